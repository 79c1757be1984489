"""Points of lanes that have been followed, until they are measured."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.steady.following import nothing_ahead

Lanes = Int[np.ndarray, " lanes"]
Points = Int[np.ndarray, " points"]


class PointsAhead:
    """So many rows of `Ahead` for each lane, in order of the points."""

    def __init__(self, lanes: int, most: int, states: int):
        self.rows = nothing_ahead(lanes * most, states)
        self.number = np.zeros(lanes, int)
        """How many there are to read."""
        self.rounds = np.zeros((lanes, most), int)
        """Rounds of Newton's method up to each."""

    def keep(
        self,
        lanes: Lanes,
        rows: Float[np.ndarray, "lanes steps columns"],
        rounds: Float[np.ndarray, "lanes steps"],
        arrived: Bool[np.ndarray, "lanes steps"],
    ) -> None:
        """Take the steps of lanes that arrived at a frequency; `rounds` are those up to each."""
        order = np.argsort(~arrived, axis=1, kind="stable")[:, : self.rounds.shape[1]]
        k, place = np.arange(len(lanes))[:, None], np.arange(order.shape[1])
        self.rows.numbers[self._own(lanes)[:, place]] = rows[k, order]
        self.rounds[lanes[:, None], place] = rounds[k, order]
        self.number[lanes] = arrived.sum(axis=1)

    def of(self, lanes: Lanes) -> tuple[Points, Points, Any]:
        """Return the lane of each point of some lanes, the rounds for it, and `Ahead`."""
        there = np.arange(self.rounds.shape[1]) < self.number[lanes, None]
        rounds = np.diff(self.rounds[lanes], axis=1, prepend=0)[there]
        own = np.repeat(lanes, self.number[lanes])
        return own, rounds, self.rows.pick(self._own(lanes)[there]).columns()

    def _own(self, lanes: Lanes) -> Int[np.ndarray, "lanes points"]:
        most = self.rounds.shape[1]
        return lanes[:, None] * most + np.arange(most)
