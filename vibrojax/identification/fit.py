"""A fit: the numbers found, what was fitted, and the problem that was solved."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from vibrojax._tools.checks import check_index
from vibrojax._tools.signatures import validated
from vibrojax.identification.fitted_data import Prediction
from vibrojax.identification.setting_up import own_name
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.history import MeasuredHistory


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
    measured: tuple[MeasuredCurve | MeasuredHistory, ...]
    """What was fitted, in the order given."""
    predictions: tuple[Prediction, ...]
    """One for every measurement."""
    influence: tuple[np.ndarray, ...]
    """By how many standard deviations each number would move without a point: points by numbers."""
    alternatives: tuple[Alternative, ...]
    """Other minima that were found, the best first."""
    warnings: tuple[str, ...]
    """What to know before believing the numbers, in sentences."""
    notes: tuple[str, ...]
    """What was assumed or guessed."""
    evaluations: int
    """Response curves (of all measurements) that were followed."""
    asked: Any
    """What `identify` was asked for; with it the rig is made again."""
    problem: Any
    """The least squares that were solved, in the coordinates of the search."""
    repetition: int
    """Number of this fit in `identify_each`, from 0."""
    frequency_scale: float
    """Scale of frequency differences, as a share of the first natural frequency."""
    point: np.ndarray
    """The estimate in the coordinates of the search."""

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

    @validated
    def residuals(self, direction: str | None = None, measurement: int = 0) -> np.ndarray:
        """Residuals of one measurement; of a curve, of the `forward` or `backward` sweep only.

        Shape (values of the measurement,), each over its standard deviation. Parameters:
            direction: `forward` or `backward`; None: all.
            measurement: from 0, in the order given.

        Raises `ValueError` for another direction, or a measurement that is not there.
        """
        check_index("measurement", measurement, len(self.measured))
        values = self.predictions[measurement].residual
        if direction is None:
            return values
        ways = {"forward": 1, "backward": -1}
        if direction not in ways:
            raise ValueError(f"direction must be 'forward' or 'backward', got {direction!r}.")
        measured: Any = self.measured[measurement]
        return values[measured.direction == ways[direction]]

    @validated
    def system(self, measurement: int = 0) -> Any:
        """Return the fitted rig.

        With the arguments that hold for one `measurement` (from 0). Raises `ValueError` when there
        is none.
        """
        check_index("measurement", measurement, len(self.measured))
        asked, measured = self.asked, self.measured[measurement]
        arguments = dict.fromkeys(asked.arguments.values())
        fitted = {n: self.estimate[own_name(asked, n, measured, measurement)] for n in arguments}
        return asked.make(**asked.numbers, **measured.parameters, **fitted)
