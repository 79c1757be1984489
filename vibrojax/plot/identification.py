"""Pictures of identifications and of profiles."""

import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from vibrojax._tools.checks import check_count
from vibrojax.identification.identification import Identification, Prediction
from vibrojax.identification.profile import Profile
from vibrojax.measured.curve import DIRECTIONS, MeasuredCurve
from vibrojax.measured.history import MeasuredHistory
from vibrojax.plot.style import (
    COLORS,
    DPI,
    GREY,
    LABEL,
    MARKERS,
    SIZE,
    SMALL,
    Picture,
    label_of,
    new_picture,
    outside_legend,
)
from vibrojax.results.variables import named_value

FITTED = "#222222"
DASHES = (0, (4, 2))
WORDS = {
    "amplitude": "amplitude (max\u00a0−\u00a0min)/2",
    "peak": "peak max |y|",
    "peak_to_peak": "peak to peak",
    "rms": "root mean square",
    "first_harmonic": "first harmonic",
}
LINE = 0.22
"""Height of a line of text, inches."""
CHARACTER = 0.082
"""Width of a character, inches, about."""
WIDE = 8.6
"""Width of the lines of text below the panels, inches."""
MOST_FOLDS = 4
"""Folds of one direction that are marked."""
MOST_WARNINGS = 3


def plot_identification(fit: Identification, measurement: int = 0) -> Figure:
    """Draw one measurement and the fitted curve, the residuals below it, and the estimates.

    Raises `ValueError` for a measurement that is not there.
    """
    check_count("measurement", measurement, least=0)
    if measurement >= len(fit.measured):
        raise ValueError(
            f"measurement must be below {len(fit.measured)}, the number of measurements, got "
            f"{measurement}."
        )
    measured, prediction = fit.measured[measurement], fit.predictions[measurement]
    written = _written(fit)
    if isinstance(measured, MeasuredHistory):
        heights = [2.0 if len(measured.channels) > 1 else 3.2] * len(measured.channels)
    else:
        heights = [3.6, *[2.6] * (prediction.channels.shape[1] - 1), 2.0]
    figure, panels, text = _stacked(heights, LINE * (len(written) + 1))
    if isinstance(measured, MeasuredHistory):
        lines, labels = _history(panels, measured, prediction)
    else:
        lines, labels = _curve(panels, measured, prediction)
    _legend_above(figure, lines, labels)
    if title := _title(fit, measurement):
        panels[0].set_title(title, fontsize=LABEL, loc="left")
    _write(text, written)
    return figure


def _stacked(heights: Sequence[float], text: float) -> tuple[Picture, list[Axes], Axes]:
    """Make panels of some heights (inches) over each other, and a place for text below them."""
    margins = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.08)
    figure = Picture(figsize=(SIZE[0], sum(heights) + text + 1.7), dpi=DPI, layout=margins)
    grid = figure.add_gridspec(len(heights) + 1, 1, height_ratios=[*heights, text])
    panels: list[Axes] = []
    for row in range(len(heights)):
        panels.append(figure.add_subplot(grid[row], sharex=panels[0] if panels else None))
        _dress(panels[-1])
        panels[-1].tick_params(labelbottom=row == len(heights) - 1)
    below = figure.add_subplot(grid[-1])
    below.set_axis_off()
    return figure, panels, below


