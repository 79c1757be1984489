"""Rigs made ready to be marched, for every study that marches many of them."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax._tools.compiled import compiled
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.systems import AbstractSystem
from vibrojax.stepping.resonance import unbounded_at
from vibrojax.stepping.stepper import AbstractMarch, AbstractStepper, with_traced_numbers


class Rigs(eqx.Module):
    """Equations and drives of some rigs, stacked along a leading axis."""

    equations: AbstractEquations
    drive: AbstractDrive


class Prepared(eqx.Module):
    """What is computed of each rig before it is marched; rigs as the trailing axis."""

    march: AbstractMarch
    first_frequency: Float[Array, "*rigs"]
    """First natural frequency of the unstopped system, rad/s."""
    reference: Float[Array, "*rigs"]
    """What responses are divided by: the amplitude of the drive."""
    resonances: Float[Array, "modes *rigs"]
    """Drive frequencies at which the motion grows without bound, rad/s; NaN for other modes."""


@compiled(lightly=True)
def rigs_of(systems: AbstractSystem) -> Rigs:
    """Compute the equations of systems that are stacked along a leading axis."""
    return eqx.filter_vmap(lambda system: Rigs(system.equations(), system.drive))(systems)


@compiled(lightly=True)
def _prepare(stepper: AbstractStepper, rigs: Rigs) -> Prepared:
    def one(rig: Rigs) -> Prepared:
        reference, _ = rig.drive.reference
        first = _first_frequency(rig.equations)
        march = stepper.prepare(rig.equations, rig.drive)
        resonances = unbounded_at(rig.equations, rig.drive)
        return Prepared(march, first, jnp.asarray(reference), resonances)

    return eqx.filter_vmap(one, out_axes=-1)(rigs)


def _first_frequency(equations: AbstractEquations) -> Array:
    if equations.linear_between_contacts is not None:
        return equations.linear_between_contacts.angular_frequency[0]
    return jnp.asarray(jnp.nan)


def prepare(stepper: AbstractStepper, rigs: Rigs) -> Prepared:
    """Make rigs ready to be marched."""
    return _prepare(with_traced_numbers(stepper), rigs)


def prepared_kinds(stepper: AbstractStepper, rigs: Any) -> Prepared:
    """Compile that in the background; return shapes and types of what `prepare` will return."""
    return _prepare.ahead(with_traced_numbers(stepper), rigs)
