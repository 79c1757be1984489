"""What is known of the motions of lanes that are followed from one drive frequency to the next."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax.steady.contact_times import Events
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.stepping.contact_phases import may_resonate
from vibrojax.stepping.measures import MOST_EVENTS, EventLog
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

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


def no_tracks(lanes: int, states: int) -> LaneTable:
    """Return the tracks of lanes of which nothing is known."""
    return table_of(no_track(lanes, states), xp=np)


def no_track(lanes: int, states: int) -> Track:
    """Return the same with the lanes as the trailing axis."""

    def zeros(*shape: int) -> Any:
        return np.zeros((*shape, lanes))

    stop: Any = np.full((MOST_EVENTS, lanes), -1, np.int32)
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
    """Put motions into some lanes of tracks, of which a march has noted one drive period.

    `track` is the columns of a table of `Track`; all arrays have the lanes leading.
    """
    track.events.stop[lanes], track.events.section[lanes] = log.stop, 0.0
    track.events.first_phase[lanes] = log.first_phase
    track.known[lanes] = np.where(log.number <= MOST_EVENTS, 0, -1)
    track.frequency[lanes, 0], track.state[lanes, 0] = angular_frequency, weighted
    track.times[lanes, 0] = np.where(np.asarray(log.stop) >= 0, log.angle, TURN)


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
