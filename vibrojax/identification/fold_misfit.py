"""Pointwise misfit with the points around the jumps left out, and the jumps put on the folds."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from vibrojax.identification.curve_misfit import LOST, CurveMisfit
from vibrojax.identification.nearest_point import Target
from vibrojax.identification.trial_rigs import Curve, Lanes, find_nearest
from vibrojax.steady.batches import take

MASKED = 2
"""Points left out on each side of a jump."""


class FoldMisfit(CurveMisfit):
    """The objective `folds`: for comparison, since a measured jump comes before its fold."""

    def __init__(self, *args: Any, **settings: Any):
        super().__init__(*args, **settings)
        repetitions = args[4]
        self.jumps = [m.jumps() for m in repetitions]
        self.kept = np.ones((len(repetitions), self.points), bool)
        for k, m in enumerate(repetitions):
            for jump in self.jumps[k]:
                same = np.flatnonzero(m.direction == jump.direction)
                place = int(np.flatnonzero(same == jump.at)[0])
                self.kept[k, same[max(place - MASKED, 0) : place + MASKED]] = False

    @property
    def size(self) -> int:
        """How many residuals there are: two more, for the jumps."""
        return super().size + 2

    def residuals(
        self,
        values: np.ndarray,
        which: np.ndarray,
        frequency_scale: float,
        *,
        precisely: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of all rigs and their derivatives; as `CurveMisfit.residuals`."""
        lanes = self.lanes(values)
        curves = self.curves(lanes.paths)
        residual, derivative = self._residuals(lanes, curves, which, frequency_scale, precisely)
        width = 1 + self.sensor.channels
        kept = np.repeat(self.kept[which], width, axis=1)
        residual = np.where(kept, residual, 0.0)
        derivative = np.where(kept[..., None], derivative, 0.0)
        more, slopes = np.zeros((len(values), 2)), np.zeros((len(values), 2, len(self.names)))
        for k, curve in enumerate(curves):
            for j, way in enumerate((1, -1)):
                jump = [m for m in self.jumps[which[k]] if m.direction == way]
                if jump:
                    more[k, j], slopes[k, j] = self._at_fold(lanes, k, curve, jump[0])
        return np.concatenate([residual, more], 1), np.concatenate([derivative, slopes], 1)

    def _at_fold(self, lanes: Lanes, lane: int, curve: Curve, jump: Any):
        """Distance of a jump from the fold where it should be, over the step of the sweep."""
        turns = np.flatnonzero(curve.turning(jump.direction))
        middle = (jump.before + jump.after) / 2
        step = max(abs(jump.after - jump.before), 1e-4 * middle)
        if not len(turns):
            return LOST / 100, np.zeros(len(self.names))
        at = turns[np.argmin(np.abs(curve.frequency[turns] - middle))]
        target = Target(
            np.full(64, middle),
            np.repeat(curve.channels[at][None], 64, 0),
            np.full(64, step),
            np.ones((64, self.sensor.channels)),
        )
        here = np.full(64, lane)
        # No rounds: the derivative at the fold itself, where the frequency is an extreme.
        nearest = find_nearest(
            take(lanes.paths, here),
            take(lanes.slopes, here),
            target,
            np.repeat(curve.depth[at][None], 64, 0),
            np.full(64, curve.frequency[at]),
            self.sensor,
            scale=self.scale,
            rounds=jnp.asarray(0),
            close=jnp.asarray(0.0),
        )
        return (middle - curve.frequency[at]) / step, np.asarray(nearest.derivative)[0, 0]
