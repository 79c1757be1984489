"""Picture of a spectrum with its lines named."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax._tools.checks import check_count
from vibrojax.plot.style import COLORS, GREY, LABEL, SMALL, new_picture, outside_legend

if TYPE_CHECKING:
    from vibrojax.history.spectrum import SpectralPeak, Spectrum

DRIVE = "#d1590a"
DEPTH = 100.0
"""dB shown below the largest value, at most."""
ROOM = 0.12
"""Share of the height above the largest value, for the numbers of the peaks."""
APART = 0.013
"""Least distance of two numbers side by side, over the width."""


def plot_spectrum(spectrum: "Spectrum", count: int = 8) -> Figure:
    """Draw a spectrum, its `count` largest peaks numbered and named below the axes.

    A peak right beside a larger one has no room for a number and is passed over. Dashed lines are
    the natural frequencies out of contact, the dotted one is the drive. Raises `ValueError` for a
    count below 1.
    """
    check_count("count", count)
    figure, axes = new_picture()
    axes.plot(spectrum.frequency, spectrum.amplitude, color=COLORS["forward"], linewidth=1.2)
    axes.set_xlim(0.0, float(spectrum.frequency[-1]))
    _set_height(axes, spectrum)
    _mark_modes(axes, spectrum)
    handles, labels = [], []
    drive = spectrum.drive_frequency
    if drive is not None and drive <= spectrum.frequency[-1]:
        style = {"color": DRIVE, "linestyle": (0, (1, 2)), "linewidth": 1.6}
        axes.axvline(drive, **style, zorder=0.5)
        handles.append(Line2D([], [], **style))
        labels.append(f"drive frequency, {drive:.5g} Hz")
    for number, peak in enumerate(_choose_peaks(spectrum, count), start=1):
        axes.annotate(
            f"{number}",
            (peak.frequency, peak.amplitude),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=SMALL,
            fontweight="bold",
        )
        style = {"color": "black", "markeredgewidth": 0.3, "markersize": 7}
        handles.append(Line2D([], [], linestyle="none", marker=f"${number}$", **style))
        labels.append(f"{peak.frequency:.5g} Hz: {peak.name if peak.name != '-' else 'not named'}")
    axes.set_xlabel("Frequency [Hz]", fontsize=LABEL)
    axes.set_ylabel(_value_label(spectrum), fontsize=LABEL)
    axes.set_title(_title(spectrum), fontsize=SMALL, loc="left", pad=22)
    if handles:
        outside_legend(axes, handles, labels)
    return figure


def _choose_peaks(spectrum: "Spectrum", count: int) -> "list[SpectralPeak]":
    """Return the largest peaks that have room for a number, by frequency."""
    least = APART * float(spectrum.frequency[-1])
    chosen: list[SpectralPeak] = []
    for peak in spectrum.peaks(len(spectrum.frequency)):
        if all(abs(peak.frequency - other.frequency) >= least for other in chosen):
            chosen.append(peak)
    return sorted(chosen[:count])


def _value_label(spectrum: "Spectrum") -> str:
    from vibrojax.history.quantities import unit_and_label
    from vibrojax.history.spectrum import SCALINGS

    place = "" if spectrum.position is None else f" at x/L = {spectrum.position:g}"
    _, label = unit_and_label(spectrum.quantity)
    return f"{label}{place},\n{SCALINGS[spectrum.scaling]} [{spectrum.units}]"


def _title(spectrum: "Spectrum") -> str:
    segments = f"one segment of {spectrum.segment:.4g} s"
    if spectrum.averages > 1:
        segments = (
            f"{spectrum.averages} averages of {spectrum.segment:.4g} s, "
            f"{100 * spectrum.overlap:.3g} % overlap"
        )
    return (
        f"Window {spectrum.window}, {segments}, resolution {spectrum.resolution:.3g} Hz "
        f"(noise bandwidth {spectrum.noise_bandwidth:.3g} Hz)"
    )


def _set_height(axes: Axes, spectrum: "Spectrum") -> None:
    """Show amplitudes in logarithms, without the round-off far below, with room for numbers."""
    shown = spectrum.amplitude[spectrum.amplitude > 0]
    if not len(shown):
        return  # nothing moves: no logarithm
    axes.set_yscale("log")
    top = float(np.max(shown))
    depth = DEPTH / (10 if spectrum.is_power else 20)
    # A few deep gaps between the lines must not set the scale.
    bottom = max(float(np.percentile(shown, 1)) / 2, top * 10**-depth)
    axes.set_ylim(bottom, top * max(top / bottom, 10.0) ** ROOM)


def _mark_modes(axes: Axes, spectrum: "Spectrum") -> None:
    """Draw the natural frequencies, named above the axes."""
    for mode, natural in enumerate(spectrum.natural_frequencies, start=1):
        if natural > spectrum.frequency[-1]:
            continue
        axes.axvline(natural, color=GREY, linestyle=(0, (6, 3)), linewidth=0.9, zorder=0.5)
        axes.annotate(
            f"mode {mode}",
            (natural, 1.0),
            xycoords=axes.get_xaxis_transform(),
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            fontsize=SMALL,
            color=GREY,
        )
