"""Pictures of identifications: points, fitted curve, residuals, estimates, and profiles."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.plot.style import (
    COLORS,
    DASHES,
    FRAME,
    GREY,
    HOLLOW,
    MARKERS,
    SIZE,
    SMALL,
    balanced,
    draw_stable,
    dress,
    empty_picture,
    label_for,
    mark_places,
    name_axes,
    new_panels,
    outside_legend,
    show_zero,
)

WAYS = {"forward": 1, "backward": -1, "unknown direction": 0}
FITTED: dict[str, Any] = {"color": COLORS["black"], "linewidth": 1.6}
NEAREST: dict[str, Any] = {"color": COLORS["black"], "linestyle": "none", "marker": "."}
NEAREST |= {"markersize": 5, "zorder": 6, "label": "fitted, at the drive of each point"}
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
REFITTED: dict[str, Any] = {"color": COLORS["blue"], "linewidth": 1.8}
THRESHOLD: dict[str, Any] = {"color": COLORS["orange"], "linestyle": DASHES, "linewidth": 1.5}
INSIDE: dict[str, Any] = {"color": COLORS["blue"], "alpha": 0.13, "linewidth": 0}
ESTIMATE: dict[str, Any] = {"color": GREY, "linestyle": ":", "linewidth": 1.5}

Line = list[tuple[float, str, dict[str, Any]]]
"""Of text: place (inches from the left), words and style of its parts."""


def plot_identification(
    data: xarray.Dataset, estimates: xarray.Dataset | None, title: str
) -> Figure:
    """Draw one measurement and the fitted curve, the residuals below it, and the estimates.

    Without `estimates` there is no text below.
    """
    text = [] if estimates is None else _written(estimates)
    is_curve = "curve_frequency" in data
    names = _channels(data) if is_curve else list(dict.fromkeys(data["channel"].values.tolist()))
    heights = [3.6, *[2.6] * (len(names) - 1), 2.0]
    if not is_curve:
        heights = [2.4, 1.5] * len(names)
    if text:
        figure, (*panels, below) = new_panels([*heights, LINE * (len(text) + 3)])
        panels[-1].tick_params(labelbottom=True)
        below.set_axis_off()
        _write(below, text)
    else:
        figure, panels = new_panels(heights)
    (_curve if is_curve else _history)(panels, data, names)
    name_axes(panels[0], title=textwrap.shorten(title, 85, placeholder=" …"))
    return outside_legend(figure, above=True)


def _channels(data: xarray.Dataset) -> list[str]:
    own = [str(n) for n in data.data_vars if str(n).startswith("measured_")]
    return [n.removeprefix("measured_") for n in own if n != "measured_frequency"]


def _curve(panels: list[Axes], data: xarray.Dataset, names: list[str]) -> None:
    """Draw points and curve of every channel, and the residuals."""
    frequency, direction = data["measured_frequency"].values, data["direction"].values
    shown = [*(f"measured_{name}" for name in names), "residual"]
    for way, number in WAYS.items():
        at = direction == number
        marks: dict[str, Any] = {"marker": MARKERS.get(way, "o"), "color": COLORS.get(way, GREY)}
        marks |= {"linestyle": "none", "markersize": 7, "markeredgewidth": 0.0, "alpha": 0.8}
        marks["label"] = f"measured, {way}{' sweep' if number else ''}"
        if at.any():
            for axes, name in zip(panels, shown, strict=True):
                axes.plot(frequency[at], data[name].values[at], zorder=3, **marks)
    along = data["curve_frequency"].values
    stable, joined = data["curve_unstable"].values == 0, data["curve_continues"].values
    own = "drive_amplitude" in data
    name = f"fitted{', at the median drive' * own}"
    style: dict[str, Any] = FITTED | {"words": (name, f"{name}, between folds"), "zorder": 4}
    folds = _folds(data)
    for axes, name in zip(panels, names, strict=False):
        values = data[f"curve_{name}"].values
        draw_stable(axes, along, values, stable, joined, entry=FITTED["color"], **style)
        if own:
            at_own = data["fitted_frequency"].values, data[f"fitted_{name}"].values
            axes.plot(*at_own, **NEAREST)
        for way, at in folds:
            axes.plot(along[at], values[at], color=COLORS[way], zorder=5, **FOLD)
        name_axes(axes, None, balanced(label_for(data[f"measured_{name}"])))
        show_zero(axes)
    if folds:
        panels[0].plot([], [], color=GREY, label="fold of the fitted curve", **FOLD)
    low, high = frequency.min(), frequency.max()
    margin = 0.03 * (high - low) or 0.02 * low
    panels[0].set_xlim(low - margin, high + margin)
    unit = " Hz" * (data["measured_frequency"].attrs["units"] == "Hz")
    words = [(along[at], f"{way} fold {along[at]:.5g}{unit}", COLORS[way]) for way, at in folds]
    mark_places(panels, words)
    _residual_axis(panels[-1], "Residual\n(std. deviations)")
    name_axes(panels[-1], label_for(data["measured_frequency"]))


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


def _history(panels: list[Axes], data: xarray.Dataset, names: list[str]) -> None:
    """Draw every channel and its residuals against time."""
    line: dict[str, Any] = {"color": COLORS["blue"], "linewidth": 0.9, "markersize": 4, "zorder": 3}
    for k, name in enumerate(names):
        signal, below = panels[2 * k : 2 * k + 2]
        own = data.isel(point=data["channel"].values == name).sortby("measured_time")
        time = own["measured_time"].values
        line["marker"] = "none" if len(time) > 200 else "o"
        signal.plot(time, own["measured_value"].values, label="measured", **line)
        signal.plot(time, own["fitted_value"].values, label="fitted", zorder=4, **FITTED)
        words = name.replace("_", " ").capitalize()
        name_axes(signal, None, f"{words}\n({own['unit'].values[0]})")
        below.plot(time, own["residual"].values, **line)
        _residual_axis(below, "Residual\n(std. deviations)")
    name_axes(panels[-1], label_for(data["measured_time"]))


def _residual_axis(axes: Axes, label: str) -> None:
    for height in (-2.0, 2.0):
        axes.axhline(height, zorder=2, label="±2 standard deviations", **LIMITS)
    axes.axhline(0.0, color=GREY, linewidth=0.8, zorder=2)
    reach = max(3.0, *np.abs(axes.get_ylim()))
    axes.set_ylim(-reach, reach)
    name_axes(axes, None, label)


def _written(estimates: xarray.Dataset) -> list[Line]:
    """Return the table of the estimates, the misfit and the warnings as lines of text."""
    attributes, head, odd = estimates.attrs, {"color": GREY}, {"color": COLORS["backward"]}
    percent = f"{100 * attributes['confidence']:g} % interval"
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
    count = attributes["number_of_measurements"]
    misfit = (
        f"reduced chi-square {attributes['reduced_chi_square']:.3f} "
        f"({attributes['degrees_of_freedom']} degrees of freedom), "
        f"{attributes['values_measured']} points"
        f"{f' in {count} measurements' * (count > 1)}"
    )
    lines += [[], [(0.0, misfit, {})]]
    warnings = attributes["warnings"].splitlines()
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


def plot_profiles(profiles: Sequence[xarray.Dataset]) -> Figure:
    """Draw profiles side by side: the rise of chi-square against the number that was held.

    They are those of `Profile.to_xarray()`. Raises `ValueError` when there is none.
    """
    if not profiles:
        raise ValueError("profiles is empty: give at least one profile.")
    count = len(profiles)
    columns = min(count, 3 if count != 4 else 2)
    rows = -(-count // columns)
    figure = empty_picture((SIZE[0], max(SIZE[1] if count == 1 else 0.0, 3.1 * rows + FRAME)))
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for k, axes in enumerate(panels.flat):
        if k >= count:
            axes.set_axis_off()
            continue
        dress(axes)
        _draw_profile(axes, profiles[k])
    for row in panels:
        name_axes(row[0], None, "Rise of chi-square")
    # All of the rise, or what is of interest where it is huge.
    threshold = max(p.attrs["threshold"] for p in profiles)
    highest = max(float(p["rise"].max()) for p in profiles)
    top = 1.06 * min(max(highest, 1.3 * threshold), 6 * threshold)
    panels[0, 0].set_ylim(-0.03 * top, top)
    return outside_legend(figure)


def _draw_profile(axes: Axes, profile: xarray.Dataset) -> None:
    name, estimate = profile.attrs["parameter"], profile.attrs["estimate"]
    values, rise = profile[name].values.astype(float), profile["rise"].values.astype(float)
    logarithmic = values.min() > 0 and values.max() > 10 * values.min()
    inside, outside = (np.log, np.exp) if logarithmic else (np.asarray, np.asarray)
    # Roots of the rise are nearly straight: what lies between the values is drawn by them.
    known, root = values, np.sqrt(np.maximum(rise, 0.0)) * np.sign(values - estimate)
    if estimate not in values and values[0] < estimate < values[-1]:
        place = int(np.searchsorted(values, estimate))
        known, root = np.insert(values, place, estimate), np.insert(root, place, 0.0)
    at = inside(known)
    between = np.linspace(at[0], at[-1], 40 * len(at))
    axes.plot(outside(between), np.interp(between, at, root) ** 2, **REFITTED)
    axes.plot(values, rise, "o", color=REFITTED["color"], markersize=6)
    axes.plot([], [], marker="o", label="others refitted", **REFITTED)
    low, high = profile.attrs["interval"]
    percent, threshold = f"{100 * profile.attrs['confidence']:g} %", profile.attrs["threshold"]
    axes.axhline(threshold, label=f"{percent} threshold, {threshold:.3g}", **THRESHOLD)
    axes.axvspan(low, high, zorder=0.5, label=f"{percent} interval", **INSIDE)
    axes.axvline(estimate, label="estimate", **ESTIMATE)
    if logarithmic:
        axes.set_xscale("log")
    title = f"{estimate:.4g}  ({low:.4g} to {high:.4g})"
    axes.set_title(title, fontsize=SMALL, loc="left", color=GREY)
    name_axes(axes, f"{name} (SI)")
