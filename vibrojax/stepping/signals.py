"""Rows that read signals of blocks, and their derivatives, in every phase of contact.

The drive is one more block, (cosine, sine) of its phase, that turns at its frequency: with it all
signals are sums of turns. Blocks are the second axis of all arrays, after their two rows.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from vibrojax.stepping.contact_phases import ContactPhases, spread
from vibrojax.stepping.forcing import Forcing
from vibrojax.stepping.turns import slope_row

lax = jax.lax


class Turning(NamedTuple):
    """How the blocks of every phase turn, the drive the last of them."""

    decay: Float[Array, "phases 2 blocks *lanes"]
    rate: Float[Array, "phases blocks *lanes"]
    speed: Float[Array, "phases blocks *lanes"]
    """Size of the eigenvalues, 1/s."""


class Signals(NamedTuple):
    """What is read of the motion in every phase: rows for the structure, rest, drive."""

    rows: Float[Array, "phases signals states *lanes"]
    rest: Float[Array, "phases signals *lanes"]
    wave: Complex[Array, "phases signals *lanes"]


def turning_of(phases: ContactPhases, force: Forcing) -> Turning:
    """Put the drive with the blocks of all phases."""
    w, lanes = force.angular_frequency, force.angular_frequency.ndim
    decay = spread(phases.exponent, 3, lanes) + jnp.zeros_like(w)
    rate = spread(phases.rate, 2, lanes) + jnp.zeros_like(w)
    # The drive turns too, and never decays.
    decay = jnp.concatenate([decay, jnp.zeros_like(decay[:, :, :1])], axis=2)
    rate = jnp.concatenate([rate, jnp.broadcast_to(w, rate[:, :1].shape)], axis=1)
    # What says how far to look has no derivative of its own.
    speed = jnp.sqrt(jnp.max(lax.stop_gradient(decay) ** 2, axis=1) + lax.stop_gradient(rate) ** 2)
    return Turning(decay, rate, speed)


def with_wave(
    blocks: Float[Array, "2 blocks *#lanes"], wave: Float[Array, "2 *lanes"]
) -> Float[Array, "2 blocks+1 *lanes"]:
    """Put the drive behind the blocks, from the sine and cosine of its phase."""
    return jnp.concatenate([blocks, wave[::-1][:, None]], axis=1)


def with_derivatives(
    turning: Turning, force: Forcing, signals: Signals, order: int = 2
) -> Float[Array, "phases 2 blocks derivatives signals *lanes"]:
    """Rows that read signals and their derivatives up to an order off the blocks and the drive."""
    value, w = signals.rows, force.angular_frequency
    blocks = value.reshape(*value.shape[:2], 2, -1, *w.shape)
    drive = _of_wave(signals.wave)[:, :, None]
    row = jnp.concatenate([jnp.moveaxis(blocks, 1, 3), drive], axis=2)
    rows = [row]
    for _ in range(order):
        # What a drive in resonance adds to a block counts in the next derivative.
        structure = row[:, :, :-1].reshape(len(row), -1, *row.shape[3:])
        added = _of_wave(jnp.sum(structure * force.driven[:, :, None], axis=1))
        row = jax.vmap(slope_row)(turning.decay[:, :, :, None], turning.rate[:, :, None], row)
        row = row.at[:, :, -1].add(added)
        rows.append(row)
    return jnp.stack(rows, axis=3)


def _of_wave(wave: Array) -> Array:
    """Rows by which the drive, as a block (cosine, sine), reads a wave."""
    return jnp.stack([wave.imag, wave.real], axis=1)


def contact_signals(phases: ContactPhases, force: Forcing) -> Signals:
    """Depths, then pushes as depths where any stop may not pull."""
    k, lanes = phases.num_stops, force.angular_frequency.ndim
    wide = jnp.zeros_like(force.angular_frequency)
    rows = spread(phases.readout, 3, lanes)[:, : 2 * k] + wide
    rest = spread(phases.readout_rest, 2, lanes)[:, : 2 * k] + wide
    wave = force.readout[:, : 2 * k]
    if all(phases.can_pull):
        return Signals(rows[:, :k], rest[:, :k], wave[:, :k])
    stiffness, damping = spread(phases.stiffness, 1, lanes), spread(phases.damping, 1, lanes)
    unit = stiffness + damping * force.angular_frequency
    pushes = (unit > 0) & ~np.reshape(phases.can_pull, (k,) + (1,) * lanes)
    safe = jnp.where(unit > 0, unit, 1.0)
    hold, drag = jnp.where(pushes, stiffness / safe, 1.0), jnp.where(pushes, damping / safe, 0.0)

    def with_push(depth, speed, hold, drag):
        return jnp.concatenate([depth, hold * depth + drag * speed], axis=1)

    return Signals(
        with_push(rows[:, :k], rows[:, k:], hold[:, None], drag[:, None]),
        with_push(rest[:, :k], rest[:, k:], hold, drag),
        with_push(wave[:, :k], wave[:, k:], hold, drag),
    )


def contact_distances(phases: ContactPhases, force: Forcing) -> Signals:
    """How far every stop is from a change of contact, m: positive behind it."""
    k, read = phases.num_stops, contact_signals(phases, force)
    touching = (np.arange(2**k)[:, None] >> np.arange(k)) & 1

    def signed(a: Array) -> Array:
        where = touching.reshape(*touching.shape, *(1,) * (a.ndim - 2))
        return jnp.where(where, -a[:, -k:], a[:, :k]) if k else a

    return Signals(*map(signed, read))


def measured_signals(phases: ContactPhases, force: Forcing) -> Signals:
    """What tops are looked for in: force of every stop, N, the response, m, and its negative."""
    k, lanes = phases.num_stops, force.angular_frequency.ndim
    wide = jnp.zeros_like(force.angular_frequency)
    stiffness, damping = spread(phases.stiffness, 1, lanes), spread(phases.damping, 1, lanes)

    def signals(read: Array, hold: Array, drag: Array) -> Array:
        read = read + wide
        force = hold * read[:, :k] + drag * read[:, k : 2 * k]
        response = read[:, 3 * k : 3 * k + 1]
        return jnp.concatenate([force, response, -response], axis=1)

    return Signals(
        signals(spread(phases.readout, 3, lanes), stiffness[:, None], damping[:, None]),
        signals(spread(phases.readout_rest, 2, lanes), stiffness, damping),
        signals(force.readout, stiffness, damping),
    )
