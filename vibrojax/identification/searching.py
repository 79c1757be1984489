"""Where searches start, besides the guess."""

import numpy as np
import scipy

from vibrojax.identification.coordinates import Coordinate

FACTORS = (0.1, 0.3, 3.0, 10.0)
"""By which the stiffness is multiplied where a search ended with a poor fit."""


def restarts(point: np.ndarray, coordinates: tuple[Coordinate, ...]) -> np.ndarray:
    """Starts around one that ended badly: the stiffness (or what moves in log) multiplied."""
    moving = [k for k, c in enumerate(coordinates) if c.kind == "log"]
    stiff = [k for k in moving if "stiffness" in coordinates[k].name] or moving[:1]
    starts = np.repeat(point[None], len(FACTORS), axis=0)
    starts[:, stiff] += np.log(FACTORS)[:, None]
    return starts


def spread_starts(point: np.ndarray, coordinates: tuple[Coordinate, ...], count: int) -> np.ndarray:
    """Starts spread evenly (Halton) within the bounds, or a decade around the guess."""
    shares = scipy.stats.qmc.Halton(len(point), scramble=False).random(count + 1)[1:]
    limits = np.array([c.limits for c in coordinates])
    reach = np.array([np.log(10.0) if c.kind == "log" else 3.0 for c in coordinates])
    around = np.stack([point - reach, point + reach], axis=1)
    low, high = np.where(np.isfinite(limits), limits, around).T
    return low + shares * (high - low)
