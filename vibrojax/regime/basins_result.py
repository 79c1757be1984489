"""The result of a study of basins: where starts lead to, and how large the basins are."""

import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from vibrojax._tools.checks import check_index
from vibrojax._tools.signatures import validated
from vibrojax.branches.branch import Branch
from vibrojax.branches.continue_response import continue_response
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.ensemble.ranges import Range
from vibrojax.history.history import History
from vibrojax.history.simulate import simulate
from vibrojax.model.systems import AbstractSystem
from vibrojax.regime.attractors import DESCRIBED
from vibrojax.results.axes import coordinates_of, place_of
from vibrojax.results.saving import AbstractSaved
from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

Array = np.ndarray
LEVEL = 0.95
"""Confidence of intervals."""
ATTRACTOR = ("attractor_number",)
SAME = 1e-3
"""Relative distance of amplitudes below which two motions are one."""


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

    share = np.asarray(share, float)
    z = scipy.stats.norm.ppf(0.5 + LEVEL / 2)
    scale = 1 + z**2 / count
    middle = (share + z**2 / (2 * count)) / scale
    half = z / scale * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return np.clip(middle - half, 0.0, 1.0), np.clip(middle + half, 0.0, 1.0)


def boundary_share(number: Int[Array, "... rows columns"]) -> float | Float[Array, "..."]:
    """Return the share of the cells of a grid that touch, by a side, one of another basin."""
    edge = np.zeros(number.shape, bool)
    for own, other in ((np.s_[..., 1:, :], np.s_[..., :-1, :]), (np.s_[..., 1:], np.s_[..., :-1])):
        differs = number[own] != number[other]
        edge[own] |= differs
        edge[other] |= differs
    return edge.mean(axis=(-2, -1))


def _passes(branch: Branch, period: int, value: float, amplitude: float) -> bool:
    """Whether a branch has a motion of this amplitude ratio at this frequency."""
    if branch.period != period or not len(branch.values):
        return False
    here = np.ravel(branch.resample([value])["amplitude_ratio"])
    return bool(np.any(np.abs(here - amplitude) < SAME * amplitude))


