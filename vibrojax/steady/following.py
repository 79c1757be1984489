"""Settled motions followed from one drive frequency to the next, without marching.

The motion at the next frequency is predicted from those before and solved for by its contact times.
It is taken if it is stable, keeps to the contacts of the last one and is its continuation; all else
is for the march to find out, as where a branch ends.
"""

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
from vibrojax.steady.settling import NEAR, is_stable
from vibrojax.stepping.contact_loop import ContactLoop
from vibrojax.stepping.contact_phases import may_resonate
from vibrojax.stepping.elementary import apply_matrix, pick
from vibrojax.stepping.forcing import Forcing
from vibrojax.stepping.measures import MOST_EVENTS, EventLog
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

lax = jax.lax

CLOSED = 1e-10
"""Relative residual at which a motion is solved for."""
ROUND_OFF = 1e-13
"""At which it is left as it is: results are then the same wherever the search began."""
MOST_ROUNDS = 6
"""Of Newton's method: further away another motion might be found."""
FREE_ROUNDS = 2
"""After which every one has to halve the residual."""
BENT = 0.25
"""Most that a step along the branch may differ from the one that the slopes at its ends give, over
its length: beyond, there may be a fold in between."""
STRAIGHT = 1e-3
"""Steps shorter than this, over the size of the motion, may be bent."""
FARTHEST = 3.0
"""Longest way beyond the last two points, over their distance, to which a cubic goes on."""
CLOSE = 0.1
"""Drive angle (rad) between the section and a change of contact below which the section moves."""
TURN = 2 * np.pi
RETURNED = 1e-7
"""How near a motion has to come back to itself."""
EDGE = 1e-6
"""Drive angle, rad, that is as good as phase 0."""


class Track(NamedTuple):
    """The motion of a lane at the last two points, the newest first."""

    events: Events
    known: Int[Array, "..."]
    """How many of the points are exact; 0 where the newest is a guess, -1 where there is none."""
    frequency: Float[Array, "... 2"]
    """rad/s."""
    state: Float[Array, "... 2 states"]
    """At the section, in units of energy."""
    times: Float[Array, "... 2 events"]
    state_slope: Float[Array, "... 2 states"]
    """By the drive frequency."""
    times_slope: Float[Array, "... 2 events"]


class Followed(NamedTuple):
    """What became of a step along the branch."""

    good: Bool[Array, "..."]
    """Whether it came to a stable motion that continues the last; contacts are not looked at."""
    state: Float[Array, "... states"]
    """(q, q') at drive phase 0."""
    rounds: Int[Array, "..."]


def no_tracks(lanes: int, states: int) -> LaneTable:
    """Return the tracks of lanes of which nothing is known."""

    def zeros(*shape: int) -> Any:
        return np.zeros((*shape, lanes))

    stop: Any = np.full((MOST_EVENTS, lanes), -1, np.int32)
    track = Track(
        events=Events(stop, zeros().astype(np.int32), zeros()),
        known=(zeros() - 1).astype(np.int32),
        frequency=zeros(2) + 1,
        state=zeros(2, states),
        times=zeros(2, MOST_EVENTS),
        state_slope=zeros(2, states),
        times_slope=zeros(2, MOST_EVENTS),
    )
    return table_of(track, xp=np)


def begin_track(
    track: Any,
    lanes: Int[np.ndarray, " lanes"],
    weighted: Float[np.ndarray, "lanes states"],
    angular_frequency: Float[np.ndarray, " lanes"],
    log: EventLog,
) -> None:
    """Put motions into some lanes of tracks, of which a march has noted one drive period.

    `track` is the columns of a table of `Track`; all arrays have the lanes leading.
    """
    track.events.stop[lanes], track.events.section[lanes] = log.stop, 0.0
    track.events.first_phase[lanes] = log.first_phase
    track.known[lanes] = np.where(log.number <= MOST_EVENTS, 0, -1)
    track.frequency[lanes, 0], track.state[lanes, 0] = angular_frequency, weighted
    track.times[lanes, 0] = np.where(np.asarray(log.stop) >= 0, log.angle, TURN)


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
            going = live & (error > ROUND_OFF) & (found.rounds + 1 < MOST_ROUNDS) & shrinks
            change = _to_return(passed, gap)
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
        passed = at.go_through(blocks, times, origin)
        return self.state(at, passed.blocks, passed.phase, origin) / self.weight

    def with_slopes(
        self, drive: tuple[Forcing, Forcing], found: _Solved
    ) -> tuple[Array, Array, Array, Array]:
        """State and multipliers' matrix of motions; slopes of state and times by the frequency."""
        passed, state, slopes = self.through(drive, found.blocks, found.times)
        change = _to_return(passed, slopes.end)
        to_state = pick(jnp.asarray(self.events.first_phase), self.march.phases.to_state)
        slope = slopes.state + self.weight * apply_matrix(to_state, change)
        matrix = passed.matrix.reshape(change.shape[0], *change.shape)
        return state, matrix, slope, slopes.late + apply_matrix(passed.delays, change)


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


