"""Impacts in a record of the contact force."""

import numpy as np
from jaxtyping import Float

from vibrojax.measured.scatter import spread

LEAST_SHARE = 0.1
"""Of the largest force, above which there is contact."""
ABOVE_NOISE = 6.0
"""Standard deviations above which there is contact."""
FEWEST = 3
"""Samples of an impact; what is shorter is a spike. As many without force part two impacts."""


def windows_of_impacts(
    time: Float[np.ndarray, " samples"],
    force: Float[np.ndarray, " samples"],
    threshold: float | None,
    margin: float,
) -> list[tuple[float, float]]:
    """Return a window (s) around each impact; see `MeasuredHistory.impacts`."""
    there = np.flatnonzero(np.isfinite(force))
    time, off = time[there], force[there] - np.median(force[there])
    if threshold is None:
        threshold = max(LEAST_SHARE * float(np.abs(off).max()), ABOVE_NOISE * spread(off))
    touching = np.flatnonzero(np.abs(off) > threshold)
    parts = np.split(touching, np.flatnonzero(np.diff(touching) > FEWEST) + 1)
    parts = [part for part in parts if len(part) >= FEWEST]
    if not parts:
        return []
    begins, ends = (np.array([time[part[k]] for part in parts]) for k in (0, -1))
    reach = margin * (ends - begins)
    # Never into the next impact.
    middle = (ends[:-1] + begins[1:]) / 2
    low = np.maximum(begins - reach, np.append(time[0], middle))
    high = np.minimum(ends + reach, np.append(middle, time[-1]))
    return [(float(a), float(b)) for a, b in zip(low, high, strict=True)]
