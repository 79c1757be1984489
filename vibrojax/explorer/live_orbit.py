"""The orbit behind one point of a live curve: phase portrait and contact force."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from vibrojax.explorer.live_curve import LiveCurve, balanced_at
from vibrojax.steady.batches import take
from vibrojax.steady.condensed import cell_average, differentiate

FINER = 4
"""How many times finer than the balance the waveform is drawn."""


class LiveOrbit(NamedTuple):
    """One drive period of a motion, closed: the last sample repeats the first."""

    phase: Float[np.ndarray, " samples"]
    """Drive periods from phase 0."""
    displacement: Float[np.ndarray, " samples"]
    """What the system reports (the tip), relative to the base, m."""
    velocity: Float[np.ndarray, " samples"]
    """m/s."""
    contact_force: Float[np.ndarray, "stops samples"]
    """N."""
    touching: Bool[np.ndarray, " samples"]
    """Whether any stop is touched."""


@eqx.filter_jit
def _waves(paths, depth, frequency):
    place, problem, per_second, at = balanced_at(take(paths, 0), depth, frequency)
    samples = 2 * (depth.shape[-1] - 1)
    average = cell_average(samples, depth.shape[-1])
    push = jnp.einsum("bk,bk->k", problem.receptance.response_from_force, at.force / average)
    tip, motion = problem.response_drive + push, depth / average
    rows = jnp.concatenate(
        [
            jnp.stack([tip, differentiate(tip, samples)]),
            motion,
            differentiate(motion, samples),
        ]
    )
    # The highest harmonic has no phase at the samples: it is left out.
    waves = jnp.fft.irfft(FINER * rows.at[:, -1].set(0.0), FINER * samples)
    stops = len(place.equations.stops)
    value, rate = waves[2 : 2 + stops], waves[2 + stops :] * per_second
    forces = [stop.force(value[a], rate[a]) for a, stop in enumerate(place.equations.stops)]
    return waves[0], waves[1] * per_second, jnp.stack(forces), jnp.any(value > 0, axis=0)


def orbit_at(curve: LiveCurve, point: int) -> LiveOrbit:
    """Return the orbit of a point of the curve (its index)."""
    waves = _waves(curve.path, curve.depth[point], jnp.asarray(curve.frequency[point]))
    closed = [np.concatenate([a, a[..., :1]], axis=-1) for a in map(np.asarray, waves)]
    return LiveOrbit(np.linspace(0.0, 1.0, len(closed[0])), *closed)
