"""Spectra as a signal analyser shows them, and what their lines are called.

Windowed segments, overlapping, whose powers are averaged linearly: `scipy.signal.welch`. An
analyser filters what lies above its span before it samples; a history is sampled faster instead.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import (
    check_choice,
    check_count,
    check_not_negative,
    check_positive,
    check_range,
    nearest,
)
from vibrojax._tools.signatures import validated
from vibrojax.history.quantities import (
    QUANTITIES,
    dataset,
    numbered,
    unit_and_label,
    unit_for,
)
from vibrojax.results.variables import VARIABLES

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

SCALINGS = {
    "peak": "peak amplitude",
    "rms": "rms amplitude",
    "power": "mean square",
    "density": "power spectral density",
    "energy_density": "energy spectral density",
}
WINDOWS = ("hann", "flattop", "boxcar", "hamming", "blackman", "blackmanharris", "nuttall")
"""Those that a refusal names; scipy knows more."""
FEWEST = 8  # samples of a segment
LARGEST_DENOMINATOR, LARGEST_SIDEBAND, LARGEST_MULTIPLE = 5, 4, 10


class SpectralPeak(NamedTuple):
    """A line of a spectrum and what it is called, in words and in numbers."""

    frequency: float
    """Hz, refined between the lines of the spectrum."""
    amplitude: float
    """In the units of the spectrum, refined likewise."""
    name: str = "-"
    """`3 x drive`, `mode 2 - 1 x drive`, ...; `-` where nothing fits."""
    drive_order: float | None = None
    """Multiple of the drive, when it is a harmonic (3.0) or subharmonic (0.5)."""
    mode: int | None = None
    """Mode it lies at or belongs to, from 1."""
    sideband: int | None = None
    """How many drive frequencies above that mode; 0 at the mode itself."""


Name = tuple[str, float | None, int | None, int | None]
"""The last four of a `SpectralPeak`."""
Candidate = tuple[float, float, int, Name]
"""Where a line so named would be, within how much (Hz), a rank (lowest first), the name."""


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum:
    """Spectrum of one quantity, with the settings it was made with."""

    frequency: Float[np.ndarray, " frequencies"]
    """Hz."""
    amplitude: Float[np.ndarray, " frequencies"]
    """Values in the sense of `scaling`; for `peak` a sine of amplitude 1 shows as 1."""
    quantity: str
    """What the spectrum is of."""
    units: str
    """Of the values: `g`, `g2/Hz`, ..."""
    scaling: str
    """`peak`, `rms`, `power`, `density` or `energy_density`."""
    window: str
    """Name of the window, as `scipy.signal.get_window` knows it."""
    segment: float
    """Length of a segment, s."""
    overlap: float
    """Share of a segment that the next one has too."""
    averages: int
    """Segments whose powers were averaged."""
    resolution: float
    """Distance of the lines, Hz: 1 over the segment."""
    noise_bandwidth: float
    """Effective noise bandwidth of the window, Hz."""
    drive_frequency: float | None
    """Hz; None when nothing drives or the drive is not `Harmonic`."""
    natural_frequencies: Float[np.ndarray, " modes"]
    """Hz, of the system out of contact; empty where it has none."""
    position: float | None = None
    """x/L; None: where the system reports, the tip of a beam, or no place at all."""

    @property
    def is_power(self) -> bool:
        """Whether the values are squares of amplitudes."""
        return self.scaling not in ("peak", "rms")

    @validated
    def decibels(self, reference: float | int = 1.0) -> Float[np.ndarray, " frequencies"]:
        """Return the values in dB; 0 becomes -inf.

        `reference` is in the unit of the amplitude (1e-6 m/s2, say) and squared where the values
        are powers. Raises `ValueError` unless it is above 0.
        """
        check_positive("reference", reference, "(unit of the amplitude)")
        factor, level = (10, reference**2) if self.is_power else (20, reference)
        with np.errstate(divide="ignore"):
            return factor * np.log10(self.amplitude / level)

    @validated
    def up_to(self, span: float | int) -> "Spectrum":
        """Return the spectrum up to `span`, Hz. Raises `ValueError` when it does not reach it."""
        highest = float(self.frequency[-1])
        check_range(
            "span",
            span,
            0.0,
            highest + self.resolution / 2,  # lines end half a one early where their number is odd
            include_low=False,
            allowed=f"above 0 and at most {highest:.6g} Hz, where the spectrum ends",
            advice="It reaches half the sampling rate: simulate with a higher sampling_rate.",
        )
        kept = self.frequency <= span * (1 + 1e-9)
        return replace(self, frequency=self.frequency[kept], amplitude=self.amplitude[kept])

    @validated
    def peaks(
        self, count: int = 10, *, threshold: float | int = 60.0, prominence: float | int = 6.0
    ) -> list[SpectralPeak]:
        """Return the `count` largest lines, largest first, each with its name.

        Lines are local maxima that stand out by `prominence` (dB) and lie at most `threshold` (dB)
        below the largest of them, refined by a parabola through three values in dB. Names: see
        `name_frequency`; without a drive the largest line within a fifth of the first natural
        frequency is the first mode. Raises `ValueError` for a count below 1 or negative dB.
        """
        from scipy.signal import find_peaks

        check_count("count", count)
        check_not_negative("threshold", threshold, "dB")
        check_not_negative("prominence", prominence, "dB")
        levels = self.decibels()
        # Round-off has peaks too, and a silent line no finite level.
        at, _ = find_peaks(np.maximum(levels, np.max(levels) - 200), prominence=prominence)
        at = at[levels[at] >= np.max(levels[at], initial=-np.inf) - threshold]
        lines: list[tuple[float, float]] = []
        for i in at[np.argsort(-levels[at])]:
            # Beside a line that fits the segment exactly there is only round-off.
            low, top, high = np.maximum(levels[i - 1 : i + 2], levels[i] - threshold - 20)
            bend = low - 2 * top + high
            shift = 0.5 * (low - high) / bend if bend < 0 else 0.0
            value = 10 ** ((top - 0.25 * (low - high) * shift) / (10 if self.is_power else 20))
            lines.append((float(self.frequency[i] + shift * self.resolution), float(value)))
        drive, modes = self.drive_frequency, self.natural_frequencies
        if drive is None and len(modes):
            first = [f for f, _ in lines if abs(f - modes[0]) <= modes[0] / 5]
            modes = np.concatenate([first[:1] or modes[:1], modes[1:]])  # contact moved it
        return [name_frequency(f, a, self.resolution, drive, modes) for f, a in lines[:count]]

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over frequency, with units, long names and settings as attributes."""
        label = f"{unit_and_label(self.quantity)[1]}, {SCALINGS[self.scaling]}"
        natural = "Natural frequencies out of contact"
        arrays = ("frequency", "amplitude", "natural_frequencies")
        return dataset(
            {
                "amplitude": ("frequency", self.amplitude, self.units, label),
                "natural_frequency": ("mode", self.natural_frequencies, "Hz", natural),
                "frequency": ("frequency", self.frequency, "Hz", "Frequency"),
            },
            numbered("mode", len(self.natural_frequencies)),
            {k: v for k, v in vars(self).items() if k not in arrays and v is not None},
        )

    @validated
    def plot(self, span: float | int | None = None, count: int = 8) -> "Figure":
        """Draw it up to `span` (Hz), with its `count` largest peaks named.

        Raises `ValueError` for a count below 1, or a span beyond the spectrum.
        """
        check_count("count", count)
        shown = self if span is None else self.up_to(span)
        from vibrojax.plot.history import plot_spectrum

        return plot_spectrum(shown.to_xarray(), shown.peaks(len(shown.frequency)), count)

    def __repr__(self) -> str:
        return (
            f"Spectrum({self.quantity}, {SCALINGS[self.scaling]} [{self.units}], {self.window}, "
            f"{self.averages} x {self.segment:.4g} s, lines of {self.resolution:.4g} Hz up to "
            f"{self.frequency[-1]:.6g} Hz)"
        )


