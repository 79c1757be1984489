"""Settled motions followed from one drive frequency to the next, without marching.

The motion at the next frequency is predicted from those before and solved for by its contact times.
It is taken if it is stable, keeps to the contacts of the last one and is its continuation; all else
is for the march to find out, as where a branch ends.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.steady.contact_times import Events
from vibrojax.steady.known_contacts import KnownContacts, Passage
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.period_maps import continues, is_stable, size_of, to_return
from vibrojax.steady.tracks import TURN, Track, no_track
from vibrojax.stepping.contact_loop import ContactLoop
from vibrojax.stepping.elementary import apply_matrix, pick
from vibrojax.stepping.forcing import Forcing
from vibrojax.stepping.stepper import ExactMarch

lax = jax.lax

CLOSED = 1e-8
"""Relative residual from which one more step of Newton's method leads to rounding: results are then
the same wherever the search began."""
MOST_ROUNDS = 6
"""Of Newton's method: further away another motion might be found."""
FREE_ROUNDS = 2
"""After which every one has to halve the residual."""
FARTHEST = 3.0
"""Longest way beyond the last two points, over their distance, to which a cubic goes on."""
MORE = 8
"""Steps beyond one for each of several frequencies."""
SHORTEST = 0.12
"""Shortest step towards a frequency, over all of the way from the last one."""
CLOSE = 0.1
"""Drive angle (rad) between the section and a change of contact below which the section moves."""


class Followed(NamedTuple):
    """What became of a step along the branch."""

    good: Bool[Array, "..."]
    """Whether it reached a stable motion that continues the last; contacts are not looked at."""
    state: Float[Array, "... states"]
    """(q, q') at drive phase 0."""
    rounds: Int[Array, "..."]


class _Solved(NamedTuple):
    """A motion at the section, as block coordinates of its phase there."""

    blocks: Float[Array, "2 blocks lanes"]
    times: Float[Array, "events lanes"]
    error: Float[Array, " lanes"]
    rounds: Int[Array, " lanes"]
    going: Bool[Array, " lanes"]


class _ByFrequency(NamedTuple):
    """Derivatives by the drive frequency, of a motion whose blocks at the section stay."""

    end: Float[Array, "2 blocks lanes"]
    late: Float[Array, "events lanes"]
    """Of what the times of contact lack."""
    state: Float[Array, "states lanes"]
    """At the section, in units of energy."""


class _Motion(NamedTuple):
    """A motion solved for."""

    blocks: Float[Array, "2 blocks lanes"]
    times: Float[Array, "events lanes"]
    state: Float[Array, "states lanes"]
    matrix: Float[Array, "states states lanes"]
    """Of the period map, in block coordinates."""
    slope: Float[Array, "states lanes"]
    """Of the state by the drive frequency."""
    times_slope: Float[Array, "events lanes"]


