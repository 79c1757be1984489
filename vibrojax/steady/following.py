"""Settled motions followed from one drive frequency to the next, without marching.

The motion at the next frequency is predicted from those before and solved for by its contact times.
It is taken if it is stable, keeps to the contacts of the last one and is its continuation; all else
is for the march to find out, as where a branch ends.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.model.drives import AbstractDrive
from vibrojax.steady.batches import take_rigs
from vibrojax.steady.contact_times import (
    Events,
    Orbit,
    PiecewiseMotion,
    Tables,
    follow_events,
    tables_of,
)
from vibrojax.steady.orbit_reading import state_at
from vibrojax.steady.settling import NEAR, is_stable
from vibrojax.stepping.contact_phases import ContactPhases, may_resonate
from vibrojax.stepping.measures import MOST_EVENTS, EventLog
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

lax = jax.lax

CLOSED = 1e-10
"""Relative residual at which a motion is solved for."""
ROUND_OFF = 1e-13
"""At which it is left as it is: results are then the same wherever the search began."""
MOST_ROUNDS = 8
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


def no_tracks(lanes: int, states: int) -> Track:
    """Return the tracks of lanes of which nothing is known."""

    def zeros(*shape: int) -> Any:
        return np.zeros((lanes, *shape))

    stop: Any = np.full((lanes, MOST_EVENTS), -1, np.int32)
    return Track(
        events=Events(stop, zeros().astype(np.int32), zeros()),
        known=(zeros() - 1).astype(np.int32),
        frequency=zeros(2) + 1,
        state=zeros(2, states),
        times=zeros(2, MOST_EVENTS),
        state_slope=zeros(2, states),
        times_slope=zeros(2, MOST_EVENTS),
    )


def begin_track(
    track: Any,
    lanes: Int[np.ndarray, " lanes"],
    weighted: Float[np.ndarray, "lanes states"],
    angular_frequency: Float[np.ndarray, " lanes"],
    log: EventLog,
) -> None:
    """Put motions into some lanes of a `Track`, of which a march has noted one drive period."""
    stop, angle = np.asarray(log.stop).T, np.asarray(log.angle).T
    track.events.stop[lanes], track.events.section[lanes] = stop, 0.0
    track.events.first_phase[lanes] = log.first_phase
    track.known[lanes] = np.where(np.asarray(log.number) <= MOST_EVENTS, 0, -1)
    track.frequency[lanes, 0], track.state[lanes, 0] = angular_frequency, weighted
    track.times[lanes, 0] = np.where(stop >= 0, angle, TURN)


class _Solved(NamedTuple):
    state: Float[Array, " states"]
    """In units of energy."""
    times: Float[Array, " events"]
    motion: PiecewiseMotion
    matrix: Float[Array, "states states"]
    """Jacobian of the period map, in units of energy."""
    error: Float[Array, ""]
    error_before: Float[Array, ""]
    rounds: Int[Array, ""]


class _Lane(eqx.Module):
    """What a lane is made of, apart from its drive frequency."""

    phases: ContactPhases
    drive: AbstractDrive

    def tables(self, w: Float[Array, ""]) -> Tables:
        return tables_of(self.phases, self.drive, w, resonant=False)

    def follow(
        self, events: Events, w: Float[Array, ""], state: Array, times: Array, *, push: bool
    ) -> PiecewiseMotion:
        orbit = Orbit(state / self.phases.weight, times)
        tables = self.tables(w)
        return follow_events(tables, events, orbit, 1, events.number, with_jacobian=push)

    def solve(self, events: Events, w: Array, state: Array, times: Array) -> _Solved:
        """Newton's method on the state at the section, the times of contact following."""
        weight, used = self.phases.weight, events.stop >= 0
        size = jnp.linalg.norm(state)
        size = jnp.where(size > 0, size, 1.0)

        def look(state: Array, times: Array, before: Array, rounds: Array) -> _Solved:
            motion = self.follow(events, w, state, times, push=True)
            assert motion.jacobian is not None
            matrix = weight[:, None] * motion.jacobian / weight
            moved = jnp.max(jnp.abs(motion.times - times), where=used, initial=0.0)
            gone = jnp.max(jnp.abs(motion.end * weight - state)) / size
            motion = motion._replace(jacobian=None)
            error = jnp.maximum(gone, moved)
            return _Solved(state, times, motion, matrix, error, before, rounds)

        def better(found: _Solved) -> _Solved:
            gap = found.motion.end * weight - found.state
            change = jnp.linalg.solve(jnp.eye(gap.size) - found.matrix, gap)
            state, times = found.state + change, found.motion.times
            return look(state, times, found.error, found.rounds + 1)

        def going(found: _Solved) -> Array:
            shrinks = (found.rounds <= FREE_ROUNDS) | (found.error < found.error_before / 2)
            return (found.error > ROUND_OFF) & (found.rounds < MOST_ROUNDS) & shrinks

        far = jnp.full_like(size, jnp.inf)
        return lax.while_loop(going, better, look(state, times, far, jnp.int32(1)))


