"""The result of a study of basins: where starts lead to, and how large the basins are."""

import os
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax._tools.checks import check_index
from vibrojax._tools.signatures import validated
from vibrojax.results.axes import coordinates_of, example, numbers_along, pick
from vibrojax.results.saving import save_dataset
from vibrojax.results.variables import VARIABLES, described_as

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

Array = np.ndarray
LEVEL = 0.95
"""Confidence of intervals."""
OF_ATTRACTORS = (
    "share",
    "standard_error",
    "share_low",
    "share_high",
    "period",
    "cross_well",
    "mean_displacement",
    "strain_power_rms",
)


def standard_error(share: Any, count: int) -> float | Float[Array, "..."]:
    """Return the standard error of a share of `count` independent random starts.

    That of the binomial distribution, sqrt(share (1 - share)/count). Source: Menck et al. 2013,
    Nature Physics 9, 89, eq. 6.
    """
    share = np.asarray(share, float)
    return np.sqrt(share * (1 - share) / count)


def wilson_interval(share: Any, count: int) -> tuple[Any, Any]:
    """Return the 95 % interval of a share of `count` independent random starts.

    That of Wilson 1927, which is not empty where the share is 0 or 1.
    """
    from scipy.stats import norm

    share = np.asarray(share, float)
    z = norm.ppf(0.5 + LEVEL / 2)
    scale = 1 + z**2 / count
    middle = (share + z**2 / (2 * count)) / scale
    half = z / scale * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return np.clip(middle - half, 0.0, 1.0), np.clip(middle + half, 0.0, 1.0)


def boundary_share(number: Int[Array, "... rows columns"]) -> float | Float[Array, "..."]:
    """Return the share of the cells of a grid that touch, by a side, one of another basin."""
    edge = np.zeros(number.shape, bool)
    down = number[..., 1:, :] != number[..., :-1, :]
    across = number[..., :, 1:] != number[..., :, :-1]
    edge[..., 1:, :] |= down
    edge[..., :-1, :] |= down
    edge[..., :, 1:] |= across
    edge[..., :, :-1] |= across
    return edge.mean(axis=(-2, -1))


