"""A cantilever that hits stops, as a reduced-order model in its own modes."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import (
    check_choice,
    check_count,
    check_not_negative,
    check_range,
    number_field,
)
from vibrojax._tools.signatures import validated
from vibrojax.model.beam import Cantilever
from vibrojax.model.drives import AbstractDrive, NoDrive, PointForce
from vibrojax.model.equations import LinearEquations
from vibrojax.model.modes import FORMULATIONS, Modes, modes
from vibrojax.model.residual_shapes import CorrectedModes, corrected_modes
from vibrojax.model.states import Displacement, beam_coordinates
from vibrojax.model.stops import Stop, as_stops
from vibrojax.model.systems import AbstractSystem


@validated
class ImpactingBeam(AbstractSystem):
    """A cantilever, its stops and its drive, reduced to the first modes of the free beam.

    Displacements are relative to the base. Source: Gandhi and Vyas 2017, eqs. 8, 36 and 37; the
    default `consistent` formulation corrects their modal mass and participation (see `modes`).

    Raises `ValueError` for num_modes below 1, a negative damping ratio, an unknown formulation,
    static_correction with `as_printed`, stops and drive that are none, or a stop without a
    position.
    """

    beam: Cantilever
    """The beam that moves."""
    stops: tuple[Stop, ...] = eqx.field(converter=as_stops, default=())
    """One or several stops, on either side."""
    drive: AbstractDrive = eqx.field(default_factory=NoDrive)
    """Base motion, point force or none."""
    damping_ratio: float | Float[Array, "..."] = number_field(default=0.0)
    """Damping ratio zeta of every mode (Gandhi and Vyas 2017, sec. 3)."""
    num_modes: int = eqx.field(static=True, default=5)
    """How many modes are kept."""
    formulation: str = eqx.field(static=True, default="consistent")
    """`consistent`, or `as_printed` to replicate the paper."""
    static_correction: bool = eqx.field(static=True, default=False)
    """Whether one shape more for each stop makes the static flexibility there exact.

    Modes left out act as a spring in series with a stop; see `vibrojax.model.residual_shapes`."""
    gravity: float | Float[Array, "..."] | None = number_field("m/s2", default=None)
    """Acceleration of free fall towards y > 0, m/s2, which bends the beam at rest; None: none.
    Displacements count from the straight beam."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a rig."""
        for stop in self.stops:
            if stop.position is None:
                raise ValueError(
                    "position must be above 0 (root) and at most 1 (tip), got None. Give every "
                    "Stop of a beam its place; None is for a MatrixSystem."
                )
        check_not_negative("damping_ratio", self.damping_ratio, "(fraction of critical)")
        if self.gravity is not None:
            check_range("gravity", self.gravity, allowed="a finite acceleration in m/s2")
        check_count("num_modes", self.num_modes, most=1000)
        check_choice("formulation", self.formulation, FORMULATIONS)
        if self.static_correction and self.formulation != "consistent":
            raise ValueError(
                "static_correction must be False with formulation='as_printed', got True: residual "
                "shapes are orthogonal to consistent modes only."
            )

    def modes(self) -> Modes:
        """Return the modes of the free beam that the model is reduced to."""
        return modes(self.beam, self.num_modes, self.formulation)

    def _basis(self) -> Modes | CorrectedModes:
        """Return the modes, and what static_correction adds to them."""
        free = self.modes()
        if not (self.static_correction and self.stops):
            return free
        return corrected_modes(self.beam, free, self._places())

    def _places(self) -> Float[Array, " stops"]:
        return jnp.stack([jnp.asarray(stop.position, float) for stop in self.stops])

    def equations(self) -> LinearEquations:
        """Reduce the beam to its modes and place the stops and the drive on them."""
        free = self._basis()
        if self.stops:
            towards = jnp.asarray([float(stop.side) for stop in self.stops])
            stop_map = towards[:, None] * free.shape(self._places())
        else:
            stop_map = jnp.zeros((0, free.num_modes))
        if isinstance(self.drive, PointForce):
            input_map = free.shape(self.drive.position) / free.modal_mass
        else:
            input_map = free.participation
        return LinearEquations(
            stops=self.stops,
            angular_frequency=free.angular_frequency,
            damping_ratio=self.damping_ratio * jnp.ones(free.num_modes),
            input_map=input_map,
            stop_map=stop_map,
            force_map=(stop_map / free.modal_mass).T,
            response_map=free.shape(1.0),
            modal_mass=free.modal_mass,
            load=None if self.gravity is None else free.participation * self.gravity,
        )

    def with_stops(
        self, stops: tuple[Stop, ...], stop_map: Float[Array, "stops coordinates"] | None = None
    ) -> "ImpactingBeam":
        """Return the beam with further `stops`; they have their places, there is no `stop_map`.

        Raises `ValueError` for one, or a stop without a place.
        """
        if stop_map is not None:
            raise ValueError(
                f"first_map and second_map are for bodies without places, got shape "
                f"{jnp.shape(stop_map)} for an ImpactingBeam. Give positions, x/L."
            )
        return replace(self, stops=(*self.stops, *stops))

    @property
    def reported_place(self) -> float:
        """The tip, x/L = 1."""
        return 1.0

    def shape_at(self, position: ArrayLike) -> Float[Array, " modes"]:
        """Return the mode shapes at a place x/L; `position` is from 0 (root) to 1 (tip)."""
        return self._basis().shape(position)

    def flexibility_left_out(self) -> list[float]:
        """Static flexibility at each stop that the modes kept lack, m/N."""
        equations = self.equations()
        by_mode = equations.modal_mass * equations.angular_frequency**2
        kept = np.sum(np.asarray(equations.stop_map**2 / by_mode), axis=1)
        places = [float(np.asarray(stop.position)) for stop in self.stops]
        return [
            self.beam.static_flexibility(place) - float(share)
            for place, share in zip(places, kept, strict=True)
        ]

    def modal_coordinates(self, displacement: Displacement) -> Float[Array, " modes"]:
        """Return the modal coordinates (m) of a displacement, or (m/s) of a velocity.

        Displacements are `modes().shape(s) @ q`; the shapes are mass-normalised as `Modes` says, so
        q is not the displacement of any place. A function is projected on the modes by the mass of
        the beam and of all masses on it; numbers at places are fitted by least squares.

        `displacement` is a function of s = x/L, called with an array of places, or a dict of
        numbers (m) by place, at least as many as there are modes. Raises `ValueError` for anything
        else; warns where the modes leave out more than a tenth of it.
        """
        return beam_coordinates(self.beam, self._basis(), displacement)

    @validated(traceable=True)
    def static_shape(self, tip_displacement: ArrayLike) -> Float[Array, " modes"]:
        """Return the modal coordinates (m) of the beam pulled at its tip by a static force.

        The force is whatever brings the tip to `tip_displacement` (m); let go, the beam is
        released from there (Ledezma-Ramirez et al., free vibration tests).
        """
        free = self._basis()
        tip = free.shape(1.0)
        flexibility = tip / (free.modal_mass * free.angular_frequency**2)
        return jnp.asarray(tip_displacement) * flexibility / (tip @ flexibility)
