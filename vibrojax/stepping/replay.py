"""A loop of as many rounds as it takes, which reverse mode can differentiate."""

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

lax = jax.lax
T = TypeVar("T")


def replayed_while(
    going: Callable[[T], Bool[Array, ""]],
    body: Callable[[T, Int[Array, ""]], T],
    start: T,
    most: int,
) -> T:
    """Return what `while going(x): x = body(x, round)` ends with, `most` rounds at the most.

    The way back replays the rounds that were made, and no others, from what each began with: room
    for `most` of them is kept, and costs no time. Forward mode needs `lax.while_loop` itself.
    """
    rounds = eqx.filter_closure_convert(body, start, jnp.int32(0))
    return _loop((rounds, start), eqx.filter_closure_convert(going, start), most)


@eqx.filter_custom_vjp
def _loop(rounds_and_start, going, most):
    rounds, start = rounds_and_start

    def on(carry):
        return going(carry[0]) & (carry[1] < most)

    def one(carry):
        return rounds(*carry), carry[1] + 1

    return lax.while_loop(on, one, (start, jnp.int32(0)))[0]


@_loop.def_fwd
def _forward(perturbed, rounds_and_start, going, most):
    rounds, start = rounds_and_start
    room = jax.tree.map(lambda a: jnp.zeros((most, *a.shape), a.dtype), start)

    def on(carry):
        return going(carry[0]) & (carry[1] < most)

    def one(carry):
        state, tick, kept = carry
        kept = jax.tree.map(lambda room, now: room.at[tick].set(now), kept, state)
        return rounds(state, tick), tick + 1, kept

    end, count, kept = lax.while_loop(on, one, (start, jnp.int32(0), room))
    return end, (count, kept)


@_loop.def_bwd
def _backward(residuals, slope, perturbed, rounds_and_start, going, most):
    count, kept = residuals
    rounds, start = rounds_and_start
    numbers, fixed = eqx.partition(rounds, eqx.is_inexact_array)
    none = jax.tree.map(jnp.zeros_like, eqx.filter((numbers, start), eqx.is_inexact_array))

    def one(carry):
        tick, slope_of_numbers, slope = carry
        begun = jax.tree.map(lambda a: a[tick], kept)
        varied, counts = eqx.partition(begun, eqx.is_inexact_array)

        def ended(numbers, varied):
            end = eqx.combine(numbers, fixed)(eqx.combine(varied, counts), tick)
            return eqx.filter(end, eqx.is_inexact_array)

        _, pull = jax.vjp(ended, numbers, varied)
        more, slope = pull(slope)
        return tick - 1, jax.tree.map(jnp.add, slope_of_numbers, more), slope

    # Where a result is not used its slope is None.
    first = count - 1, none[0], eqx.combine(slope, none[1])
    return lax.while_loop(lambda carry: carry[0] >= 0, one, first)[1:]
