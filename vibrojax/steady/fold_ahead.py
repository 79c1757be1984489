"""Where settled motions turn back: the folds at which a response jumps, solved for.

From a settled motion the branch is gone along by its arc length, which a fold does not stop, until
the frequency turns back; between the last two points the fold is where its rate vanishes. Motions
are those of `following`: block coordinates at the section and times of contact.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.steady.following import FollowedLanes, advance
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.period_maps import is_stable, size_of
from vibrojax.steady.pool_programs import (
    in_widths,
    measured,
    targets_for,
    widths_for,
    widths_to_measure,
)
from vibrojax.steady.tracks import begin_track, can_follow, keeps_to_contacts, no_tracks
from vibrojax.stepping.elementary import apply_matrix
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

lax = jax.lax

FIRST_STEP = 0.25
"""First step, of which 1 would be about all of the way on a straight branch."""
NEXT_TO_TOUCH = 2e-7
"""Most that it changes the frequency by beside a touch, over the frequency: a fold may be close."""
LONGEST_STEP = 1.0
ROUNDS = 6
"""Of Newton's method for a point."""
SHRINKS = 0.25
"""Factor by which every one of them has to bring the correction down, from 1 to begin with."""
EASY = 3
"""Rounds after which the next step is as long as the last: after fewer it is twice as long."""
MOST = 150
"""The same for all points."""
CLOSE = 1e-7
"""Correction, in units, after which there is no need of another: it is squared every time."""
TURNED = 1e-5
"""Rate of the frequency along the branch, over that of a straight one, at a fold. The frequency
there is right to the square of it."""
LINGERS = 300
"""Drive periods after which a motion from behind a fold is near enough to one before it."""
NOT_YET = 1e-2
"""Rate down to which motions have to be stable: beyond, one multiplier is all but 1."""


class FoldAhead(NamedTuple):
    """What there is ahead of lanes."""

    found: Bool[Array, " lanes"]
    """Whether a branch of stable motions turns back there; contacts are not looked at."""
    angular_frequency: Float[Array, " lanes"]
    """rad/s."""
    state: Float[Array, "states lanes"]
    """(q, q') at drive phase 0."""
    times: Float[Array, "events lanes"]
    """Changes of contact, drive angle, rad."""


class _Point(NamedTuple):
    """A motion."""

    blocks: Float[Array, "2 blocks lanes"]
    times: Float[Array, "events lanes"]
    w: Float[Array, " lanes"]


class _Search(NamedTuple):
    """Between which points of a branch a fold is; arc lengths are in units, from the last point."""

    last: _Point
    along: Float[Array, "states lanes"]
    """Rate of the block coordinates there by arc length."""
    rate: Float[Array, " lanes"]
    """Rate of the frequency, over the way; none yet where it is above 1."""
    times_along: Float[Array, "events lanes"]
    """Rate of the times."""
    step: Float[Array, " lanes"]
    """Arc length of the point that is solved for."""
    beyond: Float[Array, " lanes"]
    """That of one where the frequency goes back; inf where none is known."""
    turned: _Point
    """Which one that is."""
    rate_beyond: Float[Array, " lanes"]
    now: _Point
    rounds: Int[Array, " lanes"]
    """Of Newton's method for that point."""
    going: Bool[Array, " lanes"]
    found: Bool[Array, " lanes"]


class _Corrected(NamedTuple):
    """A point after a step of Newton's method."""

    point: _Point
    error: Float[Array, " lanes"]
    along: Float[Array, "states lanes"]
    rate: Float[Array, " lanes"]
    times_along: Float[Array, "events lanes"]
    stable: Bool[Array, " lanes"]


