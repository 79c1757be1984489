"""Small numerical pieces shared by the steppers."""

from collections.abc import Callable
from functools import partial, reduce
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax._tools.types import AnyArray

T = TypeVar("T")

FEW = 16
"""Lanes for which one call per product of large matrices costs little."""


def on_cpu() -> bool:
    """Whether programs run on a CPU, where they are written otherwise than for a GPU."""
    return jax.default_backend() == "cpu"


def computed_once(tick: Int[Array, ""], compute: Callable[[], T]) -> T:
    """Return `compute()`, evaluated once although several results are made from it.

    XLA's CPU backend repeats a shared intermediate inside every fused loop that uses it. A branch
    is a border that fusion does not cross: it made the step of `ExactContact` 2.4 times faster.
    `tick` is any counter that never is negative, which the compiler cannot know.
    """
    if not on_cpu():
        return compute()
    compute = jax.jit(compute)  # is traced once for both uses, which takes long
    shapes = jax.eval_shape(compute)
    return jax.lax.cond(
        tick >= 0, compute, lambda: jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)
    )


def where_needed(needed: Bool[Array, ""], compute: Callable[[], T], otherwise: T) -> T:
    """Return `compute()`, which is `otherwise` where it is not `needed`; then a CPU leaves it out.

    Elsewhere a branch costs more than the computing.
    """
    if not on_cpu():
        return compute()
    return jax.lax.cond(needed, compute, lambda: otherwise)


def varied(start: T, *numbers: Float[AnyArray, "..."]) -> T:
    """Return what a loop starts with as if all of it depended on some numbers.

    JAX tries what of a loop has derivatives and lanes, and traces the body anew for every trial:
    where all that will depend on the numbers does from the start, the first is right.
    """
    number = sum(jnp.ravel(number)[0] for number in numbers)
    return jax.tree.map(
        lambda a: jnp.where(False, jnp.asarray(number, jnp.asarray(a).dtype), a), start
    )


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
    along = partial(jax.lax.index_in_dim, keepdims=False)
    return reduce(jnp.add, [along(matrix, j, 1) * along(vector, j, 0) for j in range(len(vector))])


def matrix_product(
    first: Float[Array, "rows inner *#lanes"], second: Float[Array, "inner columns *#lanes"]
) -> Float[Array, "rows columns *lanes"]:
    """Product of a matrix with another, for every lane."""
    if len(second) > 16 or first.ndim == 2:
        return jnp.einsum("ij...,jk...->ik...", first, second)
    # One fused loop here too.
    return reduce(jnp.add, [first[:, j, None] * second[j] for j in range(len(second))])


def solve_small(
    matrix: Float[Array, "rows rows *#lanes"], right: Float[Array, "rows *#lanes"]
) -> Float[Array, "rows *lanes"]:
    """Solve (1 + matrix) x = right; up to two in closed form, as a library call costs a step."""
    if right.shape[0] == 1:
        return right / (1 + matrix[0])
    if right.shape[0] == 2:
        (a, b), (c, d) = matrix
        a, d = 1 + a, 1 + d
        crossed = jnp.stack([d * right[0] - b * right[1], a * right[1] - c * right[0]])
        return crossed / (a * d - b * c)
    whole = jnp.eye(right.shape[0]) + jnp.moveaxis(matrix, (0, 1), (-2, -1))
    found = jnp.linalg.solve(whole, jnp.moveaxis(right, 0, -1)[..., None])[..., 0]
    return jnp.moveaxis(found, -1, 0)


def by_halves(join: Callable[[T, T], T], terms: T, axis: int = 0) -> T:
    """Join what lies along an axis of arrays, halves at a time.

    XLA fuses and vectorises that, which it does not do with a reduction.
    """

    def part(terms: T, first: int, last: int) -> T:
        return jax.tree.map(lambda a: jax.lax.slice_in_dim(a, first, last, axis=axis), terms)

    odd = []
    while (count := jax.tree.leaves(terms)[0].shape[axis]) > 1:
        half = count // 2
        if count % 2:
            odd.append(part(terms, count - 1, count))
        terms = join(part(terms, 0, half), part(terms, half, 2 * half))
    return jax.tree.map(lambda a: jnp.squeeze(a, axis), reduce(join, odd, terms))


def total(terms: Array, axis: int = 0) -> Array:
    """Sum along an axis."""
    return by_halves(jnp.add, terms, axis)


def pick(index: Int[Array, "*#lanes"], table: Array) -> Array:
    """Take the row of each lane: `where` for the usual two, which XLA fuses; no gather."""
    chosen = table[0]
    for i in range(1, table.shape[0]):
        chosen = jnp.where(index == i, table[i], chosen)
    return chosen
