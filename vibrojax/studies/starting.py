"""Motions to start from: settled by marching, sampled over their period."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from vibrojax.drive import Harmonic
from vibrojax.response.condensed import cell_average
from vibrojax.response.paths import AbstractPath
from vibrojax.response.settling import Settled, settle
from vibrojax.stepping.method import AbstractMethod, ExactContact, ExponentialSplitting
from vibrojax.systems.base import Motion

FINER = 4
"""Samples of the march for every sample of the balance."""


@eqx.filter_jit
def settled(
    paths: AbstractPath,
    values: Float[Array, " lanes"],
    state: Float[Array, "states lanes"],
    exact: bool,
    max_period: int,
    max_periods: int = 600,
) -> Settled:
    """March every lane at its value of the parameter from its state until it settles."""
    method: AbstractMethod = ExactContact(1e-6) if exact else ExponentialSplitting(1e-4)

    def prepare(path, value):
        place = path.at(value)
        march = method.prepare(place.equations, place.drive)
        return march, place.angular_frequency

    march, frequency = eqx.filter_vmap(prepare, out_axes=-1)(paths, values)
    return settle(
        march,
        state,
        frequency,
        tolerance=1e-6 if exact else 1e-5,
        max_period=max_period,
        max_periods=max_periods,
    )


@eqx.filter_jit
def sampled_depth(
    paths: AbstractPath,
    values: Float[Array, " lanes"],
    state: Float[Array, "lanes states"],
    samples: int,
    period: int,
    exact: bool,
) -> Complex[Array, "lanes stops harmonics"]:
    """Spectra of the averaged depths of the motions that start from these states at phase 0."""
    method: AbstractMethod = ExactContact(1e-6) if exact else ExponentialSplitting(1e-4)

    def one(path, value, state):
        place = path.at(value)
        motion = Motion(
            place.equations, place.drive, Harmonic(place.angular_frequency / (2 * jnp.pi))
        )
        interval = period * 2 * jnp.pi / place.angular_frequency / (samples * FINER)
        kept = method.init(None, 0.0, interval, state, motion)

        def step(state, k):
            after = method.advance(motion, k * interval, interval, state, kept)
            return after, place.equations.penetration(state[: place.equations.size])

        _, depth = jax.lax.scan(step, state, jnp.arange(samples * FINER, dtype=float))
        fine = jnp.fft.rfft(depth.T)[:, : samples // 2 + 1] / FINER
        return fine * cell_average(samples, samples // 2 + 1)

    return jax.vmap(one)(paths, values, state)


def settled_guess(
    paths: AbstractPath,
    values: np.ndarray,
    samples: int,
    period: int,
    exact: bool,
    state: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return spectra of motions to start from, and which lanes have one.

    Without a `state` (2 coordinates) the motions are marched from rest until they settle.
    """
    if state is None:
        size = jax.eval_shape(lambda p: p.at(jnp.zeros(())), _first(paths)).equations.size
        rest = jnp.zeros((2 * size, len(values)))
        came = settled(paths, jnp.asarray(values), rest, exact, max(period, 4))
        found = (np.asarray(came.period) > 0) & (period % np.maximum(came.period, 1) == 0)
        states = np.asarray(came.state).T
    else:
        states = np.broadcast_to(state, (len(values), state.size))
        found = np.ones(len(values), bool)
    depth = sampled_depth(
        paths, jnp.asarray(values), jnp.asarray(states), samples, period, exact
    )
    depth = np.asarray(depth)
    return depth, found & np.isfinite(depth).all(axis=(1, 2))


def _first(paths):
    return jax.tree.map(lambda a: a[0] if eqx.is_array(a) else a, paths)
