"""The style of all pictures, drawn without a display and without pyplot.

A legend has what was drawn with a `label`, once each; an empty line adds an entry of its own.
"""

import io
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from vibrojax.results.axes import AxisScale
from vibrojax.results.variables import axis_description, named_value, with_unit

SIZE, DPI = (10.0, 6.4), 150  # inches and dots per inch: 1500 pixels wide
FRAME = 1.2
"""Height of what is around the panels of a picture, inches."""
LABEL, SMALL = 13, 11  # points
COLORS = {
    "blue": "#0060a8",
    "amber": "#e69f00",
    "green": "#009e73",
    "pink": "#cc79a7",
    "sky": "#56b4e9",
    "orange": "#d1590a",
    "yellow": "#f0e442",
    "red": "#b3123c",
    "violet": "#8a2be2",
    "black": "#000000",
    "dark": "#4d4d4d",
    "grey": "#555555",
    "middle": "#8a8a8a",
    "pale": "#b3b3b3",
    "light": "#d9d9d9",
    "forward": "#0060a8",
    "backward": "#d1590a",
}
"""Colours that the colour-blind can distinguish. Source: Okabe and Ito 2008, two of them darker."""
GREY = COLORS["grey"]
SERIES = tuple(
    COLORS[n] for n in ("blue", "amber", "green", "pink", "sky", "orange", "yellow", "pale")
)
"""Of things that have no order."""
SYMBOLS = ("o", "^", "s", "D")
MARKERS = {"forward": ">", "backward": "<"}
STYLES = {"forward": "-", "backward": (0, (5, 1.6))}
WORDS = {"forward": "forward sweep", "backward": "backward sweep"}
ARROWS = {"forward": "forward sweep \u2192", "backward": "\u2190 backward sweep"}
LINE_STYLES = ("-", (0, (6, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
DASHES = (0, (4, 2))
"""Of what is unstable."""
HOLLOW: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "white"}
MAX_LINES = 8
"""Lines that a legend names one by one; more get a colour bar."""
MARKER = 7.0
"""Least size of a marker in a legend, points."""


class Picture(Figure):
    """A matplotlib figure that also shows itself as the last line of a notebook cell."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        stream = io.BytesIO()
        self.savefig(stream, format="png")
        return stream.getvalue(), {"width": int(self.get_figwidth() * DPI / 2)}


def empty_picture(size: tuple[float, float] = SIZE) -> Picture:
    """Make a picture without axes; its size is in inches."""
    margins = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)
    return Picture(figsize=size, dpi=DPI, layout=margins)


def new_picture() -> tuple[Picture, Axes]:
    """Make an empty picture of one panel."""
    figure, (axes,) = new_panels([SIZE[1] - FRAME])
    return figure, axes


def new_panels(heights: Sequence[float]) -> tuple[Picture, list[Axes]]:
    """Make an empty picture of panels over each other, with heights in inches, over one axis."""
    figure = empty_picture((SIZE[0], sum(heights) + FRAME))
    found = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    panels = list(found[:, 0])
    for axes in panels:
        dress(axes)
    figure.align_ylabels(panels)
    return figure, panels


def dress(axes: Axes) -> None:
    """Give axes the grid, the letters and the frame of all pictures."""
    axes.grid(True, color=COLORS["light"], linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def name_axes(
    axes: Axes, x: str | None = None, y: str | None = None, title: str | None = None
) -> None:
    """Write the names of the axes, and a title above them."""
    if x is not None:
        axes.set_xlabel(x, fontsize=LABEL)
    if y is not None:
        axes.set_ylabel(y, fontsize=LABEL)
    if title:
        axes.set_title(title, fontsize=LABEL, loc="left")


def finish(axes: Axes, x: str, y: str, title: str = "") -> Figure:
    """Write the names of the axes, the title and the legend, and return the picture."""
    name_axes(axes, x, balanced(y, 55), title)
    figure = axes.figure
    assert isinstance(figure, Figure)
    return outside_legend(figure)


def label_for(array: xarray.DataArray) -> str:
    """Return the long name of a variable or coordinate with its unit."""
    attributes = axis_description(str(array.name)) | array.attrs
    return with_unit(attributes["long_name"], attributes["units"])


def fixed_names(view: xarray.Dataset) -> tuple[str, ...]:
    """Return the names of the coordinates of which a dataset has one value."""
    return tuple(str(name) for name, c in view.coords.items() if not c.ndim)


def chosen_in(view: xarray.Dataset, *without: str) -> str:
    """Return the coordinates of which a dataset has one value, `gap = 0.0004 m`, for a title."""
    texts = []
    names = [name for name in fixed_names(view) if name not in without]
    for name in sorted(names, key="direction".__eq__):  # the direction last
        value, units = view[name].item(), view[name].attrs.get("units")
        text = named_value(name, value, units)
        texts.append(ARROWS.get(value, text) if name == "direction" else text)
    return ", ".join(texts)


def balanced(label: str, most: int = 34) -> str:
    """Return a label in lines of about the same length."""
    rows = -(-len(label) // most)
    return label if rows < 2 else textwrap.fill(label, len(label) // rows + 6)


def within(label: str, length: float) -> str:
    """Return a label in lines that fit into some length (inches)."""
    together = label.replace(" = ", "\xa0=\xa0")
    wrapped = textwrap.fill(together, int(8 * length))  # letters to an inch
    return wrapped.replace("\xa0", " ")


def show_zero(axes: Axes) -> None:
    """Let the upright axis go to zero at the least, with room above what may hardly vary."""
    low, high = axes.get_ylim()
    axes.set_ylim(min(0.0, low), max(high, 1.05 * axes.dataLim.y1, 0.0))


def mark_places(panels: Sequence[Axes], places: Sequence[tuple[float, str, str]]) -> None:
    """Mark places (x, words, colour) by lines, the words along the top away from each other."""
    axes = panels[0]
    left, right = axes.get_xlim()
    shown = sorted(place for place in places if left <= place[0] <= right)
    low, high = axes.get_ylim()
    rows = (len(shown) + 1) // 2
    axes.set_ylim(low, high + (0.05 + 0.08 * rows) * (high - low) if shown else high)
    sides: list[bool] = []
    for k, (where, words, color) in enumerate(shown):
        for panel in panels:
            panel.axvline(where, color=color, linestyle=":", linewidth=1.0, alpha=0.7, zorder=1.5)
        place = (where - left) / (right - left)
        to_left = place > 0.78 or (2 * k + 1 < len(shown) and place > 0.22)
        row = sides.count(to_left)  # pushed by an edge to the side of the other: a row lower
        sides.append(to_left)
        axes.annotate(
            words,
            xy=(where, 0.985 - 0.065 * row),
            xycoords=axes.get_xaxis_transform(),
            xytext=(-7 if to_left else 7, 0),
            textcoords="offset points",
            ha="right" if to_left else "left",
            va="top",
            fontsize=SMALL,
            color=color,
            zorder=6,
        )


def shades(count: int) -> Any:
    """Return colours in an order; the bright yellow end is not legible on white."""
    return matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, count))


def line_styles(count: int) -> list[dict[str, Any]]:
    """Return a colour and a dash pattern for each of several lines in an order."""
    dashes = (LINE_STYLES[k % len(LINE_STYLES)] for k in range(count))
    return [{"color": c, "linestyle": d} for c, d in zip(shades(count), dashes, strict=True)]


def family_colors(axes: Axes, scale: AxisScale, **entry: Any) -> Any:
    """Return a colour for every value of an axis, explained by the legend or by a colour bar.

    `entry` is the style of the lines in the legend.
    """
    values = scale.places
    if len(values) <= MAX_LINES:
        colors = shades(len(values))
        for color, label in zip(colors, scale.labels, strict=True):
            axes.plot([], [], color=color, label=label, **entry)
        return colors
    logarithmic = values.min() > 0 and values.max() > 30 * values.min()
    norm = (LogNorm if logarithmic else Normalize)(values.min(), values.max())
    mappable = ScalarMappable(norm, matplotlib.colormaps["viridis"])
    color_bar([axes], mappable, scale.label)
    return mappable.to_rgba(values)


def color_bar(panels: Sequence[Axes], drawn: ScalarMappable, label: str, **settings: Any) -> Any:
    """Add the colour bar that some panels share, and return it."""
    bar = panels[0].figure.colorbar(drawn, ax=list(panels), pad=0.02, **settings)
    bar.set_label(label, fontsize=LABEL)
    bar.ax.tick_params(labelsize=SMALL)
    return bar


def draw_stable(
    axes: Axes,
    x: np.ndarray,
    y: np.ndarray,
    stable: np.ndarray,
    joined: np.ndarray | None = None,
    words: tuple[str, str] = ("stable", "unstable"),
    entry: str = GREY,
    **style: Any,
) -> None:
    """Draw a curve, stable solid and unstable dashed.

    What follows a point is as it is; `joined` says where something follows. `words` are what the
    legend says of the two, with lines of the colour `entry`.
    """
    kind = np.asarray(stable, bool).astype(int)[:-1]
    if joined is not None:
        kind = np.where(np.asarray(joined, bool)[:-1], kind, -1)
    edges = np.flatnonzero(np.diff(kind)) + 1
    for start, stop in zip(np.r_[0, edges], np.r_[edges, len(kind)], strict=True):
        if start == stop or kind[start] < 0:
            continue
        part = slice(start, stop + 1)
        axes.plot(x[part], y[part], linestyle="-" if kind[start] else DASHES, **style)
    for known, word, dashes in zip((1, 0), words, ("-", DASHES), strict=True):
        if (kind == known).any():
            axes.plot([], [], label=word, **(style | {"linestyle": dashes, "color": entry}))


def outside_legend(figure: Figure, *, above: bool = False) -> Figure:
    """Put the legend below the axes (or above them), where it covers nothing."""
    key: dict[str, Any] = {}
    for axes in figure.axes:
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True):
            key.setdefault(label, line)
    if not key:
        return figure
    labels = list(key)
    counts = range(len(labels), 0, -1)
    width = figure.get_figwidth()
    columns = next(n for n in counts if n == 1 or _width(labels, n) < 0.95 * width)
    legend = figure.legend(
        list(key.values()),
        labels,
        loc="outside upper center" if above else "outside lower center",
        ncols=columns,
        fontsize=SMALL,
        frameon=False,
        handlelength=3.4,
    )
    for line in legend.legend_handles:
        if isinstance(line, Line2D):
            line.set(markersize=max(MARKER, line.get_markersize()), alpha=1.0)
    return figure


def _width(labels: list[str], columns: int) -> float:
    """Return the width of a legend with so many columns, inches, about."""
    lengths = np.array_split([len(label) for label in labels], columns)
    return sum(0.085 * max(column) + 0.95 for column in lengths)


def edges_of(middles: np.ndarray) -> np.ndarray:
    """Return the ends of the cells of a map, half way between neighbours."""
    if len(middles) == 1:
        half = 0.01 * abs(middles[0]) or 0.5
        return middles[0] + np.array([-half, half])
    inner = (middles[1:] + middles[:-1]) / 2
    return np.r_[2 * middles[0] - inner[0], inner, 2 * middles[-1] - inner[-1]]
