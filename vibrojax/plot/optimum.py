"""Pictures of designs: what a search tried and where it ended, and fronts of two objectives."""

from collections.abc import Mapping
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
    SERIES,
    SIZE,
    SYMBOLS,
    balanced,
    draw_stable,
    dress,
    empty_picture,
    label_for,
    name_axes,
    outside_legend,
    show_zero,
)
from vibrojax.results.variables import axis_description, axis_unit, with_unit

COLUMNS = 5
"""Panels of variables beside each other."""
WIDE = 30.0
"""Ratio of values from which on their axis is logarithmic."""
RIGS = {"first": (COLORS["orange"], 1.6), "best": (COLORS["blue"], 2.2)}


def plot_optimum(optimum: xarray.Dataset, branches: Mapping[str, xarray.Dataset]) -> Figure:
    """Draw the values that were tried, the ways of the searches, and the neighbours of the best.

    `branches` are those of the `first` and of the `best` rig, where they are known.
    """
    names = [str(name) for name in optimum["variable"].values]
    columns = min(len(names), COLUMNS)
    blocks = -(-len(names) // columns)
    has_near = "neighbour" in optimum
    own = [2.0] * has_near + [2.0]
    heights = [3.2, *(own * blocks), *([3.4] if branches else [])]
    figure = empty_picture((_width(columns), sum(heights) + 0.5 * len(heights) + 0.6))
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    _draw_history(_panel(figure, grid[0, :]), optimum)
    for k, name in enumerate(names):
        row, column = 1 + len(own) * (k // columns), k % columns
        _draw_ways(_panel(figure, grid[row, column]), optimum, name)
        if has_near:
            _draw_slice(_panel(figure, grid[row + 1, column]), optimum, name, column == 0)
    if branches:
        _draw_branches(_panel(figure, grid[len(heights) - 1, :]), branches)
    return outside_legend(figure)


def plot_front(front: xarray.Dataset) -> Figure:
    """Draw two objectives against each other, and the designs along the front."""
    x, y = front["objective"].values.tolist()
    values = front["front"].values
    names = [str(name) for name in front["variable"].values]
    columns = min(len(names), COLUMNS)
    rows = -(-len(names) // columns)
    figure = empty_picture((_width(columns), 5.0 + 2.4 * rows))
    grid = figure.add_gridspec(1 + rows, columns, height_ratios=[4.4, *([2.0] * rows)])
    axes = _panel(figure, grid[0, :])
    tried, feasible = front["tried_objectives"].values, front["feasible"].values.astype(bool)
    shown = tried[feasible]
    axes.plot(*shown.T, "o", color=COLORS["pale"], markersize=3, label="designs tried")
    axes.plot(*values.T, "-", color=COLORS["blue"], linewidth=1.2)
    sure = front["front_status"].values == "converged"
    style: dict[str, Any] = {"linestyle": "none", "color": COLORS["blue"], "markersize": 8}
    axes.plot(*values[sure].T, "o", **style, label="front")
    if not sure.all():
        axes.plot(*values[~sure].T, "o", **style | HOLLOW, label="front, search not converged")
    for place, scale in ((values[:, 0], axes.set_xlim), (values[:, 1], axes.set_ylim)):
        width = np.ptp(place) or abs(place[0]) or 1.0
        scale(place.min() - 0.3 * width, place.max() + 0.3 * width)
    ways = [
        "largest" if name in front.attrs["maximise"].split(", ") else "least" for name in (x, y)
    ]
    labels = [f"{_words(name)} ({way} sought)" for name, way in zip((x, y), ways, strict=True)]
    name_axes(axes, *labels)
    for k, name in enumerate(names):
        panel = _panel(figure, grid[1 + k // columns, k % columns])
        panel.plot(values[:, 0], front["front_design"].values[:, k], "o-", color=COLORS["blue"])
        _scale(panel, front, name, "y")
        name_axes(panel, balanced(_words(x), 26), balanced(_label(name), 22))
    return outside_legend(figure)


def _width(columns: int) -> float:
    return max(SIZE[0] + 2.0, 2.8 * columns)


def _panel(figure: Any, place: Any) -> Axes:
    axes = figure.add_subplot(place)
    dress(axes)
    return axes


def _words(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _label(name: str) -> str:
    return with_unit(axis_description(name)["long_name"], axis_unit(name))


def _scale(axes: Axes, data: xarray.Dataset, name: str, which: str) -> None:
    """Give the axis of a variable its bounds and its scale."""
    own = data.sel(variable=name)
    low, high, log = (own[key].item() for key in ("low", "high", "logarithmic"))
    width = high - low
    ends = (
        (low / (high / low) ** 0.04, high * (high / low) ** 0.04)
        if log
        else (
            low - 0.04 * width,
            high + 0.04 * width,
        )
    )
    axes.set(**{f"{which}scale": "log" if log else "linear", f"{which}lim": ends})


def _search_style(search: int) -> dict[str, Any]:
    color, marker = SERIES[(search - 1) % len(SERIES)], SYMBOLS[(search - 1) % len(SYMBOLS)]
    return {"color": color, "marker": marker, "markersize": 4, "linewidth": 1.2}


def _draw_history(axes: Axes, data: xarray.Dataset) -> None:
    """Draw every value that was tried, by search, and the best one so far."""
    count, value = data["evaluation"].values, data["tried"].values
    search, feasible = data["search"].values, data["feasible"].values.astype(bool)
    known = value[np.isfinite(value)]
    if known.min() > 0 and known.max() > WIDE * known.min():
        axes.set_yscale("log")
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4, "color": GREY}
    screened = search == 0
    axes.plot(count[screened], np.where(feasible, value, np.nan)[screened], **dots)
    axes.plot([], [], label="screened", **dots)
    missed = ~feasible & np.isfinite(value)
    for number in sorted(set(search[search > 0].tolist())):
        own = search == number
        axes.plot(count[own], value[own], label=f"search {number}", **_search_style(number))
    near = search < 0
    if near.any():
        style: dict[str, Any] = {"linestyle": "none", "marker": "x", "color": COLORS["red"]}
        axes.plot(count[near], value[near], label="next to the best", markersize=6, **style)
    if missed.any():
        ring: dict[str, Any] = HOLLOW | {"marker": "o", "color": COLORS["middle"]}
        own = missed & screened
        axes.plot(count[own], value[own], markersize=4, **ring)
        words = "constraints missed"
        axes.plot(count[missed], value[missed], markersize=6, label=words, **ring, zorder=1.5)
    if feasible.any():
        follow = np.fmax if data.attrs["maximise"] else np.fmin
        best = follow.accumulate(np.where(feasible, value, np.nan))
        axes.step(
            count, best, where="post", color=COLORS["black"], linewidth=1.8, label="best so far"
        )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    name_axes(axes, "Designs tried", balanced(_words(data.attrs["objective"]), 30))


def _draw_ways(axes: Axes, data: xarray.Dataset, name: str) -> None:
    """Draw the ways of all searches in one variable."""
    search, number = data["search"].values, data["number_in_search"].values
    place = data["design"].sel(variable=name).values
    for one in sorted(set(search[search > 0].tolist())):
        own = search == one
        axes.plot(number[own], place[own], **_search_style(one))
    axes.axhline(data["best"].sel(variable=name).item(), color=COLORS["black"], linewidth=0.9)
    _scale(axes, data, name, "y")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
    name_axes(axes, "Try of search", balanced(_label(name), 22))


def _draw_slice(axes: Axes, data: xarray.Dataset, name: str, is_first: bool) -> None:
    """Draw the objective next to the best design, one variable changed."""
    best, value = data["best"].sel(variable=name).item(), data["value"].item()
    near = data.sel(variable=name)
    x = np.append(near["neighbour"].values, best)
    y = np.append(near["neighbour_value"].values, value)
    order = np.argsort(x)
    x, y = x[order], y[order]
    if data.attrs["status"] == "kink":
        axes.plot(x, y, color=GREY, linewidth=1.2)
    elif np.isfinite(y).all():
        along = np.linspace(x[0], x[-1], 61)
        middle, half = (x[0] + x[-1]) / 2, (x[-1] - x[0]) / 2
        curve = np.polyfit((x - middle) / half, y, 2)
        axes.plot(along, np.polyval(curve, (along - middle) / half), color=GREY, linewidth=1.2)
    style: dict[str, Any] = {"linestyle": "none", "marker": "x", "color": COLORS["red"]}
    tried = (data["search"].values < 0) & ~data["feasible"].values.astype(bool)
    missed = np.isin(x, data["design"].sel(variable=name).values[tried])
    axes.plot(x[~missed], y[~missed], markersize=7, **style)
    ring: dict[str, Any] = HOLLOW | {"marker": "o", "color": COLORS["middle"], "markersize": 7}
    axes.plot(x[missed], y[missed], **ring)
    words = "best design"
    axes.plot(best, value, "*", color=COLORS["black"], markersize=12, label=words, linestyle="none")
    axes.xaxis.set_major_locator(MaxNLocator(nbins=2))
    axes.xaxis.set_major_formatter("{x:.5g}")
    axes.margins(y=0.2)
    name_axes(axes, balanced(_label(name), 26), balanced("Next to the best", 20) * is_first or None)


def _draw_branches(axes: Axes, branches: Mapping[str, xarray.Dataset]) -> None:
    """Draw the branches of the first and of the best rig."""
    last = list(branches.values())[-1]
    axis = str(last.attrs["axis"])
    shown = next(name for name in ("mean_power", "voltage", "amplitude_ratio") if name in last)
    for name, branch in branches.items():
        color, width = RIGS[name]
        x, y, stable = (branch[key].values for key in (axis, shown, "stable"))
        draw_stable(axes, x, y, stable, color=color, linewidth=width)
        axes.plot([], [], color=color, linewidth=width, label=f"{name} rig")
    show_zero(axes)
    name_axes(axes, label_for(last[axis]), balanced(label_for(last[shown])))
