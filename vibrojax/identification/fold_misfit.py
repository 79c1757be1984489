"""The objective of jumps on folds, for comparison."""

from collections.abc import Sequence

import numpy as np

from vibrojax.ensemble.slopes import WithSlopes
from vibrojax.identification.curve_misfit import LOST, CurveMisfit
from vibrojax.identification.nearest_point import WIDTH, Target
from vibrojax.identification.sensor import seen_from
from vibrojax.identification.trial_rigs import Curve, Maker
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.jumps import Jump
from vibrojax.steady.batches import take

MASKED = 2
"""Points left out on each side of a jump, where jumps are put on the folds."""


class FoldMisfit(CurveMisfit):
    """Pointwise, without the points around the jumps, and with the jumps put on the folds.

    For comparison, since a measured jump comes before its fold.
    """

    def __init__(self, maker: Maker, repetitions: Sequence[MeasuredCurve], pointwise: bool = True):
        super().__init__(maker, repetitions, pointwise)
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

    def _with_jumps(self, lanes: WithSlopes, curves: list[Curve], which, residual, derivative):
        """Leave out the points around the jumps, and add the jumps."""
        width = 1 + self.sensor.channels
        kept = np.repeat(self.kept[which], width, axis=1)
        residual = np.where(kept, residual, 0.0)
        derivative = np.where(kept[..., None], derivative, 0.0)
        more = np.zeros((len(curves), 2))
        slopes = np.zeros((len(curves), 2, derivative.shape[2]))
        for k, curve in enumerate(curves):
            for j, way in enumerate((1, -1)):
                jump = [m for m in self.jumps[which[k]] if m.direction == way]
                if jump:
                    more[k, j], slopes[k, j] = self._at_fold(lanes, k, curve, jump[0])
        return np.concatenate([residual, more], 1), np.concatenate([derivative, slopes], 1)

    def _at_fold(self, lanes: WithSlopes, lane: int, curve: Curve, jump: Jump):
        """Distance of a jump from the fold where it should be, over the step of the sweep."""
        turns = np.flatnonzero(curve.turning(jump.direction))
        middle = (jump.before + jump.after) / 2
        step = max(abs(jump.after - jump.before), 1e-4 * middle)
        if not len(turns):
            return LOST / 100, 0.0
        at = np.full(WIDTH, turns[np.argmin(np.abs(curve.frequency[turns] - middle))])
        phase = curve.channels[at, 1] if self.sensor.with_phase else None
        target = Target(
            np.full(WIDTH, middle),
            seen_from(self.sensor, curve.channels[at], phase),
            np.full(WIDTH, step),
            np.ones((WIDTH, self.sensor.channels)),
            phase,
        )
        # No rounds: the derivative at the fold itself, where the frequency is an extreme.
        here = take(lanes, np.full(WIDTH, lane))
        nearest = self.find(here, target, curve.depth[at], curve.frequency[at], 0, 0.0)
        return (middle - curve.frequency[at[0]]) / step, np.asarray(nearest.derivative)[0, 0]
