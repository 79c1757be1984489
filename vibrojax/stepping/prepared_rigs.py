"""Rigs made ready to be marched, for every study that marches many of them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from vibrojax._tools.compiled import Compiled, compiled
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.systems import AbstractSystem
from vibrojax.stepping.resonance import unbounded_at
from vibrojax.stepping.stepper import AbstractMarch, AbstractStepper, with_traced_numbers

MANY = 32
"""Systems of which it counts what is computed once."""
VERY_MANY = 1024
"""Rigs for which it counts how fast the program is that prepares them."""


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
def _rigs_of(own: AbstractSystem, shared: AbstractSystem) -> Rigs:
    def one(own: AbstractSystem) -> Rigs:
        system = eqx.combine(own, shared)
        return Rigs(system.equations(), system.drive)

    return eqx.filter_vmap(one)(own)


def rigs_of(systems: AbstractSystem) -> Rigs:
    """Compute the equations of systems that are stacked along a leading axis."""
    return _rigs_of(*_own_and_shared(systems))


def kinds_of_rigs(systems: AbstractSystem) -> Any:
    """Compile that in the background; return shapes and types of what `rigs_of` will return."""
    return _rigs_of.ahead(*_own_and_shared(systems))


def _own_and_shared(systems: AbstractSystem) -> tuple[AbstractSystem, AbstractSystem]:
    """Split the numbers of many systems into those of each and those that all have.

    What depends on the second only (the modes, where stops differ) is then computed once. Few
    systems are not split, as each way to do it compiles.
    """
    arrays, others = eqx.partition(systems, eqx.is_array)
    leaves = jax.tree.leaves(arrays)
    is_own: Any = jax.tree.map(lambda _: True, arrays)
    if len(leaves[0]) >= MANY and not any(isinstance(leaf, Tracer) for leaf in leaves):
        differs = jax.tree.map(lambda a: bool(np.any(a != a[:1])), jax.tree.map(np.asarray, arrays))
        is_own = differs if any(jax.tree.leaves(differs)) else is_own
    own, shared = eqx.partition(arrays, is_own)
    return own, eqx.combine(jax.tree.map(lambda a: a[0], shared), others)


def _prepare(stepper: AbstractStepper, rigs: Rigs) -> Prepared:
    def one(rig: Rigs) -> Prepared:
        reference, _ = rig.drive.reference
        first = rig.equations.first_frequency
        march = stepper.prepare(rig.equations, rig.drive)
        resonances = unbounded_at(rig.equations, rig.drive)
        return Prepared(march, first, jnp.asarray(reference), resonances)

    return eqx.filter_vmap(one, out_axes=-1)(rigs)


_prepare_few, _prepare_many = compiled(lightly=True)(_prepare), compiled(_prepare)


def _preparing(rigs: Any) -> Compiled[..., Prepared]:
    """Take what compiles fast for few rigs, and what runs fast for many."""
    count = jax.tree.leaves(eqx.filter(rigs, lambda leaf: hasattr(leaf, "shape")))[0].shape[0]
    return _prepare_many if count >= VERY_MANY else _prepare_few


def prepare(stepper: AbstractStepper, rigs: Rigs) -> Prepared:
    """Make rigs ready to be marched."""
    return _preparing(rigs)(with_traced_numbers(stepper), rigs)


def prepared_kinds(stepper: AbstractStepper, rigs: Any) -> Prepared:
    """Compile that in the background; return shapes and types of what `prepare` will return."""
    return _preparing(rigs).ahead(with_traced_numbers(stepper), rigs)
