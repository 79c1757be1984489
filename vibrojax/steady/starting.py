"""Where a search for a periodic motion starts: a settled march, sampled over its period."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.model.drives import Harmonic
from vibrojax.model.equations import LinearEquations
from vibrojax.model.first_order import first_order
from vibrojax.model.systems import Motion
from vibrojax.steady.batches import in_batches, one_or_many, take
from vibrojax.steady.condensed import cell_average
from vibrojax.steady.lane_pool import LanePool
from vibrojax.steady.paths import AbstractPath, FrequencyPath, Place
from vibrojax.steady.pool_programs import compile_ahead
from vibrojax.steady.settled import Onwards, Settled
from vibrojax.stepping.linearly_implicit import LinearlyImplicit
from vibrojax.stepping.stepper import (
    AbstractMarch,
    AbstractStepper,
    ExactContact,
    ExponentialSplitting,
)

lax = jax.lax

SAMPLES = 512
"""Samples of a motion per drive period."""
SETTLED = 1e-4
"""Relative return at which a march is near enough to its limit for Newton's method."""
LONGEST = 8
"""Drive periods of the longest motion that is known as periodic: as in sweeps by default, which run
the same programs then."""
MOST_PERIODS = 600
TOGETHER = 16
"""Lanes settled in one call, where there are several: other numbers compile nothing anew, and
programs for more lanes take half a minute to compile to save tenths of a second."""


def stepper(equations: LinearEquations, exact: bool) -> AbstractStepper:
    """Return the method that suits the stops and, where these are not linear, the modes."""
    if exact:
        return ExactContact(1e-6)
    return ExponentialSplitting(1e-4) if equations.is_modal else LinearlyImplicit(1e-4)


def _march(place: Place, exact: bool) -> AbstractMarch:
    return stepper(place.equations, exact).prepare(place.equations, place.drive)


def settle(
    march: AbstractMarch,
    state: Float[np.ndarray, "lanes states"],
    angular_frequency: Float[np.ndarray, " lanes"],
    *,
    tolerance: float,
    max_period: int,
    max_periods: int,
) -> Settled:
    """Bring lanes, each with a rig of its own, to their steady states at one frequency (rad/s).

    `tolerance` is relative to the size of the state in the norm of energy. Whether a lane would
    grow without bound is not looked at.
    """
    parts: list[Settled] = []

    def last(settled: Settled) -> Onwards:
        parts.append(settled)
        nowhere = np.zeros(len(settled.lanes), bool)
        return Onwards(nowhere, np.ones(nowhere.shape), settled.state, ~nowhere)

    compile_ahead(march, len(state), max_period, follow=False)
    rig, none = np.arange(len(state)), np.zeros((0, len(state)))
    LanePool(march, rig, none, tolerance, max_period, max_periods).run(
        state, angular_frequency, last
    )
    whole: Settled = jax.tree.map(lambda *a: np.concatenate(a), *parts)
    order = np.argsort(whole.lanes)
    return jax.tree.map(lambda a: a[order], whole)


def settled_motion(
    path: FrequencyPath, value: Float[Array, ""], period: int, exact: bool
) -> Float[Array, " states"]:
    """March one lane from rest until it returns after `period` drive periods, or for long.

    A return that is small is enough to start from; how far the limit still is, which `settling`
    asks, would take up to three times as long.
    """
    place = path.at(value)
    march = _march(place, exact)
    weight, frequency = march.energy_weight(), place.angular_frequency
    once = jnp.asarray(1, jnp.int32)

    def step(carry):
        history, count, _ = carry
        state, _, _ = march(history[0] / weight, frequency, once, False)
        history = jnp.concatenate([(state * weight)[None], history[:-1]])
        gone = jnp.linalg.norm(history[0] - history[period]) / jnp.linalg.norm(history[0])
        return history, count + 1, gone

    def on(carry):
        _, count, gone = carry
        return (count < MOST_PERIODS) & ((count < 8 + period) | (gone > SETTLED))

    start = jnp.zeros((period + 1, weight.shape[0])), 0, jnp.asarray(jnp.inf)
    return lax.while_loop(on, step, start)[0][0] / weight


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
    method = stepper(equations, exact)
    kept = method.init(None, 0.0, interval, state, motion)

    def step(state, k):
        return method.advance(motion, k * interval, interval, state, kept), state

    _, states = lax.scan(step, state, jnp.arange(count, dtype=float))
    form = first_order(equations)
    depth, rate = form.depth @ states.T - form.gap[:, None], form.rate @ states.T
    lags = [stop.memory_size > 0 for stop in equations.stops]
    if any(lags):  # the surface of such a stop moves too, and the force is a spring's
        force = form.stiffness[:, None] * jnp.maximum(depth, 0.0)
        moves = form.depth @ (form.flow @ states.T + form.load[:, None] - form.push @ force)
        rate = jnp.where(np.reshape(lags, (-1, 1)), moves, rate)
    return depth, rate * interval, states


@compiled
def prepared(paths, values, exact: bool):
    """Make a march ready for every lane at its value; also the drive frequencies, rad/s."""

    def prepare(path, value):
        place = path.at(value)
        return _march(place, exact), place.angular_frequency

    return eqx.filter_vmap(prepare, out_axes=-1)(paths, values)


@compiled
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


def settled_states(
    paths: AbstractPath,
    values: np.ndarray,
    period: int,
    exact: bool,
    starts: Float[np.ndarray, "lanes states"] | None = None,
) -> tuple[Float[np.ndarray, "lanes states"], Bool[np.ndarray, " lanes"]]:
    """March lanes, from rest or from `starts`, until they settle.

    Returns their states, and which are of the period.
    """
    lanes, paths = len(values), jax.device_get(paths)
    if starts is None:
        place = jax.eval_shape(lambda p: p.at(jnp.zeros(())), take(paths, 0))
        starts = np.zeros((lanes, place.equations.state_size))
    if lanes > TOGETHER:

        def some(i: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return settled_states(take(paths, i), values[i], period, exact, starts[i])

        return in_batches(some, lanes, TOGETHER)
    index = one_or_many(lanes, TOGETHER)
    march, frequency = prepared(take(paths, index), jnp.asarray(values[index]), exact)
    came = settle(
        march,
        starts,
        np.asarray(frequency)[:lanes],
        tolerance=1e-6 if exact else 1e-5,
        max_period=max(period, LONGEST),
        max_periods=MOST_PERIODS,
    )
    return came.state, (came.period > 0) & (period % np.maximum(came.period, 1) == 0)


def settled_guess(
    paths: AbstractPath,
    values: np.ndarray,
    samples: int,
    period: int,
    exact: bool,
    state: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return spectra of motions to start from, and which lanes have one.

    Without a `state` (2 coordinates) the motions are marched from rest until they settle.
    """
    lanes = len(values)
    if state is None:
        states, found = settled_states(paths, values, period, exact)
    else:
        states, found = np.broadcast_to(state, (lanes, state.size)), np.ones(lanes, bool)
    paths = jax.device_get(paths)

    def sampled(i: np.ndarray) -> Complex[Array, "lanes stops harmonics"]:
        return sampled_depth(
            take(paths, i), values[i], jnp.asarray(states[i]), samples, period, exact
        )

    depth = in_batches(sampled, lanes, 1 if lanes == 1 else TOGETHER)
    return depth, found & np.isfinite(depth).all(axis=(1, 2))