class _Branch:
    """Lanes on their branches, in units of the way and of a change of the motion."""

    def __init__(self, lanes: FollowedLanes, change: Array, way: Array, first_step: Array):
        self.lanes, self.way, self.first_step = lanes, way, first_step
        self.unit = change / lanes.energy.reshape(-1, *change.shape)
        """Of every block coordinate."""

    def corrected(self, search: _Search) -> _Corrected:
        """Take a step of Newton's method, and find the way on there."""
        (blocks, times, w), n = search.now, len(self.unit)
        events = self.lanes.events
        passed, _, slopes = self.lanes.through(self.lanes.driven(w), blocks, times)
        gap = (passed.blocks - blocks).reshape(self.unit.shape) / self.unit
        push = slopes.end.reshape(gap.shape) * self.way / self.unit
        matrix = passed.matrix.reshape(n, *gap.shape) * self.unit / self.unit[:, None]
        left = search.step - self.length(search.along, search.rate, search.last, search.now)
        # The return of the motion, bordered by the arc length; two right-hand sides.
        inside = jnp.eye(n)[:, :, None] - matrix
        border = jnp.concatenate([search.along, search.rate[None]])[None]
        whole = jnp.concatenate([inside, -push[:, None]], axis=1)
        whole = jnp.concatenate([whole, border])
        right = jnp.stack(
            [jnp.concatenate([gap, left[None]]), jnp.eye(n + 1)[-1][:, None] + 0 * whole[0]], axis=1
        )
        solved = jnp.linalg.solve(jnp.moveaxis(whole, -1, 0), jnp.moveaxis(right, -1, 0))
        change, on = jnp.moveaxis(solved, (0, 1, 2), (2, 1, 0))
        on = on / size_of(on)

        def delayed(change: Array) -> Array:
            moved, dw = change[:-1] * self.unit, change[-1] * self.way
            later = apply_matrix(passed.delays, moved) + slopes.late * dw
            return jnp.where(events.stop >= 0, later, 0.0)

        later = jnp.where(events.stop >= 0, passed.late, 0.0) + delayed(change)
        error = jnp.maximum(size_of(change), jnp.max(jnp.abs(later), axis=0, initial=0.0))
        moved = (change[:-1] * self.unit).reshape(blocks.shape)
        point = _Point(blocks + moved, times + later, w + change[-1] * self.way)
        return _Corrected(point, error, on[:-1], on[-1], delayed(on), is_stable(matrix))

    def length(self, along: Array, rate: Array, a: _Point, b: _Point) -> Array:
        """Arc length from one point to another, seen along a tangent."""
        gone = (b.blocks - a.blocks).reshape(self.unit.shape) / self.unit
        return jnp.sum(along * gone, axis=0) + rate * (b.w - a.w) / self.way

    def is_ordered(self, times: Array) -> Array:
        """Whether contacts change one after the other."""
        used = self.lanes.events.stop >= 0
        return jnp.all((jnp.diff(times, axis=0) > 0) | ~used[1:], axis=0)

    def tried(self, search: _Search, step: Array) -> _Search:
        """Begin to solve for the point a step further on."""
        blocks, times, w = search.last
        along = (search.along * self.unit * step).reshape(blocks.shape)
        later = times + search.times_along * step
        now = _Point(blocks + along, later, w + search.rate * self.way * step)
        return search._replace(now=now, step=step, rounds=jnp.zeros_like(search.rounds))


