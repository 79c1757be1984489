"""Derivatives of a solution without those of the search that found it."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree


def frozen(tree: Any) -> Any:
    """Return the tree as constants to differentiation."""
    return jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, tree)


def with_columns(function: Callable[..., Any], numbers: Any, *constants: Any) -> Any:
    """Return `function(numbers, *constants)` with derivatives in both modes, from forward mode.

    For functions that forward mode can differentiate and reverse mode cannot (loops of unknown
    length): the Jacobian is formed column by column, one per number, and only when a derivative is
    asked for. `numbers` is a PyTree of arrays; `function` returns one too. It has no derivative in
    the `constants`, PyTrees of arrays; what JAX is tracing must be among them, not closed over.
    """
    flat, unravel = ravel_pytree(numbers)
    shapes = jax.eval_shape(function, numbers, *constants)
    leaves, structure = jax.tree.flatten(shapes)
    inexact = [jnp.issubdtype(leaf.dtype, jnp.inexact) for leaf in leaves]

    @jax.custom_jvp
    def values(x, constants):
        return jax.tree.leaves(function(unravel(x), *constants))

    @values.defjvp
    def values_jvp(primals, tangents):
        (x, constants), (change, _) = primals, tangents

        def smooth(x):
            out = jax.tree.leaves(function(unravel(x), *constants))
            return [a for a, ok in zip(out, inexact, strict=True) if ok]

        out = values(x, constants)
        columns = iter(jax.jacfwd(smooth)(x))
        changes = [
            next(columns) @ change if ok else jnp.zeros(a.shape, jax.dtypes.float0)
            for a, ok in zip(out, inexact, strict=True)
        ]
        return out, changes

    return jax.tree.unflatten(structure, values(flat, frozen(constants)))