def name_frequency(
    frequency: float,
    amplitude: float,
    resolution: float,
    drive_frequency: float | None = None,
    natural_frequencies: Float[np.ndarray, " modes"] | Sequence[float] = (),
) -> SpectralPeak:
    """Name a peak at `frequency` (Hz) of a spectrum with lines `resolution` (Hz) apart.

    With a drive, the first that fits: a harmonic of it (within the resolution, at most a twentieth
    of the drive), which also says the mode within half a drive frequency, or of which mode it is
    the sideband; a subharmonic down to 1/5; a mode; a mode plus or minus up to 4 drive frequencies;
    else `-`. Without one: a mode, a multiple of the first mode up to 10, else `-`.

    Natural frequencies (Hz) are those out of contact, which stops raise: modes are looked for
    within the resolution and half a percent (2 % without a drive), so the name of a mode is a
    coincidence of frequencies, not a proof. Names that fit equally well are joined by `or`.
    """
    modes = np.asarray(natural_frequencies, dtype=float)
    if drive_frequency is None:
        name = _name_free(frequency, resolution, modes)
    else:
        name = _name_driven(frequency, resolution, drive_frequency, modes)
    return SpectralPeak(frequency, amplitude, *name)


def _name_driven(frequency: float, resolution: float, drive: float, modes: np.ndarray) -> Name:
    near = min(resolution, drive / 20)
    for denominator in range(1, LARGEST_DENOMINATOR + 1):
        order = round(frequency * denominator / drive)
        # More multiples of smaller parts lie about: each must be met more closely.
        off = abs(frequency - order * drive / denominator)
        if order >= 1 and off <= near / denominator:
            return _name_multiple(order, denominator, drive, resolution, modes)
    candidates: list[Candidate] = []
    for i, natural in enumerate(modes):
        within = min(resolution + 0.005 * natural, drive / 10)
        for k in range(-LARGEST_SIDEBAND, LARGEST_SIDEBAND + 1):
            part = f" {'+' if k > 0 else '-'} {abs(k)} x drive" if k else ""
            name = (f"mode {i + 1}{part}", None, i + 1, k)
            candidates.append((natural + k * drive, within, abs(k), name))
    return _best(frequency, candidates)


