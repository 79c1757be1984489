"""One program of XLA: what it takes and returns, and when it is compiled."""

import functools
import gc
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.interrupts import in_background

QUICK: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False}
"""Halves what XLA takes on a CPU."""
WIDE: dict[str, Any] = {"xla_cpu_prefer_vector_width": 512}
"""Takes a fifth off the march where a processor has AVX-512; elsewhere it costs a third."""
LIGHT = {"xla_backend_optimization_level": 0}
"""Takes a third off that; the program is slower by half."""
LINES = "jax_traceback_in_locations_limit"


class Parts(NamedTuple):
    """What a program returns beside its arrays."""

    structure: Any
    held: tuple[Any, ...]
    is_array: tuple[bool, ...]

    def filled(self, arrays: Sequence[Any]) -> Any:
        """Put arrays into their places."""
        left = iter(arrays)
        both = zip(self.held, self.is_array, strict=True)
        return jax.tree.unflatten(self.structure, [next(left) if a else h for h, a in both])


ARRAYS = (jax.Array, np.ndarray, np.generic, jax.ShapeDtypeStruct)
"""What is an array, or stands for one. Not asked by a function: calls have hundreds of leaves."""


def sorted_out(thing: Any) -> tuple[list[Any], Parts]:
    """Return the arrays of a tree, and what it is without them."""
    leaves, structure = jax.tree.flatten(thing)
    is_array = tuple(isinstance(leaf, ARRAYS) for leaf in leaves)
    both = list(zip(leaves, is_array, strict=True))
    held = tuple(None if a else leaf for leaf, a in both)
    return [leaf for leaf, a in both if a], Parts(structure, held, is_array)


def kinds_of(arrays: Sequence[Any]) -> list[jax.ShapeDtypeStruct]:
    """Shapes and kinds of arrays; one that was made of a Python number is like any other."""
    canonical = jax.dtypes.canonicalize_dtype
    return [jax.ShapeDtypeStruct(a.shape, canonical(a.dtype)) for a in arrays]


class Program:
    """A function traced for one signature; compiled when it is needed first."""

    def __init__(self, traced: Callable[..., Any], returned: list[Parts], lightly: bool):
        given = options() | (LIGHT if lightly else {})
        self.traced: Any = jax.jit(traced, compiler_options=given)
        self.returned = returned
        """Of one; empty before the function was traced."""
        self.shapes: list[jax.ShapeDtypeStruct] | None = None
        """Of the arrays it returns; None before they were asked for, or it was compiled."""
        self.waiting: Future[Any] | None = None
        self.call: Callable[..., Any] | None = None
        """None before it was compiled."""

    @property
    def is_new(self) -> bool:
        """Whether it is neither compiled nor about to be."""
        return self.call is None and self.waiting is None

    def kinds(self, arrays: Sequence[Any]) -> Any:
        """What it returns, with `jax.ShapeDtypeStruct` in the place of arrays."""
        if self.shapes is None:
            self.shapes = kinds_of(jax.eval_shape(self.traced, *kinds_of(arrays)))
        return self.returned[0].filled(self.shapes)

    def compile(self, arrays: Sequence[Any]) -> None:
        """Compile it, or wait until that is done."""
        if self.waiting is None:
            self.call = self._lowered(arrays).compile()
        else:
            self.call = self.waiting.result()
        self.traced = self.waiting = None  # which hold a lot of memory

    def compile_ahead(self, arrays: Sequence[Any]) -> None:
        """Compile it in the background, unless that is done already."""
        if self.is_new:
            self.waiting = in_background(self._lowered(arrays).compile)

    def _lowered(self, arrays: Sequence[Any]) -> Any:
        with tracing():
            lowered = self.traced.lower(*kinds_of(arrays))
        self.shapes = kinds_of(lowered.out_info)
        return lowered


@functools.cache
def options() -> dict[str, Any]:
    """Options for XLA that this one knows and the processor is made for."""
    wanted = QUICK | (WIDE if _has_wide_vectors() else {})
    if _are_known(wanted):
        return wanted
    return {name: value for name, value in wanted.items() if _are_known({name: value})}


def _are_known(options: dict[str, Any]) -> bool:
    with suppress(Exception):
        jax.jit(jnp.negative, compiler_options=options)(0.0)
        return True
    return False


def _has_wide_vectors() -> bool:
    """Whether the processor says that it has AVX-512; only Linux is asked."""
    with suppress(OSError), Path("/proc/cpuinfo").open() as lines:
        return " avx512f " in next((line for line in lines if line.startswith("flags")), "")
    return False


@contextmanager
def tracing() -> Iterator[None]:
    """Leave out what takes time and nobody looks at.

    Garbage stays where it is: tracing makes hardly any, and much that is looked through for it. And
    no operation knows which lines of Python it is from, which XLA copies from pass to pass.
    """
    collects, lines = gc.isenabled(), getattr(jax.config, LINES, 0)
    gc.disable()
    if lines:
        jax.config.update(LINES, 0)
    try:
        yield
    finally:  # by the thread that found them on, if several trace
        if collects:
            gc.enable()
        if lines:
            jax.config.update(LINES, lines)


def rounded_up(count: int, digits: int) -> int:
    """Return the next number with so many leading binary digits: few counts mean few programs."""
    grain = 2 ** max(int(count).bit_length() - digits, 0)
    return -(-count // grain) * grain
