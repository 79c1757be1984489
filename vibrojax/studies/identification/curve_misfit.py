"""Distance of measured points from the response curves of many trial rigs at once."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.measured.curve import MeasuredCurve
from vibrojax.response.condensed import balance, condensed_problem
from vibrojax.response.continuation import Ending, Settings, begin
from vibrojax.response.nearest_point import Nearest, Target, nearest_points
from vibrojax.response.paths import FrequencyPath, Place, frequency_path
from vibrojax.response.sensor import Sensor, observe
from vibrojax.response.tracing import Traced, free_motion, in_batches, take, trace_branches
from vibrojax.systems.base import AbstractSystem

SAMPLES = 128
WIDTHS = (8,)
MOST_POINTS = 300
MARGIN = 0.02
"""How far beyond the measured frequencies a curve is followed, relative."""
LOST = 1e3
"""Residual of every point of a rig without a curve, in standard deviations."""


class Curve(NamedTuple):
    """A traced curve as a sensor sees it."""

    frequency: np.ndarray
    channels: np.ndarray
    depth: np.ndarray
    breaks: np.ndarray
    """Whether the next point continues this one."""
    completed: bool


class Lanes(NamedTuple):
    """Trial rigs: their paths and the derivatives of those in the numbers sought."""

    paths: FrequencyPath
    slopes: FrequencyPath


@eqx.filter_jit
def _lanes(make, names, static, is_ratio, values, fixed):
    def one(values, fixed):
        def build(values):
            system = make(**static, **fixed, **dict(zip(names, values, strict=True)))
            return frequency_path(system, is_ratio, exact=False)

        path = build(values)
        rows = jnp.eye(len(names))
        slopes = jax.vmap(lambda row: eqx.filter_jvp(build, (values,), (row,))[1])(rows)
        fill = lambda a, b: jnp.zeros((len(names), *jnp.shape(a))) if b is None else b  # noqa: E731
        return path, jax.tree.map(fill, path, slopes)

    return jax.vmap(one)(values, fixed)


@eqx.filter_jit
def _observe(paths, sensor, depth, frequency):
    samples = 2 * (depth.shape[-1] - 1)

    def one(path, depth, frequency):
        place = Place(path.equations, path.drive, frequency * path.unit)
        w = place.angular_frequency
        problem = condensed_problem(place.equations, place.drive, w, samples=samples)
        at = balance(problem, depth, samples * w / (2 * jnp.pi), samples)
        return observe(sensor, place, problem, at.force, depth, 1)

    return jax.vmap(one)(paths, depth, frequency)


_nearest = eqx.filter_jit(nearest_points)


@eqx.filter_jit
def _free_and_touching(paths, frequency):
    depth = free_motion(paths, frequency, SAMPLES, 1)
    return depth, jnp.any(jnp.fft.irfft(depth, SAMPLES) > 0, axis=(1, 2))


class CurveMisfit:
    """Misfit of one measured curve, as a function of the numbers of the user's function."""

    def __init__(
        self,
        make: Callable[..., AbstractSystem],
        names: tuple[str, ...],
        fixed: dict[str, float],
        static: dict[str, Any],
        measured: MeasuredCurve,
    ):
        self.make, self.names, self.fixed, self.static = make, names, fixed, static
        self.measured = measured
        self.sensor = Sensor(
            quantity=measured.quantity if measured.amplitude is not None else None,
            signal=measured.signal,
            is_ratio=measured.is_ratio,
            absolute=measured.frame == "absolute",
            with_force=measured.contact_force is not None,
        )
        self.is_ratio = measured.frequency_name == "frequency_ratio"
        given = (measured.amplitude, measured.contact_force)
        self.channels = np.stack([c for c in given if c is not None], axis=1)
        self.deviation = np.ones_like(self.channels)
        self.low = float(measured.frequency.min()) * (1 - MARGIN)
        self.high = float(measured.frequency.max()) * (1 + MARGIN)
        self.unit = 1.0
        """Frequency that a relative frequency scale refers to."""

    @property
    def size(self) -> int:
        """How many residuals there are."""
        return len(self.channels) * (1 + self.sensor.channels)

    def lanes(self, values: np.ndarray) -> Lanes:
        """Make the trial rigs with these numbers (lanes by names)."""
        fixed = {n: jnp.full(len(values), v) for n, v in self.fixed.items()}
        made = _lanes(
            self.make, self.names, self.static, self.is_ratio, jnp.asarray(values), fixed
        )
        return Lanes(*jax.device_get(made))

    def curves(self, paths: FrequencyPath) -> list[Curve]:
        """Follow the response curves of all rigs over the measured range."""
        lanes = paths.unit.shape[0]
        padded = take(paths, np.minimum(np.arange(-(-lanes // 8) * 8), lanes - 1))
        ends = [np.full(padded.unit.shape[0], end) for end in (self.low, self.high)]
        free = [jax.device_get(_free_and_touching(padded, end)) for end in ends]
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
        scale = (self.high - self.low) / 0.5
        settings = Settings(
            start=start,
            low=self.low * ones,
            high=self.high * ones,
            direction=np.where(from_high, -1.0, 1.0),
            scale=self.scale * ones,
            tolerance=np.asarray(1e-4),
            longest=np.asarray(0.08),
        )
        del scale
        return trace_branches(
            paths,
            settings,
            begin(guess, start),
            samples=SAMPLES,
            max_points=MOST_POINTS,
            widths=WIDTHS,
        )

    @property
    def scale(self) -> float:
        """Change of frequency that counts as much as a motion changing by its size."""
        return min(self.unit, (self.high - self.low) / 0.5)

    def _seen(
        self, paths: FrequencyPath, found: list[Traced], others: list[Traced | None]
    ) -> list[Curve]:
        parts = [[t for t in pair if t is not None] for pair in zip(found, others, strict=True)]
        counts = [sum(len(t.parameter) for t in part) for part in parts]
        lane = np.repeat(np.arange(len(parts)), counts)
        if not len(lane):
            nothing = np.zeros(0)
            empty = np.zeros((0, self.sensor.channels))
            return [Curve(nothing, empty, nothing, nothing, False) for _ in parts]
        frequency = np.concatenate([t.parameter for part in parts for t in part])
        depth = np.concatenate([t.depth for part in parts for t in part if len(t.parameter)])
        channels = in_batches(
            lambda i: _observe(take(paths, lane[i]), self.sensor, depth[i], frequency[i]),
            len(lane),
        )
        last = np.cumsum([len(t.parameter) for part in parts for t in part]) - 1
        breaks = np.ones(len(lane), bool)
        breaks[last[last >= 0]] = False
        curves = []
        for k, part in enumerate(parts):
            at = np.flatnonzero(lane == k)
            whole = bool(part) and part[0].ending is Ending.completed
            curves.append(Curve(frequency[at], channels[at], depth[at], breaks[at], whole))
        return curves

    def nearest(
        self, lanes: Lanes, curves: list[Curve], frequency_scale: float
    ) -> tuple[np.ndarray, Nearest | None]:
        """Find the nearest points; which rigs have a curve, and the points of those, in a row."""
        usable = np.array([len(c.frequency) > 1 for c in curves])
        have = np.flatnonzero(usable)
        if not len(have):
            return usable, None
        starts = [self._guess(curves[k], frequency_scale) for k in have]
        lane = np.repeat(have, len(self.channels))
        depth = np.concatenate([s[0] for s in starts])
        frequency = np.concatenate([s[1] for s in starts])
        point = np.tile(np.arange(len(self.channels)), len(have))
        target = Target(
            self.measured.frequency,
            self.channels,
            np.full(len(self.channels), frequency_scale * self.unit),
            self.deviation,
        )

        def find(i):
            return _nearest(
                take(lanes.paths, lane[i]),
                take(lanes.slopes, lane[i]),
                Target(*(t[point[i]] for t in target)),
                depth[i],
                frequency[i],
                self.sensor,
                scale=self.scale,
                capacity=64,
            )

        return usable, in_batches(find, len(lane))

    def _guess(self, curve: Curve, frequency_scale: float) -> tuple[np.ndarray, np.ndarray]:
        """Nearest places of the traced polygon to the measured points."""
        size = frequency_scale * self.unit
        start = np.flatnonzero(curve.breaks)
        if not len(start):
            start = np.array([0])
        end = np.minimum(start + 1, len(curve.frequency) - 1)
        whole = np.concatenate([curve.frequency[:, None], curve.channels], axis=1)
        scale = np.concatenate([np.full((len(self.channels), 1), size), self.deviation], axis=1)
        wanted = np.concatenate([self.measured.frequency[:, None], self.channels], axis=1)
        # points, segments, coordinates
        from_start = (wanted[:, None] - whole[None, start]) / scale[:, None]
        along = (whole[end] - whole[start])[None] / scale[:, None]
        length2 = np.sum(along**2, axis=2)
        share = np.sum(from_start * along, axis=2) / np.where(length2 > 0, length2, 1.0)
        share = np.clip(share, 0.0, 1.0)
        distance = np.sum((from_start - share[..., None] * along) ** 2, axis=2)
        best = np.argmin(distance, axis=1)
        share = share[np.arange(len(best)), best]
        first, second = start[best], end[best]
        way = share[:, None, None]
        depth = (1 - way) * curve.depth[first] + way * curve.depth[second]
        frequency = (1 - share) * curve.frequency[first] + share * curve.frequency[second]
        return depth, frequency

    def residuals(
        self, values: np.ndarray, frequency_scale: float
    ) -> tuple[np.ndarray, np.ndarray, list[Curve]]:
        """Residuals of all rigs, their derivatives in the numbers, and the curves."""
        lanes = self.lanes(values)
        curves = self.curves(lanes.paths)
        usable, nearest = self.nearest(lanes, curves, frequency_scale)
        count = len(values)
        residual = np.full((count, self.size), LOST)
        derivative = np.zeros((count, self.size, len(self.names)))
        if nearest is not None:
            some = int(usable.sum())
            residual[usable] = np.reshape(nearest.residual, (some, -1))
            derivative[usable] = np.reshape(
                nearest.derivative, (some, self.size, len(self.names))
            )
        return residual, derivative, curves
