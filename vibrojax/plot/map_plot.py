"""Pictures of maps: one variable over two axes, as many panels as further axes need."""

from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax._tools.checks import check_known
from vibrojax.plot.map_axes import (
    FREQUENCIES,
    RESPONSES,
    MapAxis,
    check_map,
    dimension_of,
    measures_of,
    parameters_of,
    read_axes,
    select,
    units_of,
    variables_of,
)
from vibrojax.plot.map_drawing import (
    JUMPS,
    LANES,
    cells,
    draw_cells,
    scale_axes,
    shades_of,
    with_regimes,
)
from vibrojax.plot.style import (
    COLORS,
    GREY,
    HOLLOW,
    LABEL,
    MARKERS,
    SIZE,
    SMALL,
    STYLES,
    chosen_in,
    empty_picture,
    fixed_names,
    label_for,
    name_axes,
    new_picture,
    outside_legend,
    within,
)
from vibrojax.plot.style import WORDS as SWEEPS
from vibrojax.results.axes import coordinates_along

DEFAULTS = ("peak_amplitude_ratio", "amplitude_ratio")
MAX_PANELS, MAX_ROWS = 24, 6
PANEL = (3.4, 2.7)  # inches, the least size of one of several panels
UNSETTLED = {
    "aperiodic": ("status", 1),
    "unstable": ("stable", 0),
    "some points not settled": ("lane_status", None),
}


def plot_map(
    dataset: xarray.Dataset,
    variable: str | None = None,
    *,
    x: str | None = None,
    y: str | None = None,
    **selection: Any,
) -> Figure:
    """Draw one variable of a map over two of its axes; see `vibrojax.plot_map`."""
    dataset = check_map(dataset)
    name = _variable(dataset, variable)
    for argument, axis in (("x", x), ("y", y)):
        chosen = [] if axis is None else [s for s in selection if _same(dataset, name, axis, s)]
        if chosen:
            raise ValueError(
                f"{argument}={axis!r} is an axis of the picture and {chosen[0]} a selection along "
                "it: give one of them."
            )
    view = _without_lost(select(dataset, name, selection), name)
    if "crossing" in view[name].dims:  # there are fewer responses at most frequencies
        found = view[name].notnull().any([d for d in view[name].dims if d != "crossing"])
        view = view.isel(crossing=found.values if found.any() else [0])
    horizontal, vertical, panels = _arrange(view, name, x, y)
    drawn = [axis for axis in (horizontal, vertical) if axis]
    used = {dimension_of(view, name, axis) for axis in drawn}
    view = view.isel({d: 0 for d in view[name].dims if view.sizes[d] == 1 and d not in used})
    view, axes = read_axes(view, name, *drawn)
    if vertical is None:
        return _draw_lines(view, name, axes[0])
    return _draw_maps(view, name, (axes[0], axes[1]), panels)


def _variable(dataset: xarray.Dataset, variable: str | None) -> str:
    known = variables_of(dataset)
    if variable is None:
        floats = [n for n in known if dataset[n].dtype.kind == "f"]
        preferred = [*(n for n in DEFAULTS if n in known), *measures_of(dataset), *floats, *known]
        return preferred[0]
    check_known("variable", variable, known)
    return variable


def _without_lost(view: xarray.Dataset, variable: str) -> xarray.Dataset:
    """Empty the lanes that failed or are missing: whole numbers have no NaN there."""
    if "lane_status" not in view or variable == "lane_status":
        return view
    lost = view["lane_status"] >= LANES["failed"]
    if not lost.any() or not set(lost.dims) <= set(view[variable].dims):
        return view
    return view.assign({variable: view[variable].where(~lost)})


def _same(dataset: xarray.Dataset, variable: str, one: str, other: str) -> bool:
    return dimension_of(dataset, variable, one) == dimension_of(dataset, variable, other)


