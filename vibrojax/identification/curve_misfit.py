"""Distance of measured points from the response curves of many trial rigs at once."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.branches.continuation import Ending, Settings, begin
from vibrojax.branches.tracing import Traced, trace_branches
from vibrojax.identification.nearest_point import Nearest, Target
from vibrojax.identification.sensor import Sensor
from vibrojax.identification.trial_rigs import (
    SAMPLES,
    WIDTHS,
    Curve,
    Lanes,
    filled_up,
    find_nearest,
    free_and_touching,
    gaps_of,
    make_lanes,
    observe_points,
)
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.batches import in_batches, take
from vibrojax.steady.paths import FrequencyPath

MOST_POINTS = 300
LONGEST_STEP = 0.16
"""Along the curve: generous, since nearest points are solved for."""
MARGIN = 0.02
"""How far beyond the measured frequencies a curve is followed, relative."""
FEW_ROUNDS, MANY_ROUNDS = 4, 30
NEAR_ENOUGH, PRECISE = 1e-3, 1e-8
"""Last step to a nearest point, in a search and at its end."""
CLOSE = 0.5
"""Distance, in standard deviations, by which a polygon may mistake the nearest place."""
HELD = 1e-7
"""Frequency scale that keeps a point at its frequency."""
FAR_AWAY = 1e6
"""A gap that is never closed, m."""
LOST = 1e3
"""Residual of every point of a rig without a curve, in standard deviations."""


def _both(amplitude: np.ndarray | None, force: np.ndarray | None) -> np.ndarray:
    return np.stack([c for c in (amplitude, force) if c is not None], axis=1)


def _put(whole, at, part):
    whole = np.array(whole)
    whole[at] = part
    return whole


def sensor_of(measured: MeasuredCurve) -> Sensor:
    """Return the sensor that shows what was measured."""
    return Sensor(
        quantity=measured.quantity if measured.amplitude is not None else None,
        signal=measured.signal,
        is_ratio=measured.is_ratio,
        absolute=measured.frame == "absolute",
        with_force=measured.contact_force is not None,
    )


class CurveMisfit:
    """Misfit of a measured curve, as a function of the numbers of the user's function.

    Several repetitions of one measurement, of the same number of points, can be fitted side by
    side: every lane says which one it is compared with.
    """

    def __init__(
        self,
        make: Callable[..., AbstractSystem],
        names: tuple[str, ...],
        fixed: dict[str, float],
        static: dict[str, Any],
        repetitions: Sequence[MeasuredCurve],
        objective: str = "distance",
    ):
        first = repetitions[0]
        self.make, self.names, self.fixed, self.static = make, names, fixed, static
        self.objective = objective
        self.unit = 1.0
        """Frequency that a frequency scale refers to: the first natural one, or 1 for ratios."""
        self.sensor = sensor_of(first)
        self.is_ratio = first.frequency_name == "frequency_ratio"
        self.frequency = np.stack([m.frequency for m in repetitions])
        self.direction = np.stack([m.direction for m in repetitions])
        self.channels = np.stack([_both(m.amplitude, m.contact_force) for m in repetitions])
        noise = [m.noise() for m in repetitions]
        self.deviation = np.stack([_both(n.amplitude, n.contact_force) for n in noise])
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
    def scale(self) -> float:
        """Change of frequency that counts as much as a motion changing by its size."""
        return min(self.unit, (self.high - self.low) / 0.5)

    def lanes(self, values: np.ndarray) -> Lanes:
        """Make the trial rigs with these numbers (lanes by names)."""
        index = filled_up(len(values))
        fixed = {n: jnp.full(len(index), v) for n, v in self.fixed.items()}
        numbers = jnp.asarray(values[index])
        made = make_lanes(self.make, self.names, self.static, self.is_ratio, numbers, fixed)
        return take(Lanes(*jax.device_get(made)), slice(len(values)))

    def curves(self, paths: FrequencyPath) -> list[Curve]:
        """Follow the response curves of all rigs over the measured range."""
        lanes = paths.unit.shape[0]
        padded = take(paths, filled_up(lanes))
        ends = [np.full(padded.unit.shape[0], end) for end in (self.low, self.high)]
        free = [jax.device_get(free_and_touching(padded, end)) for end in ends]
        # A curve is begun where there is no contact yet.
        from_high = free[0][1] & ~free[1][1]
        found = self._trace(paths, free, from_high[:lanes])
        short = np.array([t.ending is not Ending.completed for t in found])
        again = np.flatnonzero(short)
        others: list[Traced | None] = [None] * lanes
        if len(again):
            other = [(depth[again], touch[again]) for depth, touch in free]
            for k, t in zip(
                again, self._trace(take(paths, again), other, ~from_high[again]), strict=True
            ):
                others[k] = t
        return self._seen(paths, found, others)

    def _trace(self, paths, free, from_high: np.ndarray) -> list[Traced]:
        lanes = len(from_high)
        ones = np.ones(lanes)
        start = np.where(from_high, self.high, self.low)
        choose = from_high[:, None, None]
        guess = np.where(choose, free[1][0][:lanes], free[0][0][:lanes])
        settings = Settings(
            start=start,
            low=self.low * ones,
            high=self.high * ones,
            direction=np.where(from_high, -1.0, 1.0),
            scale=self.scale * ones,
            tolerance=np.asarray(1e-4),
            longest=np.asarray(LONGEST_STEP),
        )
        return trace_branches(
            paths,
            settings,
            begin(guess, start),
            samples=SAMPLES,
            max_points=MOST_POINTS,
            widths=WIDTHS,
        )

    def _seen(
        self, paths: FrequencyPath, found: list[Traced], others: list[Traced | None]
    ) -> list[Curve]:
        parts = [[t for t in pair if t is not None] for pair in zip(found, others, strict=True)]
        counts = [sum(len(t.parameter) for t in part) for part in parts]
        lane = np.repeat(np.arange(len(parts)), counts)
        if not len(lane):
            nothing = np.zeros(0, bool)
            empty = np.zeros((0, self.sensor.channels))
            return [Curve(nothing, empty, nothing, nothing, False) for _ in parts]
        frequency = np.concatenate([t.parameter for part in parts for t in part])
        depth = np.concatenate([t.depth for part in parts for t in part if len(t.parameter)])
        channels = in_batches(
            lambda i: observe_points(take(paths, lane[i]), self.sensor, depth[i], frequency[i]),
            len(lane),
        )
        last = np.cumsum([len(t.parameter) for part in parts for t in part]) - 1
        continues = np.ones(len(lane), bool)
        continues[last[last >= 0]] = False
        curves = []
        for k, part in enumerate(parts):
            at = np.flatnonzero(lane == k)
            whole = bool(part) and part[0].ending is Ending.completed
            curves.append(Curve(frequency[at], channels[at], depth[at], continues[at], whole))
        return curves

    def nearest(
        self,
        lanes: Lanes,
        curves: list[Curve],
        which: np.ndarray,
        frequency_scale: float,
        precisely: bool,
    ) -> tuple[np.ndarray, Nearest | None]:
        """Find the nearest points; which rigs have a curve, and the points of those, in a row."""
        usable = np.array([c.continues.any() for c in curves])
        have = np.flatnonzero(usable)
        if not len(have):
            return usable, None
        which = np.asarray(which)
        starts = [self._guesses(curves[k], int(which[k]), frequency_scale) for k in have]
        lane = np.concatenate([np.full(len(s[0]), k) for k, s in zip(have, starts, strict=True)])
        point, depth, frequency = (np.concatenate(part) for part in zip(*starts, strict=True))
        # Like with like: a batch takes as long as its longest contact.
        order = np.argsort(np.sum(np.fft.irfft(depth, SAMPLES) > 0, axis=(1, 2)), kind="stable")
        lane, point, depth, frequency = lane[order], point[order], depth[order], frequency[order]
        row = which[lane], point
        anywhere = self.objective == "distance"
        target = Target(
            self.frequency[row],
            self.channels[row],
            np.full(len(lane), self.unit * (frequency_scale if anywhere else HELD)),
            self.deviation[row],
        )

        def find(i, rounds=FEW_ROUNDS):
            return find_nearest(
                take(lanes.paths, lane[i]),
                take(lanes.slopes, lane[i]),
                take(target, i),
                depth[i],
                frequency[i],
                self.sensor,
                scale=self.scale,
                rounds=jnp.asarray(rounds),
                close=jnp.asarray(PRECISE if precisely else NEAR_ENOUGH),
            )

        nearest = in_batches(find, len(lane))
        slow = np.flatnonzero(~nearest.settled)
        # The few that creep, next to folds; a search does without the last of their way.
        if precisely and len(slow):
            again = in_batches(lambda i: find(slow[i], MANY_ROUNDS), len(slow))
            nearest = jax.tree.map(lambda a, b: _put(a, slow, b), nearest, again)
        # Of several guesses the one that came nearest.
        row = np.searchsorted(have, lane) * self.points + point
        order = np.lexsort((np.sum(nearest.residual**2, axis=1), row))
        _, first = np.unique(row[order], return_index=True)
        return usable, take(nearest, order[first])

    def _guesses(
        self, curve: Curve, which: int, frequency_scale: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nearest places of the traced polygon: index of the measured point, motion, frequency.

        Where two places are about as near there are two guesses.
        """
        size = frequency_scale * self.unit
        start = np.flatnonzero(curve.continues)
        whole = np.concatenate([curve.frequency[:, None], curve.channels], axis=1)
        if self.objective != "distance":
            return self._branch_ends(curve, which)
        channels, deviation = self.channels[which], self.deviation[which]
        scale = np.concatenate([np.full((self.points, 1), size), deviation], axis=1)
        wanted = np.concatenate([self.frequency[which, :, None], channels], axis=1)
        # points, segments, coordinates
        from_start = (wanted[:, None] - whole[None, start]) / scale[:, None]
        along = (whole[start + 1] - whole[start])[None] / scale[:, None]
        length2 = np.sum(along**2, axis=2)
        share = np.sum(from_start * along, axis=2) / np.where(length2 > 0, length2, 1.0)
        share = np.clip(share, 0.0, 1.0)
        distance = np.sum((from_start - share[..., None] * along) ** 2, axis=2)
        rows = np.arange(len(wanted))
        best = np.argmin(distance, axis=1)
        least = distance[rows, best]
        aside = np.pad(distance, ((0, 0), (1, 1)), constant_values=np.inf)
        lowest = (distance <= aside[:, :-2]) & (distance <= aside[:, 2:])
        elsewhere = lowest & (np.abs(np.arange(len(start)) - best[:, None]) > 1)
        others = np.where(elsewhere, distance, np.inf)
        second = np.argmin(others, axis=1)
        close = np.sqrt(others[rows, second]) < 1.2 * np.sqrt(least) + CLOSE
        point = np.concatenate([rows, rows[close]])
        place = np.concatenate([best, second[close]])
        share = share[point, place]
        first = start[place]
        way = share[:, None, None]
        depth = (1 - way) * curve.depth[first] + way * curve.depth[first + 1]
        return (
            point,
            depth,
            (1 - share) * curve.frequency[first] + share * curve.frequency[first + 1],
        )

    def _branch_ends(self, curve: Curve, which: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the curve crosses the measured frequencies: as a sweep passes it.

        Upwards the first crossing along the curve, downwards the last one, which is what a settled
        sweep follows where the curve is an S; without a direction the one nearest in amplitude.
        """
        start = np.flatnonzero(curve.continues)
        at, ahead = curve.frequency[start], curve.frequency[start + 1]
        wanted = self.frequency[which, :, None]
        crosses = (wanted - at) * (wanted - ahead) <= 0
        share = np.clip((wanted - at) / np.where(ahead == at, 1.0, ahead - at), 0.0, 1.0)
        first = np.argmax(crosses, axis=1)
        last = crosses.shape[1] - 1 - np.argmax(crosses[:, ::-1], axis=1)
        seen = (1 - share) * curve.channels[start, 0] + share * curve.channels[start + 1, 0]
        off = np.where(crosses, np.abs(seen - self.channels[which, :, :1]), np.inf)
        if at[0] > ahead[-1]:  # followed from its high end
            first, last = last, first
        direction = self.direction[which]
        place = np.select([direction > 0, direction < 0], [first, last], np.argmin(off, axis=1))
        share = share[np.arange(self.points), place]
        first = start[place]
        way = share[:, None, None]
        depth = (1 - way) * curve.depth[first] + way * curve.depth[first + 1]
        return np.arange(self.points), depth, self.frequency[which]

    def without_contact(self, values: np.ndarray, which: int) -> np.ndarray:
        """Residuals (rigs by measured numbers), point by point, of rigs without their stops."""
        paths = self.lanes(values).paths
        away = eqx.tree_at(gaps_of, paths, replace_fn=lambda gap: 0 * gap + FAR_AWAY)
        index = filled_up(len(values))
        low = np.full(len(index), self.low)
        depth = np.asarray(free_and_touching(take(away, index), low)[0])
        lane = np.repeat(np.arange(len(values)), self.points)
        frequency = np.tile(self.frequency[which], len(values))
        channels = in_batches(
            lambda i: observe_points(
                take(away, lane[i]), self.sensor, depth[lane[i]], frequency[i]
            ),
            len(lane),
        )
        seen = channels.reshape(len(values), *self.channels[which].shape)
        return ((self.channels[which] - seen) / self.deviation[which]).reshape(len(values), -1)

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
        curves = self.curves(lanes.paths)
        return self._residuals(lanes, curves, which, frequency_scale, precisely)

    def _residuals(
        self,
        lanes: Lanes,
        curves: list[Curve],
        which: np.ndarray,
        frequency_scale: float,
        precisely: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        usable, nearest = self.nearest(lanes, curves, which, frequency_scale, precisely)
        rows = self.points * (1 + self.sensor.channels)
        residual = np.full((len(curves), rows), LOST)
        derivative = np.zeros((len(curves), rows, len(self.names)))
        if nearest is not None:
            some = int(usable.sum())
            residual[usable] = np.reshape(nearest.residual, (some, rows))
            derivative[usable] = np.reshape(nearest.derivative, (some, rows, -1))
        return residual, derivative
