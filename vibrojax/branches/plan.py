"""What a continuation is to do, apart from the systems it is done with."""

from typing import Any, NamedTuple

import numpy as np

from vibrojax.branches.over_range import scale_of, trace_over
from vibrojax.branches.tracing import Traced
from vibrojax.steady.paths import AbstractPath

CONVERGED = 1e-8
"""Newton correction at which a balanced point counts as found."""


class Plan(NamedTuple):
    """What a continuation is to do; the systems themselves are in its paths."""

    axis: str
    low: float
    high: float
    labels: list[dict[str, float]]
    """Values of the axes, by lane."""
    period: int
    exact: bool
    samples: int
    """Samples per drive period of the balance; 0 where motions are exact."""
    harmonics: int | None
    """Harmonics kept; None: all."""
    max_points: int
    longest_step: float
    ratio_units: str
    description: str

    @property
    def scale(self) -> float:
        """Change of the parameter that counts as much as a change of the motion by its size."""
        largest = 1.0 if self.axis == "frequency_ratio" else np.inf
        return scale_of(self.low, self.high, largest)

    def trace(
        self, paths: AbstractPath, start: np.ndarray, guess: Any = None, **others: Any
    ) -> list[Traced]:
        """Trace some lanes; upwards from free flight, or as `trace_over` says."""
        return trace_over(
            paths,
            start,
            self.low,
            self.high,
            scale=self.scale,
            guess=guess,
            tolerance=CONVERGED,
            longest=self.longest_step,
            period=self.period,
            max_points=self.max_points,
            **{"samples": self.samples, "harmonics": self.harmonics} | others,
        )