class Basins(AbstractSaved):
    """Attractors and their basins, over starts that two named numbers make.

    Attractors are numbered by the share of the starts that they attract, the largest first, at
    every combination of the other axes on its own; where one has fewer attractors than another,
    what is missing has share 0 and NaN. Motions without a period are one attractor or two: those
    that go from side to side of the barrier, and those that do not.
    """

    axes: dict[str, Array]
    """The other axes of the call, by name, the frequency among them where it was a list."""
    starts: dict[str, Array]
    """The two numbers: axes of the grid, or the values of every random start; empty where the
    starts are states."""
    start_states: Float[Array, "starts states"]
    """States (q, q', memories) at drive phase 0, the second number of a grid running fastest."""
    sampling: str = eqx.field(static=True)
    """`grid` or `random`."""
    attractor: Int[Array, "..."]
    """Number of the attractor, from 1, of every start; 0 where it was lost. Over (axes..., first
    number, second number), or (axes..., starts)."""
    period: Int[Array, "... attractors"]
    """Drive periods; 0 for motions without a period, -1 where there is no such attractor."""
    cross_well: Bool[Array, "... attractors"]
    """Whether the response visits both sides of the barrier."""
    mean_displacement: Float[Array, "... attractors"]
    """m."""
    strain_power_rms: Float[Array, "... attractors"]
    """Rms of the rate of the strain energy, W."""
    amplitude_ratio: Float[Array, "... attractors"]
    """Half peak-to-peak displacement over the drive amplitude."""
    contact_force: Float[Array, "... attractors"]
    """Largest contact force, N."""
    initial_state: Float[Array, "... attractors states"]
    """State of each attractor at drive phase 0; NaN where there is no such attractor."""
    periods_marched: Int[Array, "..."]
    """Drive periods marched with every start."""
    systems: AbstractSystem
    """What moves, stacked over the axes of its numbers."""
    frequency_axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    frequencies: Float[Array, " frequencies"]
    """Drive frequencies, in the unit of that axis."""
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
            raise ValueError(
                "Random starts have no cells: give both numbers of start as lists, a grid."
            )
        return boundary_share(self.attractor)

    @property
    def diverged_share(self) -> float | Float[Array, "..."]:
        """Share of the starts that were lost: diverged, or given up."""
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
        over = self.period.shape[:-1]
        if len(index) != len(over):
            raise ValueError(f"index must hold {len(over)} whole numbers, got {index!r}.")
        for place, size in zip(index, over, strict=True):
            check_index("index", place, size)
        found = int(np.sum(self.period[index] >= 0))
        check_index("attractor", attractor, found, first=1)

        def words(k: int) -> str:
            period = int(self.period[(*index, k)])
            kind = f"period {period}" if period else "no period"
            return kind + (", crosses the barrier" if self.cross_well[(*index, k)] else "")

        own = words(attractor - 1)
        alike = sum(words(k) == own for k in range(found))
        mean = self.mean_displacement[(*index, attractor - 1)]
        return f"{own}, mean {mean:.3g} m" if alike > 1 else own

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over the axes, the starts and `attractor_number`, with units and names.

        `attractor` is over the starts; the attractors are described over `attractor_number`.
        """
        import xarray

        outer, grid = tuple(self.axes), self.sampling == "grid"
        inner = (*outer, *self.starts) if grid else (*outer, "start")
        places = {
            **dict.fromkeys(("share", "standard_error", "share_low", "share_high"), ATTRACTOR),
            **dict.fromkeys(("period", *DESCRIBED), ATTRACTOR),
            "initial_state": (*ATTRACTOR, "state"),
            "diverged_share": (),
        } | ({"boundary_share": ()} if grid else {})
        low, high = np.moveaxis(self.interval, -1, 0)
        own: dict[str, Any] = {"share_low": low, "share_high": high}
        own |= {name: getattr(self, name) for name in places if name not in own}
        data: dict[str, Any] = {name: ((*outer, *dims), own[name]) for name, dims in places.items()}
        data |= {"attractor": (inner, self.attractor)}
        data |= {"periods_marched": (inner, self.periods_marched)}
        if not self.starts:
            data["start_state"] = (("start", "state"), self.start_states)
        coordinates: dict[str, Any] = coordinates_of(self.axes)
        for name, axis in self.starts.items():
            about = {"units": self.units.get(name, "1"), "long_name": name.replace("_", " ")}
            coordinates[name] = (name if grid else "start", axis, about)
        numbers = np.arange(1, self.period.shape[-1] + 1)
        coordinates[ATTRACTOR[0]] = (*ATTRACTOR, numbers, described_as(ATTRACTOR[0]))
        ratio_units = self.systems.drive.reference[1]
        described = {n: (*values, described_as(n, ratio_units)) for n, values in data.items()}
        return xarray.Dataset(described, coordinates, attrs=dict(self.attributes))

    def _system_at(self, index: tuple[int, ...]) -> tuple[AbstractSystem, float]:
        """Return what moves at a place along the axes, and its drive frequency."""
        over = [len(axis) for name, axis in self.axes.items() if name != self.frequency_axis]
        place = dict(zip(self.axes, index, strict=True))
        value = float(self.frequencies[place.pop(self.frequency_axis, 0)])
        lane = int(np.ravel_multi_index(tuple(place.values()), over)) if over else 0
        return jax.tree.map(lambda a: a[lane], self.systems), value

    def _drawn(self, index: tuple[int, ...], count: int) -> tuple["xarray.Dataset", list[str]]:
        """Return the dataset at a place along the axes, and the names of its attractors."""
        lane = self.to_xarray().isel(dict(zip(self.axes, index, strict=True)))
        return lane, [self.name_of(k, index) for k in range(1, count + 1)]

    @validated
    def history(
        self, attractor: int = 1, *, samples_per_period: int = 256, **selection: Any
    ) -> History:
        """Return an attractor over its period (one drive period where it has none).

        Parameters:
            attractor: its number, from 1.
            samples_per_period: samples per drive period.
            selection: a value (nearest) of each other axis.

        Raises `ValueError` for an attractor that is not there, an unknown axis, or one without a
        value.
        """
        index = place_of(self.axes, selection)
        period = self.period[index]
        check_index("attractor", attractor, int(np.sum(period >= 0)), first=1)
        system, value = self._system_at(index)
        at: dict[str, Any] = {self.frequency_axis: value}
        return simulate(
            system,
            **at,
            periods=max(int(period[attractor - 1]), 1),
            samples_per_period=samples_per_period,
            initial_state=self.initial_state[(*index, attractor - 1)],
        )

    @validated
    def branches(
        self, over: Range, *, settings: ContinuationSettings | None = None, **selection: Any
    ) -> list[Branch]:
        """Follow every periodic attractor along the drive frequency, both ways.

        Motions on a branch that another one gave already are not followed again, so isolated
        branches are what comes besides the first.

        Parameters:
            over: lowest and highest frequency, in the unit of the frequency axis.
            settings: `vj.ContinuationSettings(...)`; the period is that of the attractor.
            selection: a value (nearest) of each other axis.

        Raises `ValueError` for an unknown axis, or one without a value.
        """
        index = place_of(self.axes, selection)
        system, value = self._system_at(index)
        along: dict[str, Any] = {self.frequency_axis: over}
        found: list[Branch] = []
        for k in np.flatnonzero(self.period[index] > 0):
            period, amplitude = int(self.period[index][k]), self.amplitude_ratio[(*index, k)]
            if any(_passes(branch, period, value, amplitude) for branch in found):
                continue
            own = dataclasses.replace(settings or ContinuationSettings(), period=period)
            start = (self.initial_state[(*index, k)], value)
            branch = continue_response(system, **along, start=start, settings=own)
            assert isinstance(branch, Branch)
            found.append(branch)
        return found

    def plot_orbits(self, **selection: Any) -> "Figure":
        """Draw every attractor in the plane of displacement (mm) and velocity (m/s).

        `selection` picks one value (nearest) of each other axis; dots mark the drive phase 0.
        Raises `ValueError` for an unknown axis, one without a value, or without an attractor.
        """
        index = place_of(self.axes, selection)
        count = int(np.sum(self.period[index] >= 0))
        if not count:
            raise ValueError("No start reached an attractor: there is nothing to draw.")
        histories = [self.history(k + 1, **selection) for k in range(count)]
        orbits = [(np.asarray(h.displacement()), np.asarray(h.velocity())) for h in histories]
        lane, names = self._drawn(index, count)
        from vibrojax.plot.regime import plot_orbits

        return plot_orbits(lane, orbits, names, 256)

    def plot(self, **selection: Any) -> "Figure":
        """Draw the attractor of every start over the two numbers.

        `selection` picks one value (nearest) of each other axis. The legend says period and share
        of every attractor, with its standard error. Raises `ValueError` for an unknown axis, or
        one without a value, or starts that no two numbers make (see `plot_orbits`).
        """
        if not self.starts:
            raise ValueError("The starts are states, not two numbers: use plot_orbits().")
        index = place_of(self.axes, selection)
        lane, names = self._drawn(index, int(np.sum(self.period[index] >= 0)))
        from vibrojax.plot.regime import plot_basins

        return plot_basins(lane, list(self.starts), names)

    def __repr__(self) -> str:
        shape = [f"{name}: {len(axis)}" for name, axis in self.axes.items()]
        if self.sampling == "grid":
            shape += [f"{name}: {len(axis)}" for name, axis in self.starts.items()]
        else:
            shape += [f"{self.count} random starts"]
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
