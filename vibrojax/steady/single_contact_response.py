"""The response with one contact per drive period on a grid of contact time and frequency."""

from collections.abc import Sequence
from importlib.metadata import version

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_range, concrete
from vibrojax._tools.described import recipe
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import frequency_axis
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.systems import AbstractSystem, as_arrays, equations_of
from vibrojax.steady.single_contact import (
    check_single_stop,
    contact_free_amplitude,
    touch_gap_ratio,
    unit_phases,
    unit_tables,
)
from vibrojax.steady.single_contact_points import Points, evaluate
from vibrojax.steady.single_contact_result import SingleContactResponse
from vibrojax.stepping.contact_phases import ContactPhases

DEFAULT_FRACTIONS = 0.45 * np.linspace(0.04, 1.0, 97) ** 2
"""Dense towards short contacts, where the lower fold is."""


@eqx.filter_jit
def _touches(
    phases: ContactPhases, drive: AbstractDrive, angular_frequency: Float[Array, " frequencies"]
) -> tuple[Float[Array, " frequencies"], Float[Array, " frequencies"]]:
    def one(w):
        tables = unit_tables(phases, drive, w)
        return touch_gap_ratio(tables), contact_free_amplitude(tables)

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
    size = concrete(reference)
    if ratio_units == "m" or (size is not None and not size > 0):
        raise ValueError(
            "Single-contact motions need a drive with an amplitude above 0, got "
            f"{system.drive!r}. Give the system drive=BaseMotion(...) or PointForce(...)."
        )
    equations = check_single_stop(equations_of(as_arrays(system)))
    phases, drive = eqx.filter_jit(unit_phases)(equations), as_arrays(system.drive)
    first = equations.angular_frequency[0]
    angular = grid * (float(first) if axis == "frequency_ratio" else 2 * np.pi)
    touch, free = _touches(phases, drive, jnp.asarray(angular))
    places = np.stack(np.meshgrid(fractions, angular, indexing="ij"), axis=-1)
    points = Points(*map(np.asarray, evaluate(phases, drive, places)))
    stable = points.valid & (points.multiplier < 1)

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
        stable=np.asarray(stable),
        valid=np.asarray(points.valid),
        touch_gap_ratio=np.asarray(touch),
        contact_free_amplitude_ratio=np.asarray(free),
        attributes={
            "title": "vibrojax single-contact response",
            "rig": recipe(system),
            "vibrojax_version": version("vibrojax"),
            "jax_version": version("jax"),
        },
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
    if (np.diff(fractions) <= 0).any():
        bad = int(np.flatnonzero(np.diff(fractions) <= 0)[0])
        raise ValueError(
            f"contact_fraction must increase strictly, got {fractions[bad]} then "
            f"{fractions[bad + 1]} at index {bad + 1}."
        )
    return fractions
