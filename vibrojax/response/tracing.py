"""Branches of many lanes from first guess to exact points: the work of `continue_response`.

A few lanes at a time run in one compiled loop (wider loops are no faster); a lane that ends makes
room for the next one.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from vibrojax.response import continuation
from vibrojax.response.condensed import (
    balance,
    cell_average,
    condensed_problem,
    differentiate,
    state_of,
)
from vibrojax.response.contact_times import MOST_EVENTS, Orbit
from vibrojax.response.continuation import Ending, Settings, Trace, begin, follow
from vibrojax.response.exact_point import ExactPoint, Guess, exact_point
from vibrojax.response.orbit_reading import find_crossings
from vibrojax.response.paths import AbstractPath

WIDTHS = (1, 4, 32)
"""Lanes in one loop; the number compiled is the least of these that holds them all."""
TICKS = 64
BATCH = 128
"""Points made exact at a time."""
REPAIRS = 3


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
    """Averaged depths without contact, of every lane: the first guess."""

    def one(path, p):
        place = path.at(p)
        problem = condensed_problem(
            place.equations, place.drive, place.angular_frequency, samples=samples, period=period
        )
        return problem.drive

    return jax.vmap(one)(paths, parameter)


def take(tree, index):
    """Pick lanes of a stacked tree."""
    return jax.tree.map(lambda a: a[index] if eqx.is_array(a) else a, tree)


def trace_branches(
    paths: AbstractPath,
    settings: Settings,
    start: Trace,
    *,
    samples: int,
    period: int = 1,
    harmonics: int | None = None,
    max_points: int = 2000,
    progress=None,
) -> list[Traced]:
    """Follow the branch of every lane; lanes that end make room for those that wait."""
    lanes = start.parameter.shape[0]
    width = next((w for w in WIDTHS if w >= lanes), WIDTHS[-1])
    waiting = list(range(lanes))
    places: list[int | None] = [None] * width
    found: dict[int, list] = {lane: [] for lane in range(lanes)}
    done: dict[int, Traced] = {}
    trace = jax.tree.map(lambda a: a[jnp.zeros(width, int)], start)
    trace = trace._replace(status=jnp.full(width, Ending.completed.value, jnp.int32))
    lane_of = np.zeros(width, int)
    while len(done) < lanes:
        for place in range(width):
            if places[place] is None and waiting:
                lane = waiting.pop(0)
                places[place], lane_of[place] = lane, lane
                trace = jax.tree.map(
                    lambda a, b, lane=lane, place=place: a.at[place].set(b[lane]), trace, start
                )
        index = jnp.asarray(lane_of)
        here = Settings(*(s if s.ndim == 0 else s[index] for s in settings))
        trace, points = _follow(take(paths, index), here, trace, samples, period, harmonics)
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
            if ending is not Ending.running or count > max_points or ticks[place] > 8 * max_points:
                joined = [np.concatenate(part) for part in zip(*found[lane], strict=True)]
                done[lane] = Traced(*joined, ending, int(ticks[place]))
                places[place] = None
                trace = trace._replace(
                    status=trace.status.at[place].set(Ending.completed.value)
                )
                if progress is not None:
                    progress()
    return [done[lane] for lane in range(lanes)]


def _first_guess(path, depth, parameter, samples, period):
    """Contact times and state of a sampled motion."""
    place = path.at(parameter)
    motion = depth / cell_average(samples, depth.shape[-1])
    value, change = jnp.fft.irfft(jnp.stack([motion, differentiate(motion, samples)]), samples)
    found = find_crossings(value, change, MOST_EVENTS, period)
    problem = condensed_problem(
        place.equations, place.drive, place.angular_frequency, samples=samples, period=period
    )
    per_second = samples / period * place.angular_frequency / (2 * jnp.pi)
    force = balance(problem, depth, per_second, samples).force
    state = state_of(
        place.equations,
        place.drive,
        place.angular_frequency,
        force,
        found.events.section,
        samples=samples,
        period=period,
    )
    return Guess(found.events, Orbit(state, found.times), found.count <= MOST_EVENTS)


@eqx.filter_jit
def _guesses(paths, lane, depth, parameter, period):
    samples = 2 * (depth.shape[-1] - 1)

    def one(lane, depth, parameter):
        return _first_guess(take(paths, lane), depth, parameter, samples, period)

    return jax.vmap(one)(lane, depth, parameter)


@eqx.filter_jit
def _exact(paths, lane, guess, parameter, period, hold):
    def one(lane, guess, parameter):
        path = take(paths, lane)
        return exact_point(path.tables, guess, parameter, period, hold=hold)

    return jax.vmap(one)(lane, guess, parameter)


def make_exact(
    paths: AbstractPath,
    lane: np.ndarray,
    depth: Complex[np.ndarray, "points stops harmonics"],
    parameter: Float[np.ndarray, " points"],
    *,
    period: int = 1,
    hold: bool = False,
) -> ExactPoint:
    """Turn sampled motions into exact ones, in batches; those that cannot be are not `valid`.

    Where a motion breaks its sequence of contacts, the sequence is taken from the motion found and
    the search repeated.
    """
    lane = np.asarray(lane)
    parameter = np.asarray(parameter)
    guesses = _in_batches(
        lambda i: _guesses(paths, lane[i], depth[i], parameter[i], period), len(lane)
    )
    return exact_from(paths, lane, guesses, parameter, period=period, hold=hold)


def exact_from(paths, lane, guesses, parameter, *, period=1, hold=False) -> ExactPoint:
    """Turn guesses of contact times into exact motions, in batches."""
    best = None
    left = np.arange(len(lane))
    for _ in range(1 + REPAIRS):

        def solve(i, left=left):
            at = left[i]
            return _exact(paths, lane[at], take(guesses, at), parameter[at], period, hold)

        points, following = _in_batches(solve, len(left))
        if best is None:
            best, guesses = points, following
        else:
            better = points.valid
            best = _put(best, points, left, better | ~best.valid[left])
            guesses = _put(guesses, following, left, np.ones(len(left), bool))
        left = np.flatnonzero(~best.valid)
        if not len(left):
            break
    return best


def _put(whole, part, at, where):
    def put(a, b):
        a = np.array(a)
        a[at[where]] = b[where]
        return a

    return jax.tree.map(put, whole, part)


def _in_batches(function, count: int):
    """Run a function of an index over batches of one size, the last one filled up by repeats."""
    size = BATCH if count > BATCH // 8 else BATCH // 8
    parts = []
    for first in range(0, count, size):
        index = np.minimum(np.arange(first, first + size), count - 1)
        parts.append(function(index))
    parts = jax.device_get(parts)
    return jax.tree.map(lambda *a: np.concatenate(a)[:count], *parts)
