"""From a state to the steady state it leads to: march, and recognise.

A steady state is recognised on the stroboscopic map: the state returns after n drive periods, and
the geometric decay of the returns says how far away the limit still is. Where it is near, Newton's
method puts the state on the orbit; only a stable orbit, close to where the march was, is accepted,
so the march alone decides which attractor it is. The rest marches on.
"""

from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from vibrojax._tools.types import AnyArray
from vibrojax.stepping.elementary import by_halves, total
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

lax = jax.lax

NEAR = 1e-3
"""Relative distance from the limit at which Newton's method is tried."""
CLOSED = 1e-5
"""Relative return before the last Newton step that shows the steps converge: they square it."""
STEADY = 3
"""Periods in a row that have to look settled."""
SLOW, MODES = 0.2, 8
"""Longest return, over the size of a motion, that is one of slow settling; modes of its decay that
are distinguished."""
UNDAMPED = 1e-9
"""Decay, over the highest angular frequency of a rig, that counts as none."""
FEW_PERIODS, MANY_PERIODS = 600, 10_000
"""Marched at the most where nothing is asked for: where motions decay fast, and however slowly."""
APERIODIC_PERIODS = 24
"""Periods over which a motion without a period is measured."""


class Search(NamedTuple):
    """How far the march of a lane to its steady state has come."""

    history: Float[Array, "strobes states *lanes"]
    """Weighted states at the last drive periods, the newest first."""
    last_error: Float[Array, "orders *lanes"]
    streak: Int[Array, "*lanes"]
    marched: Int[Array, "*lanes"]
    steps: Int[Array, "*lanes"]
    done: Bool[Array, "*lanes"]


def _size(weighted: Float[Array, "..."], axis: int) -> Array:
    return jnp.sqrt(total(weighted**2, axis))


def _return_errors(history, max_period):
    """Estimated relative distance from a period-n limit, for n up to the largest.

    The returns of a converging motion shrink geometrically; their sum is what is left.
    """
    now, before_now, twice = history[0], history[1 : max_period + 1], history[2::2]
    size = by_halves(jnp.maximum, _size(history, 1))
    size = jnp.maximum(size, jnp.finfo(now.dtype).tiny)
    recent, before = _size(now - before_now, 1), _size(before_now - twice, 1)
    ratio = jnp.where(before > 0, recent / jnp.where(before > 0, before, 1.0), 0.0)
    left = jnp.where(ratio < 1, recent * ratio / jnp.where(ratio < 1, 1 - ratio, 1.0), jnp.inf)
    # At round-off level the ratio says nothing any more.
    left = jnp.where(recent < 1e-12 * size, recent, jnp.maximum(left, recent * 0.1))
    return left / size, recent / size


def begin_search(
    weighted: Float[AnyArray, "states *lanes"], max_period: int, xp: ModuleType = jnp
) -> Search:
    """Return the search of lanes that have not marched yet, in arrays of JAX or of numpy."""
    lanes = weighted.shape[1:]
    zero = xp.zeros(lanes, xp.int32)
    history = xp.broadcast_to(weighted, (2 * max_period + 1, *weighted.shape))
    far = xp.full((max_period, *lanes), xp.inf)
    return Search(history, far, zero, zero, zero, xp.zeros(lanes, bool))


def march_until(
    march: AbstractMarch,
    weight: Float[Array, "states *#lanes"],
    search: Search,
    frequency: Float[Array, "*lanes"],
    tolerance: Float[Array, "*#lanes"],
    max_periods: Int[ArrayLike, "*#lanes"],
    still: Int[ArrayLike, ""],
) -> Search:
    """March the lanes that are not done until their motion returns to within the tolerance.

    Stops as soon as no more than `still` lanes are left.
    """
    max_period, run = search.last_error.shape[0], march.run_at(frequency)

    def step(carry: tuple[Search, Any]) -> tuple[Search, Any]:
        search, lanes = carry
        lanes, came = run.go_on(lanes, ~search.done)
        new, steps = run.arrived_at(lanes)
        history = jnp.concatenate([(new * weight)[None], search.history[:-1]])
        history = jnp.where(came, history, search.history)
        marched = search.marched + came
        error, _ = _return_errors(history, max_period)
        worst = jnp.maximum(error, search.last_error)
        near = jnp.min(worst, axis=0) <= tolerance
        full = marched >= 2 * max_period
        streak = jnp.where(near & full, search.streak + 1, 0)
        lost = ~jnp.all(jnp.isfinite(history[0]), axis=0)
        done = (streak >= STEADY) | lost | (marched >= max_periods)
        search = Search(
            history=history,
            last_error=jnp.where(came, error, search.last_error),
            streak=jnp.where(came, streak, search.streak),
            marched=marched,
            steps=search.steps + jnp.where(came, steps, 0),
            done=search.done | (came & done),
        )
        # From the state, not from within a period: what lanes do depends on no other lane.
        fresh = run.begin(history[0] / weight)
        return search, jax.tree.map(lambda a, b: jnp.where(came, a, b), fresh, lanes)

    first = search, run.begin(search.history[0] / weight)
    return lax.while_loop(lambda carry: jnp.sum(~carry[0].done) > still, step, first)[0]