def _dress(axes: Axes) -> None:
    axes.grid(True, color="#d9d9d9", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _title(fit: Identification, measurement: int) -> str:
    measured = fit.measured[measurement]
    count = len(fit.measured)
    parts = [f"measurement {measurement + 1} of {count}"] if count > 1 else []
    parts += [measured.label] if measured.label else []
    parts += [named_value(name, value) for name, value in measured.parameters.items()]
    return textwrap.shorten(", ".join(parts), 85, placeholder=" …")


def _curve(
    panels: list[Axes], measured: MeasuredCurve, prediction: Prediction
) -> tuple[list[Artist], list[str]]:
    """Draw points and curve of every channel, and the residuals; return the legend."""
    channels = []
    if measured.amplitude is not None:
        channels.append((amplitude_label(measured), measured.amplitude))
    if measured.contact_force is not None:
        channels.append((label_of("contact_force"), measured.contact_force))
    folds = _folds(prediction)
    for k, (label, values) in enumerate(channels):
        axes = panels[k]
        for way, name in DIRECTIONS.items():
            at = measured.direction == way
            if at.any():
                axes.plot(measured.frequency[at], values[at], zorder=3, **_marks(name))
        _draw_fitted(axes, prediction, prediction.channels[:, k])
        for name, at in folds:
            x, y = prediction.frequency[at], prediction.channels[at, k]
            axes.plot(x, y, **_fold_mark(COLORS[name]))
        axes.set_ylabel(label, fontsize=LABEL)
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    low, high = measured.frequency.min(), measured.frequency.max()
    margin = 0.03 * (high - low) or 0.02 * low
    panels[0].set_xlim(low - margin, high + margin)
    _label_folds(panels[0], [(n, float(prediction.frequency[at])) for n, at in folds], measured)
    for axes in panels:
        for name, at in folds:
            where = float(prediction.frequency[at])
            axes.axvline(where, color=COLORS[name], linestyle=":", linewidth=1.0, alpha=0.7)
    residuals = panels[-1]
    for way, name in DIRECTIONS.items():
        at = measured.direction == way
        if at.any():
            x, y = measured.frequency[at], prediction.residual[at]
            residuals.plot(x, y, zorder=3, **_marks(name))
    _residual_axis(residuals, "Residual\n(std. deviations)")
    residuals.set_xlabel(label_of(measured.frequency_name), fontsize=LABEL)
    return _curve_legend(measured, prediction, bool(folds))


def amplitude_label(measured: MeasuredCurve) -> str:
    """Return what the amplitudes of a measured curve are, with their unit, in lines."""
    signal = f"{'absolute ' * (measured.frame == 'absolute')}{measured.signal}"
    what = f"{signal.capitalize()}, {WORDS[measured.quantity]}"
    unit = "over drive amplitude" if measured.is_ratio else f"({measured.unit})"
    whole = f"{what} {unit}"
    rows = -(-len(whole) // 34)
    return textwrap.fill(whole, len(whole) // rows + 6)


def _marks(name: str) -> dict[str, Any]:
    """Style of the measured points of a direction."""
    return {
        "marker": MARKERS.get(name, "o"),
        "linestyle": "none",
        "color": COLORS.get(name, GREY),
        "markersize": 7,
        "markeredgewidth": 0.0,
        "alpha": 0.8,
    }


def _fold_mark(color: str) -> dict[str, Any]:
    return {
        "marker": "o",
        "linestyle": "none",
        "color": color,
        "markersize": 9,
        "markeredgewidth": 2.0,
        "markerfacecolor": "white",
        "zorder": 5,
    }


def _folds(prediction: Prediction) -> list[tuple[str, int]]:
    """Direction and place along the curve of its folds, the largest ones where they are many."""
    found = []
    along = prediction.frequency
    for name, frequencies in prediction.folds.items():
        way = 1 if name == "forward" else -1
        beyond = way * (along - np.stack([np.roll(along, 1), np.roll(along, -1)]))
        turning = np.all(beyond > 0, axis=0)
        # Other branches pass the same frequency.
        off = np.where(turning, 0.0, np.inf) if turning.any() else np.zeros(len(along))
        places = [int(np.argmin(np.abs(along - f) + off)) for f in frequencies]
        places.sort(key=lambda at: -prediction.channels[at, 0])
        found += [(name, at) for at in places[:MOST_FOLDS]]
    return found


def _draw_fitted(axes: Axes, prediction: Prediction, y: np.ndarray) -> None:
    for unstable, start, stop in _runs(prediction):
        axes.plot(
            prediction.frequency[start:stop],
            y[start:stop],
            color=FITTED,
            linewidth=1.4 if unstable else 1.6,
            linestyle=DASHES if unstable else "-",
            zorder=4,
        )


def _runs(prediction: Prediction) -> Iterator[tuple[bool, int, int]]:
    """Stretches of the fitted curve without a break: whether unstable, first point, end."""
    joined = np.asarray(prediction.continues, bool)[:-1]
    unstable = np.asarray(prediction.unstable, bool)[:-1]
    kind = np.where(joined, unstable.astype(int), -1)
    edges = np.flatnonzero(np.diff(kind)) + 1
    for start, stop in zip(np.r_[0, edges], np.r_[edges, len(kind)], strict=True):
        if start < stop and kind[start] >= 0:
            yield bool(kind[start]), int(start), int(stop) + 1


def _label_folds(axes: Axes, folds: list[tuple[str, float]], measured: MeasuredCurve) -> None:
    """Write the frequencies of the folds along the top, on the sides away from each other."""
    left, right = axes.get_xlim()
    shown = sorted((f for f in folds if left <= f[1] <= right), key=lambda fold: fold[1])
    low, high = axes.get_ylim()
    rows = max(1, (len(shown) + 1) // 2)
    axes.set_ylim(low, high + (0.06 + 0.09 * rows) * (high - low) if shown else high)
    unit = "" if measured.frequency_name == "frequency_ratio" else " Hz"
    sides: list[bool] = []
    for k, (name, where) in enumerate(shown):
        place = (where - left) / (right - left)
        to_left = place > 0.72 or (2 * k + 1 < len(shown) and place > 0.28)
        row = sides.count(to_left)
        sides.append(to_left)
        axes.annotate(
            f"{name} fold {where:.5g}{unit}",
            xy=(where, 0.99 - 0.08 * row),
            xycoords=axes.get_xaxis_transform(),
            xytext=(-7 if to_left else 7, 0),
            textcoords="offset points",
            ha="right" if to_left else "left",
            va="top",
            fontsize=SMALL,
            color=COLORS[name],
            zorder=6,
        )


def _residual_axis(axes: Axes, label: str) -> None:
    for height in (-2.0, 2.0):
        axes.axhline(height, color=GREY, linestyle=DASHES, linewidth=1.0, zorder=2)
    axes.axhline(0.0, color=GREY, linewidth=0.8, zorder=2)
    reach = max(3.0, *np.abs(axes.get_ylim()))
    axes.set_ylim(-reach, reach)
    axes.set_ylabel(label, fontsize=LABEL)


def _curve_legend(
    measured: MeasuredCurve, prediction: Prediction, folds: bool
) -> tuple[list[Artist], list[str]]:
    lines: list[Artist] = []
    labels = []
    for way, name in DIRECTIONS.items():
        if np.any(measured.direction == way):
            lines.append(Line2D([], [], **_marks(name)))
            labels.append(f"measured, {name}{' sweep' if way else ''}")
    kinds = {unstable for unstable, _, _ in _runs(prediction)}
    for unstable, words in ((False, "fitted"), (True, "fitted, between folds")):
        if unstable in kinds:
            style = DASHES if unstable else "-"
            lines.append(Line2D([], [], color=FITTED, linewidth=1.8, linestyle=style))
            labels.append(words)
    if folds:
        lines.append(Line2D([], [], **_fold_mark(GREY)))
        labels.append("fold of the fitted curve")
    return [*lines, _two_deviations()], [*labels, "±2 standard deviations"]


def _two_deviations() -> Line2D:
    return Line2D([], [], color=GREY, linestyle=DASHES, linewidth=1.0)


def _legend_above(figure: Figure, lines: list[Artist], labels: list[str]) -> None:
    """Put the legend above the panels: the numbers are below them."""
    rows = -(-len(labels) // 3)
    figure.legend(
        lines,
        labels,
        loc="outside upper center",
        ncols=-(-len(labels) // rows),
        fontsize=SMALL,
        frameon=False,
        handlelength=3.4,
    )


def _history(
    panels: list[Axes], measured: MeasuredHistory, prediction: Prediction
) -> tuple[list[Artist], list[str]]:
    """Draw the residuals of every channel against time; return the legend."""
    part = measured.windowed()
    residual = np.asarray(prediction.residual).reshape(len(part.channels), part.size)
    many = part.size > 200
    for axes, name, values in zip(panels, part.channels, residual, strict=True):
        axes.plot(
            part.time,
            values,
            color=COLORS["forward"],
            marker="none" if many else "o",
            markersize=4,
            linewidth=0.9,
            zorder=3,
        )
        _residual_axis(axes, f"{name.replace('_', ' ').capitalize()}\n(std. deviations)")
    panels[-1].set_xlabel("Time (s)", fontsize=LABEL)
    line = Line2D([], [], color=COLORS["forward"], linewidth=1.4)
    return [line, _two_deviations()], ["measured less fitted", "±2 standard deviations"]


def _written(fit: Identification) -> list[list[tuple[float, str, dict[str, Any]]]]:
    """Lines of text: place (inches from the left), words and style of their parts."""
    head = {"color": GREY}
    rows = [("number, SI", "estimate", f"{100 * fit.confidence:g} % interval", "the data say")]
    for name in fit.names:
        low, high = fit.interval[name]
        ends = f"{low:.4g} to {high:.4g}"
        rows.append((name, f"{fit.estimate[name]:.5g}", ends, fit.identifiability[name]))
    places = np.cumsum(
        [0.0, *(CHARACTER * max(len(row[c]) for row in rows) + 0.3 for c in range(3))]
    )
    room = max(20, int((WIDE - places[3]) / CHARACTER))
    lines: list[list[tuple[float, str, dict[str, Any]]]] = []
    for k, row in enumerate(rows):
        known = k == 0 or fit.identifiable[row[0]]
        style = head if k == 0 else {"weight": "bold"}
        first, *more = textwrap.wrap(row[3], room)
        last = head if k == 0 else {} if known else {"color": COLORS["backward"]}
        lines.append(
            [
                (places[0], row[0], style if k else head),
                (places[1], row[1], style),
                (places[2], row[2], head if k == 0 else {}),
                (places[3], first, last),
            ]
        )
        lines += [[(places[3], rest, last)] for rest in more]
    lines.append([])
    points = sum(m.size for m in fit.measured)
    measurements = f" in {len(fit.measured)} measurements" if len(fit.measured) > 1 else ""
    lines.append(
        [
            (
                0.0,
                f"reduced chi-square {fit.reduced_chi_square:.3f} ({fit.degrees_of_freedom} "
                f"degrees of freedom), {points} points{measurements}",
                {},
            )
        ]
    )
    for warning in fit.warnings[:MOST_WARNINGS]:
        # The first sentence: the others are in the report.
        words = f"Warning: {warning.partition('. ')[0].rstrip('.')}."
        wrapped = textwrap.wrap(words, int(WIDE / CHARACTER), subsequent_indent="   ")
        lines += [[(0.0, line, {"color": COLORS["backward"]})] for line in wrapped]
    more = len(fit.warnings) - MOST_WARNINGS
    if more > 0:
        words = f"and {more} more warning{'s' * (more > 1)}: print the fit to read them."
        lines.append([(0.0, words, {"color": COLORS["backward"]})])
    return lines


def _write(axes: Axes, lines: list[list[tuple[float, str, dict[str, Any]]]]) -> None:
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


def plot_profile(profile: Profile) -> Figure:
    """Draw the rise of chi-square against the number that was held."""
    figure, axes = new_picture()
    _draw_profile(axes, profile)
    axes.set_ylabel("Rise of chi-square, others refitted", fontsize=LABEL)
    _set_height(axes, [profile])
    outside_legend(axes, *_profile_legend([profile]))
    return figure


def plot_profiles(profiles: Sequence[Profile]) -> Figure:
    """Draw several profiles side by side. Raises `ValueError` when there is none."""
    profiles = list(profiles)
    if not profiles:
        raise ValueError("profiles is empty: give at least one profile.")
    columns = min(len(profiles), 3 if len(profiles) != 4 else 2)
    rows = -(-len(profiles) // columns)
    margins = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)
    size = (SIZE[0], 3.1 * rows + 0.9)
    figure = Picture(figsize=size, dpi=DPI, layout=margins)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for k, axes in enumerate(panels.flat):
        if k >= len(profiles):
            axes.set_axis_off()
            continue
        _dress(axes)
        _draw_profile(axes, profiles[k])
        if k + columns >= len(profiles):
            axes.tick_params(labelbottom=True)
    for row in panels:
        row[0].set_ylabel("Rise of chi-square", fontsize=LABEL)
    _set_height(panels[0, 0], profiles)
    outside_legend(panels[0, 0], *_profile_legend(profiles))
    return figure


def _draw_profile(axes: Axes, profile: Profile) -> None:
    values, rise = np.asarray(profile.values, float), np.asarray(profile.rise, float)
    logarithmic = values.min() > 0 and values.max() > 10 * values.min()
    inside, outside = (np.log, np.exp) if logarithmic else (np.asarray, np.asarray)
    # Roots of the rise are nearly straight: what lies between the values is drawn by them.
    known, root = values, np.sqrt(np.maximum(rise, 0.0)) * np.sign(values - profile.estimate)
    if profile.estimate not in values and values[0] < profile.estimate < values[-1]:
        place = int(np.searchsorted(values, profile.estimate))
        known, root = np.insert(values, place, profile.estimate), np.insert(root, place, 0.0)
    at = inside(known)
    between = np.linspace(at[0], at[-1], 40 * len(at))
    color = COLORS["forward"]
    axes.plot(outside(between), np.interp(between, at, root) ** 2, color=color, linewidth=1.8)
    axes.plot(values, rise, "o", color=color, markersize=6)
    axes.axvspan(*profile.interval, color=color, alpha=0.13, linewidth=0, zorder=0.5)
    axes.axhline(profile.threshold, color=COLORS["backward"], linestyle=DASHES, linewidth=1.5)
    axes.axvline(profile.estimate, color=GREY, linestyle=":", linewidth=1.5)
    if logarithmic:
        axes.set_xscale("log")
    low, high = profile.interval
    axes.set_title(
        f"{profile.estimate:.4g}  ({low:.4g} to {high:.4g})", fontsize=SMALL, loc="left", color=GREY
    )
    axes.set_xlabel(f"{profile.name} (SI)", fontsize=LABEL)


def _set_height(axes: Axes, profiles: list[Profile]) -> None:
    """Show all of the rise, or what is of interest where it is huge."""
    threshold = max(p.threshold for p in profiles)
    highest = max(float(np.max(p.rise)) for p in profiles)
    top = 1.06 * min(max(highest, 1.3 * threshold), 6 * threshold)
    axes.set_ylim(-0.03 * top, top)


def _profile_legend(profiles: list[Profile]) -> tuple[list[Artist], list[str]]:
    first = profiles[0]
    percent = f"{100 * first.confidence:g} %"
    lines: list[Artist] = [
        Line2D([], [], color=COLORS["forward"], marker="o", markersize=6, linewidth=1.8),
        Line2D([], [], color=COLORS["backward"], linestyle=DASHES, linewidth=1.5),
        Patch(color=COLORS["forward"], alpha=0.13, linewidth=0),
        Line2D([], [], color=GREY, linestyle=":", linewidth=1.5),
    ]
    limit = f"{percent} threshold, {first.threshold:.3g}"
    return lines, ["others refitted", limit, f"{percent} interval", "estimate"]