def _slopes(
    lane: _Lane, events: Events, w: Array, found: _Solved
) -> tuple[Float[Array, " states"], Float[Array, " events"]]:
    """Derivatives of state and times along the branch, by the drive frequency."""

    def followed(state: Array, w: Array) -> tuple[Array, Array]:
        motion = lane.follow(events, w, state, found.times, push=False)
        return motion.end * lane.phases.weight, motion.times

    one = jnp.ones_like(w)
    _, (push, _) = jax.jvp(lambda w: followed(found.state, w), (w,), (one,))
    slope = jnp.linalg.solve(jnp.eye(push.size) - found.matrix, push)
    _, (_, times_slope) = jax.jvp(followed, (found.state, w), (slope, one))
    return slope, times_slope


def _predicted(track: Track, w: Array) -> tuple[Float[Array, " states"], Float[Array, " events"]]:
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


def _after(events: Events, times: Float[Array, " events"]) -> Float[Array, " events"]:
    """How long the phases behind the events take, as drive angles."""
    used = events.stop >= 0
    last = jnp.arange(times.size) + 1 == jnp.sum(used)
    return jnp.where(used, jnp.where(last, times[0] + TURN, jnp.roll(times, -1)) - times, 0.0)


def _is_close(track: Track) -> Bool[Array, ""]:
    """Whether the section is close to a change of contact."""
    events, times = track.events, track.times[0]
    used = events.stop >= 0
    last = jnp.max(times, where=used, initial=-jnp.inf)
    nearest = jnp.minimum(times[0] - events.section, events.section + TURN - last)
    room = jnp.minimum(CLOSE, jnp.max(_after(events, times)) / 4)
    return (jnp.sum(used) > 0) & (nearest < room)


def _section_moved(lane: _Lane, track: Track) -> Track:
    """Move a section that is close to a change of contact into the middle of the longest phase.

    There the newest point is a guess again.
    """
    events, times, w = track.events, track.times[0], track.frequency[0]
    used, length = events.stop >= 0, _after(track.events, track.times[0])
    longest = jnp.argmax(length)
    section = times[longest] + length[longest] / 2
    section = jnp.where(section >= events.section + TURN, section - TURN, section)
    early = used & (times < section)
    later = jnp.where(early, times + TURN, times)
    order = jnp.argsort(jnp.where(used, later, jnp.inf))
    first = events.first_phase
    for s in range(lane.phases.num_stops):
        odd = jnp.sum(early & (events.stop == s)) % 2
        first = first ^ (odd << s).astype(first.dtype)
    # The section is counted from less than a turn.
    turns = TURN * jnp.floor(section / TURN)
    whole = section - turns
    stop = events.stop[order]
    new_times = jnp.where(stop >= 0, later[order] - turns, whole + TURN)
    motion = lane.follow(events, w, track.state[0], times, push=False)
    state = state_at(lane.tables(w), motion, section, events.section, 1) * lane.phases.weight
    moved = track._replace(
        events=Events(stop, first, whole),
        known=jnp.zeros_like(track.known),
        state=track.state.at[0].set(state),
        times=track.times.at[0].set(new_times),
    )
    return jax.tree.map(lambda a, b: jnp.where(_is_close(track), a, b), moved, track)


