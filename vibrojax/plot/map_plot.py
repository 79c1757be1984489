"""Pictures of maps: one variable over two axes, as many panels as further axes need."""

import textwrap
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax._tools.checks import nearest
from vibrojax.plot.map_axes import (
    FREQUENCIES,
    RESPONSES,
    MapAxis,
    check_map,
    coordinates_along,
    dimension_of,
    fixed_names,
    fixed_text,
    parameters_of,
    read_axis,
    select,
    units_of,
    variables_of,
)
from vibrojax.plot.map_drawing import (
    JUMPS,
    LANES,
    add_color_bar,
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
    Key,
    empty_picture,
    label_for,
    name_axes,
    new_picture,
    outside_legend,
)
from vibrojax.plot.style import WORDS as SWEEPS

DEFAULTS = ("peak_amplitude_ratio", "amplitude_ratio")
MAX_PANELS, MAX_ROWS = 24, 6
PANEL = (3.4, 2.7)  # inches, the least size of one of several panels


def plot_map(
    dataset: xarray.Dataset,
    variable: str | None = None,
    *,
    x: str | None = None,
    y: str | None = None,
    **selection: Any,
) -> Figure:
    """Draw one variable of a map over two of its axes, with its jumps and where the motion changes.

    `dataset` is that of `parameter_map`, or a sweep's `to_xarray()`. `variable` is the peak
    amplitude ratio where there is one. `x` and `y` name dimensions or coordinates along them: left
    out, a curve has its frequency on x and the first parameter on y, a measure the first parameter
    on y and the second on x. `selection` picks the value of other axes, the nearest of numbers. Up
    to two axes that are left become panels; a single axis becomes a line.

    Raises `ValueError` for a dataset that is not a map, an unknown variable or axis, a selection
    that is not on its axis, or when more than two axes or 24 panels are left.
    """
    dataset = check_map(dataset)
    name = _variable(dataset, variable)
    for argument, axis in (("x", x), ("y", y)):
        if axis is not None:
            chosen = [s for s in selection if _same(dataset, name, axis, s)]
            if chosen:
                raise ValueError(
                    f"{argument}={axis!r} is an axis of the picture and {chosen[0]} a selection "
                    "along it: give one of them."
                )
    view = _without_lost(dataset.isel(select(dataset, name, selection)), name)
    if "crossing" in view[name].dims:  # there are fewer responses at most frequencies
        others = [d for d in view[name].dims if d != "crossing"]
        found = view[name].notnull().any(others)
        view = view.isel(crossing=found.values if found.any() else [0])
    horizontal, vertical, panels = _arrange(view, name, x, y)
    sides = {d for d in view[name].dims if view.sizes[d] == 1}
    sides -= {dimension_of(view, name, axis) for axis in (horizontal, vertical) if axis}
    view = view.isel(dict.fromkeys(sides, 0))
    if vertical is None:
        return _draw_lines(view, name, read_axis(view, name, horizontal))
    across = read_axis(view, name, horizontal), read_axis(view, name, vertical)
    return _draw_maps(view, name, across, panels)


def _variable(dataset: xarray.Dataset, variable: str | None) -> str:
    known = variables_of(dataset)
    if variable is None:
        floats = [n for n in known if dataset[n].dtype.kind == "f"]
        measures = [n for n in floats if not {*FREQUENCIES, *RESPONSES} & set(dataset[n].dims)]
        return next(iter([*(n for n in DEFAULTS if n in known), *measures, *floats, *known]))
    if variable not in known:
        raise ValueError(f"Unknown variable {variable!r}. {nearest(variable, known)}")
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
    key: Key = {}
    letters = int(8 * (width / columns - 0.7))
    known = fixed_names(view, variable)
    for place, axes in zip(np.ndindex(rows, columns), grid.flat, strict=True):
        number = place[0] * columns + place[1]
        if number >= count:
            axes.set_visible(False)
            continue
        where = dict(zip(panels, np.unravel_index(number, sizes), strict=True)) if panels else {}
        panel = view.isel(where)
        draw_cells(axes, panel, variable, across, shades, words, key)
        scale_axes(axes, x, y)
        title = fixed_text(panel, variable, known)
        title = title if len(title) <= letters else title.replace(", ", "\n")
        axes.set_title(title, fontsize=LABEL)
        axes.tick_params(labelsize=SMALL, labelbottom=number + columns >= count)
        label = textwrap.fill(x.label, letters)
        if place[0] == rows - 1:
            name_axes(axes, label, None)
        elif number + columns >= count:  # there is room below
            style = {"ha": "center", "va": "top", "textcoords": "offset points"}
            text = axes.annotate(
                label, (0.5, 0), (0, -22), "axes fraction", fontsize=LABEL, **style
            )
            text.set_in_layout(False)
        if not place[1]:
            name_axes(axes, None, textwrap.fill(y.label, int(8 * height / rows)))
    label = textwrap.fill(label_for(view[variable]), int(8 * (height - 1.5)))
    shown = [axes for axes in grid.flat if axes.get_visible()]
    add_color_bar(figure, shown, shades, label)
    _title(figure, fixed_text(view, variable))
    outside_legend(figure, key)
    return figure


