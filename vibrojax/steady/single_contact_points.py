"""Many motions with one contact per drive period: everything about each, in batches of one size.

One size compiles once, for grids, pictures and folds alike.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from vibrojax.model.drives import AbstractDrive
from vibrojax.steady.single_contact import (
    gap_ratio_and_slope,
    multipliers,
    single_contact,
    unit_tables,
)
from vibrojax.steady.single_contact_orbit import read_single_contact
from vibrojax.stepping.contact_phases import ContactPhases, can_resonate

BATCH = 256
"""Motions at once: what is looked at of each takes some 25 kB."""


AnyArray = np.ndarray | Array


class Points(NamedTuple):
    """What is known of some motions, per unit of drive amplitude."""

    gap_ratio: Float[AnyArray, "..."]
    slope: Float[AnyArray, "... 2"]
    """Derivatives of the gap ratio in contact fraction and angular frequency."""
    multiplier: Float[AnyArray, "..."]
    """Largest modulus of the Floquet multipliers."""
    amplitude: Float[AnyArray, "..."]
    """Half peak-to-peak displacement."""
    peak: Float[AnyArray, "..."]
    force: Float[AnyArray, "..."]
    valid: Bool[AnyArray, "..."]


class Surface(NamedTuple):
    """The gap ratio on a grid."""

    fractions: Float[np.ndarray, " fractions"]
    frequencies: Float[np.ndarray, " frequencies"]
    gap_ratio: Float[np.ndarray, "fractions frequencies"]
    slope: Float[np.ndarray, "fractions frequencies"]
    """Derivative of it in the contact fraction."""


@eqx.filter_jit
def _batch(
    phases: ContactPhases,
    drive: AbstractDrive,
    places: Float[Array, "motions 2"],
    resonant: bool,
):
    def gap_of(place):
        tables = unit_tables(phases, drive, place[1], resonant=resonant)
        found = single_contact(tables, place[0])
        return found.gap_ratio, found

    def one(place):
        slope, found = jax.jacfwd(gap_of, has_aux=True)(place)
        tables = unit_tables(phases, drive, place[1], resonant=resonant)
        reading, valid = read_single_contact(tables, found)
        return Points(
            gap_ratio=found.gap_ratio,
            slope=slope,
            multiplier=jnp.max(jnp.abs(multipliers(tables, place[0]))),
            amplitude=(reading.highest - reading.lowest) / 2,
            peak=jnp.maximum(reading.highest, -reading.lowest),
            force=reading.contact_force,
            valid=valid,
        )

    return jax.vmap(one)(places)


def evaluate(
    phases: ContactPhases, drive: AbstractDrive, places: Float[np.ndarray, "*many 2"]
) -> Points:
    """Evaluate motions at places (contact fraction, angular frequency), of any shape.

    `phases` as of `unit_phases`.
    """
    shape = places.shape[:-1]
    flat = places.reshape(-1, 2)
    missing = -len(flat) % BATCH
    whole = np.concatenate([flat, np.repeat(flat[:1], missing, axis=0)])
    resonant = can_resonate(phases)
    parts = [
        jax.device_get(_batch(phases, drive, jnp.asarray(part), resonant))
        for part in whole.reshape(-1, BATCH, 2)
    ]

    def joined(*pieces):
        return np.concatenate(pieces)[: len(flat)].reshape((*shape, *pieces[0].shape[1:]))

    return jax.tree.map(joined, *parts)


def gap_surface(
    phases: ContactPhases,
    drive: AbstractDrive,
    fractions: Float[Array, " fractions"],
    angular_frequency: Float[Array, " frequencies"],
) -> tuple[Float[Array, "fractions frequencies"], Float[Array, "fractions frequencies"]]:
    """Return the gap ratio and its derivative in the contact fraction on a grid, nothing else.

    Ten times faster than `evaluate`.
    """

    return _surface(phases, drive, fractions, angular_frequency, can_resonate(phases))


@eqx.filter_jit
def _surface(phases, drive, fractions, angular_frequency, resonant: bool):
    def column(w):
        tables = unit_tables(phases, drive, w, resonant=resonant)
        return jax.vmap(lambda f: gap_ratio_and_slope(tables, f)[:2])(fractions)

    return jax.vmap(column, out_axes=1)(angular_frequency)