class FollowedLanes:
    """Lanes with the events of their motions, apart from the drive frequency."""

    def __init__(self, march: ExactMarch, events: Events):
        self.march, self.events = march, events
        self.weight, phases = march.phases.weight, march.phases
        # Energies of block coordinates, were each alone.
        of_state = jnp.sqrt(jnp.sum((self.weight[:, None] * phases.to_state) ** 2, axis=1))
        energy = pick(jnp.asarray(events.first_phase), of_state)
        self.energy = energy.reshape(2, -1, *energy.shape[1:])

    def driven(self, w: Float[Array, " lanes"]) -> tuple[Forcing, Forcing]:
        """Tables of the drive at a frequency, rad/s, and their derivatives by it."""
        return jax.jvp(self.march.force_at, (w,), (jnp.ones_like(w),))

    def at(self, force: Forcing) -> KnownContacts:
        """The lanes under a drive."""
        return KnownContacts(ContactLoop(self.march.phases, force), self.events)

    def begin(self, at: KnownContacts, state: Float[Array, "states lanes"]) -> Array:
        """Block coordinates at the section of a state in units of energy."""
        time = self.events.section / at.frequency
        return at.loop.blocks_of(state / self.weight, self.events.first_phase, time)

    def state(self, at: KnownContacts, blocks: Array, phase: Array, angle: Array) -> Array:
        """State in units of energy."""
        return self.weight * at.loop.state_of(blocks, phase, angle / at.frequency)

    def solve(self, at: KnownContacts, blocks: Array, times: Array, size: Array) -> _Solved:
        """Newton's method on block coordinates at the section and times of contact."""
        until, used = self.events.section + TURN, self.events.stop >= 0

        def better(found: _Solved) -> _Solved:
            blocks, times, live = found.blocks, found.times, found.going
            passed = at.go_through(blocks, times, until)
            gap = passed.blocks - blocks
            gone = jnp.sqrt(jnp.sum((self.energy * gap) ** 2, axis=(0, 1))) / size
            late = jnp.max(jnp.abs(passed.late), axis=0, where=used, initial=0.0)
            error = jnp.maximum(gone, late)
            shrinks = (found.rounds < FREE_ROUNDS) | (error < found.error / 2)
            going = live & (error > CLOSED) & (found.rounds + 1 < MOST_ROUNDS) & shrinks
            (change,) = to_return(*_flat(passed, gap))
            moved = passed.late + apply_matrix(passed.delays, change)
            room = 0.4 * _room(self.events, times)
            moved = jnp.where(used, jnp.clip(moved, -room, room), 0.0)
            return _Solved(
                blocks=jnp.where(going, blocks + change.reshape(blocks.shape), blocks),
                times=jnp.where(going, times + moved, times),
                error=jnp.where(live, error, found.error),
                rounds=found.rounds + live,
                going=going,
            )

        none, whole = jnp.zeros(size.shape, jnp.int32), jnp.ones(size.shape, bool)
        first = _Solved(blocks, times, jnp.full_like(size, jnp.inf), none, whole)
        return lax.while_loop(lambda found: jnp.any(found.going), better, first)

    def through(
        self, drive: tuple[Forcing, Forcing], blocks: Array, times: Array
    ) -> tuple[Passage, Array, "_ByFrequency"]:
        """Go through a period; also the state where it begins, and what depends on the drive."""

        def passed_at(force: Forcing) -> tuple["_ByFrequency", tuple[Passage, Array]]:
            at, section = self.at(force), self.events.section
            passed = at.go_through(blocks, times, section + TURN)
            state = self.state(at, blocks, self.events.first_phase, section)
            return _ByFrequency(passed.blocks, passed.late, state), (passed, state)

        force, rate = drive
        _, slopes, (passed, state) = jax.jvp(passed_at, (force,), (rate,), has_aux=True)
        return passed, state, slopes

    def at_start(self, at: KnownContacts, blocks: Array, times: Array) -> Array:
        """State (q, q') at drive phase 0, which lies within the turn behind the section."""
        origin = jnp.where(self.events.section > 0, TURN, 0.0)
        return self.state(at, *at.go_to(blocks, times, origin), origin) / self.weight

    def last_step(self, drive: tuple[Forcing, Forcing], found: _Solved) -> _Motion:
        """Newton's last step to motions that are all but solved for, and their slopes."""
        passed, state, slopes = self.through(drive, found.blocks, found.times)
        gaps = passed.blocks - found.blocks, slopes.end
        step, change = to_return(*_flat(passed, *gaps))
        to_state = pick(jnp.asarray(self.events.first_phase), self.march.phases.to_state)
        return _Motion(
            blocks=found.blocks + step.reshape(found.blocks.shape),
            times=found.times + passed.late + apply_matrix(passed.delays, step),
            state=state + self.weight * apply_matrix(to_state, step),
            matrix=passed.matrix.reshape(len(step), *step.shape),
            slope=slopes.state + self.weight * apply_matrix(to_state, change),
            times_slope=slopes.late + apply_matrix(passed.delays, change),
        )


def _predicted(track: Track, w: Float[Array, " lanes"]) -> tuple[Array, Array]:
    """State and times at a frequency: the cubic through two points, a straight line from one."""
    way = w - track.frequency[0]
    back = track.frequency[0] - track.frequency[1]
    ratio = way / jnp.where(back == 0, 1.0, back)
    both = (track.known > 1) & (jnp.abs(ratio) <= FARTHEST) & (back != 0)
    u = jnp.where(both, ratio, 0.0)

    def at(value: Array, slope: Array) -> Array:
        bent = value[1] - (value[0] - back * slope[0])
        steep = (slope[1] - slope[0]) * back
        return value[0] + way * slope[0] + u**2 * (3 * bent + steep) + u**3 * (2 * bent + steep)

    return at(track.state, track.state_slope), at(track.times, track.times_slope)


def _flat(passed: Passage, *gaps: Float[Array, "2 blocks lanes"]) -> list[Array]:
    """Matrix of a passage and gaps, block coordinates as one vector."""
    states, lanes = passed.matrix.shape[2:]
    square = passed.matrix.reshape(states, states, lanes)
    return [square, *(gap.reshape(states, lanes) for gap in gaps)]


def _room(events: Events, times: Float[Array, "events lanes"]) -> Float[Array, "events lanes"]:
    """Drive angle, rad, that an event has to its neighbours, to the section and to its end."""
    ends = jnp.concatenate([events.section[None], times, events.section[None] + TURN])
    between = jnp.diff(ends, axis=0)
    return jnp.clip(jnp.minimum(between[:-1], between[1:]), 0.0, 1.0)


