"""Pictures of profile likelihoods."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from vibrojax.plot.style import (
    COLORS,
    DASHES,
    FRAME,
    GREY,
    SIZE,
    SMALL,
    Key,
    dress,
    empty_picture,
    name_axes,
    outside_legend,
)

REFITTED: dict[str, Any] = {"color": COLORS["blue"], "linewidth": 1.8}
LIMIT: dict[str, Any] = {"color": COLORS["orange"], "linestyle": DASHES, "linewidth": 1.5}
INSIDE: dict[str, Any] = {"color": COLORS["blue"], "alpha": 0.13, "linewidth": 0}
ESTIMATE: dict[str, Any] = {"color": GREY, "linestyle": ":", "linewidth": 1.5}


def plot_profiles(profiles: Sequence[xarray.Dataset]) -> Figure:
    """Draw profiles side by side: the rise of chi-square against the number that was held.

    They are those of `Profile.to_xarray()`. Raises `ValueError` when there is none.
    """
    if not profiles:
        raise ValueError("profiles is empty: give at least one profile.")
    count = len(profiles)
    columns = min(count, 3 if count != 4 else 2)
    rows = -(-count // columns)
    figure = empty_picture((SIZE[0], max(SIZE[1] if count == 1 else 0.0, 3.1 * rows + FRAME)))
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for k, axes in enumerate(panels.flat):
        if k >= count:
            axes.set_axis_off()
            continue
        dress(axes)
        _draw_profile(axes, profiles[k])
    for row in panels:
        name_axes(row[0], None, "Rise of chi-square")
    # All of the rise, or what is of interest where it is huge.
    threshold = max(p.attrs["threshold"] for p in profiles)
    highest = max(float(p["rise"].max()) for p in profiles)
    top = 1.06 * min(max(highest, 1.3 * threshold), 6 * threshold)
    panels[0, 0].set_ylim(-0.03 * top, top)
    outside_legend(figure, _key(profiles[0].attrs))
    return figure


def _draw_profile(axes: Axes, profile: xarray.Dataset) -> None:
    name, estimate = profile.attrs["parameter"], profile.attrs["estimate"]
    values, rise = profile[name].values.astype(float), profile["rise"].values.astype(float)
    logarithmic = values.min() > 0 and values.max() > 10 * values.min()
    inside, outside = (np.log, np.exp) if logarithmic else (np.asarray, np.asarray)
    # Roots of the rise are nearly straight: what lies between the values is drawn by them.
    known, root = values, np.sqrt(np.maximum(rise, 0.0)) * np.sign(values - estimate)
    if estimate not in values and values[0] < estimate < values[-1]:
        place = int(np.searchsorted(values, estimate))
        known, root = np.insert(values, place, estimate), np.insert(root, place, 0.0)
    at = inside(known)
    between = np.linspace(at[0], at[-1], 40 * len(at))
    axes.plot(outside(between), np.interp(between, at, root) ** 2, **REFITTED)
    axes.plot(values, rise, "o", color=REFITTED["color"], markersize=6)
    low, high = profile.attrs["interval"]
    axes.axvspan(low, high, zorder=0.5, **INSIDE)
    axes.axhline(profile.attrs["threshold"], **LIMIT)
    axes.axvline(estimate, **ESTIMATE)
    if logarithmic:
        axes.set_xscale("log")
    title = f"{estimate:.4g}  ({low:.4g} to {high:.4g})"
    axes.set_title(title, fontsize=SMALL, loc="left", color=GREY)
    name_axes(axes, f"{name} (SI)", None)


def _key(first: dict[str, Any]) -> Key:
    percent = f"{100 * first['confidence']:g} %"
    return {
        "others refitted": Line2D([], [], marker="o", markersize=6, **REFITTED),
        f"{percent} threshold, {first['threshold']:.3g}": Line2D([], [], **LIMIT),
        f"{percent} interval": Patch(**INSIDE),
        "estimate": Line2D([], [], **ESTIMATE),
    }
