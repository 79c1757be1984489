"""Steady states that lanes arrive at, and where they are sent next."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.results.status import Status
from vibrojax.stepping.measures import Measures

SETTLED = Status.settled.value


def place_in_lane(lanes: Int[np.ndarray, " points"]) -> Int[np.ndarray, " points"]:
    """Return how many points of the same lane are before each; those of a lane are together."""
    every = np.arange(len(lanes))
    first = np.diff(lanes, prepend=-1) != 0
    return every - np.maximum.accumulate(np.where(first, every, 0))


def status_of(
    state: Float[np.ndarray, "lanes states"],
    grows: Bool[np.ndarray, " lanes"],
    period: Int[np.ndarray, " lanes"],
) -> Int[np.ndarray, " lanes"]:
    """Return the status of lanes by their states: infinite where they gave up, NaN where lost.

    `grows` says which would grow without bound.
    """
    kind = np.where(period > 0, SETTLED, Status.aperiodic.value)
    lost = [grows, np.isinf(state).any(axis=1), ~np.isfinite(state).all(axis=1)]
    words = Status.unbounded, Status.gave_up, Status.diverged
    return np.select(lost, [w.value for w in words], kind).astype(np.int32)


class Settled(NamedTuple):
    """Steady states of some lanes, lanes leading; a lane may have several, one after the other."""

    lanes: Int[np.ndarray, " lanes"]
    state: Float[np.ndarray, "lanes states"]
    period: Int[np.ndarray, " lanes"]
    status: Int[np.ndarray, " lanes"]
    periods_marched: Int[np.ndarray, " lanes"]
    steps: Int[np.ndarray, " lanes"]
    window: Int[np.ndarray, " lanes"]
    """Drive periods measured."""
    measures: Measures


class Onwards(NamedTuple):
    """Where the lanes that settled go next."""

    active: Bool[np.ndarray, " lanes"]
    angular_frequency: Float[np.ndarray, " lanes"]
    """rad/s; of no meaning where a lane is not active any more."""
    state: Float[np.ndarray, "lanes states"]
    goes_on: Bool[np.ndarray, " lanes"]
    """Whether a lane goes on from its last motion; else, again from the one before."""
