"""From the function of the rig to the rigs of a block, many at once where JAX can trace it."""

import hashlib
import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.ensemble.arguments import Arguments, default_of
from vibrojax.ensemble.lanes import stacked
from vibrojax.maps.chunks import Block
from vibrojax.maps.fingerprints import value_digest
from vibrojax.model.systems import AbstractSystem, as_arrays, check_made
from vibrojax.sweep.swept_lanes import Rigs, rigs_of

TOGETHER = 4096
"""Lanes whose systems are made together for their fingerprints."""
NO_RIGS = "none"
"""Stands for rigs that cannot be made."""
Numbers = tuple[dict[str, Any], ...]
"""Values along every dimension that is traced."""


@eqx.filter_jit
def _made(make, static: dict[str, Any], fixed: dict[str, Any], numbers: Numbers, with_modes: bool):
    # One vmap for each dimension: what depends on one of them only (the modes on taper and mass,
    # say) is computed once for its values, not for every lane.
    def level(depth: int, known: dict[str, Any]) -> Any:
        if depth == len(numbers):
            system = as_arrays(make(**static, **fixed, **known))
            return Rigs(system.equations(), system.drive) if with_modes else system
        return eqx.filter_vmap(lambda own: level(depth + 1, known | own))(numbers[depth])

    made = level(0, {})
    depth = len(numbers)

    def flat(leaf):
        if not eqx.is_array(leaf):
            return leaf
        # Not -1: without stops some arrays have no elements.
        return leaf.reshape((math.prod(leaf.shape[:depth]), *leaf.shape[depth:]))

    return jax.tree.map(flat, made)


def _lanes(numbers: dict[str, np.ndarray]) -> int:
    return len(next(iter(numbers.values())))


@contextmanager
def _on_host() -> Iterator[None]:
    """Compute on the processor of this host, where results are the same whatever else it has."""
    try:
        device = jax.local_devices(backend="cpu")[0]
    except RuntimeError:  # JAX may use others only
        yield
        return
    with jax.default_device(device):
        yield


class _Stacked:
    """Systems stacked along a leading axis, for their fingerprints."""

    def __init__(self, systems: AbstractSystem) -> None:
        arrays, others = eqx.partition(systems, eqx.is_array)
        self.leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(arrays)]
        self.others = value_digest(others)

    def digest(self, first: int = 0, last: int | None = None) -> str:
        """Return what stands for some of them."""
        found = hashlib.blake2b(self.others.encode(), digest_size=8)
        for leaf in self.leaves:
            own = np.ascontiguousarray(leaf[first:last])
            found.update(f"{own.dtype} {own.shape}".encode())
            found.update(own.tobytes())
        return found.hexdigest()


