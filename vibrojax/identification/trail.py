"""What a search keeps of its trials: from nearest points known, the next ones are predicted."""

from collections.abc import Hashable
from typing import NamedTuple

import numpy as np

from vibrojax.branches.continuation import dot
from vibrojax.identification.nearest_point import CONVERGED, Nearest
from vibrojax.identification.trial_rigs import Curve

FARTHEST = 0.1
"""Farthest that a point is predicted, in the arclength of the continuation."""


class Kept(NamedTuple):
    """The best trial of a start."""

    values: np.ndarray
    """Its numbers."""
    cost: float
    nearest: Nearest
    """The nearest points, one for every measured point."""
    curve: Curve | None
    """Its curve; None where points were predicted."""

    def ahead(self, values: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Predict motions and frequencies of the nearest points of another trial.

        `scale` is the change of frequency that counts as much as a motion changing by its size.
        None where one of the points is not known well, or goes far.
        """
        moved, known = values - self.values, self.nearest
        change = np.einsum("n,pnsh->psh", moved, known.depth_slope)
        shift = known.frequency_slope @ moved
        size = dot(known.depth, known.depth)
        far = np.sqrt(dot(change, change) / size + (shift / scale) ** 2)
        if not (known.found & (known.newton < CONVERGED) & (far < FARTHEST)).all():
            return None
        return known.depth + change, known.frequency + shift


Trail = dict[Hashable, Kept]
"""The best trial, by start."""
