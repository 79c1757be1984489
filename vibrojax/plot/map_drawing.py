"""What is drawn in one panel of a map: cells, jumps, and the edges between kinds of motion."""

from typing import Any, NamedTuple

import matplotlib
import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, LogNorm, Normalize
from matplotlib.patheffects import Normal, Stroke, withStroke
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from vibrojax.plot.map_axes import FREQUENCIES, MapAxis
from vibrojax.plot.style import COLORS, HOLLOW, SMALL, color_bar
from vibrojax.results.status import LOST

REGIME = "_regime"
"""Name under which the kind of motion of every cell is kept in the view."""
APERIODIC, GONE, UNSTABLE = -1, -2, -3  # instead of a period
LANES = {"settled": 0, "aperiodic": 1, "lost": 2, "failed": 3, "missing": 4}
MARKS = {"aperiodic": "o", "lost": "X", "failed": "s"}
BLANK: dict[str, Any] = {"edgecolor": COLORS["middle"], "hatch": "////"}
MOST_VALUES = 10
"""Whole numbers that get a colour each; more get a continuous scale."""
ROOM = 0.06
"""Share of the height and of the width that an area has where a letter goes."""
LEAST_APART = 0.07
"""Share of an axis between values above which each has its tick."""
CLIPPED = 98
"""Percentile at which the colours of a gradient end: gradients are huge beside a jump."""
JUMPS: dict[str, dict[str, Any]] = {
    "jump_up": {"color": COLORS["black"], "linestyle": (0, (4, 1.5)), "marker": "^"},
    "jump_down": {"color": COLORS["orange"], "linestyle": (0, (1.2, 1.2)), "marker": "v"},
}


class Shades(NamedTuple):
    """How values become colours, and what the colour bar says."""

    drawn: ScalarMappable
    ticks: list[float] | None = None
    names: list[str] | None = None
    extend: str = "neither"

    def bar(self, panels: list[Axes], label: str) -> None:
        """Add the colour bar that panels share."""
        bar = color_bar(panels, self.drawn, label, extend=self.extend)
        if self.ticks is not None:
            bar.set_ticks(self.ticks, labels=self.names)
            bar.ax.minorticks_off()


class Words(NamedTuple):
    """What the legend says of blank cells, of the edges, and of the letters between them."""

    blank: str
    on_curves: bool = False
    edges: str = ""
    letters: dict[int, str] = {}  # noqa: RUF012


def cells(panel: xarray.Dataset, name: str, *axes: MapAxis) -> np.ndarray:
    """Return a variable as floats over the given axes, outermost first."""
    return panel[name].transpose(*(axis.dimension for axis in axes)).values.astype(float)


def flags_of(array: xarray.DataArray) -> dict[str, int]:
    """Return the numbers of the flags of a variable by their names; empty where it has none."""
    names = str(array.attrs.get("flag_meanings", "")).split()
    numbers = np.atleast_1d(array.attrs.get("flag_values", [])).tolist()
    if len(names) == len(numbers) and names:
        return dict(zip(names, numbers, strict=True))
    return LANES if array.name in ("status", "lane_status") else {}


def shades_of(view: xarray.Dataset, variable: str) -> Shades:
    """Choose the colours: one each for flags and few whole numbers, else a scale.

    Gradients of both signs are centred at zero, and end where few values are larger.
    """
    values = view[variable].values.astype(float)
    values = values[np.isfinite(values)]
    colors = matplotlib.colormaps["viridis"]
    flags = flags_of(view[variable])
    whole = np.unique(values).tolist()
    few = 0 < len(whole) <= MOST_VALUES and all(value == round(value) for value in whole)
    if flags or few:
        whole = [v for v in whole if not flags or v in flags.values()] or [0]
        names = {v: k for k, v in flags.items()}
        edges = np.r_[np.array(whole) - 0.5, whole[-1] + 0.5]
        colors = colors.resampled(max(2, len(whole)))
        drawn = ScalarMappable(BoundaryNorm(edges, len(whole)), colors)
        middles = ((edges[1:] + edges[:-1]) / 2).tolist()
        return Shades(drawn, middles, [names.get(v, f"{v:g}") for v in whole])
    if not len(values):
        return Shades(ScalarMappable(Normalize(0.0, 1.0), colors))
    low, high = float(values.min()), float(values.max())
    if low < 0 < high and variable.startswith("d_"):
        limit = float(np.percentile(np.abs(values), CLIPPED)) or high
        extend = "both" if max(-low, high) > limit else "neither"
        return Shades(ScalarMappable(Normalize(-limit, limit), "PuOr_r"), extend=extend)
    norm = LogNorm if low > 0 and high > 300 * low else Normalize
    if low == high:
        low, high = low - (abs(low) or 1.0) / 100, high + (abs(high) or 1.0) / 100
    return Shades(ScalarMappable(norm(low, high), colors))