def _arrange(
    view: xarray.Dataset, variable: str, x: str | None, y: str | None
) -> tuple[str, str | None, list[str]]:
    """Return the axes across and up (None: lines), and the dimensions that become panels."""
    if x is not None and y is not None and _same(view, variable, x, y):
        raise ValueError(
            f"x and y must be two axes, got {x!r} and {y!r}"
            + (f", which lie along {dimension_of(view, variable, x)}." if x != y else ".")
        )
    dims = [str(d) for d in view[variable].dims if view.sizes[d] > 1]
    given = [dimension_of(view, variable, axis) for axis in (x, y) if axis is not None]
    parameters = [d for d in parameters_of(view, variable) if d not in given]
    frequency = [d for d in dims if d in FREQUENCIES and d not in given]
    vertical = y or next(iter([*parameters, *frequency]), None)
    horizontal = x or next((d for d in [*frequency, *parameters] if d != vertical), None)
    if horizontal is None:  # one axis is left: the values go up
        horizontal, vertical = vertical, None
    if horizontal is None:
        horizontal = next(iter(dims), None)
    if horizontal is None:
        raise ValueError(
            f"{variable} has a single value there, {view[variable].values.item():.6g}: there is "
            "nothing to draw. Select less."
        )
    used = {dimension_of(view, variable, axis) for axis in (horizontal, vertical) if axis}
    panels = sorted((d for d in dims if d not in used), key=RESPONSES.__contains__)
    if vertical is not None:
        _check_panels(view, variable, panels)
    return horizontal, vertical, panels


def _check_panels(view: xarray.Dataset, variable: str, panels: list[str]) -> None:
    count = int(np.prod([view.sizes[d] for d in panels]))
    if len(panels) <= 2 and count <= MAX_PANELS:
        return
    widest = max(panels, key=lambda d: view.sizes[d])
    example = coordinates_along(view, widest)[0]
    value = view[example].values[0]
    shown = repr(str(value)) if value.dtype.kind not in "fiu" else f"{value:.4g}"
    why = f"{len(panels)} axes are" if len(panels) > 2 else f"{count} panels would be"
    raise ValueError(
        f"{why} left over, {' and '.join(f'{d} ({view.sizes[d]} values)' for d in panels)}; at "
        f"most two axes and {MAX_PANELS} panels are drawn. Select a value, such as "
        f"plot_map(dataset, {variable!r}, {example}={shown})."
    )


