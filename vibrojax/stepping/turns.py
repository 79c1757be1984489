"""What a time does to the blocks of a phase: turns with decay, or two exponentials.

A turn is the matrix [[p, -q], [q, r]] of every block, kept as (p, r, q) along its first axis; turns
of a block commute, and one after another is the turn over both times.
"""

from collections.abc import Callable, Sequence
from functools import partial

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from vibrojax._tools.trigonometry import cosine_and_sine
from vibrojax.stepping.elementary import computed_once, total

Turns = Float[Array, "3 *#shape"]
Tick = Int[Array, ""]
Rows = Float[Array, "2 *#shape"]


def turn_over(
    decay: Float[Array, "2 blocks *#lanes"],
    rate: Float[Array, "blocks *#lanes"],
    time: Float[Array, "*#lanes"],
) -> Float[Array, "3 blocks *lanes"]:
    """Turns over a time, s. Real pairs have rate 0, and each row its own exponent."""
    growth, angle = jnp.exp(decay * time), rate * time
    c, s = cosine_and_sine(angle)
    return jnp.stack([growth[0] * c, growth[1] * c, growth[0] * s])


def short_turn(
    decay: Float[Array, "2 blocks *#lanes"],
    rate: Float[Array, "blocks *#lanes"],
    time: Float[Array, "*#lanes"],
) -> Float[Array, "3 blocks *lanes"]:
    """The same, for times of at most a thousandth of every block's own: by series."""
    a, b = decay * time, rate * time
    growth = 1 + a * (1 + a / 2 * (1 + a / 3))
    c, s = 1 - b * b / 2, b * (1 - b * b / 6)
    return jnp.stack([growth[0] * c, growth[1] * c, growth[0] * s])


def both(first: Turns, second: Turns) -> Turns:
    """One turn after another."""
    (p, r, q), (p2, r2, q2) = first, second
    return jnp.stack([p * p2 - q * q2, r * r2 - q * q2, q * p2 + r * q2])


def squares(turn: Turns, count: int, tick: Tick) -> list[Turns]:
    """The turn once, twice, four times, ...: as many of them as `count`."""
    found = [turn]
    for _ in range(count - 1):
        found.append(computed_once(tick, partial(both, found[-1], found[-1])))
    return found


def doubled(
    after: Callable[[Array, Array], Array], turns: Sequence[Array], first: Array, tick: Tick
) -> Array:
    """Put behind what is along the third axis the same, turned further: once for every turn."""

    def further(turn, found):
        turn = turn.reshape(*turn.shape[:2], *(1,) * (found.ndim - turn.ndim), *turn.shape[2:])
        return jnp.concatenate([found, after(turn, found)], axis=2)

    for turn in turns:
        first = computed_once(tick, partial(further, turn, first))
    return first


def turned(turn: Turns, blocks: Rows) -> Rows:
    """Block coordinates after a turn."""
    (p, r, q), (x, y) = turn, blocks
    return jnp.stack([p * x - q * y, q * x + r * y])


def slope_row(
    decay: Float[Array, "2 *#shape"], rate: Float[Array, "*#shape"], row: Rows
) -> Float[Array, "2 *shape"]:
    """Row that reads the rate of what `row` reads, in free motion."""
    x, y = row
    return jnp.stack([x * decay[0] + y * rate, y * decay[1] - x * rate])


def product(
    rows: Float[Array, "2 blocks *#shape"], blocks: Float[Array, "2 blocks *#shape"]
) -> Float[Array, "*shape"]:
    """Sum over blocks and their two rows: one fused loop, where a reduction is not vectorised."""
    return total(total(rows * blocks, axis=1))
