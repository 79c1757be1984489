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
        grid = np.zeros([len(i) for i in self.indices], bool)
        grid[tuple(map(slice, self.shape))] = True
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
        region, indices = [], []
        for k, b, n in zip(where, self.block, self.shape, strict=True):
            region.append(slice(int(k) * b, min((int(k) + 1) * b, n)))
            indices.append(np.minimum(np.arange(b) + int(k) * b, n - 1))
        return Block(number, tuple(region), tuple(indices))


def cut(shape: tuple[int, ...], single: tuple[bool, ...], lanes: int) -> Chunks:
    """Cut a grid into equal blocks of at most so many lanes, the last dimensions kept together.

    Along dimensions that are `single` a block has length 1.
    """
    block, room = [1] * len(shape), max(1, lanes)
    for k in reversed(range(len(shape))):
        if not single[k] and room > 1:
            # Of the lengths that cover the axis, the one with the least computed twice.
            size, fewest = shape[k], -(-shape[k] // room)
            lengths = {-(-size // parts) for parts in range(fewest, 2 * fewest + 1)}
            block[k] = min(lengths, key=lambda one, n=size: (-(-n // one) * one - n, -one))
            room //= block[k]
    return Chunks(shape, tuple(block))


def spread_out(shape: tuple[int, ...], lanes: int) -> list[tuple[int, ...]]:
    """Return up to so many combinations, spread evenly over a grid."""
    if np.prod(shape, dtype=object) <= lanes:
        return list(itertools.product(*map(range, shape)))
    from scipy.stats.qmc import Halton

    places = Halton(len(shape), scramble=False).random(lanes)
    return sorted({tuple(map(int, place)) for place in places * np.array(shape)})
