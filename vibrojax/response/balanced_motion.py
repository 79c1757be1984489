"""What is read off a motion found by harmonic balance: amplitudes, forces, stability, residual."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from vibrojax.response.condensed import (
    balance,
    cell_average,
    condensed_problem,
    differentiate,
    state_of,
)
from vibrojax.response.paths import AbstractPath, Place
from vibrojax.response.tracing import in_batches, take

FINER = 4
"""How many times finer a motion is looked at than it was solved."""


class BalancedMotion(NamedTuple):
    """What is read off a motion."""

    highest: Float[Array, ""]
    lowest: Float[Array, ""]
    mean_square: Float[Array, ""]
    first_harmonic: Float[Array, ""]
    contact_force: Float[Array, ""]
    contact_fraction: Float[Array, ""]
    contacts: Float[Array, ""]
    initial_state: Float[Array, " states"]
    multipliers: Complex[Array, " states"]
    residual: Float[Array, ""]
    """Of the balance on a finer grid, over the size of the motion."""


def refined(
    depth: Complex[Array, "... harmonics"], factor: int
) -> Complex[Array, "... harmonics_refined"]:
    """Spectrum of the same averaged motion sampled more finely, with its shorter cells."""
    count = depth.shape[-1]
    samples = 2 * (count - 1)
    fine = factor * samples // 2 + 1
    motion = depth / cell_average(samples, count)
    # The highest harmonic of even sampling stands for two.
    motion = motion.at[..., -1].multiply(0.5) * factor
    padded = jnp.zeros((*depth.shape[:-1], fine), complex).at[..., :count].set(motion)
    return padded * cell_average(factor * samples, fine)


def read_balanced(
    place: Place, depth: Complex[Array, "stops harmonics"], period: int
) -> BalancedMotion:
    """Read a balanced motion on a finer grid, and judge it there."""
    samples = FINER * 2 * (depth.shape[-1] - 1)
    equations, drive, w = place.equations, place.drive, place.angular_frequency
    problem = condensed_problem(equations, drive, w, samples=samples, period=period)
    per_second = samples / period * w / (2 * jnp.pi)
    fine = refined(depth, FINER)
    at = balance(problem, fine, per_second, samples)
    average = cell_average(samples, fine.shape[-1])
    push = jnp.einsum("bk,bk->k", problem.receptance.response_from_force, at.force / average)
    response = jnp.fft.irfft(problem.response_drive + push, samples)
    both = jnp.stack([fine / average, differentiate(fine / average, samples)])
    value, change = jnp.fft.irfft(both, samples)
    forces = [s.force(value[a], change[a] * per_second) for a, s in enumerate(equations.stops)]
    touching = value > 0
    angle = 2 * np.pi * period * np.arange(samples) / samples
    entered = touching & ~jnp.roll(touching, 1, axis=1)
    zero = jnp.zeros(())
    size = jnp.sqrt(jnp.sum(jnp.abs(fine) ** 2))
    return BalancedMotion(
        highest=jnp.max(response),
        lowest=jnp.min(response),
        mean_square=jnp.mean(response**2),
        first_harmonic=2
        * jnp.hypot(jnp.mean(response * np.sin(angle)), jnp.mean(response * np.cos(angle))),
        contact_force=jnp.max(jnp.stack(forces)),
        contact_fraction=jnp.mean(jnp.any(touching, axis=0)),
        contacts=jnp.sum(entered) + zero,
        initial_state=state_of(
            equations, drive, w, at.force, zero, samples=samples, period=period
        ),
        multipliers=jnp.linalg.eigvals(_monodromy(place, at, 1 / per_second)),
        residual=jnp.sqrt(jnp.sum(jnp.abs(at.residual) ** 2)) / size,
    )


def _monodromy(place: Place, at, interval):
    """Jacobian of the period map: exact flight over every sample, contact as a kick."""
    equations = place.equations
    n = equations.size
    w = equations.angular_frequency
    damping = jnp.diag(2 * equations.damping_ratio * w)
    if equations.damping_coupling is not None:
        damping = damping + equations.damping_coupling
    unit = w[0]
    flight = jnp.block(
        [[jnp.zeros((n, n)), unit * jnp.eye(n)], [-jnp.diag(w**2) / unit, -damping]]
    )
    flight = jax.scipy.linalg.expm(flight * interval)
    # The slope in the change of depth per sample is one in the rate, over the interval.
    stiffness, rate = at.stiffness * interval / unit, at.damping * interval * interval

    def step(matrix, slopes):
        k, c = slopes
        moved = flight @ matrix
        depth = equations.stop_map @ moved[:n]
        speed = equations.stop_map @ moved[n:]
        kick = equations.force_map @ (k[:, None] * depth + c[:, None] * speed)
        return moved.at[n:].add(-kick), None

    matrix, _ = jax.lax.scan(step, jnp.eye(2 * n), (stiffness.T, rate.T))
    return matrix


@eqx.filter_jit
def _read(paths, depth, parameter, period):
    return jax.vmap(lambda path, d, p: read_balanced(path.at(p), d, period))(
        paths, depth, parameter
    )


def read_all(
    paths: AbstractPath,
    lane: np.ndarray,
    depth: np.ndarray,
    parameter: np.ndarray,
    *,
    period: int,
) -> BalancedMotion:
    """Read many motions, in batches."""
    paths = jax.device_get(paths)
    return in_batches(
        lambda i: _read(take(paths, lane[i]), depth[i], parameter[i], period), len(lane)
    )
