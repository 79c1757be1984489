"""Picture of a frequency response: both directions, with the jumps."""

import itertools
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vibrojax.plot.style import (
    COLORS,
    GREY,
    HOLLOW,
    MARKERS,
    SMALL,
    STYLES,
    WORDS,
    chosen_in,
    family_colors,
    finish,
    label_for,
    mark_places,
    new_picture,
)
from vibrojax.results.axes import axes_of, axis_scale
from vibrojax.results.status import LOST, Status
from vibrojax.results.variables import label_of

MAX_MARKERS = 30
"""Markers on a line that show its direction; every point of a short sweep has one."""
JUMP: dict[str, Any] = {"linestyle": (0, (3, 2)), "linewidth": 1.3}
GONE: dict[str, Any] = {"marker": "x", "linestyle": "none"}
UNSETTLED = {
    Status.aperiodic: ("no period found", HOLLOW | {"marker": ">", "markeredgewidth": 1.4}),
    Status.diverged: ("diverged", GONE),
    Status.unbounded: ("unbounded", GONE),
    Status.gave_up: ("given up", GONE),
}
"""What the legend says of points that did not settle, and how it shows them."""

Jumps = dict[str, tuple[float, int, str]]
"""Of a direction: where it jumps, after which point, and the name of the jump."""


