"""Time histories of several rigs, made in one go."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_count
from vibrojax._tools.signatures import validated
from vibrojax.history.cycles import Cycles, cycles_of_each
from vibrojax.history.history import History
from vibrojax.history.quantities import check_quantity, unit_and_label
from vibrojax.results.axes import axis_scale, coordinates_of, place_of
from vibrojax.results.variables import described_as, with_unit

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class Histories(eqx.Module):
    """One `History` for every combination of the axes, in the order of the call.

    `histories[i]` counts along the only axis, or through all combinations; `histories.at(force=12)`
    picks by value.
    """

    axes: dict[str, np.ndarray]
    """Values of the numbers that differ, by name; those that go together as a structured array."""
    lanes: History
    """All of them, stacked along a leading axis."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(len(values) for values in self.axes.values())

    def __len__(self) -> int:
        return self.lanes.time.shape[0]

    def __getitem__(self, index: int) -> History:
        if not -len(self) <= index < len(self):  # which also ends a loop over them
            raise IndexError(f"index {index} of {len(self)} histories.")
        return jax.tree.map(lambda a: a[index], self.lanes)

    def __iter__(self) -> Iterator[History]:
        return (self[k] for k in range(len(self)))

    @validated
    def at(self, **values: float) -> History:
        """Return the history nearest to a value of every axis.

        Raises `ValueError` for an unknown axis, or one without a value.

        `values` are numbers by name of the axes.
        """
        place = place_of(self.axes, values)
        return self[int(np.ravel_multi_index(place, self.shape)) if place else 0]

    @validated
    def cycles(
        self,
        quantity: str = "displacement",
        *,
        level: float | int = 0.0,
        threshold: float | int | None = None,
    ) -> Cycles:
        """Return the cycles of all histories together, as `History.cycles` reads them.

        Histories that diverged are left out and counted. Raises `ValueError` as that does, or where
        all of them diverged.

        `quantity`, `level` and `threshold` are those of `History.cycles`.
        """
        return cycles_of_each(self, quantity, level, threshold)

    @validated
    def plot(
        self, quantity: str = "displacement", position: ArrayLike | None = None, *, most: int = 8
    ) -> "Figure":
        """Draw a quantity of the histories against time.

        Parameters:
            quantity, position: as for `History.quantity`.
            most: how many are drawn at most, evenly chosen.

        Raises `ValueError` for an unknown quantity, or `most` below 1.
        """
        check_count("most", most)
        check_quantity(self[0].motion.equations, quantity)
        count = len(self)
        scales = [axis_scale(self.axes, name) for name in self.axes]
        lines = []
        for k in np.unique(np.linspace(0, count - 1, min(most, count)).round()).astype(int):
            history = self[int(k)]
            place = np.unravel_index(k, self.shape) if scales else ()
            words = (scale.labels[i] for scale, i in zip(scales, place, strict=True))
            values = np.asarray(history.quantity(quantity, position))
            lines.append((np.asarray(history.time), values, ", ".join(words)))
        title = f"{len(lines)} of {count} histories" if len(lines) < count else ""
        units, label = unit_and_label(quantity)
        from vibrojax.plot.history import plot_histories

        return plot_histories(lines, with_unit(label, units), title)

    def to_xarray(self) -> "xarray.Dataset":
        """Return one dataset over the axes and what `History.to_xarray` has.

        Where the times differ, `time` is a variable over `sample`.
        """
        import xarray

        each = [history.to_xarray() for history in self]
        if any((one["time"].values != each[0]["time"].values).any() for one in each):
            each = [one.drop_indexes("time").reset_coords("time") for one in each]
            each = [one.rename_dims(time="sample") for one in each]
        first, along = each[0], tuple(self.axes)

        def stacked(values: list[Any]) -> np.ndarray:
            return np.reshape(values, (*self.shape, *np.shape(values[0])))

        data: dict[Any, Any] = {
            name: ((*along, *v.dims), stacked([one[name].values for one in each]), v.attrs)
            for name, v in first.data_vars.items()
        }
        status = stacked([one.attrs["status"] for one in each])
        data["status"] = along, status, described_as("status")
        return xarray.Dataset(
            data, {**first.coords, **coordinates_of(self.axes)}, {"rig": first.attrs["rig"]}
        )

    def __repr__(self) -> str:
        axes = ", ".join(f"{name}: {len(values)}" for name, values in self.axes.items())
        return f"Histories({axes or 1}; each {self[0]!r})"
