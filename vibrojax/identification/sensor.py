"""What a sensor shows of a balanced motion: one number per channel, as it stands on its axis."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from vibrojax.measured.kinds import ORDERS
from vibrojax.model.drives import BaseMotion
from vibrojax.model.first_order import without_memory
from vibrojax.steady.condensed import Problem, cell_average, differentiate
from vibrojax.steady.paths import Place
from vibrojax.stepping.cubic import cubic_maximum, largest

FINER = 2
"""How many times finer than the balance a waveform is looked at."""


class Sensor(eqx.Module):
    """What is measured of a periodic motion; all of it decided before anything compiles."""

    quantity: str | None = eqx.field(static=True, default="amplitude")
    """`amplitude` (half of peak to peak), `peak`, `peak_to_peak`, `rms`, `first_harmonic` or, of a
    power, `mean`.

    None where only the contact force is measured.
    """
    signal: str = eqx.field(static=True, default="displacement")
    """`displacement`, `velocity`, `acceleration`, `voltage`, or `power`, whose root is reported."""
    is_ratio: bool = eqx.field(static=True, default=True)
    """Divided by the drive amplitude; else in SI units."""
    absolute: bool = eqx.field(static=True, default=False)
    """In space, not relative to the base."""
    with_force: bool = eqx.field(static=True, default=False)
    """Whether the largest contact force (N) is measured too, as the last channel."""
    with_phase: bool = eqx.field(static=True, default=False)
    """Whether the phase is measured too, as the second channel: see `seen_from`."""

    @property
    def channels(self) -> int:
        """How many numbers there are per point."""
        return (self.quantity is not None) + self.with_phase + self.with_force

    @property
    def is_complex(self) -> bool:
        """Whether the first two channels are a complex amplitude: its size and its angle."""
        return self.with_phase and self.quantity == "first_harmonic"


def observe(
    sensor: Sensor,
    place: Place,
    problem: Problem,
    force: Complex[Array, "stops harmonics"],
    depth: Complex[Array, "stops harmonics"],
) -> Float[Array, " channels"]:
    """Read the channels of a sensor off a balanced motion and its averaged contact force.

    A phase is the angle (rad) by which the first harmonic leads the force or the displacement of
    the base.
    """
    count = depth.shape[-1]
    average = cell_average(2 * (count - 1), count)
    values = []
    if sensor.quantity is not None:
        push = jnp.einsum("bk,bk->k", problem.receptance.response_from_force, force / average)
        spectrum = _signal(sensor, place, problem.response_drive + push)
        values.append(_shown(sensor, spectrum))
        if sensor.with_phase:
            values.append(jnp.angle(1j * spectrum[1]))  # the drive is a sine
    if sensor.with_force:
        values.append(_largest_force(place, depth / average, problem.per_second))
    return jnp.stack(values)


def seen_from(sensor: Sensor, channels: Any, phase: Any, xp: Any = np) -> Any:
    """Return channels as a point of a measured phase (rad) has them, the first two turned by it.

    Of a complex amplitude what lies along the measured one and across it, so that noise is alike in
    both; of other quantities the angle (rad) ahead of the measured one. Where the phase is NaN, the
    size and 0. Without a phase all stay as they are.
    """
    if not sensor.with_phase:
        return channels
    size, angle = channels[..., 0], channels[..., 1] - phase
    angle = xp.where(xp.isnan(phase), 0.0, angle)
    if sensor.is_complex:
        pair = [size * xp.cos(angle), size * xp.sin(angle)]
    else:
        pair = [size + 0 * angle, wrapped(angle, xp)]
    rest = xp.broadcast_to(channels[..., 2:], (*angle.shape, channels.shape[-1] - 2))
    return xp.concatenate([xp.stack(pair, axis=-1), rest], axis=-1)


def seen_back(sensor: Sensor, channels: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Undo `seen_from`."""
    size, angle = channels[..., 0], channels[..., 1]
    if sensor.is_complex:
        size, angle = np.hypot(size, angle), np.arctan2(angle, size)
    pair = np.stack([size, angle + phase], axis=-1)
    return np.concatenate([pair, channels[..., 2:]], axis=-1)


def wrapped(angle: Any, xp: Any = np) -> Any:
    """Return an angle (rad) within half a turn of 0."""
    return angle - 2 * np.pi * xp.round(angle / (2 * np.pi))


def _signal(sensor: Sensor, place: Place, spectrum: Complex[Array, " harmonics"]):
    """Spectrum of what is measured of the displacement reported."""
    samples = 2 * (spectrum.size - 1)
    if sensor.absolute and isinstance(place.drive, BaseMotion):
        spectrum = spectrum.at[1].add(-0.5j * place.drive.amplitude * samples)
    rates = 1j * place.angular_frequency * np.arange(spectrum.size)
    spectrum = spectrum * rates ** ORDERS[sensor.signal]
    if sensor.is_ratio:
        spectrum = spectrum / place.drive.reference[0]
    return spectrum


def _shown(sensor: Sensor, spectrum: Complex[Array, " harmonics"]):
    samples = 2 * (spectrum.size - 1)
    if sensor.quantity == "first_harmonic":
        return 2 / samples * jnp.abs(spectrum[1])
    # The highest harmonic has no phase at the samples: it is left out.
    finer, spectrum = FINER * samples, FINER * spectrum.at[-1].set(0.0)
    if sensor.quantity in ("rms", "mean"):
        square = jnp.mean(jnp.fft.irfft(spectrum, finer) ** 2)
        return square if sensor.quantity == "mean" else jnp.sqrt(square)
    slope = 1j * np.arange(spectrum.size) * (2 * np.pi / finer) * spectrum
    wave, change = jnp.fft.irfft(jnp.stack([spectrum, slope]), finer)
    both, slopes = jnp.stack([wave, -wave]), jnp.stack([change, -change])
    ahead = jnp.roll(both, -1, axis=1), jnp.roll(slopes, -1, axis=1)
    high, low = largest(cubic_maximum(both, slopes, *ahead))
    if sensor.quantity == "peak":
        return jnp.maximum(high, low) ** (2 if sensor.signal == "power" else 1)
    return (high + low) / (1.0 if sensor.quantity == "peak_to_peak" else 2.0)


def _largest_force(place: Place, motion: Complex[Array, "stops harmonics"], per_second):
    samples, finer = 2 * (motion.shape[-1] - 1), 4 * FINER
    motion = finer * motion.at[:, -1].set(0.0)
    both = jnp.stack([motion, differentiate(motion, samples) / finer])
    value, change = jnp.fft.irfft(both, finer * samples)
    forces = [
        stop.force(value[a], change[a] * finer * per_second)
        for a, stop in enumerate(without_memory(place.equations.stops))
    ]
    return largest(jnp.concatenate(forces))
