"""Motions with one contact per drive period, laid out in time: what is read off, and validity."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from vibrojax.steady.contact_times import Events, PiecewiseMotion, Tables, forced, moved_on
from vibrojax.steady.exact_point import BREACH
from vibrojax.steady.orbit_reading import Reading, read_motion
from vibrojax.steady.single_contact import (
    CONTACT,
    FLIGHT,
    SingleContact,
    durations,
)


def with_gap(tables: Tables, gap: Float[Array, ""]) -> Tables:
    """Give tables of unit gap another gap, m (or m per unit of drive)."""
    p = tables.phases
    scaled = eqx.tree_at(
        lambda p: (p.rest, p.readout_rest, p.change_rest, p.gap),
        p,
        (p.rest * gap, p.readout_rest * gap, p.change_rest * gap, p.gap * gap),
    )
    return tables._replace(phases=scaled)


def laid_out(tables: Tables, found: SingleContact) -> tuple[Tables, Events, PiecewiseMotion]:
    """Lay the motion out from the middle of its flight, with the tables at its own gap."""
    phases = tables.phases
    angle, _, _ = durations(tables, found.contact_fraction)
    half = np.pi - angle / 2
    section = jnp.mod(found.touch - half, 2 * np.pi)
    touch, last = section + half, section + 2 * np.pi
    departure = touch + angle
    middle = moved_on(tables, FLIGHT, found.in_flight, departure, last - departure)
    none = jnp.zeros((), jnp.int32)
    events = Events(jnp.zeros(2, jnp.int32), none, section)
    motion = PiecewiseMotion(
        end=phases.to_state[FLIGHT] @ (middle + forced(tables, FLIGHT, section)),
        times=jnp.stack([touch, departure]),
        phase=jnp.array([FLIGHT, CONTACT, FLIGHT], jnp.int32),
        blocks=jnp.stack([middle, found.in_contact, found.in_flight], axis=1),
        start=jnp.stack([section, touch, departure]),
        stop=jnp.stack([touch, departure, last]),
        jacobian=None,
    )
    return with_gap(tables, found.gap_ratio), events, motion


def read_single_contact(tables: Tables, found: SingleContact) -> tuple[Reading, Bool[Array, ""]]:
    """Read the motion off, per unit of drive amplitude, and say whether it is a real one.

    A virtual motion enters the stop again in its flight, or leaves it during its contact.
    """
    own, events, motion = laid_out(tables, found)
    reading = read_motion(own, events, motion, 1)
    size = jnp.maximum(jnp.abs(found.gap_ratio), jnp.maximum(reading.highest, -reading.lowest))
    return reading, found.possible & (reading.breach <= BREACH * size)
