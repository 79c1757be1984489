"""The samples of a motion: what everything in this room is read from."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._tools.checks import check_one, check_range, is_traced
from vibrojax.model.systems import AbstractSystem, Motion
from vibrojax.results.status import Status


class SampledMotion(eqx.Module):
    """Motion of one lane at equal intervals; displacements are relative to the base."""

    system: AbstractSystem
    """What moves."""
    motion: Motion
    """Its equations with drive and waveform: the `args` of a stepper."""
    time: Float[Array, " samples"]
    """s."""
    coordinates: Float[Array, "samples coordinates"]
    """Modal coordinates q of a beam, m (shapes as `modes(...)` normalises them); those of the
    equations of other systems, in `coordinate_units`."""
    rates: Float[Array, "samples coordinates"]
    """Their velocities, per s."""
    accelerations: Float[Array, "samples coordinates"]
    """Their accelerations, per s2."""
    contact_force: Float[Array, "samples stops"]
    """Force of each stop, N, positive when it pushes the body off."""
    memory: Float[Array, "samples memories"]
    """Internal states of the stops whose law has one, m for a `StandardLinearSolid`."""
    status: Int[Array, ""]
    """`Status.completed` when the integration reached its end, `Status.diverged` when not."""

    @property
    def states(self) -> Float[Array, "samples states"]:
        """States (q, q', memories of stops), as `initial_state=` and `guess=` take them.

        After whole drive periods the drive is at phase 0 again, from where a motion goes on.
        """
        return jnp.concatenate([self.coordinates, self.rates, self.memory], axis=-1)

    def shape_at(self, position: ArrayLike | None) -> Float[Array, " coordinates"]:
        """Displacement by coordinate at the place `position` = x/L; None: the one reported.

        Raises `ValueError` for a place that the system does not have.
        """
        linear = self.motion.equations.linear_between_contacts
        if position is None and linear is not None:
            return linear.response_map
        if position is None or self.system.reported_place is None:
            raise ValueError("Only the history of a beam has a position along it.")
        check_one("position", position, "place x/L")
        allowed = "from 0 (root) to 1 (tip)"
        check_range("position", position, 0.0, 1.0, allowed=allowed, advice="It is x/length.")
        return self.system.shape_at(position)


def check_one_history(history: SampledMotion, what: str) -> None:
    """Raise `ValueError` for the lanes of several histories; one may be traced."""
    if lanes := np.shape(history.time)[:-1]:
        raise ValueError(
            f"Reading the {what} needs one history, got lanes of shape {lanes}. Take one: "
            "jax.tree.map(lambda a: a[0], history)."
        )


def times_of(history: SampledMotion, what: str) -> Float[np.ndarray, " samples"]:
    """Return the times (s) of one finished history.

    Raises `ValueError` for a traced one, lanes, one that diverged and one of a single sample.
    """
    if is_traced(history.time) or np.ndim(history.time) != 1:
        raise ValueError(
            f"Reading the {what} needs one history outside jit and vmap, got lanes of shape "
            f"{np.shape(history.time)[:-1]}. Take one: jax.tree.map(lambda a: a[0], history)."
        )
    if int(history.status) != Status.completed.value:
        status = Status(int(history.status)).name
        raise ValueError(f"This history has no {what}: its status is {status}.")
    if history.time.size < 2:
        raise ValueError(f"A history of one sample has no {what}.")
    return np.asarray(history.time)