def scale_axes(axes: Axes, x: MapAxis, y: MapAxis | None = None) -> None:
    """Put ticks, names and scales on the axes."""
    for side, axis, drawn in (("x", x, axes.xaxis), ("y", y, axes.yaxis)):
        if axis is None:
            continue
        if axis.names is not None:
            drawn.set_ticks(axis.places.tolist(), labels=axis.names)
        elif axis.logarithmic:
            axes.set(**{f"{side}scale": "log"})
        else:
            formatter = ScalarFormatter(useMathText=True)
            formatter.set_powerlimits((-3, 4))
            drawn.set_major_formatter(formatter)
            apart = np.diff(axis.places, append=np.inf).min() / np.ptp(axis.edges)
            short = np.allclose(axis.places, [float(f"{v:.3g}") for v in axis.places], rtol=1e-9)
            if short and apart > (LEAST_APART if side == "y" else 2 * LEAST_APART):
                drawn.set_ticks(axis.places.tolist())
            else:
                drawn.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        drawn.get_offset_text().set_fontsize(SMALL)


def with_regimes(view: xarray.Dataset, variable: str) -> tuple[xarray.Dataset, Words]:
    """Add the kind of motion of every cell, and return what is said of it.

    Where the variable lies on the curves that is the period and the status, for a measure whether
    there is a jump.
    """
    array, blank = view[variable], _blank(view, variable)
    alike = [n for n, v in view.data_vars.items() if set(v.dims) == set(array.dims)]
    jumps = [n for n in JUMPS if n in alike]
    on_curves = {"period", "status"} <= {*view.data_vars} and "status" in alike
    if on_curves:
        status, regime = view["status"], view["period"].astype(float)
        regime = regime.where(status != LANES["aperiodic"], APERIODIC)
        regime = regime.where(~status.isin(LOST), GONE)
        if "stable" in alike:
            regime = regime.where(view["stable"] != 0, UNSTABLE)
        regime = regime.where(array.notnull())
    elif jumps:
        # Jumps have no value where there is none.
        known = array.notnull() if variable not in JUMPS else xarray.ones_like(array, bool)
        if "lane_status" in view:
            known = known & (view["lane_status"] < LANES["failed"])
        regime = view[jumps].notnull().to_array().any("variable").astype(float).where(known)
    else:
        return view, Words(blank)
    view = view.assign({REGIME: regime})
    there = np.unique(regime.values[np.isfinite(regime.values)]).astype(int).tolist()
    if len(there) < 2:
        return view, Words(blank, on_curves)
    if not on_curves:
        return view, Words(blank, False, "edge of hysteresis (H: jumps)", {1: "H"})
    letters = {n: f"P{n}" if n > 0 else "U" for n in there if n > 0 or n == UNSTABLE}
    said = "Pn: period n" + ", U: unstable" * (UNSTABLE in there)
    return view, Words(blank, True, f"change of motion ({said})", letters)


def _blank(view: xarray.Dataset, variable: str) -> str:
    """Return why cells have no value, as far as the lanes say."""
    none = view[variable].isnull()
    is_jump = variable in JUMPS
    reasons = []
    if "lane_status" in view:
        lane = view["lane_status"]
        bad = lane.where(none.any([d for d in none.dims if d not in lane.dims])).values
        for name, number in flags_of(lane).items():
            count = int((bad == number).sum())
            if count and number >= LANES["failed" if is_jump else "aperiodic"]:
                reasons.append(f"{name}: {count} lane{'s' * (count > 1)}")
    if not reasons:
        return "no jump" if is_jump else "no value"
    joined = ", ".join(reasons)
    return f"no jump, or {joined}" if is_jump else f"no value ({joined})"


def draw_cells(
    axes: Axes,
    panel: xarray.Dataset,
    variable: str,
    across: tuple[MapAxis, MapAxis],
    shades: Shades,
    words: Words,
) -> None:
    """Draw one panel over two axes."""
    x, y = across
    values = np.ma.masked_invalid(cells(panel, variable, y, x))
    blank = np.ma.getmaskarray(values)
    axes.set_facecolor(COLORS["light"])
    axes.patch.set(**BLANK)
    style: dict[str, Any] = {"norm": shades.drawn.norm, "cmap": shades.drawn.cmap}
    axes.pcolormesh(x.edges, y.edges, values, rasterized=True, **style)
    taken = np.zeros(values.shape, bool)
    if {x.dimension, y.dimension} & set(FREQUENCIES):
        taken = _draw_jumps(axes, panel, across)
    if blank.any():
        axes.fill_between([], [], facecolor=COLORS["light"], label=words.blank, **BLANK)
    if REGIME in panel:
        regime = cells(panel, REGIME, y, x)
        _draw_edges(axes, regime, taken, across, words)
        marked = (("aperiodic", APERIODIC), ("lost", GONE))
        for name, number in marked if variable != "status" else ():
            _mark(axes, regime == number, name, name, across)
    shown = words.on_curves or variable == "lane_status"
    has_status = "lane_status" in panel and {*panel.lane_status.dims} == {*panel[variable].dims}
    if has_status and not shown:
        lanes = np.where(blank, 0, cells(panel, "lane_status", y, x))
        flags = flags_of(panel["lane_status"])
        for name in MARKS:
            label = name if name == "failed" else f"some points {name}"
            _mark(axes, lanes == flags.get(name, -1), name, label, across)
    axes.set(xlim=x.edges[[0, -1]], ylim=y.edges[[0, -1]])
    scale_axes(axes, x, y)