def _name_multiple(
    order: int, denominator: int, drive: float, resolution: float, modes: np.ndarray
) -> Name:
    """Name a multiple of the drive, with the mode that it is near or a sideband of."""
    ratio = order / denominator
    times = f"{order}" if denominator == 1 else f"{order}/{denominator}"
    name = "drive" if ratio == 1 else f"{times} x drive"
    off, i = min(((abs(ratio * drive - f), i) for i, f in enumerate(modes)), default=(np.inf, 0))
    if off <= drive / 2:
        size = f"{off:.{max(0, math.ceil(-math.log10(resolution)))}f}"
        away = f" {'+' if ratio * drive > modes[i] else '-'} {size} Hz" if float(size) else ""
        beside = "" if ratio == 1 else f" (mode {i + 1}{away})"
        return name + beside, ratio, i + 1, 0
    # A mode at the drive itself has no sidebands but the harmonics.
    central = [(i, round(natural / drive)) for i, natural in enumerate(modes)]
    sidebands = [(abs(order - at), i, order - at) for i, at in central if at >= 2]
    distance, i, k = min(sidebands, default=(LARGEST_SIDEBAND + 1, 0, 0))
    if denominator > 1 or distance > LARGEST_SIDEBAND:
        return name, ratio, None, None
    return f"{name} (mode {i + 1}, sideband {k:+d})", ratio, i + 1, k


def _name_free(frequency: float, resolution: float, modes: np.ndarray) -> Name:
    candidates: list[Candidate] = []
    for i, natural in enumerate(modes):
        apart = np.min(np.abs(np.delete(modes, i) - natural), initial=np.inf)
        within = min(resolution + 0.02 * natural, apart / 2)
        candidates.append((natural, within, 0, (f"mode {i + 1}", None, i + 1, 0)))
    for n in range(2, LARGEST_MULTIPLE + 1) if len(modes) else ():
        within = min(resolution + 0.01 * n * modes[0], modes[0] / 8)
        candidates.append((n * modes[0], within, 0, (f"{n} x mode 1", None, 1, None)))
    return _best(frequency, candidates)


