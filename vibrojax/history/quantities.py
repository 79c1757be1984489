"""What can be read from a history by name: values, their rates, units and long names."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import nearest
from vibrojax._tools.compiled import compiled
from vibrojax.history.samples import SampledMotion, check_one_history
from vibrojax.measured.units import UNITS, unit_named
from vibrojax.model.equations import AbstractEquations
from vibrojax.results.variables import VARIABLES

if TYPE_CHECKING:
    import xarray

QUANTITIES = {
    "displacement": ("m", "Displacement"),
    "velocity": ("m/s", "Velocity"),
    "acceleration": ("m/s2", "Acceleration"),
    "contact_force": ("N", "Contact force"),
}
"""Units and long names of what every system has and a place along it may be given for."""

MOVING = ("displacement", "velocity", "acceleration")
STRAIN_POWER = "strain_power"
"""Rate of the observable `strain_energy`."""


def unit_and_label(quantity: str) -> tuple[str, str]:
    """Return the unit and the long name of a quantity."""
    if quantity in QUANTITIES:
        return QUANTITIES[quantity]
    return VARIABLES.get(quantity, ("1", quantity.replace("_", " ").capitalize()))


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
    return (*(name for name in seen if name != "displacement"), *_internal_names(equations))


def _internal_names(equations: AbstractEquations) -> tuple[str, ...]:
    linear = equations.linear_between_contacts
    return () if linear is None or linear.internal is None else linear.internal.names


def check_quantity(equations: AbstractEquations, quantity: Any) -> None:
    """Raise `ValueError` for a quantity that histories of these equations do not have."""
    known = (*QUANTITIES, *observables_of(equations), STRAIN_POWER)
    if quantity not in known:
        listed = ", ".join(map(repr, known))
        raise ValueError(
            f"quantity must be one of {listed} for this system, got {quantity!r}. "
            f"{nearest(str(quantity), known)}"
        )


def numbered(name: str, count: int) -> dict[str, Any]:
    """Return the coordinate of a dataset that counts from 1."""
    label = {"units": "1", "long_name": f"{name.capitalize()}, from 1"}
    return {name: (name, np.arange(1, count + 1), label)}


def dataset(
    variables: Mapping[str, tuple[Any, Any, str, str]],
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, Any] | None = None,
) -> "xarray.Dataset":
    """Return a dataset of variables given as (dimensions, values, units, long name) by name."""
    import xarray

    data = {
        name: (dims, np.asarray(values), {"units": units, "long_name": label})
        for name, (dims, values, units, label) in variables.items()
    }
    return xarray.Dataset(data, coordinates, attributes)


def table(
    name: str,
    columns: Mapping[str, tuple[Any, str, str]],
    attributes: Mapping[str, Any] | None = None,
) -> "xarray.Dataset":
    """Return a dataset of columns (values, units, long name), with the number of the row."""
    count = len(next(iter(columns.values()))[0])
    rows = {n: (name, *column) for n, column in columns.items()}
    return dataset(rows, numbered(name, count), attributes)


Motions = tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]
"""A quantity along a motion, its rate and the rate of that."""


@compiled
def observable_motion(history: SampledMotion, name: str) -> Motions:
    """Return an observable of the equations, its rate and the rate of that.

    Of an internal state the latter is not given (NaN): it may jump.
    """
    equations, motion = history.motion.equations, history.motion
    if name in (names := _internal_names(equations)):
        place = 2 * equations.size + names.index(name)
        rates = jax.vmap(lambda t, x: motion.vector_field(t, x, None))(history.time, history.states)
        return history.states[:, place], rates[:, place], jnp.full_like(history.time, jnp.nan)

    def read(q):
        return equations.response(q) if name == "displacement" else equations.observables(q)[name]

    def value_and_rate(q, rate):
        return jax.jvp(read, (q,), (rate,))

    def one(q, rate, acceleration):
        (value, first), (_, second) = jax.jvp(value_and_rate, (q, rate), (rate, acceleration))
        return value, first, second

    return jax.vmap(one)(history.coordinates, history.rates, history.accelerations)


def displacement_of(history: SampledMotion, position: ArrayLike | None = None) -> Motions:
    """Return the displacement, velocity and acceleration of a history.

    Raises `ValueError` for lanes, or a position where there is none.
    """
    check_one_history(history, "quantities")
    equations = history.motion.equations
    if position is None and equations.linear_between_contacts is None:
        return observable_motion(history, "displacement")
    shape = history.shape_at(position)
    return history.coordinates @ shape, history.rates @ shape, history.accelerations @ shape


def quantity_of(
    history: SampledMotion, name: str, position: ArrayLike | None = None
) -> tuple[Any, Any]:
    """Return a quantity and its rate; None for the rate of what may jump.

    Raises `ValueError` for lanes, an unknown name, or a position where there is none.
    """
    check_one_history(history, "quantities")
    equations = history.motion.equations
    check_quantity(equations, name)
    if name == "contact_force":
        return jnp.sum(history.contact_force, axis=1), None
    if name in MOVING:
        parts = (*displacement_of(history, position), None)
        order = MOVING.index(name)
    elif position is not None:
        raise ValueError(f"The {name} is that of the whole system: give no position.")
    else:
        order = int(name == STRAIN_POWER)
        parts = observable_motion(history, "strain_energy" if order else name)
    return parts[order], parts[order + 1]
