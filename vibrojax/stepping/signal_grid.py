"""Where a march under a signal reads its input and where its states are kept."""

import math
from fractions import Fraction

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from vibrojax._tools.checks import concrete
from vibrojax._tools.compiled import compiled
from vibrojax.model.drives import AbstractSignal
from vibrojax.model.signals import Sampled, Tones
from vibrojax.model.systems import Motion
from vibrojax.stepping.input_phases import input_phases
from vibrojax.stepping.signal_march import march_equal, march_unequal

LONGEST = 2.0
"""Longest interval of a march, times the highest natural frequency: else intervals are divided."""
FINEST = 64
"""Parts that an interval of a record is divided into, at most."""


class SignalGrid(eqx.Module):
    """Knots of a march, between which its input is linear, and those at which states are kept."""

    knots: Float[Array, " knots"]
    """s."""
    kept: Int[Array, " samples"] | None
    """Which knots are kept; None: the knots are equally spaced, and every `stride`-th is."""
    stride: int = eqx.field(static=True)


def signal_grid(
    waveform: AbstractSignal, start: float, interval: float, count: int, fastest: float
) -> SignalGrid:
    """Choose the knots for states at `count` equal intervals (s) from the start (s) on.

    `fastest` is the highest angular frequency of the motion, rad/s. Raises `ValueError` where JAX
    is tracing the times of a `Sampled`.
    """
    ratio = Fraction(1)
    if isinstance(waveform, Tones):
        rates = concrete(waveform.frequencies)
        if rates is not None:
            fastest = max(fastest, 2 * np.pi * float(np.max(rates)))
    if isinstance(waveform, Sampled):
        time = times_of_record(waveform)
        spacing = (time[-1] - time[0]) / (time.size - 1)
        ratio = Fraction(interval / spacing).limit_denominator(FINEST)
        off = abs(interval / spacing - ratio) * count
        if not waveform.equally_spaced or ratio <= 0 or off > 1e-6:
            return unequal_grid(time, start + interval * np.arange(count + 1))
    finer = math.ceil(interval / ratio.numerator * fastest / LONGEST)
    stride = ratio.numerator * max(1, min(finer, FINEST))
    return SignalGrid(start + interval / stride * jnp.arange(count * stride + 1), None, stride)


def unequal_grid(time: np.ndarray, wanted: np.ndarray) -> SignalGrid:
    """Take the times of the record and those wanted together."""
    inside = time[(time > wanted[0]) & (time < wanted[-1])]
    after = np.clip(np.searchsorted(wanted, inside), 1, wanted.size - 1)
    nearest = wanted[after - np.array([[1], [0]])]
    alone = np.min(np.abs(nearest - inside), axis=0) > 1e-13 * np.max(np.abs(wanted))
    knots = np.union1d(inside[alone], wanted)
    return SignalGrid(jnp.asarray(knots), jnp.asarray(np.searchsorted(knots, wanted)), 1)


def times_of_record(waveform: Sampled) -> Float[np.ndarray, " samples"]:
    """Return the times (s) of a record. Raises `ValueError` where JAX is tracing them."""
    time = concrete(waveform.time)
    if time is None:
        raise ValueError(
            "The times of a Sampled must be known: JAX is tracing them (jit, vmap, grad), which it "
            "may do with the values only."
        )
    return time


@compiled
def march_on_grid(
    motion: Motion, grid: SignalGrid, state: Float[Array, " states"], *, reverse: bool
) -> Float[Array, "samples states"]:
    """March one lane with linear stops under a signal; return its states at the samples.

    `reverse` prepares the loops for reverse mode, instead of forward mode. The states of a motion
    that takes too many changes of contact are infinite from there on.
    """
    equations, waveform = motion.equations.linear_between_contacts, motion.waveform
    assert equations is not None  # checked before
    phases = input_phases(equations, motion.drive, waveform)
    knots = grid.knots
    values = jnp.zeros_like(knots)  # tones are states
    if not isinstance(waveform, Tones):
        values = motion.drive.input(waveform, knots)
    carried = phases.begin(state, knots[0])
    if grid.kept is None:
        count = (knots.shape[0] - 1) // grid.stride
        step = (knots[-1] - knots[0]) / (knots.shape[0] - 1)
        found = march_equal(
            phases, carried, values, step, stride=grid.stride, count=count, reverse=reverse
        )
    else:
        found = march_unequal(phases, carried, values, knots, reverse=reverse)[grid.kept]
    return found[:, : phases.scale.shape[0]] * phases.scale