def _after(events: Events, times: Float[Array, "events lanes"]) -> Float[Array, "events lanes"]:
    """How long the phases behind the events take, as drive angles."""
    used = events.stop >= 0
    last = jnp.arange(1, len(times) + 1)[:, None] == jnp.sum(used, axis=0)
    following = jnp.where(last, times[0] + TURN, jnp.roll(times, -1, axis=0))
    return jnp.where(used, following - times, 0.0)


def _is_close(events: Events, times: Float[Array, "events lanes"]) -> Bool[Array, " lanes"]:
    """Whether the section is close to a change of contact."""
    used = events.stop >= 0
    last = jnp.max(times, axis=0, where=used, initial=-jnp.inf)
    nearest = jnp.minimum(times[0] - events.section, events.section + TURN - last)
    room = jnp.minimum(CLOSE, jnp.max(_after(events, times), axis=0) / 4)
    return jnp.any(used, axis=0) & (nearest < room)


def _section_moved(lanes: FollowedLanes, track: Track, close: Bool[Array, " lanes"]) -> Track:
    """Move sections that are close to a change of contact into the middle of the longest phase.

    There the newest point is a guess again.
    """
    events, times = track.events, track.times[0]
    at = lanes.at(lanes.march.force_at(track.frequency[0]))
    used, length = events.stop >= 0, _after(track.events, track.times[0])
    longest = jnp.argmax(length, axis=0)[None]
    begun, long = (jnp.take_along_axis(a, longest, axis=0)[0] for a in (times, length))
    section = begun + long / 2
    section = jnp.where(section >= events.section + TURN, section - TURN, section)
    early = used & (times < section)
    later = jnp.where(early, times + TURN, times)
    order = jnp.argsort(jnp.where(used, later, jnp.inf), axis=0)
    stop, later = (jnp.take_along_axis(a, order, axis=0) for a in (events.stop, later))
    # The section is counted from less than a turn.
    turns = TURN * jnp.floor(section / TURN)
    whole = section - turns
    blocks, phase = at.go_to(lanes.begin(at, track.state[0]), times, section)
    state = lanes.state(at, blocks, phase, section)
    moved = track._replace(
        events=Events(stop, phase.astype(events.first_phase.dtype), whole),
        known=jnp.zeros_like(track.known),
        state=track.state.at[0].set(state),
        times=track.times.at[0].set(jnp.where(stop >= 0, later - turns, whole + TURN)),
    )
    return jax.tree.map(lambda a, b: jnp.where(close, a, b), moved, track)


def _advanced(
    lanes: FollowedLanes, track: Track, w: Float[Array, " lanes"]
) -> tuple[Track, Followed]:
    """Solve for the motions at a frequency; where that is not good, the new track means nothing."""
    events, known, drive = track.events, track.known > 0, lanes.driven(w)
    at = lanes.at(drive[0])
    ahead = _predicted(track, w)
    guess, times = (
        jnp.where(known, a, b) for a, b in zip(ahead, (track.state[0], track.times[0]), strict=True)
    )
    size = size_of(guess)
    found = lanes.solve(at, lanes.begin(at, guess), times, jnp.where(size > 0, size, 1.0))
    now = lanes.last_step(drive, found)
    step = now.state - track.state[0]
    straight = (w - track.frequency[0]) / 2 * (now.slope + track.state_slope[0])
    goes_on = continues(known, step, straight, size_of(now.state))
    good = (found.error <= CLOSED) & goes_on & is_stable(now.matrix)
    good &= jnp.all(jnp.isfinite(now.slope), axis=0)

    def pair(new: Array, old: Array) -> Array:
        return jnp.stack([new, old[0]])

    new = Track(
        events=events,
        known=jnp.where(known, 2, 1).astype(jnp.int32),
        frequency=pair(w, track.frequency),
        state=pair(now.state, track.state),
        times=pair(now.times, track.times),
        state_slope=pair(now.slope, track.state_slope),
        times_slope=pair(now.times_slope, track.times_slope),
    )
    return new, Followed(good, lanes.at_start(at, now.blocks, now.times), found.rounds)


class Pace(NamedTuple):
    """How far steps towards the next frequency go."""

    stride: Float[Array, "..."]
    """rad/s, signed; inf where all of the way is to be tried first."""
    way: Float[Array, "..."]
    """All of it, rad/s."""


class Ahead(NamedTuple):
    """A step of lanes towards the frequencies ahead of them."""

    track: Track
    """After the step; as before where the motion is not good."""
    found: Followed
    arrived: Bool[Array, "..."]
    """Whether it is the motion at the next of the frequencies."""
    ended: Bool[Array, "..."]
    """Whether there are no steps left to try."""
    pace: Pace


