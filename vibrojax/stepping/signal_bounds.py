"""What signals may be between places at which they are read.

Every number here is an array of lanes of its own, block by block and signal by signal: of what is
computed from such arrays XLA makes one loop over lanes, in which nothing is computed twice and
nothing is stored. With arrays of places, blocks and signals it took twice as long.
"""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from vibrojax.stepping.turns import Turn

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


Place = list[tuple[Array, Array]]
"""Values of signals, and thirds of their slopes per interval."""


def places_ahead(
    rows: Float[Array, "2 blocks kinds signals *lanes"],
    rest: Float[Array, "signals *lanes"],
    blocks: Float[Array, "2 blocks *lanes"],
    step: Float[Array, "*lanes"],
    turn: Turn,
    count: int,
) -> list[Place]:
    """Read signals now and after so many turns, an interval of `step` (s) each."""
    p, r, q, x, y = map(list, (*turn, *blocks))
    first, second = ([list(map(list, block)) for block in side] for side in rows)

    def read(kind: int, signal: int) -> Array:
        ahead = zip(first, second, x, y, strict=True)
        terms = [a[kind][signal] * u + b[kind][signal] * v for a, b, u, v in ahead]
        return reduce(jnp.add, terms)

    found = []
    for k in range(count + 1):
        if k:
            both = list(zip(p, r, q, x, y, strict=True))
            x = [p * x - q * y for p, _, q, x, y in both]
            y = [q * x + r * y for _, r, q, x, y in both]
        signals = range(len(rest))
        found.append([(read(0, s) + rest[s], read(1, s) * (step / 3)) for s in signals])
    return found


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
