"""Pictures of signals over time: of one history below each other, of several together."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from vibrojax.plot.style import (
    COLORS,
    FRAME,
    LINE_STYLES,
    SIZE,
    finish,
    key_of,
    name_axes,
    new_panels,
    new_picture,
    outside_legend,
    shades,
    within,
)
from vibrojax.results.variables import with_unit

LOWEST = 1.75
"""Least height of a panel, inches."""
SMALLER = {"m": ("mm", 1e-3), "J": ("mJ", 1e-3), "W": ("mW", 1e-3)}
"""Units of axes in which the numbers of small rigs are short."""
STOPS = ("blue", "orange", "green", "pink")


class Signal(NamedTuple):
    """What one panel shows."""

    values: np.ndarray
    """Over time; with a second axis, several lines."""
    units: str
    long_name: str
    names: tuple[str, ...] = ()
    """Of several lines."""


def plot_signals(time: np.ndarray, signals: Sequence[Signal]) -> Figure:
    """Draw signals against time, one below the other: in thousandths where they are small."""
    height = max(LOWEST, (SIZE[1] - FRAME) / len(signals))
    figure, panels = new_panels([height] * len(signals))
    for panel, signal in zip(panels, signals, strict=True):
        values, units = signal.values, signal.units
        if units in SMALLER and np.max(np.abs(values), initial=0.0) < 0.1:
            units, factor = SMALLER[units]
            values = values / factor
        columns = values.reshape(len(time), -1).T
        for k, column in enumerate(columns):
            label = signal.names[k] if len(columns) > 1 else None
            panel.plot(time, column, color=COLORS[STOPS[k % 4]], linewidth=0.9, label=label)
        name_axes(panel, None, within(with_unit(signal.long_name, units), height))
    panels[-1].set_xlim(float(time[0]), float(time[-1]))
    name_axes(panels[-1], "Time (s)", None)
    outside_legend(figure, key_of(*panels))
    return figure


def plot_histories(
    lines: Sequence[tuple[np.ndarray, np.ndarray, str]], label: str, title: str
) -> Figure:
    """Draw a quantity of several histories: times, values and what the legend says of each."""
    figure, axes = new_picture()
    for k, (line, color) in enumerate(zip(lines, shades(len(lines)), strict=True)):
        time, values, words = line
        style = LINE_STYLES[k % len(LINE_STYLES)]
        axes.plot(time, values, color=color, linestyle=style, linewidth=1.5, label=words or None)
    return finish(figure, axes, "Time (s)", label, key_of(axes), title)
