"""Pictures of histories: signals over time, contacts, energy, cycles, sections and spectra."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.plot.style import (
    COLORS,
    FRAME,
    GREY,
    SERIES,
    SIZE,
    SMALL,
    SYMBOLS,
    finish,
    label_for,
    line_styles,
    name_axes,
    new_panels,
    new_picture,
    outside_legend,
    show_zero,
    within,
)
from vibrojax.results.variables import with_unit

LOWEST = 1.75
"""Least height of a panel of a signal, inches."""
SMALLER = {"m": ("mm", 1e-3), "J": ("mJ", 1e-3), "W": ("mW", 1e-3)}
"""Units in which the numbers of small rigs are short."""
STOPS = ("blue", "orange", "green", "pink")
TABLE = 2.6
"""Height of a panel of a column of contacts, inches."""
MOST_POINTS = 4000
"""Samples that a picture of the energy shows; of more, every so manyth."""
LEAST_SHARE = 1e-5
"""Share of the energy at the bottom of a logarithmic axis."""
SHOWN = 1.6
"""Drive periods shown above the highest order, at least."""
ORDER: dict[str, Any] = {"color": GREY, "linewidth": 1.0, "linestyle": (0, (6, 3))}
DEPTH = 100.0
"""dB of a spectrum shown below the largest value, at most."""
ROOM = 0.12
"""Share of the height of a spectrum above the largest value, for the numbers of the peaks."""
APART = 0.013
"""Least distance of two numbers of peaks, over the width."""

Signal = tuple[np.ndarray, str, str]
"""Values over time (over stops too, where there is a second axis), unit and long name."""


def plot_signals(time: np.ndarray, signals: Sequence[Signal]) -> Figure:
    """Draw signals against time, one below the other: in thousandths where they are small."""
    height = max(LOWEST, (SIZE[1] - FRAME) / len(signals))
    figure, panels = new_panels([height] * len(signals))
    for panel, (values, units, long_name) in zip(panels, signals, strict=True):
        if units in SMALLER and np.max(np.abs(values), initial=0.0) < 0.1:
            units, factor = SMALLER[units]
            values = values / factor
        columns = values.reshape(len(time), -1).T
        for k, column in enumerate(columns):
            label = f"stop {k + 1}" if len(columns) > 1 else None
            panel.plot(time, column, color=COLORS[STOPS[k % 4]], linewidth=0.9, label=label)
        name_axes(panel, None, within(with_unit(long_name, units), height))
    panels[-1].set_xlim(float(time[0]), float(time[-1]))
    name_axes(panels[-1], "Time (s)")
    return outside_legend(figure)


def plot_histories(
    lines: Sequence[tuple[np.ndarray, np.ndarray, str]], label: str, title: str
) -> Figure:
    """Draw a quantity of several histories: times, values and what the legend says of each."""
    _, axes = new_picture()
    for (time, values, words), style in zip(lines, line_styles(len(lines)), strict=True):
        axes.plot(time, values, linewidth=1.5, label=words or None, **style)
    return finish(axes, "Time (s)", label, title)


def plot_contacts(contacts: xarray.Dataset, names: Sequence[str]) -> Figure:
    """Draw columns of the table against the time of touch, one panel each."""
    figure, panels = new_panels([TABLE] * len(names))
    stops = np.unique(contacts["stop"])
    for panel, name in zip(panels, names, strict=True):
        for k, stop in enumerate(stops):
            own = contacts["stop"].values == stop
            color = SERIES[k % len(SERIES)]
            style: dict[str, Any] = {
                "color": color,
                "linestyle": "none",
                "marker": SYMBOLS[k % len(SYMBOLS)],
                "markerfacecolor": "white" if k % 2 else color,
                "label": f"stop {stop}" if len(stops) > 1 else None,
            }
            touch, values = contacts["touch"].values[own], contacts[name].values[own]
            panel.plot(touch, values, markersize=6, **style)
        name_axes(panel, None, within(label_for(contacts[name]), TABLE))
        if np.nanmin(contacts[name].values, initial=0.0) >= 0:
            show_zero(panel)
    name_axes(panels[-1], label_for(contacts["touch"]))
    return outside_legend(figure)


def plot_energy(energy: xarray.Dataset, kind: str) -> Figure:
    """Draw the share of every mode, and below it what was lost and put in."""
    shown = energy.isel(time=slice(None, None, max(1, energy.sizes["time"] // MOST_POINTS)))
    time, share = shown["time"].values, shown["share"].values.T
    figure, (top, bottom) = new_panels([2.9, 2.9])
    names = [f"mode {i + 1}" for i in range(len(share))]
    colors = [SERIES[i % len(SERIES)] for i in range(len(share))]
    if kind == "stacked":
        top.stackplot(time, share, labels=names, colors=colors)
        top.set_ylim(0.0, 1.0)
    else:
        for name, color, values in zip(names, colors, share, strict=True):
            top.semilogy(time, np.maximum(values, LEAST_SHARE / 10), label=name, color=color)
        top.set_ylim(LEAST_SHARE, 1.5)
    name_axes(top, None, "Share of the energy")
    lines = [("lost in the body", shown["beam_loss"].sum("mode"), "black", "-")]
    losses = shown["contact_loss"].values.T
    for s, values in enumerate(losses):
        name = "lost in the stop" if len(losses) == 1 else f"lost in stop {s + 1}"
        lines.append((name, values, "orange", ("-", "-.", ":")[s % 3]))
    if np.any(shown["input_work"]):
        lines.append(("put in by the drive", shown["input_work"], "blue", "--"))
    held = shown["modal_energy"].sum("mode") + shown["stop_energy"].sum("stop")
    lines.append(("held by body and stops", held, "middle", "-"))
    for name, values, color, style in lines:
        bottom.plot(time, values, label=name, color=COLORS[color], linestyle=style)
    name_axes(bottom, label_for(shown["time"]), "Energy (J)")
    top.set_xlim(time[0], time[-1])
    return outside_legend(figure)


def plot_cycles(cycles: xarray.Dataset, orders: Sequence[int], quantity: str) -> Figure:
    """Draw the lengths of cycles of a quantity against the drive frequency."""
    _, axes = new_picture()
    frequency, length = cycles["drive_frequency"], cycles["drive_periods"].values
    top = max([order + SHOWN for order in orders] + [SHOWN])
    if len(length):
        top = max(top, float(np.quantile(length, 0.98)) * 1.08)
    over = length > top
    points: dict[str, Any] = {"linestyle": "none", "color": COLORS["blue"], "markersize": 5}
    words = f"a cycle of {quantity} ({len(length)})"
    axes.plot(frequency[~over], length[~over], "o", alpha=0.6, label=words, **points)
    if over.any():
        words, heights = f"longer than shown ({over.sum()})", np.full(over.sum(), 0.99 * top)
        axes.plot(frequency[over], heights, "^", markerfacecolor="white", label=words, **points)
    words = f"{', '.join(map(str, orders))} drive period{'' if list(orders) == [1] else 's'}"
    for order in orders:
        axes.axhline(order, zorder=0.9, label=words, **ORDER)
    axes.set_ylim(0.0, top)
    axes.set_yticks(np.arange(0, np.ceil(top), 1 if top < 16 else 5))
    return finish(axes, label_for(frequency), "Length of the cycle (drive periods)")


def plot_section(section: xarray.Dataset, x: str, y: str) -> Figure:
    """Draw one variable of a Poincaré section against another."""
    _, axes = new_picture()
    size = 6.0 if section.sizes["point"] < 200 else 3.0
    dots = {"color": COLORS["blue"], "markersize": size, "markeredgewidth": 0, "alpha": 0.7}
    axes.plot(section[x], section[y], "o", **dots)
    return finish(axes, label_for(section[x]), label_for(section[y]), section.attrs["section"])


def plot_spectrum(spectrum: xarray.Dataset, peaks: Sequence[Any], count: int) -> Figure:
    """Draw a spectrum, its `count` largest peaks numbered and named below the axes.

    A peak has a frequency, an amplitude and a name, the largest comes first; one right beside a
    larger one has no room for a number and is passed over. Dashed lines are the natural frequencies
    out of contact, the dotted one is the drive.
    """
    _, axes = new_picture()
    frequency, settings = spectrum["frequency"].values, spectrum.attrs
    highest = float(frequency[-1])
    axes.plot(frequency, spectrum["amplitude"], color=COLORS["blue"], linewidth=1.2)
    axes.set_xlim(0.0, highest)
    _set_height(axes, spectrum["amplitude"].values, settings["scaling"] in ("peak", "rms"))
    for mode, natural in enumerate(spectrum["natural_frequency"].values, start=1):
        if natural <= highest:
            axes.axvline(natural, zorder=0.5, **(ORDER | {"linewidth": 0.9}))
            above = axes.get_xaxis_transform()
            _write_above(axes, f"mode {mode}", (natural, 1.0), xycoords=above, color=GREY)
    drive = settings.get("drive_frequency", np.inf)
    if drive <= highest:
        style = {"color": COLORS["orange"], "linestyle": (0, (1, 2)), "linewidth": 1.6}
        axes.axvline(drive, zorder=0.5, label=f"drive frequency, {drive:.5g} Hz", **style)
    shown: list[Any] = []
    for peak in peaks:
        if all(abs(peak[0] - other[0]) >= APART * highest for other in shown):
            shown.append(peak)
    for number, peak in enumerate(sorted(shown[:count]), start=1):
        _write_above(axes, f"{number}", (peak[0], peak[1]), fontweight="bold")
        style = {"color": "black", "markeredgewidth": 0.3, "linestyle": "none"}
        words = f"{peak[0]:.5g} Hz: {peak[2] if peak[2] != '-' else 'not named'}"
        axes.plot([], [], marker=f"${number}$", label=words, **style)
    what, how = label_for(spectrum["amplitude"]).rsplit(", ", 1)
    place = f" at x/L = {settings['position']:g}" if "position" in settings else ""
    axes.set_title(_analysis(settings), fontsize=SMALL, loc="left", pad=22)
    return finish(axes, label_for(spectrum["frequency"]), f"{what}{place},\n{how}")


def _analysis(settings: dict[str, Any]) -> str:
    segments = f"one segment of {settings['segment']:.4g} s"
    if settings["averages"] > 1:
        segments = (
            f"{settings['averages']} averages of {settings['segment']:.4g} s, "
            f"{100 * settings['overlap']:.3g} % overlap"
        )
    return (
        f"Window {settings['window']}, {segments}, resolution {settings['resolution']:.3g} Hz "
        f"(noise bandwidth {settings['noise_bandwidth']:.3g} Hz)"
    )


def _set_height(axes: Axes, values: np.ndarray, is_amplitude: bool) -> None:
    """Show amplitudes in logarithms, without the round-off far below, with room for numbers."""
    shown = values[values > 0]
    if not len(shown):
        return  # nothing moves: no logarithm
    axes.set_yscale("log")
    top = float(np.max(shown))
    depth = DEPTH / (20 if is_amplitude else 10)
    # A few deep gaps between the lines must not set the scale.
    bottom = max(float(np.percentile(shown, 1)) / 2, top * 10**-depth)
    axes.set_ylim(bottom, top * max(top / bottom, 10.0) ** ROOM)


def _write_above(axes: Axes, words: str, place: tuple, **style: Any) -> None:
    offset = {"xytext": (0, 3), "textcoords": "offset points", "ha": "center", "va": "bottom"}
    axes.annotate(words, place, fontsize=SMALL, **(offset | style))


def plot_shock(spectrum: xarray.Dataset) -> Figure:
    """Draw a shock response spectrum on logarithmic axes."""
    _, axes = new_picture()
    names = {"maximax": ("larger of both", "-", 2.0), "positive": ("positive", "--", 1.3)}
    names["negative"] = ("negative", ":", 1.6)
    colors = dict(zip(names, ("black", "blue", "orange"), strict=True))
    for name, (words, style, width) in names.items():
        values = np.where(spectrum[name] > 0, spectrum[name], np.nan)
        line: dict[str, Any] = {"linestyle": style, "linewidth": width}
        line |= {"color": COLORS[colors[name]], "marker": None if len(values) > 1 else "o"}
        axes.loglog(spectrum["frequency"], values, label=words, **line)
    damping = f"Damping ratio of the oscillators {spectrum.attrs['damping_ratio']:g}"
    return finish(axes, label_for(spectrum["frequency"]), label_for(spectrum["maximax"]), damping)
