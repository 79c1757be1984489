"""What lasts of a motion: its period by its returns to drive phase 0, and its exponent."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._tools.checks import check_count, check_positive
from vibrojax._tools.compiled import compiled
from vibrojax.steady.growth import drive_period, grown, mean_rate
from vibrojax.stepping.stepper import AbstractMarch

lax = jax.lax


def period_number(
    section: Float[Array, "count states *lanes"],
    tolerance: Float[ArrayLike, ""],
    max_period: int,
) -> tuple[Int[Array, "*lanes"], Float[Array, "*lanes"]]:
    """Return the smallest n after which a record of states repeats, up to `max_period`.

    The states are those at the same drive phase of successive periods, weighted so that their norm
    is that of an energy. With period n every state of the record returns after n periods to within
    `tolerance` of the size of the motion, and lies as near to the newest state of its phase, so
    that a slow drift along a torus is no period. The size is the spread of the states about their
    mean; of a fixed point, n = 1, it is that of the states themselves: a motion whose states
    spread by less than `tolerance` of their size is called period 1. The second answer is the
    relative error of that return; where the period is 0, none found, it is the least of all.

    Raises `ValueError` unless the tolerance is above 0 and there are at least 2 max_period states.
    """
    check_positive("tolerance", tolerance, "(relative return)")
    check_count("max_period", max_period)
    count = section.shape[0]
    if count < 2 * max_period:
        raise ValueError(
            f"section must have at least 2 max_period = {2 * max_period} states, got {count}. "
            "Observe more periods, or look for shorter ones."
        )

    def squares(states: Float[Array, "count states *lanes"]) -> Float[Array, "count *lanes"]:
        return jnp.sum(states**2, axis=1)

    spread = jnp.sqrt(jnp.mean(squares(section - jnp.mean(section, axis=0)), axis=0))
    size = jnp.sqrt(jnp.mean(squares(section), axis=0))
    place = jnp.arange(count)
    newest = count - 1

    def error(n):
        latest = newest - (newest - place) % n
        ahead = jnp.minimum(place + n, latest)  # itself near the end
        away = [
            jnp.max(squares(jnp.take(section, other, axis=0) - section), axis=0)
            for other in (ahead, latest)
        ]
        distance = jnp.sqrt(jnp.maximum(*away))
        still = distance <= 0  # at rest; a state that is not a number is not
        scale = jnp.where(n == 1, size, spread)
        return jnp.where(still, 0.0, distance / jnp.where(still, 1.0, scale))

    errors = lax.map(error, jnp.arange(1, max_period + 1, dtype=jnp.int32))
    fits = errors <= tolerance
    first = jnp.argmax(fits, axis=0)
    found = jnp.any(fits, axis=0)
    least = jnp.min(jnp.where(jnp.isnan(errors), jnp.inf, errors), axis=0)
    own = jnp.take_along_axis(errors, first[None], axis=0)[0]
    return jnp.where(found, first + 1, 0).astype(jnp.int32), jnp.where(found, own, least)


def iterated(advance, state, count: int):
    """Return the state after `count` calls, and those after every one."""
    return lax.scan(lambda s, _: (advance(s),) * 2, state, None, length=count)


@compiled
def observe(
    march: AbstractMarch, frequency, state, transient, tolerance, periods, max_period, lyapunov
):
    """March a transient and observe so many periods of what lasts; states lead with the lanes."""
    before = jnp.full(frequency.shape, transient, jnp.int32)
    if lyapunov:
        start, end, section, growth = grown(march, frequency, state.T, before, periods)
        exponent, error = mean_rate(growth, 2 * jnp.pi / frequency)
    else:
        start, _, _ = march(state.T, frequency, before, False)
        end, section = iterated(drive_period(march, frequency), start, periods)
        exponent = error = jnp.full(frequency.shape, jnp.nan)
    period, away = period_number(section * march.energy_weight(), tolerance, max_period)
    alive = jnp.all(jnp.isfinite(end), axis=0)
    return {
        "start": start.T,
        "end": end.T,
        "period": jnp.where(alive, period, 0),
        "return_error": jnp.where(alive, away, jnp.nan),
        "lyapunov_exponent": exponent,
        "lyapunov_standard_error": error,
        "alive": alive,
    }
