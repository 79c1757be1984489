"""Picture of a frequency response: both directions, with the jumps."""

import itertools
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from vibrojax.plot.style import (
    COLORS,
    GREY,
    HOLLOW,
    MARKERS,
    MAX_LINES,
    SMALL,
    STYLES,
    WORDS,
    Key,
    chosen_in,
    finish,
    label_for,
    mark_places,
    new_picture,
    scale_beside,
    shades,
)
from vibrojax.results.axes import axes_of, axis_scale
from vibrojax.results.status import Status
from vibrojax.results.variables import label_of

MAX_MARKERS = 30
"""Markers on a line that show its direction; every point of a short sweep has one."""
JUMP = (0, (3, 2))


def plot_frequency_response(
    response: xarray.Dataset, variable: str, directions: tuple[str, ...]
) -> Figure:
    """Draw one variable against frequency in some directions, with the jumps.

    One axis of the call may be left in the dataset and is drawn as lines of different colour.
    Points that did not settle are hollow.
    """
    figure, axes = new_picture()
    left = response["jump_up"].dims
    lanes = [response.isel({left[0]: k}) for k in range(response.sizes[left[0]])] if left else []
    if left:
        lanes = [_Lane(one, variable) for one in lanes]
        key = _family(figure, axes, response, lanes, directions, str(left[0]))
    else:
        lanes, key = [_Lane(response, variable)], {}
        _single(axes, lanes[0], directions)
    _from_zero(axes, variable)
    if not left:
        lane, unit = lanes[0], " Hz" if lanes[0].axis == "frequency" else ""
        jumps = [(*lane.jumps[d], COLORS[d]) for d in directions if d in lane.jumps]
        mark_places([axes], [(x, f"{name} {x:.5g}{unit}", color) for x, _, name, color in jumps])
        _hertz_above(axes, lane)
    colors = dict.fromkeys(directions, GREY) if left else COLORS
    names = label_for(response[lanes[0].axis]), label_for(response[variable])
    return finish(figure, axes, *names, key | _key(lanes, directions, colors), chosen_in(response))


class _Lane:
    """What is drawn of one system."""

    def __init__(self, response: xarray.Dataset, variable: str):
        self.axis = str(response[variable].dims[-1])
        self.frequencies = response[self.axis].values
        self.directions = response["direction"].values.tolist()
        self.curves = response[variable].values.astype(float)
        self.status = response["status"].values
        amplitude = response["amplitude_ratio"].values
        self.natural_frequency = float(response["natural_frequency"])
        self.jumps: dict[str, tuple[float, int, str]] = {}
        """Of a direction: where it jumps, after which point, and the name of the jump."""
        found = []
        for name in ("jump_up", "jump_down"):
            where = float(response[name])
            if np.isfinite(where) and len(self.frequencies) > 1:
                last = len(self.frequencies) - 2
                at = int(np.clip(np.searchsorted(self.frequencies, where) - 1, 0, last))
                change = np.nan_to_num(np.abs(amplitude[:, at + 1] - amplitude[:, at]))
                found.append((change, (where, at, name.replace("_", " "))))
        # A direction has one jump at most: give each jump the direction that changes there.
        takers = list(itertools.permutations(range(len(self.directions)), len(found)))
        if takers:
            best = max(takers, key=lambda t: sum(f[0][k] for f, k in zip(found, t, strict=True)))
            for (_, jump), k in zip(found, best, strict=True):
                self.jumps[self.directions[k]] = jump

    def curve(self, direction: str) -> np.ndarray:
        return self.curves[self.directions.index(direction)]

    def of_status(self, direction: str, *status: Status) -> np.ndarray:
        own = self.status[self.directions.index(direction)]
        return np.isin(own, [one.value for one in status])


