"""What signals may be between places at which they are read.

Every number here is an array of lanes of its own, block by block and signal by signal: of what is
computed from such arrays XLA makes one loop over lanes, in which nothing is computed twice and
nothing is stored. With arrays of places, blocks and signals it took twice as long on a CPU.
Elsewhere all places are read at once, as a product with a table of turns: of what is written out
place by place XLA takes minutes to make a program for a GPU.
"""

from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, DTypeLike, Float

from vibrojax._tools.trigonometry import cosine_and_sine
from vibrojax.stepping.turns import Rows, Turn, turned_rows

T = TypeVar("T")

SHAPE = 16 / 6
"""Middle coefficient of 16 x^2 (1 - x)^2, the shape of a cubic's largest error, as a quartic."""
SLOPE = 384 * 3**0.5 / 216
"""Bound of the error of the cubic's slope over that of its value (Birkhoff and Priver, Hermite
interpolation errors for derivatives, 1967)."""


class Errors(NamedTuple):
    """How far signals may be from the cubics through them, by signal and lane."""

    cubic: Float[Array, "signals *lanes"]
    """At the middle of an interval, falling off towards its ends as the error of a cubic does."""
    cubic_of_parts: Float[Array, "signals *lanes"]
    flat: Float[Array, "signals *lanes"]
    """Anywhere in an interval, of blocks that turn too far in it."""
    size: Float[Array, "signals *lanes"]
    """What rounding is a share of."""


def errors_of(amplitude: Float[Array, "blocks signals *lanes"], turn: Array, parts: int) -> Errors:
    """Bounds from the largest amplitudes and the turns over an interval, rad; also on its parts."""
    cubic, of_parts = turn**4 / 384, (turn / parts) ** 4 / 384
    # However fast a block turns, the cubic through it is no higher than its ends make it.
    flat = 2 + 0.3 * turn
    slow = SHAPE * cubic <= flat
    kinds = jnp.where(slow, cubic, 0.0), of_parts, jnp.where(slow, 0.0, flat), 1 + turn
    of_blocks = (zip(amplitude, kind, strict=True) for kind in kinds)
    return Errors(*(reduce(jnp.add, [a * k for a, k in blocks]) for blocks in of_blocks))


class Margin(NamedTuple):
    """What bounds are moved by."""

    cubic: Float[Array, "signals *lanes"]
    """Error of the cubic at the middle of an interval."""
    more: Float[Array, "signals *lanes"]
    """All else, less what counts as none."""


Pairs = list[tuple[Array, Array]]
"""Both rows of every block."""
Place = list[tuple[Array, Array]]
"""Values of signals, and thirds of their slopes per interval."""
Span = tuple[Place, Place]
"""Both ends of an interval; of several where their arrays have these as leading axis."""


def spans_ahead(
    rows: Float[Array, "2 blocks kinds signals *lanes"],
    rest: Float[Array, "signals *lanes"],
    blocks: Float[Array, "2 blocks *lanes"],
    step: Float[Array, "*lanes"],
    turn: Turn,
    count: int,
) -> list[Span]:
    """Read signals at the ends of so many intervals of `step` (s), in each of which blocks turn."""
    read = _reader(rows, rest, step)
    turns, ahead = list(zip(*turn, strict=True)), list(zip(*blocks, strict=True))
    places = [read(ahead)]
    for _ in range(count):
        ahead = _turned(turns, ahead)
        places.append(read(ahead))
    return list(pairwise(places))


def _turned(turns: list[tuple[Array, ...]], blocks: Pairs) -> Pairs:
    return [turned_rows(*both) for both in zip(turns, blocks, strict=True)]


