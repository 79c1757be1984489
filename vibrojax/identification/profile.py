"""Profile likelihood: one number held at several values, the others refitted, all at once."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vibrojax._tools.checks import check_count, check_positive
from vibrojax.identification.fit import Fit
from vibrojax.identification.least_squares import LevenbergMarquardt

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Profile:
    """Misfit against one number, the others refitted; arrays over the values."""

    name: str
    values: np.ndarray
    rise: np.ndarray
    """Chi-square above its minimum (scaled down where the model does not explain the data)."""
    others: dict[str, np.ndarray]
    """The other numbers, refitted."""
    threshold: float
    """Rise at the ends of the interval."""
    interval: tuple[float, float]
    """Where the rise passes the threshold; the ends of the values where it does not."""
    confidence: float
    estimate: float

    def plot(self) -> "Figure":
        """Draw the rise of chi-square against the number."""
        from vibrojax.plot.identification import plot_profiles

        return plot_profiles([self.to_xarray()])

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over the values of the number, with the interval as attributes."""
        import xarray

        described = {"units": "SI, as the rig's argument"}
        data = {"rise": (self.name, self.rise, {"units": "1", "long_name": "Rise of chi-square"})}
        for name, values in self.others.items():
            data[name] = (self.name, values, described | {"long_name": f"{name}, refitted"})
        held = {self.name: (self.name, self.values, described | {"long_name": self.name})}
        names = ("estimate", "interval", "threshold", "confidence")
        settings = {name: getattr(self, name) for name in names}
        return xarray.Dataset(data, held, attrs=settings | {"parameter": self.name})

    def __repr__(self) -> str:
        low, high = self.interval
        return (
            f"Profile({self.name}: {low:.5g} to {high:.5g} at {100 * self.confidence:g} %, from "
            f"{len(self.values)} values)"
        )


def profile(fit: Fit, name: str, *, points: int, reach: float) -> Profile:
    """See `Identification.profile`."""
    check_count("points", points, least=5)
    check_positive("reach", reach, "standard deviations")
    held = fit.place_of(name)
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
        cost, start[:, free] = found.cost, found.point
    else:
        cost = np.sum(evaluate(start[:, free], np.arange(len(values)))[0] ** 2, axis=1)
    excess = max(1.0, fit.reduced_chi_square)
    rise = (cost - min(fit.chi_square, cost.min())) / excess
    threshold = float(scipy.stats.chi2.ppf(fit.confidence, 1))
    ends = _ends(values, rise, threshold)
    numbers = problem.numbers(start)
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

    def end(x: np.ndarray, y: np.ndarray) -> float:
        k = int(np.argmax(y > wanted))
        if not y[k] > wanted:
            return float(x[-1])
        return float(np.interp(wanted, y[k - 1 : k + 1], x[k - 1 : k + 1]))

    return end(values[best::-1], root[best::-1]), end(values[best:], root[best:])
