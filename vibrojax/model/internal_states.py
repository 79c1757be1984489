"""States of first order that a structure has beside its coordinates and their velocities.

Voltages of a circuit, currents of an amplifier, what a damper remembers: whatever follows

    s' = flow s + from_displacement q + from_velocity q' + from_input a(t) - from_force F

and accelerates the coordinates by `acceleration` s.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class InternalStates(eqx.Module):
    """Internal states s of a structure with coordinates q; arrays may carry lanes as trailing axes.

    The unit of every state is its own; `names` and `units` say what they are.
    """

    flow: Float[Array, "internal internal *lanes"]
    """Rate of every state by every state, 1/s."""
    from_displacement: Float[Array, "internal coordinates *lanes"]
    """Rate by coordinate."""
    from_velocity: Float[Array, "internal coordinates *lanes"]
    """Rate by velocity of the coordinates."""
    from_input: Float[Array, "internal *lanes"]
    """Rate by a unit input of the drive."""
    from_force: Float[Array, "internal stops *lanes"]
    """Rate by a unit contact force, which acts against it."""
    acceleration: Float[Array, "coordinates internal *lanes"]
    """Acceleration of the coordinates by unit states."""
    response: Float[Array, "internal *lanes"]
    """What a unit state is in the reported response, where that is theirs."""
    weight: Float[Array, "internal *lanes"]
    """Root of twice the energy of a unit state, J^(1/2) per unit."""
    names: tuple[str, ...] = eqx.field(static=True, default=())
    """What histories call the states; none where they have no names."""
    reports: bool = eqx.field(static=True, default=False)
    """Whether the response that studies report is theirs, in place of the displacement."""

    @property
    def size(self) -> int:
        """How many states there are."""
        return self.flow.shape[0]


def no_states(coordinates: int, stops: int) -> InternalStates:
    """Return no internal states of a structure of so many coordinates and stops."""
    row = jnp.zeros((0, coordinates))
    none = jnp.zeros(0)
    return InternalStates(
        jnp.zeros((0, 0)), row, row, none, jnp.zeros((0, stops)), row.T, none, none
    )
