"""Picture of an identification: the points, the fitted curve, residuals and estimates."""

import textwrap
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.style import (
    COLORS,
    DASHES,
    GREY,
    HOLLOW,
    MARKERS,
    SMALL,
    Key,
    balanced,
    draw_stable,
    label_for,
    mark_places,
    name_axes,
    new_panels,
    outside_legend,
    stability_key,
    titled,
)

WAYS = {"forward": 1, "backward": -1, "unknown direction": 0}
FITTED: dict[str, Any] = {"color": COLORS["black"], "linewidth": 1.6}
FOLD = HOLLOW | {"marker": "o", "markersize": 9, "markeredgewidth": 2.0}
LIMITS: dict[str, Any] = {"color": GREY, "linestyle": DASHES, "linewidth": 1.0}
LINE = 0.22
"""Height of a line of text, inches."""
CHARACTER = 0.082
"""Width of a character, inches, about."""
WIDE = 8.6
"""Width of the lines of text below the panels, inches."""
MOST_FOLDS = 4
"""Folds of one direction that are marked."""
MOST_WARNINGS = 3

Line = list[tuple[float, str, dict[str, Any]]]
"""Of text: place (inches from the left), words and style of its parts."""


def plot_identification(data: xarray.Dataset, estimates: xarray.Dataset, title: str) -> Figure:
    """Draw one measurement and the fitted curve, the residuals below it, and the estimates."""
    text = _written(estimates)
    is_curve = "curve_frequency" in data
    names = _channels(data) if is_curve else list(dict.fromkeys(data["channel"].values.tolist()))
    heights = [3.6, *[2.6] * (len(names) - 1), 2.0]
    if not is_curve:
        heights = [2.0 if len(names) > 1 else 3.2] * len(names)
    figure, (*panels, below) = new_panels([*heights, LINE * (len(text) + 3)])
    panels[-1].tick_params(labelbottom=True)
    below.set_axis_off()
    key = (_curve if is_curve else _history)(panels, data, names)
    key["±2 standard deviations"] = Line2D([], [], **LIMITS)
    outside_legend(figure, key, above=True)
    titled(panels[0], textwrap.shorten(title, 85, placeholder=" …"))
    _write(below, text)
    return figure


def _channels(data: xarray.Dataset) -> list[str]:
    own = [str(n) for n in data.data_vars if str(n).startswith("measured_")]
    return [n.removeprefix("measured_") for n in own if n != "measured_frequency"]


def _curve(panels: list[Axes], data: xarray.Dataset, names: list[str]) -> Key:
    """Draw points and curve of every channel, and the residuals; return the legend."""
    frequency, direction = data["measured_frequency"].values, data["direction"].values
    shown = [*(f"measured_{name}" for name in names), "residual"]
    key: Key = {}
    for way, number in WAYS.items():
        at = direction == number
        if at.any():
            marks = _marks(way)
            for axes, name in zip(panels, shown, strict=True):
                axes.plot(frequency[at], data[name].values[at], zorder=3, **marks)
            key[f"measured, {way}{' sweep' if number else ''}"] = Line2D([], [], **marks)
    along = data["curve_frequency"].values
    stable = data["curve_unstable"].values == 0
    joined = data["curve_continues"].values
    folds = _folds(data)
    for axes, name in zip(panels, names, strict=False):
        values = data[f"curve_{name}"].values
        kinds = draw_stable(axes, along, values, stable, joined, zorder=4, **FITTED)
        for way, at in folds:
            axes.plot(along[at], values[at], color=COLORS[way], zorder=5, **FOLD)
        name_axes(axes, None, balanced(label_for(data[f"measured_{name}"])))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        key |= stability_key(kinds, ("fitted", "fitted, between folds"), **FITTED)
    if folds:
        key["fold of the fitted curve"] = Line2D([], [], color=GREY, **FOLD)
    low, high = frequency.min(), frequency.max()
    margin = 0.03 * (high - low) or 0.02 * low
    panels[0].set_xlim(low - margin, high + margin)
    unit = " Hz" * (data["measured_frequency"].attrs["units"] == "Hz")
    words = [(along[at], f"{way} fold {along[at]:.5g}{unit}", COLORS[way]) for way, at in folds]
    mark_places(panels, words)
    _residual_axis(panels[-1], "Residual\n(std. deviations)")
    name_axes(panels[-1], label_for(data["measured_frequency"]), None)
    return key


def _marks(way: str) -> dict[str, Any]:
    """Return the style of the measured points of a direction."""
    style: dict[str, Any] = {"marker": MARKERS.get(way, "o"), "color": COLORS.get(way, GREY)}
    return style | {"linestyle": "none", "markersize": 7, "markeredgewidth": 0.0, "alpha": 0.8}


