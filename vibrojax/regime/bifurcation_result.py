"""The result of a bifurcation diagram: motions over one parameter, in both directions."""

import os
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from vibrojax._tools.signatures import validated
from vibrojax.regime.dataset import dataset_of, tally
from vibrojax.regime.table import AbstractRegimeTable
from vibrojax.results.axes import example, lane_of, pick
from vibrojax.results.saving import save_dataset

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

Array = np.ndarray


class PeriodChange(NamedTuple):
    """Two neighbouring values between which the period changes."""

    direction: str
    low: float
    high: float
    period_low: int
    """Drive periods at the lower value; 0 where none was found."""
    period_high: int

    @property
    def is_doubling(self) -> bool:
        """Whether the one period is twice the other."""
        low, high = sorted((self.period_low, self.period_high))
        return low > 0 and high == 2 * low


class BifurcationDiagram(AbstractRegimeTable):
    """Motions over one parameter, the state carried along each direction.

    `diagram["displacement"]` is a variable by name: strobed displacements, of the dimensions
    `dims` and `strobe`; the others have the dimensions `dims`.
    """

    parameter: str = eqx.field(static=True)
    """Name of what changes: `frequency` (Hz), `frequency_ratio`, or an argument of the function."""
    values: Float[Array, " values"]
    """Values of the parameter, ascending, in its unit."""
    directions: tuple[str, ...] = eqx.field(static=True)
    """Directions followed: `forward`, `backward`."""
    axes: dict[str, Array]
    """The other axes of the call, by name."""
    variables: dict[str, Array]
    """Variables by name, over the dimensions `dims` (and `strobe`, `order`)."""
    orders: Float[Array, " orders"] | None
    """Frequencies of the spectrum over the drive frequency; None where there is none."""
    ratio_units: str = eqx.field(static=True)
    """Unit of the ratios: `1` for base motion, `m/N` for a force."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, settings, versions."""

    @property
    def coordinates(self) -> dict[str, Array]:
        """Values along every dimension of the lanes."""
        directions = {"direction": np.array(self.directions)}
        return self.axes | directions | {self.parameter: np.asarray(self.values)}

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions of the lanes."""
        return tuple(self.coordinates)

    def period_changes(self, **selection: Any) -> list[PeriodChange]:
        """Return the brackets in which the period changes, by direction and value.

        `selection` picks one value (nearest) of every other axis. Raises `ValueError` for an
        unknown axis, or where one is left.
        """
        index, _, left = pick(self.axes, selection)
        if left:
            example_of = example(self.axes, left[0])
            raise ValueError(f"Give a value of {' and '.join(left)}, such as {example_of}.")
        values, found = np.asarray(self.values), []
        for direction, period in zip(self.directions, self.period[index], strict=True):
            for k in np.flatnonzero(np.diff(period)):
                bracket = float(values[k]), float(values[k + 1])
                found.append(PeriodChange(direction, *bracket, int(period[k]), int(period[k + 1])))
        return found

    def period_doublings(self, **selection: Any) -> list[PeriodChange]:
        """Return the brackets in which the period doubles or halves; see `period_changes`.

        `selection` picks a value of each other axis, as there. Raises `ValueError` for an
        unknown axis.
        """
        return [change for change in self.period_changes(**selection) if change.is_doubling]

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
        """Draw strobed displacements and exponents against the parameter, in both directions.

        `selection` picks one value (nearest) of every other axis, or a `direction`. Raises
        `ValueError` for an unknown axis, or where one is left.
        """
        dataset = self.to_xarray()
        if (direction := selection.pop("direction", None)) is not None:
            index, _, _ = pick({"direction": np.array(self.directions)}, {"direction": direction})
            dataset = dataset.isel(direction=[*index])
        lane = lane_of(dataset, self.axes, selection)
        from vibrojax.plot.bifurcation import plot_bifurcation_diagram

        return plot_bifurcation_diagram(lane)

    def __repr__(self) -> str:
        shape = ", ".join(f"{name}: {len(v)}" for name, v in self.coordinates.items())
        lines = [f"BifurcationDiagram({shape})", f"  motions   {tally(self.regime)}"]
        if not self.axes:
            lines += [
                f"  {c.direction:9} period {c.period_low or 'none'} to {c.period_high or 'none'} "
                f"between {c.low:.6g} and {c.high:.6g}"
                for c in self.period_changes()
            ]
        return "\n".join(lines)
