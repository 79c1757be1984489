"""A line through the numbers of a system: what continuation moves along."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import LinearEquations
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.batches import in_batches, take
from vibrojax.steady.contact_times import Tables, tables_of
from vibrojax.stepping.contact_phases import ContactPhases, can_resonate, contact_phases

TOGETHER = 16
"""Points near which paths are made in one call."""


class Place(eqx.Module):
    """Equations, drive and drive frequency at one value of the parameter."""

    equations: LinearEquations
    drive: AbstractDrive
    angular_frequency: Float[Array, "..."]


class AbstractPath(eqx.Module):
    """From a parameter to a place; one lane."""

    @abstractmethod
    def at(self, parameter: Float[Array, ""]) -> Place:
        """Return equations, drive and drive frequency."""


class LocalPath(AbstractPath):
    """A path near one value of its parameter, to first order: cheap to compile and to evaluate.

    Along a frequency that is the path itself.
    """

    parameter: Float[AnyArray, "..."]
    place: Place
    slope: Place
    """Derivative of the place; for what does not change, zero."""
    phases: ContactPhases | None
    phases_slope: ContactPhases | None
    """Derivative of the phases. Along a frequency nothing of them changes: it has the form of that
    along wider gaps, with zeros, so that both ways share their programs."""
    resonant: bool = eqx.field(static=True)
    """Whether the drive could turn a block at its own frequency: there is one without damping."""

    def at(self, parameter: Float[Array, "..."]) -> Place:
        """Return equations, drive and drive frequency."""
        return _moved(self.place, self.slope, parameter - self.parameter)

    def phases_at(self, parameter: Float[Array, "..."]) -> ContactPhases:
        """Return the phases of contact (linear stops only)."""
        assert self.phases is not None
        return _moved(self.phases, self.phases_slope, parameter - self.parameter)

    def tables(self, parameter: Float[Array, ""]) -> Tables:
        """Return the exact propagators (linear stops only)."""
        place, phases = self.at(parameter), self.phases_at(parameter)
        return tables_of(phases, place.drive, place.angular_frequency, resonant=self.resonant)


def _moved(tree: Any, slope: Any, way: Array) -> Any:
    def moved(a, b):
        return a if b is None or not eqx.is_inexact_array(a) else a + way * b

    return jax.tree.map(moved, tree, slope)


class FrequencyPath(AbstractPath):
    """The drive frequency changes."""

    equations: LinearEquations
    drive: AbstractDrive
    unit: Float[AnyArray, "..."]
    """Angular frequency of a parameter of 1."""
    phases: ContactPhases | None

    def at(self, parameter: Float[Array, ""]) -> Place:
        """Return the same system at another frequency."""
        return Place(self.equations, self.drive, parameter * self.unit)

    def tables(self, parameter: Float[Array, ""]) -> Tables:
        """Return the exact propagators at another frequency (linear stops only)."""
        assert self.phases is not None
        return tables_of(self.phases, self.drive, parameter * self.unit)


class OpenedPath(AbstractPath):
    """All gaps become wider by the parameter, m; the drive frequency stays."""

    place: Place

    def at(self, parameter: Float[Array, ""]) -> Place:
        """Return the system with wider gaps."""
        equations = self.place.equations
        stops = tuple(replace(stop, gap=stop.gap + parameter) for stop in equations.stops)
        return replace(self.place, equations=replace(equations, stops=stops))


class NumberPath(AbstractPath):
    """Some numbers of a system are the parameter themselves, the drive frequency stays."""

    system: AbstractSystem
    followed: tuple[bool, ...] = eqx.field(static=True)
    """Which of its numbers."""
    frequency: Float[Array, "..."]
    is_ratio: bool = eqx.field(static=True)

    def with_number(self, parameter: Float[Array, "*lanes"]) -> AbstractSystem:
        """Return the system with this number."""
        leaves, structure = jax.tree.flatten(self.system)
        both = zip(leaves, self.followed, strict=True)
        return jax.tree.unflatten(structure, [parameter if f else leaf for leaf, f in both])

    def at(self, parameter: Float[Array, ""]) -> Place:
        """Return equations, drive and drive frequency with this number."""
        return _place_at(self.with_number(parameter), self.frequency, self.is_ratio)


class FunctionPath(AbstractPath):
    """A named number of the user's function changes, and the function computes with it."""

    make: Callable[..., AbstractSystem] = eqx.field(static=True)
    name: str = eqx.field(static=True)
    fixed: dict[str, Any]
    static: dict[str, Any] = eqx.field(static=True)
    """What is not a number, such as counts and names."""
    frequency: Float[Array, "..."]
    is_ratio: bool = eqx.field(static=True)

    def at(self, parameter: Float[Array, ""]) -> Place:
        """Make the system anew."""
        system = self.make(**self.static, **self.fixed, **{self.name: parameter})
        return _place_at(system, self.frequency, self.is_ratio)