def _to_return(
    passed: Passage, gap: Float[Array, "2 blocks lanes"]
) -> Float[Array, "states lanes"]:
    """Change of where motions begin that makes up for a gap between end and beginning."""
    flat = gap.reshape(-1, gap.shape[-1])
    matrix = jnp.moveaxis(passed.matrix.reshape(len(flat), *flat.shape), -1, 0)
    return jnp.linalg.solve(jnp.eye(len(flat)) - matrix, flat.T[..., None])[..., 0].T


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
    passed = at.go_through(lanes.begin(at, track.state[0]), times, section)
    state = lanes.state(at, passed.blocks, passed.phase, section)
    moved = track._replace(
        events=Events(stop, passed.phase.astype(events.first_phase.dtype), whole),
        known=jnp.zeros_like(track.known),
        state=track.state.at[0].set(state),
        times=track.times.at[0].set(jnp.where(stop >= 0, later - turns, whole + TURN)),
    )
    return jax.tree.map(lambda a, b: jnp.where(close, a, b), moved, track)


def size_of(state: Float[Array, "states lanes"]) -> Float[Array, " lanes"]:
    """Length of vectors, one for every lane."""
    return jnp.sqrt(jnp.sum(state**2, axis=0))


def _advanced(
    lanes: FollowedLanes, track: Track, w: Float[Array, " lanes"]
) -> tuple[Track, Followed]:
    """Solve for the motions at a frequency; where that is not good, the track stays."""
    events, known, drive = track.events, track.known > 0, lanes.driven(w)
    at = lanes.at(drive[0])
    ahead = _predicted(track, w)
    guess, times = (
        jnp.where(known, a, b) for a, b in zip(ahead, (track.state[0], track.times[0]), strict=True)
    )
    size = size_of(guess)
    found = lanes.solve(at, lanes.begin(at, guess), times, jnp.where(size > 0, size, 1.0))
    state, matrix, slope, times_slope = lanes.with_slopes(drive, found)
    # Along one branch the slopes at both ends give the step between them.
    step = state - track.state[0]
    straight = (w - track.frequency[0]) / 2 * (slope + track.state_slope[0])
    bent, size, length = size_of(step - straight), size_of(state), size_of(step)
    goes_on = jnp.where(known, bent <= BENT * length + STRAIGHT * size, length <= 5 * NEAR * size)
    good = (found.error <= CLOSED) & goes_on & is_stable(jnp.moveaxis(matrix, -1, 0))
    good &= jnp.all(jnp.isfinite(slope), axis=0)

    def pair(new: Array, old: Array) -> Array:
        return jnp.stack([new, old[0]])

    point = Track(
        events=events,
        known=jnp.where(known, 2, 1).astype(jnp.int32),
        frequency=pair(w, track.frequency),
        state=pair(state, track.state),
        times=pair(found.times, track.times),
        state_slope=pair(slope, track.state_slope),
        times_slope=pair(times_slope, track.times_slope),
    )
    new = jax.tree.map(lambda a, b: jnp.where(good, a, b), point, track)
    return new, Followed(good, lanes.at_start(at, found.blocks, found.times), found.rounds)


@compiled
def advance(
    march: LaneTable, tracks: LaneTable, angular_frequency: Float[AnyArray, " lanes"]
) -> LaneTable:
    """Solve for the motions of lanes at their next frequencies.

    Returns `Track` and `Followed` of all.
    """
    own, track, w = march.lanes_last(), tracks.lanes_last(), jnp.asarray(angular_frequency)
    lanes = FollowedLanes(own, track.events)
    track, found = _advanced(lanes, track, w)
    close = _is_close(track.events, track.times[0])
    moved = lambda track: _section_moved(lanes, track, close)  # noqa: E731
    return table_of((lax.cond(jnp.any(close), moved, lambda track: track, track), found))


def keeps_to_contacts(
    track: Track,
    log: EventLog,
    begun: Float[np.ndarray, "lanes states"],
    gone: Float[np.ndarray, "lanes states"],
) -> Bool[np.ndarray, " lanes"]:
    """Whether motions that were marched for a period keep to the contacts of their tracks.

    `log` is what the march met, `begun` where it began and `gone` how far from there it ended,
    both in units of energy.
    """
    size = np.maximum(np.linalg.norm(begun, axis=1), 1e-300)
    returned = np.linalg.norm(gone, axis=1) / size
    used = track.events.stop >= 0
    angle = np.where(used, track.times[:, 0], np.pi)
    # A change of contact at drive phase 0 may count at the beginning, at the end or not at all.
    edge = np.any(np.abs(angle - TURN * np.round(angle / TURN)) < EDGE, axis=1)
    more = np.abs(np.asarray(log.number) - used.sum(axis=1))
    return (returned <= RETURNED) & (more <= np.where(edge, 1, 0))


def can_follow(march: AbstractMarch, rigs: int) -> Bool[np.ndarray, " rigs"]:
    """Which rigs' motions can be followed: with linear stops, and no mode without damping.

    Rigs are the leading axis of the arrays of `march`."""
    if not isinstance(march, ExactMarch):
        return np.zeros(rigs, bool)
    return ~may_resonate(march.phases)
