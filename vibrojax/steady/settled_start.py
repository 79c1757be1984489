"""Motions that continuations start from: settled by marching, many lanes at once."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from vibrojax._tools.types import AnyArray
from vibrojax.steady.condensed import cell_average
from vibrojax.steady.paths import AbstractPath
from vibrojax.steady.settling import Settled, settle
from vibrojax.steady.starting import SAMPLES, sampled_motion, stepper


@eqx.filter_jit
def settled(
    paths: AbstractPath,
    values: Float[AnyArray, " lanes"],
    state: Float[Array, "states lanes"],
    exact: bool,
    max_period: int,
    max_periods: int = 600,
) -> Settled:
    """March every lane at its value of the parameter from its state until it settles."""

    def prepare(path, value):
        place = path.at(value)
        return stepper(exact).prepare(place.equations, place.drive), place.angular_frequency

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
    values: Float[AnyArray, " lanes"],
    state: Float[Array, "lanes states"],
    samples: int,
    period: int,
    exact: bool,
) -> Complex[Array, "lanes stops harmonics"]:
    """Spectra of the averaged depths of the motions that start from these states at phase 0."""

    def one(path, value, state):
        per_period = max(SAMPLES, 2 * samples // period)
        depth, _, _ = sampled_motion(path, value, state, period, exact, per_period)
        count = samples // 2 + 1
        # The march is sampled more finely, so nothing folds back into the harmonics kept.
        spectrum = jnp.fft.rfft(depth)[:, :count] * (samples / depth.shape[1])
        return spectrum * cell_average(samples, count)

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
        place = jax.eval_shape(lambda p: p.at(jnp.zeros(())), take_first(paths))
        rest = jnp.zeros((place.equations.state_size, len(values)))
        came = settled(paths, values, rest, exact, max(period, 4))
        found = (np.asarray(came.period) > 0) & (period % np.maximum(came.period, 1) == 0)
        states = np.asarray(came.state).T
    else:
        states = np.broadcast_to(state, (len(values), state.size))
        found = np.ones(len(values), bool)
    depth = np.asarray(sampled_depth(paths, values, jnp.asarray(states), samples, period, exact))
    return depth, found & np.isfinite(depth).all(axis=(1, 2))


def take_first(paths: AbstractPath) -> AbstractPath:
    """Return the first lane of a stack of paths."""
    return jax.tree.map(lambda a: a[0] if eqx.is_array(a) else a, paths)