def _draw_jumps(axes: Axes, panel: xarray.Dataset, across: tuple[MapAxis, MapAxis]) -> np.ndarray:
    """Draw the jumps as lines, and return which cells are beside one."""
    x, y = across
    upright = x.dimension in FREQUENCIES
    frequency, other = (x, y) if upright else (y, x)
    taken = np.zeros((len(other.places), len(frequency.places)), bool)
    for name, style in JUMPS.items():
        if name not in panel or panel[name].dims != (other.dimension,):
            continue
        where = cells(panel, name, other)
        if not np.isfinite(where).any():
            continue
        taken |= np.abs(frequency.places - where[:, None]) < ROOM * np.ptp(frequency.places)
        places = (where, other.places) if upright else (other.places, where)
        drawn: dict[str, Any] = style | {"linewidth": 2.2, "markersize": 8, "zorder": 4}
        drawn |= {"markeredgecolor": "white", "markeredgewidth": 1.0}
        if other.names is None:
            axes.plot(*places, color="white", linewidth=4.4, zorder=3.9)
        else:
            drawn["linestyle"] = "none"
        # A point without neighbours is no line: it needs its marker.
        apart = np.isnan(np.r_[np.nan, where[:-1]]) & np.isnan(np.r_[where[1:], np.nan])
        shown = apart | (np.arange(len(where)) % max(1, len(where) // 12) == 0)
        drawn |= {"gid": name, "markevery": np.flatnonzero(shown).tolist()}
        axes.plot(*places, label=name.replace("_", " "), **drawn)
    return taken if upright else taken.T


def _draw_edges(
    axes: Axes,
    regime: np.ndarray,
    taken: np.ndarray,
    across: tuple[MapAxis, MapAxis],
    words: Words,
) -> None:
    """Draw the borders between cells of different kinds, and letters where no cell is taken."""
    x, y = across[0].edges, across[1].edges
    segments = []
    known = np.isfinite(regime)
    for i, j in np.argwhere((regime[:, 1:] != regime[:, :-1]) & known[:, 1:] & known[:, :-1]):
        segments.append([(x[j + 1], y[i]), (x[j + 1], y[i + 1])])
    for i, j in np.argwhere((regime[1:] != regime[:-1]) & known[1:] & known[:-1]):
        segments.append([(x[j], y[i + 1]), (x[j + 1], y[i + 1])])
    casing = [Stroke(linewidth=2.6, foreground="white"), Normal()]
    style: dict[str, Any] = {"color": "black", "linewidth": 1.1, "path_effects": casing}
    if segments:
        axes.add_collection(LineCollection(segments, zorder=3, **style), autolim=False)
        axes.plot([], [], label=words.edges, **style)
    text: dict[str, Any] = {"fontsize": SMALL, "fontweight": "bold", "ha": "center"}
    text |= {"path_effects": [withStroke(linewidth=3, foreground="white")], "zorder": 3.5}
    for number, letter in words.letters.items():
        for i, j in _middles((regime == number) & ~taken):
            axes.text(across[0].places[j], across[1].places[i], letter, va="center", **text)


def _middles(inside: np.ndarray) -> list[tuple[int, int]]:
    """Return the most inner cell of the two largest areas, where they are large enough."""
    from scipy import ndimage

    areas: Any
    areas, count = ndimage.label(inside)  # pyright: ignore[reportGeneralTypeIssues]
    sizes = np.bincount(areas.ravel(), minlength=count + 1)[1:]
    middles = []
    for area in np.argsort(sizes)[::-1][:2]:
        there = areas == area + 1
        depth: Any = ndimage.distance_transform_edt(np.pad(there, 1))
        inner = np.argwhere(there & (depth[1:-1, 1:-1] == depth.max()))
        place = inner[np.argmin(np.abs(inner - np.argwhere(there).mean(axis=0)).sum(axis=1))]
        share = np.array([there[:, place[1]].mean(), there[place[0]].mean()])
        if (share >= ROOM).all():
            middles.append((int(place[0]), int(place[1])))
    return middles


def _mark(
    axes: Axes, where: np.ndarray, name: str, label: str, across: tuple[MapAxis, MapAxis]
) -> None:
    """Put a mark on cells that did not settle."""
    rows, columns = np.nonzero(where)
    if len(rows):
        size = float(np.clip(120 / max(where.shape), 1.5, 8.0))
        style: dict[str, Any] = HOLLOW | {"marker": MARKS[name], "color": "black", "zorder": 3.2}
        style |= {"markeredgewidth": min(1.0, size / 3), "markersize": size, "label": label}
        axes.plot(across[0].places[columns], across[1].places[rows], **style)