def _further(branch: _Branch, search: _Search, start: Array) -> _Search:
    """Go on with Newton's method, or to the next point of the branch where there is one."""
    now = branch.corrected(search)
    point, error, rate, first = now.point, now.error, now.rate, search.rate > 1.0
    turns = jnp.sum(now.along * search.along, axis=0) + rate * search.rate
    solved = error <= CLOSE
    good = solved & (first | (turns > 0.5)) & branch.is_ordered(point.times)
    rounds = search.rounds + 1
    fails = ~good & (solved | (rounds >= ROUNDS) | ~(error < SHRINKS**search.rounds))
    at_fold, back = good & (jnp.abs(rate) <= TURNED), good & (rate < -TURNED)
    lost = good & ~now.stable & (rate > NOT_YET)
    lost |= (point.w - start) / branch.way > 1.0
    takes = search.going & good & ~back
    turned = jax.tree.map(lambda a, b: jnp.where(back, a, b), point, search.turned)
    rate_beyond = jnp.where(back, rate, search.rate_beyond)
    # Seen along the new tangent: the branch may have bent much since the last point.
    away = branch.length(now.along, rate, point, turned)
    away = jnp.where(jnp.isfinite(search.beyond) & (away > 0), away, jnp.inf)
    beyond = jnp.where(back, search.step, jnp.where(good, away, search.beyond))

    def taken(new: Array, old: Array) -> Array:
        return jnp.where(takes, new, old)

    last = jax.tree.map(taken, point, search.last)
    along, rate = taken(now.along, search.along), taken(rate, search.rate)
    # Along a parabola the rate falls off straight.
    between = jnp.isfinite(beyond)
    share = rate / jnp.where(between, rate - rate_beyond, 1.0)
    inside = jnp.clip(share, 0.05, 0.95) * jnp.where(between, beyond, 1.0)
    longer = jnp.where(rounds <= EASY, jnp.minimum(2 * search.step, LONGEST_STEP), search.step)
    longer = jnp.where(first, branch.first_step, longer)
    step = jnp.where(good, jnp.where(between, inside, longer), search.step / 2)
    going = search._replace(now=point, rounds=rounds)
    new = search._replace(
        last=last,
        along=along,
        rate=rate,
        times_along=taken(now.times_along, search.times_along),
        beyond=beyond,
        turned=turned,
        rate_beyond=rate_beyond,
        going=search.going & ~(good & (lost | at_fold)),
        found=search.found | (search.going & at_fold & ~lost),
    )
    new = branch.tried(new, step)
    return jax.tree.map(lambda a, b: jnp.where(good | fails, a, b), new, going)


@compiled(lightly=True)
def fold_ahead(
    march: LaneTable,
    tracks: LaneTable,
    way: Float[AnyArray, " lanes"],
    first_step: Float[AnyArray, " lanes"],
) -> LaneTable:
    """Look for the folds ahead of motions that are known exactly, in tables of lanes.

    `way` (rad/s, signed) says in which direction and no further than how far. Returns `FoldAhead`.
    """
    own, track = march.lanes_last(), tracks.lanes_last()
    lanes, way, w = FollowedLanes(own, track.events), jnp.asarray(way), track.frequency[0]
    # In units of their own change along the way, near a fold motions count as the frequency does.
    change, zero = size_of(track.state_slope[0]) * jnp.abs(way), jnp.zeros_like(w)
    branch = _Branch(lanes, jnp.where(change > 0, change, 1.0), way, jnp.asarray(first_step))
    begin = _Point(lanes.begin(lanes.at(own.force_at(w)), track.state[0]), track.times[0], w)
    none, exact = jnp.zeros(w.shape, jnp.int32), track.known > 0
    # The way on from where it begins is found by a step of no length.
    search = _Search(
        last=begin,
        along=jnp.zeros((len(branch.unit), *w.shape)),
        rate=zero + 2,
        times_along=jnp.zeros_like(begin.times),
        step=zero,
        beyond=zero + jnp.inf,
        turned=begin,
        rate_beyond=zero,
        now=begin,
        rounds=none,
        going=exact,
        found=exact & False,
    )
    search, _ = lax.while_loop(
        lambda carry: jnp.any(carry[0].going) & (carry[1] < MOST),
        lambda carry: (_further(branch, carry[0], w), carry[1] + 1),
        (search, jnp.int32(0)),
    )
    there = search.last
    state = lanes.at_start(lanes.at(own.force_at(there.w)), there.blocks, there.times)
    return table_of(FoldAhead(search.found, there.w, state, there.times))


