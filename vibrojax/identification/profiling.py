"""Profile likelihood: one number held, the others refitted, all values at once."""

import numpy as np
from scipy import stats

from vibrojax._tools.checks import check_count, check_positive, nearest
from vibrojax.identification.fit import Fit
from vibrojax.identification.least_squares import LevenbergMarquardt
from vibrojax.identification.profile import Profile


def index_of(fit: Fit, name: str) -> int:
    """Place of a number among those fitted. Raises `ValueError` for an unknown name."""
    if name not in fit.names:
        raise ValueError(f"name {name!r} was not fitted. {nearest(name, fit.names)}")
    return fit.names.index(name)


def profile(fit: Fit, name: str, *, points: int, reach: float) -> Profile:
    """See `Identification.profile`."""
    check_count("points", points, least=5)
    check_positive("reach", reach, "standard deviations")
    held = index_of(fit, name)
    problem, coordinate = fit.problem, fit.problem.coordinates[held]
    low, high = problem.limits
    deviation = float(np.sqrt(fit.covariance[held, held]))
    deviation = deviation if np.isfinite(deviation) and deviation > 0 else 1.0
    ways = np.linspace(-reach, reach, points) * deviation
    values = np.unique(np.clip(fit.point[held] + ways, low[held], high[held]))
    free = [k for k in range(len(fit.names)) if k != held]
    # The others start where the covariance says they go.
    slope = fit.covariance[:, held] / fit.covariance[held, held]
    slope = np.where(np.isfinite(slope), slope, 0.0)
    start = fit.point + (values - fit.point[held])[:, None] * slope
    start[:, held] = values
    which = np.full(len(values), fit.repetition)

    def evaluate(some, lanes):
        whole = start[lanes]
        whole[:, free] = some
        residual, jacobian = problem.evaluate(whole, which[lanes], fit.frequency_scale)
        return residual, jacobian[:, :, free]

    if free:
        found = LevenbergMarquardt()(evaluate, start[:, free], low[free], high[free], 1e-2)
        cost, others = found.cost, found.point
    else:
        residual, _ = evaluate(start[:, free], np.arange(len(values)))
        cost, others = np.sum(residual**2, axis=1), start[:, free]
    excess = max(1.0, fit.reduced_chi_square)
    rise = (cost - min(fit.chi_square, cost.min())) / excess
    threshold = float(stats.chi2.ppf(fit.confidence, 1))
    ends = _ends(values, rise, threshold)
    whole = start.copy()
    whole[:, free] = others
    numbers = problem.numbers(whole)
    return Profile(
        name=name,
        values=numbers[:, held],
        rise=rise,
        others={fit.names[k]: numbers[:, k] for k in free},
        threshold=threshold,
        interval=(float(coordinate.number(ends[0])), float(coordinate.number(ends[1]))),
        confidence=fit.confidence,
        estimate=fit.estimate[name],
    )


def _ends(values: np.ndarray, rise: np.ndarray, threshold: float) -> tuple[float, float]:
    """Where the rise passes the threshold, by interpolating its root, which is nearly straight."""
    best = int(np.argmin(rise))
    root, wanted = np.sqrt(np.maximum(rise, 0.0)), np.sqrt(threshold)
    ends = []
    for part in (slice(best, None, -1), slice(best, None)):
        x, y = values[part], root[part]
        above = np.flatnonzero(y > wanted)
        if not len(above):
            ends.append(float(x[-1]))
            continue
        k = above[0]
        share = (wanted - y[k - 1]) / (y[k] - y[k - 1])
        ends.append(float(x[k - 1] + share * (x[k] - x[k - 1])))
    return ends[0], ends[1]
