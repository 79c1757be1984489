"""Picture of a resolution check."""

from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from vibrojax.plot.style import (
    COLORS,
    GREY,
    HOLLOW,
    SMALL,
    SYMBOLS,
    finish,
    label_for,
    new_picture,
)

STYLES = tuple(zip(SYMBOLS, ("blue", "orange", "green", "violet"), strict=True))
LEAST = 1e-16
"""Where changes of exactly zero are drawn."""


def plot_resolution(check: xarray.Dataset) -> Figure:
    """Draw the relative change of every number, one marker for every refinement.

    Hollow markers at the right end are changes without a size.
    """
    _, axes = new_picture()
    relative, names = check["relative_change"], check["number"].values.tolist()
    for k, what in enumerate(check["refinement"].values.tolist()):
        marker, color = STYLES[k % len(STYLES)]
        changes = np.maximum(relative.values[k], LEAST)
        places = np.arange(len(names)) + 0.12 * (k - (len(relative) - 1) / 2)
        known = np.isfinite(changes)
        style: dict[str, Any] = {"marker": marker, "color": COLORS[color], "markersize": 9}
        axes.plot(changes[known], places[known], linestyle="none", label=what, **style)
        lost, beside = places[~known], axes.get_yaxis_transform()
        axes.plot(np.full(len(lost), 0.985), lost, transform=beside, **(style | HOLLOW))
    if not np.isfinite(relative.values).all():
        words = "from 0, came or went, or not finite"
        axes.plot([], [], "o", color=GREY, markersize=9, label=words, **HOLLOW)
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), [n.replace("_", " ") for n in names], fontsize=SMALL)
    axes.invert_yaxis()
    return finish(axes, f"{label_for(relative)} ({LEAST:g}: none)", "")
