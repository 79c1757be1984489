"""A profile likelihood: the misfit with one number held at several values."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
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
        from vibrojax.plot.identification import plot_profile

        return plot_profile(self)

    def __repr__(self) -> str:
        low, high = self.interval
        return (
            f"Profile({self.name}: {low:.5g} to {high:.5g} at {100 * self.confidence:g} %, from "
            f"{len(self.values)} values)"
        )
