"""Means over an exact motion in closed form: between its events it is a sum of exponentials."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from vibrojax.steady.contact_times import PiecewiseMotion, Tables
from vibrojax.stepping.elementary import varied

Terms = Complex[Array, " terms"]

NEAR = 0.5
"""Exponents below which the quotient of differences is taken by its series."""
ORDER = 13
"""Terms of it: the next one is below round-off there."""


def _mean_growth(exponent: Complex[Array, "..."], grown: Complex[Array, "..."]) -> Array:
    """Mean of exp(x s) over s from 0 to 1, for exponents x; `grown` is exp(x)."""
    near = jnp.abs(exponent) < NEAR
    small = jnp.where(near, exponent, 0.0)
    series = jnp.ones_like(small)
    for order in range(ORDER, 1, -1):
        series = 1 + small / order * series
    return jnp.where(near, series, (grown - 1) / jnp.where(near, 1.0, exponent))


def _terms(
    tables: Tables, motion: PiecewiseMotion, segment: Int[Array, ""], row: int
) -> tuple[Terms, Terms]:
    """A row of the read-out over a segment as a sum of exponentials of the time since its
    beginning: amplitudes, and rates in 1/s."""
    phases, n = tables.phases, tables.phases.num_blocks
    phase, blocks = motion.phase[segment], motion.blocks[:, segment]
    left, right = phases.readout[phase, row, :n], phases.readout[phase, row, n:]
    decay, turn = phases.exponent[phase], phases.rate[phase]
    turning = phases.oscillates[phase] > 0
    amplitude = (left - 1j * right) * (blocks[:n] + 1j * blocks[n:]) / 2
    begun = jnp.exp(1j * motion.start[segment])
    driven = -0.5j * tables.rows[phase, row] * begun
    w = 1j * tables.angular_frequency
    one = jnp.where(turning, amplitude, left * blocks[:n])
    other = jnp.where(turning, jnp.conj(amplitude), right * blocks[n:])
    rest = phases.readout_rest[phase, row]
    amplitudes = jnp.concatenate([one, other, jnp.stack([driven, jnp.conj(driven), rest + 0j])])
    rates = [decay[0] + 1j * turn, decay[1] - 1j * turn, jnp.stack([w, -w, 0 * w])]
    return amplitudes, jnp.concatenate(rates)


def mean_square_and_harmonic(
    tables: Tables, motion: PiecewiseMotion, period: int, count: Int[Array, ""] | None = None
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Mean square of the reported displacement and its amplitude at the drive frequency.

    No block may be driven in resonance. `count` is the number of segments to go through; without it
    all are, which reverse mode needs.
    """
    w = tables.angular_frequency

    def add(j: Int[Array, ""], sums: tuple[Array, Array]) -> tuple[Array, Array]:
        angle = motion.stop[j] - motion.start[j]
        time = angle / w
        amplitudes, rates = _terms(tables, motion, j, 3 * tables.phases.num_stops)
        exponents = rates * time
        grown = jnp.exp(exponents)
        pairs = exponents[:, None] + exponents
        square = amplitudes @ _mean_growth(pairs, grown[:, None] * grown) @ amplitudes
        turned = exponents - 1j * angle
        harmonic = amplitudes @ _mean_growth(turned, grown * jnp.exp(-1j * angle))
        harmonic = harmonic * jnp.exp(-1j * motion.start[j])
        return sums[0] + square.real * angle, sums[1] + harmonic * angle

    zero = varied(jnp.zeros_like(w), w)
    segments = motion.start.size if count is None else count
    square, harmonic = jax.lax.fori_loop(0, segments, add, (zero, zero + 0j))
    whole = 2 * np.pi * period
    # Where the motion vanishes the modulus has no derivative.
    size = harmonic.real**2 + harmonic.imag**2
    modulus = jnp.where(size > 0, jnp.sqrt(jnp.where(size > 0, size, 1.0)), 0.0)
    return square / whole, 2 * modulus / whole


def mean_force(
    tables: Tables, motion: PiecewiseMotion, period: int, count: Int[Array, ""]
) -> Float[Array, ""]:
    """Mean of the contact force over the motion, N, all stops together, of so many segments.

    No block may be driven in resonance.
    """
    phases, stops = tables.phases, tables.phases.num_stops
    w = tables.angular_frequency

    def add(j: Int[Array, ""], total: Array) -> Array:
        angle = motion.stop[j] - motion.start[j]
        for s in range(stops):
            force = jnp.zeros(())
            for row, factor in ((s, phases.stiffness[s]), (stops + s, phases.damping[s])):
                amplitudes, rates = _terms(tables, motion, j, row)
                exponents = rates * (angle / w)
                mean = amplitudes @ _mean_growth(exponents, jnp.exp(exponents))
                force = force + factor * mean.real
            held = ((motion.phase[j] >> s) & 1) == 1
            total = total + jnp.where(held, force * angle, 0.0)
        return total

    total = jax.lax.fori_loop(0, count, add, varied(jnp.zeros_like(w), w))
    return total / (2 * np.pi * period)


def contact_fraction(motion: PiecewiseMotion, period: int) -> Float[Array, ""]:
    """Share of the time in contact with any stop."""
    length = jnp.maximum(motion.stop - motion.start, 0.0)
    return jnp.sum(jnp.where(motion.phase > 0, length, 0.0)) / (2 * np.pi * period)
