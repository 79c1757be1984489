"""The result of `single_contact_response`: the response for every gap and amplitude at once."""

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from vibrojax._tools.checks import check_range
from vibrojax._tools.signatures import validated
from vibrojax.model.equations import LinearEquations
from vibrojax.model.systems import AbstractSystem, as_arrays, equations_of
from vibrojax.results.saving import save_dataset
from vibrojax.results.variables import described_as
from vibrojax.steady.single_contact import unit_phases
from vibrojax.steady.single_contact_folds import newton_step, places_around
from vibrojax.steady.single_contact_points import Points, Surface, evaluate, gap_surface

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

Array = np.ndarray
SURFACES = (
    "gap_ratio",
    "amplitude_ratio",
    "peak_ratio",
    "contact_force",
    "leading_multiplier",
    "stable",
    "valid",
)
EDGES = ("touch_gap_ratio", "contact_free_amplitude_ratio")
ACCURATE = 1e-10
"""Largest relative last step to a fold."""
ITERATIONS = 9
"""Of Newton's method to a fold, from the middle of a cell."""


class SingleContactResponse(eqx.Module):
    """Motions with one contact per drive period, shape (contact fractions, frequencies).

    The level set of `gap_ratio` at gap over drive amplitude is the response of a system, unstable
    branches included. Ratios are over the drive amplitude; displacements are those that a sweep
    reports. Sizes are NaN where there is no such motion (`valid`).
    """

    system: AbstractSystem
    """What moves."""
    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    frequencies: Float[Array, " frequencies"]
    """Drive frequencies, ascending, in the unit of the axis."""
    contact_fraction: Float[Array, " fractions"]
    """Share of the drive period in contact."""
    ratio_units: str = eqx.field(static=True)
    """Unit of the ratios: `1` for base motion, `m/N` for a force."""
    natural_frequency: float
    """First natural frequency of the unstopped system, Hz."""
    gap_ratio: Float[Array, "fractions frequencies"]
    """Gap over drive amplitude at which this is the motion, also where it is not `valid`."""
    gap_ratio_slope: Float[Array, "fractions frequencies"]
    """Its derivative in the contact fraction; zero at folds."""
    amplitude_ratio: Float[Array, "fractions frequencies"]
    """Half peak-to-peak displacement over drive amplitude."""
    peak_ratio: Float[Array, "fractions frequencies"]
    """Largest displacement, either side, over drive amplitude."""
    contact_force: Float[Array, "fractions frequencies"]
    """Largest contact force at the drive amplitude of the system, N."""
    leading_multiplier: Float[Array, "fractions frequencies"]
    """Largest modulus of the Floquet multipliers."""
    stable: Bool[Array, "fractions frequencies"]
    """Whether the motion exists and is stable."""
    valid: Bool[Array, "fractions frequencies"]
    """Whether the motion exists: it touches once, stays in until it leaves, at a gap of 0 or
    more."""
    touch_gap_ratio: Float[Array, " frequencies"]
    """Gap ratio at which the motion without contact just touches: the limit of short contacts."""
    contact_free_amplitude_ratio: Float[Array, " frequencies"]
    """Amplitude ratio of the motion without contact."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, versions."""

    @property
    def own_gap_ratio(self) -> float:
        """Gap over drive amplitude of the system itself."""
        equations = _equations(self.system)
        reference, _ = self.system.drive.reference
        return float(np.asarray(equations.stops[0].gap)) / float(np.asarray(reference))

    @validated
    def folds(self, gap_ratio: float | None = None) -> Float[Array, " folds"]:
        """Return the frequencies of the folds at a gap ratio (the system's own by default).

        In the unit of the axis, increasing. They are looked for in every cell of a finer grid and
        refined to 1e-10; those where the motion is virtual are left out.
        Raises `ValueError` for a negative gap ratio.

        `gap_ratio` is gap over drive amplitude, in the unit of the gap ratios.
        """
        gap = self._gap_ratio(gap_ratio)
        surface = self._surface()
        cells = _cells_with_folds(surface, gap)
        if not len(cells):
            return np.zeros(0)
        place = np.array(
            [
                (surface.fractions[i : i + 2].mean(), surface.frequencies[j : j + 2].mean())
                for i, j in cells
            ]
        )
        step = np.full_like(place, np.inf)
        for _ in range(ITERATIONS):
            near = np.asarray(places_around(place))
            points = self._evaluate(near)
            values = np.stack([points.gap_ratio - gap, points.slope[..., 0]], axis=-1)
            step = np.nan_to_num(newton_step(place, values)[0])
            place = place + step
        close = np.max(np.abs(step / place), axis=-1) < ACCURATE
        close &= np.asarray(self._evaluate(place).valid)
        found = np.sort(
            [
                frequency
                for (i, j), (fraction, frequency), good in zip(cells, place, close, strict=True)
                if good
                and _around(surface.fractions, i, fraction)
                and _around(surface.frequencies, j, frequency)
            ]
        )
        return found[np.append(True, np.diff(found) > 1e-8 * found[1:])] if len(found) else found

    def _surface(self) -> Surface:
        """Gap ratio and slope on a grid fine enough for the ridge of the resonance."""
        phases = eqx.filter_jit(unit_phases)(_equations(self.system))
        fractions, frequencies = _finer(self.contact_fraction, 4), _finer(self.frequencies, 2)
        gap, slope = gap_surface(
            phases,
            as_arrays(self.system.drive),
            jnp.asarray(fractions),
            jnp.asarray(frequencies * self._angular_unit),
        )
        return Surface(fractions, frequencies, np.asarray(gap), np.asarray(slope))

    def _evaluate(self, places: Float[Array, "*many 2"]) -> Points:
        """Evaluate motions at places (contact fraction, frequency in the unit of the axis)."""
        phases = eqx.filter_jit(unit_phases)(_equations(self.system))
        unit = np.array([1.0, self._angular_unit])
        points = evaluate(phases, as_arrays(self.system.drive), places * unit)
        return points._replace(slope=points.slope * unit)

    def _gap_ratio(self, value: float | None) -> float:
        gap = self.own_gap_ratio if value is None else value
        check_range("gap_ratio", gap, 0.0, allowed=f"at least 0 ({self.ratio_units})")
        return float(gap)

    @property
    def _angular_unit(self) -> float:
        """From the unit of the axis to rad/s."""
        first = self.natural_frequency if self.axis == "frequency_ratio" else 1.0
        return 2 * np.pi * first

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset with named dimensions, units, long names and the rig in its attributes.

        Dimensions are `contact_fraction`, and `frequency_ratio` or `frequency`.
        """
        import xarray

        def described(name: str) -> dict[str, Any]:
            return described_as(name, self.ratio_units)

        dims = ("contact_fraction", self.axis)
        data: dict[str, Any] = {
            name: (dims, np.asarray(getattr(self, name)), described(name)) for name in SURFACES
        }
        for name in EDGES:
            data[name] = (self.axis, np.asarray(getattr(self, name)), described(name))
        data["natural_frequency"] = ((), self.natural_frequency, described("natural_frequency"))
        coordinates = {
            "contact_fraction": (dims[0], self.contact_fraction, described("contact_fraction")),
            self.axis: (self.axis, np.asarray(self.frequencies), described(self.axis)),
        }
        return xarray.Dataset(data, coordinates, attrs=dict(self.attributes))

    @validated
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the dataset to a NetCDF file, whole or not at all.

        `path` is that of the file, such as `curve.nc`; what is there is replaced. Raises
        `ValueError` for a path that cannot be a file's, `OSError` where writing fails.
        """
        save_dataset(self.to_xarray(), path)

    @validated
    def plot(self, gap_ratios: Sequence[float] | None = None) -> "Figure":
        """Draw amplitude against frequency, a line per gap ratio, and where they fold.

        By default a quarter, half, once, twice and four times the gap ratio of the system, as far
        as the grid reaches. Raises `ValueError` for a negative gap ratio, or a grid of one row or
        column.

        `gap_ratios` are gaps over drive amplitude.
        """
        if min(self.gap_ratio.shape) < 2:
            raise ValueError(
                "A picture needs at least two frequencies and two contact fractions, got "
                f"{self.gap_ratio.shape[1]} and {self.gap_ratio.shape[0]}."
            )
        own = self.own_gap_ratio
        wanted = [own * k for k in (0.25, 0.5, 1.0, 2.0, 4.0)] if gap_ratios is None else gap_ratios
        values = sorted({self._gap_ratio(float(v)) for v in wanted})
        from vibrojax.plot.single_contact import plot_single_contact
        from vibrojax.steady.single_contact_levels import Levels

        lines = Levels(self.frequencies, self.touch_gap_ratio, self._surface(), self._evaluate)
        levels = [(value, bool(np.isclose(value, own)), lines.level(value)) for value in values]
        if gap_ratios is None:
            levels = [level for level in levels if level[2].drawn.any()]
        return plot_single_contact(self.to_xarray(), levels, lines.folds())

    def __repr__(self) -> str:
        shape = f"contact_fraction: {len(self.contact_fraction)}, {self.axis}: "
        return (
            f"SingleContactResponse({shape}{len(self.frequencies)})\n"
            f"  own gap ratio  {self.own_gap_ratio:.6g}\n"
            f"  points         {int(np.sum(self.valid))} valid, {int(np.sum(self.stable))} stable"
        )


