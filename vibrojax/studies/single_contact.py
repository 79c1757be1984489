"""The response with one contact per drive period on a grid of contact time and frequency."""

from collections.abc import Sequence
from importlib.metadata import version
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from vibrojax._checks import check_range, concrete
from vibrojax.drive import AbstractDrive
from vibrojax.response.single_contact import (
    SingleContact,
    check_single_stop,
    contact_free_amplitude,
    gap_ratio_and_slope,
    multipliers,
    touch_gap_ratio,
    unit_phases,
    unit_tables,
)
from vibrojax.response.single_contact_orbit import read_single_contact
from vibrojax.results.single_contact_response import SingleContactResponse
from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.studies.frequency_sweep import _frequency_axis
from vibrojax.systems.base import AbstractSystem, as_arrays, equations_of

CHUNK = 256
"""Motions read at once: what is looked at of each takes some 25 kB."""
DEFAULT_FRACTIONS = 0.45 * np.linspace(0.04, 1.0, 97) ** 2
"""Dense towards short contacts, where the lower fold is."""


class _Grid(NamedTuple):
    found: SingleContact
    slope: Float[Array, "fractions frequencies"]
    multiplier: Float[Array, "fractions frequencies"]
    touch: Float[Array, " frequencies"]
    free: Float[Array, " frequencies"]


@eqx.filter_jit
def _solve(
    phases: ContactPhases,
    drive: AbstractDrive,
    angular_frequency: Float[Array, " frequencies"],
    fractions: Float[Array, " fractions"],
) -> _Grid:
    def point(tables, fraction):
        _, slope, found = gap_ratio_and_slope(tables, fraction)
        return found, slope, jnp.max(jnp.abs(multipliers(tables, fraction)))

    def column(w):
        tables = unit_tables(phases, drive, w)
        found, slope, multiplier = jax.vmap(lambda f: point(tables, f))(fractions)
        return _Grid(
            found, slope, multiplier, touch_gap_ratio(tables), contact_free_amplitude(tables)
        )

    by_frequency = jax.vmap(column)(angular_frequency)
    swapped = jax.tree.map(lambda a: jnp.swapaxes(a, 0, 1), by_frequency[:3])
    return _Grid(*swapped, *by_frequency[3:])


class _Reading(NamedTuple):
    amplitude: Float[Array, " motions"]
    peak: Float[Array, " motions"]
    force: Float[Array, " motions"]
    valid: Bool[Array, " motions"]


@eqx.filter_jit
def _read(
    phases: ContactPhases,
    drive: AbstractDrive,
    angular_frequency: Float[Array, " motions"],
    found: SingleContact,
) -> _Reading:
    def one(at):
        w, motion = at
        reading, valid = read_single_contact(unit_tables(phases, drive, w), motion)
        return _Reading(
            amplitude=(reading.highest - reading.lowest) / 2,
            peak=jnp.maximum(reading.highest, -reading.lowest),
            force=reading.contact_force,
            valid=valid,
        )

    count = angular_frequency.size
    chunks = max(1, -(-count // CHUNK))
    rows = -(-count // chunks)

    def split(a):
        a = jnp.concatenate([a, jnp.repeat(a[:1], chunks * rows - count, axis=0)])
        return a.reshape(chunks, rows, *a.shape[1:])

    many = jax.lax.map(jax.vmap(one), jax.tree.map(split, (angular_frequency, found)))
    return jax.tree.map(lambda a: a.reshape(-1)[:count], many)


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
    if not isinstance(system, AbstractSystem):
        raise ValueError(f"system must be a system such as ImpactingBeam, got {system!r}.")
    axis, grid = _frequency_axis(frequency_ratio, frequency)
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
    angular = jnp.asarray(grid) * (first if axis == "frequency_ratio" else 2 * np.pi)

    solved = _solve(phases, drive, angular, jnp.asarray(fractions))
    shape = solved.slope.shape
    flat = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), solved.found)
    every = jnp.broadcast_to(angular, shape).reshape(-1)
    read = jax.tree.map(lambda a: np.asarray(a).reshape(shape), _read(phases, drive, every, flat))

    def where_valid(values):
        return np.where(read.valid, values, np.nan)

    multiplier = np.asarray(solved.multiplier)
    return SingleContactResponse(
        system=system,
        axis=axis,
        frequencies=grid,
        contact_fraction=fractions,
        ratio_units=ratio_units,
        natural_frequency=float(first) / (2 * np.pi),
        gap_ratio=np.asarray(solved.found.gap_ratio),
        gap_ratio_slope=np.asarray(solved.slope),
        amplitude_ratio=where_valid(read.amplitude),
        peak_ratio=where_valid(read.peak),
        contact_force=where_valid(read.force * float(np.asarray(reference))),
        leading_multiplier=multiplier,
        stable=read.valid & (multiplier < 1),
        valid=read.valid,
        touch_gap_ratio=np.asarray(solved.touch),
        contact_free_amplitude_ratio=np.asarray(solved.free),
        attributes={
            "title": "vibrojax single-contact response",
            "rig": repr(system),
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
