"""Of what period a motion is, from its states at every drive period (the stroboscopic map)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._tools.checks import check_count, check_positive

lax = jax.lax


class PeriodNumber(NamedTuple):
    """The period of some lanes."""

    period: Int[Array, "*lanes"]
    """Drive periods after which the motion repeats; 0 where no period was found."""
    return_error: Float[Array, "*lanes"]
    """Relative error of the return after that period; the least of all periods where it is 0."""


def period_number(
    section: Float[Array, "count states *lanes"],
    tolerance: Float[ArrayLike, ""],
    max_period: int,
) -> PeriodNumber:
    """Return the smallest n after which a record of states repeats, up to `max_period`.

    The states are those at the same drive phase of successive periods, weighted so that their norm
    is that of an energy. With period n every state of the record returns after n periods to within
    `tolerance` of the size of the motion, and lies as near to the newest state of its phase, so
    that a slow drift along a torus is no period. The size is the spread of the states about their
    mean; of a fixed point, n = 1, it is that of the states themselves: a motion whose states
    spread by less than `tolerance` of their size is called period 1.

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
    spread = jnp.sqrt(jnp.mean(_squares(section - jnp.mean(section, axis=0)), axis=0))
    size = jnp.sqrt(jnp.mean(_squares(section), axis=0))
    place = jnp.arange(count)
    newest = count - 1

    def error(n):
        ahead = jnp.minimum(place + n, newest - (newest - place) % n)  # itself near the end
        latest = newest - (newest - place) % n
        away = jnp.maximum(
            jnp.max(_squares(jnp.take(section, ahead, axis=0) - section), axis=0),
            jnp.max(_squares(jnp.take(section, latest, axis=0) - section), axis=0),
        )
        scale = jnp.where(n == 1, size, spread)
        away = jnp.sqrt(away)
        still = away <= 0  # at rest; a state that is not a number is not
        return jnp.where(still, 0.0, away / jnp.where(still, 1.0, scale))

    orders = jnp.arange(1, max_period + 1, dtype=jnp.int32)
    errors = lax.map(error, orders)
    fits = errors <= tolerance
    first = jnp.argmax(fits, axis=0)
    found = jnp.any(fits, axis=0)
    least = jnp.min(jnp.where(jnp.isnan(errors), jnp.inf, errors), axis=0)
    own = jnp.take_along_axis(errors, first[None], axis=0)[0]
    period = jnp.where(found, first + 1, 0).astype(jnp.int32)
    return PeriodNumber(period, jnp.where(found, own, least))


def _squares(states: Float[Array, "count states *lanes"]) -> Float[Array, "count *lanes"]:
    return jnp.sum(states**2, axis=1)