def _place_at(system: AbstractSystem, frequency: Array, is_ratio: bool) -> Place:
    equations = system.equations().linear_between_contacts
    assert equations is not None  # checked before
    return Place(equations, system.drive, frequency * equations.drive_unit(is_ratio))


def localise(
    paths: AbstractPath, lane: np.ndarray, parameter: Float[AnyArray, " points"], exact: bool
) -> LocalPath:
    """Return the paths of some lanes near some values, stacked along the points."""
    if isinstance(paths, FrequencyPath):
        equations, drive, unit, phases = (
            jax.tree.map(lambda a: np.asarray(a)[lane] if eqx.is_array(a) else a, part)
            for part in (paths.equations, paths.drive, paths.unit, paths.phases)
        )
        place = Place(equations, drive, jnp.asarray(parameter * unit))
        still = jax.tree.map(np.zeros_like, place)
        slope = eqx.tree_at(lambda p: p.angular_frequency, still, np.asarray(unit))
        none = None if phases is None else jax.tree.map(np.zeros_like, phases).changed_by_gaps()
        resonant = can_resonate(phases)
        return LocalPath(jnp.asarray(parameter), place, slope, phases, none, resonant)
    paths, parameter = jax.device_get((paths, parameter))
    local = in_batches(
        lambda i: _localise(take(paths, lane[i]), parameter[i], exact), len(lane), TOGETHER
    )
    return replace(local, resonant=can_resonate(local.phases))


@compiled
def _localise(paths: AbstractPath, parameter: Float[AnyArray, " points"], exact: bool) -> LocalPath:
    def one(path, p):
        def value(p):
            place = path.at(p)
            return place, contact_phases(place.equations) if exact else None

        (place, phases), (slope, phases_slope) = eqx.filter_jvp(value, (p,), (jnp.ones_like(p),))
        fill = lambda a, b: jnp.zeros_like(a) if b is None else b  # noqa: E731
        slope = jax.tree.map(fill, place, slope)
        phases_slope = jax.tree.map(fill, phases, phases_slope) if exact else None
        if phases_slope is not None and isinstance(path, OpenedPath):
            phases_slope = phases_slope.changed_by_gaps()
        return LocalPath(p, place, slope, phases, phases_slope, True)

    return jax.vmap(one)(paths, parameter)


def frequency_path(system: AbstractSystem, is_ratio: bool, exact: bool) -> FrequencyPath:
    """Make the path along the drive frequency (a ratio to the first natural one, or Hz)."""
    equations = system.equations().linear_between_contacts
    assert equations is not None  # checked before
    phases = contact_phases(equations) if exact else None
    return FrequencyPath(equations, system.drive, equations.drive_unit(is_ratio), phases)


@compiled(lightly=True)
def exact_path(system: AbstractSystem, is_ratio: bool) -> FrequencyPath:
    """Make that path with the exact propagators, as a program of its own that many searches run."""
    return frequency_path(system, is_ratio, True)
