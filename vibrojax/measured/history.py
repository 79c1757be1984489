"""A measured time history: displacement, velocity, acceleration or contact force over time."""

import dataclasses
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.checks import (
    check_choice,
    check_position,
    check_positive,
    check_range,
    nearest,
)
from vibrojax._tools.signatures import validated
from vibrojax.measured.cells import real_channel
from vibrojax.measured.curve import check_parameters
from vibrojax.measured.impacts import windows_of_impacts
from vibrojax.measured.kinds import FRAMES
from vibrojax.measured.scatter import (
    ASSUMED_LEVEL,
    FEWEST_POINTS,
    LOWEST_LEVEL,
    interpolation_residuals,
    spread,
)
from vibrojax.model.signals import Sampled

CHANNELS = {
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s2",
    "contact_force": "N",
}
_FEWEST_SAMPLES = 2
_BEGINNINGS = (
    *("frequency", "frequency_ratio", "release", "initial_displacement", "initial_velocity"),
)


class HistoryNoise(NamedTuple):
    """Standard deviation of every channel, and what was assumed to get it."""

    deviation: dict[str, float]
    """In the SI unit of the channel."""
    sentence: str | None
    """None when all of them were given."""


class Observations(NamedTuple):
    """Single samples of all channels."""

    channel: Int[np.ndarray, " observations"]
    """Place of the channel among those measured."""
    sample: Int[np.ndarray, " observations"]
    """Place of the time."""
    value: Float[np.ndarray, " observations"]


