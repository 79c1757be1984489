"""What can be read from a history by name: values, their rates, units and long names."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import nearest
from vibrojax.history.samples import SampledMotion
from vibrojax.measured.units import UNITS, unit_named
from vibrojax.model.equations import AbstractEquations
from vibrojax.results.variables import VARIABLES

QUANTITIES = {
    "displacement": ("m", "Displacement"),
    "velocity": ("m/s", "Velocity"),
    "acceleration": ("m/s2", "Acceleration"),
    "contact_force": ("N", "Contact force"),
}
"""Units and long names of what every system has and a place along it may be given for."""

STRAIN_POWER = "strain_power"
"""Rate of the observable `strain_energy`."""


def unit_and_label(quantity: str) -> tuple[str, str]:
    """Return the unit and the long name of a quantity."""
    if quantity in QUANTITIES:
        return QUANTITIES[quantity]
    known = VARIABLES.get(quantity)
    if known is None:
        return "1", quantity.replace("_", " ").capitalize()
    return known.units, known.long_name


def unit_for(quantity: str, asked: str | None) -> tuple[str, float]:
    """Return the unit asked for (None: the SI unit) and its size in SI units.

    Raises `ValueError` for one that the quantity cannot have.
    """
    si, _ = unit_and_label(quantity)
    if si in UNITS:
        unit = si if asked is None else unit_named(quantity, asked, [UNITS[si].kind])
        return unit, UNITS[unit].factor
    if asked not in (None, si):
        raise ValueError(f"Unit of {quantity} must be {si!r}, got {asked!r}.")
    return si, 1.0


def observables_of(equations: AbstractEquations) -> tuple[str, ...]:
    """Return the names of what the equations let one watch, beyond the displacement."""
    like = jax.ShapeDtypeStruct((equations.size,), float)
    seen = jax.eval_shape(equations.observables, like)
    return tuple(name for name in seen if name != "displacement")


def quantities_of(equations: AbstractEquations) -> tuple[str, ...]:
    """Return the names of all quantities of a history of these equations."""
    return (*QUANTITIES, *observables_of(equations), STRAIN_POWER)


def check_quantity(equations: AbstractEquations, quantity: Any) -> None:
    """Raise `ValueError` for a quantity that histories of these equations do not have."""
    known = quantities_of(equations)
    if quantity not in known:
        listed = ", ".join(map(repr, known))
        raise ValueError(
            f"quantity must be one of {listed} for this system, got {quantity!r}. "
            f"{nearest(str(quantity), known)}"
        )


Motions = tuple[Float[Array, " samples"], Float[Array, " samples"], Float[Array, " samples"]]
"""A quantity along a motion, its rate and the rate of that."""


@eqx.filter_jit
def _observed(
    equations: AbstractEquations,
    name: str,
    q: Float[Array, "samples coordinates"],
    rate: Float[Array, "samples coordinates"],
    acceleration: Float[Array, "samples coordinates"],
) -> Motions:
    def read(q):
        return equations.response(q) if name == "displacement" else equations.observables(q)[name]

    def value_and_rate(q, rate):
        return jax.jvp(read, (q,), (rate,))

    def one(q, rate, acceleration):
        (value, first), (_, second) = jax.jvp(value_and_rate, (q, rate), (rate, acceleration))
        return value, first, second

    return jax.vmap(one)(q, rate, acceleration)


def observable_motion(history: SampledMotion, name: str) -> Motions:
    """Return an observable of the equations, its rate and the rate of that."""
    return _observed(
        history.motion.equations,
        name,
        history.coordinates,
        history.rates,
        history.accelerations,
    )


def displacement_of(
    history: SampledMotion, position: ArrayLike | None = None
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """Return the displacement, velocity and acceleration of a history."""
    equations = history.motion.equations
    if position is None and equations.linear_between_contacts is None:
        return observable_motion(history, "displacement")
    shape = history.shape_at(position)
    return history.coordinates @ shape, history.rates @ shape, history.accelerations @ shape


def quantity_of(
    history: SampledMotion, name: str, position: ArrayLike | None = None
) -> tuple[Float[Array, "..."], Float[Array, "..."] | None]:
    """Return a quantity and its rate; None for the rate of what may jump.

    Raises `ValueError` for an unknown name or for a position where there is none.
    """
    equations = history.motion.equations
    check_quantity(equations, name)
    if name == "contact_force":
        return jnp.sum(history.contact_force, axis=1), None
    if name in QUANTITIES:
        motion = displacement_of(history, position)
        order = ("displacement", "velocity", "acceleration").index(name)
        return motion[order], motion[order + 1] if order < 2 else None
    if position is not None:
        raise ValueError(f"The {name} is that of the whole system: give no position.")
    value, rate, second = observable_motion(
        history, "strain_energy" if name == STRAIN_POWER else name
    )
    return (rate, second) if name == STRAIN_POWER else (value, rate)