def _draw_maps(
    view: xarray.Dataset, variable: str, across: tuple[MapAxis, MapAxis], panels: list[str]
) -> Figure:
    x, y = across
    sizes = [view.sizes[d] for d in panels]
    count = int(np.prod(sizes))
    columns = 2 if count == 4 else min(count, 4 if count > 9 else 3)
    if len(sizes) > 1:  # each row has whole groups of the second axis
        columns = sizes[1] * -(-sizes[0] // MAX_ROWS)
    rows = -(-count // columns)
    width = max(SIZE[0], PANEL[0] * columns + 1.2)
    height = max(SIZE[1], PANEL[1] * rows + 1.2)
    figure = empty_picture((width, height))
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    view, words = with_regimes(view, variable)
    shades = shades_of(view, variable)
    room = width / columns - 0.7
    for number, axes in enumerate(grid.flat):
        if number >= count:
            axes.set_visible(False)
            continue
        where = dict(zip(panels, np.unravel_index(number, sizes), strict=True)) if panels else {}
        panel = view.isel(where)
        draw_cells(axes, panel, variable, across, shades, words)
        title = chosen_in(panel, *fixed_names(view))
        title = title if len(title) <= 8 * room else title.replace(", ", "\n")
        axes.set_title(title, fontsize=LABEL)
        at_end = number + columns >= count
        axes.tick_params(labelsize=SMALL, labelbottom=at_end)
        label = within(x.label(), room)
        if number >= (rows - 1) * columns:
            name_axes(axes, label)
        elif at_end:  # there is room below
            place = ((0.5, 0), (0, -22), "axes fraction", "offset points")
            text = axes.annotate(label, *place, ha="center", va="top", fontsize=LABEL)
            text.set_in_layout(False)
        if not number % columns:
            name_axes(axes, None, within(y.label(), height / rows))
    shown = [axes for axes in grid.flat if axes.get_visible()]
    shades.bar(shown, within(label_for(view[variable]), height - 1.5))
    return _titled(figure, view)


def _titled(figure: Figure, view: xarray.Dataset) -> Figure:
    """Write above a picture what was selected, and its legend."""
    if text := within(chosen_in(view), figure.get_figwidth()):
        figure.suptitle(text, fontsize=LABEL, x=0.02, ha="left")
    return outside_legend(figure)


def _draw_lines(view: xarray.Dataset, variable: str, x: MapAxis) -> Figure:
    figure, axes = new_picture()
    array = view[variable]
    split = next((str(d) for d in array.dims if d != x.dimension), None)
    for number in range(view.sizes[split] if split else 1):
        part = view.isel({split: number}) if split else view
        style: dict[str, Any] = {"color": COLORS["forward"], "marker": "o", "linestyle": "-"}
        if split == "direction":
            direction = str(part["direction"].item())
            style = {"color": COLORS.get(direction, GREY), "marker": MARKERS.get(direction, "o")}
            style["linestyle"] = STYLES.get(direction, ":")
            style["label"] = SWEEPS.get(direction, direction)
        elif split:  # crossings of one frequency are not in line with those of the next
            style["linestyle"] = "none"
            style["label"] = f"responses, up to {view.sizes[split]} at one frequency"
        if x.names is not None:
            style["linestyle"] = "none"
        y = cells(part, variable, x)
        (line,) = axes.plot(x.places, y, linewidth=1.8, markersize=6, **style)
        _hollow(axes, part, variable, x, y, line)
    none = array.isnull().all([d for d in array.dims if d != x.dimension]).values
    if none.any():  # marked at the bottom
        style = {"linestyle": "none", "marker": "x", "color": GREY, "markersize": 8}
        style |= {"transform": axes.get_xaxis_transform(), "label": f"no value ({none.sum()})"}
        axes.plot(x.places[none], np.full(none.sum(), 0.02), **style)
    scale_axes(axes, x)
    high = axes.get_ylim()[1]
    if 0 < np.nanmin(array.values, initial=np.inf) < 0.3 * high:
        axes.set_ylim(-0.02 * high, high)
    for name, style in JUMPS.items() if x.dimension in FREQUENCIES else ():
        if name in view and not view[name].ndim and np.isfinite(view[name].item()):
            where, unit = view[name].item(), " Hz" * (units_of(view, name) == "Hz")
            words = f"{name.replace('_', ' ')} {where:.5g}{unit}"
            drawn = {n: style[n] for n in ("color", "linestyle")}
            axes.axvline(where, linewidth=1.5, label=words, **drawn)
    name_axes(axes, x.label(), within(label_for(array), 5.0))
    return _titled(figure, view)


def _hollow(
    axes: Axes, part: xarray.Dataset, variable: str, x: MapAxis, y: np.ndarray, line: Line2D
) -> None:
    """Draw points hollow that did not settle, or are not stable."""
    for words, (flag, value) in UNSETTLED.items():
        if flag not in part or part[flag].dims != part[variable].dims:
            continue
        flags = cells(part, flag, x)
        at = flags == value if value is not None else flags > 0
        if not (at & np.isfinite(y)).any():
            continue
        style = HOLLOW | {"marker": line.get_marker(), "markersize": 8, "markeredgewidth": 1.4}
        axes.plot(x.places[at], y[at], color=line.get_color(), zorder=3, **style)
        axes.plot([], [], color=GREY, label=words, **style)
