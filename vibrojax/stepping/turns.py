"""What a time does to the blocks of a phase: turns with decay, or two exponentials.

A turn is the matrix [[p, -q], [q, r]] of every block; turns of a block commute, and one after
another is the turn over both times.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from vibrojax._tools.trigonometry import cosine, cosine_and_sine
from vibrojax.stepping.elementary import computed_once, where_needed

Tick = Int[Array, ""]
Rows = Float[Array, "2 *#shape"]


class Turn(NamedTuple):
    """Turns of blocks, with their decay."""

    p: Float[Array, "*shape"]
    r: Float[Array, "*shape"]
    q: Float[Array, "*shape"]


def turn_over(
    decay: Float[Array, "2 blocks *#lanes"],
    rate: Float[Array, "blocks *#lanes"],
    time: Float[Array, "*#lanes"],
    creeps: Bool[Array, ""] | None = None,
) -> Turn:
    """Turns over a time, s. Real pairs have rate 0, and each row its own exponent.

    Where no pair `creeps`, r is p and need not be computed.
    """
    growth = jnp.exp(decay[0] * time)
    c, s = cosine_and_sine(rate * time)
    p = growth * c

    def apart() -> Array:
        return jnp.exp(decay[1] * time) * cosine(rate * time)

    return Turn(p, apart() if creeps is None else where_needed(creeps, apart, p), growth * s)


def short_turn(
    decay: Float[Array, "2 blocks *#lanes"],
    rate: Float[Array, "blocks *#lanes"],
    time: Float[Array, "*#lanes"],
) -> Turn:
    """The same, for times of at most a thousandth of every block's own: by series."""
    a, b = decay * time, rate * time
    growth = 1 + a * (1 + a / 2 * (1 + a / 3))
    c, s = 1 - b * b / 2, b * (1 - b * b / 6)
    return Turn(growth[0] * c, growth[1] * c, growth[0] * s)


def both(first: Turn, second: Turn) -> Turn:
    """One turn after another."""
    (p, r, q), (p2, r2, q2) = first, second
    return Turn(p * p2 - q * q2, r * r2 - q * q2, q * p2 + r * q2)


def repeated(turn: Turn, times: int) -> Turn:
    """A turn so many times, a power of two."""
    return turn if times == 1 else repeated(both(turn, turn), times // 2)


def squares(turn: Turn, count: int, tick: Tick) -> list[Turn]:
    """The turn once, twice, four times, ...: as many of them as `count`."""
    found = [turn]
    for _ in range(count - 1):
        found.append(computed_once(tick, partial(both, found[-1], found[-1])))
    return found


def doubled(
    after: Callable[[Turn, Array], Array], turns: Sequence[Turn], first: Array, tick: Tick
) -> Array:
    """Put behind what is along the third axis the same, turned further: once for every turn."""

    def further(turn, found):
        def wide(a):
            return a.reshape(a.shape[0], *(1,) * (found.ndim - 1 - a.ndim), *a.shape[1:])

        return jnp.concatenate([found, after(jax.tree.map(wide, turn), found)], axis=2)

    for turn in turns:
        first = computed_once(tick, partial(further, turn, first))
    return first


def turned(turn: Turn, blocks: Rows) -> Rows:
    """Block coordinates after a turn."""
    return jnp.stack(turned_rows(turn, blocks))


def turned_rows(turn: Sequence[Array], rows: Sequence[Array] | Array) -> tuple[Array, Array]:
    """Both rows of block coordinates after a turn, apart."""
    (p, r, q), (x, y) = turn, rows
    return p * x - q * y, q * x + r * y


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
    (first, second), (x, y) = rows, blocks
    both = zip(first, x, second, y, strict=True)
    return reduce(jnp.add, [a * u + b * v for a, u, b, v in both])
