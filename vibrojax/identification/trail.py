"""What a search keeps of its trials: from nearest points known, the next ones are predicted."""

from collections.abc import Sequence
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
        shift = np.asarray(known.frequency_slope @ moved)
        size = dot(known.depth, known.depth)
        far = np.sqrt(dot(change, change) / size + (shift / scale) ** 2)
        if not (known.found & (known.newton < CONVERGED) & (far < FARTHEST)).all():
            return None
        point = np.flatnonzero(~self.rests)
        depth, frequency = known.depth + change, known.frequency + shift
        return point, np.asarray(depth)[point], np.asarray(frequency)[point]

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


Trail = dict[tuple[int, int], Kept]
"""The best trials at one frequency scale, by measurement and start."""


def residuals_along(
    trail: Trail,
    keys: Sequence[tuple[int, int]],
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
        lanes, kept = misfit.lanes(values[left]), [trail.get(keys[lane]) for lane in left]
        starts: list[Any] = [None] * len(left)
        for k, before in enumerate(kept):
            if predicting and before is not None:
                starts[k] = before.ahead(values[left[k]], misfit.scale)
        curves = _curves(misfit, lanes.made, values[left], [start is None for start in starts])
        for k, curve in curves.items():
            starts[k], before, lane = curve, kept[k], left[k]
            if precisely and before is not None and before.is_of(values[lane]):
                guesses = misfit.guesses(curve, int(which[lane]), frequency_scale)
                starts[k] = before.improved(guesses, misfit.scale)
        rows, nearest = misfit.nearest(lanes, starts, which[left], frequency_scale, precisely)
        lost = []
        for k, lane in enumerate(left):
            mine = np.flatnonzero(rows // misfit.points == k)
            own, before = take(nearest, mine), kept[k]
            if k not in curves:
                assert before is not None  # from which it was predicted
                own = before.with_points(rows[mine] % misfit.points, own)
                if not before.leads_to(own, values[lane]):
                    lost.append(lane)
                    continue
            elif not len(mine):
                continue
            put_down(lane, own)
            found = Kept(values[lane], own, curves.get(k))
            if precisely or before is None or found.cost <= before.cost:
                trail[keys[lane]] = found
        left = lost
    return residual, derivative


def _curves(
    misfit: CurveMisfit, paths: FrequencyPath, values: np.ndarray, wanted: Sequence[bool]
) -> dict[int, Curve]:
    """Follow the curves of some lanes; those of the same numbers share theirs."""
    lanes = np.flatnonzero(wanted)
    if not len(lanes):
        return {}
    _, first, same = np.unique(values[lanes], axis=0, return_index=True, return_inverse=True)
    curves = misfit.curves(take(paths, lanes[first]))
    return {int(k): curves[one] for k, one in zip(lanes, same.ravel(), strict=True)}
