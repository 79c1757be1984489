"""Pictures of branches."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax._tools.checks import nearest
from vibrojax.branches.branch import CURVES, Branch, axis_description
from vibrojax.plot.style import (
    GREY,
    LABEL,
    MARKERS,
    SMALL,
    label_of,
    new_picture,
    outside_legend,
)
from vibrojax.results.variables import named_value

if TYPE_CHECKING:
    from vibrojax.branches.fold_curves import FoldCurve
    from vibrojax.sweep.frequency_response import FrequencyResponse

MARKS = {
    "fold": ("o", "fold"),
    "period_doubling": ("D", "period doubling"),
    "neimark_sacker": ("^", "Neimark-Sacker"),
    "grazing": ("|", "first touch"),
}
BLUE = "#0060a8"


def plot_branches(
    branches: list[Branch], variable: str = "amplitude_ratio", *, sweep: Any = None
) -> Figure:
    """Draw one variable of some branches: stable solid, unstable dashed, special points marked.

    Raises `ValueError` for an unknown variable, or when there is nothing to draw.
    """
    if variable not in CURVES:
        raise ValueError(f"Unknown variable {variable!r}. {nearest(variable, CURVES)}")
    drawn = [b for b in branches if len(b.values)]
    if not drawn:
        raise ValueError("None of the branches has a point to draw.")
    figure, axes = new_picture()
    first = drawn[0]
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(drawn)))
    seen: set[str] = set()
    unstable = False
    for branch, shade in zip(drawn, shades, strict=True):
        color = BLUE if len(drawn) == 1 else shade
        y = np.asarray(getattr(branch, variable))
        for stable, start, stop in _runs(branch.stable):
            unstable |= not stable
            axes.plot(
                branch.values[start:stop],
                y[start:stop],
                color=color,
                linewidth=2.0 if stable else 1.5,
                linestyle="-" if stable else (0, (4, 2)),
                zorder=3,
            )
        for point in branch.special_points:
            marker, _ = MARKS[point.kind]
            seen.add(point.kind)
            axes.plot(
                point.parameter,
                _height(branch, y, variable, point),
                marker=marker,
                color=color,
                markersize=10 if marker == "|" else 8,
                markeredgewidth=2.0,
                markerfacecolor="white",
                linestyle="none",
                zorder=4,
            )
    lines, labels = _key(unstable, seen)
    if len(drawn) > 1:
        for branch, shade in zip(drawn, shades, strict=True):
            lines.append(Line2D([], [], color=shade, linewidth=3))
            labels.append(", ".join(named_value(n, v) for n, v in branch.labels.items()))
    if sweep is not None:
        _lay_sweep(axes, sweep, variable, lines, labels)
    axes.set_xlabel(_axis_label(first.axis), fontsize=LABEL)
    axes.set_ylabel(label_of(variable, first.ratio_units), fontsize=LABEL)
    if variable != "leading_multiplier":
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    else:
        axes.axhline(1.0, color=GREY, linewidth=0.8)
    outside_legend(axes, lines[:14], labels[:14])
    axes.tick_params(labelsize=SMALL)
    return figure


def _axis_label(axis: str) -> str:
    described = axis_description(axis)
    units = described["units"]
    return described["long_name"] if units == "1" else f"{described['long_name']} ({units})"


def _runs(stable: np.ndarray):
    """Stretches of one stability, each reaching to the first point of the next."""
    edges = np.flatnonzero(np.diff(stable.astype(int))) + 1
    starts, stops = np.r_[0, edges], np.r_[edges, len(stable)]
    for start, stop in zip(starts, stops, strict=True):
        yield bool(stable[start]), start, min(stop + 1, len(stable))


def _height(branch: Branch, y: np.ndarray, variable: str, point: Any) -> float:
    if variable == "amplitude_ratio":
        return point.amplitude_ratio
    at = min(point.after, len(y) - 2)
    x0, x1 = branch.values[at], branch.values[at + 1]
    share = 0.5 if x0 == x1 else np.clip((point.parameter - x0) / (x1 - x0), 0.0, 1.0)
    return float(y[at] + share * (y[at + 1] - y[at]))


def _key(unstable: bool, seen: set[str]) -> tuple[list[Any], list[str]]:
    lines: list[Any] = [Line2D([], [], color=GREY, linewidth=2.0)]
    labels = ["stable"]
    if unstable:
        lines.append(Line2D([], [], color=GREY, linewidth=1.5, linestyle=(0, (4, 2))))
        labels.append("unstable")
    for kind, (marker, words) in MARKS.items():
        if kind in seen:
            style = {"markerfacecolor": "white", "markeredgewidth": 2.0, "markersize": 8}
            lines.append(Line2D([], [], color=GREY, marker=marker, linestyle="none", **style))
            labels.append(words)
    return lines, labels


def _lay_sweep(
    axes: Any, sweep: "FrequencyResponse", variable: str, lines: list[Any], labels: list[str]
) -> None:
    # Filled and hollow: told apart without colour too.
    colors = {"forward": "#d1590a", "backward": "black"}
    faces = {"forward": "#d1590a", "backward": "white"}
    for k, direction in enumerate(sweep.directions):
        y = np.asarray(getattr(sweep, variable))[..., k, :].reshape(-1)
        x = np.asarray(sweep.frequencies)
        if len(y) != len(x):
            raise ValueError("sweep must be of one system: pick one value of every axis.")
        style: dict[str, Any] = {
            "marker": MARKERS[direction],
            "linestyle": "none",
            "color": colors[direction],
            "markerfacecolor": faces[direction],
        }
        axes.plot(x, y, markersize=5, alpha=0.9, zorder=2, **style)
        lines.append(Line2D([], [], markersize=6, **style))
        labels.append(f"{direction} sweep")


def plot_fold_curves(curves: "Sequence[FoldCurve]") -> Figure:
    """Draw the frequencies of folds against a second number.

    Raises `ValueError` when there is no fold.
    """
    if not curves:
        raise ValueError("There are no folds to draw.")
    figure, axes = new_picture()
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.75, len(curves)))
    for k, (curve, shade) in enumerate(zip(curves, shades, strict=True)):
        axes.plot(curve.folds, curve.values, color=shade, linewidth=2.0, label=f"fold {k + 1}")
        # Where a fold ends inside the range, its end is marked.
        for end, why in zip((0, -1), curve.endings, strict=True):
            if why != "end of the range":
                axes.plot(curve.folds[end], curve.values[end], "o", color=shade, markersize=7)
    axes.set_xlabel(_axis_label(curves[0].axis), fontsize=LABEL)
    axes.set_ylabel(_axis_label(curves[0].parameter), fontsize=LABEL)
    lines, labels = axes.get_legend_handles_labels()
    outside_legend(axes, lines, labels)
    return figure
