"""What is traced of a branch, and its points made exact."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.branches.continuation import Ending
from vibrojax.steady.batches import BATCH, REPAIRS, in_batches, take
from vibrojax.steady.condensed import (
    balance,
    cell_average,
    condensed_problem,
    differentiate,
    state_of,
)
from vibrojax.steady.contact_times import Orbit
from vibrojax.steady.exact_point import ExactPoint, Guess, exact_point
from vibrojax.steady.orbit_reading import Crossings, find_crossings, state_at
from vibrojax.steady.paths import AbstractPath, FrequencyPath, localise
from vibrojax.stepping.measures import MOST_EVENTS
from vibrojax.stepping.resonance import is_unbounded, undamped_at


class Traced(NamedTuple):
    """The points of one lane, along its branch."""

    parameter: np.ndarray
    depth: np.ndarray
    direction: np.ndarray
    """Change of the parameter along the branch."""
    ending: Ending
    ticks: int


@compiled
def free_motion(paths: AbstractPath, parameter, samples: int, period: int):
    """Averaged depths without contact, of every lane: the first guess. NaN where it is endless."""

    def one(path, p):
        place = path.at(p)
        problem = condensed_problem(
            place.equations, place.drive, place.angular_frequency, samples=samples, period=period
        )
        resonances = undamped_at(place.equations, place.drive)
        endless = is_unbounded(resonances, place.angular_frequency)
        return jnp.where(endless, jnp.nan, problem.drive)

    return jax.vmap(one)(paths, parameter)


def _guess(found: Crossings, state) -> Guess:
    return Guess(found.events, Orbit(state, found.times), found.number <= MOST_EVENTS)


@compiled
def _sampled_guess(paths, depth, parameter, period) -> Guess:
    """Contact times of balanced motions, and their states at the first of them."""
    samples = 2 * (depth.shape[-1] - 1)

    def one(path, depth, parameter):
        place = path.at(parameter)
        equations, drive, w = place.equations, place.drive, place.angular_frequency
        motion = depth / cell_average(samples, depth.shape[-1])
        both = jnp.stack([motion, differentiate(motion, samples)])
        value, change = jnp.fft.irfft(both, samples)
        found = find_crossings(value, change, MOST_EVENTS, period)
        problem = condensed_problem(equations, drive, w, samples=samples, period=period)
        per_second = samples / period * w / (2 * jnp.pi)
        force = balance(problem, depth, per_second, samples).force
        angle = found.events.section
        state = state_of(equations, drive, w, force, angle, samples=samples, period=period)
        return _guess(found, state)

    return jax.vmap(one)(paths, depth, parameter)


@compiled
def _guess_again(paths, point: ExactPoint, motion, period) -> Guess:
    """Contact times of motions that broke their sequence of contacts, as they then come."""

    def one(path, point, motion):
        found = find_crossings(point.reading.depth, point.reading.change, MOST_EVENTS, period)
        tables, section = path.tables(point.parameter), point.events.section
        return _guess(found, state_at(tables, motion, found.events.section, section, period))

    return jax.vmap(one)(paths, point, motion)


@compiled
def _exact(paths, guess, parameter, period, hold):
    def one(path, guess, parameter, hold):
        return exact_point(path.tables, guess, parameter, period, hold=hold)

    return jax.vmap(one)(paths, guess, parameter, hold)


def make_exact_ahead(paths: FrequencyPath, samples: int, period: int) -> None:
    """Compile in the background what `make_exact` will run for motions of so many samples."""
    ones = np.ones(BATCH)
    here = localise(paths, np.zeros(BATCH, int), ones, exact=True)
    depth = np.zeros((BATCH, len(paths.equations.stops), samples // 2 + 1), complex)
    guess = _sampled_guess.ahead(here, depth, ones, period)
    point, motion = _exact.ahead(here, guess, ones, period, ones > 0)
    _guess_again.ahead(here, point, motion, period)


def make_exact(
    paths: AbstractPath,
    lane: np.ndarray,
    depth: Complex[AnyArray, "points stops harmonics"],
    parameter: Float[AnyArray, " points"],
    *,
    period: int = 1,
    hold: bool | Bool[np.ndarray, " points"] = False,
) -> ExactPoint:
    """Turn sampled motions into exact ones, in batches; those that cannot be are not `valid`.

    Those to `hold` stay at their parameter, others move across the branch.
    Where a motion breaks its sequence of contacts, the sequence is taken from the motion found and
    the search repeated.
    """
    paths = jax.device_get(paths)

    def guess(i):
        here = localise(paths, lane[i], parameter[i], exact=True)
        return _sampled_guess(here, depth[i], parameter[i], period)

    guesses = in_batches(guess, len(lane))
    return exact_from(paths, lane, guesses, parameter, period=period, hold=hold)


def exact_from(
    paths: AbstractPath,
    lane: np.ndarray,
    guesses: Guess,
    parameter: Float[AnyArray, " points"],
    *,
    period: int = 1,
    hold: bool | Bool[np.ndarray, " points"] = False,
) -> ExactPoint:
    """Turn guesses of contact times into exact motions, in batches; `hold` as in `make_exact`."""
    parameter = np.asarray(parameter)
    held = np.broadcast_to(hold, parameter.shape)

    # Every batch has its own stack of paths, so that the number of lanes compiles nothing anew.
    paths = jax.device_get(paths)

    def solve(i, before=None):
        here = localise(paths, lane[i], parameter[i], exact=True)
        guess = (
            take(guesses, i) if before is None else _guess_again(here, before[0], before[1], period)
        )
        return _exact(here, guess, parameter[i], period, held[i])

    found = in_batches(solve, len(lane))
    for _ in range(REPAIRS):
        left = np.flatnonzero(~found[0].valid)
        if not len(left):
            break

        def repair(i, left=left, found=found):
            return solve(left[i], take(found, left[i]))

        found = put(found, in_batches(repair, len(left)), left)
    best = found[0]
    if not isinstance(paths, FrequencyPath) and not held.all():
        # Near its value the path was taken to first order: once more from where the points are.
        guesses = Guess(best.events, best.orbit, np.ones(len(lane), bool))
        parameter = np.where(best.valid, best.parameter, parameter)
        best, _ = in_batches(solve, len(lane))
    return best


def held_from(
    paths: AbstractPath,
    lane: np.ndarray,
    points: ExactPoint,
    at: np.ndarray,
    near: ExactPoint,
    parameter: np.ndarray,
    period: int,
) -> ExactPoint:
    """Find some points anew, held at their parameters, from motions near them."""
    if not len(at):
        return points
    guesses = Guess(near.events, near.orbit, near.valid)
    found = exact_from(paths, lane[at], guesses, parameter[at], period=period, hold=True)
    return put(points, found, at)


def put(whole: Any, part: Any, at: np.ndarray) -> Any:
    """Return a stacked tree with some lanes replaced."""

    def one(a, b):
        a = np.array(a)
        a[at] = b
        return a

    return jax.tree.map(one, whole, part)
