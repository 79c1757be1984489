"""Where a search for a periodic motion starts: a settled march, sampled over its period."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax.model.drives import Harmonic
from vibrojax.model.systems import Motion
from vibrojax.steady.paths import AbstractPath, FrequencyPath
from vibrojax.stepping.method import AbstractMethod, ExactContact, ExponentialSplitting

lax = jax.lax

SAMPLES = 512
"""Samples of a motion per drive period."""
SETTLED = 1e-4
"""Relative return at which a march is near enough to its limit for Newton's method."""
MOST_PERIODS = 600


def stepper(exact: bool, tolerance: float = 1e-6) -> AbstractMethod:
    """Return the method that suits the stops."""
    return ExactContact(tolerance) if exact else ExponentialSplitting(max(tolerance, 1e-4))


def settled_motion(
    path: FrequencyPath, value: Float[Array, ""], period: int, exact: bool
) -> Float[Array, " states"]:
    """March one lane from rest until it returns after `period` drive periods, or for long."""
    place = path.at(value)
    march = stepper(exact).prepare(place.equations, place.drive)
    weight = march.energy_weight()
    once = jnp.asarray(1, jnp.int32)

    def step(carry):
        history, count, _ = carry
        state, _, _ = march(history[0] / weight, place.angular_frequency, once, False)
        history = jnp.concatenate([(state * weight)[None], history[:-1]])
        gone = jnp.linalg.norm(history[0] - history[period])
        return history, count + 1, gone / jnp.linalg.norm(history[0])

    def on(carry):
        _, count, gone = carry
        return (count < MOST_PERIODS) & ((count < 8 + period) | (gone > SETTLED))

    start = jnp.zeros((period + 1, weight.shape[0])), 0, jnp.asarray(jnp.inf)
    history, _, _ = lax.while_loop(on, step, start)
    return history[0] / weight


def sampled_motion(
    path: AbstractPath,
    value: Float[Array, ""],
    state: Float[Array, " states"],
    period: int,
    exact: bool,
    per_period: int = SAMPLES,
) -> tuple[Array, Array, Array]:
    """Depths (stops, samples), their change per sample and the states of a motion from phase 0."""
    place = path.at(value)
    equations = place.equations
    count = per_period * period
    motion = Motion(equations, place.drive, Harmonic(place.angular_frequency / (2 * jnp.pi)))
    interval = 2 * jnp.pi / place.angular_frequency / per_period
    method = stepper(exact)
    kept = method.init(None, 0.0, interval, state, motion)

    def step(state, k):
        return method.advance(motion, k * interval, interval, state, kept), state

    _, states = lax.scan(step, state, jnp.arange(count, dtype=float))
    n = equations.size
    gaps = jnp.stack([jnp.asarray(stop.gap) for stop in equations.stops])
    depth = states[:, :n] @ equations.stop_map.T - gaps
    change = states[:, n : 2 * n] @ equations.stop_map.T * interval
    return depth.T, change.T, states
