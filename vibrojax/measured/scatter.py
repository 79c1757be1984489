"""Noise read off the scatter of neighbouring points."""

import numpy as np
from jaxtyping import Float

NORMAL = 0.6745
"""Median of |x| for a normal x of standard deviation 1."""
FEWEST_POINTS = 8
ASSUMED_LEVEL = 0.02
LOWEST_LEVEL = 0.002


def interpolation_residuals(
    x: Float[np.ndarray, " points"],
    y: Float[np.ndarray, " points"],
    neighbours: int,
) -> Float[np.ndarray, " residuals"]:
    """Return how far each point lies off the polynomial through its neighbours.

    `neighbours` (1 or 2) are taken on either side: a line or a cubic. Residuals are divided by
    sqrt(1 + sum of squared weights), so that independent noise keeps its standard deviation.
    Points whose neighbours coincide are left out.
    """
    offsets = [k for k in range(-neighbours, neighbours + 1) if k]
    count = len(x) - 2 * neighbours
    if count < 1:
        return np.zeros(0)
    middle = slice(neighbours, neighbours + count)
    around = [slice(neighbours + k, neighbours + k + count) for k in offsets]
    weights = []
    with np.errstate(divide="ignore", invalid="ignore"):
        for one in around:
            others = [other for other in around if other != one]
            parts = [(x[middle] - x[other]) / (x[one] - x[other]) for other in others]
            weights.append(np.prod(parts, axis=0))
        foretold = sum(w * y[one] for w, one in zip(weights, around, strict=True))
        residuals = (y[middle] - foretold) / np.sqrt(1 + np.sum(np.square(weights), axis=0))
    return residuals[np.isfinite(residuals)]


def spread(residuals: Float[np.ndarray, " residuals"]) -> float:
    """Return the standard deviation by the median absolute residual; NaN without residuals."""
    if not residuals.size:
        return float("nan")
    return float(np.median(np.abs(residuals))) / NORMAL
