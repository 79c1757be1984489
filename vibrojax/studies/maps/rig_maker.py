"""From the function of the rig to the rigs of a block, many at once where JAX can trace it."""

import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._checks import name_of
from vibrojax.studies.axes import stacked
from vibrojax.studies.maps.dimensions import Arguments, default_of
from vibrojax.studies.swept_lanes import Rigs, rigs_of
from vibrojax.systems.base import AbstractSystem, as_arrays

Numbers = tuple[dict[str, Any], ...]
"""Values along every dimension that is traced."""


@eqx.filter_jit
def _made(make, static: dict[str, Any], fixed: dict[str, Any], numbers: Numbers, with_modes: bool):
    # One vmap for each dimension: what hangs on one of them only (the modes on taper and mass,
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
        return leaf.reshape((-1, *leaf.shape[depth:]))

    return jax.tree.map(flat, made)


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
        if not isinstance(made, AbstractSystem):
            raise ValueError(f"{name_of(self.make)} must return a system, got {made!r}.")
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
        static, fixed, numbers = self._split(index)
        lengths = [len(next(iter(d.values()))) for d in numbers]
        count = int(np.prod(lengths, dtype=int))
        found = {n: np.full(count, v) for n, v in fixed.items()}
        for k, own in enumerate(numbers):
            shape = [-1 if j == k else 1 for j in range(len(lengths))]
            for n, v in own.items():
                found[n] = np.broadcast_to(v.reshape(shape), lengths).ravel()
        for name in names:
            if name not in found:
                found[name] = np.full(count, float(self.default(name)))
                static.pop(name, None)
        return static, {n: jnp.asarray(v, float) for n, v in found.items()}

    def default(self, name: str) -> Any:
        """Return the value of an argument that is not varied."""
        fixed = self.arguments.fixed
        return fixed[name] if name in fixed else default_of(self.make, name)