@validated
@dataclass(frozen=True, eq=False, repr=False)
class MeasuredHistory:
    """Measured signals over time; arrays have the shape (samples,).

    A channel is NaN where it was not sampled: those of slower sensors are between their samples.

    Raises `ValueError` when no signal is there, nothing says how the motion begins, lengths differ,
    a value is infinite, time does not rise, or a number or name is not one of those allowed.
    """

    time: np.ndarray
    """s, rising, of all channels together; intervals need not be equal."""
    displacement: np.ndarray | None = None
    """m."""
    velocity: np.ndarray | None = None
    """m/s."""
    acceleration: np.ndarray | None = None
    """m/s2."""
    contact_force: np.ndarray | None = None
    """N, of all stops together."""
    deviation: dict[str, float] = field(default_factory=dict)
    """Standard deviation by channel, in its unit; channels left out are estimated by `noise`."""
    frequency: float | None = None
    """Drive frequency, Hz."""
    frequency_ratio: float | None = None
    """Drive frequency over the first natural one, when it is known so."""
    release: float | None = None
    """Displacement of the tip (m) from which the beam is let go at rest; it needs no drive."""
    initial_displacement: float | None = None
    """Of what the system reports, when the motion begins, m: of a beam the tip of its static shape,
    of other systems as a force at the sensor pulls them."""
    initial_velocity: float | None = None
    """The same of its velocity, m/s: of other systems as a blow at the sensor makes it."""
    waveform: Sampled | None = None
    """Drive as measured, on the same clock; the motion begins at rest with its first sample."""
    gain: dict[str, float] = field(default_factory=dict)
    """Of the sensors, by channel: measured = gain times what is there + offset; 1 if left out."""
    offset: dict[str, float] = field(default_factory=dict)
    """In the unit of the channel; 0 if left out."""
    delay: dict[str, float] = field(default_factory=dict)
    """By how much the clock of a channel is late, s: what shows at t was at t - delay."""
    position: float | None = None
    """Place s = x/L of the sensor; None: where the system reports, the tip of a beam."""
    frame: str = "relative"
    """`relative` to the moving base, or `absolute`, as an accelerometer on the beam measures."""
    window: tuple[float, float] | None = None
    """Start and end (s) of the samples that count; None: all of them."""
    align_phase: bool = True
    """Whether an unknown constant may shift the time axis."""
    settled: bool = True
    """Whether the motion is steady; one that was let go (`release`) never is."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Arguments of the user's rig function that hold for this history."""
    label: str = ""
    """Name shown in pictures and messages, such as that of the file."""
    notes: tuple[str, ...] = ()
    """What was assumed or left out on the way."""

    def __post_init__(self) -> None:
        """Bring the arrays into form and refuse what is not a measured history."""
        check_choice("frame", self.frame, FRAMES)
        self._check_arrays()
        if self.frequency is not None and self.frequency_ratio is not None:
            raise ValueError("Give frequency (Hz) or frequency_ratio, not both.")
        if self.waveform is not None:
            self._check_waveform(self.waveform)
        elif all(getattr(self, name) is None for name in _BEGINNINGS):
            raise ValueError(
                "Give the drive's frequency (Hz) or frequency_ratio, its waveform as measured, the "
                "release (m) from which the beam was let go, or the initial_displacement (m) and "
                "initial_velocity (m/s) with which the motion begins."
            )
        for name, unit in (("frequency", "Hz"), ("frequency_ratio", "(ratio)")):
            if getattr(self, name) is not None:
                check_positive(name, getattr(self, name), unit)
        if self.release is not None:
            check_range("release", self.release, allowed="a finite displacement in m")
            object.__setattr__(self, "settled", False)
        for name, unit in (("initial_displacement", "m"), ("initial_velocity", "m/s")):
            if getattr(self, name) is not None:
                check_range(name, getattr(self, name), allowed=f"finite, in {unit}")
                if self.release is not None:
                    raise ValueError(f"Give release or {name}, not both.")
                object.__setattr__(self, "settled", False)
        if self.position is not None:
            check_position("position", self.position)
        for part in ("deviation", "gain", "offset", "delay"):
            self._check_by_channel(part)
        if self.window is not None:
            start, end = self.window
            inside = int(np.sum(self._inside()))
            if inside < _FEWEST_SAMPLES:
                raise ValueError(
                    f"window must be a start and a later end (s) with at least {_FEWEST_SAMPLES} "
                    f"samples between, got ({start:g}, {end:g}) with {inside}; time runs from "
                    f"{self.time[0]:g} to {self.time[-1]:g} s."
                )
        object.__setattr__(self, "parameters", check_parameters(self.parameters))
        object.__setattr__(self, "notes", tuple(self.notes))

    def _check_by_channel(self, part: str) -> None:
        for name, value in getattr(self, part).items():
            if name not in self.channels:
                raise ValueError(
                    f"{part}: there is no channel {name!r}. {nearest(name, self.channels)}"
                )
            if part == "deviation":
                check_positive(f"deviation of {name}", value, CHANNELS[name])
                continue
            unit = {"gain": "", "offset": f", in {CHANNELS[name]}", "delay": ", in s"}[part]
            check_range(f"{part} of {name}", value, allowed=f"finite{unit}")
            if part == "gain" and value == 0:
                raise ValueError(f"gain of {name} must not be 0: leave the channel out.")

    def _check_waveform(self, waveform: Sampled) -> None:
        others = ("frequency", "frequency_ratio", "release")
        given = [name for name in others if getattr(self, name) is not None]
        if given:
            raise ValueError(f"Give waveform or {given[0]}, not both.")
        begun = float(waveform.start)
        if self.time[0] < begun:
            raise ValueError(
                f"time must begin with the waveform, at {begun:g} s, or later, got "
                f"{self.time[0]:g} s."
            )
        # One clock has both: no shift is sought.
        object.__setattr__(self, "settled", False)
        object.__setattr__(self, "align_phase", False)

    def _check_arrays(self) -> None:
        for name in ("time", *CHANNELS):
            if getattr(self, name) is None:
                continue
            values = real_channel(name, getattr(self, name))
            if len(values) < _FEWEST_SAMPLES:
                raise ValueError(
                    f"{name} must have at least {_FEWEST_SAMPLES} samples, got {len(values)}."
                )
            object.__setattr__(self, name, values)
            if len(values) != len(self.time):
                raise ValueError(f"{name} has {len(values)} samples, time has {len(self.time)}.")
            refused = ~np.isfinite(values) if name == "time" else np.isinf(values)
            if refused.any():
                bad = int(np.flatnonzero(refused)[0])
                raise ValueError(f"{name} must be finite, got {values[bad]} at index {bad}.")
            if np.sum(np.isfinite(values)) < _FEWEST_SAMPLES:
                raise ValueError(
                    f"{name} must have at least {_FEWEST_SAMPLES} samples that are not NaN, got "
                    f"{np.sum(np.isfinite(values))}. Leave the channel out."
                )
        if not self.channels:
            raise ValueError(f"Give at least one of {', '.join(CHANNELS)}.")
        if (np.diff(self.time) <= 0).any():
            bad = int(np.flatnonzero(np.diff(self.time) <= 0)[0])
            raise ValueError(
                f"time must rise, got {self.time[bad]:g} s then {self.time[bad + 1]:g} s at index "
                f"{bad + 1}. Sort the samples, and leave out those that are there twice."
            )

    @property
    def size(self) -> int:
        """Number of samples."""
        return len(self.time)

    @property
    def channels(self) -> dict[str, Float[np.ndarray, " samples"]]:
        """The signals that were measured, by name."""
        return {n: getattr(self, n) for n in CHANNELS if getattr(self, n) is not None}

    def _inside(self) -> np.ndarray:
        if self.window is None:
            return np.ones(self.size, dtype=bool)
        start, end = self.window
        return (self.time >= start) & (self.time <= end)

    def observations(self) -> Observations:
        """Return the samples that count and are there, channel after channel."""
        inside = np.flatnonzero(self._inside())
        found = [
            (k, inside[np.isfinite(v[inside])], v) for k, v in enumerate(self.channels.values())
        ]
        return Observations(
            np.concatenate([np.full(len(at), k) for k, at, _ in found]),
            np.concatenate([at for _, at, _ in found]),
            np.concatenate([values[at] for _, at, values in found]),
        )

    def windowed(self) -> "MeasuredHistory":
        """Return the history of the samples that count; times stay as they are."""
        inside = self._inside()
        parts = {name: values[inside] for name, values in self.channels.items()}
        return dataclasses.replace(self, time=self.time[inside], **parts)

    def impacts(
        self, threshold: float | None = None, margin: float = 0.5
    ) -> "list[MeasuredHistory]":
        """Return one history for each impact in the contact force, with a window around it.

        Labels are numbered from 1. What is shorter than 3 samples counts as a spike.

        Parameters:
            threshold: force (N), from its median, above which there is contact; None: a tenth of
                the largest one, and 6 standard deviations of the scatter about the median.
            margin: how far a window reaches on either side, in lengths of the impact.

        Raises `ValueError` without a contact force, or where there is no impact.
        """
        if self.contact_force is None:
            raise ValueError("impacts are read off the contact_force, which was not measured.")
        if threshold is not None:
            check_positive("threshold", threshold, "N")
        check_range("margin", margin, 0.0, 10.0, allowed="from 0 to 10")
        part = self.windowed()
        assert part.contact_force is not None
        windows = windows_of_impacts(part.time, part.contact_force, threshold, margin)
        if not windows:
            raise ValueError(
                "There is no impact in the contact_force. Give a lower threshold (N), or look "
                "whether its unit is right."
            )
        named = f"{self.label}, " if self.label else ""
        return [
            dataclasses.replace(self, window=window, label=f"{named}impact {k}")
            for k, window in enumerate(windows, 1)
        ]

    def noise(self) -> HistoryNoise:
        """Return the standard deviation of every channel: as given, or estimated from the scatter.

        Estimated: how far samples that count lie off the cubic through the four next to them
        (robust), and at least 0.2 % of the largest value; 2 % of it for fewer than 8 samples.
        """
        inside = self._inside()
        found, estimated = {}, []
        for name, values in self.channels.items():
            if name in self.deviation:
                found[name] = float(self.deviation[name])
                continue
            own = inside & np.isfinite(values)
            largest = float(np.max(np.abs(values[own]), initial=0.0)) or 1.0
            residuals = interpolation_residuals(self.time[own], values[own], 2)
            if np.sum(own) < FEWEST_POINTS:
                found[name] = ASSUMED_LEVEL * largest
                why = f"2 % of the largest value, as {np.sum(own)} samples are too few"
            else:
                found[name] = max(spread(residuals), LOWEST_LEVEL * largest)
                why = "from the scatter of neighbouring samples"
            estimated.append(f"{name} {found[name]:.3g} {CHANNELS[name]} ({why})")
        text = f"Standard deviations are assumed: {', '.join(estimated)}." if estimated else None
        return HistoryNoise(found, text)

    def _sensor(self, channel: str) -> str:
        parts = {"gain": "", "offset": f" {CHANNELS[channel]}", "delay": " s"}
        given = [(n, getattr(self, n).get(channel), u) for n, u in parts.items()]
        missing = int(np.sum(np.isnan(getattr(self, channel))))
        details = [f", {name} {value:g}{unit}" for name, value, unit in given if value is not None]
        return "".join([*details, f", {self.size - missing} samples" * (missing > 0)])

    def __repr__(self) -> str:
        named = f"{self.label!r}, " if self.label else ""
        lines = [
            f"MeasuredHistory({named}{self.size} samples, {self.time[0]:.6g} to "
            f"{self.time[-1]:.6g} s)"
        ]
        if self.window is not None:
            counted = int(np.sum(self._inside()))
            lines.append(f"  window {self.window[0]:g} to {self.window[1]:g} s: {counted} samples")
        for name, values in self.channels.items():
            given = self.deviation.get(name)
            size = "not given" if given is None else f"{given:g}"
            lines.append(
                f"  {name} {np.nanmin(values):.5g} to {np.nanmax(values):.5g} {CHANNELS[name]}, "
                f"deviation {size}{self._sensor(name)}"
            )
        place = "where the system reports" if self.position is None else f"s = {self.position:g}"
        lines.append(f"  measured {place}, {self.frame}")
        units = " Hz", "", " m", " m", " m/s"
        given = [(n, getattr(self, n), u) for n, u in zip(_BEGINNINGS, units, strict=True)]
        settings = [f"{name} {value:g}{unit}" for name, value, unit in given if value is not None]
        if self.waveform is not None:
            settings.append(f"drive {self.waveform!r}")
        lines.append(f"  {', '.join([*settings, 'settled' if self.settled else 'transient'])}")
        if self.parameters:
            lines.append("  " + ", ".join(f"{k} = {v:g}" for k, v in self.parameters.items()))
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])