class RigMaker:
    """The function of a map and what it is called with."""

    make: Callable[..., AbstractSystem]
    arguments: Arguments
    static: tuple[bool, ...]
    """Which dimensions are not traced: texts, and numbers that decide the structure."""
    traced: bool
    """Whether the function can be traced."""

    def __init__(self, make: Callable[..., AbstractSystem], arguments: Arguments) -> None:
        self.make, self.arguments = make, arguments
        dimensions = arguments.dimensions
        self.static = tuple(d.is_text for d in dimensions)
        self.traced = True
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
        made = self.make(**self.arguments.at(index))
        check_made(self.make, made)
        return made

    def check(self) -> None:
        """Build every value of every axis once from concrete numbers: wrong ones are refused."""
        shape = self.arguments.shape
        for k, size in enumerate(shape):
            for i in range(size):
                self.sample(tuple(i if j == k else 0 for j in range(len(shape))))
        self.sample(tuple(size - 1 for size in shape))

    def systems(self, index: tuple[np.ndarray, ...]) -> AbstractSystem:
        """Return the systems of a block, stacked, the last dimension running fastest."""
        if self.traced:
            static, fixed, numbers = self._split(index)
            return _made(self.make, static, fixed, numbers, False)
        return self._sampled(index)

    def _sampled(self, index: tuple[np.ndarray, ...]) -> AbstractSystem:
        """Return the systems of a block, stacked, each made from concrete numbers."""
        grid = np.stack(np.meshgrid(*index, indexing="ij"), axis=-1).reshape(-1, len(index))
        return stacked([self.sample(tuple(map(int, row))) for row in grid])

    def rigs(self, index: tuple[np.ndarray, ...]) -> Rigs:
        """Return equations and drives of a block, stacked likewise."""
        if not self.traced:
            return rigs_of(self.systems(index))
        static, fixed, numbers = self._split(index)
        return _made(self.make, static, fixed, numbers, True)

    def lane_numbers(
        self, index: tuple[np.ndarray, ...], names: tuple[str, ...]
    ) -> tuple[dict[str, Any], dict[str, jnp.ndarray]]:
        """Return, lane by lane of a block, the numbers that vary, `names` always among them.

        With them the static arguments: `make(**static, **{n: v[k] for each})` is the rig of lane k.
        """
        static, found = self._flat(index)
        count = _lanes(found) if found else 1
        for name in names:
            if name not in found:
                found[name] = np.full(count, float(self.default(name)))
                static.pop(name, None)
        return static, {n: jnp.asarray(v, float) for n, v in found.items()}

    def _flat(self, index: tuple[np.ndarray, ...]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the static arguments of a block, and its numbers lane by lane."""
        static, fixed, numbers = self._split(index)
        lengths = [len(next(iter(d.values()))) for d in numbers]
        found = {n: np.full(int(np.prod(lengths, dtype=int)), v) for n, v in fixed.items()}
        for k, own in enumerate(numbers):
            shape = [-1 if j == k else 1 for j in range(len(lengths))]
            for n, v in own.items():
                found[n] = np.broadcast_to(v.reshape(shape), lengths).ravel()
        return static, found

    def digests(self, blocks: Iterable[Block]) -> Iterator[str]:
        """Return, for each block, what stands for all numbers of its systems.

        Traced systems are made operation by operation, many together: compiled as a whole a number
        could differ in its last digit from one machine to another, or because something else in
        the function was changed.
        """
        if not self.traced or all(self.static):
            for block in blocks:
                yield self._digest_of_samples(block)
            return
        together: list[tuple[Block, dict[str, np.ndarray]]] = []
        common: dict[str, Any] = {}
        lanes = 0
        for block in blocks:
            static, numbers = self._flat(block.indices)
            if together and (static != common or lanes >= TOGETHER):
                yield from self._digests(common, together)
                together, lanes = [], 0
            common = static
            together.append((block, numbers))
            lanes += _lanes(numbers)
        if together:
            yield from self._digests(common, together)

    def _digest_of_samples(self, block: Block) -> str:
        try:
            with _on_host():
                return _Stacked(self._sampled(block.indices)).digest()
        except Exception:  # as will be said where it is computed
            return NO_RIGS

    def _digests(
        self, static: dict[str, Any], blocks: list[tuple[Block, dict[str, np.ndarray]]]
    ) -> Iterator[str]:
        """Return what stands for the systems of some blocks, whose numbers are given."""
        _, names = blocks[0]
        flat = {n: np.concatenate([numbers[n] for _, numbers in blocks]) for n in names}
        try:
            made = _Stacked(self._by_operations(static, flat))
        except Exception:  # one of them cannot be made
            for block, _ in blocks:
                yield self._digest_of_samples(block)
            return
        first = 0
        for _, numbers in blocks:
            yield made.digest(first, first + _lanes(numbers))
            first += _lanes(numbers)

    def _by_operations(self, static: dict[str, Any], flat: dict[str, np.ndarray]) -> Any:
        """Return systems lane by lane, not compiled as a whole."""

        def one(numbers: dict[str, Any]) -> AbstractSystem:
            return as_arrays(self.make(**static, **numbers))

        # Always as many, whatever the map: operations are compiled once, and no lane is treated
        # apart as one of the odd ones at the end of a vector.
        count = _lanes(flat)
        padded = {n: np.pad(v, (0, -count % TOGETHER), mode="edge") for n, v in flat.items()}
        parts = []
        with _on_host():
            for k in range(0, count, TOGETHER):
                own = {n: jnp.asarray(v[k : k + TOGETHER]) for n, v in padded.items()}
                parts.append(jax.device_get(eqx.filter_vmap(one)(own)))
        return jax.tree.map(
            lambda *parts: np.concatenate(parts) if eqx.is_array(parts[0]) else parts[0], *parts
        )

    def default(self, name: str) -> Any:
        """Return the value of an argument that is not varied."""
        fixed = self.arguments.fixed
        return fixed[name] if name in fixed else default_of(self.make, name)
