"""Jumps of a measured sweep: abrupt changes of its amplitude."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

_LEAST_CHANGE = np.log(1.25)
_ABOVE_MEDIAN = 4.0
_ABOVE_NEIGHBOURS = 2.0
_ABOVE_NOISE = 8.0


class Jump(NamedTuple):
    """An abrupt change of the amplitude between successive points of a sweep."""

    direction: int
    """1 in the forward, -1 in the backward sweep."""
    before: float
    """Frequency of the last point before it, in the unit of the curve."""
    after: float
    """Frequency of the first point after it."""
    change: float
    """Amplitude after over amplitude before."""
    at: int
    """Index of the point after it."""
    last: int
    """Index of the point before it."""


def jumps_along(
    at: Int[np.ndarray, " some"],
    direction: int,
    frequency: Float[np.ndarray, " points"],
    amplitude: Float[np.ndarray, " points"],
    deviation: Float[np.ndarray, " points"] | None,
) -> list[Jump]:
    """Return the jumps along a sweep, of which `at` holds the points in its order.

    See `MeasuredCurve.jumps`.
    """
    if len(at) < 2:
        return []
    size_at = amplitude[at]
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.nan_to_num(np.diff(np.log(size_at)), posinf=0.0, neginf=0.0)
    size = np.abs(change)
    strong = (size > _LEAST_CHANGE) & (size > _ABOVE_MEDIAN * np.median(size))
    if deviation is not None:
        combined = np.hypot(deviation[at[1:]], deviation[at[:-1]])
        strong &= np.abs(np.diff(size_at)) > _ABOVE_NOISE * combined
    found = []
    for sign in (1, -1):
        same = np.pad(np.maximum(sign * change, 0.0), 1)
        beside = np.maximum(same[:-2], same[2:])
        candidates = strong & (same[1:-1] > _ABOVE_NEIGHBOURS * beside)
        if candidates.any():
            k = int(np.argmax(np.where(candidates, sign * change, -np.inf)))
            last, first = (int(i) for i in at[k : k + 2])
            before, after = float(frequency[last]), float(frequency[first])
            found.append((k, Jump(direction, before, after, float(np.exp(change[k])), first, last)))
    return [jump for _, jump in sorted(found)]
