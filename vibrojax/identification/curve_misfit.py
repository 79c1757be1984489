"""Distance of measured points from the response curves of many trial rigs at once."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.branches.continuation import Ending
from vibrojax.branches.over_range import scale_of, trace_over
from vibrojax.branches.tracing import Traced
from vibrojax.ensemble.slopes import WithSlopes
from vibrojax.identification.as_measured import (
    channels_of,
    check_alike,
    deviations_of,
    drive_levels,
    drive_of_rig,
    order_of,
    sensor_of,
)
from vibrojax.identification.first_guesses import (
    Guesses,
    Points,
    at_crossings,
    at_nearest_places,
)
from vibrojax.identification.nearest_point import WIDTH, Nearest, Target, nearest_points, settled
from vibrojax.identification.sensor import seen_back, seen_from
from vibrojax.identification.trial_rigs import (
    SAMPLES,
    WIDTHS,
    Curve,
    Maker,
    at_level,
    driven,
    driven_as_measured,
    free_and_touching,
    frequency_path,
    observe_points,
    together,
)
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.steady.batches import filled_up, in_batches, take
from vibrojax.steady.paths import FrequencyPath

MOST_POINTS = 300
LONGEST_STEP = 0.16
"""Along the curve: generous, since nearest points are solved for."""
ALONE = (1,)
"""Curves followed in one loop: several wait for the longest, and mostly there is but one."""
MARGIN = 0.02
"""How far beyond the measured frequencies a curve is followed, relative."""
FEW_ROUNDS, MANY_ROUNDS = 4, 30
NEAR_ENOUGH, PRECISE = 1e-3, 1e-8
"""Last step to a nearest point, in a search and at its end."""
HELD = 1e-7
"""Frequency scale that keeps a point at its frequency."""
FAR_AWAY = 1e6
"""A gap that is never closed, m."""
LOST = 1e3
"""Residual of every point of a rig without a curve, in standard deviations."""


class CurveMisfit:
    """Misfit of a measured curve, as a function of the numbers of the user's function.

    Several repetitions of one measurement, of the same number of points, can be fitted side by
    side: every lane says which one it is compared with.
    """

    def __init__(self, maker: Maker, repetitions: Sequence[MeasuredCurve], pointwise: bool = False):
        check_alike(repetitions)
        first = repetitions[0]
        self.maker, self.pointwise = maker, pointwise
        self.unit = 1.0
        """Frequency that a frequency scale refers to: the first natural one, or 1 for ratios."""
        self.sensor = sensor_of(first)
        self.is_ratio = first.frequency_name == "frequency_ratio"
        self.frequency = np.stack([m.frequency for m in repetitions])
        self.direction = np.stack([m.direction for m in repetitions])
        self.channels = np.stack([channels_of(m) for m in repetitions])
        self.deviation = np.stack([deviations_of(m) for m in repetitions])
        self.order = order_of(first)
        """Which derivative of what drives the rig was measured."""
        self.drive, self.levels = None, None
        """Drive of every point as measured; amplitudes of that kind at which curves are traced."""
        self.rig_drive = None
        """Drive of every point as the rig has it, N or m."""
        if first.drive_amplitude is not None:
            self.drive = np.stack([np.asarray(m.drive_amplitude) for m in repetitions])
            self.levels = drive_levels(self.drive)
            self.rig_drive = np.stack([np.asarray(drive_of_rig(m)) for m in repetitions])
        self.low = float(self.frequency.min()) * (1 - MARGIN)
        self.high = float(self.frequency.max()) * (1 + MARGIN)

    @property
    def points(self) -> int:
        """How many points were measured."""
        return self.frequency.shape[1]

    @property
    def size(self) -> int:
        """How many residuals there are."""
        return self.points * (1 + self.sensor.channels)

    @property
    def values(self) -> int:
        """How many numbers were measured: a phase may be missing at some points."""
        return round(np.isfinite(self.deviation).sum() / len(self.deviation))

    @property
    def scale(self) -> float:
        """Change of frequency that counts as much as a motion changing by its size."""
        return scale_of(self.low, self.high, self.unit)

    def lanes(self, values: np.ndarray) -> WithSlopes:
        """Paths of the trial rigs with these numbers (lanes by names)."""
        index = filled_up(len(values), WIDTHS[-1])
        made, slopes = jax.device_get(
            self.maker.trials(frequency_path, self.is_ratio, values[index])
        )
        changes = jax.tree.map(lambda a: bool(np.any(a)), slopes)
        if any(jax.tree.leaves(changes)):  # no derivatives along what no number changes
            slopes = eqx.filter(slopes, changes)
        return take(WithSlopes(made, slopes), slice(len(values)))

    def curves(self, paths: FrequencyPath) -> list[Curve]:
        """Follow the response curves of all rigs over the measured range, at every drive level."""
        if self.levels is None:
            return self._followed(paths)
        count, lanes = len(self.levels), paths.unit.shape[0]
        each = take(paths, np.repeat(np.arange(lanes), count))
        found = self._followed(at_level(each, np.tile(self.levels, lanes), self.order))
        starts = range(0, len(found), count)
        return [together(found[k : k + count], self.levels) for k in starts]

    def _followed(self, paths: FrequencyPath) -> list[Curve]:
        """Follow the response curves of all paths over the measured range.

        From the end where there is no contact yet; where that does not get through, from the other
        one too.
        """
        lanes = paths.unit.shape[0]
        padded = take(paths, filled_up(lanes, WIDTHS[-1]))
        ends = [np.full(padded.unit.shape[0], end) for end in (self.low, self.high)]
        free = [jax.device_get(free_and_touching(padded, end)) for end in ends]
        from_high = (free[0][1] & ~free[1][1])[:lanes]

        def trace(index: np.ndarray, down: np.ndarray) -> list[Traced]:
            low, high = (depth[index] for depth, _ in free)
            return trace_over(
                take(paths, index),
                np.where(down, self.high, self.low),
                self.low,
                self.high,
                scale=self.scale,
                way=np.where(down, -1.0, 1.0),
                guess=np.where(down[:, None, None], high, low),
                longest=LONGEST_STEP,
                samples=SAMPLES,
                max_points=MOST_POINTS,
                widths=ALONE,
            )

        pieces = [[piece] for piece in trace(np.arange(lanes), from_high)]
        short = [k for k, (piece,) in enumerate(pieces) if piece.ending is not Ending.completed]
        if short:
            again = np.array(short)
            for k, piece in zip(short, trace(again, ~from_high[again]), strict=True):
                pieces[k].append(piece)
        return self._seen(paths, pieces)

    def _seen(self, paths: FrequencyPath, pieces: list[list[Traced]]) -> list[Curve]:
        """Read the channels of all points of the pieces of all lanes."""
        numbered = [(k, piece) for k, own in enumerate(pieces) for piece in own]
        counts = [len(piece.parameter) for _, piece in numbered]
        lane = np.repeat([k for k, _ in numbered], counts)
        frequency = np.concatenate([piece.parameter for _, piece in numbered])
        depth = np.concatenate([piece.depth for _, piece in numbered])
        continues = np.concatenate([np.arange(count) < count - 1 for count in counts])
        channels = np.zeros((0, self.sensor.channels))
        if len(lane):
            channels = self._observed(paths, lane, depth, frequency)
        columns = frequency, channels, depth, continues
        return [Curve(*(c[lane == k] for c in columns)) for k in range(len(pieces))]

    def _observed(self, paths: FrequencyPath, lane, depth, frequency, drive=None) -> np.ndarray:
        """Channels of some motions, each of its own lane, and its own drive where there is one."""

        def at(i):
            own = take(paths, lane[i])
            own = own if drive is None else driven(own, drive[i])
            return observe_points(own, self.sensor, depth[i], frequency[i])

        return in_batches(at, len(lane))

    def nearest(
        self,
        lanes: WithSlopes,
        starts: Sequence[Curve | Guesses],
        which: np.ndarray,
        frequency_scale: float,
        precisely: bool,
    ) -> tuple[np.ndarray, Nearest | None]:
        """Find the nearest points; return their rows (of lanes by measured points), and them.

        They are looked for from the curve of each rig, or from guesses of some of them.
        """
        guesses = [
            self.guesses(start, int(k), frequency_scale) if isinstance(start, Curve) else start
            for start, k in zip(starts, which, strict=True)
        ]
        lane = np.repeat(np.arange(len(guesses)), [len(guess[0]) for guess in guesses])
        if not len(lane):
            return lane, None
        point, depth, frequency = (np.concatenate(part) for part in zip(*guesses, strict=True))
        # Like with like: a batch takes as long as its longest contact.
        order = np.argsort(np.sum(np.fft.irfft(depth, SAMPLES) > 0, axis=(1, 2)), kind="stable")
        lane, point, depth, frequency = lane[order], point[order], depth[order], frequency[order]
        row = which[lane], point
        wanted, phase = self._wanted(*row)
        target = Target(
            self.frequency[row],
            wanted,
            np.full(len(lane), self.unit * (HELD if self.pointwise else frequency_scale)),
            self.deviation[row],
            phase,
        )
        drive = None if self.rig_drive is None else self.rig_drive[row]
        close = PRECISE if precisely else NEAR_ENOUGH

        def find(i, rounds=FEW_ROUNDS):
            own = take(lanes, lane[i])
            own = own if drive is None else driven_as_measured(own, drive[i])
            return self.find(own, take(target, i), depth[i], frequency[i], rounds, close)

        nearest = in_batches(find, len(lane), WIDTH)
        slow = np.flatnonzero(~settled(nearest, close))
        # The few that creep, next to folds; a search does without the last of their way.
        if precisely and len(slow):
            again = in_batches(lambda i: find(slow[i], MANY_ROUNDS), len(slow), WIDTH)
            for whole, part in zip(nearest, again, strict=True):
                whole[slow] = part
        # Of several guesses the one that came nearest.
        row = lane * self.points + point
        order = np.lexsort((np.sum(nearest.residual**2, axis=1), row))
        rows, first = np.unique(row[order], return_index=True)
        return rows, take(nearest, order[first])

    def _wanted(self, *row: Any) -> tuple[np.ndarray, np.ndarray | None]:
        """Channels of some points as they are seen from their phases, and these."""
        channels, phase = self.channels[row], None
        if self.sensor.with_phase:
            phase = channels[..., 1]
            channels = seen_from(self.sensor, channels, phase)
        return channels, phase

    def find(self, lanes: WithSlopes, target: Target, depth, frequency, rounds, close) -> Nearest:
        """Find the nearest points of as many lanes from guesses of motions and frequencies."""
        return nearest_points(
            lanes.made,
            lanes.slopes,
            target,
            depth,
            frequency,
            self.sensor,
            scale=self.scale,
            rounds=jnp.asarray(rounds),
            close=jnp.asarray(close),
        )

    def guesses(self, curve: Curve, which: int, frequency_scale: float) -> Guesses:
        """First guesses on the traced polygon."""
        drive = None if self.drive is None else self.drive[which]
        own = self.frequency[which], self.direction[which], *self._wanted(which)
        points = Points(*own, self.deviation[which], drive, self.channels[which, :, 0])
        if self.pointwise:
            return at_crossings(points, curve)
        return at_nearest_places(points, curve, self.sensor, frequency_scale * self.unit)

    def without_contact(self, values: np.ndarray, which: int) -> np.ndarray:
        """Residuals (rigs by measured numbers), point by point, of rigs without their stops."""
        away = eqx.tree_at(
            lambda path: [stop.gap for stop in path.equations.stops],
            self.lanes(values).made,
            replace_fn=lambda gap: 0 * gap + FAR_AWAY,
        )
        index = filled_up(len(values), WIDTHS[-1])
        low = np.full(len(index), self.low)
        depth = np.asarray(free_and_touching(take(away, index), low)[0])
        lane = np.repeat(np.arange(len(values)), self.points)
        frequency = np.tile(self.frequency[which], len(values))
        drive = None if self.rig_drive is None else np.tile(self.rig_drive[which], len(values))
        seen = self._observed(away, lane, depth[lane], frequency, drive)
        seen = seen.reshape(len(values), *self.channels[which].shape)
        wanted, phase = self._wanted(which)
        seen = seen_from(self.sensor, seen, phase)
        return ((wanted - seen) / self.deviation[which]).reshape(len(values), -1)

    def fitted(
        self, residual: np.ndarray, which: int, frequency_scale: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Frequency and channels of the nearest points, from their residuals (by coordinates)."""
        channels, phase = self._wanted(which)
        off = np.where(np.isfinite(self.deviation[which]), self.deviation[which], 0.0)
        channels = channels - residual[:, 1:] * off
        scale = self.unit * (HELD if self.pointwise else frequency_scale)
        frequency = self.frequency[which] - residual[:, 0] * scale
        return frequency, channels if phase is None else seen_back(self.sensor, channels, phase)

    def residuals(
        self,
        values: np.ndarray,
        which: np.ndarray,
        frequency_scale: float,
        *,
        precisely: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of all rigs (lanes by `size`) and their derivatives in the numbers.

        `values` has lanes by numbers, `which` the repetition that every lane is compared with.
        `precisely` goes on with points that would move only a little more.
        """
        lanes = self.lanes(values)
        curves = self.curves(lanes.made)
        rows, nearest = self.nearest(lanes, curves, which, frequency_scale, precisely)
        width, names = 1 + self.sensor.channels, len(self.maker.names)
        residual = np.full((len(curves) * self.points, width), LOST)
        derivative = np.zeros((*residual.shape, names))
        if nearest is not None:
            residual[rows], derivative[rows] = nearest.residual, nearest.derivative
        residual = residual.reshape(len(curves), -1)
        derivative = derivative.reshape(*residual.shape, names)
        return self._with_jumps(lanes, curves, which, residual, derivative)

    def _with_jumps(self, lanes: WithSlopes, curves: list[Curve], which, residual, derivative):
        """Leave all as it is; see `FoldMisfit`."""
        return residual, derivative
