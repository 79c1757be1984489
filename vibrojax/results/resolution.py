"""The outcome of a resolution check."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np

from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class ResolutionCheck(eqx.Module):
    """How far every number of a result moved when it was repeated more finely."""

    values: dict[str, np.ndarray]
    """The result itself."""
    moved: dict[str, dict[str, np.ndarray]]
    """Largest absolute change of every number, by what was refined."""
    skipped: dict[str, str]
    """What was not varied, and why."""

    @property
    def relative(self) -> dict[str, dict[str, float]]:
        """Changes over the size of the numbers; NaN for one that came or went."""
        return {
            what: {
                n: float(change / np.max(np.abs(self.values[n]))) if n in self.values else np.nan
                for n, change in numbers.items()
            }
            for what, numbers in self.moved.items()
        }

    @property
    def worst(self) -> float:
        """Largest relative change of all; NaN when a number came or went."""
        changes = [c for numbers in self.relative.values() for c in numbers.values()]
        return float(np.max(changes)) if changes else 0.0

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset of the relative changes over `refinement` and `number`."""
        import xarray

        relative = self.relative
        names = list(dict.fromkeys(n for numbers in relative.values() for n in numbers))
        changes = [[numbers.get(n, np.nan) for n in names] for numbers in relative.values()]
        table = np.reshape(np.array(changes, float), (len(relative), len(names)))
        data = {
            "relative_change": (("refinement", "number"), table, described_as("relative_change"))
        }
        coordinates = {
            "refinement": ("refinement", list(relative), {"long_name": "What was refined"}),
            "number": ("number", names, {"long_name": "Number of the result"}),
        }
        return xarray.Dataset(data, coordinates, attrs={"title": "vibrojax resolution check"})

    def plot(self) -> "Figure":
        """Draw the relative change of every number, by what was refined.

        Raises `ValueError` when nothing was varied.
        """
        from vibrojax.results.resolution_plot import plot_resolution

        return plot_resolution(self)

    def __repr__(self) -> str:
        lines = ["ResolutionCheck (relative change)"]
        for what, numbers in self.relative.items():
            lines.append(f"  {what}")
            lines += [f"    {n:24s}{c:.2e}" for n, c in numbers.items()]
        lines += [f"  {what}: not varied, {why}" for what, why in self.skipped.items()]
        return "\n".join(lines)
