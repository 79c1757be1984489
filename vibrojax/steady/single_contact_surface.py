"""The gap ratio of single contacts over contact time and frequency: its folds and level sets."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from contourpy import contour_generator
from jaxtyping import Array, Bool, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.model.drives import AbstractDrive
from vibrojax.steady.batches import in_batches
from vibrojax.steady.single_contact import (
    multipliers,
    read_single_contact,
    single_contact,
    unit_tables,
)
from vibrojax.stepping.contact_phases import ContactPhases, can_resonate

BATCH = 256
"""Motions at once: what is looked at of each takes some 25 kB."""
ACCURATE = 1e-10
"""Largest relative last step to a fold."""
ITERATIONS = 9
"""Of Newton's method to a fold, from the middle of a cell."""
CORRECTIONS = 3
"""Newton steps from an interpolated level set to the true one."""
LONGEST = 0.02
"""Longest straight piece of a level set, over the size of the picture."""
HALVINGS = 5
"""Rounds in which longer pieces are halved."""

# Derivatives by differences of fourth order, in the same batch as the residual: a further
# derivative would take three times as long to compile.
STEPS = np.array([0.0, -2.0, -1.0, 1.0, 2.0])
WEIGHTS = np.array([0.0, 1.0, -8.0, 8.0, -1.0]) / 12
WIDTH = np.array([2e-4, 1e-5])
"""Relative steps in contact fraction and frequency."""


class Points(NamedTuple):
    """What is known of some motions, per unit of drive amplitude."""

    gap_ratio: Float[AnyArray, "..."]
    slope: Float[AnyArray, "... 2"]
    """Derivatives of the gap ratio in contact fraction and frequency."""
    multiplier: Float[AnyArray, "..."]
    """Largest modulus of the Floquet multipliers."""
    amplitude: Float[AnyArray, "..."]
    """Half peak-to-peak displacement."""
    peak: Float[AnyArray, "..."]
    force: Float[AnyArray, "..."]
    valid: Bool[AnyArray, "..."]


class Level(NamedTuple):
    """Lines end to end, with a place that is not drawn between them."""

    frequency: Float[np.ndarray, " places"]
    amplitude_ratio: Float[np.ndarray, " places"]
    stable: Bool[np.ndarray, " places"]
    drawn: Bool[np.ndarray, " places"]


def _with_slope(phases, drive, place: Float[Array, "2"], resonant: bool):
    """Slope of the gap ratio at a place, and the motion there."""

    def gap_of(place):
        tables = unit_tables(phases, drive, place[1], resonant=resonant)
        found = single_contact(tables, place[0])
        return found.gap_ratio, found

    return jax.jacfwd(gap_of, has_aux=True)(place)


@compiled
def _gaps(phases, drive, places: Float[Array, "motions 2"], resonant: bool):
    """Gap ratio and its slope alone, which a search asks for many times."""

    def one(place):
        slope, found = _with_slope(phases, drive, place, resonant)
        return found.gap_ratio, slope

    return jax.vmap(one)(places)


@compiled
def _points(phases, drive, places: Float[Array, "motions 2"], resonant: bool) -> Points:
    def one(place):
        slope, found = _with_slope(phases, drive, place, resonant)
        tables = unit_tables(phases, drive, place[1], resonant=resonant)
        reading, valid = read_single_contact(tables, found)
        return Points(
            gap_ratio=found.gap_ratio,
            slope=slope,
            multiplier=jnp.max(jnp.abs(multipliers(tables, place[0]))),
            amplitude=(reading.highest - reading.lowest) / 2,
            peak=jnp.maximum(reading.highest, -reading.lowest),
            force=reading.contact_force,
            valid=valid,
        )

    return jax.vmap(one)(places)


def _at(function: Any, phases: ContactPhases, drive: AbstractDrive, places: np.ndarray) -> Any:
    """Evaluate a function of places in batches, of any shape."""
    flat, resonant = places.reshape(-1, 2), can_resonate(phases)
    found = in_batches(lambda i: function(phases, drive, flat[i], resonant), len(flat), BATCH)
    return jax.tree.map(lambda a: a.reshape(places.shape[:-1] + a.shape[1:]), found)


def evaluate(
    phases: ContactPhases, drive: AbstractDrive, places: Float[np.ndarray, "*many 2"]
) -> Points:
    """Evaluate motions at places (contact fraction, angular frequency), of any shape.

    `phases` as of `unit_phases`.
    """
    return _at(_points, phases, drive, places)


