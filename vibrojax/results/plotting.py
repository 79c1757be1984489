"""Pictures of results, drawn without a display and without pyplot."""

import io
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax._checks import nearest
from vibrojax.modes import Modes
from vibrojax.results.frequency_response import CURVES, FrequencyResponse
from vibrojax.results.status import Status
from vibrojax.results.variables import VARIABLES

SIZE, DPI = (10.0, 6.0), 150  # inches and dots per inch: 1500 pixels wide
LABEL, SMALL = 13, 11  # points
FORWARD, BACKWARD = "#0060a8", "#d1590a"
GREY = "#555555"
MARKERS = {"forward": ">", "backward": "<"}
STYLES = {"forward": "-", "backward": (0, (5, 1.6))}
WORDS = {"forward": "forward (frequency rising)", "backward": "backward (frequency falling)"}
MAX_MARKERS = 28
"""Markers on a line that show its direction; all points of short sweeps have one."""
MAX_LINES = 8
"""Lines that a legend names one by one; more get a colour bar."""
LINE_STYLES = ("-", (0, (6, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))


class Picture(Figure):
    """A matplotlib figure that also shows itself as the last line of a notebook cell."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        stream = io.BytesIO()
        self.savefig(stream, format="png")
        return stream.getvalue(), {"width": int(self.get_figwidth() * DPI / 2)}


def _picture() -> tuple[Picture, Axes]:
    figure = Picture(figsize=SIZE, dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    axes.grid(True, color="#d9d9d9", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure, axes


def _label(name: str, ratio_units: str = "1") -> str:
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
    if variable not in CURVES:
        raise ValueError(f"Unknown variable {variable!r}. {nearest(variable, CURVES)}")
    directions = _directions(response, selection)
    index, chosen, left = _select(response, selection)
    if len(left) > 1:
        raise ValueError(
            f"{len(left)} axes are left, {' and '.join(left)}: give a value of all but one, such "
            f"as plot({left[0]}={float(response.axes[left[0]][0]):g})."
        )
    figure, axes = _picture()
    if left:
        _family(figure, axes, response, variable, directions, index, left[0])
    else:
        _single(axes, response, variable, directions, index)
    axes.set_xlabel(_label(response.axis), fontsize=LABEL)
    axes.set_ylabel(_label(variable, response.ratio_units), fontsize=LABEL)
    if chosen:
        title = ", ".join(f"{name} = {value:g}" for name, value in chosen.items())
        axes.set_title(title, fontsize=LABEL, loc="left")
    if variable == "status":
        axes.set_yticks([s.value for s in Status], [s.name for s in Status])
    elif variable not in ("period", "jump_up"):
        low, high = axes.get_ylim()
        axes.set_ylim(min(0.0, low) if low > -0.1 * high else low, high)
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


def _select(
    response: FrequencyResponse, selection: dict[str, Any]
) -> tuple[tuple[Any, ...], dict[str, float], list[str]]:
    """Return the index into the axes, the values chosen, and the names of the axes left."""
    for name, value in selection.items():
        if name not in response.axes:
            known = [*response.axes, "direction"]
            raise ValueError(f"Unknown axis {name!r}. {nearest(name, known)}")
        if np.ndim(value) or not isinstance(value, int | float | np.generic | np.ndarray):
            raise ValueError(f"{name} must be one number, got {value!r}.")
        if not np.isfinite(value):
            raise ValueError(f"{name} must be finite, got {value!r}.")
    index, chosen = [], {}
    for name, values in response.axes.items():
        if name in selection:
            at = int(np.argmin(np.abs(values - selection[name])))
            index.append(at)
            chosen[name] = float(values[at])
        else:
            index.append(slice(None))
    return tuple(index), chosen, [name for name in response.axes if name not in selection]


class _Lane:
    """What is drawn of one system."""

    def __init__(self, response: FrequencyResponse, variable: str, index: tuple[Any, ...]):
        self.frequencies = np.asarray(response.frequencies)
        self.directions = response.directions
        self.curves = np.asarray(getattr(response, variable))[index].astype(float)
        self.status = np.asarray(response.status)[index]
        amplitude = np.asarray(response.amplitude_ratio)[index]
        self.natural_frequency = float(np.asarray(response.natural_frequency)[index])
        self.jumps: dict[str, tuple[float, int]] = {}  # direction: where, after which point
        for jump in (response.jump_up, response.jump_down):
            where = float(np.asarray(jump)[index])
            if np.isfinite(where) and len(self.frequencies) > 1:
                n = len(self.frequencies)
                at = int(np.clip(np.searchsorted(self.frequencies, where) - 1, 0, n - 2))
                change = np.abs(amplitude[:, at + 1] - amplitude[:, at])
                taker = self.directions[int(np.nanargmax(np.nan_to_num(change, nan=-1.0)))]
                self.jumps[taker] = (where, at)

    def curve(self, direction: str) -> np.ndarray:
        return self.curves[self.directions.index(direction)]

    def of_status(self, direction: str, status: Status) -> np.ndarray:
        return self.status[self.directions.index(direction)] == status.value


def _draw_curve(axes: Axes, lane: _Lane, direction: str, color: Any, stagger: int) -> None:
    x, y = lane.frequencies, lane.curve(direction)
    settled = lane.of_status(direction, Status.settled)
    line_x, line_y = x, y
    if direction in lane.jumps:  # the line is broken at the jump
        at = lane.jumps[direction][1] + 1
        line_x, line_y = np.insert(x, at, x[at]), np.insert(y, at, np.nan)
    axes.plot(line_x, line_y, color=color, linestyle=STYLES[direction], linewidth=1.8)
    every = max(1, -(-len(x) // MAX_MARKERS))
    shown = np.zeros(len(x), bool)
    shown[stagger * every // 2 :: every] = True
    marks = {"marker": MARKERS[direction], "linestyle": "none", "color": color}
    axes.plot(x[shown & settled], y[shown & settled], markersize=6.5, **marks)
    lost = lane.of_status(direction, Status.aperiodic)
    axes.plot(x[lost], y[lost], markersize=8, markerfacecolor="white", markeredgewidth=1.4, **marks)
    gone = lane.of_status(direction, Status.diverged)
    if gone.any():
        at_bottom = axes.get_xaxis_transform()
        marks["marker"] = "x"
        axes.plot(x[gone], np.full(gone.sum(), 0.02), transform=at_bottom, markersize=8, **marks)


def _draw_jump(axes: Axes, lane: _Lane, direction: str, color: Any) -> tuple[float, float] | None:
    """Draw a jump as a dashed arrow; return where it is and the height of its upper end."""
    if direction not in lane.jumps:
        return None
    where, at = lane.jumps[direction]
    start, end = lane.curve(direction)[[at, at + 1]]
    if direction == "backward":
        start, end = end, start
    if not np.isfinite([start, end]).all():
        return None
    axes.plot([where, where], [start, end], color=color, linestyle=(0, (3, 2)), linewidth=1.3)
    middle = (start + end) / 2
    axes.annotate(
        "",
        xy=(where, middle + 0.04 * (end - start)),
        xytext=(where, middle - 0.04 * (end - start)),
        arrowprops={"arrowstyle": "-|>", "color": color, "mutation_scale": 20, "linewidth": 0},
    )
    return where, max(start, end)


def _single(
    axes: Axes,
    response: FrequencyResponse,
    variable: str,
    directions: tuple[str, ...],
    index: tuple[Any, ...],
) -> None:
    lane = _Lane(response, variable, index)
    colors = {"forward": FORWARD, "backward": BACKWARD}
    for stagger, direction in enumerate(directions):
        color = colors[direction]
        _draw_curve(axes, lane, direction, color, stagger)
        drawn = _draw_jump(axes, lane, direction, color)
        if drawn is None:
            continue
        where = drawn[0]
        start, end = lane.curve(direction)[[lane.jumps[direction][1], lane.jumps[direction][1] + 1]]
        unit = " Hz" if response.axis == "frequency" else ""
        # Beside the arrow, outside the loop that the two jumps enclose.
        right = direction == "forward"
        axes.annotate(
            f"jump at {where:.5g}{unit}",
            xy=(where, (start + end) / 2),
            xytext=(10 if right else -10, 0),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
            fontsize=LABEL - 1,
            color=color,
        )
    _legend(axes, lane.directions, [lane], directions, colors)
    if response.axis == "frequency_ratio":
        unit = lane.natural_frequency
        hertz = axes.secondary_xaxis("top", functions=(lambda r: r * unit, lambda f: f / unit))
        hertz.set_xlabel(_label("frequency"), fontsize=SMALL, color=GREY)
        hertz.tick_params(labelsize=SMALL, colors=GREY)
        hertz.spines["top"].set_color(GREY)


def _family(
    figure: Figure,
    axes: Axes,
    response: FrequencyResponse,
    variable: str,
    directions: tuple[str, ...],
    index: tuple[Any, ...],
    name: str,
) -> None:
    values = np.asarray(response.axes[name], float)
    place = list(response.axes).index(name)
    many = len(values) > MAX_LINES
    colors = matplotlib.colormaps["viridis"]
    if many:
        spread = values.max() / values.min() if values.min() > 0 else 1.0
        norm = (LogNorm if spread > 30 else Normalize)(values.min(), values.max())
        shades = [colors(norm(v)) for v in values]
        bar = figure.colorbar(ScalarMappable(norm, colors), ax=axes, pad=0.02)
        bar.set_label(name, fontsize=LABEL)
        bar.ax.tick_params(labelsize=SMALL)
    else:
        # The bright yellow end is not legible on white.
        shades = [colors(v) for v in np.linspace(0.0, 0.85, len(values))]
    lanes = []
    for k, shade in enumerate(shades):
        lane = _Lane(response, variable, (*index[:place], k, *index[place + 1 :]))
        lanes.append(lane)
        for stagger, direction in enumerate(directions):
            _draw_curve(axes, lane, direction, shade, stagger)
            _draw_jump(axes, lane, direction, shade)
    lines = [] if many else [Line2D([], [], color=shade, linewidth=3) for shade in shades]
    labels = [] if many else [f"{name} = {v:g}" for v in values]
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

    if any(d in lane.jumps for lane in lanes for d in directions):
        add("jump", color=GREY, linestyle=(0, (3, 2)), linewidth=1.3)
    marks = {"color": GREY, "linestyle": "none", "markersize": 8}
    if count(Status.aperiodic):
        hollow = {"markerfacecolor": "white", "markeredgewidth": 1.4}
        add(f"no period found ({count(Status.aperiodic)} points)", marker=">", **hollow, **marks)
    if count(Status.diverged):
        add(f"diverged ({count(Status.diverged)} points)", marker="x", **marks)
    axes.legend(lines, labels, fontsize=SMALL, framealpha=0.9, handlelength=3.2)


def plot_modes(modes: Modes) -> Figure:
    """Draw the mode shapes, each scaled to a largest displacement of 1, with their frequencies.

    Raises `ValueError` for a batch of modes: pick one beam.
    """
    if modes.beta.ndim != 1:
        raise ValueError(
            f"Modes of a batch of beams, {modes.beta.shape[:-1]}, cannot be drawn: pick one, such "
            "as jax.tree.map(lambda a: a[0], modes)."
        )
    figure, axes = _picture()
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
    axes.legend(fontsize=SMALL, framealpha=0.9, handlelength=3.2)
    return figure
