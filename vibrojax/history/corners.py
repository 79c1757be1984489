"""Samples where a signal has its corners, beside those of a history."""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vibrojax._tools.types import AnyArray
from vibrojax.model.drives import AbstractSignal
from vibrojax.model.signals import Sampled, Tones
from vibrojax.model.systems import Motion
from vibrojax.stepping.signal_grid import (
    SignalGrid,
    march_on_grid,
    times_of_record,
    unequal_grid,
)

CHORD = 0.01
"""Longest stretch of a sum of tones that counts as straight, rad of its fastest: its input is then
right to 1e-5."""


def cut_at_corners(
    motion: Motion,
    time: Float[np.ndarray, " samples"],
    states: Float[AnyArray, "samples states"],
) -> tuple[Float[np.ndarray, " knots"], Float[np.ndarray, "knots states"]]:
    """Return times (s) and states between which the input of a signal is straight.

    Those given where the drive has a phase, or where the motion is stepped and not exact.
    """
    waveform = motion.waveform
    if not isinstance(waveform, AbstractSignal) or motion.prepared is None:
        return time, np.asarray(states)
    if isinstance(waveform, Tones):
        fastest = 2 * np.pi * float(jnp.max(waveform.frequencies))
        finer = math.ceil(fastest * float(time[1] - time[0]) / CHORD)
        knots = np.linspace(time[0], time[-1], finer * (time.size - 1) + 1)
        grid = SignalGrid(jnp.asarray(knots), None, 1)
    else:
        assert isinstance(waveform, Sampled)
        grid = unequal_grid(times_of_record(waveform), time)
        if grid.knots.shape[0] == time.size:
            return time, np.asarray(states)
        grid = SignalGrid(grid.knots, jnp.arange(grid.knots.shape[0]), 1)  # all of them kept
    first: Array = jnp.asarray(states[0])
    return np.asarray(grid.knots), np.asarray(march_on_grid(motion, grid, first, reverse=False))


def own_interval(
    cut: Float[np.ndarray, " knots"], time: Float[np.ndarray, " samples"]
) -> np.ndarray:
    """Return in which interval of the samples those between the knots lie."""
    middle = (cut[:-1] + cut[1:]) / 2
    return np.clip(np.searchsorted(time, middle) - 1, 0, time.size - 2)
