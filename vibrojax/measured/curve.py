"""A measured frequency response: amplitudes or contact forces against frequency."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from vibrojax._tools.checks import check_choice
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.measured.cells import channel, real_channel
from vibrojax.measured.jumps import Jump, jumps_along
from vibrojax.measured.kinds import (
    DRIVES,
    ELECTRIC,
    FRAMES,
    ORDERS,
    QUANTITIES,
    SIGNALS,
    check_signal,
)
from vibrojax.measured.noise import Noise, Run, lever, phase_noise, relative_noise

FREQUENCY_NAMES = ("frequency_ratio", "frequency")
DIRECTIONS = {1: "forward", -1: "backward", 0: "unknown direction"}


def check_parameters(parameters: Any) -> dict[str, float]:
    """Return the parameters as floats; raise `ValueError` unless they are finite numbers."""
    found = {}
    for name, value in dict(parameters).items():
        real = isinstance(value, int | float | np.integer | np.floating)
        number = real and not isinstance(value, bool)
        if not number or not np.isfinite(value):
            raise ValueError(f"parameters: {name} must be a finite number, got {value!r}.")
        found[str(name)] = float(value)
    return found


@validated
@dataclass(frozen=True, eq=False, repr=False)
class MeasuredCurve:
    """Measured responses on a frequency axis, in the order in which they were measured.

    Arrays have the shape (points,). Raises `ValueError` when neither amplitude nor contact force is
    there, lengths differ, a value is not finite, an amplitude or force is negative, a frequency,
    drive or deviation is not above 0, or a name is not one of those allowed.
    """

    frequency: np.ndarray
    """Drive frequency: over the first natural one, or in Hz (`frequency_name`)."""
    frequency_name: str
    """`frequency_ratio`, or `frequency` in Hz."""
    amplitude: np.ndarray | None = None
    """Response, at least 0: over the drive amplitude, or in the unit of `signal`; None: none.

    A complex one, as in a measured response function, becomes its magnitude and the `phase`."""
    amplitude_deviation: np.ndarray | None = None
    """Standard deviations, in the unit of the amplitude; None: not known."""
    contact_force: np.ndarray | None = None
    """Largest contact force, N."""
    contact_force_deviation: np.ndarray | None = None
    """Standard deviations, N; None: not known."""
    direction: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    """1 in a sweep of rising frequency, -1 of falling, 0 not known (when left out), or no sweep.

    Points held by control or by their phase, unstable ones included, are 0, in their order."""
    quantity: str = ""
    """What of the signal: amplitude ((max - min)/2), peak, peak_to_peak, rms, first_harmonic; of a
    power mean or peak. Left out: first_harmonic of complex amplitudes, mean of a power, else
    amplitude."""
    signal: str = "displacement"
    """`displacement` (m), `velocity` (m/s), `acceleration` (m/s2), `voltage` (V), `power` (W)."""
    is_ratio: bool = True
    """True: displacement over the drive amplitude; False: in the unit of the signal."""
    frame: str = "relative"
    """`relative` to the moving base, or `absolute`, as an accelerometer on the beam measures."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Arguments of the user's rig function that hold for this curve."""
    label: str = ""
    """Name shown in pictures and messages, such as that of the file."""
    notes: tuple[str, ...] = ()
    """What was guessed or left out on the way."""
    lines: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    """Line of the file on which each point is; 1 to n without a file."""
    phase: np.ndarray | None = None
    """Angle (rad) by which the first harmonic of the response leads the drive: that of a complex
    amplitude times exp(+i w t). NaN: not known at this point; None: at none."""
    phase_deviation: np.ndarray | None = None
    """Standard deviations, rad; None: not known."""
    drive_amplitude: np.ndarray | None = None
    """Amplitude of the drive at every point, as measured, in the unit of `drive_signal`; None: the
    one of the rig, at all of them. A ratio is over it. Where both are complex, the phase is that
    of the response over the drive."""
    drive_signal: str = ""
    """What drive amplitude and phase refer to: `force` (N), or of the base `displacement` (m),
    `velocity` (m/s) or `acceleration` (m/s2). Left out: the force or displacement of the rig."""

    def __post_init__(self) -> None:
        """Bring the arrays into form and refuse what is not a measured curve."""
        check_choice("frequency_name", self.frequency_name, FREQUENCY_NAMES)
        object.__setattr__(self, "notes", tuple(self.notes))
        check_choice("drive_signal", self.drive_signal, ("", *DRIVES))
        self._take_apart()
        check_choice("quantity", self.quantity, tuple(QUANTITIES))
        check_choice("signal", self.signal, tuple(SIGNALS))
        check_choice("frame", self.frame, FRAMES)
        check_signal(self.signal, self.quantity, self.frame)
        if self.is_ratio and self.signal != "displacement":
            raise ValueError(
                f"is_ratio must be False for a signal of {self.signal!r}: only displacements are "
                f"taken over the drive amplitude. Multiply by what it was divided by and give "
                f"{SIGNALS[self.signal]}."
            )
        object.__setattr__(self, "frequency", real_channel("frequency", self.frequency))
        size = len(self.frequency)
        if size < 1:
            raise ValueError("frequency is empty: give at least one point.")
        self._check_whole_numbers(size)
        self._check("frequency", self.frequency > 0, "above 0")
        for name in ("amplitude", "contact_force"):
            self._check_channel(name, size)
        if self.amplitude is None and self.contact_force is None:
            raise ValueError("Give amplitude or contact_force, or both.")
        self._check_phase(size)
        self._check_drive(size)
        object.__setattr__(self, "parameters", check_parameters(self.parameters))

    def _check_whole_numbers(self, size: int) -> None:
        for name in ("direction", "lines"):
            given = np.atleast_1d(np.asarray(getattr(self, name)))
            if given.size == 0:
                given = np.arange(1, size + 1) if name == "lines" else np.zeros(size, int)
            elif given.size == 1:
                given = np.repeat(given, size)
            if given.shape != (size,):
                raise ValueError(f"{name} has {given.size} entries, frequency has {size}.")
            whole = given.dtype.kind in "iufb" and np.all(given == np.round(given))
            if not whole:
                raise ValueError(f"{name} must be whole numbers, got {in_short(given.tolist())}.")
            object.__setattr__(self, name, given.astype(int))
        if not np.isin(self.direction, list(DIRECTIONS)).all():
            bad = self.direction[~np.isin(self.direction, list(DIRECTIONS))][0]
            raise ValueError(f"direction must be 1, -1 or 0 (not known), got {bad}.")
        if self.lines.min() < 1:
            raise ValueError(f"lines must be numbers of at least 1, got {self.lines.min()}.")

    def _take_apart(self) -> None:
        """Put magnitude and phase in place of a complex amplitude."""
        given = None if self.amplitude is None else channel("amplitude", self.amplitude)
        if given is None or not np.iscomplexobj(given):
            usual = "mean" if self.signal == "power" else "amplitude"
            object.__setattr__(self, "quantity", self.quantity or usual)
            return
        if self.phase is not None:
            raise ValueError("phase is given, but the amplitude is complex and has its own.")
        phase = np.angle(given)
        if self.drive_amplitude is not None:
            drive = channel("drive_amplitude", self.drive_amplitude)
            if np.iscomplexobj(drive):
                phase = np.angle(given * drive.conj())
                object.__setattr__(self, "drive_amplitude", np.abs(drive))
        object.__setattr__(self, "quantity", self.quantity or "first_harmonic")
        object.__setattr__(self, "amplitude", np.abs(given))
        object.__setattr__(self, "phase", phase)

    def _check_phase(self, size: int) -> None:
        if self.phase is None:
            if self.phase_deviation is not None:
                raise ValueError("phase_deviation is given without phase.")
            return
        if self.amplitude is None:
            raise ValueError("phase is given without amplitude.")
        if self.signal == "power":
            raise ValueError("phase is given, and a power has none. Leave it out: phase=None.")
        self._take("phase", size)
        if np.isinf(self.phase).any():
            raise ValueError("phase must be finite, or NaN where it is not known, got inf.")
        if np.isnan(self.phase).all():
            object.__setattr__(self, "phase", None)
            object.__setattr__(self, "phase_deviation", None)
        elif self.phase_deviation is not None:
            self._take("phase_deviation", size)
            self._check("phase_deviation", self.phase_deviation > 0, "above 0")

    def _check_drive(self, size: int) -> None:
        if self.drive_amplitude is not None:
            self._take("drive_amplitude", size)
            self._check("drive_amplitude", self.drive_amplitude > 0, "above 0")
            if self.frequency_name == "frequency_ratio" and ORDERS.get(self.drive_signal, 0):
                raise ValueError(
                    f"drive_amplitude is a {self.drive_signal} of the base, and its displacement "
                    "follows from frequencies in Hz: give frequency in Hz, or the displacement, m."
                )

    def _take(self, name: str, size: int) -> None:
        """Put a channel into form; one deviation or drive is that of all points."""
        values = real_channel(name, getattr(self, name))
        if name not in ("amplitude", "contact_force", "phase") and values.size == 1:
            values = np.repeat(values, size)
        if values.shape != (size,):
            raise ValueError(f"{name} has {values.size} points, frequency has {size}.")
        object.__setattr__(self, name, values)

    def _check_channel(self, name: str, size: int) -> None:
        for part in (name, f"{name}_deviation"):
            if getattr(self, part) is None:
                continue
            if getattr(self, name) is None:
                raise ValueError(f"{part} is given without {name}.")
            self._take(part, size)
            if part == name:
                self._check(part, getattr(self, part) >= 0, "at least 0")
            else:
                self._check(part, getattr(self, part) > 0, "above 0")
        values = getattr(self, name)
        if name == "amplitude" and values is not None and not values.any():
            raise ValueError("amplitude is 0 at every point: nothing was measured.")

    def _check(self, name: str, good: np.ndarray, allowed: str) -> None:
        values = getattr(self, name)
        bad = np.flatnonzero(~(good & np.isfinite(values)))
        if bad.size:
            lines = ", ".join(str(line) for line in self.lines[bad[:6]])
            more = f" and {bad.size - 6} more" if bad.size > 6 else ""
            raise ValueError(
                f"{name} must be finite and {allowed}, got {values[bad[0]]:g} (line {lines}{more})."
                " Correct these points or leave them out."
            )

    @property
    def size(self) -> int:
        """Number of points."""
        return len(self.frequency)

    @property
    def forward(self) -> Bool[np.ndarray, " points"]:
        """Which points are of a sweep of rising frequency."""
        return self.direction == 1

    @property
    def backward(self) -> Bool[np.ndarray, " points"]:
        """Which points are of a sweep of falling frequency."""
        return self.direction == -1

    @property
    def unit(self) -> str:
        """Unit of the amplitude."""
        return "1" if self.is_ratio else SIGNALS[self.signal]

    def _in_order(self, direction: int) -> Int[np.ndarray, " some"]:
        """Indices of the points of a direction, in the order of the sweep."""
        at = np.flatnonzero(self.direction == direction)
        towards = -1 if direction == -1 else 1
        return at[np.argsort(towards * self.frequency[at], kind="stable")]

    def jumps(self) -> list[Jump]:
        """Return where the amplitude jumps: at most once up and once down in each direction.

        A jump changes the amplitude by more than a quarter, by 4 times what successive points
        usually differ by (median of the logarithms), by twice what the pairs next to it differ by
        in the same sense, as no resonance that its points resolve does, and by 8 standard
        deviations where they were given. A curve without amplitudes, or of unknown direction, has
        none.
        """
        amplitude, deviation = self.amplitude, self.amplitude_deviation
        if amplitude is None:
            return []
        return [
            jump
            for way in (1, -1)
            for jump in jumps_along(self._in_order(way), way, self.frequency, amplitude, deviation)
        ]

    def _orders(self) -> list[list[Run]]:
        """Runs of neighbours: those of no direction by frequency, or in their order."""
        jumps = [jump.at for jump in self.jumps()]
        runs: list[Run] = []
        for direction in (1, -1):
            at = self._in_order(direction)
            parts = np.split(at, np.flatnonzero(np.isin(at, jumps)))
            runs += [(self.frequency, part) for part in parts]
        at = self._in_order(0)
        orders = [(self.frequency, at), (np.arange(float(self.size)), np.sort(at))]
        return [[*runs, one] for one in orders[: 2 if at.size else 1]]

    def noise(self) -> Noise:
        """Return the standard deviation of every point: as given, or estimated from the scatter.

        Estimated: one relative level from how far points lie off the line or cubic through their
        neighbours (robust, the smaller of the two, not across jumps), at least 0.2 %; 2 % for fewer
        than 8 points. Never less than 0.5 % of the median value. Of a phase the same in rad; where
        the deviations of a first harmonic were given, they hold for both of its parts.
        """
        found: dict[str, np.ndarray | None] = {}
        sentences = []
        for name in ("amplitude", "contact_force"):
            values, found[name] = getattr(self, name), getattr(self, f"{name}_deviation")
            if values is not None and found[name] is None:
                found[name], sentence = relative_noise(values, self._orders())
                sentences.append(f"{name.replace('_', ' ').capitalize()}: {sentence}")
        if self.phase is not None and self.amplitude is not None:
            given, of_amplitude = self.phase_deviation, self.amplitude_deviation
            if given is None and of_amplitude is not None and self.quantity == "first_harmonic":
                given = of_amplitude / lever(self.amplitude)
            elif given is None:
                given, sentence = phase_noise(self.phase, self.amplitude, self._orders())
                sentences.append(f"Phase: {sentence}")
            found["phase"] = np.where(np.isnan(self.phase), np.inf, given)
        return Noise(sentence=" ".join(sentences) or None, **found)

    def __repr__(self) -> str:
        counts = {name: int(np.sum(self.direction == d)) for d, name in DIRECTIONS.items()}
        tally = ", ".join(f"{n} {name}" for name, n in counts.items() if n)
        hertz = "" if self.frequency_name == "frequency_ratio" else " Hz"
        named = f"{self.label!r}, " if self.label else ""
        lines = [
            f"MeasuredCurve({named}{self.size} points: {tally}; {self.frequency_name} "
            f"{np.min(self.frequency):.6g} to {np.max(self.frequency):.6g}{hertz})"
        ]
        if self.amplitude is not None:
            unit = "over drive amplitude" if self.is_ratio else self.unit
            frame = ", relative to the base" if self.frame == "relative" else ", absolute"
            frame = "" if self.signal in ELECTRIC else frame
            lines.append(
                f"  {self.signal}, {self.quantity} {QUANTITIES[self.quantity]}, {unit}"
                f"{frame}: up to {np.max(self.amplitude):.5g}"
            )
        known = self.drive_signal
        drive = f"{known}, {DRIVES[known]}" if known else "in the unit of the rig's, N or m"
        shown = {"phase, rad": self.phase, f"drive, {drive}": self.drive_amplitude}
        for label, values in shown.items():
            if values is not None:
                lines.append(f"  {label}: {np.nanmin(values):.4g} to {np.nanmax(values):.4g}")
        if self.contact_force is not None:
            lines.append(f"  contact force, N: up to {np.max(self.contact_force):.5g}")
        channels = [n for n in ("amplitude", "contact_force") if getattr(self, n) is not None]
        parts = ", ".join(
            f"{name} {'not given' if getattr(self, f'{name}_deviation') is None else 'given'}"
            for name in channels
        )
        lines.append(f"  deviations: {parts}")
        if self.parameters:
            lines.append("  " + ", ".join(f"{k} = {v:g}" for k, v in self.parameters.items()))
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])


@validated
@dataclass(frozen=True, eq=False, repr=False)
class MeasuredCurves:
    """Several measured curves of one rig. Raises `ValueError` when there are none."""

    curves: tuple[MeasuredCurve, ...]

    def __post_init__(self) -> None:
        """Refuse an empty list."""
        object.__setattr__(self, "curves", tuple(self.curves))
        if not self.curves:
            raise ValueError("curves is empty: give at least one measured curve.")

    def __len__(self) -> int:
        return len(self.curves)

    def __getitem__(self, index: int) -> MeasuredCurve:
        return self.curves[index]

    def __iter__(self) -> Iterator[MeasuredCurve]:
        return iter(self.curves)

    def __repr__(self) -> str:
        points = sum(curve.size for curve in self.curves)
        lines = "\n".join(repr(curve) for curve in self.curves).splitlines()
        head = f"MeasuredCurves({len(self)} curves, {points} points)"
        return "\n".join([head, *(f"  {line}" for line in lines)])
