"""How the lanes of a map are cut into chunks: blocks of its grid, all of one shape."""

import itertools
from typing import NamedTuple

import numpy as np


class Block(NamedTuple):
    """One chunk: where it lies in the grid, and the indices it is computed at."""

    number: int
    region: tuple[slice, ...]
    """Where its results belong."""
    indices: tuple[np.ndarray, ...]
    """Indices along every dimension, the last one repeated at the edge of the grid up to the full
    length: all chunks have one shape and compile once."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of its part of the grid."""
        return tuple(part.stop - part.start for part in self.region)

    @property
    def lanes(self) -> int:
        """How many lanes of the grid it holds."""
        return int(np.prod(self.shape, dtype=int))

    @property
    def inside(self) -> np.ndarray:
        """Which of the lanes that are computed belong to the grid."""
        kept = [np.arange(len(i)) < n for i, n in zip(self.indices, self.shape, strict=True)]
        grid = np.ones((), bool)
        for one in kept:
            grid = np.logical_and.outer(grid, one)
        return grid.ravel()


class Chunks(NamedTuple):
    """A grid of lanes cut into blocks."""

    shape: tuple[int, ...]
    """Lengths of the dimensions of the grid."""
    block: tuple[int, ...]
    """Lengths of a block."""

    @property
    def counts(self) -> tuple[int, ...]:
        """How many blocks lie along every dimension."""
        return tuple(-(-n // b) for n, b in zip(self.shape, self.block, strict=True))

    @property
    def number(self) -> int:
        """How many blocks there are."""
        return int(np.prod(self.counts, dtype=int))

    @property
    def lanes_per_block(self) -> int:
        """How many lanes are computed together."""
        return int(np.prod(self.block, dtype=int))

    def at(self, number: int) -> Block:
        """Return a block by its number."""
        where = np.unravel_index(number, self.counts) if self.counts else ()
        parts = []
        for k, b, n in zip(where, self.block, self.shape, strict=True):
            parts.append(slice(int(k) * b, min((int(k) + 1) * b, n)))
        index = tuple(
            np.minimum(np.arange(part.start, part.start + b), n - 1)
            for part, b, n in zip(parts, self.block, self.shape, strict=True)
        )
        return Block(number, tuple(parts), index)


def cut(shape: tuple[int, ...], single: tuple[bool, ...], lanes: int) -> Chunks:
    """Cut a grid into equal blocks of at most so many lanes, the last dimensions kept together.

    Along dimensions that are `single` a block has length 1.
    """
    block = [1] * len(shape)
    room = max(1, lanes)
    for k in reversed(range(len(shape))):
        if single[k]:
            continue
        block[k] = _even(shape[k], min(room, shape[k]))
        room //= block[k]
        if room < 2:
            break
    return Chunks(shape, tuple(block))


def _even(size: int, most: int) -> int:
    """Return the length of blocks that cover an axis with the least computed twice."""
    fewest = -(-size // most)
    lengths = [-(-size // parts) for parts in range(fewest, 2 * fewest + 1)]
    return min(lengths, key=lambda length: (-(-size // length) * length - size, -length))


def spread_out(shape: tuple[int, ...], lanes: int) -> list[tuple[int, ...]]:
    """Return up to so many combinations, spread evenly over a grid."""
    total = int(np.prod(shape, dtype=object))
    if total <= lanes:
        return list(itertools.product(*map(range, shape)))
    # Steps of the golden ratio visit all parts of every dimension.
    numbers = sorted({int((k * 0.6180339887498949) % 1.0 * total) for k in range(lanes)})
    return [tuple(int(i) for i in np.unravel_index(n, shape)) for n in numbers]
