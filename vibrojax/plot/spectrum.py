"""Picture of a spectrum with its lines named."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.style import (
    COLORS,
    GREY,
    SMALL,
    Key,
    label_for,
    name_axes,
    new_picture,
    outside_legend,
)

DEPTH = 100.0
"""dB shown below the largest value, at most."""
ROOM = 0.12
"""Share of the height above the largest value, for the numbers of the peaks."""
APART = 0.013
"""Least distance of two numbers side by side, over the width."""


def plot_spectrum(spectrum: xarray.Dataset, peaks: Sequence[Any], count: int) -> Figure:
    """Draw a spectrum, its `count` largest peaks numbered and named below the axes.

    A peak has a frequency, an amplitude and a name, the largest comes first; one right beside a
    larger one has no room for a number and is passed over. Dashed lines are the natural frequencies
    out of contact, the dotted one is the drive.
    """
    figure, axes = new_picture()
    frequency, settings = spectrum["frequency"].values, spectrum.attrs
    axes.plot(frequency, spectrum["amplitude"], color=COLORS["blue"], linewidth=1.2)
    axes.set_xlim(0.0, float(frequency[-1]))
    _set_height(axes, spectrum["amplitude"].values, settings["scaling"] in ("peak", "rms"))
    _mark_modes(axes, spectrum["natural_frequency"].values, float(frequency[-1]))
    key: Key = {}
    drive = settings.get("drive_frequency", np.inf)
    if drive <= frequency[-1]:
        style = {"color": COLORS["orange"], "linestyle": (0, (1, 2)), "linewidth": 1.6}
        axes.axvline(drive, **style, zorder=0.5)
        key[f"drive frequency, {drive:.5g} Hz"] = Line2D([], [], **style)
    shown = _apart(peaks, APART * float(frequency[-1]))[:count]
    for number, peak in enumerate(sorted(shown), start=1):
        _write_above(axes, f"{number}", (peak[0], peak[1]), "data", fontweight="bold")
        style = {"color": "black", "markeredgewidth": 0.3, "markersize": 7, "linestyle": "none"}
        words = f"{peak[0]:.5g} Hz: {peak[2] if peak[2] != '-' else 'not named'}"
        key[words] = Line2D([], [], marker=f"${number}$", **style)
    what, how = label_for(spectrum["amplitude"]).rsplit(", ", 1)
    place = f" at x/L = {settings['position']:g}" if "position" in settings else ""
    name_axes(axes, label_for(spectrum["frequency"]), f"{what}{place},\n{how}")
    axes.set_title(_title(settings), fontsize=SMALL, loc="left", pad=22)
    outside_legend(figure, key)
    return figure


def _apart(peaks: Sequence[Any], least: float) -> list[Any]:
    """Return the peaks that have room for a number."""
    chosen: list[Any] = []
    for peak in peaks:
        if all(abs(peak[0] - other[0]) >= least for other in chosen):
            chosen.append(peak)
    return chosen


def _title(settings: dict[str, Any]) -> str:
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


def _mark_modes(axes: Axes, natural: np.ndarray, highest: float) -> None:
    """Draw the natural frequencies, named above the axes."""
    above = axes.get_xaxis_transform()
    for mode, frequency in enumerate(natural, start=1):
        if frequency <= highest:
            axes.axvline(frequency, color=GREY, linestyle=(0, (6, 3)), linewidth=0.9, zorder=0.5)
            _write_above(axes, f"mode {mode}", (frequency, 1.0), above, color=GREY)


def _write_above(axes: Axes, words: str, place: tuple, coordinates: Any, **style: Any) -> None:
    axes.annotate(
        words,
        place,
        xycoords=coordinates,
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=SMALL,
        **style,
    )
