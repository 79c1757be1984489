"""Condensed harmonic balance: a system that is linear but for its stops, seen from the stops.

The force at the stops is the only nonlinearity, so the unknown is the motion at the stops alone,

    depth = depth without contact + receptance * force(depth, rate),

whatever the number of modes (design: Gandhi and Vyas 2017, eqs. 36 and 37, solved at the stop).
It is sampled in time. The force is averaged over a sampling cell, as a corner sampled at points
makes folds that are not there; averaged force and averaged depth are then related by the receptance
itself.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Complex, Float

from vibrojax._tools.eigenvalues import eigen
from vibrojax.model.equations import LinearEquations
from vibrojax.model.first_order import first_order, without_memory
from vibrojax.model.laws import can_pull, linear_coefficients
from vibrojax.model.stops import Stop
from vibrojax.steady.methods import check_balance
from vibrojax.steady.paths import Place

Scalar = Float[Array, ""]
Spectra = Complex[Array, "stops harmonics"]

LEAST_DYNAMIC = 1e-6
"""Least dynamic stiffness of a mode at resonance, relative to its static one: below it a balance
loses the digits in which the motion differs from that without stops. Exact motions need none."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


class Receptance(NamedTuple):
    """Steady response to unit harmonic inputs at some angular frequencies."""

    stop_from_force: Complex[Array, "stops stops harmonics"]
    """Displacement of each contact point towards its stop, by contact force (so mostly below 0)."""
    stop_from_input: Spectra
    response_from_force: Spectra
    response_from_input: Complex[Array, " harmonics"]


def receptance(
    equations: LinearEquations, angular_frequency: Float[Array, " harmonics"]
) -> Receptance:
    """Receptances of the unstopped system, m/N or m per unit input, exact in the modes kept."""
    table = _transfer(equations, angular_frequency, states=False)
    return Receptance(table[:-1, :-1], table[:-1, -1], table[-1, :-1], table[-1, -1])


def _transfer(equations: LinearEquations, w: Float[Array, " harmonics"], *, states: bool):
    """What contact forces and, last, the input cause, at some angular frequencies.

    Depths at the stops and, last, the response; or all `states`.
    """
    if not equations.is_modal or equations.memory_size:
        poles, left, right = _flight_poles(equations, states)
        dynamic = _damped(1j * w - poles[:, None], equations.angular_frequency[0])
        return jnp.einsum("rp,pc,pk->rck", left, right, 1.0 / dynamic)
    columns = jnp.concatenate([-equations.force_map, equations.input_map[:, None]], axis=1)
    natural, zeta = equations.angular_frequency, equations.damping_ratio
    stiff = equations.modal_stiffness[:, None] - w**2
    dynamic = stiff + 2j * (zeta * natural)[:, None] * w
    compliance = 1.0 / _damped(dynamic, 1j * (natural**2)[:, None])
    rows = jnp.concatenate([equations.stop_map, equations.response_map[None]])
    rows = jnp.eye(equations.size) if states else rows
    table = jnp.einsum("ri,ic,ik->rck", rows, columns, compliance)
    return jnp.concatenate([table, 1j * w * table]) if states else table


def _damped(dynamic, damping):
    """Give a mode that would respond without bound just enough damping to respond."""
    least = LEAST_DYNAMIC * damping
    return jnp.where(jnp.abs(dynamic) < jnp.abs(least), least, dynamic)


def _flight_poles(equations: LinearEquations, states: bool):
    """Poles of the unstopped system, and the two factors of its residues."""
    form, unit = first_order(equations), equations.angular_frequency[0]
    scale = form.scale
    values, vectors = eigen(form.flow * scale / scale[:, None] / unit)
    columns = jnp.concatenate([-form.push, form.input[:, None]], axis=1) / scale[:, None]
    rows = jnp.concatenate([form.depth, form.response[None]]) * scale
    rows = jnp.diag(scale) if states else rows
    return values * unit, rows @ vectors, jnp.linalg.solve(vectors, columns.astype(vectors.dtype))


class Problem(eqx.Module):
    """One lane at one parameter value: all that the residual needs."""

    stops: tuple[Stop, ...]
    receptance: Receptance
    drive: Spectra
    """Spectrum of the averaged depth without contact."""
    response_drive: Complex[Array, " harmonics"]
    """Spectrum of the reported displacement without contact."""
    per_second: Scalar
    """Samples in a second."""


def cell_average(samples: int, harmonics: int) -> Float[np.ndarray, " harmonics"]:
    """Transfer of the mean over a sampling cell with a hat as weight, two samples wide."""
    return np.sinc(np.arange(harmonics) / samples) ** 2


