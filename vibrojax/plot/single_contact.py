"""Picture of the response with one contact per drive period."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.style import (
    COLORS,
    GREY,
    Key,
    draw_stable,
    finish,
    label_for,
    new_picture,
    shades,
    stability_key,
)

FOLDS: dict[str, Any] = {"color": COLORS["red"], "linestyle": ":", "linewidth": 1.8}
FREE: dict[str, Any] = {"color": GREY, "linewidth": 1.0}


def plot_single_contact(
    response: xarray.Dataset, levels: Sequence[tuple[float, bool, Any]], folds: Any
) -> Figure:
    """Draw level sets of the gap ratio as amplitude against frequency, and the folds.

    `levels` are gap ratios, whether it is that of the system, and the lines: `frequency`,
    `amplitude_ratio`, `stable` and which places are `drawn`; `folds` are such lines.
    """
    figure, axes = new_picture()
    key: Key = {}
    top, units = 0.0, response["gap_ratio"].attrs["units"]
    for (level, is_own, curve), color in zip(levels, shades(max(len(levels), 1)), strict=False):
        style = {"color": color, "linewidth": 2.8 if is_own else 1.7}
        top = max(top, np.max(curve.amplitude_ratio, initial=0.0, where=curve.drawn))
        joined = curve.drawn & np.append(curve.drawn[1:], False)
        draw_stable(axes, curve.frequency, curve.amplitude_ratio, curve.stable, joined, **style)
        words = f"gap / drive {level:.4g}{'' if units == '1' else f' {units}'}"
        key[words + " (this system)" * is_own] = Line2D([], [], **style)
    free = response["contact_free_amplitude_ratio"]
    frequency = response[free.dims[0]]
    axes.plot(frequency, free, **FREE)
    axes.plot(folds.frequency, np.where(folds.drawn, folds.amplitude_ratio, np.nan), **FOLDS)
    key["no contact"] = Line2D([], [], **FREE)
    key |= stability_key({True, False}, ("stable", "unstable"), color=GREY, linewidth=1.8)
    key["folds"] = Line2D([], [], **FOLDS)
    axes.set_xlim(float(frequency[0]), float(frequency[-1]))
    axes.set_ylim(0.0, 1.08 * top if top else None)
    names = label_for(frequency), label_for(response["amplitude_ratio"])
    return finish(figure, axes, *names, key, "One contact per drive period")
