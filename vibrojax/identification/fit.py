"""A fit: the numbers found, what was fitted, and the problem that was solved."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax._tools.checks import check_index, nearest
from vibrojax._tools.signatures import validated
from vibrojax.identification.problem import Measurement
from vibrojax.model.systems import AbstractSystem

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Alternative:
    """Another minimum of the misfit."""

    estimate: dict[str, float]
    reduced_chi_square: float


@dataclass(frozen=True, repr=False)
class Fit:
    """Numbers fitted to measurements. Dictionaries are by name of the number."""

    estimate: dict[str, float]
    """Best value, in the unit of the argument of the rig function."""
    interval: dict[str, tuple[float, float]]
    """Confidence intervals (95 % unless asked otherwise); one-sided where data only bound."""
    identifiability: dict[str, str]
    """`identifiable`, or what the data can and cannot say."""
    identifiable: dict[str, bool]
    """Whether the data determine the number; `identifiability` says why not."""
    standard_deviation: dict[str, float]
    """To first order; infinite for what the data do not know."""
    covariance: np.ndarray
    """In the coordinates of the search (`coordinates` says which): unknowns by unknowns."""
    correlation: np.ndarray
    """Correlation of the estimates, unknowns by unknowns."""
    chi_square: float
    """Sum of the squared residuals, each over its standard deviation."""
    degrees_of_freedom: int
    """Values measured less numbers fitted."""
    confidence: float
    """Probability of the intervals, such as 0.95."""
    measured: tuple[Measurement, ...]
    """What was fitted, in the order given."""
    predictions: "tuple[xarray.Dataset, ...]"
    """One dataset for every measurement: points, residuals and the fitted curve."""
    alternatives: tuple[Alternative, ...]
    """Other minima that were found, the best first."""
    warnings: tuple[str, ...]
    """What to know before believing the numbers, in sentences."""
    notes: tuple[str, ...]
    """What was assumed or guessed."""
    evaluations: int
    """Response curves (of all measurements) that were followed."""
    problem: Any
    """The least squares that were solved, in the coordinates of the search."""
    repetition: int
    """Number of this fit where several were fitted one by one, from 0."""
    frequency_scale: float
    """Scale of frequency differences, as a share of the first natural frequency."""
    point: np.ndarray
    """The estimate in the coordinates of the search."""
    call: dict[str, Any]
    """What `identify` was asked for besides the function and the data, by argument."""

    @property
    def names(self) -> tuple[str, ...]:
        """The numbers that were fitted."""
        return tuple(self.estimate)

    @property
    def reduced_chi_square(self) -> float:
        """Misfit per degree of freedom: about 1 where model and deviations are right."""
        return self.chi_square / self.degrees_of_freedom

    @property
    def coordinates(self) -> dict[str, str]:
        """Coordinate in which each number moved: `log`, `asinh` or `linear`."""
        return {c.name: c.kind for c in self.problem.coordinates}

    def place_of(self, name: str) -> int:
        """Place of a number among those fitted. Raises `ValueError` for an unknown `name`."""
        if name not in self.names:
            raise ValueError(f"name {name!r} was not fitted. {nearest(name, self.names)}")
        return self.names.index(name)

    @validated
    def residuals(self, direction: str | None = None, measurement: int = 0) -> np.ndarray:
        """Residuals of one measurement; of a curve, of the `forward` or `backward` sweep only.

        Shape (values of the measurement,), each over its standard deviation. Parameters:
            direction: `forward` or `backward`; None: all.
            measurement: from 0, in the order given.

        Raises `ValueError` for another direction, or a measurement that is not there.
        """
        check_index("measurement", measurement, len(self.measured))
        data, ways = self.predictions[measurement], {"forward": 1, "backward": -1}
        if direction is None:
            return data["residual"].values
        if direction not in ways or "direction" not in data:
            raise ValueError(
                f"direction must be 'forward' or 'backward', of a curve, got {direction!r}."
            )
        return data["residual"].values[data["direction"].values == ways[direction]]

    @validated
    def system(self, measurement: int = 0) -> AbstractSystem:
        """Return the fitted rig.

        With the arguments that hold for one `measurement` (from 0). Raises `ValueError` when there
        is none.
        """
        check_index("measurement", measurement, len(self.measured))
        estimate = list(self.estimate.values())
        return self.problem.system(estimate, measurement, self.measured[measurement])
