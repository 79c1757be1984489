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
from vibrojax.stepping.elementary import apply_matrix

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
    stops, count = phases.num_stops, 2**phases.num_stops
    steady = forced_blocks(phases, amplitude, angular_frequency)
    driven = resonant_blocks(phases, amplitude, angular_frequency)
    read = steady_readout(phases, steady, driven, angular_frequency)
    change = jnp.zeros((count, stops, *steady.shape[1:]), steady.dtype)
    for p, s in np.ndindex(count, stops):
        moved = _complex_apply(phases.change[p, s], steady[p]) - steady[p ^ (1 << s)]
        change = change.at[p, s].set(moved)
    # A landing is judged by the gap: near resonance the steady response without stops says little.
    gap = spread(phases.gap, 1, angular_frequency.ndim)
    pushed = _complex_apply(phases.readout[0, :stops], driven[0])
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
    s, every = phases.num_stops, range(2**phases.num_stops)
    read = jnp.stack([_complex_apply(phases.readout[p], steady[p]) for p in every])
    # The steady response is no free motion of a block: its acceleration is -w^2 its depth.
    acceleration = -(angular_frequency**2) * read[:, :s]
    if driven is not None:
        rates = phases.readout[:, s : 2 * s]
        acceleration = acceleration + jnp.stack(
            [_complex_apply(rates[p], driven[p]) for p in every]
        )
    return read.at[:, 2 * s : 3 * s].set(acceleration)


def _complex_apply(
    matrix: Float[Array, "rows columns *#lanes"], vector: Complex[Array, "columns *#lanes"]
) -> Complex[Array, "rows *#lanes"]:
    return apply_matrix(matrix, vector.real) + 1j * apply_matrix(matrix, vector.imag)


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
