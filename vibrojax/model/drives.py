"""What drives the system: where it acts and how strongly, and how it runs in time."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float

from vibrojax._tools.checks import (
    check_choice,
    check_not_negative,
    check_position,
    check_positive,
    number_field,
)
from vibrojax._tools.described import described
from vibrojax._tools.signatures import validated

Values = Float[Array, "..."]
Number = float | Values


class AbstractWaveform(eqx.Module):
    """A drive in time: its phase (rad) and the two derivatives of it."""

    @abstractmethod
    def phase(self, time: Values) -> tuple[Values, Values, Values]:
        """Return the phase (rad), its rate (rad/s) and the rate of that (rad/s2) at `time` (s)."""

    def __repr__(self) -> str:
        return described(self)


class AbstractSignal(AbstractWaveform):
    """A drive in time without a phase: it is known by its values."""

    @abstractmethod
    def input(self, drive: "AbstractDrive", time: Values) -> Values:
        """Return what a drive puts in at `time` (s): m/s2 or N; see `AbstractDrive.input`."""

    @abstractmethod
    def strength(self, drive: "AbstractDrive") -> Values:
        """Return the largest input by a drive, about, m/s2 or N."""

    @property
    @abstractmethod
    def start(self) -> Values:
        """When motions under it begin, s."""

    @property
    @abstractmethod
    def clock(self) -> Values:
        """Angular frequency by which steps are chosen where a system has no modes, rad/s."""

    def phase(self, time: Values) -> tuple[Values, Values, Values]:
        """Raise `ValueError`: there is none, at no `time` (s).

        Raises `ValueError`.
        """
        kind = type(self).__name__
        raise ValueError(
            f"A {kind} has no drive phase. Give a Harmonic or a Chirp, or read what needs no phase."
        )


@validated
class Harmonic(AbstractWaveform):
    """sin(2 pi frequency t). Raises `ValueError` unless the frequency (Hz) is above 0."""

    frequency: Number = number_field("Hz")
    """Drive frequency, Hz."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a frequency."""
        check_positive("frequency", self.frequency, "Hz")

    def phase(self, time: Values) -> tuple[Values, Values, Values]:
        """Return the phase (rad) and its first two derivatives."""
        rate = 2 * jnp.pi * jnp.asarray(self.frequency)
        return rate * time, rate * jnp.ones_like(time), jnp.zeros_like(time)


@validated
class Chirp(AbstractWaveform):
    """A continuous change of frequency, held at its end once the duration is over.

    Raises `ValueError` unless both frequencies (Hz) and the duration (s) are above 0 and the kind
    is `linear` or `logarithmic`.
    """

    start: Number = number_field("Hz")
    """Frequency at time 0, Hz."""
    end: Number = number_field("Hz")
    """Frequency at the end, Hz."""
    duration: Number = number_field("s")
    """Time from start to end, s."""
    kind: str = eqx.field(static=True, default="linear")
    """`linear` or `logarithmic` change of frequency with time."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a chirp."""
        check_positive("start", self.start, "Hz")
        check_positive("end", self.end, "Hz")
        check_positive("duration", self.duration, "s")
        check_choice("kind", self.kind, ("linear", "logarithmic"))

    def phase(self, time: Values) -> tuple[Values, Values, Values]:
        """Return the phase (rad) and its first two derivatives."""
        start, end = 2 * jnp.pi * jnp.asarray(self.start), 2 * jnp.pi * jnp.asarray(self.end)
        running = jnp.clip(time, 0.0, self.duration)
        moving = jnp.where((time >= 0) & (time <= self.duration), 1.0, 0.0)
        if self.kind == "linear":
            slope = (end - start) / self.duration
            swept = start * running + slope * running**2 / 2
            rate, second = start + slope * running, slope * moving
        else:
            growth = jnp.log(end / start) / self.duration
            # Where the ratio is 1 the chirp is a harmonic: the limit of expm1(g t)/g is t.
            steady = jnp.abs(growth) < 1e-12
            safe = jnp.where(steady, 1.0, growth)
            swept = start * jnp.where(steady, running, jnp.expm1(safe * running) / safe)
            rate = start * jnp.exp(growth * running)
            second = growth * rate * moving
        rest = time - running
        return swept + jnp.where(rest > 0, end, start) * rest, rate, second


