"""A profile likelihood: the misfit with one number held at several values."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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
        from vibrojax.plot.profiles import plot_profiles

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
