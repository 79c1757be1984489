"""Maps of whole drive periods: what leads to their orbits, and which of these are to be taken."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from vibrojax.steady.settling import NEAR
from vibrojax.stepping.elementary import matrix_product

BENT = 0.25
"""Most that a step along the branch may differ from the one that the slopes at its ends give, over
its length: beyond, there may be a fold in between."""
STRAIGHT = 1e-3
"""Steps shorter than this, over the size of the motion, may be bent."""


def size_of(state: Float[Array, "states *lanes"]) -> Float[Array, "*lanes"]:
    """Length of vectors, one for every lane."""
    return jnp.sqrt(jnp.sum(state**2, axis=0))


def is_stable(matrix: Float[Array, "states states *lanes"]) -> Bool[Array, "*lanes"]:
    """Whether the spectral radius of period maps is below 1: their high powers vanish."""
    power = jax.lax.fori_loop(0, 12, lambda _, power: matrix_product(power, power), matrix)
    return jnp.sum(power**2, axis=(0, 1)) < 1.0


def to_return(
    matrix: Float[Array, "states states *lanes"], *gaps: Float[Array, "states *lanes"]
) -> list[Float[Array, "states *lanes"]]:
    """Changes of where motions begin that make up for gaps between end and beginning."""
    left = jnp.eye(len(matrix)) - jnp.moveaxis(matrix, (0, 1), (-2, -1))
    right = jnp.stack([jnp.moveaxis(gap, 0, -1) for gap in gaps], axis=-1)
    solved = jnp.linalg.solve(left, right)
    return [jnp.moveaxis(solved[..., k], -1, 0) for k in range(len(gaps))]


def continues(
    known: Bool[Array, "*lanes"],
    step: Float[Array, "states *lanes"],
    straight: Float[Array, "states *lanes"],
    size: Float[Array, "*lanes"],
) -> Bool[Array, "*lanes"]:
    """Whether motions go on from those that are `known`, a step away, or are near to guesses.

    Along one branch the slopes at both ends give the step between them, which is then `straight`.
    """
    bent, length = size_of(step - straight), size_of(step)
    return jnp.where(known, bent <= BENT * length + STRAIGHT * size, length <= 5 * NEAR * size)