class AbstractDrive(eqx.Module):
    """Where a drive acts and how strongly; the waveform is given with the run."""

    @abstractmethod
    def complex_amplitude(self, rate: Values, second: Values) -> Complex[Array, "..."]:
        """Return A such that the input is Im(A exp(i phase)), from the phase's derivatives.

        `rate` is the angular frequency (rad/s), `second` its rate of change (rad/s2). The input is
        in m/s2 for a base motion and in N for a force.
        """

    @property
    @abstractmethod
    def reference(self) -> tuple[ArrayLike, str]:
        """Amplitude by which responses are divided, and the unit of a displacement over it."""

    @property
    def signal_factor(self) -> float:
        """Input by a unit of a measured signal: -1 of a base acceleration, 1 of a force."""
        return 1.0

    def with_amplitude(self, amplitude: ArrayLike) -> "AbstractDrive":
        """Return the drive with another `amplitude`, m or N. Raises `ValueError` if it has none."""
        if not hasattr(self, "amplitude"):
            raise ValueError(f"A {type(self).__name__} has no amplitude that could be another.")
        return eqx.tree_at(lambda drive: getattr(drive, "amplitude"), self, amplitude)  # noqa: B009

    def input(self, waveform: AbstractWaveform, time: Values) -> Values:
        """Return the input at `time` (s): base acceleration with its sign changed, or force.

        `waveform` gives the phase at any time, or is a signal of its own.
        """
        if isinstance(waveform, AbstractSignal):
            return waveform.input(self, time)
        phase, rate, second = waveform.phase(time)
        amplitude = self.complex_amplitude(rate, second)
        return amplitude.real * jnp.sin(phase) + amplitude.imag * jnp.cos(phase)

    def __repr__(self) -> str:
        return described(self)


@validated
class BaseMotion(AbstractDrive):
    """The base, stop included, moves as chi = amplitude sin(phase).

    Under a `Sampled` waveform it has the acceleration that was measured, and needs no amplitude.
    Source: Gandhi and Vyas 2017, sec. 2.1. Raises `ValueError` for a negative amplitude.
    """

    amplitude: Number = number_field("m", default=0.0)
    """Displacement amplitude sigma of the base, m."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not an amplitude."""
        check_not_negative("amplitude", self.amplitude, "m")

    def complex_amplitude(self, rate: Values, second: Values) -> Complex[Array, "..."]:
        """Return sigma (rate^2 - i second): minus the base acceleration, m/s2."""
        return self.amplitude * (rate**2 - 1j * second)

    @property
    def reference(self) -> tuple[ArrayLike, str]:
        """Amplitude of the base: ratios are dimensionless."""
        return self.amplitude, "1"

    @property
    def signal_factor(self) -> float:
        """-1: what is measured is the acceleration of the base."""
        return -1.0


@validated
class PointForce(AbstractDrive):
    """A force amplitude sin(phase) at one place of the beam.

    Under a `Sampled` waveform it is the force that was measured, and needs no amplitude. Raises
    `ValueError` for a negative amplitude or a position outside (0, 1].
    """

    amplitude: Number = number_field("N", default=0.0)
    """Force amplitude, N."""
    position: Number = number_field(default=1.0)
    """Place along the beam, x/L."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a force on the beam."""
        check_not_negative("amplitude", self.amplitude, "N")
        check_position("position", self.position)

    def complex_amplitude(self, rate: Values, second: Values) -> Complex[Array, "..."]:
        """Return the force amplitude, N."""
        return (self.amplitude + 0j) * jnp.ones_like(rate)

    @property
    def reference(self) -> tuple[ArrayLike, str]:
        """Amplitude of the force: ratios are receptances, m/N."""
        return self.amplitude, "m/N"


@validated
class NoDrive(AbstractDrive):
    """Nothing drives the system: free motion."""

    def complex_amplitude(self, rate: Values, second: Values) -> Complex[Array, "..."]:
        """Return zero."""
        return jnp.zeros_like(rate) + 0j

    @property
    def reference(self) -> tuple[ArrayLike, str]:
        """1: a free system has displacements only, m."""
        return 1.0, "m"

    @property
    def signal_factor(self) -> float:
        """0: no signal acts."""
        return 0.0
