"""Level sets of the gap ratio of single contacts, and their folds, as a picture draws them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from contourpy import contour_generator
from jaxtyping import Bool, Float

from vibrojax.steady.single_contact_points import Points, Surface

CORRECTIONS = 3
"""Newton steps from an interpolated level set to the true one."""
LONGEST = 0.02
"""Longest straight piece of a level set, over the size of the picture."""
HALVINGS = 5
"""Rounds in which longer pieces are halved."""


class Level(NamedTuple):
    """Lines end to end, with a place that is not drawn between them."""

    frequency: Float[np.ndarray, " places"]
    amplitude_ratio: Float[np.ndarray, " places"]
    stable: Bool[np.ndarray, " places"]
    drawn: Bool[np.ndarray, " places"]


class Levels:
    """The gap ratio over (contact fraction, frequency), the touch as its first row.

    `evaluate` returns motions at places (contact fraction, frequency).
    """

    def __init__(
        self,
        frequencies: Float[np.ndarray, " coarse"],
        touch: Float[np.ndarray, " coarse"],
        surface: Surface,
        evaluate: Callable[[Float[np.ndarray, "places 2"]], Points],
    ):
        self.surface, self.evaluate = surface, evaluate
        self.x, self.y = surface.frequencies, np.append(0.0, surface.fractions)
        self.touch, self.largest = np.interp(self.x, frequencies, touch), np.max(touch)

    def _lines(self, first, values, level: float) -> np.ndarray:
        """Return places (contact fraction, frequency) of a level, a NaN between lines."""
        surface = np.ma.masked_invalid(np.concatenate([first[None], values]))
        places = [np.full((1, 2), np.nan)]
        for line in contour_generator(self.x, self.y, surface).lines(level):
            places += [np.asarray(line)[:, ::-1], np.full((1, 2), np.nan)]
        return np.concatenate(places)

    def _curve(self, places: np.ndarray, good: np.ndarray, points: Points) -> Level:
        inside = (self.x[0] <= places[:, 1]) & (places[:, 1] <= self.x[-1])
        drawn = good & inside & np.asarray(points.valid)
        return Level(
            places[:, 1], np.asarray(points.amplitude), np.asarray(points.multiplier) < 1, drawn
        )

    def _filled(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        good = np.asarray(np.isfinite(places).all(axis=1))
        least = 1e-2 * self.y[1], self.x[0]
        return good, np.maximum(np.where(good[:, None], places, least), least)

    def level(self, level: float) -> Level:
        """Return the level set of the gap ratio, corrected to where it truly is."""
        good, places = self._filled(self._lines(self.touch, self.surface.gap_ratio, level))
        places, on_level, points = self._corrected(places, level)
        # What stays between two lines is not drawn, so that they are not joined.
        kept = on_level | ~good
        places, good = places[kept], good[kept]
        points = Points(*(np.asarray(a)[kept] for a in points))
        reach = np.array([np.ptp(self.x), np.max(points.amplitude, initial=0.0, where=good)])
        reach = np.where(reach > 0, reach, 1.0)  # 0 where no motion of this level is there
        for _ in range(HALVINGS):
            shown = np.stack([places[:, 1], points.amplitude], axis=1) / reach
            far = np.linalg.norm(np.diff(shown, axis=0), axis=1) > LONGEST
            (at,) = np.nonzero(far & good[1:] & good[:-1])
            if not at.size:
                break
            between, on_level, more = self._corrected((places[at] + places[at + 1]) / 2, level)
            places = np.insert(places, at + 1, between, axis=0)
            good = np.insert(good, at + 1, on_level)
            points = Points(
                *(np.insert(a, at + 1, b, axis=0) for a, b in zip(points, more, strict=True))
            )
        return self._curve(places, good, points)

    def _corrected(self, places, level: float) -> tuple[np.ndarray, np.ndarray, Points]:
        """Take Newton steps to the level, the short way in units of cells; say which got there."""
        cell = np.array([np.diff(self.y).mean(), np.diff(self.x).mean()])
        for _ in range(CORRECTIONS):
            points = self.evaluate(places)
            slope = points.slope * cell
            step = (level - points.gap_ratio)[:, None] * slope
            step = np.nan_to_num(step / np.sum(slope**2, axis=1, keepdims=True)) * cell
            places = np.maximum(places + np.clip(step, -cell, cell), 1e-3 * self.y[1])
        points = self.evaluate(places)
        size = level if level > 0 else self.largest
        return places, np.abs(points.gap_ratio - level) < 1e-4 * size, points

    def folds(self) -> Level:
        """Return where the gap ratio does not change with the contact fraction, at any gap."""
        slope = self.surface.slope
        good, places = self._filled(self._lines(slope[0], slope, 0.0))
        height, move = np.diff(self.y).mean(), np.zeros(len(places))
        for _ in range(CORRECTIONS):
            step = 1e-3 * places[:, 0]
            sides = [places + np.stack([k * step, 0 * step], axis=1) for k in (-1.0, 1.0)]
            low, high = (self.evaluate(side).slope[:, 0] for side in sides)
            move = np.nan_to_num(-(low + high) * step / np.where(high == low, np.inf, high - low))
            moved = places[:, 0] + np.clip(move, -height, height)
            places = np.stack([np.maximum(moved, 1e-2 * self.y[1]), places[:, 1]], axis=1)
        points = self.evaluate(places)
        good &= np.abs(move) < 0.1 * height
        return self._curve(places, good, points)