def folds_ahead(
    march: AbstractMarch,
    rig: Int[np.ndarray, " lanes"],
    state: Float[np.ndarray, "lanes states"],
    angular_frequency: Float[np.ndarray, " lanes"],
    way: Float[np.ndarray, " lanes"],
    beside_touch: Bool[np.ndarray, " lanes"],
    periods: int = 0,
) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, "lanes states"]]:
    """Return where the branches of settled motions of one drive period end in a fold, rad/s.

    Also their states there. NaN where none is found on the way (rad/s, signed) that keeps to the
    contacts of the motion. `rig` says which of the rigs of `march`, its trailing axis, each lane
    has, `beside_touch` whether its motion all but grazes a stop. First they are marched for so many
    drive `periods`.
    """
    close = NEXT_TO_TOUCH * angular_frequency / np.abs(way)
    first_step = np.where(beside_touch, np.minimum(close, FIRST_STEP), FIRST_STEP)
    rigs, found, states = table_of(march, xp=np), np.full(len(rig), np.nan), state + np.nan
    weight = np.asarray(march.energy_weight()).T
    left = np.flatnonzero(can_follow(rigs.columns(), len(weight))[rig])
    each = len(left), rigs.numbers.shape[1]
    widths, to_measure = widths_for(*each), widths_to_measure(*each)
    for own, lanes in in_widths(left, widths):
        system, one = rigs.pick(rig[lanes]), np.ones(len(lanes), np.int32)
        unit, every = weight[rig[lanes]], np.arange(len(lanes))
        begin, w = state[lanes], angular_frequency[lanes]
        if periods:
            begin, _, _ = measured(system, every, begin, w, periods * one, to_measure)
        _, _, measures = measured(system, every, begin, w, one, to_measure)
        tracks = no_tracks(len(lanes), begin.shape[1])
        track = tracks.columns()
        begin_track(track, every, begin * unit, w, measures.events)
        targets = np.full((targets_for(len(lanes)), len(lanes)), np.nan)
        targets[0] = w
        pace = np.full((2, len(lanes)), np.inf)
        solved, _ = advance(system, tracks, targets, pace, np.asarray(0))
        numbers = np.asarray(solved.numbers)[: len(lanes), : tracks.numbers.shape[1]]
        tracks.numbers[:] = numbers
        ahead = fold_ahead(system, tracks, way[lanes], first_step[lanes]).columns()
        good = (track.known > 0) & (ahead.found > 0)
        # What is marched has to be finite.
        at, w = (
            np.where(good[:, None], ahead.state, begin),
            np.where(good, ahead.angular_frequency, w),
        )
        end, _, measures = measured(system, every, at, w, one, to_measure)
        track.times[:, 0] = ahead.times
        good &= keeps_to_contacts(track, measures.events, at * unit, (end - at) * unit)
        found[own] = np.where(good, w, np.nan)[: len(own)]
        states[own] = np.where(good[:, None], at, np.nan)[: len(own)]
    return found, states


def folds_within(
    march: AbstractMarch,
    rig: Int[np.ndarray, " lanes"],
    state: Float[np.ndarray, "lanes states"],
    bracket: Float[np.ndarray, "lanes 2"],
) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, "lanes states"]]:
    """Return `folds_ahead` of motions that leave their branches somewhere in a bracket, rad/s.

    They are on them at its first end, or linger there just behind a fold, so that a march takes
    them for settled. A fold may lie somewhat further on than the bracket.
    """
    begin, width, touches = bracket[:, 0], np.diff(bracket)[:, 0], np.zeros(len(rig), bool)
    way = width / FIRST_STEP
    fold, there = folds_ahead(march, rig, state, begin, way, touches)
    lost = np.isnan(fold)
    if not lost.any():
        return fold, there
    # All of them again: fewer may be another program.
    again, there_too = folds_ahead(march, rig, state, begin - width, 2 * way, touches, LINGERS)
    return np.where(lost, again, fold), np.where(lost[:, None], there_too, there)


def compile_fold_ahead(march: AbstractMarch, lanes: int) -> None:
    """Compile in the background what folds of so many lanes, or fewer, are looked for with.

    Of `march`, whose rigs are its trailing axis, only the shapes are looked at.
    """
    if isinstance(march, ExactMarch):
        width = widths_for(lanes, table_of(march, lanes=1).numbers.shape[1])[0]
        states = jax.eval_shape(lambda march: march.energy_weight(), march).shape[0]
        own, tracks = table_of(march, lanes=width), no_tracks(width, states)
        fold_ahead.ahead(own, tracks, np.ones(width), np.ones(width))
