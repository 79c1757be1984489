"""What is read off a motion found by harmonic balance: amplitudes, forces, stability, residual."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.eigenvalues import eigenvalues
from vibrojax.model.first_order import first_order
from vibrojax.steady.batches import in_batches
from vibrojax.steady.condensed import (
    balance,
    cell_average,
    condensed_problem,
    differentiate,
    solve_condensed,
    state_of,
)
from vibrojax.steady.paths import AbstractPath, Place, localise
from vibrojax.stepping.cubic import largest

Scalar = Float[Array, ""]
Spectra = Complex[Array, "stops harmonics"]

FINER = 4
"""How many times finer a motion is looked at than it was solved."""
CONVERGED = 1e-10
"""Relative Newton step at which a balance is solved."""
MOST_STEPS = 40


class BalancedMotion(NamedTuple):
    """What is read off a motion."""

    highest: Scalar
    lowest: Scalar
    mean_square: Scalar
    first_harmonic: Scalar
    contact_force: Scalar
    contact_fraction: Scalar
    contacts: Scalar
    initial_state: Float[Array, " states"]
    multipliers: Complex[Array, " states"]
    residual: Scalar
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


def read_balanced(place: Place, depth: Spectra, period: int) -> BalancedMotion:
    """Read a balanced motion on a finer grid, and judge it there."""
    samples = FINER * 2 * (depth.shape[-1] - 1)
    problem = condensed_problem(place, samples=samples, period=period)
    per_second = problem.per_second
    fine = refined(depth, FINER)
    at = balance(problem, fine)
    average = cell_average(samples, fine.shape[-1])
    push = jnp.einsum("bk,bk->k", problem.receptance.response_from_force, at.force / average)
    response = jnp.fft.irfft(problem.response_drive + push, samples)
    both = jnp.stack([fine / average, differentiate(fine / average, samples)])
    value, change = jnp.fft.irfft(both, samples)
    forces = [s.force(value[a], change[a] * per_second) for a, s in enumerate(problem.stops)]
    touching = value > 0
    angle = 2 * np.pi * period * np.arange(samples) / samples
    entered = touching & ~jnp.roll(touching, 1, axis=1)
    zero = jnp.zeros(())
    size = jnp.sqrt(jnp.sum(jnp.abs(fine) ** 2))
    return BalancedMotion(
        highest=largest(response),
        lowest=-largest(-response),
        mean_square=jnp.mean(response**2),
        first_harmonic=2
        * jnp.hypot(jnp.mean(response * np.sin(angle)), jnp.mean(response * np.cos(angle))),
        contact_force=largest(jnp.concatenate(forces)),
        contact_fraction=jnp.mean(jnp.any(touching, axis=0)),
        contacts=jnp.sum(entered) + zero,
        initial_state=state_of(place, at.force, zero, period=period),
        multipliers=eigenvalues(jax.lax.stop_gradient(kicked_monodromy(place, at, 1 / per_second))),
        residual=jnp.sqrt(jnp.sum(jnp.abs(at.residual) ** 2)) / size,
    )


def balanced_strobes(place: Place, depth: Spectra, period: int) -> Float[Array, "periods states"]:
    """Return the states of a balanced motion at drive phase 0, one for each drive period of it."""
    samples = 2 * (depth.shape[-1] - 1)
    force = balance(condensed_problem(place, samples=samples, period=period), depth).force
    phases = 2 * np.pi * jnp.arange(period)
    return jax.vmap(lambda phase: state_of(place, force, phase, period=period))(phases)


def kicked_monodromy(place: Place, at, interval):
    """Jacobian of the period map: exact flight over every sample, contact as a kick."""
    equations = place.equations
    form, lags = first_order(equations), [stop.memory_size > 0 for stop in equations.stops]
    scale = form.scale
    flight = jax.scipy.linalg.expm(form.flow * scale / scale[:, None] * interval)
    rates = jnp.where(np.reshape(lags, (-1, 1)), form.depth @ form.flow, form.rate)
    # The slope in the change of depth per sample is one in the rate, over the interval.
    stiffness, rate = at.stiffness * interval, at.damping * interval * interval

    def step(matrix, slopes):
        k, c = slopes
        moved = flight @ matrix
        depth, speed = (form.depth * scale) @ moved, (rates * scale) @ moved
        kick = (form.push / scale[:, None]) @ (k[:, None] * depth + c[:, None] * speed)
        return moved - kick, None

    matrix, _ = jax.lax.scan(step, jnp.eye(len(scale)), (stiffness.T, rate.T))
    return matrix


@compiled
def _read(paths, depth, parameter, period):
    return jax.vmap(lambda path, d, p: read_balanced(path.at(p), d, period))(
        paths, depth, parameter
    )


def read_all(
    paths: AbstractPath, lane: np.ndarray, depth: np.ndarray, parameter: np.ndarray, *, period: int
) -> BalancedMotion:
    """Read many motions, in batches."""
    return _of_each(_read, paths, lane, depth, parameter, period)


def _of_each(program, paths, lane, depth, parameter, period):
    paths = jax.device_get(paths)

    def some(i):
        here = localise(paths, lane[i], parameter[i], False)
        return program(here, depth[i], parameter[i], period)

    return in_batches(some, len(lane))


def solve_balance(
    place: Place,
    still: Place,
    depth: Float[Array, "stops fine_samples"],
    samples: int,
    period: int,
    harmonics: int | None,
) -> tuple[Spectra, Bool[Array, ""]]:
    """Newton's method on the balance from sampled depths; whether it converged.

    `still` is the place as a constant, in which the search runs; derivatives are implicit, in
    `place`.
    """
    total = samples * period
    count = total // 2 + 1
    start = jnp.fft.rfft(depth)[:, :count] * (total / depth.shape[1])
    start = start * cell_average(total, count)
    kept = None if harmonics is None else harmonics * period
    unknowns = len(place.equations.stops) * total

    def at(place, spectrum):
        problem = condensed_problem(place, samples=total, period=period, harmonics=kept)
        return problem, balance(problem, spectrum)

    def size(spectrum):
        return jnp.sqrt(jnp.sum(jnp.abs(spectrum) ** 2))

    def newton(carry):
        spectrum, _, tries = carry
        problem, here = at(still, spectrum)
        change = solve_condensed(problem, here, -here.residual[None], unknowns)[0]
        relative = size(change) / size(spectrum)
        # A long step is shortened, so that contacts are not gained and lost by the dozen.
        return spectrum + change * jnp.minimum(1.0, 0.3 / relative), relative, tries + 1

    def on(carry):
        _, relative, tries = carry
        return (relative > CONVERGED) & (tries < MOST_STEPS)

    found, relative, _ = jax.lax.while_loop(on, newton, (start, jnp.asarray(jnp.inf), 0))
    found = jax.lax.stop_gradient(found)
    problem, factor = at(still, found)
    _, now = at(place, found)
    converged = jnp.isfinite(relative) & (relative <= CONVERGED)
    right = -jnp.where(converged, now.residual, 0.0)[None]
    change = solve_condensed(problem, factor, right, unknowns)[0]
    return found + change, converged


@compiled
def _solve_here(paths, depth, parameter, period):
    samples = 2 * (depth.shape[-1] - 1)

    def one(path, depth, parameter):
        place = path.at(parameter)
        waveform = jnp.fft.irfft(depth / cell_average(samples, depth.shape[-1]), samples)
        return solve_balance(place, place, waveform, samples // period, period, None)

    return jax.vmap(one)(paths, depth, parameter)


def solve_all(
    paths: AbstractPath, lane: np.ndarray, depth: np.ndarray, parameter: np.ndarray, *, period: int
) -> tuple[np.ndarray, np.ndarray]:
    """Solve many balances at fixed parameters from motions nearby; spectra and which converged."""
    return _of_each(_solve_here, paths, lane, depth, parameter, period)
