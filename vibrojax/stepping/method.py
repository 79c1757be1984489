"""How a sweep steps its lanes: one interface, several methods."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from vibrojax._checks import check_count, check_range
from vibrojax.drive import AbstractDrive
from vibrojax.stepping import exact_contact
from vibrojax.stepping.contact_phases import ContactPhases, contact_phases
from vibrojax.stepping.measures import Measures
from vibrojax.systems.base import AbstractEquations, LinearEquations


def measuring(tolerance: Float[Array, ""]) -> Float[Array, ""]:
    """How many times finer than the march the periods are stepped in which extremes are read.

    Extremes are those of cubics between steps: their error falls with the fourth power of it.
    """
    return 6.0 * jnp.maximum(1e-4 / tolerance, 1.0) ** 0.25


class AbstractMarch(eqx.Module):
    """A method made ready for its lanes."""

    @abstractmethod
    def __call__(
        self,
        state: Float[Array, "states *lanes"],
        angular_frequency: Float[Array, "*lanes"],
        periods: Int[Array, "*lanes"],
        observe: bool,
    ) -> tuple[Float[Array, "states *lanes"], Int[Array, "*lanes"], Measures | None]:
        """Advance each lane from drive phase 0 by its number of drive periods.

        Returns the states, the steps taken, and the measures if `observe`. A lane that cannot go
        on has a state that is not finite.
        """

    @abstractmethod
    def energy_weight(self) -> Float[Array, "states *lanes"]:
        """Return weights that make (q, q') comparable: norms of weighted states are energies."""


class AbstractMethod(eqx.Module):
    """How the motion is stepped; a setting, apart from the system."""

    @abstractmethod
    def prepare(self, equations: AbstractEquations, drive: AbstractDrive) -> AbstractMarch:
        """Compute what does not depend on the drive frequency, for one lane.

        Map it with `jax.vmap(..., out_axes=-1)` for lanes of different systems.
        """


class ExactMarch(AbstractMarch):
    """`ExactContact` made ready: the phases of every rig are known."""

    phases: ContactPhases
    drive: AbstractDrive
    tolerance: Float[Array, ""]
    steps_per_period: int | None = eqx.field(static=True)

    def __call__(
        self,
        state: Float[Array, "states *lanes"],
        angular_frequency: Float[Array, "*lanes"],
        periods: Int[Array, "*lanes"],
        observe: bool,
    ) -> tuple[Float[Array, "states *lanes"], Int[Array, "*lanes"], Measures | None]:
        """March with exact propagators; see `exact_contact.march`."""
        step = exact_contact.longest_step(
            self.phases, angular_frequency, self.tolerance, self.steps_per_period
        )
        zero = jnp.zeros_like(angular_frequency)
        force = exact_contact.forcing(
            self.phases,
            self.drive.complex_amplitude(angular_frequency, zero),
            angular_frequency,
            zero,
            step / measuring(self.tolerance) if observe else step,
            self.tolerance / 2,
        )
        return exact_contact.march(self.phases, force, state, periods, observe=observe)

    def energy_weight(self) -> Float[Array, "states *lanes"]:
        """Return weights that make (q, q') comparable."""
        return self.phases.weight


class ExactContact(AbstractMethod):
    """Exact propagators in flight and in contact, crossings located inside the step.

    For linear stops (KelvinVoigt, with or without tension, any smoothing left out); up to four of
    them. The error left is that of contacts too short to be seen between steps. Raises
    `ValueError` for a tolerance outside (0, 0.1] or fewer than 4 steps per period.
    """

    tolerance: float = eqx.field(default=1e-4)
    """Error to expect relative to the response; chooses steps and how sharply to land."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps per drive period, instead of those chosen from the contact and the tolerance."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_settings(self.tolerance, self.steps_per_period)

    def prepare(self, equations: AbstractEquations, drive: AbstractDrive) -> ExactMarch:
        """Compute the phases of flight and contact."""
        if not isinstance(equations, LinearEquations):
            raise ValueError("ExactContact needs a system that is linear but for its stops.")
        phases = contact_phases(equations)
        return ExactMarch(phases, drive, jnp.asarray(self.tolerance), self.steps_per_period)


def check_settings(tolerance: float, steps_per_period: int | None) -> None:
    """Refuse a tolerance or a number of steps that cannot work, with a `ValueError`."""
    check_range(
        "tolerance", tolerance, 0.0, 0.1, include_low=False, allowed="above 0 and at most 0.1"
    )
    if steps_per_period is not None:
        check_count("steps_per_period", steps_per_period, least=4)
