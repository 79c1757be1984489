"""Where a sampled signal passes a level, and what else is then: cubics between the samples."""

from typing import Any

import numpy as np
from jaxtyping import Float


def curve_through(time: Float[np.ndarray, " samples"], values: Any, rates: Any) -> Any:
    """Return the piecewise cubic of scipy through values and rates at times (s).

    Without overshoot where the rate is None, as of what may jump.
    """
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    if rates is None:
        return PchipInterpolator(time, np.asarray(values))
    return CubicHermiteSpline(time, np.asarray(values), np.asarray(rates))


def crossings(
    curve: Any, level: float | int, direction: str = "both"
) -> Float[np.ndarray, " crossings"]:
    """Return the times (s) at which the curve passes a level, `upwards`, `downwards` or `both`."""
    times = curve.solve(level, discontinuity=False, extrapolate=False)
    times = np.unique(times[np.isfinite(times)])  # a stretch at rest has no time
    # A crossing at a sample is found from both sides of it.
    times = times[np.diff(times, prepend=-np.inf) > 1e-9 * (curve.x[1] - curve.x[0])]
    slope = curve(times, 1)
    if direction == "both":
        return times[slope != 0]
    return times[slope > 0] if direction == "upwards" else times[slope < 0]
