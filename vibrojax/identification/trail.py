"""What a search keeps of its trials: from nearest points known, the next ones are predicted."""

from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np

from vibrojax.branches.continuation import dot
from vibrojax.branches.tracing import put
from vibrojax.identification.curve_misfit import LOST, NEAR_ENOUGH, CurveMisfit, Guesses
from vibrojax.identification.nearest_point import CONVERGED, Nearest, settled
from vibrojax.identification.trial_rigs import Curve
from vibrojax.steady.batches import take
from vibrojax.steady.paths import FrequencyPath

ASTRAY = 1.0
"""Distance beyond the expected one, in standard deviations, at which a point went elsewhere."""
SAME = 0.05
"""Distance along the curve of a guess from a point that is known, for which it stands."""
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

    def is_of(self, values: np.ndarray) -> bool:
        """Whether it is the trial of these numbers."""
        return np.allclose(self.values, values, rtol=1e-12, atol=0)

    @property
    def rests(self) -> np.ndarray:
        """Whether each point stays where it is: no contact there, so no number moves it."""
        known = self.nearest
        moves = np.any(known.depth_slope, axis=(1, 2, 3)) | np.any(known.frequency_slope, axis=1)
        return settled(known, NEAR_ENOUGH) & ~moves

    def ahead(self, values: np.ndarray, scale: float) -> Guesses | None:
        """Predict the nearest points of another trial, but for those that rest.

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
        point = np.flatnonzero(~self.rests)
        return point, (known.depth + change)[point], (known.frequency + shift)[point]

    def improved(self, guesses: Guesses, scale: float) -> Guesses:
        """Return guesses of the nearest points of the same trial, exact where they agree."""
        (point, depth, frequency), known = guesses, self.nearest
        off = depth - known.depth[point]
        far = (
            dot(off, off) / dot(depth, depth) + ((frequency - known.frequency[point]) / scale) ** 2
        )
        same = (far < SAME**2) & known.found[point]
        return (
            point,
            np.where(same[:, None, None], known.depth[point], depth),
            np.where(same, known.frequency[point], frequency),
        )

    def with_points(self, point: np.ndarray, nearest: Nearest | None) -> Nearest:
        """Return its nearest points, some of them replaced."""
        return put(self.nearest, nearest, point) if len(point) else self.nearest

    def leads_to(self, found: Nearest, values: np.ndarray) -> bool:
        """Whether points that were predicted are about as far away as their slopes say."""
        known = self.nearest
        expected = known.residual + known.derivative @ (values - self.values)
        beyond = np.linalg.norm(found.residual, axis=1) - np.linalg.norm(expected, axis=1)
        return bool((found.found & (beyond < ASTRAY)).all())


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

    Curves are followed only for lanes that are not near to it; `precisely`, for all.
    """
    residual = np.full((len(values), misfit.size), LOST)
    derivative = np.zeros((*residual.shape, values.shape[1]))

    def put_down(lane: int, nearest: Nearest) -> None:
        residual[lane] = nearest.residual.ravel()
        derivative[lane] = nearest.derivative.reshape(derivative.shape[1:])

    left = []
    for lane, key in enumerate(keys):
        if not precisely and key in trail and trail[key].is_of(values[lane]):
            put_down(lane, trail[key].nearest)
        else:
            left.append(lane)
    for predicting in (False,) if precisely else (True, False):
        if not left:
            break
        lanes = misfit.lanes(values[left])
        known = [trail.get(keys[lane]) if predicting else None for lane in left]
        starts = _starts(misfit, lanes.made, known, values[left])
        guesses = list(starts)
        for k, lane in enumerate(left):
            kept = trail.get(keys[lane])
            if precisely and kept is not None and kept.is_of(values[lane]):
                whole = misfit.guesses(starts[k], int(which[lane]), frequency_scale)
                guesses[k] = kept.improved(whole, misfit.scale)
        rows, nearest = misfit.nearest(lanes, guesses, which[left], frequency_scale, precisely)
        lost = []
        for k, lane in enumerate(left):
            mine = np.flatnonzero(rows // misfit.points == k)
            before, curve, own = known[k], starts[k], take(nearest, mine)
            if isinstance(curve, Curve):
                if not len(mine):
                    continue
            else:
                curve = None
                assert before is not None  # from which it was predicted
                own = before.with_points(rows[mine] % misfit.points, own)
                if not before.leads_to(own, values[lane]):
                    lost.append(lane)
                    continue
            put_down(lane, own)
            found = Kept(values[lane], own, curve)
            if precisely or keys[lane] not in trail or found.cost <= trail[keys[lane]].cost:
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
        starts[k] = ahead
    far = np.array([k for k, start in enumerate(starts) if start is None], int)
    if len(far):
        _, first, same = np.unique(values[far], axis=0, return_index=True, return_inverse=True)
        curves = misfit.curves(take(paths, far[first]))
        for k, curve in zip(far, same.ravel(), strict=True):
            starts[k] = curves[curve]
    return starts
