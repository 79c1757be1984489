"""The result of a study of regimes: the kind of motion of every lane."""

import os
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import nearest
from vibrojax._tools.signatures import validated
from vibrojax.regime.dataset import dataset_of, tally
from vibrojax.regime.kinds import Regime
from vibrojax.regime.table import AbstractRegimeTable
from vibrojax.results.axes import lane_of, view_of
from vibrojax.results.saving import save_dataset

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

Array = np.ndarray


class Regimes(AbstractRegimeTable):
    """Kinds of motion over the axes of the call, the starts and the drive frequency.

    `regimes["strain_power_rms"]` is a variable by name; all have the dimensions of `dims`, the
    strobed `displacement` and `velocity` a dimension `strobe` behind them, the `spectrum` one of
    `order`, the frequency over that of the drive.
    """

    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    frequencies: Float[Array, " frequencies"]
    """Drive frequencies, in the unit of the axis."""
    axes: dict[str, Array]
    """The other axes, by name; the last is `start` where several starts were given."""
    variables: dict[str, Array]
    """Variables by name, over the dimensions `dims` (and `strobe`, `order`)."""
    orders: Float[Array, " orders"] | None
    """Frequencies of the spectrum over the drive frequency; None where there is none."""
    starts: Float[Array, "starts states"]
    """Initial states (q, q', memories) at drive phase 0."""
    ratio_units: str = eqx.field(static=True)
    """Unit of ratios: `1` for base motion, `m/N` for a force."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, settings, versions."""

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions of the lanes."""
        return (*self.axes, self.axis)

    @property
    def coordinates(self) -> dict[str, Array]:
        """Values along every dimension of the lanes."""
        return self.axes | {self.axis: np.asarray(self.frequencies)}

    @validated
    def fraction(self, kind: str) -> float:
        """Return the share of the lanes of a kind: `periodic`, `chaotic`, ...

        Raises `ValueError` for an unknown kind.
        """
        known = [r.name for r in Regime]
        if kind not in known:
            raise ValueError(f"Unknown kind {kind!r}. {nearest(str(kind), known)}")
        return float(np.mean(self.regime == Regime[kind].value))

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset with named dimensions, units and long names."""
        return dataset_of(
            self.coordinates, self.variables, self.orders, self.ratio_units, self.attributes
        )

    @validated
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the dataset to a NetCDF file, whole or not at all.

        `path` is that of the file, such as `curve.nc`; what is there is replaced. Raises
        `ValueError` for a path that cannot be a file's, `OSError` where writing fails.
        """
        save_dataset(self.to_xarray(), path)

    def plot(self, **selection: Any) -> "Figure":
        """Draw kind, period and exponent against frequency: a strip, or a map over one more axis.

        `selection` picks one value (nearest) of other axes. Raises `ValueError` for an unknown
        axis, or where more than one is left.
        """
        view = view_of(self.to_xarray(), self.axes, selection, "plot")
        from vibrojax.plot.regime import plot_regimes

        return plot_regimes(view)

    def poincare(self, **selection: Any) -> "Figure":
        """Draw the Poincaré section of a lane: displacement and velocity at every drive period.

        `selection` picks the lane; one axis may be left out, and its values are shown by
        colour. Raises `ValueError` for an unknown axis, or where more are left.
        """
        view = view_of(self.to_xarray(), self.coordinates, selection, "poincare")
        from vibrojax.plot.regime import plot_poincare

        return plot_poincare(view)

    def plot_spectrum(self, **selection: Any) -> "Figure":
        """Draw the spectrum of the displacement of one lane, picked by `selection`.

        Raises `ValueError` where the lane is not picked, or there are no spectra.
        """
        if self.orders is None:
            raise ValueError("There are no spectra: give spectrum=True to vj.regimes.")
        lane = lane_of(self.to_xarray(), self.coordinates, selection)
        from vibrojax.plot.regime import plot_order_spectrum

        return plot_order_spectrum(lane)

    def __repr__(self) -> str:
        shape = ", ".join(f"{name}: {len(v)}" for name, v in self.coordinates.items())
        periods = np.unique(self.period[self.period > 0])
        lines = [f"Regimes({shape})", f"  motions   {tally(self.regime)}"]
        if periods.size:
            lines.append(f"  periods   {', '.join(map(str, periods))}")
        exponent = self.lyapunov_exponent
        if np.isfinite(exponent).any():
            at = np.unravel_index(np.nanargmax(exponent), exponent.shape)
            where = float(np.asarray(self.frequencies)[at[-1]])
            lines.append(
                f"  largest Lyapunov exponent {exponent[at]:.4g} +- "
                f"{self.lyapunov_standard_error[at]:.2g} 1/s at {self.axis} {where:.5g}"
            )
        return "\n".join(lines)
