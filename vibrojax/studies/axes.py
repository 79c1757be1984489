"""From a function of named numbers to the lanes of a study."""

import inspect
import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._checks import check_needed_arguments, name_of, nearest
from vibrojax._described import recipe
from vibrojax.systems.base import AbstractSystem


class Lanes(eqx.Module):
    """The systems of a study, stacked along a leading axis."""

    systems: AbstractSystem
    sample: AbstractSystem
    """The first system, with the numbers as they were given."""
    axes: dict[str, np.ndarray]
    description: str

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(len(values) for values in self.axes.values())


def stacked(systems: list[AbstractSystem]) -> AbstractSystem:
    """Stack systems along a new leading axis of every number.

    Raises `ValueError` for systems of different structure.
    """

    def alike() -> bool:
        return all(jax.tree.structure(s) == jax.tree.structure(systems[0]) for s in systems)

    if not alike():
        systems = [one.with_fixed_structure() for one in systems]
    if not alike():
        raise ValueError(
            "All systems of a study must have the same structure (stops, laws, num_modes): only "
            "numbers can be axes."
        )
    # On the host: a transfer for every number of every lane would cost more than the lanes.
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves).astype(float)), *systems)


def lanes_of(system: AbstractSystem | Callable[..., AbstractSystem], axes: dict[str, Any]) -> Lanes:
    """Build one system, or one for every combination of the axes.

    Every system is built from concrete numbers, so wrong ones are refused before anything
    compiles. Raises `ValueError` for unknown names, empty axes, or systems of different structure.
    """
    if isinstance(system, AbstractSystem):
        if axes:
            raise ValueError(
                f"Unknown argument {next(iter(axes))!r}. To sweep a number of the rig, pass a "
                "function that makes the rig from named numbers, in place of the rig itself."
            )
        return Lanes(stacked([system]), system, {}, recipe(system))
    if not callable(system):
        raise ValueError(f"system must be a system or a function that makes one, got {system!r}.")
    parameters = inspect.signature(system).parameters.values()
    known = [p.name for p in parameters]
    if not any(p.kind is p.VAR_KEYWORD for p in parameters):
        for name in axes:
            if name not in known:
                raise ValueError(f"Unknown argument {name!r}. {nearest(name, known)}")
    check_needed_arguments(system, axes)
    fixed = {k: v for k, v in axes.items() if np.ndim(v) == 0}
    swept = {k: np.asarray(v, dtype=float) for k, v in axes.items() if np.ndim(v) > 0}
    for name, values in swept.items():
        if values.ndim != 1 or values.size == 0 or not np.isfinite(values).all():
            raise ValueError(
                f"{name} must be a non-empty list of finite numbers, got {axes[name]!r}."
            )
    combinations = itertools.product(*swept.values())
    made = [
        system(**fixed, **dict(zip(swept, map(float, values), strict=True)))
        for values in combinations
    ]
    for one in made:
        if not isinstance(one, AbstractSystem):
            raise ValueError(f"{name_of(system)} must return a system, got {one!r}.")
    return Lanes(stacked(made), made[0], swept, recipe(made[0]))
