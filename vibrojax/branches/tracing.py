"""Branches of many lanes from first guess to exact points: the work of `continue_response`.

A few lanes at a time run in one compiled loop (wider loops are no faster); a lane that ends makes
room for the next one.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float

from vibrojax._tools.types import AnyArray
from vibrojax.branches.continuation import Ending, Settings, Trace, follow
from vibrojax.steady.batches import REPAIRS, in_batches, take
from vibrojax.steady.condensed import (
    balance,
    cell_average,
    condensed_problem,
    differentiate,
    state_of,
)
from vibrojax.steady.contact_times import MOST_EVENTS, Orbit
from vibrojax.steady.exact_point import ExactPoint, Guess, exact_point
from vibrojax.steady.orbit_reading import find_crossings, state_at
from vibrojax.steady.paths import AbstractPath, FrequencyPath, localise
from vibrojax.stepping.resonance import is_unbounded, undamped_at

WIDTHS = (1, 32)
"""Lanes in one loop; the number compiled is the least of these that holds them all."""
TICKS = 64


class Traced(NamedTuple):
    """The points of one lane, along its branch."""

    parameter: np.ndarray
    depth: np.ndarray
    direction: np.ndarray
    """Change of the parameter along the branch."""
    ending: Ending
    ticks: int


@eqx.filter_jit
def _follow(paths, settings, trace, samples, period, harmonics):
    return follow(
        paths,
        settings,
        trace,
        samples=samples,
        period=period,
        harmonics=harmonics,
        ticks=TICKS,
    )


@eqx.filter_jit
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


def trace_branches(
    paths: AbstractPath,
    settings: Settings,
    start: Trace,
    *,
    samples: int,
    period: int = 1,
    harmonics: int | None = None,
    max_points: int = 2000,
    widths: tuple[int, ...] = WIDTHS,
) -> list[Traced]:
    """Follow the branch of every lane; lanes that end make room for those that wait."""
    lanes = start.parameter.shape[0]
    width = next((w for w in widths if w >= lanes), widths[-1])
    waiting = list(range(lanes))
    places: list[int | None] = [None] * width
    found: dict[int, list] = {lane: [] for lane in range(lanes)}
    done: dict[int, Traced] = {}
    # Lanes are put in and taken out on the host: single operations on a device cost more.
    paths, settings, start = jax.device_get((paths, settings, start))
    trace = take(start, np.zeros(width, int))
    trace = trace._replace(status=np.full(width, Ending.completed.value, np.int32))
    index = np.zeros(width, int)
    here = None
    while len(done) < lanes:
        for place in range(width):
            if places[place] is None and waiting:
                lane = waiting.pop(0)
                places[place], index[place] = lane, lane
                trace, here = jax.device_get(trace), None
                trace = _put(trace, take(start, np.array([lane])), np.array([place]))
        if here is None:
            chosen = Settings(*(s if s.ndim == 0 else s[index] for s in settings))
            here = jax.device_put((take(paths, index), chosen))
        trace, points = _follow(*here, trace, samples, period, harmonics)
        accepted = np.asarray(points.accepted)
        columns = [np.asarray(a) for a in (points.parameter, points.depth, points.direction)]
        status, ticks = np.asarray(trace.status), np.asarray(trace.ticks)
        for place, lane in enumerate(places):
            if lane is None:
                continue
            kept = accepted[:, place]
            found[lane].append([c[kept, place] for c in columns])
            count = sum(len(part[0]) for part in found[lane])
            ending = Ending(int(status[place]))
            over = count > max_points or ticks[place] > 8 * max_points
            if ending is not Ending.running or over:
                parameter, depth, direction = (
                    np.concatenate(part) for part in zip(*found[lane], strict=True)
                )
                done[lane] = Traced(parameter, depth, direction, ending, int(ticks[place]))
                places[place] = None
                if over:
                    stopped = np.array(trace.status)
                    stopped[place] = Ending.stuck.value
                    trace = trace._replace(status=stopped)
    return [done[lane] for lane in range(lanes)]


@eqx.filter_jit
def _crossings(depth, change, period):
    return jax.vmap(lambda d, c: find_crossings(d, c, MOST_EVENTS, period))(depth, change)


@eqx.filter_jit
def _balanced(paths, depth, parameter, period, harmonics):
    """Samples of depth and its change, and the spectrum of the force, of balanced motions."""
    samples = 2 * (depth.shape[-1] - 1)

    def one(path, depth, parameter):
        place = path.at(parameter)
        motion = depth / cell_average(samples, depth.shape[-1])
        both = jnp.stack([motion, differentiate(motion, samples)])
        value, change = jnp.fft.irfft(both, samples)
        problem = condensed_problem(
            place.equations,
            place.drive,
            place.angular_frequency,
            samples=samples,
            period=period,
            harmonics=harmonics,
        )
        per_second = samples / period * place.angular_frequency / (2 * jnp.pi)
        at = balance(problem, depth, per_second, samples)
        return value, change, at.force

    return jax.vmap(one)(paths, depth, parameter)


@eqx.filter_jit
def _states(paths, force, parameter, angle, period):
    samples = 2 * (force.shape[-1] - 1)

    def one(path, force, parameter, angle):
        place = path.at(parameter)
        drive, frequency = place.drive, place.angular_frequency
        return state_of(
            place.equations, drive, frequency, force, angle, samples=samples, period=period
        )

    return jax.vmap(one)(paths, force, parameter, angle)


@eqx.filter_jit
def _exact(paths, guess, parameter, period, hold):
    def one(path, guess, parameter, hold):
        return exact_point(path.tables, guess, parameter, period, hold=hold)

    return jax.vmap(one)(paths, guess, parameter, hold)


@eqx.filter_jit
def _states_at(paths, parameter, motion, section, begin, period):
    def one(path, parameter, motion, section, begin):
        tables = path.tables(parameter)
        return state_at(tables, motion, section, begin, period)

    return jax.vmap(one)(paths, parameter, motion, section, begin)


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
        value, change, force = _balanced(here, depth[i], parameter[i], period, None)
        found = _crossings(value, change, period)
        state = _states(here, force, parameter[i], found.events.section, period)
        return _guess(found, state)

    guesses = in_batches(guess, len(lane))
    return exact_from(paths, lane, guesses, parameter, period=period, hold=hold)


def _guess(found, state) -> Guess:
    return Guess(found.events, Orbit(state, found.times), found.number <= MOST_EVENTS)


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

    def solve(i, points=None, motions=None):
        guess, at = take(guesses, i), parameter[i]
        here = localise(paths, lane[i], at, exact=True)
        if points is not None:
            reading, section = points.reading, points.events.section
            found = _crossings(reading.depth, reading.change, period)
            there = found.events.section
            guess = _guess(
                found,
                _states_at(here, points.parameter, motions, there, section, period),
            )
        return _exact(here, guess, at, period, held[i])

    best, motions = in_batches(solve, len(lane))
    for _ in range(REPAIRS):
        left = np.flatnonzero(~best.valid)
        if not len(left):
            break

        def repair(i, left=left, best=best, motions=motions):
            return solve(left[i], take(best, left[i]), take(motions, left[i]))

        again = in_batches(repair, len(left))
        best, motions = _put((best, motions), again, left)
    if not isinstance(paths, FrequencyPath) and not held.all():
        # Near its value the path was taken to first order: once more from where the points are.
        guesses = Guess(best.events, best.orbit, np.ones(len(lane), bool))
        parameter = np.where(best.valid, best.parameter, parameter)
        best, motions = in_batches(solve, len(lane))
    return best


def _put(whole, part, at):
    def put(a, b):
        a = np.array(a)
        a[at] = b
        return a

    return jax.tree.map(put, whole, part)