def _equations(system: AbstractSystem) -> LinearEquations:
    equations = equations_of(as_arrays(system)).linear_between_contacts
    assert equations is not None  # checked before the result was made
    return equations


def _around(axis: Array, cell: int, value: float) -> bool:
    """Whether a value lies in a cell of an axis or the ones beside it."""
    last = len(axis) - 1
    return bool(axis[max(cell - 1, 0)] <= value <= axis[min(cell + 2, last)])


def _finer(axis: Array, times: int) -> Array:
    """Split every interval into so many."""
    count = len(axis)
    return np.interp(np.arange(times * (count - 1) + 1) / times, np.arange(count), axis)


def _cells_with_folds(surface: Surface, gap: float) -> list[tuple[int, int]]:
    """Cells in which slope and distance from the level may both be zero."""

    def corners(values):
        parts = [values[:-1, :-1], values[1:, :-1], values[:-1, 1:], values[1:, 1:]]
        return np.stack(parts)

    slope, level = corners(surface.slope), corners(surface.gap_ratio)
    turns = (slope.min(axis=0) <= 0) & (slope.max(axis=0) >= 0)
    # Between corners the ratio goes beyond them by no more than this.
    margin = np.abs(slope).max(axis=0) * np.diff(surface.fractions)[:, None]
    reached = (level.min(axis=0) - margin <= gap) & (gap <= level.max(axis=0) + margin)
    return [(int(i), int(j)) for i, j in zip(*np.nonzero(turns & reached), strict=True)]