def _advanced(lane: _Lane, track: Track, w: Array) -> tuple[Track, Followed]:
    """Solve for the motion of one lane at a frequency; where that is not good, the track stays."""
    events, known = track.events, track.known > 0
    ahead = _predicted(track, w)
    guess, times = (
        jnp.where(known, a, b) for a, b in zip(ahead, (track.state[0], track.times[0]), strict=True)
    )
    found = lane.solve(events, w, guess, times)
    slope, times_slope = _slopes(lane, events, w, found)
    # Along one branch the slopes at both ends give the step between them.
    step = found.state - track.state[0]
    straight = (w - track.frequency[0]) / 2 * (slope + track.state_slope[0])
    bent = jnp.linalg.norm(step - straight)
    size, length = jnp.linalg.norm(found.state), jnp.linalg.norm(step)
    goes_on = jnp.where(known, bent <= BENT * length + STRAIGHT * size, length <= 5 * NEAR * size)
    good = (found.error <= CLOSED) & goes_on & is_stable(found.matrix)
    good &= jnp.all(jnp.isfinite(slope))

    def pair(new: Array, old: Array) -> Array:
        return jnp.stack([new, old[0]])

    point = Track(
        events=events,
        known=jnp.where(known, 2, 1).astype(jnp.int32),
        frequency=pair(w, track.frequency),
        state=pair(found.state, track.state),
        times=pair(found.times, track.times),
        state_slope=pair(slope, track.state_slope),
        times_slope=pair(times_slope, track.times_slope),
    )
    new = jax.tree.map(lambda a, b: jnp.where(good, a, b), point, track)
    at_start = state_at(lane.tables(w), found.motion, jnp.zeros(()), events.section, 1)
    return new, Followed(good, at_start, found.rounds)


def _lanes(march: AbstractMarch, rigs: Int[AnyArray, " lanes"]) -> _Lane:
    """Stack lanes, each with its rig, along a leading axis."""
    assert isinstance(march, ExactMarch)
    own = take_rigs(_Lane(march.phases, march.drive), rigs)
    return jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), own)


@compiled
def advance(
    march: AbstractMarch,
    rigs: Int[AnyArray, " lanes"],
    track: Track,
    angular_frequency: Float[AnyArray, " lanes"],
) -> tuple[Track, Followed]:
    """Solve for the motions of lanes, each with its rig, at the frequencies they come to next."""
    lanes = _lanes(march, rigs)
    track, found = jax.vmap(_advanced)(lanes, track, jnp.asarray(angular_frequency))
    close = jax.vmap(_is_close)(track)
    return lax.cond(jnp.any(close), jax.vmap(_section_moved), lambda _, t: t, lanes, track), found


def keeps_to_contacts(
    track: Track, log: EventLog, returned: Float[np.ndarray, " lanes"]
) -> Bool[np.ndarray, " lanes"]:
    """Whether motions that were marched for a period keep to the contacts of their tracks.

    `log` is what the march met, lanes last, and `returned` how far from where it began it ended,
    over the size of the state.
    """
    used = track.events.stop >= 0
    angle = np.where(used, track.times[:, 0], np.pi)
    # A change of contact at drive phase 0 may count at the beginning, at the end or not at all.
    edge = np.any(np.abs(angle - TURN * np.round(angle / TURN)) < EDGE, axis=1)
    more = np.abs(np.asarray(log.number) - used.sum(axis=1))
    return (returned <= RETURNED) & (more <= np.where(edge, 1, 0))


def can_follow(march: AbstractMarch, rigs: int) -> Bool[np.ndarray, " rigs"]:
    """Which rigs' motions can be followed: with linear stops, and no mode without damping."""
    if not isinstance(march, ExactMarch):
        return np.zeros(rigs, bool)
    lanes_lead = jax.tree.map(lambda a: np.moveaxis(np.asarray(a), -1, 0), march.phases)
    return ~may_resonate(lanes_lead)
