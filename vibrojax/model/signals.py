"""Drives in time that have no phase: samples as measured, and sums of harmonics."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_frequencies, concrete
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive, AbstractSignal, Values

EQUAL = 1e-3
"""How far times may be off equal spacing and count as equally spaced, by the spacing."""
FEWEST = 2


def _samples(name: str, values: Any) -> Float[Array, " samples"]:
    """Return samples as an array. Raises `ValueError` for what are none."""
    with jax.ensure_compile_time_eval():  # known numbers stay known inside of jit
        array = jnp.asarray(values, float)
    if array.ndim != 1 or array.shape[0] < FEWEST:
        raise ValueError(
            f"{name} must be a list of at least {FEWEST} samples, got the shape {array.shape}."
        )
    known = concrete(array)
    if known is not None and not np.isfinite(known).all():
        bad = int(np.argmin(np.isfinite(known)))
        raise ValueError(
            f"{name} must be finite, got {known[bad]} at index {bad}. Leave such samples out, or "
            "fill them in."
        )
    return array


@validated
class Sampled(AbstractSignal):
    """A drive as it was measured: linear between its samples, and propagated exactly so.

        simulate(rig, waveform=vj.Sampled(time, acceleration))

    The values are the input itself, whatever the amplitude of the drive: the acceleration of the
    base, m/s2, where the system has a `BaseMotion`, the force, N, where it has a `PointForce`.
    Motions begin at its first sample; before that and after the last one it keeps their values.
    Times within a thousandth of an interval of equal spacing count as equally spaced, for which
    long records are marched fastest.

    Parameters:
        time: s, rising, shape (samples,).
        values: m/s2 or N, shape (samples,).

    Raises `ValueError` for fewer than 2 samples, lengths that differ, values that are not finite
    and times that do not rise.
    """

    time: Float[Array, " samples"]
    """s."""
    values: Float[Array, " samples"]
    """Acceleration of the base, m/s2, or force, N."""
    equally_spaced: bool = eqx.field(static=True, init=False)
    """Whether the samples are equally spaced."""

    def __init__(self, time: ArrayLike | list[float], values: ArrayLike | list[float]):
        self.time, self.values = _samples("time", time), _samples("values", values)
        if self.time.shape != self.values.shape:
            raise ValueError(
                f"time has {self.time.shape[0]} samples and values have {self.values.shape[0]}: "
                "give one value for every time."
            )
        known = concrete(self.time)
        self.equally_spaced = False
        if known is None:
            return
        if (falls := np.diff(known) <= 0).any():
            bad = int(np.argmax(falls))
            raise ValueError(
                f"time must rise, got {known[bad]:g} s then {known[bad + 1]:g} s at index "
                f"{bad + 1}. Sort the samples, and leave out those that are there twice."
            )
        even = np.linspace(known[0], known[-1], known.size)
        spacing = (known[-1] - known[0]) / (known.size - 1)
        self.equally_spaced = bool(np.max(np.abs(known - even)) <= EQUAL * spacing)

    @property
    def start(self) -> Values:
        """Time of the first sample, s."""
        return self.time[0]

    @property
    def clock(self) -> Values:
        """A turn in 64 samples, rad/s."""
        return 2 * jnp.pi / 64 * (self.time.shape[0] - 1) / (self.time[-1] - self.time[0])

    def strength(self, drive: AbstractDrive) -> Values:
        """Return the largest input by a drive, m/s2 or N."""
        return abs(drive.signal_factor) * jnp.max(jnp.abs(self.values))

    def input(self, drive: AbstractDrive, time: Values) -> Values:
        """Return what a drive puts in at `time` (s): m/s2 or N."""
        return drive.signal_factor * self.at(time)

    def at(self, time: Values) -> Values:
        """Return the signal at `time` (s)."""
        if not self.equally_spaced:
            return jnp.interp(time, self.time, self.values)
        last = self.values.shape[0] - 1
        place = (time - self.time[0]) / (self.time[-1] - self.time[0]) * last
        place = jnp.clip(place, 0.0, last)
        # At a sample to rounding it is that sample: XLA may round the index of one term one way and
        # that of another the other way, which would miss by all of an interval.
        nearest = jax.lax.stop_gradient(jnp.round(place))
        place = jnp.where(jnp.abs(place - nearest) < 4e-15 * last, nearest, place)
        before = jnp.minimum(place.astype(int), last - 1)
        low, high = self.values[before], self.values[before + 1]
        return low + (place - before) * (high - low)

    def __repr__(self) -> str:
        count, first, last = self.time.shape[-1], concrete(self.time), concrete(self.values)
        if first is None or last is None or first.ndim != 1:
            return f"Sampled({count} samples)"
        return (
            f"Sampled({count} samples, {first[0]:.6g} to {first[-1]:.6g} s, values "
            f"{np.min(last):.5g} to {np.max(last):.5g})"
        )


@validated
class Tones(AbstractSignal):
    """A sum of harmonics: the sum over i of share_i sin(2 pi frequency_i t + phase_i).

        simulate(rig, waveform=vj.Tones([12.0, 17.5], [1.0, 0.4]), duration=20.0)

    The drive's amplitude times this is the displacement of the base, or the force. Motions begin at
    time 0; with linear stops they are exact.

    Parameters:
        frequencies: Hz, rising, shape (tones,).
        shares: amplitudes over that of the drive, shape (tones,); 1 by default.
        phases: rad, shape (tones,); 0 by default.

    Raises `ValueError` for frequencies that are not above 0 and rising, lengths that differ, and
    numbers that are not finite.
    """

    frequencies: Float[Array, " tones"]
    """Hz."""
    shares: Float[Array, " tones"]
    """Amplitudes over that of the drive."""
    phases: Float[Array, " tones"]
    """rad."""

    def __init__(
        self,
        frequencies: ArrayLike | list[float],
        shares: ArrayLike | list[float] | None = None,
        phases: ArrayLike | list[float] | None = None,
    ):
        if concrete(jnp.asarray(frequencies)) is not None:
            check_frequencies("frequencies", frequencies, "Hz")
        self.frequencies = jnp.atleast_1d(jnp.asarray(frequencies, float))
        like = jnp.ones_like(self.frequencies)
        self.shares = like if shares is None else jnp.asarray(shares, float)
        self.phases = 0 * like if phases is None else jnp.asarray(phases, float)
        for name in ("shares", "phases"):
            values = getattr(self, name)
            if values.shape != like.shape:
                raise ValueError(
                    f"{name} must be one number for every frequency, shape {like.shape}, got "
                    f"the shape {values.shape}."
                )
            known = concrete(values)
            if known is not None and not np.isfinite(known).all():
                raise ValueError(f"{name} must be finite, got {known[~np.isfinite(known)][0]}.")

    @property
    def start(self) -> Values:
        """0 s."""
        return jnp.zeros(())

    @property
    def clock(self) -> Values:
        """Angular frequency of the first tone, rad/s."""
        return 2 * jnp.pi * self.frequencies[0]

    def strength(self, drive: AbstractDrive) -> Values:
        """Return the sum of the amplitudes of the input by a drive, m/s2 or N."""
        rate = 2 * jnp.pi * self.frequencies
        amplitude = drive.complex_amplitude(rate, jnp.zeros_like(rate))
        return jnp.sum(jnp.abs(self.shares * amplitude))

    def input(self, drive: AbstractDrive, time: Values) -> Values:
        """Return what a drive puts in at `time` (s): m/s2 or N."""
        rate = 2 * jnp.pi * self.frequencies
        amplitude = self.shares * drive.complex_amplitude(rate, jnp.zeros_like(rate))
        angle = jnp.asarray(time)[..., None] * rate + self.phases
        return jnp.sum(amplitude.real * jnp.sin(angle) + amplitude.imag * jnp.cos(angle), axis=-1)