def _folds(data: xarray.Dataset) -> list[tuple[str, int]]:
    """Return direction and place along the curve of its folds, the highest of many."""
    along, heights = data["curve_frequency"].values, data[f"curve_{_channels(data)[0]}"].values
    ways = data["fold_direction"].values
    found: list[tuple[str, int]] = []
    for name in dict.fromkeys(ways.tolist()):
        beyond = WAYS[name] * (along - np.stack([np.roll(along, 1), np.roll(along, -1)]))
        turning = np.all(beyond > 0, axis=0)
        # Other branches pass the same frequency.
        off = np.where(turning, 0.0, np.inf) if turning.any() else np.zeros(len(along))
        frequencies = data["fold"].values[ways == name]
        places = [int(np.argmin(np.abs(along - f) + off)) for f in frequencies]
        places.sort(key=lambda at: -heights[at])
        found += [(name, at) for at in places[:MOST_FOLDS]]
    return found


def _history(panels: list[Axes], data: xarray.Dataset, names: list[str]) -> Key:
    """Draw the residuals of every channel against time; return the legend."""
    color = COLORS["blue"]
    for axes, name in zip(panels, names, strict=True):
        own = data["channel"].values == name
        dots = {"marker": "none" if own.sum() > 200 else "o", "markersize": 4}
        time, residual = data["measured_time"].values[own], data["residual"].values[own]
        axes.plot(time, residual, color=color, linewidth=0.9, zorder=3, **dots)
        _residual_axis(axes, f"{name.replace('_', ' ').capitalize()}\n(std. deviations)")
    name_axes(panels[-1], label_for(data["measured_time"]), None)
    return {"measured less fitted": Line2D([], [], color=color, linewidth=1.4)}


def _residual_axis(axes: Axes, label: str) -> None:
    for height in (-2.0, 2.0):
        axes.axhline(height, zorder=2, **LIMITS)
    axes.axhline(0.0, color=GREY, linewidth=0.8, zorder=2)
    reach = max(3.0, *np.abs(axes.get_ylim()))
    axes.set_ylim(-reach, reach)
    name_axes(axes, None, label)


def _written(estimates: xarray.Dataset) -> list[Line]:
    """Return the table of the estimates, the misfit and the warnings as lines of text."""
    told, head, odd = estimates.attrs, {"color": GREY}, {"color": COLORS["backward"]}
    percent = f"{100 * told['confidence']:g} % interval"
    rows = [("number, SI", "estimate", percent, "the data say")]
    for name in estimates["parameter"].values.tolist():
        own = estimates.sel(parameter=name)
        low, high = own["interval"].values
        estimate, sentence = f"{own['estimate'].item():.5g}", own["identifiability"].item()
        rows.append((name, estimate, f"{low:.4g} to {high:.4g}", sentence))
    widths = [CHARACTER * max(len(row[c]) for row in rows) + 0.3 for c in range(3)]
    places = np.cumsum([0.0, *widths]).tolist()
    room = max(20, int((WIDE - places[3]) / CHARACTER))
    lines: list[Line] = []
    for row, known in zip(rows, [True, *estimates["identifiable"].values], strict=True):
        styles: list[dict[str, Any]] = [{"weight": "bold"}] * 2 + [{}, {} if known else odd]
        styles = styles if lines else [head] * 4
        first, *more = textwrap.wrap(row[3], room)
        lines.append(list(zip(places, (*row[:3], first), styles, strict=True)))
        lines += [[(places[3], rest, styles[3])] for rest in more]
    count = told["number_of_measurements"]
    misfit = (
        f"reduced chi-square {told['reduced_chi_square']:.3f} ({told['degrees_of_freedom']} "
        f"degrees of freedom), {told['values_measured']} points"
        f"{f' in {count} measurements' * (count > 1)}"
    )
    lines += [[], [(0.0, misfit, {})]]
    warnings = told["warnings"].splitlines()
    for warning in warnings[:MOST_WARNINGS]:
        # The first sentence: the others are in the report.
        words = f"Warning: {warning.partition('. ')[0].rstrip('.')}."
        wrapped = textwrap.wrap(words, int(WIDE / CHARACTER), subsequent_indent="   ")
        lines += [[(0.0, line, odd)] for line in wrapped]
    if (more := len(warnings) - MOST_WARNINGS) > 0:
        words = f"and {more} more warning{'s' * (more > 1)}: print the fit to read them."
        lines.append([(0.0, words, odd)])
    return lines


def _write(axes: Axes, lines: list[Line]) -> None:
    for row, parts in enumerate(lines):
        for place, words, style in parts:
            axes.annotate(
                words,
                xy=(0.0, 1.0),
                xycoords="axes fraction",
                xytext=(72 * place, -72 * LINE * row),
                textcoords="offset points",
                va="top",
                fontsize=SMALL,
                annotation_clip=False,
                **style,
            ).set_in_layout(False)
