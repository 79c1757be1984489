"""A line through the numbers of a system: what continuation moves along."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax.drive import AbstractDrive
from vibrojax.response.contact_times import Tables, tables_of
from vibrojax.stepping.contact_phases import ContactPhases, contact_phases
from vibrojax.systems.base import AbstractSystem, LinearEquations


class Place(eqx.Module):
    """Equations, drive and drive frequency at one value of the parameter."""

    equations: LinearEquations
    drive: AbstractDrive
    angular_frequency: Float[Array, ""]


class AbstractPath(eqx.Module):
    """From a parameter to a place; one lane."""

    @abstractmethod
    def at(self, parameter: Float[Array, ""]) -> Place:
        """Return equations, drive and drive frequency."""

    @abstractmethod
    def tables(self, parameter: Float[Array, ""]) -> Tables:
        """Return the exact propagators there (linear stops only)."""


class FrequencyPath(AbstractPath):
    """The drive frequency changes."""

    equations: LinearEquations
    drive: AbstractDrive
    unit: Float[Array, "..."]
    """Angular frequency of a parameter of 1."""
    phases: ContactPhases | None

    def at(self, parameter: Float[Array, ""]) -> Place:
        """Return the same system at another frequency."""
        return Place(self.equations, self.drive, parameter * self.unit)

    def tables(self, parameter: Float[Array, ""]) -> Tables:
        """Return the propagators at another frequency."""
        assert self.phases is not None
        return tables_of(self.phases, self.drive, parameter * self.unit)


class ParameterPath(AbstractPath):
    """A named number of the user's function changes, the drive frequency stays."""

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
        equations = system.equations()
        assert isinstance(equations, LinearEquations)
        unit = equations.angular_frequency[0] if self.is_ratio else 2 * jnp.pi
        return Place(equations, system.drive, self.frequency * unit)

    def tables(self, parameter: Float[Array, ""]) -> Tables:
        """Return the propagators of the new system."""
        place = self.at(parameter)
        return tables_of(contact_phases(place.equations), place.drive, place.angular_frequency)


def frequency_path(system: AbstractSystem, is_ratio: bool, exact: bool) -> FrequencyPath:
    """Make the path along the drive frequency (a ratio to the first natural one, or Hz)."""
    equations = system.equations()
    assert isinstance(equations, LinearEquations)
    unit = equations.angular_frequency[0] if is_ratio else jnp.asarray(2 * jnp.pi)
    phases = contact_phases(equations) if exact else None
    return FrequencyPath(equations, system.drive, unit, phases)
