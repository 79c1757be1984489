"""Where searches start: from the guess, from what the data show, and from elsewhere."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from vibrojax.branches.tracing import free_motion
from vibrojax.identification.coordinates import Coordinate
from vibrojax.identification.trial_rigs import SAMPLES
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.steady.batches import take
from vibrojax.steady.condensed import cell_average
from vibrojax.steady.paths import FrequencyPath

FACTORS = (0.1, 0.3, 3.0, 10.0)
"""By which the stiffness is multiplied where a search ended with a poor fit."""


def jump_up(measured: MeasuredCurve) -> float | None:
    """Frequency at which the amplitude jumps up, where it does."""
    ups = [j for j in measured.jumps() if j.change > 1]
    # Down from above resonance is where contact begins by a jump.
    ups.sort(key=lambda j: j.direction)
    return (ups[0].before + ups[0].after) / 2 if ups else None


def free_stop_amplitude(path: FrequencyPath, frequency: float) -> float:
    """Largest amplitude (m) at a stop without contact: the gap, where the curve jumps up."""
    one = take(path, np.array([0]))
    spectrum = np.asarray(jax.device_get(free_motion(one, jnp.asarray([frequency]), SAMPLES, 1)))
    average = cell_average(SAMPLES, spectrum.shape[-1])[1]
    return float(np.max(np.abs(spectrum[0, :, 1])) * 2 / SAMPLES / average)


def restarts(point: np.ndarray, coordinates: tuple[Coordinate, ...]) -> np.ndarray:
    """Starts around one that ended badly: the stiffness (or what moves in log) multiplied."""
    moving = [k for k, c in enumerate(coordinates) if c.kind == "log"]
    stiff = [k for k in moving if "stiffness" in coordinates[k].name] or moving[:1]
    starts = np.repeat(point[None], len(FACTORS), axis=0)
    starts[:, stiff] += np.log(FACTORS)[:, None]
    return starts


def spread_starts(point: np.ndarray, coordinates: tuple[Coordinate, ...], count: int) -> np.ndarray:
    """Starts spread evenly (Halton) within the bounds, or a decade around the guess."""
    shares = qmc.Halton(len(point), scramble=False).random(count + 1)[1:]
    low, high = np.empty(len(point)), np.empty(len(point))
    for k, c in enumerate(coordinates):
        bottom, top = c.limits
        reach = np.log(10.0) if c.kind == "log" else 3.0
        low[k] = bottom if np.isfinite(bottom) else point[k] - reach
        high[k] = top if np.isfinite(top) else point[k] + reach
    return low + shares * (high - low)
