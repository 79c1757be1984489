"""Curves of folds: jump frequencies as functions of a second number."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from vibrojax.results.branch import Branch, axis_description

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
    contact_force: Float[np.ndarray, " points"]
    """N."""
    endings: tuple[str, str] = eqx.field(static=True)
    """Why the curve ends at its low and at its high end."""


class FoldCurves(eqx.Module):
    """All folds of a response, followed in a second number."""

    parameter: str = eqx.field(static=True)
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
                {"units": self.branch.ratio_units, "long_name": "Amplitude at the fold over drive"},
            ),
            "contact_force": (
                dims,
                padded("contact_force"),
                {"units": "N", "long_name": "Largest contact force at the fold"},
            ),
        }
        return xarray.Dataset(data, attrs=dict(self.branch.attributes))

    def plot(self) -> "Figure":
        """Draw the fold frequencies against the second number."""
        from vibrojax.results.branch_plot import plot_fold_curves

        return plot_fold_curves(self)

    def __repr__(self) -> str:
        lines = [f"FoldCurves({len(self.curves)} folds along {self.parameter})"]
        for c in self.curves:
            lines.append(
                f"  {self.parameter} {c.values[0]:.6g} to {c.values[-1]:.6g}, {self.axis} "
                f"{c.folds[0]:.6g} to {c.folds[-1]:.6g}, {len(c.values)} points"
            )
        return "\n".join(lines)