class Basins(eqx.Module):
    """Attractors and their basins, over starts that two named numbers make.

    Attractors are numbered by the share of the starts that they attract, the largest first, at
    every combination of the other axes on its own; where one has fewer attractors than another,
    what is missing has share 0 and NaN. Motions without a period are one attractor or two: those
    that go from side to side of the barrier, and those that do not.
    """

    axes: dict[str, Array]
    """The other axes of the call, by name, the frequency among them where it was a list."""
    starts: dict[str, Array]
    """The two numbers: axes of the grid, or the values of every random start."""
    sampling: str = eqx.field(static=True)
    """`grid` or `random`."""
    attractor: Int[Array, "..."]
    """Number of the attractor, from 1, of every start; 0 where it diverged. Over (axes..., first
    number, second number), or (axes..., starts)."""
    period: Int[Array, "... attractors"]
    """Drive periods; 0 for motions without a period, -1 where there is no such attractor."""
    cross_well: Bool[Array, "... attractors"]
    """Whether the response visits both sides of the barrier."""
    mean_displacement: Float[Array, "... attractors"]
    """m."""
    strain_power_rms: Float[Array, "... attractors"]
    """Rms of the rate of the strain energy, W."""
    periods_marched: Int[Array, "..."]
    """Drive periods marched with every start."""
    units: dict[str, str] = eqx.field(static=True)
    """Of the two numbers, by name; empty where they were not given."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, settings, versions."""

    @property
    def count(self) -> int:
        """How many starts there are at every combination of the axes."""
        return int(np.prod(self.attractor.shape[len(self.axes) :]))

    def _flat(self) -> Int[Array, "... starts"]:
        return self.attractor.reshape((*self.attractor.shape[: len(self.axes)], -1))

    @property
    def share(self) -> Float[Array, "... attractors"]:
        """Share of the starts that each attractor attracts."""
        number = self._flat()[..., None, :]
        wanted = np.arange(1, self.period.shape[-1] + 1)[:, None]
        return np.mean(number == wanted, axis=-1)

    @property
    def standard_error(self) -> Float[Array, "... attractors"]:
        """Standard error of the shares, as if the starts had been drawn at random.

        Exact for `random` starts. A regular grid does better than that for a basin with a smooth
        boundary; what it cannot resolve is said by `boundary_share`.
        """
        return np.asarray(standard_error(self.share, self.count))

    @property
    def interval(self) -> Float[Array, "... attractors 2"]:
        """95 % interval of the shares by Wilson's formula, on the assumption of random starts."""
        return np.stack(wilson_interval(self.share, self.count), axis=-1)

    @property
    def boundary_share(self) -> float | Float[Array, "..."]:
        """Share of the cells of the grid that touch one of another basin: what is not resolved.

        Raises `ValueError` for random starts.
        """
        if self.sampling != "grid":
            raise ValueError("Random starts have no cells: give starts='grid' to basins.")
        return boundary_share(self.attractor)

    @property
    def diverged_share(self) -> float | Float[Array, "..."]:
        """Share of the starts that diverged."""
        return np.mean(self._flat() == 0, axis=-1)[()]

    @property
    def periodic_share(self) -> float | Float[Array, "..."]:
        """Share of the starts that lead to a periodic motion."""
        return np.sum(np.where(self.period > 0, self.share, 0.0), axis=-1)[()]

    @validated
    def name_of(self, attractor: int, index: tuple[int, ...] = ()) -> str:
        """Return what an attractor is, in words; `index` is the place along the other axes.

        Attractors, from 1, that are alike in this are distinguished by their mean displacements.
        Raises `ValueError` for one that is not there.
        """
        *over, found = self.period.shape
        if len(index) != len(over):
            raise ValueError(f"index must hold {len(over)} whole numbers, got {index!r}.")
        for place, size in zip(index, over, strict=True):
            check_index("index", place, size)
        check_index("attractor", attractor, found, first=1)

        def words(k: int) -> str:
            period = int(self.period[(*index, k)])
            kind = f"period {period}" if period else "no period"
            return kind + (", crosses the barrier" if self.cross_well[(*index, k)] else "")

        own = words(attractor - 1)
        alike = sum(words(k) == own for k in range(self.period.shape[-1]))
        mean = self.mean_displacement[(*index, attractor - 1)]
        return f"{own}, mean {mean:.3g} m" if alike > 1 else own

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over the axes, the starts and `attractor_number`, with units and names.

        `attractor` is over the starts; the attractors are described over `attractor_number`.
        """
        import xarray

        outer = tuple(self.axes)
        inner = tuple(self.starts) if self.sampling == "grid" else ("start",)

        def about(name: str) -> dict[str, str]:
            units, long_name = VARIABLES[name]
            return {"units": units, "long_name": long_name}

        low, high = np.moveaxis(self.interval, -1, 0)
        values: dict[str, Any] = {"share_low": low, "share_high": high}
        data: dict[str, Any] = {
            name: (
                (*outer, "attractor_number"),
                np.asarray(values.get(name, getattr(self, name, None))),
                about(name),
            )
            for name in OF_ATTRACTORS
        }
        data["attractor"] = ((*outer, *inner), self.attractor, about("attractor"))
        marched = about("periods_marched")
        data["periods_marched"] = ((*outer, *inner), self.periods_marched, marched)
        data["diverged_share"] = (outer, np.asarray(self.diverged_share), about("diverged_share"))
        if self.sampling == "grid":
            edge = np.asarray(self.boundary_share)
            data["boundary_share"] = (outer, edge, about("boundary_share"))
        coordinates: dict[str, Any] = coordinates_of(self.axes)
        for name, axis in self.starts.items():
            dimension = name if self.sampling == "grid" else "start"
            told_of = {"units": self.units.get(name, "1"), "long_name": name.replace("_", " ")}
            coordinates[name] = (dimension, axis, told_of)
        numbers = np.arange(1, self.period.shape[-1] + 1)
        described = described_as("attractor_number")
        coordinates["attractor_number"] = ("attractor_number", numbers, described)
        return xarray.Dataset(data, coordinates, attrs=dict(self.attributes))

    @validated
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the dataset to a NetCDF file, whole or not at all.

        `path` is that of the file, such as `curve.nc`; what is there is replaced. Raises
        `ValueError` for a path that cannot be a file's, `OSError` where writing fails.
        """
        save_dataset(self.to_xarray(), path)

    def place_of(self, selection: dict[str, Any]) -> tuple[tuple[int, ...], dict[str, Any]]:
        """Return the index along the other axes nearest to a selection, and the values there.

        Raises `ValueError` for an unknown axis, or one without a value.
        """
        index, chosen, left = pick(self.axes, selection)
        for name in left:
            if len(self.axes[name]) > 1:
                about = example(self.axes, name)
                raise ValueError(f"Give a value of {name} too, such as {about}.")
        alone = {n: own[0].item() for name in left for n, own in self._along(name).items()}
        return tuple(0 if isinstance(at, slice) else at for at in index), chosen | alone

    def _along(self, name: str) -> dict[str, Array]:
        return numbers_along(name, np.asarray(self.axes[name]))

    def plot(self, **selection: Any) -> "Figure":
        """Draw the attractor of every start over the two numbers.

        `selection` picks one value (nearest) of each other axis. The legend says period and share
        of every attractor, with its standard error. Raises `ValueError` for an unknown axis, or
        one without a value.
        """
        index, _ = self.place_of(selection)
        names = [self.name_of(k, index) for k in range(1, self.period.shape[-1] + 1)]
        lane = self.to_xarray().isel(dict(zip(self.axes, index, strict=True)))
        from vibrojax.plot.basins import plot_basins

        return plot_basins(lane, list(self.starts), names)

    def __repr__(self) -> str:
        shape = [f"{name}: {len(axis)}" for name, axis in self.axes.items()]
        count = self.count
        shape += (
            [f"{name}: {len(axis)}" for name, axis in self.starts.items()]
            if self.sampling == "grid"
            else [f"{count} random starts"]
        )
        lines = [f"Basins({', '.join(shape)})"]
        if all(len(axis) == 1 for axis in self.axes.values()):
            index = (0,) * len(self.axes)
            for k, share in enumerate(self.share[index]):
                error = 100 * self.standard_error[(*index, k)]
                lines.append(
                    f"  {k + 1}: {self.name_of(k + 1, index):<48s} {100 * share:6.2f} +- "
                    f"{error:.2f} %"
                )
        diverged = float(np.mean(self.diverged_share))
        if diverged:
            lines.append(f"  diverged {100 * diverged:.2f} %")
        if self.sampling == "grid":
            edge = 100 * float(np.mean(self.boundary_share))
            lines.append(f"  cells at a boundary {edge:.2f} %")
        return "\n".join(lines)
