"""Pictures of branches: responses through their folds, single contact."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from vibrojax.plot.style import (
    COLORS,
    GREY,
    HOLLOW,
    MARKERS,
    chosen_in,
    draw_stable,
    finish,
    label_for,
    new_picture,
    shades,
    show_zero,
)

MARKS = {
    "fold": ("o", "fold"),
    "period_doubling": ("D", "period doubling"),
    "neimark_sacker": ("^", "Neimark-Sacker"),
    "grazing": ("|", "first touch"),
}
APART = 0.01
"""Least distance of points whose band is shaded, over the size of the picture."""
MOST = 10
"""Branches that the legend names."""
FOLDS: dict[str, Any] = {"color": COLORS["red"], "linestyle": ":", "linewidth": 1.8}


def plot_branches(
    branches: Sequence[xarray.Dataset],
    variable: str,
    sweep: xarray.Dataset | None = None,
    band: xarray.Dataset | None = None,
) -> Figure:
    """Draw one variable of some branches: stable solid, unstable dashed, special points marked.

    `sweep` is laid over them: the dataset of one system. `band` is what tolerances may make of it.
    """
    _, axes = new_picture()
    if band is not None:
        _shade_band(axes, band, variable)
    first = branches[0]
    axis = str(first.attrs["axis"])
    several = len(branches) > 1
    colors = shades(len(branches)) if several else [COLORS["blue"]]
    for branch, color in zip(branches, colors, strict=True):
        x, y, stable = (branch[name].values for name in (axis, variable, "stable"))
        draw_stable(axes, x, y, stable, color=color, linewidth=1.8, zorder=3)
    for kind, (marker, words) in MARKS.items():
        style: dict[str, Any] = HOLLOW | {"marker": marker, "markeredgewidth": 2.0, "zorder": 4}
        style["markersize"] = 10 if marker == "|" else 8
        for branch, color in zip(branches, colors, strict=True):
            at = branch[f"{kind}s"].values
            axes.plot(at, _heights(branch, kind, axis, variable), color=color, **style)
        if any(branch[f"{kind}s"].size for branch in branches):
            axes.plot([], [], color=GREY, label=words, **style)
    for branch, color in zip(branches[: MOST * several], colors, strict=False):
        axes.plot([], [], color=color, linewidth=3, label=chosen_in(branch))
    if sweep is not None:
        _lay_sweep(axes, sweep, variable)
    if variable != "leading_multiplier":
        show_zero(axes)
    else:
        axes.axhline(1.0, color=GREY, linewidth=0.8)
    return finish(axes, label_for(first[axis]), label_for(first[variable]))


def _shade_band(axes: Axes, band: xarray.Dataset, variable: str) -> None:
    """Shade how far the curve may lie from where it is, all tolerances to the worse side."""
    curve = np.array([band[str(band.attrs["axis"])].values, band[variable].values])
    moves = np.array([band["frequency_change"].values, band[f"{variable}_change"].values])
    size = np.ptp(curve, axis=1)
    size = np.where(size > 0, size, 1.0)[:, None]
    # Points that are apart in the picture: wiggles too small to be seen have any direction.
    kept = [0]
    for k in range(1, curve.shape[1]):
        if np.linalg.norm((curve[:, k] - curve[:, kept[-1]]) / size[:, 0]) >= APART:
            kept.append(k)
    curve, moves = curve[:, kept], moves[..., kept]
    # Across the curve as it is seen: along it nothing is seen to move.
    along = np.gradient(curve / size, axis=1)
    along = along / np.linalg.norm(along, axis=0)
    across = np.array([-along[1], along[0]])
    far = np.sum(np.abs(np.einsum("cp,cnp->np", across, moves / size[:, None])), axis=0)
    far = np.median([far, np.roll(far, 1), np.roll(far, -1)], axis=0)
    aside = size * across * far
    outline = np.concatenate([(curve + aside).T, (curve - aside).T[::-1]])
    words = f"{band.attrs['tolerances']} (first order)"
    shade = {"facecolor": COLORS["blue"], "alpha": 0.2, "linewidth": 0, "zorder": 1}
    axes.add_patch(Polygon(outline, closed=True, label=words, **shade))


def _heights(branch: xarray.Dataset, kind: str, axis: str, variable: str) -> np.ndarray:
    """Return the values at special points, between those of their neighbours where not known."""
    if variable == "amplitude_ratio":
        return branch[f"{kind}_amplitude_ratio"].values
    x, y = branch[axis].values, branch[variable].values
    at = np.minimum(branch[f"{kind}_after"].values, len(y) - 2)
    step = x[at + 1] - x[at]
    share = np.clip((branch[f"{kind}s"].values - x[at]) / np.where(step, step, 1.0), 0.0, 1.0)
    return y[at] + np.where(step, share, 0.5) * (y[at + 1] - y[at])


def _lay_sweep(axes: Axes, sweep: xarray.Dataset, variable: str) -> None:
    x = sweep[sweep[variable].dims[-1]].values
    for direction in sweep["direction"].values.tolist():
        # Filled and hollow: distinct without colour too.
        hollow = direction == "backward"
        color = COLORS["black"] if hollow else COLORS["orange"]
        style: dict[str, Any] = {"linestyle": "none", "marker": MARKERS[direction], "zorder": 2}
        style |= {"color": color, "markerfacecolor": "white" if hollow else color}
        y = sweep[variable].sel(direction=direction).values.reshape(-1)
        axes.plot(x, y, markersize=5, alpha=0.9, label=f"{direction} sweep", **style)


def plot_fold_curves(curves: Sequence[xarray.Dataset]) -> Figure:
    """Draw the frequencies of folds against a second number."""
    _, axes = new_picture()
    names = [curves[0].attrs[name] for name in ("axis", "parameter")]
    for k, (curve, color) in enumerate(zip(curves, shades(len(curves)), strict=True)):
        x, y = (curve[name].values for name in names)
        axes.plot(x, y, color=color, linewidth=2.0, label=f"fold {k + 1}")
        # Where a fold ends inside the range, its end is marked.
        for end, why in zip((0, -1), ("low_ending", "high_ending"), strict=True):
            if curve.attrs[why] != "end of the range":
                axes.plot(x[end], y[end], "o", color=color, markersize=7)
    x, y = (label_for(curves[0][name]) for name in names)
    return finish(axes, x, y)


def plot_single_contact(
    response: xarray.Dataset, levels: Sequence[tuple[float, bool, Any]], folds: Any
) -> Figure:
    """Draw level sets of the gap ratio as amplitude against frequency, and the folds.

    `levels` are gap ratios, whether it is that of the system, and the lines: `frequency`,
    `amplitude_ratio`, `stable` and which places are `drawn`; `folds` are such lines.
    """
    _, axes = new_picture()
    top, units = 0.0, response["gap_ratio"].attrs["units"]
    for (level, is_own, curve), color in zip(levels, shades(max(len(levels), 1)), strict=False):
        style = {"color": color, "linewidth": 2.8 if is_own else 1.7}
        top = max(top, np.max(curve.amplitude_ratio, initial=0.0, where=curve.drawn))
        joined = curve.drawn & np.append(curve.drawn[1:], False)
        draw_stable(axes, curve.frequency, curve.amplitude_ratio, curve.stable, joined, **style)
        words = f"gap / drive {level:.4g}{'' if units == '1' else f' {units}'}"
        axes.plot([], [], label=words + " (this system)" * is_own, **style)
    free = response["contact_free_amplitude_ratio"]
    frequency = response[free.dims[0]]
    axes.plot(frequency, free, color=GREY, linewidth=1.0, label="no contact")
    heights = np.where(folds.drawn, folds.amplitude_ratio, np.nan)
    axes.plot(folds.frequency, heights, label="folds", **FOLDS)
    axes.set_xlim(float(frequency[0]), float(frequency[-1]))
    axes.set_ylim(0.0, 1.08 * top if top else None)
    names = label_for(frequency), label_for(response["amplitude_ratio"])
    return finish(axes, *names, "One contact per drive period")