def _draw_curve(
    axes: Axes, lane: _Lane, direction: str, color: Any, stagger: int, markers: int = MAX_MARKERS
) -> None:
    x, y = lane.frequencies, lane.curve(direction)
    line_x, line_y = x, y
    if direction in lane.jumps:  # the line is broken at the jump
        at = lane.jumps[direction][1] + 1
        line_x, line_y = np.insert(x, at, x[at]), np.insert(y, at, np.nan)
    axes.plot(line_x, line_y, color=color, linestyle=STYLES[direction], linewidth=1.8)
    every = max(1, -(-len(x) // markers))
    shown = lane.of_status(direction, Status.settled)
    shown &= (np.arange(len(x)) - stagger * every // 2) % every == 0
    marks: dict[str, Any] = {"marker": MARKERS[direction], "linestyle": "none", "color": color}
    axes.plot(x[shown], y[shown], markersize=6.5, **marks)
    lost = lane.of_status(direction, Status.aperiodic)
    axes.plot(x[lost], y[lost], markersize=8, markeredgewidth=1.4, **(marks | HOLLOW))
    gone = lane.of_status(direction, Status.diverged, Status.unbounded)
    if gone.any():
        at_bottom = axes.get_xaxis_transform()
        marks["marker"] = "x"
        axes.plot(x[gone], np.full(gone.sum(), 0.02), transform=at_bottom, markersize=8, **marks)


def _draw_jump(axes: Axes, lane: _Lane, direction: str, color: Any) -> None:
    """Draw a jump as a dashed arrow from branch to branch, behind the curves."""
    if direction not in lane.jumps:
        return
    where, at, _ = lane.jumps[direction]
    x, y = lane.frequencies[[at, at + 1]], lane.curve(direction)[[at, at + 1]]
    path = [x[0], where, where, x[1]], [y[0], y[0], y[1], y[1]]
    axes.plot(*path, color=color, linestyle=JUMP, linewidth=1.3, zorder=1.8)
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


def _single(axes: Axes, lane: _Lane, directions: tuple[str, ...]) -> None:
    for stagger, direction in enumerate(directions):
        _draw_curve(axes, lane, direction, COLORS[direction], stagger)
        _draw_jump(axes, lane, direction, COLORS[direction])


def _hertz_above(axes: Axes, lane: _Lane) -> None:
    """Add the frequency in Hz above one over the natural frequency."""
    if lane.axis != "frequency_ratio":
        return
    natural = lane.natural_frequency
    scales = (lambda r: np.asarray(r) * natural, lambda f: np.asarray(f) / natural)
    hertz = axes.secondary_xaxis("top", functions=scales)
    hertz.set_xlabel(label_of("frequency"), fontsize=SMALL, color=GREY)
    hertz.tick_params(labelsize=SMALL, colors=GREY)
    hertz.spines["top"].set_color(GREY)


def _from_zero(axes: Axes, variable: str) -> None:
    """Let an axis of sizes begin at zero, and name the values of a status."""
    if variable == "status":
        shown = (Status.settled, Status.aperiodic, Status.diverged, Status.unbounded)
        axes.set_yticks([s.value for s in shown], [s.name for s in shown])
    elif variable == "period":
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        top = max(axes.get_ylim()[1], 1e-12)
        axes.set_ylim(-0.02 * top, top)  # markers at zero are seen whole


def _family(
    figure: Figure,
    axes: Axes,
    response: xarray.Dataset,
    lanes: list[_Lane],
    directions: tuple[str, ...],
    name: str,
) -> Key:
    """Draw several systems in the colours of a scale; return the legend of few."""
    scale = axis_scale(axes_of(response, [name]), name)
    values, key = scale.places, {}
    if len(values) > MAX_LINES:
        spread = values.max() / values.min() if values.min() > 0 else 1.0
        norm = (LogNorm if spread > 30 else Normalize)(values.min(), values.max())
        colors = map(scale_beside(figure, axes, norm, scale.label), values)
    else:
        colors = shades(len(values))
    for lane, color, label in zip(lanes, colors, scale.labels, strict=True):
        if len(values) <= MAX_LINES:
            key[label] = Line2D([], [], color=color, linewidth=3)
        for stagger, direction in enumerate(directions):
            _draw_curve(axes, lane, direction, color, stagger, MAX_MARKERS // 2)
            _draw_jump(axes, lane, direction, color)
    return key


def _key(lanes: list[_Lane], directions: tuple[str, ...], colors: dict[str, str]) -> Key:
    key: Key = {}
    for d in directions:
        style: dict[str, Any] = {"color": colors[d], "linestyle": STYLES[d], "linewidth": 1.8}
        key[WORDS[d]] = Line2D([], [], marker=MARKERS[d], markersize=7, **style)
    if len(lanes) > 1 and any(d in lane.jumps for lane in lanes for d in directions):
        key["jump"] = Line2D([], [], color=GREY, linestyle=JUMP, linewidth=1.3)
    hollow = HOLLOW | {"marker": ">", "markeredgewidth": 1.4}
    gone = {"marker": "x", "linestyle": "none"}
    for status, words, style in (
        (Status.aperiodic, "no period found", hollow),
        (Status.diverged, "diverged", gone),
        (Status.unbounded, "unbounded", gone),
    ):
        count = sum(int(lane.of_status(d, status).sum()) for lane in lanes for d in directions)
        if count:
            label = f"{words} ({count} point{'s' if count > 1 else ''})"
            key[label] = Line2D([], [], color=GREY, markersize=8, **style)
    return key
