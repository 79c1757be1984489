"""The response with one contact per drive period on a grid of contact time and frequency."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from vibrojax._tools.checks import check_increasing, check_range
from vibrojax._tools.compiled import compiled
from vibrojax._tools.described import provenance, recipe
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import check_drive, frequency_axis
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.systems import AbstractSystem, as_arrays, equations_of
from vibrojax.results.saving import AbstractSaved
from vibrojax.results.variables import described_as, with_unit
from vibrojax.steady.single_contact import (
    DEPTH,
    RESPONSE,
    check_single_stop,
    contact_free,
    unit_phases,
    unit_tables,
)
from vibrojax.steady.single_contact_surface import GapSurface, Points, evaluate
from vibrojax.stepping.contact_phases import ContactPhases

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

DEFAULT_FRACTIONS = 0.45 * np.linspace(0.04, 1.0, 97) ** 2
"""Dense towards short contacts, where the lower fold is."""
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


class SingleContactResponse(AbstractSaved):
    """Motions with one contact per drive period, shape (contact fractions, frequencies).

    The level set of `gap_ratio` at gap over drive amplitude is the response of a system, unstable
    branches included. Ratios are over the drive amplitude; displacements are those that a sweep
    reports. Sizes are NaN where there is no such motion (`valid`).
    """

    system: AbstractSystem
    """What moves."""
    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    frequencies: Float[np.ndarray, " frequencies"]
    """Drive frequencies, ascending, in the unit of the axis."""
    contact_fraction: Float[np.ndarray, " fractions"]
    """Share of the drive period in contact."""
    ratio_units: str = eqx.field(static=True)
    """Unit of the ratios: `1` for base motion, `m/N` for a force."""
    natural_frequency: float
    """First natural frequency of the unstopped system, Hz."""
    gap_ratio: Float[np.ndarray, "fractions frequencies"]
    """Gap over drive amplitude at which this is the motion, also where it is not `valid`."""
    gap_ratio_slope: Float[np.ndarray, "fractions frequencies"]
    """Its derivative in the contact fraction; zero at folds."""
    amplitude_ratio: Float[np.ndarray, "fractions frequencies"]
    """Half peak-to-peak displacement over drive amplitude."""
    peak_ratio: Float[np.ndarray, "fractions frequencies"]
    """Largest displacement, either side, over drive amplitude."""
    contact_force: Float[np.ndarray, "fractions frequencies"]
    """Largest contact force at the drive amplitude of the system, N."""
    leading_multiplier: Float[np.ndarray, "fractions frequencies"]
    """Largest modulus of the Floquet multipliers."""
    stable: Bool[np.ndarray, "fractions frequencies"]
    """Whether the motion exists and is stable."""
    valid: Bool[np.ndarray, "fractions frequencies"]
    """Whether the motion exists: it touches once, stays in until it leaves, at a gap of 0 or
    more."""
    touch_gap_ratio: Float[np.ndarray, " frequencies"]
    """Gap ratio at which the motion without contact just touches: the limit of short contacts."""
    contact_free_amplitude_ratio: Float[np.ndarray, " frequencies"]
    """Amplitude ratio of the motion without contact."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, versions."""

    @property
    def own_gap_ratio(self) -> float:
        """Gap over drive amplitude of the system itself."""
        (stop,) = equations_of(as_arrays(self.system)).stops
        return float(np.asarray(stop.gap)) / float(np.asarray(self.system.drive.reference[0]))

    @validated
    def folds(self, gap_ratio: float | None = None) -> Float[np.ndarray, " folds"]:
        """Return the frequencies of the folds at a gap ratio (the system's own by default).

        In the unit of the axis, increasing. They are looked for in every cell of a finer grid and
        refined to 1e-10; those where the motion is virtual are left out.
        Raises `ValueError` for a negative gap ratio.

        `gap_ratio` is gap over drive amplitude, in the unit of the gap ratios.
        """
        gap = self.own_gap_ratio if gap_ratio is None else self._checked(gap_ratio)
        return self._surface().folds(gap)

    def _checked(self, gap_ratio: float) -> float:
        check_range("gap_ratio", gap_ratio, 0.0, allowed=with_unit("at least 0", self.ratio_units))
        return float(gap_ratio)

    def _surface(self) -> GapSurface:
        equations = check_single_stop(equations_of(as_arrays(self.system)))
        unit = self.natural_frequency if self.axis == "frequency_ratio" else 1.0
        return GapSurface(
            _unit_phases(equations),
            as_arrays(self.system.drive),
            2 * np.pi * unit,
            self.contact_fraction,
            self.frequencies,
            self.touch_gap_ratio,
        )

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset with named dimensions, units, long names and the rig in its attributes.

        Dimensions are `contact_fraction`, and `frequency_ratio` or `frequency`.
        """
        import xarray

        dims = {"contact_fraction": ("contact_fraction",), self.axis: (self.axis,)}
        dims |= dict.fromkeys(EDGES, (self.axis,)) | {"natural_frequency": ()}

        def variable(name: str, values: Any) -> tuple[Any, ...]:
            on = dims.get(name, ("contact_fraction", self.axis))
            return on, np.asarray(values), described_as(name, self.ratio_units)

        names = (*SURFACES, *EDGES, "natural_frequency")
        data = {name: variable(name, getattr(self, name)) for name in names}
        coordinates = {
            "contact_fraction": variable("contact_fraction", self.contact_fraction),
            self.axis: variable(self.axis, self.frequencies),
        }
        return xarray.Dataset(data, coordinates, attrs=dict(self.attributes))

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
        values = sorted({self._checked(float(v)) for v in wanted})
        from vibrojax.plot.branches import plot_single_contact

        surface = self._surface()
        levels = [(value, bool(np.isclose(value, own)), surface.level(value)) for value in values]
        if gap_ratios is None:
            levels = [level for level in levels if level[2].drawn.any()]
        return plot_single_contact(self.to_xarray(), levels, surface.all_folds())

    def __repr__(self) -> str:
        shape = f"contact_fraction: {len(self.contact_fraction)}, {self.axis}: "
        return (
            f"SingleContactResponse({shape}{len(self.frequencies)})\n"
            f"  own gap ratio  {self.own_gap_ratio:.6g}\n"
            f"  points         {int(np.sum(self.valid))} valid, {int(np.sum(self.stable))} stable"
        )


_unit_phases = compiled(unit_phases)


@compiled
def _touches(
    phases: ContactPhases, drive: AbstractDrive, angular_frequency: Float[Array, " frequencies"]
) -> list[Float[Array, " frequencies"]]:
    """Gap ratio at which the motion without contact just touches, and its amplitude."""

    def one(w):
        tables = unit_tables(phases, drive, w)
        return [contact_free(tables, row) for row in (DEPTH, RESPONSE)]

    return jax.vmap(one)(angular_frequency)


@validated
def single_contact_response(
    system: AbstractSystem,
    *,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    contact_fraction: ArrayLike | Sequence[float] | None = None,
) -> SingleContactResponse:
    """Return all motions with one contact per drive period, for every gap and amplitude at once.

    For a given share of the period in contact and a given frequency there is one such motion at
    most, in closed form: nothing is marched, sampled or smoothed. The gap over the drive amplitude
    at which it is the motion of the system is `gap_ratio` of the result; the level sets of that
    are the responses, unstable branches included.

    Parameters:
        system: one linear `Stop` (KelvinVoigt with tension=True); its gap only says which gap
            ratio is its own.
        frequency_ratio: drive frequencies over the first linear natural frequency of the
            unstopped system, increasing, shape (frequencies,).
        frequency: the same in Hz; give one of the two.
        contact_fraction: shares of the drive period in contact, increasing, inside (0, 1), shape
            (fractions,); by default 97 from 0.0007 to 0.45, dense towards short contacts.

    Raises `ValueError` for another kind of system or stop, a drive without an amplitude, and
    frequencies or contact fractions that are empty, out of range or not increasing.
    """
    axis, grid = frequency_axis(frequency_ratio, frequency)
    fractions = _fractions(contact_fraction)
    reference, ratio_units = system.drive.reference
    check_drive(system, "Single-contact motions need")
    equations = check_single_stop(equations_of(as_arrays(system)))
    phases, drive = _unit_phases(equations), as_arrays(system.drive)
    first = equations.angular_frequency[0]
    angular = grid * (float(first) if axis == "frequency_ratio" else 2 * np.pi)
    touch, free = _touches(phases, drive, jnp.asarray(angular))
    places = np.stack(np.meshgrid(fractions, angular, indexing="ij"), axis=-1)
    points = Points(*map(np.asarray, evaluate(phases, drive, places)))

    def where_valid(values):
        return np.where(points.valid, values, np.nan)

    return SingleContactResponse(
        system=system,
        axis=axis,
        frequencies=grid,
        contact_fraction=fractions,
        ratio_units=ratio_units,
        natural_frequency=float(first) / (2 * np.pi),
        gap_ratio=np.asarray(points.gap_ratio),
        gap_ratio_slope=np.asarray(points.slope[..., 0]),
        amplitude_ratio=where_valid(points.amplitude),
        peak_ratio=where_valid(points.peak),
        contact_force=where_valid(points.force * float(np.asarray(reference))),
        leading_multiplier=np.asarray(points.multiplier),
        stable=np.asarray(points.valid & (points.multiplier < 1)),
        valid=np.asarray(points.valid),
        touch_gap_ratio=np.asarray(touch),
        contact_free_amplitude_ratio=np.asarray(free),
        attributes=provenance("single-contact response", recipe(system)),
    )


def _fractions(values: ArrayLike | Sequence[float] | None) -> np.ndarray:
    if values is None:
        return DEFAULT_FRACTIONS
    fractions = np.atleast_1d(np.asarray(values, dtype=float))
    if fractions.ndim > 1 or fractions.size == 0:
        raise ValueError(
            f"contact_fraction must be a list of shares, got an array of shape {fractions.shape}."
        )
    check_range(
        "contact_fraction",
        fractions,
        0.0,
        1.0,
        include_low=False,
        include_high=False,
        allowed="above 0 and below 1",
        advice="It is the share of the drive period in contact.",
    )
    check_increasing("contact_fraction", fractions)
    return fractions
