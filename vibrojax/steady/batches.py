"""Points in batches of one size, so that their number compiles nothing anew."""

import equinox as eqx
import jax
import numpy as np

BATCH = 64
"""Points made exact at a time."""
REPAIRS = 3


def take(tree, index):
    """Pick lanes of a stacked tree."""
    return jax.tree.map(lambda a: a[index] if eqx.is_array(a) else a, tree)


def in_batches(function, count: int, width: int = BATCH):
    """Run a function of an index over batches of one size, the last one filled up by repeats."""
    parts = []
    for first in range(0, count, width):
        index = np.minimum(np.arange(first, first + width), count - 1)
        parts.append(function(index))
    parts = jax.device_get(parts)
    return jax.tree.map(lambda *a: np.concatenate(a)[:count], *parts)
