"""Points in batches of one size, so that their number compiles nothing anew."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

BATCH = 64
"""Points computed at a time."""


def take(tree, index):
    """Pick lanes of a stacked tree."""
    return jax.tree.map(lambda a: a[index] if eqx.is_array(a) else a, tree)


def take_rigs(tree, rigs):
    """Pick rigs of a tree in which they are the trailing axis."""
    return jax.tree.map(lambda a: jnp.take(a, rigs, axis=-1) if eqx.is_array(a) else a, tree)


def filled_up(lanes: int, width: int) -> np.ndarray:
    """Index of the lanes, the last one repeated up to full widths: one program for all numbers."""
    return np.minimum(np.arange(-(-lanes // width) * width), lanes - 1)


def one_or_many(lanes: int, many: int) -> np.ndarray:
    """Index of the lanes, filled up to full widths of `many`; a single one has its own program."""
    return filled_up(lanes, 1 if lanes == 1 else many)


def in_batches(function, count: int, width: int = BATCH):
    """Run a function of an index over batches of one size, the last one filled up by repeats."""
    parts = [function(index) for index in filled_up(count, width).reshape(-1, width)]
    parts = jax.device_get(parts)
    return jax.tree.map(lambda *a: np.concatenate(a)[:count], *parts)