@compiled
def _gap_and_slope(phases, drive, fractions, angular_frequency, resonant: bool):
    """Gap ratio and its derivative in the contact fraction, ten times faster than `evaluate`."""

    def column(w):
        tables = unit_tables(phases, drive, w, resonant=resonant)
        gap = lambda f: single_contact(tables, f).gap_ratio  # noqa: E731
        return jax.vmap(lambda f: jax.jvp(gap, (f,), (jnp.ones_like(f),)))(fractions)

    return jax.vmap(column, out_axes=1)(angular_frequency)


def _finer(axis: Float[np.ndarray, " coarse"], times: int) -> Float[np.ndarray, " fine"]:
    """Split every interval into so many."""
    count = len(axis)
    return np.interp(np.arange(times * (count - 1) + 1) / times, np.arange(count), axis)


class GapSurface:
    """The gap ratio on a grid fine enough for the ridge of the resonance.

    `fractions` and `frequencies` are those of a coarser grid, `unit` leads from a frequency to
    rad/s, `touch` is the gap ratio at which the motion without contact just touches. Places are
    (contact fraction, frequency).
    """

    def __init__(
        self,
        phases: ContactPhases,
        drive: AbstractDrive,
        unit: float,
        fractions: Float[np.ndarray, " fractions"],
        frequencies: Float[np.ndarray, " frequencies"],
        touch: Float[np.ndarray, " frequencies"],
    ):
        self.phases, self.drive, self.unit = phases, drive, unit
        self.fractions, self.frequencies = _finer(fractions, 4), _finer(frequencies, 2)
        self.least = self.fractions[0]
        self.touch, self.largest = np.interp(self.frequencies, frequencies, touch), np.max(touch)
        place = jnp.asarray(self.fractions), jnp.asarray(self.frequencies * unit)
        found = _gap_and_slope(phases, drive, *place, can_resonate(phases))
        self.gap_ratio, self.slope = map(np.asarray, found)
        # The touch is the first row of a picture.
        self.heights = np.append(0.0, self.fractions)

    @property
    def cell(self) -> np.ndarray:
        """Size of a cell."""
        return np.array([np.diff(self.heights).mean(), np.diff(self.frequencies).mean()])

    def evaluate(self, places: Float[np.ndarray, "*many 2"]) -> Points:
        """Evaluate motions at places."""
        unit = np.array([1.0, self.unit])
        points = evaluate(self.phases, self.drive, places * unit)
        return points._replace(slope=points.slope * unit)

    def gaps(self, places: Float[np.ndarray, "*many 2"]) -> tuple[np.ndarray, np.ndarray]:
        """Gap ratios at places, and their slopes."""
        unit = np.array([1.0, self.unit])
        gap_ratio, slope = _at(_gaps, self.phases, self.drive, places * unit)
        return gap_ratio, slope * unit

    def folds(self, gap: float) -> Float[np.ndarray, " folds"]:
        """Return the frequencies of the folds at a gap ratio, increasing, to `ACCURATE`."""
        i, j = self._cells_with_folds(gap)
        if not len(i):
            return np.zeros(0)
        axes = (self.fractions, i), (self.frequencies, j)
        place = np.stack([(axis[k] + axis[k + 1]) / 2 for axis, k in axes], axis=-1)
        step = np.full_like(place, np.inf)
        around = 1 + (STEPS[:, None, None] * np.diag(WIDTH))[:, :, None]
        for _ in range(ITERATIONS):
            gap_ratio, slope = self.gaps(place * around)
            values = np.stack([gap_ratio - gap, slope[..., 0]], axis=-1)
            matrix = np.einsum("k,kp...c->...cp", WEIGHTS, values) / (place * WIDTH)[:, None]
            step = np.asarray(jnp.linalg.solve(matrix, -values[0, 0][..., None]))[..., 0]
            # Where the surface bends the other way a step can lead far off.
            length = np.max(np.abs(step) / (place * [0.3, 0.03]), axis=-1, keepdims=True)
            step = np.nan_to_num(step / np.maximum(length, 1.0))
            place = place + step
        good = np.max(np.abs(step / place), axis=-1) < ACCURATE
        good &= self.evaluate(place).valid
        for (axis, k), value in zip(axes, place.T, strict=True):  # in its cell or beside it
            low, high = axis[np.maximum(k - 1, 0)], axis[np.minimum(k + 2, len(axis) - 1)]
            good &= (low <= value) & (value <= high)
        found = np.sort(place[good, 1])
        return found[np.diff(found, prepend=-np.inf) > 1e-8 * found]

    def _cells_with_folds(self, gap: float) -> tuple[np.ndarray, ...]:
        """Cells in which slope and distance from the level may both be zero."""

        def corners(values):
            return np.stack([values[:-1, :-1], values[1:, :-1], values[:-1, 1:], values[1:, 1:]])

        slope, level = corners(self.slope), corners(self.gap_ratio)
        turns = (slope.min(axis=0) <= 0) & (slope.max(axis=0) >= 0)
        # Between corners the ratio goes beyond them by no more than this.
        margin = np.abs(slope).max(axis=0) * np.diff(self.fractions)[:, None]
        reached = (level.min(axis=0) - margin <= gap) & (gap <= level.max(axis=0) + margin)
        return np.nonzero(turns & reached)

    def _lines(self, first, values, level: float) -> tuple[np.ndarray, np.ndarray]:
        """Return places of a level, between two lines one that is not good, and which are good."""
        surface = np.ma.masked_invalid(np.concatenate([first[None], values]))
        places = [np.full((1, 2), np.nan)]
        for line in contour_generator(self.frequencies, self.heights, surface).lines(level):
            places += [np.asarray(line)[:, ::-1], np.full((1, 2), np.nan)]
        whole = np.concatenate(places)
        good = np.asarray(np.isfinite(whole).all(axis=1))
        least = 1e-2 * self.least, self.frequencies[0]
        return good, np.maximum(np.where(good[:, None], whole, least), least)

    def _curve(self, places: np.ndarray, good: np.ndarray, points: Points) -> Level:
        x = places[:, 1]
        drawn = good & (self.frequencies[0] <= x) & (x <= self.frequencies[-1]) & points.valid
        return Level(x, np.asarray(points.amplitude), np.asarray(points.multiplier < 1), drawn)

    def level(self, level: float) -> Level:
        """Return the level set of the gap ratio, corrected to where it truly is."""
        good, places = self._lines(self.touch, self.gap_ratio, level)
        places, on_level, points = self._corrected(places, level)
        # What stays between two lines is not drawn, so that they are not joined.
        kept = on_level | ~good
        places, good = places[kept], good[kept]
        points = Points(*(a[kept] for a in points))
        top = np.max(points.amplitude, initial=0.0, where=good)
        reach = np.array([np.ptp(self.frequencies), top])
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
            points = jax.tree.map(lambda a, b, k=at + 1: np.insert(a, k, b, axis=0), points, more)
        return self._curve(places, good, points)

    def _corrected(self, places, level: float) -> tuple[np.ndarray, np.ndarray, Points]:
        """Take Newton steps to the level, the short way in units of cells; say which got there."""
        for _ in range(CORRECTIONS):
            gap_ratio, slope = self.gaps(places)
            slope = slope * self.cell
            step = (level - gap_ratio)[:, None] * slope
            step = np.nan_to_num(step / np.sum(slope**2, axis=1, keepdims=True)) * self.cell
            places = np.maximum(places + np.clip(step, -self.cell, self.cell), 1e-3 * self.least)
        points = self.evaluate(places)
        size = level if level > 0 else self.largest
        return places, np.abs(points.gap_ratio - level) < 1e-4 * size, points

    def all_folds(self) -> Level:
        """Return where the gap ratio does not change with the contact fraction, at any gap."""
        good, places = self._lines(self.slope[0], self.slope, 0.0)
        height, move = self.cell[0], np.zeros(len(places))
        for _ in range(CORRECTIONS):
            step = 1e-3 * places[:, 0]
            sides = [places + np.stack([k * step, 0 * step], axis=1) for k in (-1.0, 1.0)]
            low, high = (self.gaps(side)[1][:, 0] for side in sides)
            move = np.nan_to_num(-(low + high) * step / np.where(high == low, np.inf, high - low))
            moved = places[:, 0] + np.clip(move, -height, height)
            places = np.stack([np.maximum(moved, 1e-2 * self.least), places[:, 1]], axis=1)
        good &= np.abs(move) < 0.1 * height
        return self._curve(places, good, self.evaluate(places))
