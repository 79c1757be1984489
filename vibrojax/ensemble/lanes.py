"""From a function of named numbers to the lanes of a study."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.checks import axis_of
from vibrojax._tools.described import recipe
from vibrojax._tools.kinds import is_list
from vibrojax.ensemble.arguments import arguments_of
from vibrojax.model.systems import AbstractSystem, check_made


class Lanes(eqx.Module):
    """The systems of a study, stacked along a leading axis."""

    systems: AbstractSystem
    sample: AbstractSystem
    """The first system, with the numbers as they were given."""
    axes: dict[str, np.ndarray]
    """Values by name of the axis; of numbers that go together as `together` has them."""
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


def check_lists(numbers: Mapping[str, Any]) -> None:
    """Refuse, with a `ValueError`, lists of numbers that are no axis."""
    for name, given in numbers.items():
        if is_list(given) and not (len(given) and isinstance(given[0], str | bool | np.bool_)):
            axis_of(name, given)


def lanes_of(
    system: AbstractSystem | Callable[..., AbstractSystem],
    numbers: Mapping[str, Any],
    groups: tuple[Any, ...] = (),
) -> Lanes:
    """Build one system, or one for every combination of the axes: zipped groups, then lists.

    Every system is built from concrete numbers, so wrong ones are refused before anything
    compiles. Raises `ValueError` for unknown names, empty axes, or systems of different structure.
    """
    if isinstance(system, AbstractSystem):
        check_no_numbers(numbers, groups)
        return Lanes(stacked([system]), system, {}, recipe(system))
    check_lists(numbers)
    named = arguments_of(system, groups, numbers)
    made = [made_by(system, named.at(index)) for index in np.ndindex(*named.shape)]
    return Lanes(stacked(made), made[0], named.axes, recipe(made[0]))


def check_no_numbers(numbers: Mapping[str, Any], groups: tuple[Any, ...]) -> None:
    """Refuse, with a `ValueError`, numbers beside a system that is made already."""
    names = [*numbers, *groups]
    if names:
        raise ValueError(
            f"Unknown argument {names[0]!r}. To follow or vary a number of the rig, pass a "
            "function that makes the rig from named numbers, in place of the rig itself. Settings "
            "of a study go into settings=."
        )


def made_by(make: Callable[..., AbstractSystem], numbers: Mapping[str, Any]) -> AbstractSystem:
    """Call the function of a system. Raises `ValueError` unless it makes one, of known numbers."""
    made = make(**numbers)
    check_made(make, made)
    return made
