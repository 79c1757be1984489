"""Standard deviations of the points of a measured curve, where nobody gave them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.measured.scatter import (
    ASSUMED_LEVEL,
    FEWEST_POINTS,
    LOWEST_LEVEL,
    interpolation_residuals,
    spread,
)

_FLOOR = 0.005
"""Smallest deviation, of the median value: the foot of a resonance is not known ever better."""
_SMALLEST_FORCE = 1e-3
_LEAST_LEVER = 1e-6

Values = Float[np.ndarray, " points"]
Run = tuple[Float[np.ndarray, " points"], Int[np.ndarray, "_"]]
"""Neighbours: an abscissa of all points, and the points that follow each other on it."""


class Noise(NamedTuple):
    """Standard deviations of the points, and what was assumed to get them."""

    amplitude: Values | None
    """In the unit of the amplitude."""
    contact_force: Values | None
    """N."""
    sentence: str | None
    """None when all of them were given."""
    phase: Values | None = None
    """rad; infinite where the phase is not known."""


def lever(amplitude: Values) -> Values:
    """Return the length by which an angle moves a complex amplitude, in its unit; never 0."""
    return np.maximum(amplitude, _LEAST_LEVER * np.max(amplitude))


def relative_noise(values: Values, orders: Sequence[Sequence[Run]]) -> tuple[Values, str]:
    """Return deviations in proportion to the values, with a floor, and a sentence about them.

    `orders` are ways to say who is whose neighbour, of which the one with the least scatter counts.
    """
    positive = values[values > 0]
    if not positive.size:
        text = f"a standard deviation of {_SMALLEST_FORCE:g} N is assumed, as all forces are 0."
        return np.full(len(values), _SMALLEST_FORCE), text
    runs = [[(x, at[values[at] > 0]) for x, at in order] for order in orders]
    found = [[(x[at], np.log(values[at])) for x, at in order] for order in runs]
    level, why = _level(found, len(positive))
    text = f"a standard deviation of {100 * level:.2g} % {why}."
    return np.hypot(level * values, _FLOOR * np.median(positive)), text


def phase_noise(
    phase: Values, amplitude: Values, orders: Sequence[Sequence[Run]]
) -> tuple[Values, str]:
    """Return deviations of a phase (rad), larger where the amplitude is small, and a sentence."""
    known = np.isfinite(phase)
    runs = [[(x, at[known[at]]) for x, at in order] for order in orders]
    found = [[(x[at], np.unwrap(phase[at])) for x, at in order] for order in runs]
    level, why = _level(found, int(known.sum()))
    floor = _FLOOR * np.median(amplitude[amplitude > 0])
    text = f"a standard deviation of {level:.2g} rad {why}."
    return np.hypot(level, floor / lever(amplitude)), text


def _level(
    orders: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]], count: int
) -> tuple[float, str]:
    """Scatter of the values of runs about their neighbours, and how it was found."""
    # The cubic follows a curved response, the line a kinked one: neither reads too little.
    spreads = [
        spread(np.concatenate([interpolation_residuals(x, y, n) for x, y in runs]))
        for runs in orders
        for n in (1, 2)
    ]
    if count < FEWEST_POINTS or np.isnan(spreads).all():
        return ASSUMED_LEVEL, f"is assumed, as {count} points are too few to estimate it"
    level = max(float(np.nanmin(spreads)), LOWEST_LEVEL)
    return level, "is assumed, estimated from the scatter of neighbouring points"