def _title(figure: Figure, text: str) -> None:
    if text:
        wrapped = textwrap.fill(text, int(9 * figure.get_figwidth()))
        figure.suptitle(wrapped, fontsize=LABEL, x=0.02, ha="left")


def _draw_lines(view: xarray.Dataset, variable: str, x: MapAxis) -> Figure:
    figure, axes = new_picture()
    array = view[variable]
    split = next((str(d) for d in array.dims if d != x.dimension), None)
    key: Key = {}
    for number in range(view.sizes[split] if split else 1):
        part = view.isel({split: number}) if split else view
        y = cells(part, variable, x)
        style: dict[str, Any] = {"color": COLORS["forward"], "marker": "o", "linestyle": "-"}
        label = None
        if split == "direction":
            direction = str(part["direction"].item())
            style = {"color": COLORS.get(direction, GREY), "marker": MARKERS.get(direction, "o")}
            style["linestyle"] = STYLES.get(direction, ":")
            label = SWEEPS.get(direction, direction)
        elif split:  # crossings of one frequency are not in line with those of the next
            style["linestyle"] = "none"
            label = f"responses, up to {view.sizes[split]} at one frequency"
        if x.names is not None:
            style["linestyle"] = "none"
        (line,) = axes.plot(x.places, y, linewidth=1.8, markersize=6, **style)
        if label:
            key.setdefault(label, line)
        _hollow(axes, part, variable, x, y, line, key)
    if view[variable].isnull().any():
        none = view[variable].isnull().all([d for d in array.dims if d != x.dimension])
        _rug(axes, x.places[none.values[x.order]], key)
    scale_axes(axes, x)
    high = axes.get_ylim()[1]
    if 0 < np.nanmin(array.values, initial=np.inf) < 0.3 * high:
        axes.set_ylim(-0.02 * high, high)
    if x.dimension in FREQUENCIES:
        _mark_jumps(axes, view, key)
    name_axes(axes, x.label, textwrap.fill(label_for(view[variable]), 45))
    _title(figure, fixed_text(view, variable))
    outside_legend(figure, key)
    return figure


UNSETTLED = {
    "aperiodic": ("status", 1),
    "unstable": ("stable", 0),
    "some points not settled": ("lane_status", None),
}


def _hollow(
    axes: Axes,
    part: xarray.Dataset,
    variable: str,
    x: MapAxis,
    y: np.ndarray,
    line: Line2D,
    key: Key,
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
        key.setdefault(words, Line2D([], [], color=GREY, **style))


def _rug(axes: Axes, places: np.ndarray, key: Key) -> None:
    """Mark values of the axis without any response, at the bottom."""
    if len(places):
        style: dict[str, Any] = {"linestyle": "none", "marker": "x", "color": GREY}
        bottom = axes.get_xaxis_transform()
        axes.plot(places, np.full(len(places), 0.02), transform=bottom, markersize=8, **style)
        key[f"no value ({len(places)})"] = Line2D([], [], markersize=8, **style)


def _mark_jumps(axes: Axes, view: xarray.Dataset, key: Key) -> None:
    for name, style in JUMPS.items():
        if name in view and not view[name].ndim and np.isfinite(view[name].item()):
            where = view[name].item()
            line = axes.axvline(where, color=style.color, linestyle=style.dashes, linewidth=1.5)
            unit = " Hz" if units_of(view, name) == "Hz" else ""
            key[f"{name.replace('_', ' ')} {where:.5g}{unit}"] = line
