"""One mass on a spring and a damper."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax._tools.checks import check_not_negative, check_positive, number_field
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive, NoDrive, PointForce
from vibrojax.model.equations import LinearEquations
from vibrojax.model.states import Displacement, check_coordinates
from vibrojax.model.stops import Stop
from vibrojax.model.systems import AbstractSystem, as_stops, check_without_places

Number = float | Float[Array, "..."]


@validated
class Oscillator(AbstractSystem):
    """A mass on a spring and a damper: an impact oscillator, or a stop that gives way (`Joined`).

    Its one coordinate is its displacement x, m, relative to the base: m x'' + c x' + k x = drive.

    Raises `ValueError` for a mass or stiffness not above 0, a negative damping, stops and drive
    that are none, or a stop with a position.
    """

    mass: Number = number_field("kg")
    """Mass m, kg."""
    stiffness: Number = number_field("N/m")
    """Stiffness k of its spring, N/m."""
    damping: Number = number_field("N s/m", default=0.0)
    """Damping c, N s/m."""
    stops: tuple[Stop, ...] = eqx.field(converter=as_stops, default=())
    """One or several stops, on either side, with position None."""
    drive: AbstractDrive = eqx.field(default_factory=NoDrive)
    """Base motion, a force on the mass (`PointForce`, its position is not used) or none."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not an oscillator."""
        check_positive("mass", self.mass, "kg")
        check_positive("stiffness", self.stiffness, "N/m")
        check_not_negative("damping", self.damping, "N s/m")
        check_without_places("an Oscillator", self.stops, "There is one place, the mass.")

    def equations(self) -> LinearEquations:
        """Return the equation of the mass as one mode."""
        mass, one = jnp.asarray(self.mass, float), jnp.ones(1)
        root = jnp.sqrt(jnp.asarray(self.stiffness) * mass)
        stop_map = jnp.asarray([float(stop.side) for stop in self.stops]).reshape(-1, 1)
        return LinearEquations(
            stops=self.stops,
            angular_frequency=root / mass * one,
            damping_ratio=self.damping / (2 * root) * one,
            input_map=one / mass if isinstance(self.drive, PointForce) else one,
            stop_map=stop_map,
            force_map=stop_map.T / mass,
            response_map=one,
            modal_mass=mass * one,
        )

    def with_stops(
        self, stops: tuple[Stop, ...], stop_map: Float[Array, "stops coordinates"] | None = None
    ) -> "Oscillator":
        """Return the oscillator with further `stops`, all at the mass; there is no `stop_map`.

        Raises `ValueError` for one, or a stop with a position.
        """
        if stop_map is not None:
            raise ValueError(
                f"first_map and second_map are not for an Oscillator, whose stops are all at the "
                f"mass, got shape {jnp.shape(stop_map)}. Leave it out."
            )
        return replace(self, stops=(*self.stops, *stops))

    def flexibility_left_out(self) -> list[float]:
        """Static flexibility at each stop that the coordinate lacks, m/N: none."""
        return [0.0] * len(self.stops)

    def modal_coordinates(self, displacement: Displacement) -> Float[Array, " coordinates"]:
        """Return a displacement (m) or velocity of the mass as an array of one.

        `displacement` is a number, or an array of one. Raises `ValueError` for another shape.
        """
        given = jnp.atleast_1d(jnp.asarray(displacement, float))
        return check_coordinates("displacement", given, 1, "the displacement of the mass")
