"""Pictures of results, drawn without a display and without pyplot."""

import io
import itertools
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from vibrojax._tools.checks import nearest
from vibrojax.model.modes import Modes
from vibrojax.results.axes import axis_scale, example, pick
from vibrojax.results.status import Status
from vibrojax.results.variables import VARIABLES, named_value
from vibrojax.sweep.frequency_response import FrequencyResponse

SIZE, DPI = (10.0, 6.4), 150  # inches and dots per inch: 1500 pixels wide
LABEL, SMALL = 13, 11  # points
COLORS = {"forward": "#0060a8", "backward": "#d1590a"}
GREY = "#555555"
MARKERS = {"forward": ">", "backward": "<"}
STYLES = {"forward": "-", "backward": (0, (5, 1.6))}
WORDS = {"forward": "forward sweep", "backward": "backward sweep"}
MAX_MARKERS = 30
"""Markers on a line that show its direction; every point of a short sweep has one."""
MAX_LINES = 8
"""Lines that a legend names one by one; more get a colour bar."""
LINE_STYLES = ("-", (0, (6, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))


class Picture(Figure):
    """A matplotlib figure that also shows itself as the last line of a notebook cell."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        stream = io.BytesIO()
        self.savefig(stream, format="png")
        return stream.getvalue(), {"width": int(self.get_figwidth() * DPI / 2)}


def new_picture() -> tuple[Picture, Axes]:
    """Make an empty picture in the style of all of them."""
    margins = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)
    figure = Picture(figsize=SIZE, dpi=DPI, layout=margins)
    axes = figure.add_subplot()
    axes.grid(True, color="#d9d9d9", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure, axes


def label_of(name: str, ratio_units: str = "1") -> str:
    """Return the long name of a variable with its unit."""
    units, long_name = VARIABLES[name]
    units = ratio_units if units == "ratio" else units
    return long_name if units == "1" else f"{long_name} ({units})"


def plot_frequency_response(
    response: FrequencyResponse, variable: str = "amplitude_ratio", **selection: Any
) -> Figure:
    """Draw one variable against frequency in both directions, with the jumps.

    `selection` picks the nearest value of each other axis, or a `direction`; one axis may be left
    out and is drawn as lines of different colour. Points that did not settle are hollow.

    Raises `ValueError` for a variable or axis that is not there, or when more than one axis is
    left.
    """
    if variable not in response.curves:
        raise ValueError(f"Unknown variable {variable!r}. {nearest(variable, response.curves)}")
    directions = _directions(response, selection)
    index, chosen, left = pick(response.axes, selection, others=("direction",))
    if len(left) > 1:
        raise ValueError(
            f"{len(left)} axes are left, {' and '.join(left)}: give a value of all but one, such "
            f"as plot({example(response.axes, left[0])})."
        )
    figure, axes = new_picture()
    if left:
        _family(figure, axes, response, variable, directions, index, left[0])
    else:
        _single(axes, response, variable, directions, index)
    axes.set_xlabel(label_of(response.axis), fontsize=LABEL)
    axes.set_ylabel(label_of(variable, response.ratio_units), fontsize=LABEL)
    if chosen:
        title = ", ".join(named_value(name, value) for name, value in chosen.items())
        axes.set_title(title, fontsize=LABEL, loc="left")
    return figure


def _directions(response: FrequencyResponse, selection: dict[str, Any]) -> tuple[str, ...]:
    wanted = selection.pop("direction", None)
    if wanted is None:
        return response.directions
    if wanted not in response.directions:
        raise ValueError(
            f"direction must be one of those swept, {', '.join(response.directions)}, "
            f"got {wanted!r}."
        )
    return (wanted,)


class _Lane:
    """What is drawn of one system."""

    def __init__(self, response: FrequencyResponse, variable: str, index: tuple[Any, ...]):
        self.frequencies = np.asarray(response.frequencies)
        self.directions = response.directions
        self.curves = np.asarray(getattr(response, variable))[index].astype(float)
        self.status = np.asarray(response.status)[index]
        amplitude = np.asarray(response.amplitude_ratio)[index]
        self.natural_frequency = float(np.asarray(response.natural_frequency)[index])
        self.jumps: dict[str, tuple[float, int, str]] = {}
        """Of a direction: where it jumps, after which point, and the name of the jump."""
        found = []
        for name in ("jump_up", "jump_down"):
            where = float(np.asarray(getattr(response, name))[index])
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

    def of_status(self, direction: str, status: Status) -> np.ndarray:
        return self.status[self.directions.index(direction)] == status.value


def _draw_curve(
    axes: Axes,
    lane: _Lane,
    direction: str,
    color: Any,
    stagger: int,
    most_markers: int = MAX_MARKERS,
) -> None:
    x, y = lane.frequencies, lane.curve(direction)
    settled = lane.of_status(direction, Status.settled)
    line_x, line_y = x, y
    if direction in lane.jumps:  # the line is broken at the jump
        at = lane.jumps[direction][1] + 1
        line_x, line_y = np.insert(x, at, x[at]), np.insert(y, at, np.nan)
    axes.plot(line_x, line_y, color=color, linestyle=STYLES[direction], linewidth=1.8)
    every = max(1, -(-len(x) // most_markers))
    shown = np.zeros(len(x), bool)
    shown[stagger * every // 2 :: every] = True
    marks = {"marker": MARKERS[direction], "linestyle": "none", "color": color}
    axes.plot(x[shown & settled], y[shown & settled], markersize=6.5, **marks)
    lost = lane.of_status(direction, Status.aperiodic)
    axes.plot(x[lost], y[lost], markersize=8, markerfacecolor="white", markeredgewidth=1.4, **marks)
    gone = lane.of_status(direction, Status.diverged)
    gone |= lane.of_status(direction, Status.unbounded)
    if gone.any():
        at_bottom = axes.get_xaxis_transform()
        marks["marker"] = "x"
        axes.plot(x[gone], np.full(gone.sum(), 0.02), transform=at_bottom, markersize=8, **marks)


def _draw_jump(axes: Axes, lane: _Lane, direction: str, color: Any) -> None:
    """Draw a jump as a dashed arrow from branch to branch, behind the curves."""
    where, at, _ = lane.jumps[direction]
    x, y = lane.frequencies[[at, at + 1]], lane.curve(direction)[[at, at + 1]]
    path = [x[0], where, where, x[1]], [y[0], y[0], y[1], y[1]]
    axes.plot(*path, color=color, linestyle=(0, (3, 2)), linewidth=1.3, zorder=1.8)
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


def _label_jumps(axes: Axes, jumps: list[tuple[float, str, Any]]) -> None:
    """Write the jumps, (where, text, colour), along the top, on the sides away from each other."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.1 * (high - low))
    left, right = axes.get_xlim()
    sides = []
    for where, text, color in sorted(jumps, key=lambda jump: jump[0]):
        place = (where - left) / (right - left)
        lower_of_two = not sides and len(jumps) > 1
        to_left = place > 0.78 or (lower_of_two and place > 0.22)
        row = sides.count(to_left)  # pushed by an edge to the side of the other: a row lower
        sides.append(to_left)
        axes.axvline(where, color=color, linestyle=":", linewidth=1.0, alpha=0.7, zorder=1.5)
        axes.annotate(
            text,
            xy=(where, 0.98 - 0.06 * row),
            xycoords=axes.get_xaxis_transform(),
            xytext=(-7 if to_left else 7, 0),
            textcoords="offset points",
            ha="right" if to_left else "left",
            va="top",
            fontsize=LABEL - 1,
            color=color,
        )


def _single(
    axes: Axes,
    response: FrequencyResponse,
    variable: str,
    directions: tuple[str, ...],
    index: tuple[Any, ...],
) -> None:
    lane = _Lane(response, variable, index)
    unit = " Hz" if response.axis == "frequency" else ""
    written = []
    for stagger, direction in enumerate(directions):
        color = COLORS[direction]
        _draw_curve(axes, lane, direction, color, stagger)
        if direction in lane.jumps:
            _draw_jump(axes, lane, direction, color)
            where, _, name = lane.jumps[direction]
            written.append((where, f"{name} {where:.5g}{unit}", color))
    _from_zero(axes, variable)
    _label_jumps(axes, written)
    _legend(axes, lane.directions, [lane], directions, COLORS)
    if response.axis == "frequency_ratio":
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
    response: FrequencyResponse,
    variable: str,
    directions: tuple[str, ...],
    index: tuple[Any, ...],
    name: str,
) -> None:
    scale = axis_scale(response.axes, name)
    values = scale.places
    place = list(response.axes).index(name)
    many = len(values) > MAX_LINES
    colors = matplotlib.colormaps["viridis"]
    if many:
        spread = values.max() / values.min() if values.min() > 0 else 1.0
        norm = (LogNorm if spread > 30 else Normalize)(values.min(), values.max())
        shades = [colors(norm(v)) for v in values]
        bar = figure.colorbar(ScalarMappable(norm, colors), ax=axes, pad=0.02)
        bar.set_label(scale.number + scale.partners, fontsize=LABEL)
        bar.ax.tick_params(labelsize=SMALL)
    else:
        # The bright yellow end is not legible on white.
        shades = [colors(v) for v in np.linspace(0.0, 0.85, len(values))]
    lanes = []
    for k, shade in enumerate(shades):
        lane = _Lane(response, variable, (*index[:place], k, *index[place + 1 :]))
        lanes.append(lane)
        for stagger, direction in enumerate(directions):
            _draw_curve(axes, lane, direction, shade, stagger, MAX_MARKERS // 2)
            if direction in lane.jumps:
                _draw_jump(axes, lane, direction, shade)
    lines = [] if many else [Line2D([], [], color=shade, linewidth=3) for shade in shades]
    labels = [] if many else scale.labels
    _from_zero(axes, variable)
    grey = dict.fromkeys(directions, GREY)
    _legend(axes, response.directions, lanes, directions, grey, (lines, labels))


def _legend(
    axes: Axes,
    swept: tuple[str, ...],
    lanes: list[_Lane],
    directions: tuple[str, ...],
    colors: dict[str, str],
    first: tuple[list[Line2D], list[str]] = ([], []),
) -> None:
    lines, labels = list(first[0]), list(first[1])

    def add(label: str, **style: Any) -> None:
        lines.append(Line2D([], [], **style))
        labels.append(label)

    for d in directions:
        style = {"color": colors[d], "linestyle": STYLES[d], "linewidth": 1.8}
        add(WORDS[d], marker=MARKERS[d], markersize=7, **style)

    def count(status: Status) -> int:
        rows = [swept.index(d) for d in directions]
        return sum(int((lane.status[rows] == status.value).sum()) for lane in lanes)

    def counted(status: Status) -> str:
        return f"{count(status)} point{'s' if count(status) > 1 else ''}"

    if len(lanes) > 1 and any(d in lane.jumps for lane in lanes for d in directions):
        add("jump", color=GREY, linestyle=(0, (3, 2)), linewidth=1.3)
    marks = {"color": GREY, "linestyle": "none", "markersize": 8}
    if count(Status.aperiodic):
        hollow = {"markerfacecolor": "white", "markeredgewidth": 1.4}
        add(f"no period found ({counted(Status.aperiodic)})", marker=">", **hollow, **marks)
    if count(Status.diverged):
        add(f"diverged ({counted(Status.diverged)})", marker="x", **marks)
    if count(Status.unbounded):
        add(f"unbounded ({counted(Status.unbounded)})", marker="x", **marks)
    outside_legend(axes, lines, labels)


def outside_legend(axes: Axes, lines: Sequence[Artist], labels: list[str]) -> None:
    """Put the legend below the axes, where it covers nothing."""
    columns = next(n for n in range(len(labels), 0, -1) if n == 1 or _width(labels, n) < 0.95)
    axes.figure.legend(
        lines,
        labels,
        loc="outside lower center",
        ncols=columns,
        fontsize=SMALL,
        frameon=False,
        handlelength=3.4,
    )


def _width(labels: list[str], columns: int) -> float:
    """Return the width of a legend with so many columns over that of the picture, about."""
    lengths = np.array_split([len(label) for label in labels], columns)
    return sum(0.085 * max(column) + 0.95 for column in lengths) / SIZE[0]


def plot_modes(modes: Modes) -> Figure:
    """Draw the mode shapes, each scaled to a largest displacement of 1, with their frequencies.

    Raises `ValueError` for a batch of modes: pick one beam.
    """
    if modes.beta.ndim != 1:
        raise ValueError(
            f"Modes of a batch of beams, {modes.beta.shape[:-1]}, cannot be drawn: pick one, such "
            "as jax.tree.map(lambda a: a[0], modes)."
        )
    figure, axes = new_picture()
    places = np.linspace(0.0, 1.0, 401)
    shapes = np.asarray(modes.shape(places))
    colors = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, modes.num_modes))
    for i, frequency in enumerate(np.asarray(modes.frequency)):
        if not np.isfinite(shapes[:, i]).all():
            continue
        axes.plot(
            places,
            shapes[:, i] / np.abs(shapes[:, i]).max(),
            color=colors[i],
            linestyle=LINE_STYLES[i % len(LINE_STYLES)],
            linewidth=2,
            label=f"mode {i + 1}: {frequency:.5g} Hz",
        )
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("Place along the beam x/length (0 root, 1 tip)", fontsize=LABEL)
    axes.set_ylabel("Mode shape, largest displacement 1", fontsize=LABEL)
    lines, labels = axes.get_legend_handles_labels()
    outside_legend(axes, lines, labels)
    return figure
