"""From the function of the rig to the rigs of a block, many at once where JAX can trace it."""

import contextlib
import hashlib
import itertools
import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.compiled import compiled
from vibrojax.ensemble.arguments import Arguments, default_of
from vibrojax.ensemble.lanes import made_by, stacked
from vibrojax.maps.chunks import Block
from vibrojax.maps.fingerprints import value_digest
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.stepping.prepared_rigs import Prepared, Rigs, prepare, prepared_kinds, rigs_of
from vibrojax.stepping.stepper import AbstractStepper

TOGETHER = 4096
"""Lanes whose systems are made together for their fingerprints."""
NO_RIGS = "none"
"""Stands for rigs that cannot be made."""
Numbers = tuple[dict[str, Any], ...]
"""Values along every dimension that is traced."""


@compiled
def _made(make, static: dict[str, Any], fixed: dict[str, Any], numbers: Numbers, with_modes: bool):
    # One vmap for each dimension: what depends on one of them only (the modes on taper and mass,
    # say) is computed once for its values, not for every lane.
    def level(depth: int, known: dict[str, Any]) -> Any:
        if depth == len(numbers):
            system = as_arrays(make(**static, **fixed, **known))
            return Rigs(system.equations(), system.drive) if with_modes else system
        return eqx.filter_vmap(lambda own: level(depth + 1, known | own))(numbers[depth])

    # Not -1 for the lanes: without stops some arrays have no elements.
    return jax.tree.map(
        lambda leaf: (
            leaf.reshape((math.prod(leaf.shape[: len(numbers)]), *leaf.shape[len(numbers) :]))
            if eqx.is_array(leaf)
            else leaf
        ),
        level(0, {}),
    )


def _on_host() -> contextlib.AbstractContextManager[Any]:
    """Compute on the processor of this host, where results are the same whatever else it has."""
    try:
        return jax.default_device(jax.local_devices(backend="cpu")[0])
    except RuntimeError:  # JAX may use others only
        return contextlib.nullcontext()


def _digests_of(systems: AbstractSystem, count: int = 1) -> list[str]:
    """Return what stands for each of so many equal parts of stacked systems."""
    arrays, others = eqx.partition(systems, eqx.is_array)
    alike = value_digest(others).encode()
    found = [hashlib.blake2b(alike, digest_size=8) for _ in range(count)]
    for leaf in jax.tree.leaves(arrays):
        for own, part in zip(found, np.split(np.asarray(leaf), count), strict=True):
            own.update(f"{part.dtype} {part.shape}".encode() + part.tobytes())
    return [own.hexdigest() for own in found]