def _best(frequency: float, candidates: list[Candidate]) -> Name:
    """Return the name of lowest rank; several of that rank together, the closest first."""
    off = [(rank, abs(frequency - at), name) for at, _, rank, name in candidates]
    near = [fit for fit, (_, within, *_) in zip(off, candidates, strict=True) if fit[1] <= within]
    near = sorted(near, key=lambda fit: fit[:2])
    names = [name for rank, _, name in near if rank == near[0][0]]
    if not names:
        return "-", None, None, None
    return " or ".join(name[0] for name in names), *names[0][1:]


def spectrum_of(
    values: Float[np.ndarray, " samples"],
    rate: float | int,
    *,
    quantity: str = "displacement",
    window: str = "hann",
    segment: float | int | None = None,
    overlap: float | int = 0.5,
    averages: int | None = None,
    scaling: str = "peak",
    span: float | int | None = None,
    units: str | None = None,
    drive_frequency: float | None = None,
    natural_frequencies: Float[np.ndarray, " modes"] | Sequence[float] = (),
    position: float | None = None,
) -> Spectrum:
    """Return the spectrum of samples (SI units) at `rate` per second, measured ones also.

    The other arguments and the errors are those of `History.spectrum`; the last three name lines.
    """
    from scipy.signal import get_window, welch

    if quantity not in VARIABLES:
        check_choice("quantity", quantity, tuple(QUANTITIES))
    check_choice("scaling", scaling, tuple(SCALINGS))
    check_positive("rate", rate, "samples/s")
    check_range("overlap", overlap, 0.0, 1.0, include_high=False, allowed="from 0 to below 1")
    unit, factor = unit_for(quantity, units)
    length, record = len(values), f"{len(values) / rate:.6g} s"
    if segment is not None:
        allowed = f"above 0 and at most {record}, the length of the record"
        advice = "Simulate longer, or give a shorter segment."
        limits = {"low": 0.0, "high": (length + 0.5) / rate, "include_low": False}
        check_range("segment", segment, **limits, allowed=allowed, advice=advice)
        length = round(segment * rate)
    if length < FEWEST:
        raise ValueError(
            f"A segment must have at least {FEWEST} samples, got {length}. Sample faster, or take "
            "a longer segment."
        )
    shared = int(overlap * length)
    count = 1 + (len(values) - length) // (length - shared)
    if averages is not None:
        check_count("averages", averages)
        needed = length + (averages - 1) * (length - shared)
        if needed > len(values):
            raise ValueError(
                f"averages = {averages} segments of {length / rate:.6g} s that overlap by "
                f"{overlap:g} need a record of {needed / rate:.6g} s, got {record}, enough for "
                f"{count}. Simulate longer, or give a shorter segment."
            )
        count, values = averages, values[:needed]
    try:
        weights = np.asarray(get_window(window, length))
    except (ValueError, TypeError):
        raise ValueError(
            f"window must be a name that scipy.signal.get_window knows, without parameters, got "
            f"{window!r}. {nearest(str(window), WINDOWS)}"
        ) from None
    keep: Any = False  # the mean: scipy's annotation knows only names
    how = {"nperseg": length, "noverlap": shared, "detrend": keep, "scaling": "spectrum"}
    frequency, power = welch(values / factor, rate, window, **how)
    bandwidth = float(rate * np.sum(weights**2) / np.sum(weights) ** 2)
    square = f"({unit})2" if "/" in unit else f"{unit}2"
    amplitude, shown = {
        "peak": (np.sqrt(power * np.where(frequency > 0, 2.0, 1.0)), unit),
        "rms": (np.sqrt(power), unit),
        "power": (power, square),
        "density": (power / bandwidth, f"{square}/Hz"),
        "energy_density": (power / bandwidth * length / rate, f"{square} s/Hz"),
    }[scaling]
    whole = Spectrum(
        frequency,
        amplitude,
        quantity=quantity,
        units=shown,
        scaling=scaling,
        window=window,
        segment=length / rate,
        overlap=float(overlap),
        averages=count,
        resolution=float(rate / length),
        noise_bandwidth=bandwidth,
        drive_frequency=drive_frequency,
        natural_frequencies=np.asarray(natural_frequencies, dtype=float),
        position=position,
    )
    return whole if span is None else whole.up_to(span)
