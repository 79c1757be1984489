"""Numbers of many lanes as one table, a lane a row: how they go to programs and come back.

A call with sixty small arrays costs more than most programs take; a table is one array.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from operator import getitem
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.stepping.elementary import on_cpu

Kinds = tuple[tuple[tuple[int, ...], str], ...]

PLACE = "array"
"""Stands for an array in the tree that a table was made of."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LaneTable:
    """A tree of arrays of lanes; what is no array in it is kept as it is."""

    numbers: Any
    """Shape (lanes, columns); stands for other things where JAX takes trees apart."""
    like: Any
    """The tree, `PLACE` in the place of arrays."""
    kinds: Kinds = field(metadata={"static": True})
    """Shape for one lane, and kind, of the arrays."""

    def columns(self) -> Any:
        """Return the tree as views of the table in numpy: the lanes lead, all numbers are floats.

        What is written into them is in the table.
        """
        numbers = np.asarray(self.numbers)
        parts = [
            numbers[:, at].reshape(len(numbers), *shape) for at, shape, _ in _places(self.kinds)
        ]
        return self._filled(parts)

    def lanes_last(self) -> Any:
        """Return the tree as arrays of JAX with the lanes as the trailing axis."""
        numbers = jnp.asarray(self.numbers).T
        parts = [
            numbers[at].reshape(*shape, -1).astype(kind)
            if np.prod(shape)
            else jnp.zeros((*shape, numbers.shape[1]), kind)
            for at, shape, kind in _places(self.kinds)
        ]
        return self._filled(parts)

    def pick(self, lanes: np.ndarray) -> "LaneTable":
        """Return the table of some lanes, in numpy or `on_device`."""
        there = isinstance(self.numbers, jax.Array)
        return replace(self, numbers=(_rows if there else getitem)(self.numbers, lanes))

    def on_device(self) -> "LaneTable":
        """Return the table where programs have no long way to it: on a CPU numpy's own memory."""
        return self if on_cpu() else replace(self, numbers=jax.device_put(self.numbers))

    def _filled(self, parts: Sequence[Any]) -> Any:
        left = iter(parts)
        leaves, structure = jax.tree.flatten(self.like)
        is_place = [isinstance(a, str) and a == PLACE for a in leaves]
        both = zip(leaves, is_place, strict=True)
        return jax.tree.unflatten(structure, [next(left) if a else leaf for leaf, a in both])


_rows = jax.jit(getitem)
"""Rows of an array on a device: `jit` is called faster than indexing."""


@lru_cache
def _places(kinds: Kinds) -> list[tuple[slice, tuple[int, ...], str]]:
    """Columns, shape for one lane and kind of the arrays."""
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape, _ in kinds)]).tolist()
    both = zip(kinds, ends[:-1], ends[1:], strict=True)
    return [(slice(a, b), shape, kind) for (shape, kind), a, b in both]


def table_of(tree: Any, *, lanes: int | None = None, xp: ModuleType = jnp) -> LaneTable:
    """Put a tree of arrays with the lanes as the trailing axis into a table.

    With `lanes` the table is one of zeros for so many; the arrays may be shapes only.
    """
    leaves, structure = jax.tree.flatten(tree)
    is_array = [hasattr(a, "shape") for a in leaves]
    arrays = [leaf for leaf, a in zip(leaves, is_array, strict=True) if a]
    kinds = tuple((tuple(a.shape[:-1]), str(a.dtype)) for a in arrays)
    if lanes is None:
        whole = arrays[0].shape[-1]
        rows = [xp.reshape(a, (int(np.prod(a.shape[:-1])), whole)).astype(float) for a in arrays]
        numbers = xp.concatenate(rows).T
    else:
        numbers = np.zeros((lanes, sum(int(np.prod(shape)) for shape, _ in kinds)))
    if xp is np:
        numbers = np.ascontiguousarray(numbers)
    places = [PLACE if a else leaf for leaf, a in zip(leaves, is_array, strict=True)]
    return LaneTable(numbers, jax.tree.unflatten(structure, places), kinds)
