"""What a search keeps of its trials: from nearest points known, the next ones are predicted."""

from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np

from vibrojax.branches.continuation import dot
from vibrojax.identification.curve_misfit import LOST, CurveMisfit, Guesses
from vibrojax.identification.nearest_point import CONVERGED, Nearest
from vibrojax.identification.trial_rigs import Curve
from vibrojax.steady.batches import take
from vibrojax.steady.paths import FrequencyPath

FARTHEST = 0.1
"""Farthest that a point is predicted, in the arclength of the continuation."""


class Kept(NamedTuple):
    """The best trial of a start."""

    values: np.ndarray
    """Its numbers."""
    nearest: Nearest
    """The nearest points, one for every measured point."""
    curve: Curve | None
    """Its curve; None where points were predicted."""

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(np.sum(self.nearest.residual**2))

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
"""The best trial at one frequency scale, by start."""


def residuals_along(
    trail: Trail,
    keys: Sequence[Hashable],
    misfit: CurveMisfit,
    values: np.ndarray,
    which: np.ndarray,
    frequency_scale: float,
    precisely: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Do as `CurveMisfit.residuals`, going on from what the trail keeps under the `keys` of lanes.

    Curves are followed only for lanes that are not near to it.
    """
    residual = np.full((len(values), misfit.size), LOST)
    derivative = np.zeros((*residual.shape, values.shape[1]))

    def put(lane: int, nearest: Nearest) -> None:
        residual[lane] = nearest.residual.ravel()
        derivative[lane] = nearest.derivative.reshape(derivative.shape[1:])

    left = []
    for lane, key in enumerate(keys):
        if key in trail and np.array_equal(trail[key].values, values[lane]):
            put(lane, trail[key].nearest)
        else:
            left.append(lane)
    for predicting in (True, False):
        if not left:
            break
        lanes = misfit.lanes(values[left])
        known = [trail.get(keys[lane]) if predicting else None for lane in left]
        starts = _starts(misfit, lanes.made, known, values[left])
        usable, nearest = misfit.nearest(lanes, starts, which[left], frequency_scale, precisely)
        lost = []
        for row, k in enumerate(usable):
            own = take(nearest, slice(row * misfit.points, (row + 1) * misfit.points))
            curve = starts[k] if isinstance(starts[k], Curve) else None
            lane = left[k]
            if curve is None and not own.found.all():
                lost.append(lane)
                continue
            put(lane, own)
            found = Kept(values[lane], own, curve)
            if keys[lane] not in trail or found.cost <= trail[keys[lane]].cost:
                trail[keys[lane]] = found
        left = lost
    return residual, derivative


def _starts(
    misfit: CurveMisfit, paths: FrequencyPath, known: Sequence[Kept | None], values: np.ndarray
) -> list[Curve | Guesses]:
    """Where to look for the nearest points of every lane: where they are predicted, or its curve.

    Lanes of the same numbers share their curve.
    """
    starts: list[Any] = [None] * len(values)
    for k, kept in enumerate(known):
        ahead = None if kept is None else kept.ahead(values[k], misfit.scale)
        starts[k] = None if ahead is None else (np.arange(misfit.points), *ahead)
    far = np.array([k for k, start in enumerate(starts) if start is None], int)
    if len(far):
        _, first, same = np.unique(values[far], axis=0, return_index=True, return_inverse=True)
        curves = misfit.curves(take(paths, far[first]))
        for k, curve in zip(far, same.ravel(), strict=True):
            starts[k] = curves[curve]
    return starts