def plot_frequency_response(
    response: xarray.Dataset, variable: str, directions: tuple[str, ...]
) -> Figure:
    """Draw one variable against frequency in some directions, with the jumps.

    One axis of the call may be left in the dataset and is drawn as lines of different colour.
    Points that did not settle are hollow.
    """
    _, axes = new_picture()
    axis = str(response[variable].dims[-1])
    chosen = response.sel(direction=list(directions))
    left = [str(d) for d in response["jump_up"].dims]
    if left:
        colors = family_colors(axes, axis_scale(axes_of(response, left), left[0]), linewidth=3)
        lanes = [response.isel({left[0]: k}) for k in range(len(colors))]
        several = [dict.fromkeys(directions, color) for color in colors]
    else:
        lanes, several = [response], [COLORS]
    jumps = [_jumps(lane, axis) for lane in lanes]
    for lane, found, own in zip(lanes, jumps, several, strict=True):
        for stagger, direction in enumerate(directions):
            line = lane.sel(direction=direction)
            style = {"color": own[direction], "markers": MAX_MARKERS // (1 + bool(left))}
            _draw_curve(axes, line, variable, found.get(direction), stagger, **style)
    entries = dict.fromkeys(directions, GREY) if left else COLORS
    for d in directions:
        style = {"color": entries[d], "linestyle": STYLES[d], "linewidth": 1.8}
        axes.plot([], [], marker=MARKERS[d], label=WORDS[d], **style)
    if left and any(d in found for found in jumps for d in directions):
        axes.plot([], [], color=GREY, label="jump", **JUMP)
    for status, (words, style) in UNSETTLED.items():
        if count := int((chosen["status"] == status.value).sum()):
            words = f"{words} ({count} point{'s' if count > 1 else ''})"
            axes.plot([], [], color=GREY, markersize=8, label=words, **style)
    _from_zero(axes, variable)
    if not left:
        unit, found = " Hz" if axis == "frequency" else "", jumps[0]
        named = [(*found[d], COLORS[d]) for d in directions if d in found]
        mark_places([axes], [(x, f"{name} {x:.5g}{unit}", color) for x, _, name, color in named])
        if axis == "frequency_ratio":
            _hertz_above(axes, float(response["natural_frequency"]))
    return finish(axes, label_for(response[axis]), label_for(response[variable]), chosen_in(chosen))


def _jumps(lane: xarray.Dataset, axis: str) -> Jumps:
    """Return the jumps of one system by their directions."""
    frequencies, amplitude = lane[axis].values, lane["amplitude_ratio"].values
    directions, found = lane["direction"].values.tolist(), []
    for name in ("jump_up", "jump_down"):
        where = float(lane[name])
        if np.isfinite(where) and len(frequencies) > 1:
            at = np.clip(np.searchsorted(frequencies, where) - 1, 0, len(frequencies) - 2)
            step = np.nan_to_num(np.abs(amplitude[:, at + 1] - amplitude[:, at]))
            found.append((step, (where, int(at), name.replace("_", " "))))
    # A direction has one jump at most: give each jump the direction that changes there.
    takers = itertools.permutations(range(len(directions)), len(found))

    def change(taker: tuple[int, ...]) -> float:
        return float(sum(f[0][k] for f, k in zip(found, taker, strict=True)))

    best = max(takers, key=change, default=())
    return {directions[k]: jump for (_, jump), k in zip(found, best, strict=False)}


def _draw_curve(
    axes: Axes,
    line: xarray.Dataset,
    variable: str,
    jump: tuple[float, int, str] | None,
    stagger: int,
    *,
    color: Any,
    markers: int,
) -> None:
    """Draw one system in one direction, with its jump and the points that did not settle."""
    direction, status = line["direction"].item(), line["status"].values
    y = line[variable].values.astype(float)
    x = line[line[variable].dims[0]].values
    line_x, line_y = x, y
    if jump is not None:  # the line is broken there
        where, at, _ = jump
        line_x, line_y = np.insert(x, at + 1, x[at + 1]), np.insert(y, at + 1, np.nan)
        _draw_jump(axes, where, x[at : at + 2], y[at : at + 2], direction, color)
    axes.plot(line_x, line_y, color=color, linestyle=STYLES[direction], linewidth=1.8)
    every = max(1, -(-len(x) // markers))
    shown = (np.arange(len(x)) - stagger * every // 2) % every == 0
    shown &= status == Status.settled.value
    marks: dict[str, Any] = {"marker": MARKERS[direction], "linestyle": "none", "color": color}
    axes.plot(x[shown], y[shown], markersize=6.5, **marks)
    lost = status == Status.aperiodic.value
    axes.plot(x[lost], y[lost], markersize=8, markeredgewidth=1.4, **(marks | HOLLOW))
    gone = x[np.isin(status, LOST)]
    at_bottom = {"transform": axes.get_xaxis_transform(), "color": color, "markersize": 8}
    axes.plot(gone, np.full(len(gone), 0.02), **(at_bottom | GONE))


def _draw_jump(
    axes: Axes, where: float, x: np.ndarray, y: np.ndarray, direction: str, color: Any
) -> None:
    """Draw a jump as a dashed arrow from branch to branch, behind the curves."""
    axes.plot([x[0], where, where, x[1]], y[[0, 0, 1, 1]], color=color, zorder=1.8, **JUMP)
    start, end = y if direction == "forward" else y[::-1]
    if not np.isfinite([start, end]).all():
        return
    middle, reach = (start + end) / 2, 0.04 * (end - start)
    axes.annotate(
        "",
        xy=(where, middle + reach),
        xytext=(where, middle - reach),
        arrowprops={"arrowstyle": "-|>", "color": color, "mutation_scale": 20, "linewidth": 0},
        zorder=1.9,
    )


def _hertz_above(axes: Axes, natural: float) -> None:
    """Add the frequency in Hz above one over the natural frequency."""
    scales = (lambda r: np.asarray(r) * natural, lambda f: np.asarray(f) / natural)
    hertz = axes.secondary_xaxis("top", functions=scales)
    hertz.set_xlabel(label_of("frequency"), fontsize=SMALL, color=GREY)
    hertz.tick_params(labelsize=SMALL, colors=GREY)
    hertz.spines["top"].set_color(GREY)


def _from_zero(axes: Axes, variable: str) -> None:
    """Let an axis of sizes begin at zero, and name the values of a status."""
    if variable == "status":
        shown = (Status.settled, *UNSETTLED)
        axes.set_yticks([s.value for s in shown], [s.name for s in shown])
        return
    if variable == "period":
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    top = max(axes.get_ylim()[1], 1e-12)
    axes.set_ylim(-0.02 * top, top)  # markers at zero are seen whole
