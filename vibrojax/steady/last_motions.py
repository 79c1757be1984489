"""The last settled motions of many lanes: where they are followed from, and may go back to."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from vibrojax.steady.map_orbits import no_orbits
from vibrojax.steady.tracks import no_tracks

Lanes = Int[np.ndarray, " lanes"]
States = Float[np.ndarray, "lanes states"]


class LastMotions:
    """Motions by their contact times (`tracks`) and orbits of the map (`orbits`), a row a lane."""

    def __init__(self, lanes: int, states: int):
        self.tracks, self._tracks_before = (no_tracks(lanes, states) for _ in range(2))
        self.track: Any = self.tracks.columns()
        """Views of the tracks: what is written into them is there."""
        self.orbits, self._orbits_before = (no_orbits(lanes, states) for _ in range(2))
        self.orbit: Any = self.orbits.columns()

    def leave(self, on: Lanes, back: Int[np.ndarray, " others"]) -> None:
        """Let lanes go on from their motions, or `back` to those they went on from before."""
        for now, before in (
            (self.tracks, self._tracks_before),
            (self.orbits, self._orbits_before),
        ):
            now.numbers[back] = before.numbers[back]
            before.numbers[on] = now.numbers[on]

    def orbits_at(self, lanes: Lanes, angular_frequency: Float[np.ndarray, " lanes"]) -> States:
        """Return where orbits go on to at frequencies (rad/s), in units of energy."""
        way = angular_frequency - self.orbit.frequency[lanes]
        return self.orbit.state[lanes] + way[:, None] * self.orbit.slope[lanes]

    def orbits_left(self, lanes: Lanes) -> States:
        """Return the orbits that lanes went on from, in units of energy."""
        return self._orbits_before.pick(lanes).columns().state

    def stepped(
        self, lanes: Lanes, begun: States, end: States
    ) -> tuple[States, Float[np.ndarray, " lanes"]]:
        """Take a step of Newton's method with the Jacobian of the last orbits, in units of energy.

        `end` is where the map leads from where motions have `begun`. Also returns how far those
        are, over their size.
        """
        gap, matrix = end - begun, self.orbit.matrix[lanes]
        size = np.maximum(np.linalg.norm(begun, axis=1), 1e-300)
        step = np.linalg.solve(np.eye(gap.shape[1]) - matrix, gap[..., None])[..., 0]
        return begun + step, np.linalg.norm(gap, axis=1) / size
