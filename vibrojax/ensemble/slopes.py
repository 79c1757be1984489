"""Systems and their derivatives in named numbers, as data.

Only the small program that makes the systems depends on the user's function. What is computed of
them, and differentiated along, is compiled once for their structure.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from vibrojax._tools.compiled import compiled
from vibrojax.model.systems import AbstractSystem, as_arrays


class WithSlopes(NamedTuple):
    """Something, and its derivatives along some ways, which are the leading axis there."""

    made: Any
    slopes: Any


def with_slopes(build: Callable[..., Any], at: Any, ways: Any) -> WithSlopes:
    """Return what is built at one place, and its derivatives along the ways (leading axis)."""
    made, slopes = jax.vmap(lambda way: eqx.filter_jvp(build, (at,), (way,)), out_axes=(None, 0))(
        ways
    )
    count = len(jax.tree.leaves(ways)[0])
    fill = lambda a, b: jnp.zeros((count, *jnp.shape(a))) if b is None else b  # noqa: E731
    return WithSlopes(made, jax.tree.map(fill, made, slopes))


@compiled
def systems_with_slopes(
    make: Callable[..., AbstractSystem],
    static: dict[str, Any],
    names: tuple[str, ...],
    numbers: Mapping[str, Any],
) -> WithSlopes:
    """Make the systems of some lanes, and their derivatives in the numbers of these names.

    `numbers` are by lane. The axes of the derivatives are lanes, names.
    """

    def one(numbers):
        def build(moved):
            return as_arrays(make(**static, **(numbers | dict(zip(names, moved, strict=True)))))

        moved = jnp.stack([numbers[name] for name in names])
        return with_slopes(build, moved, jnp.eye(len(names)))

    return jax.vmap(one)(dict(numbers))
