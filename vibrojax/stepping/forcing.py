"""What a harmonic drive does in every phase of contact, tabulated once for a drive frequency."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from vibrojax.stepping.contact_phases import (
    ContactPhases,
    contact_rates,
    forced_blocks,
    resonant_blocks,
    spread,
)

TOUCH = 1e-9
"""Depth over the gap below which a stop is not touched."""


class Forcing(NamedTuple):
    """Tables of one drive frequency, split into sine and cosine."""

    angular_frequency: Float[Array, "*#lanes"]
    start_phase: Float[Array, "*#lanes"]
    blocks: Complex[Array, "phases states *#lanes"]
    driven: Complex[Array, "phases states *#lanes"]
    """Input of blocks in resonance, which have no steady response."""
    readout: Complex[Array, "phases rows *#lanes"]
    change: Complex[Array, "phases stops states *#lanes"]
    depth_tolerance: Float[Array, "*#lanes"]


def forcing(
    phases: ContactPhases,
    amplitude: Complex[Array, "*#lanes"],
    angular_frequency: Float[Array, "*#lanes"],
    start_phase: Float[Array, "*#lanes"],
) -> Forcing:
    """Tabulate what a harmonic input Im(amplitude exp(i phase)) does in every phase."""
    stops, lanes = phases.num_stops, angular_frequency.ndim
    steady = forced_blocks(phases, amplitude, angular_frequency)
    driven = resonant_blocks(phases, amplitude, angular_frequency)
    read = steady_readout(phases, steady, driven, angular_frequency)
    # Every set of stops with one of them the other way.
    others = np.arange(2**stops)[:, None] ^ (1 << np.arange(stops))
    change = _applied(phases.change, steady[:, None], lanes) - steady[others]
    # A landing is judged by the gap: near resonance the steady response without stops says little.
    gap = spread(phases.gap, 1, lanes)
    pushed = _applied(phases.readout[0, :stops], driven[0], lanes)
    moved = jnp.abs(read[0, :stops]) + jnp.abs(pushed) / angular_frequency
    size = jnp.where(gap == 0, moved, jnp.abs(gap))
    size = jnp.min(size, axis=0) if stops else jnp.zeros_like(angular_frequency)
    return Forcing(
        angular_frequency=angular_frequency,
        start_phase=start_phase,
        blocks=steady,
        driven=driven,
        readout=read,
        change=change,
        depth_tolerance=jnp.broadcast_to(TOUCH * size, angular_frequency.shape),
    )


def steady_readout(
    phases: ContactPhases,
    steady: Complex[Array, "phases states *#lanes"],
    driven: Complex[Array, "phases states *#lanes"] | None,
    angular_frequency: Float[Array, "*#lanes"],
) -> Complex[Array, "phases rows *#lanes"]:
    """What the read-out rows see of the steady response and of the input of blocks in resonance."""
    s, lanes = phases.num_stops, angular_frequency.ndim
    read = _applied(phases.readout, steady, lanes)
    # The steady response is no free motion of a block: its acceleration is -w^2 its depth.
    acceleration = -(angular_frequency**2) * read[:, :s]
    if driven is not None:
        acceleration = acceleration + _applied(phases.readout[:, s : 2 * s], driven, lanes)
    return read.at[:, 2 * s : 3 * s].set(acceleration)


def _applied(
    matrices: Float[Array, "..."], vectors: Complex[Array, "..."], lanes: int
) -> Complex[Array, "..."]:
    """Matrices times vectors, rows and columns the axes before the lanes, which may be missing.

    A sum over an axis compiles quickly, and this runs once in a call.
    """
    wide = spread(matrices, vectors.ndim + 1 - lanes, lanes)
    return jnp.sum(wide * jnp.expand_dims(vectors, -2 - lanes), axis=-1 - lanes)


def longest_step(
    phases: ContactPhases,
    angular_frequency: Float[Array, "*#lanes"],
    tolerance: Float[ArrayLike, "*#lanes"],
) -> Float[Array, "*#lanes"]:
    """Longest step that diffrax is to take, s: short against a contact and the drive period.

    Propagation is exact at any step, and a march takes none.
    """
    period = 2 * jnp.pi / angular_frequency
    per_contact = 10.0 * (1e-3 / tolerance) ** 0.085
    contact = 2 * jnp.pi / spread(contact_rates(phases), 0, angular_frequency.ndim)
    return jnp.minimum(contact / per_contact, period / 16)
