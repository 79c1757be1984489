"""Small numerical pieces shared by the steppers."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

T = TypeVar("T")

FEW = 16
"""Lanes for which one call per product of large matrices costs little."""


def computed_once(tick: Int[Array, ""], compute: Callable[[], T]) -> T:
    """Return `compute()`, evaluated once although several results are made from it.

    XLA's CPU backend repeats a shared intermediate inside every fused loop that uses it. A branch
    is a border that fusion does not cross: it made the step of `ExactContact` 2.4 times faster.
    `tick` is any counter that never is negative, which the compiler cannot know.
    """
    if jax.default_backend() != "cpu":
        return compute()
    shapes = jax.eval_shape(compute)
    return jax.lax.cond(
        tick >= 0, compute, lambda: jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)
    )


def where_needed(needed: Bool[Array, ""], compute: Callable[[], T], otherwise: T) -> T:
    """Return `compute()`, which is `otherwise` where it is not `needed`; then a CPU leaves it out.

    Elsewhere a branch costs more than the computing.
    """
    if jax.default_backend() != "cpu":
        return compute()
    return jax.lax.cond(needed, compute, lambda: otherwise)


def apply_matrix(
    matrix: Float[Array, "rows columns *#lanes"], vector: Float[Array, "columns *#lanes"]
) -> Float[Array, "rows *#lanes"]:
    """Matrix times vector, the matrix shared by all lanes or one for each."""
    if matrix.ndim == 2:
        return jnp.tensordot(matrix, vector, axes=1)
    if len(vector) > 16 and np.prod(matrix.shape[2:]) <= FEW:
        # So few lanes that calls count less than what takes so long to compile.
        return jnp.einsum("ij...,j...->i...", matrix, vector)
    # One fused loop over lanes, where a batch of products is one call for each of them.
    total = matrix[:, 0] * vector[0]
    for j in range(1, len(vector)):
        total = total + matrix[:, j] * vector[j]
    return total


def pick(index: Int[Array, "*#lanes"], table: Array) -> Array:
    """Take the row of each lane: `where` for the usual two, which XLA fuses; no gather."""
    chosen = table[0]
    for i in range(1, table.shape[0]):
        chosen = jnp.where(index == i, table[i], chosen)
    return chosen
