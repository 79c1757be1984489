"""Derivatives of a solution without those of the search that found it."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from vibrojax._tools.compiled import compiled

Result = TypeVar("Result")


def frozen(tree: Any) -> Any:
    """Return the tree as constants to differentiation."""
    return jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, tree)


def with_columns(
    function: Callable[..., Result], numbers: Any, *constants: Any, first_only: str = ""
) -> Result:
    """Return `function(numbers, *constants)` with derivatives in both modes, from forward mode.

    The Jacobian is formed column by column, one per number, and only when a derivative is asked
    for: so what reverse mode cannot do (loops of unknown length) need not be, and derivatives
    outside of other transformations are a compiled program, as the values are. `numbers` is a
    PyTree of arrays, as `function` returns one; it has no derivative in the `constants`. What JAX
    is tracing must be among them, not closed over.

    Raises `ValueError` for derivatives of derivatives where the first ones alone are right:
    `first_only` is what it says.
    """
    flat, unravel = ravel_pytree(numbers)
    arrays, held = eqx.partition(frozen(constants), eqx.is_array)
    structure = []  # of one, known when the values are

    @jax.custom_jvp
    def values(x, arrays):
        found = function(unravel(x), *eqx.combine(arrays, held))
        structure[:] = [jax.tree.structure(found)]
        return jax.tree.leaves(found)

    @values.defjvp
    def values_jvp(primals, tangents):
        (x, arrays), (change, _) = primals, tangents
        found, columns = _columns(function, unravel(x), eqx.combine(arrays, held))
        out, structure[:] = jax.tree.leaves(found), [jax.tree.structure(found)]
        left = iter(_once(columns, first_only) if first_only else columns)
        changes = [
            (next(left) @ change).astype(a.dtype)
            if _is_smooth(a)
            else np.zeros(a.shape, jax.dtypes.float0)
            for a in out
        ]
        return out, changes

    leaves = values(flat, arrays)
    return jax.tree.unflatten(structure[0], leaves)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def _once(columns: list[Any], refusal: str) -> list[Any]:
    """Derivatives that have none themselves."""
    return columns


@_once.defjvp
def _once_jvp(refusal: str, primals: Any, tangents: Any) -> Any:
    raise ValueError(refusal)


def compile_columns_ahead(function: Callable[..., Any], numbers: Any, *constants: Any) -> None:
    """Compile the Jacobian of `with_columns` in the background; of constants the shapes count."""
    _columns.ahead(function, frozen(numbers), constants)


def _is_smooth(array: Any) -> bool:
    return jnp.issubdtype(array.dtype, jnp.inexact)


@compiled(lightly=True)
def _columns(function: Callable[..., Result], numbers: Any, constants: Any) -> Any:
    """What is returned, and Jacobians of what of it has one, the numbers along the last axis."""
    flat, unravel = ravel_pytree(numbers)

    def smooth(x):
        found = function(unravel(x), *constants)
        return [jnp.asarray(a) for a in jax.tree.leaves(found) if _is_smooth(a)], found

    columns, found = jax.jacfwd(smooth, has_aux=True)(flat)
    return found, columns