def nothing_ahead(points: int, states: int) -> LaneTable:
    """Return a table with room for `Ahead` of so many points, in numpy."""
    none: Any = np.zeros(1, np.int32)
    state: Any = np.zeros((states, 1))
    found, pace = Followed(none > 0, state, none), Pace(0.0 * none, 0.0 * none)
    return table_of(Ahead(no_track(1, states), found, none > 0, none > 0, pace), lanes=points)


@compiled
def advance(
    march: LaneTable,
    tracks: LaneTable,
    targets: Float[AnyArray, "targets lanes"],
    pace: Float[AnyArray, "2 lanes"],
    still: Int[AnyArray, ""],
) -> tuple[LaneTable, Int[Array, ""]]:
    """Solve for the motions of lanes at one frequency after another, rad/s, until one is not good.

    NaN ends the frequencies of a lane. A motion that is a guess is solved for where it is first. On
    the way to the first frequency a step that fails is halved, one that does not is doubled. Ends
    when all but `still` lanes have; returns tables of `Ahead`, all lanes of the first step before
    those of the second, and the number of steps.
    """
    own, track, targets = march.lanes_last(), tracks.lanes_last(), jnp.asarray(targets)
    count, lanes = targets.shape

    def step(track: Track, pace: Pace, reached: Array, going: Array) -> tuple[Ahead, Array, Array]:
        at = jnp.minimum(reached, count - 1)[None]
        target, here = jnp.take_along_axis(targets, at, axis=0)[0], track.frequency[0]
        left, known = target - here, track.known > 0
        going = going & (reached < count) & jnp.isfinite(target)
        whole = jnp.abs(left) <= jnp.abs(pace.stride)
        way = jnp.where(whole, left, pace.stride)
        w = jnp.where(going & known, jnp.where(whole, target, here + way), here)
        new, found = _advanced(FollowedLanes(own, track.events), track, w)
        good = going & found.good
        arrived = good & (w == target)
        all_of_it = jnp.where(jnp.isinf(pace.stride), jnp.abs(left), pace.way)
        # Behind the first frequency the motions there are to be read before steps are halved.
        first, fails = reached == 0, going & ~good
        stride = jnp.where(fails & first, way / 2, jnp.where(good & ~whole, 2 * way, pace.stride))
        pace = Pace(jnp.where(arrived | ~known, jnp.inf, stride), all_of_it)
        ended = fails & first & (~known | (jnp.abs(way) / 2 < SHORTEST * all_of_it))
        track = jax.tree.map(lambda a, b: jnp.where(good, a, b), new, track)
        close = good & _is_close(track.events, track.times[0])
        moved = lambda track: _section_moved(  # noqa: E731
            FollowedLanes(own, track.events), track, close
        )
        track = lax.cond(jnp.any(close), moved, lambda track: track, track)
        found = found._replace(good=good, rounds=jnp.where(going, found.rounds, 0))
        going = going & ~ended & (good | first)
        return Ahead(track, found, arrived, ended, pace), reached + arrived, going

    none = jnp.zeros(lanes, jnp.int32)
    like = nothing_ahead(lanes, own.energy_weight().shape[0])
    room = jnp.zeros((count + MORE * (count > 1), *like.numbers.shape))

    def goes_on(carry: tuple[Any, ...]) -> Array:
        steps, *_, going, _ = carry
        return (steps < len(room)) & (jnp.sum(going) > still)

    def on(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        steps, track, pace, reached, going, rows = carry
        ahead, reached, going = step(track, pace, reached, going)
        rows = lax.dynamic_update_index_in_dim(rows, table_of(ahead).numbers, steps, 0)
        return steps + 1, ahead.track, ahead.pace, reached, going, rows

    begin = jnp.int32(0), track, Pace(*jnp.asarray(pace)), none, none == 0, room
    steps, *_, rows = lax.while_loop(goes_on, on, begin)
    return replace(like, numbers=rows.reshape(-1, rows.shape[-1])), steps


def steps_of_lanes(
    table: LaneTable, steps: Int[Array, ""], width: int, lanes: int
) -> tuple[Float[np.ndarray, "lanes steps columns"], Any]:
    """Return the steps of `advance` with the first of so many lanes: rows, and `Ahead` of them."""
    rows = np.asarray(table.numbers).reshape(-1, width, table.numbers.shape[1])
    rows = rows[: int(steps), :lanes].swapaxes(0, 1)
    every = replace(table, numbers=rows.reshape(-1, rows.shape[-1])).columns()
    return rows, jax.tree.map(lambda a: a.reshape(*rows.shape[:2], *a.shape[1:]), every)
