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
        """Changes over the size of the numbers.

        0 for a number that is 0 in both, such as the force of a motion without contact; infinite
        for one that was 0 and is not any more; NaN for one that came or went, or is not finite.
        """
        return {
            what: {n: self._relative(n, float(change)) for n, change in numbers.items()}
            for what, numbers in self.moved.items()
        }

    def _relative(self, name: str, change: float) -> float:
        if change == 0.0 or np.isnan(change):
            return change
        size = float(np.max(np.abs(self.values[name])))
        return change / size if size > 0 else np.inf

    @property
    def worst(self) -> float:
        """Largest relative change of all; NaN when a number came or went, or is not finite."""
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
        from vibrojax.plot.resolution import plot_resolution

        return plot_resolution(self)

    def __repr__(self) -> str:
        lines = ["ResolutionCheck (relative change)"]
        for what, numbers in self.relative.items():
            lines.append(f"  {what}")
            lines += [f"    {n:24s}{self._told(what, n, c)}" for n, c in numbers.items()]
        lines += [f"  {what}: not varied, {why}" for what, why in self.skipped.items()]
        return "\n".join(lines)

    def _told(self, what: str, name: str, change: float) -> str:
        if np.isinf(change):
            return f"from 0 to {float(self.moved[what][name]):.2e}"
        if np.isnan(change):
            return "nan (it came or went, or is not finite)"
        stays = change == 0.0 and not np.any(self.values[name])
        return "0 (it is 0 in both)" if stays else f"{change:.2e}"