def condensed_problem(
    place: Place, *, samples: int, period: int = 1, harmonics: int | None = None
) -> Problem:
    """Set the problem up for motions over `period` drive periods, `samples` in all.

    `harmonics` of the motion are kept, counted over those periods; by default as many as the
    samples carry.
    """
    equations, w, count = place.equations, place.angular_frequency, samples // 2 + 1
    check_balance(equations.stops)
    table = receptance(equations, w / period * jnp.arange(count))
    kept = np.arange(count) <= (count if harmonics is None else harmonics)
    table = Receptance(*(jnp.where(kept, t, 0.0) for t in table))
    wave = _input_wave(place, samples, period)
    gaps = jnp.stack([jnp.asarray(stop.gap, float) for stop in equations.stops])
    still = jnp.zeros(count).at[0].set(samples)
    averaged = table.stop_from_input * wave * cell_average(samples, count)
    moved, response = table.response_from_input * wave, jnp.zeros(())
    if equations.load is not None:
        form, rest = first_order(equations), _under_load(equations)
        gaps, response = gaps - form.depth @ rest, form.response @ rest
    return Problem(
        stops=without_memory(equations.stops),
        receptance=table,
        drive=averaged - gaps[:, None] * still,
        response_drive=moved + response * still,
        per_second=samples / period * w / (2 * jnp.pi),
    )


