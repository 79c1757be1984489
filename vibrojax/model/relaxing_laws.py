"""Contact laws that relax: springs in parallel with Maxwell elements, linear in contact and out."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from vibrojax._tools.checks import check_not_negative, check_positive, number_field
from vibrojax._tools.signatures import validated
from vibrojax.model.laws import AbstractMemoryLaw, LinearContact, Number, Values


def _numbers_field(units: str) -> Any:
    return eqx.field(converter=tuple, metadata={"units": units})


class AbstractRelaxingLaw(AbstractMemoryLaw):
    """A spring in parallel with Maxwell elements, each a spring and a dashpot in series.

    F = stiffness d + sum of k_j (d - z_j) with z_j' = (d - z_j)/time_j, z_j the stretch of a
    dashpot. The stop does not stick: where the body leaves its surface the force is zero and the
    surface creeps back.
    """

    stiffness: eqx.AbstractVar[Number]
    """Stiffness of a slow compression, N/m."""

    @property
    @abstractmethod
    def elements(self) -> tuple[tuple[Any, Any], ...]:
        """Stiffness (N/m) and relaxation time (s) of every Maxwell element."""

    @property
    def memory_size(self) -> int:
        """How many Maxwell elements there are."""
        return len(self.elements)

    @property
    def relaxes_linearly(self) -> bool:
        """Whether the law is linear in contact and out of it: it is."""
        return True

    def linear_contact(self) -> LinearContact:
        """Return the law as one that is linear in contact and out of it."""
        total = jnp.asarray(self.stiffness) + sum(k for k, _ in self.elements)
        shares = tuple(
            jnp.where(total > 0, k / jnp.where(total > 0, total, 1.0), 0.0)
            for k, _ in self.elements
        )
        return LinearContact(total, 0.0, shares, tuple(time for _, time in self.elements))

    def force_with_memory(self, penetration: Values, rate: Values, memory: Values) -> Values:
        """Return stiffness d + sum of k_j (d - z_j), at least zero."""
        force = self.stiffness * penetration
        for (k, _), stretch in self._with(memory):
            force = force + k * (penetration - stretch)
        return jnp.maximum(force, 0.0)

    def memory_rate(self, penetration: Values, rate: Values, memory: Values) -> Values:
        """Return z', m/s."""
        surface = self._surface(penetration, memory)
        rates = [(surface - stretch) / time for (_, time), stretch in self._with(memory)]
        return jnp.asarray(rates[0]) if self.memory_size == 1 else jnp.stack(rates)

    def stored_energy_with_memory(self, penetration: Values, memory: Values) -> Values:
        """Return the energy of all springs, J."""
        surface = self._surface(penetration, memory)
        energy = self.stiffness * surface**2
        for (k, _), stretch in self._with(memory):
            energy = energy + k * (surface - stretch) ** 2
        return energy / 2

    def force(self, penetration: Values, rate: Values) -> Values:
        """Return the force of a stop that was at rest before, N."""
        return jnp.asarray(self.linear_contact().stiffness) * penetration

    def _with(self, memory: Values) -> list[tuple[tuple[Any, Any], Values]]:
        stretches = [memory] if self.memory_size == 1 else list(memory)
        return list(zip(self.elements, stretches, strict=True))

    def _surface(self, penetration: Values, memory: Values) -> Values:
        """How deep the surface of the stop is, m: with the body, or where no force holds it."""
        shares = self.linear_contact().shares
        free = sum(s * z for s, (_, z) in zip(shares, self._with(memory), strict=True))
        return jnp.maximum(penetration, jnp.asarray(free))


@validated
class StandardLinearSolid(AbstractRelaxingLaw):
    """Rubber: a spring in parallel with a Maxwell element (spring and dashpot in series).

    F = stiffness d + maxwell_stiffness (d - z) with z' = (d - z)/relaxation_time, z the stretch of
    the dashpot. Slow contacts feel `stiffness`, quick ones the sum of both. The stop does not
    stick: where the body leaves its surface the force is zero and the surface creeps back. Source:
    Zener 1948, ch. V; Findley, Lai and Onaran, Creep and Relaxation (1976), sec. 5.4.

    Raises `ValueError` for a negative stiffness or a relaxation time that is not above 0.
    """

    stiffness: Number = number_field("N/m")
    """Stiffness of a slow compression, N/m."""
    maxwell_stiffness: Number = number_field("N/m")
    """What a sudden compression adds to it, N/m."""
    relaxation_time: Number = number_field("s")
    """Time in which the added force falls to 1/e under constant penetration, s."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a stop."""
        check_not_negative("stiffness", self.stiffness, "N/m")
        check_not_negative("maxwell_stiffness", self.maxwell_stiffness, "N/m")
        check_positive("relaxation_time", self.relaxation_time, "s")

    @property
    def elements(self) -> tuple[tuple[Any, Any], ...]:
        """Stiffness (N/m) and relaxation time (s) of the Maxwell element."""
        return ((self.maxwell_stiffness, self.relaxation_time),)

    def with_shorter_contacts(self, factor: Number) -> "StandardLinearSolid":
        """Return the law with both stiffnesses times factor^2 and relaxation time over `factor`."""
        return StandardLinearSolid(
            self.stiffness * factor**2,
            self.maxwell_stiffness * factor**2,
            self.relaxation_time / factor,
        )


@validated
class MaxwellChain(AbstractRelaxingLaw):
    """A spring in parallel with several Maxwell elements: relaxation over decades of time.

    F = stiffness d + sum of k_j (d - z_j) with z_j' = (d - z_j)/time_j (generalised Maxwell model,
    Prony series). One element makes it a `StandardLinearSolid`. Source: Findley, Lai and Onaran,
    Creep and Relaxation (1976), ch. 5.

    Raises `ValueError` for a negative stiffness, a relaxation time that is not above 0, no
    elements, or as many stiffnesses as there are not times.
    """

    stiffness: Number = number_field("N/m")
    """Stiffness of a slow compression, N/m."""
    maxwell_stiffness: tuple[Number, ...] = _numbers_field("N/m")
    """What a sudden compression adds to it, N/m, by element."""
    relaxation_time: tuple[Number, ...] = _numbers_field("s")
    """Time in which the force of an element falls to 1/e under constant penetration, s."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a stop."""
        stiffnesses, times = len(self.maxwell_stiffness), len(self.relaxation_time)
        if stiffnesses != times or not times:
            raise ValueError(
                "maxwell_stiffness and relaxation_time must hold a number for each element, got "
                f"{stiffnesses} and {times}."
            )
        check_not_negative("stiffness", self.stiffness, "N/m")
        for k, time in self.elements:
            check_not_negative("maxwell_stiffness", k, "N/m")
            check_positive("relaxation_time", time, "s")

    @property
    def elements(self) -> tuple[tuple[Any, Any], ...]:
        """Stiffness (N/m) and relaxation time (s) of every Maxwell element."""
        return tuple(zip(self.maxwell_stiffness, self.relaxation_time, strict=True))

    def with_shorter_contacts(self, factor: Number) -> "MaxwellChain":
        """Return the law with all stiffnesses times factor^2 and all times over `factor`."""
        return MaxwellChain(
            self.stiffness * factor**2,
            tuple(k * factor**2 for k in self.maxwell_stiffness),
            tuple(time / factor for time in self.relaxation_time),
        )
