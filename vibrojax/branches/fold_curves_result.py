"""Curves of folds: jump frequencies as functions of a second number."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from vibrojax.branches.branch import Branch, axis_description
from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class FoldCurve(eqx.Module):
    """One fold, followed in a second number; arrays of shape (points,)."""

    values: Float[np.ndarray, " points"]
    """The second number, increasing."""
    folds: Float[np.ndarray, " points"]
    """Drive frequency of the fold, in the unit that was asked for."""
    amplitude_ratio: Float[np.ndarray, " points"]
    """Half peak-to-peak displacement at the fold over the drive amplitude."""
    contact_force: Float[np.ndarray, " points"]
    """Largest contact force at the fold, N."""
    endings: tuple[str, str] = eqx.field(static=True)
    """Why the curve ends at its low and at its high end."""
    parameter: str = eqx.field(static=True, default="parameter")
    """Name of the second number."""
    axis: str = eqx.field(static=True, default="frequency_ratio")
    """`frequency_ratio`, or `frequency` in Hz."""
    ratio_units: str = eqx.field(static=True, default="1")
    """Unit of the amplitude ratio: `1` for base motion, `m/N` for a force."""

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over `point`, with units and long names."""
        import xarray

        names = {self.parameter: "values", self.axis: "folds"}
        data = {
            name: ("point", getattr(self, field), axis_description(name))
            for name, field in names.items()
        }
        for name in ("amplitude_ratio", "contact_force"):
            described = described_as(name, self.ratio_units)
            data[name] = ("point", getattr(self, name), described)
        return xarray.Dataset(data, attrs={"title": "vibrojax fold curve"})

    def plot(self) -> "Figure":
        """Draw the frequency of the fold against the second number."""
        from vibrojax.plot.branch import plot_fold_curves

        return plot_fold_curves([self])

    def __repr__(self) -> str:
        low, high = self.values[[0, -1]]
        first, last = self.folds[[0, -1]]
        return (
            f"FoldCurve({self.parameter} {low:.6g} to {high:.6g}, {self.axis} {first:.6g} to "
            f"{last:.6g}, {len(self.values)} points)"
        )


class FoldCurves(eqx.Module):
    """All folds of a response, followed in a second number."""

    parameter: str = eqx.field(static=True)
    """Name of the second number."""
    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    curves: tuple[FoldCurve, ...]
    """In the order of the folds along the branch they start from."""
    branch: Branch
    """The branch on which they were found."""

    def __len__(self) -> int:
        return len(self.curves)

    def __getitem__(self, index: int) -> FoldCurve:
        return self.curves[index]

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over `fold` and `point`, shorter curves filled up with NaN."""
        import xarray

        length = max((len(c.values) for c in self.curves), default=0)

        def padded(name: str) -> np.ndarray:
            rows = [getattr(c, name) for c in self.curves]
            out = np.full((len(rows), length), np.nan)
            for k, row in enumerate(rows):
                out[k, : len(row)] = row
            return out

        dims = ("fold", "point")
        data: dict[str, Any] = {
            self.parameter: (dims, padded("values"), axis_description(self.parameter)),
            self.axis: (dims, padded("folds"), axis_description(self.axis)),
            "amplitude_ratio": (
                dims,
                padded("amplitude_ratio"),
                described_as("amplitude_ratio", self.branch.ratio_units),
            ),
            "contact_force": (
                dims,
                padded("contact_force"),
                described_as("contact_force"),
            ),
        }
        return xarray.Dataset(data, attrs=dict(self.branch.attributes))

    def plot(self) -> "Figure":
        """Draw the fold frequencies against the second number.

        Raises `ValueError` when there is no fold.
        """
        from vibrojax.plot.branch import plot_fold_curves

        return plot_fold_curves(self.curves)

    def __repr__(self) -> str:
        lines = [f"FoldCurves({len(self.curves)} folds along {self.parameter})"]
        for c in self.curves:
            lines.append(f"  {c!r}")
        return "\n".join(lines)