def found_period(search: Search, tolerance: Float[Array, "*#lanes"]) -> Int[Array, "*lanes"]:
    """Smallest n with a return within the tolerance; 0 where the march did not look settled."""
    history, max_period = search.history, search.last_error.shape[0]
    errors, returns = _return_errors(history, max_period)
    orders = jnp.arange(1, max_period + 1).reshape((-1,) + (1,) * (errors.ndim - 1))
    # The order is that of the return itself: a slow period-1 motion is not called period 2.
    fits = (returns <= 4 * tolerance) | (errors <= tolerance)
    first = jnp.min(jnp.where(fits, orders, max_period + 1), axis=0)
    first = jnp.where(first <= max_period, first, 0)
    return jnp.where(search.streak >= STEADY, first, 0).astype(jnp.int32)


def settling_time(march: AbstractMarch) -> Float[np.ndarray, " rigs"]:
    """Time, s, in which free motions of rigs decay to what is `NEAR`; 0 where they never do.

    Also where what is marched does not say so.
    """
    if not isinstance(march, ExactMarch):
        return np.zeros(march.energy_weight().shape[1])
    decay, rate = -np.asarray(march.phases.exponent)[0], np.asarray(march.phases.rate)[0]
    slowest = np.where(decay > UNDAMPED * rate.max(axis=0), decay, np.inf).min(axis=(0, 1))
    return np.log(1 / NEAR) / slowest


def most_periods(
    time: Float[np.ndarray, " lanes"],
    angular_frequency: Float[np.ndarray, " lanes"],
    max_period: int,
) -> Int[np.ndarray, " lanes"]:
    """Return the drive periods to march lanes whose free motions decay in a time, s, to `NEAR`."""
    periods = 2 * time * angular_frequency / (2 * np.pi)
    return np.clip(periods, max(FEW_PERIODS, 2 * max_period + 1), MANY_PERIODS).astype(np.int32)


def slow_limits(
    history: Float[np.ndarray, "lanes strobes states"], max_period: int
) -> tuple[Float[np.ndarray, "lanes states"], Int[np.ndarray, " lanes"]]:
    """Where motions that still settle should end, and after how many drive periods they return.

    Period 0 where they do not look like that. `history` holds weighted states, the newest first;
    the last returns are continued by reduced rank extrapolation (Sidi, Vector Extrapolation Methods
    with Applications, 2017, section 1.4), which is exact for some linear modes of decay.
    """
    limit, period = history[:, 0].copy(), np.zeros(len(history), np.int32)
    size, least = np.linalg.norm(history, axis=2).max(axis=1), np.full(len(history), np.inf)
    for n in range(1, max_period + 1):
        states = history[:, ::n][:, : MODES + 2]
        back = np.diff(states, axis=1)
        returns = np.linalg.norm(back, axis=2)
        shrinks = (returns[:, 0] < returns[:, -1]) & (returns[:, 0] < SLOW * size)
        # The smallest period, unless a multiple of it returns far better.
        own = np.flatnonzero(shrinks & (returns[:, 0] < least / 4))
        bends = np.diff(back[own], axis=1)
        share = np.linalg.pinv(bends.swapaxes(1, 2), rcond=1e-8) @ back[own, 0, :, None]
        limit[own] = states[own, 0] - (share.swapaxes(1, 2) @ back[own, :-1])[:, 0]
        least[own], period[own] = returns[own, 0], n
    return limit, period