class RigMaker:
    """The function of a map and what it is called with."""

    def __init__(self, make: Callable[..., AbstractSystem], arguments: Arguments) -> None:
        self.make, self.arguments = make, arguments
        dimensions = arguments.dimensions
        self.static = tuple(d.is_text for d in dimensions)
        """Which dimensions are not traced: texts, and numbers that decide the structure."""
        self.traced = True
        """Whether the function can be traced."""
        if not self._traceable():
            # Whole numbers may decide the structure (num_modes): one compilation for each.
            self.static = tuple(d.is_text or d.is_whole for d in dimensions)
            self.traced = self._traceable()

    def _split(self, index: tuple[np.ndarray, ...]) -> tuple[dict[str, Any], dict, Numbers]:
        """Return the static arguments of a block, the fixed numbers, and those that vary."""
        static: dict[str, Any] = {}
        numbers = []
        for d, i, is_static in zip(self.arguments.dimensions, index, self.static, strict=True):
            if is_static:
                static |= {name: values[i[0]].item() for name, values in d.values.items()}
            else:
                numbers.append({n: np.asarray(v[i], float) for n, v in d.values.items()})
        fixed = {n: np.asarray(v) for n, v in self.arguments.fixed.items() if type(v) is float}
        static |= {n: v for n, v in self.arguments.fixed.items() if n not in fixed}
        return static, fixed, tuple(numbers)

    def _traceable(self) -> bool:
        first = tuple(np.zeros(1, int) for _ in self.arguments.dimensions)
        static, fixed, numbers = self._split(first)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # such as a number that decides the structure
                eqx.filter_eval_shape(_made, self.make, static, fixed, numbers, False)
        except (jax.errors.JAXTypeError, TypeError, ValueError, Warning):
            return False
        return True

    def sample(self, index: tuple[int, ...] | None = None) -> AbstractSystem:
        """Return the system of one combination, by default the first, from concrete numbers.

        Raises `ValueError` where it is no system.
        """
        index = (0,) * len(self.arguments.dimensions) if index is None else index
        return made_by(self.make, self.arguments.at(index))

    def first_of(self, index: tuple[np.ndarray, ...]) -> AbstractSystem:
        """Return the first system of a block, from concrete numbers."""
        return self.sample(tuple(int(i[0]) for i in index))

    def check(self) -> None:
        """Build every value of every axis once from concrete numbers: wrong ones are refused."""
        shape = self.arguments.shape
        for k, size in enumerate(shape):
            for i in range(size):
                self.sample(tuple(i if j == k else 0 for j in range(len(shape))))
        self.sample(tuple(size - 1 for size in shape))

    def systems(self, index: tuple[np.ndarray, ...]) -> AbstractSystem:
        """Return the systems of a block, stacked, the last dimension running fastest."""
        return _made(self.make, *self._split(index), False) if self.traced else self._sampled(index)

    def _sampled(self, index: tuple[np.ndarray, ...]) -> AbstractSystem:
        """Return the systems of a block, stacked, each made from concrete numbers."""
        return stacked([self.sample(tuple(map(int, at))) for at in itertools.product(*index)])

    def rigs(self, index: tuple[np.ndarray, ...]) -> Rigs:
        """Return equations and drives of a block, stacked likewise."""
        if not self.traced:
            return rigs_of(self._sampled(index))
        return _made(self.make, *self._split(index), True)

    def prepared(
        self,
        index: tuple[np.ndarray, ...],
        stepper: AbstractStepper,
        meanwhile: Callable[[Prepared], object],
    ) -> Prepared:
        """Return the rigs of a block ready to be marched.

        `meanwhile` is called with their shapes and types while they are computed.
        """
        rigs = self.rigs(index)
        meanwhile(prepared_kinds(stepper, rigs))
        return prepare(stepper, rigs)

    def lane_numbers(
        self, index: tuple[np.ndarray, ...], names: tuple[str, ...] = ()
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the static arguments of a block, and its numbers lane by lane.

        Numbers are those that vary, and `names`: `make(**static, **{n: v[k] for each})` is the rig
        of lane k.
        """
        static, fixed, numbers = self._split(index)
        lengths = [len(next(iter(own.values()))) for own in numbers]
        count = math.prod(lengths)
        places = np.unravel_index(np.arange(count), lengths) if lengths else ()
        for name in names:
            if not any(name in own for own in (fixed, *numbers)):
                fixed[name] = float(static.pop(name, default_of(self.make, name)))
        found = {n: np.full(count, float(v)) for n, v in fixed.items()}
        for place, own in zip(places, numbers, strict=True):
            found |= {n: v[place] for n, v in own.items()}
        return static, found

    def together(self, lanes: int) -> int:
        """Return of how many blocks of so many lanes the digests are computed at a time."""
        return max(1, TOGETHER // lanes) if self.traced else 1

    def digests(self, blocks: Iterable[Block]) -> Iterator[str]:
        """Return, for each block, what stands for all numbers of its systems.

        Traced systems are made operation by operation, many together: compiled as a whole a number
        could differ in its last digit from one machine to another, or because something else in
        the function was changed.
        """
        if not self.traced or all(self.static):
            yield from map(self._digest_of_samples, blocks)
            return
        for _, group in itertools.groupby(blocks, lambda block: self._split(block.indices)[0]):
            alike = list(group)
            step = self.together(math.prod(map(len, alike[0].indices)))
            for k in range(0, len(alike), step):
                yield from self._digests(alike[k : k + step])

    def _digest_of_samples(self, block: Block) -> str:
        try:
            with _on_host():
                return _digests_of(self._sampled(block.indices))[0]
        except Exception:  # as will be said where it is computed
            return NO_RIGS

    def _digests(self, blocks: list[Block]) -> Iterable[str]:
        """Return what stands for the systems of blocks with the same static arguments."""
        static, several = zip(*(self.lane_numbers(b.indices) for b in blocks), strict=True)
        flat = {n: np.concatenate([own[n] for own in several]) for n in several[0]}
        count = len(next(iter(flat.values())))
        # Always as many, whatever the map: operations are compiled once, and no lane is treated
        # apart as one of the odd ones at the end of a vector.
        padded = {n: np.pad(v, (0, -count % TOGETHER), mode="edge") for n, v in flat.items()}
        make = eqx.filter_vmap(lambda own: as_arrays(self.make(**static[0], **own)))
        try:
            with _on_host():
                parts = [
                    jax.device_get(
                        make({n: jnp.asarray(v[k:][:TOGETHER]) for n, v in padded.items()})
                    )
                    for k in range(0, count, TOGETHER)
                ]
            made = jax.tree.map(
                lambda *a: np.concatenate(a)[:count] if eqx.is_array(a[0]) else a[0], *parts
            )
            return _digests_of(made, len(blocks))
        except Exception:  # one of them cannot be made
            return map(self._digest_of_samples, blocks)
