"""Where a sampled signal passes a level, and what else is then: cubics between the samples."""

from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import is_traced
from vibrojax.history.quantities import quantity_of
from vibrojax.history.samples import SampledMotion
from vibrojax.results.status import Status


def check_whole(history: SampledMotion, what: str) -> None:
    """Raise `ValueError` unless it is one finished history of known numbers."""
    if is_traced(history.time) or np.ndim(history.time) != 1:
        raise ValueError(
            f"{what} are those of one history outside jit and vmap, got lanes of shape "
            f"{np.shape(history.time)[:-1]}. Take one: jax.tree.map(lambda a: a[0], history)."
        )
    if int(history.status) != Status.completed.value:
        status = Status(int(history.status)).name
        raise ValueError(f"{what} cannot be read from this history: its status is {status}.")
    if history.time.size < 2:
        raise ValueError(f"{what} cannot be read from a history of one sample.")


def curve_of(history: SampledMotion, quantity: str) -> Any:
    """Return a quantity as a piecewise cubic of scipy over time (s).

    Through values and rates at the samples; where the rate may jump, without overshoot.
    """
    values, rates = quantity_of(history, quantity)
    return curve_through(
        np.asarray(history.time), np.asarray(values), None if rates is None else np.asarray(rates)
    )


def curve_through(
    time: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, " samples"],
    rates: Float[np.ndarray, " samples"] | None,
) -> Any:
    """Return the piecewise cubic of scipy through values, with their rates if there are any."""
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    if rates is None:
        return PchipInterpolator(time, values)
    return CubicHermiteSpline(time, values, rates)


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