def _reader(rows: Array, rest: Array, step: Array) -> Callable[[Pairs], Place]:
    """Function that reads signals of blocks."""
    first, second = ([list(map(list, block)) for block in side] for side in rows)

    def row(kind: int, signal: int, blocks: Pairs) -> Array:
        ahead = zip(first, second, blocks, strict=True)
        terms = [a[kind][signal] * x + b[kind][signal] * y for a, b, (x, y) in ahead]
        return reduce(jnp.add, terms)

    def read(blocks: Pairs) -> Place:
        signals = range(len(rest))
        return [(row(0, s, blocks) + rest[s], row(1, s, blocks) * (step / 3)) for s in signals]

    return read


def turns_ahead(
    decay: Rows,
    rate: Float[Array, "blocks *lanes"],
    step: Float[Array, "*lanes"],
    count: int,
    kind: DTypeLike,
) -> Turn:
    """Turns over no interval of `step` (s), over one, and so on: places behind the blocks."""
    time = jnp.arange(count + 1.0).reshape(-1, *(1,) * step.ndim) * step
    first, second = jnp.exp((decay[:, :, None] * time).astype(kind))
    angle = rate[:, None] * time
    c, s = cosine_and_sine((angle - 2 * jnp.pi * jnp.round(angle / (2 * jnp.pi))).astype(kind))
    return Turn(first * c, second * c, first * s)


def spans_at_once(
    rows: Float[Array, "2 blocks kinds signals *lanes"],
    rest: Float[Array, "signals *lanes"],
    blocks: Float[Array, "2 blocks *lanes"],
    step: Float[Array, "*lanes"],
    turns: Turn,
) -> list[Span]:
    """The same by `turns_ahead`, as one entry of all intervals."""
    there = _turned(list(zip(*turns, strict=True)), list(zip(*blocks, strict=True)))
    read = _reader(rows, rest, step)(there)
    return [(jax.tree.map(lambda a: a[:-1], read), jax.tree.map(lambda a: a[1:], read))]


def first_of(
    none: Float[Array, "*lanes"], hits: list[Bool[Array, "*where"]], each: list[T]
) -> tuple[Float[Array, "*lanes"], T]:
    """First of the intervals that are hit, and what belongs to it; else `none` and something.

    One entry has all intervals as its leading axis, as `spans_at_once` returns them.
    """
    if len(hits) == 1:
        place = jnp.argmax(hits[0], axis=0)[None]
        found = jnp.where(jnp.any(hits[0], axis=0), place[0], none)
        return found, jax.tree.map(lambda a: jnp.take_along_axis(a, place, axis=0)[0], each[0])
    found, chosen = none, each[-1]
    for k in reversed(range(len(hits))):
        found = jnp.where(hits[k], k, found)
        choose = lambda new, old, k=k: jnp.where(hits[k], new, old)  # noqa: E731
        chosen = jax.tree.map(choose, each[k], chosen)
    return found, chosen


class Bounds(NamedTuple):
    """What a signal is known to be between two places."""

    top: Float[Array, "*lanes"]
    bottom: Float[Array, "*lanes"]
    rises: Bool[Array, "*lanes"]
    """Whether it does nothing but rise."""


def bounds_between(
    start: Place, end: Place, errors: Float[Array, "signals *lanes"]
) -> list[Bounds]:
    """Bounds of signals between two places."""
    found = []
    for (b0, early), (b3, late), error in zip(start, end, errors, strict=True):
        b1, b2 = b0 + early, b3 - late
        near, far, middle = (b0 + 3 * b1) / 4, (3 * b2 + b3) / 4, (b1 + b2) / 2
        top = jnp.maximum(jnp.maximum(near, far), jnp.maximum(middle + SHAPE * error, b3))
        bottom = jnp.minimum(jnp.minimum(near, far), middle - SHAPE * error)
        bottom = jnp.minimum(bottom, jnp.minimum(b0, b3))
        rise = jnp.minimum(jnp.minimum(b1 - b0, b2 - b1), b3 - b2)
        found.append(Bounds(top, bottom, 3 * rise > SLOPE * error))
    return found