def _input_wave(place: Place, samples: int, period: int) -> Complex[Array, " harmonics"]:
    """Spectrum of the drive's input."""
    w = place.angular_frequency
    amplitude = place.drive.complex_amplitude(w, jnp.zeros_like(w))
    none = jnp.zeros(samples // 2 + 1, complex)
    return none.at[period].set(-1j * amplitude * samples / 2)


def _under_load(equations: LinearEquations) -> Float[Array, " states"]:
    """State of rest under the forces that stay the same, without contact."""
    form = first_order(equations)
    scaled = form.flow * form.scale / form.scale[:, None]
    return -form.scale * jnp.linalg.solve(scaled, form.load / form.scale)


def differentiate(
    spectrum: Complex[Array, "... harmonics"], samples: int
) -> Complex[Array, "... harmonics"]:
    """Spectrum of the change per sample."""
    order = np.arange(spectrum.shape[-1]) * (2 * np.pi / samples)
    order[-1] = 0.0  # the highest harmonic has no slope at the samples
    return jnp.asarray(1j * order) * spectrum


def cell_force(
    stop: Stop,
    depth: Float[Array, " samples"],
    change: Float[Array, " samples"],
    per_second: Scalar,
) -> Float[Array, " samples"]:
    """Contact force averaged over the sampling cell, N.

    `change` is the depth gained per sample; over a cell the depth is a straight line.
    """
    law = linear_coefficients(stop.law)
    scale = jnp.sqrt(change**2 + jnp.asarray(stop.width, float) ** 2 + 1e-300)
    if law is not None and stop.is_linear and can_pull(stop.law):
        stiffness, damping = (jnp.asarray(c) for c in law)
        # Deep in the stop the mean is the force itself, which the polynomial would lose digits of.
        x = jnp.clip(depth / scale, -1.0, 1.0)
        above, here, below = (jnp.maximum(x + shift, 0.0) for shift in (1.0, 0.0, -1.0))
        ramp = scale * (above**3 - 2 * here**3 + below**3) / 6 + jnp.maximum(depth - scale, 0.0)
        touching = (above**2 - 2 * here**2 + below**2) / 2
        return stiffness * ramp + damping * change * per_second * touching
    # Two halves of the hat, each integrated where the depth is above zero.
    start = depth[:, None] - scale[:, None] * np.array([1.0, 0.0])
    end = start + scale[:, None]
    width = jnp.clip(end, 0.0) - jnp.clip(start, 0.0)
    place = jnp.clip(start, 0.0)[..., None] + width[..., None] * (_NODES + 1) / 2
    inside = (place - depth[:, None, None]) / scale[:, None, None]
    rate = (change * per_second)[:, None, None]
    force = _law_force(stop, place, rate * jnp.ones_like(place))
    return jnp.sum(force * (1 - jnp.abs(inside)) * _WEIGHTS / 2 * width[..., None], (1, 2)) / scale


def _law_force(stop: Stop, depth, rate):
    return stop.exact_force(depth, rate) if stop.smoothing is None else stop.force(depth, rate)


class Balance(NamedTuple):
    """Residual of a motion and what its linearisation needs."""

    residual: Spectra
    force: Spectra
    stiffness: Float[Array, "stops samples"]
    """Slope of the averaged force in the averaged depth."""
    damping: Float[Array, "stops samples"]
    """Slope in the change of depth per sample."""


def balance(problem: Problem, depth: Spectra) -> Balance:
    """Evaluate the residual depth - depth without contact - receptance * force."""
    samples, per_second = 2 * (depth.shape[-1] - 1), problem.per_second
    both = jnp.stack([depth, differentiate(depth, samples)])
    value, change = jnp.fft.irfft(both, samples)
    forces, slopes, slopes_of_change = [], [], []
    for a, stop in enumerate(problem.stops):
        # Elementwise, so one tangent of ones gives the whole diagonal.
        force, slope = jax.jvp(
            lambda d, stop=stop, a=a: cell_force(stop, d, change[a], per_second),
            (value[a],),
            (jnp.ones(samples),),
        )
        _, slope_of_change = jax.jvp(
            lambda v, stop=stop, a=a: cell_force(stop, value[a], v, per_second),
            (change[a],),
            (jnp.ones(samples),),
        )
        forces.append(force)
        slopes.append(slope)
        slopes_of_change.append(slope_of_change)
    force = jnp.fft.rfft(jnp.stack(forces))
    pushed = jnp.einsum("abk,bk->ak", problem.receptance.stop_from_force, force)
    return Balance(
        depth - problem.drive - pushed, force, jnp.stack(slopes), jnp.stack(slopes_of_change)
    )


def solve_condensed(
    problem: Problem,
    at: Balance,
    right: Complex[Array, "sides stops harmonics"],
    capacity: int,
) -> Complex[Array, "sides stops harmonics"]:
    """Solve the linearised balance for several right-hand sides (a change of the residual).

    The unknown is the change of force at the samples in contact, of which there may be at most
    `capacity`; the change of the motion follows from it.
    """
    stops, samples = at.stiffness.shape
    kernel = problem.receptance.stop_from_force
    both = jnp.fft.irfft(jnp.stack([kernel, differentiate(kernel, samples)]), samples)
    active = ((at.stiffness != 0) | (at.damping != 0)).reshape(-1)
    place = jnp.where(active, jnp.cumsum(active) - 1, capacity)
    index = (
        jnp.full(capacity, stops * samples).at[place].set(jnp.arange(stops * samples), mode="drop")
    )
    stiffness = jnp.append(at.stiffness.reshape(-1), 0.0)[index]
    damping = jnp.append(at.damping.reshape(-1), 0.0)[index]
    stop, time = jnp.minimum(index // samples, stops - 1), index % samples
    lag = (time[:, None] - time[None, :]) % samples
    if stops == 1:
        depth_of, change_of = both[0, 0, 0][lag], both[1, 0, 0][lag]
    else:
        pair = (stop[:, None], stop[None, :], lag)
        depth_of, change_of = both[0][pair], both[1][pair]
    matrix = jnp.eye(capacity) - stiffness[:, None] * depth_of - damping[:, None] * change_of
    sides = jnp.fft.irfft(jnp.stack([right, differentiate(right, samples)], axis=1), samples)
    sides = sides.reshape(right.shape[0], 2, -1)
    padded = jnp.concatenate([sides, jnp.zeros((*sides.shape[:2], 1))], axis=2)[:, :, index]
    pushes = stiffness * padded[:, 0] + damping * padded[:, 1]
    solved = jnp.linalg.solve(matrix, pushes.T).T
    force = jnp.zeros((right.shape[0], stops * samples)).at[:, index].set(solved, mode="drop")
    spectrum = jnp.fft.rfft(force.reshape(right.shape[0], stops, samples))
    return right + jnp.einsum("abk,sbk->sak", kernel, spectrum)


def solve_lanes(
    problems: Problem,
    at: Balance,
    right: Complex[Array, "lanes sides stops harmonics"],
    capacities: Sequence[int],
    running: Bool[ArrayLike, "*lanes"] = True,
) -> Complex[Array, "lanes sides stops harmonics"]:
    """Solve the linearised balances of many lanes, in the least capacity that holds them all.

    Lanes that are not `running` do not count.
    """
    touching = (at.stiffness != 0) | (at.damping != 0)
    needed = jnp.max(jnp.where(running, jnp.sum(touching, axis=(1, 2)), 0))
    solvers = [
        jax.vmap(lambda p, a, r, size=size: solve_condensed(p, a, r, size)) for size in capacities
    ]
    level = jnp.searchsorted(jnp.asarray(capacities), needed)
    return jax.lax.switch(level, solvers, problems, at, right)


def state_of(
    place: Place, force: Spectra, angle: Scalar, *, period: int = 1
) -> Float[Array, " states"]:
    """State at a drive phase (rad) of the motion with this spectrum of averaged force."""
    equations, count = place.equations, force.shape[-1]
    samples = 2 * (count - 1)
    w = place.angular_frequency / period * jnp.arange(count)
    table = _transfer(equations, w, states=True)
    wave = _input_wave(place, samples, period)
    inputs = jnp.concatenate([force / cell_average(samples, count), wave[None]])
    spectrum = jnp.einsum("rck,ck->rk", table, inputs)
    twice = jnp.full(count, 2.0).at[0].set(1.0).at[-1].set(0.0)
    turn = twice * jnp.exp(1j * angle / period * jnp.arange(count)) / samples
    state = (spectrum * turn).real.sum(1)
    return state if equations.load is None else state + _under_load(equations)
