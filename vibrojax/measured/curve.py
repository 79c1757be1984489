"""A measured frequency response: amplitudes or contact forces against frequency."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax._tools.checks import check_choice
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.measured.cells import channel, real_channel
from vibrojax.measured.kinds import ELECTRIC, FRAMES, QUANTITIES, SIGNALS, check_signal
from vibrojax.measured.scatter import (
    ASSUMED_LEVEL,
    FEWEST_POINTS,
    LOWEST_LEVEL,
    interpolation_residuals,
    spread,
)

FREQUENCY_NAMES = ("frequency_ratio", "frequency")
DIRECTIONS = {1: "forward", -1: "backward", 0: "unknown direction"}

_FLOOR = 0.005
"""Smallest deviation, of the median value: the foot of a resonance is not known ever better."""
_LEAST_CHANGE = np.log(1.25)
_ABOVE_MEDIAN = 4.0
_ABOVE_NEIGHBOURS = 2.0
_ABOVE_NOISE = 8.0
_SMALLEST_FORCE = 1e-3


class Jump(NamedTuple):
    """An abrupt change of the amplitude between successive points of a sweep."""

    direction: int
    """1 in the forward, -1 in the backward sweep."""
    before: float
    """Frequency of the last point before it, in the unit of the curve."""
    after: float
    """Frequency of the first point after it."""
    change: float
    """Amplitude after over amplitude before."""
    at: int
    """Index of the point after it."""


class Noise(NamedTuple):
    """Standard deviations of the points, and what was assumed to get them."""

    amplitude: Float[np.ndarray, " points"] | None
    """In the unit of the amplitude."""
    contact_force: Float[np.ndarray, " points"] | None
    """N."""
    sentence: str | None
    """None when all of them were given."""


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
    there, lengths differ, a value is not finite, an amplitude or force is negative, a frequency or
    deviation is not above 0, or a name is not one of those allowed.
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
    """1 in a sweep of rising frequency, -1 of falling, 0 not known (when left out)."""
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
    """Angle (rad) by which the response leads the drive, as the source has it: that of a complex
    amplitude times exp(+i w t). NaN: not known at this point; None: at none. Fits do not use it."""

    def __post_init__(self) -> None:
        """Bring the arrays into form and refuse what is not a measured curve."""
        check_choice("frequency_name", self.frequency_name, FREQUENCY_NAMES)
        object.__setattr__(self, "notes", tuple(self.notes))
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
        self._check("frequency", self.frequency > 0, "above 0")
        for name in ("amplitude", "contact_force"):
            self._check_channel(name, size)
        if self.amplitude is None and self.contact_force is None:
            raise ValueError("Give amplitude or contact_force, or both.")
        if self.phase is not None:
            self._check_phase(size)
        object.__setattr__(self, "parameters", check_parameters(self.parameters))

    def _take_apart(self) -> None:
        """Put magnitude and phase in place of a complex amplitude."""
        given = None if self.amplitude is None else channel("amplitude", self.amplitude)
        if given is None or not np.iscomplexobj(given):
            usual = "mean" if self.signal == "power" else "amplitude"
            object.__setattr__(self, "quantity", self.quantity or usual)
            return
        quantity = self.quantity or "first_harmonic"
        if self.phase is not None:
            raise ValueError("phase is given, but the amplitude is complex and has its own.")
        object.__setattr__(self, "quantity", quantity)
        object.__setattr__(self, "amplitude", np.abs(given))
        object.__setattr__(self, "phase", np.angle(given))
        note = (
            f"The response is complex: its magnitude was taken ({quantity}), its angle is kept as "
            "the phase, which fits do not use."
        )
        object.__setattr__(self, "notes", (*self.notes, note))

    def _check_phase(self, size: int) -> None:
        phase = real_channel("phase", self.phase)
        if self.amplitude is None:
            raise ValueError("phase is given without amplitude.")
        if phase.shape != (size,):
            raise ValueError(f"phase has {phase.size} points, frequency has {size}.")
        if np.isinf(phase).any():
            raise ValueError("phase must be finite, or NaN where it is not known, got inf.")
        object.__setattr__(self, "phase", phase)

    def _check_channel(self, name: str, size: int) -> None:
        for part in (name, f"{name}_deviation"):
            if getattr(self, part) is None:
                continue
            values = real_channel(part, getattr(self, part))
            if getattr(self, name) is None:
                raise ValueError(f"{part} is given without {name}.")
            if part != name and values.size == 1:
                values = np.repeat(values, size)
            if values.shape != (size,):
                raise ValueError(f"{part} has {values.size} points, frequency has {size}.")
            object.__setattr__(self, part, values)
            if part == name:
                self._check(part, values >= 0, "at least 0")
            else:
                self._check(part, values > 0, "above 0")
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
        return [jump for direction in (1, -1) for jump in self._jumps(self._in_order(direction))]

    def _jumps(self, at: Int[np.ndarray, " some"]) -> list[Jump]:
        if self.amplitude is None or len(at) < 2:
            return []
        amplitude = self.amplitude[at]
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.nan_to_num(np.diff(np.log(amplitude)), posinf=0.0, neginf=0.0)
        size = np.abs(change)
        strong = (size > _LEAST_CHANGE) & (size > _ABOVE_MEDIAN * np.median(size))
        if self.amplitude_deviation is not None:
            deviation = self.amplitude_deviation[at]
            combined = np.hypot(deviation[1:], deviation[:-1])
            strong &= np.abs(np.diff(amplitude)) > _ABOVE_NOISE * combined
        found = []
        for sign in (1, -1):
            same = np.pad(np.maximum(sign * change, 0.0), 1)
            beside = np.maximum(same[:-2], same[2:])
            candidates = strong & (same[1:-1] > _ABOVE_NEIGHBOURS * beside)
            if candidates.any():
                k = int(np.argmax(np.where(candidates, sign * change, -np.inf)))
                before, after = (float(f) for f in self.frequency[at[k : k + 2]])
                ratio = float(np.exp(change[k]))
                found.append(Jump(int(self.direction[at[k]]), before, after, ratio, int(at[k + 1])))
        return sorted(found, key=lambda jump: int(np.flatnonzero(at == jump.at)[0]))

    def noise(self) -> Noise:
        """Return the standard deviation of every point: as given, or estimated from the scatter.

        Estimated: one relative level from how far points lie off the line or cubic through their
        neighbours (robust, the smaller of the two, not across jumps), at least 0.2 %; 2 % for fewer
        than 8 points. Never less than 0.5 % of the median value.
        """
        found: dict[str, np.ndarray | None] = {"amplitude": None, "contact_force": None}
        sentences = []
        for name in found:
            values, given = getattr(self, name), getattr(self, f"{name}_deviation")
            if values is None or given is not None:
                found[name] = given
                continue
            found[name], sentence = self._estimate(values)
            sentences.append(f"{name.replace('_', ' ').capitalize()}: {sentence}")
        return Noise(found["amplitude"], found["contact_force"], " ".join(sentences) or None)

    def _estimate(self, values: Float[np.ndarray, " points"]) -> tuple[np.ndarray, str]:
        positive = values[values > 0]
        if not positive.size:
            text = f"a standard deviation of {_SMALLEST_FORCE:g} N is assumed, as all forces are 0."
            return np.full(len(values), _SMALLEST_FORCE), text
        jumps = [jump.at for jump in self.jumps()]
        off_line, off_cubic = [], []
        for direction in DIRECTIONS:
            at = self._in_order(direction)
            at = at[values[at] > 0]
            for part in np.split(at, np.flatnonzero(np.isin(at, jumps))):
                x, y = self.frequency[part], np.log(values[part])
                off_line.append(interpolation_residuals(x, y, 1))
                off_cubic.append(interpolation_residuals(x, y, 2))
        # The cubic follows a curved response, the line a kinked one: neither reads too little.
        spreads = [spread(np.concatenate(r)) for r in (off_line, off_cubic)]
        if len(positive) < FEWEST_POINTS or np.isnan(spreads).all():
            level = ASSUMED_LEVEL
            why = f"is assumed, as {len(positive)} points are too few to estimate it"
        else:
            level = max(float(np.nanmin(spreads)), LOWEST_LEVEL)
            why = "is assumed, estimated from the scatter of neighbouring points"
        text = f"a standard deviation of {100 * level:.2g} % {why}."
        return np.hypot(level * values, _FLOOR * np.median(positive)), text

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
        if self.phase is not None and not np.isnan(self.phase).all():
            low, high = np.nanmin(self.phase), np.nanmax(self.phase)
            lines.append(f"  phase, rad: {low:.4g} to {high:.4g}, not used by fits")
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
