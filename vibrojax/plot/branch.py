"""Pictures of branches."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.style import (
    COLORS,
    GREY,
    HOLLOW,
    MARKERS,
    Key,
    chosen_in,
    draw_stable,
    finish,
    key_of,
    label_for,
    new_picture,
    shades,
    stability_key,
)

MARKS = {
    "fold": ("o", "fold"),
    "period_doubling": ("D", "period doubling"),
    "neimark_sacker": ("^", "Neimark-Sacker"),
    "grazing": ("|", "first touch"),
}
MOST = 14
"""Entries of a legend."""


def plot_branches(
    branches: Sequence[xarray.Dataset], variable: str, sweep: xarray.Dataset | None = None
) -> Figure:
    """Draw one variable of some branches: stable solid, unstable dashed, special points marked.

    `sweep` is laid over them: the dataset of one system.
    """
    figure, axes = new_picture()
    first = branches[0]
    axis = str(first.attrs["axis"])
    colors = shades(len(branches)) if len(branches) > 1 else [COLORS["blue"]]
    points: Key = {}
    own: Key = {}
    drawn: set[bool] = set()
    for branch, color in zip(branches, colors, strict=True):
        x, y, stable = (branch[name].values for name in (axis, variable, "stable"))
        drawn |= draw_stable(axes, x, y, stable, color=color, linewidth=1.8, zorder=3)
        for kind, (marker, words) in MARKS.items():
            at = branch[f"{kind}s"].values
            style: dict[str, Any] = HOLLOW | {"marker": marker, "markeredgewidth": 2.0}
            style["markersize"] = 10 if marker == "|" else 8
            if len(at):
                heights = _heights(branch, kind, x, y, variable)
                axes.plot(at, heights, color=color, zorder=4, **style)
                points[words] = Line2D([], [], color=GREY, **style)
        if len(branches) > 1:
            own[chosen_in(branch)] = Line2D([], [], color=color, linewidth=3)
    key = stability_key(drawn, ("stable", "unstable"), color=GREY, linewidth=1.8)
    key |= {words: points[words] for _, words in MARKS.values() if words in points} | own
    if sweep is not None:
        key |= _lay_sweep(axes, sweep, variable)
    if variable != "leading_multiplier":
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    else:
        axes.axhline(1.0, color=GREY, linewidth=0.8)
    names = label_for(first[axis]), label_for(first[variable])
    return finish(figure, axes, *names, dict(list(key.items())[:MOST]))


def _heights(
    branch: xarray.Dataset, kind: str, x: np.ndarray, y: np.ndarray, variable: str
) -> np.ndarray:
    """Return the values at special points, between those of their neighbours where not known."""
    if variable == "amplitude_ratio":
        return branch[f"{kind}_amplitude_ratio"].values
    at = np.minimum(branch[f"{kind}_after"].values, len(y) - 2)
    step = x[at + 1] - x[at]
    share = np.clip((branch[f"{kind}s"].values - x[at]) / np.where(step, step, 1.0), 0.0, 1.0)
    return y[at] + np.where(step, share, 0.5) * (y[at + 1] - y[at])


def _lay_sweep(axes: Axes, sweep: xarray.Dataset, variable: str) -> Key:
    key: Key = {}
    x = sweep[sweep[variable].dims[-1]].values
    for direction in sweep["direction"].values.tolist():
        # Filled and hollow: told apart without colour too.
        hollow = direction == "backward"
        color = COLORS["black"] if hollow else COLORS["orange"]
        style: dict[str, Any] = {
            "marker": MARKERS[direction],
            "linestyle": "none",
            "color": color,
            "markerfacecolor": "white" if hollow else color,
        }
        y = sweep[variable].sel(direction=direction).values.reshape(-1)
        axes.plot(x, y, markersize=5, alpha=0.9, zorder=2, **style)
        key[f"{direction} sweep"] = Line2D([], [], markersize=6, **style)
    return key


def plot_fold_curves(curves: Sequence[xarray.Dataset]) -> Figure:
    """Draw the frequencies of folds against a second number."""
    figure, axes = new_picture()
    names = [curves[0].attrs[name] for name in ("axis", "parameter")]
    for k, (curve, color) in enumerate(zip(curves, shades(len(curves)), strict=True)):
        x, y = (curve[name].values for name in names)
        axes.plot(x, y, color=color, linewidth=2.0, label=f"fold {k + 1}")
        # Where a fold ends inside the range, its end is marked.
        for end, why in zip((0, -1), ("low_ending", "high_ending"), strict=True):
            if curve.attrs[why] != "end of the range":
                axes.plot(x[end], y[end], "o", color=color, markersize=7)
    x, y = (label_for(curves[0][name]) for name in names)
    return finish(figure, axes, x, y, key_of(axes))
