"""First guesses of the nearest points of measured ones, on a traced curve."""

from typing import NamedTuple

import numpy as np

from vibrojax.identification.sensor import Sensor, seen_from, wrapped
from vibrojax.identification.trial_rigs import Curve

CLOSE = 0.5
"""Distance, in standard deviations, by which a polygon may mistake the nearest place."""
OFF_LEVEL = 0.01
"""Relative distance from the drive of a traced curve that counts as a standard deviation."""
Guesses = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Of nearest points: index of the measured point, motion, frequency."""


class Points(NamedTuple):
    """Measured points of one repetition."""

    frequency: np.ndarray
    direction: np.ndarray
    channels: np.ndarray
    """As they are seen from their phases."""
    phase: np.ndarray | None
    deviation: np.ndarray
    drive: np.ndarray | None
    """As it was measured; None: that of the rig."""
    size: np.ndarray
    """Their first channel, whatever their phase."""


def at_nearest_places(
    points: Points, curve: Curve, sensor: Sensor, frequency_scale: float
) -> Guesses:
    """Return the nearest places; where two are about as near there are two guesses."""
    start = np.flatnonzero(curve.continues)
    if not len(start):
        return np.zeros(0, int), curve.depth[:0], curve.frequency[:0]
    count = len(points.frequency)
    size = np.full((count, 1), frequency_scale)
    scale = np.concatenate([size, points.deviation], axis=1)[:, None]
    wanted = np.concatenate([points.frequency[:, None], points.channels], axis=1)[:, None]
    phase = None if points.phase is None else points.phase[:, None]

    def seen(at):  # points (one, where all see the same), segments, coordinates
        own = seen_from(sensor, curve.channels[None, at], phase)
        frequency = np.broadcast_to(curve.frequency[None, at, None], (*own.shape[:2], 1))
        return np.concatenate([frequency, own], axis=2)

    begin, end = seen(start), seen(start + 1)
    from_start, along = (wanted - begin) / scale, end - begin
    if sensor.with_phase and not sensor.is_complex:
        along[..., 2] = wrapped(along[..., 2])
    along = along / scale
    length2 = np.sum(along**2, axis=2)
    share = np.sum(from_start * along, axis=2) / np.where(length2 > 0, length2, 1.0)
    share = np.clip(share, 0.0, 1.0)
    distance = np.sum((from_start - share[..., None] * along) ** 2, axis=2)
    if points.drive is not None and curve.drive is not None:
        distance += (np.log(points.drive[:, None] / curve.drive[start]) / OFF_LEVEL) ** 2
    rows = np.arange(count)
    best = np.argmin(distance, axis=1)
    aside = np.pad(distance, ((0, 0), (1, 1)), constant_values=np.inf)
    lowest = (distance <= aside[:, :-2]) & (distance <= aside[:, 2:])
    elsewhere = lowest & (np.abs(np.arange(len(start)) - best[:, None]) > 1)
    others = np.where(elsewhere, distance, np.inf)
    second = np.argmin(others, axis=1)
    close = np.sqrt(others[rows, second]) < 1.2 * np.sqrt(distance[rows, best]) + CLOSE
    point = np.concatenate([rows, rows[close]])
    place = np.concatenate([best, second[close]])
    return point, *_between(curve, start[place], share[point, place])


def at_crossings(points: Points, curve: Curve) -> Guesses:
    """Return where the curve crosses the measured frequencies: as a sweep passes it.

    Upwards the first crossing along the curve, downwards the last one, which is what a settled
    sweep follows where the curve is an S; without a direction the one nearest in amplitude.
    """
    start = np.flatnonzero(curve.continues)
    if not len(start):
        return np.zeros(0, int), curve.depth[:0], curve.frequency[:0]
    at, ahead = curve.frequency[start], curve.frequency[start + 1]
    wanted = points.frequency[:, None]
    crosses = (wanted - at) * (wanted - ahead) <= 0
    share = np.clip((wanted - at) / np.where(ahead == at, 1.0, ahead - at), 0.0, 1.0)
    first = np.argmax(crosses, axis=1)
    last = crosses.shape[1] - 1 - np.argmax(crosses[:, ::-1], axis=1)
    seen = (1 - share) * curve.channels[start, 0] + share * curve.channels[start + 1, 0]
    off = np.where(crosses, np.abs(seen - points.size[:, None]), np.inf)
    if at[0] > ahead[-1]:  # followed from its high end
        first, last = last, first
    way, rows = points.direction, np.arange(len(wanted))
    place = np.select([way > 0, way < 0], [first, last], np.argmin(off, axis=1))
    depth, _ = _between(curve, start[place], share[rows, place])
    return rows, depth, points.frequency


def _between(curve: Curve, first: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motions and frequencies on segments of a curve."""
    way = share[:, None, None]
    depth = (1 - way) * curve.depth[first] + way * curve.depth[first + 1]
    return depth, (1 - share) * curve.frequency[first] + share * curve.frequency[first + 1]
