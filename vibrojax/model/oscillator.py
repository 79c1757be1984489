"""One mass on a spring and a damper."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from vibrojax._tools.checks import (
    check_not_negative,
    check_positive,
    check_range,
    number_field,
)
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive, NoDrive, PointForce
from vibrojax.model.equations import LinearEquations
from vibrojax.model.states import Displacement, check_coordinates
from vibrojax.model.stop_forces import contact_slope
from vibrojax.model.stops import Stop, as_stops
from vibrojax.model.systems import AbstractSystem, check_without_places

Number = float | Float[Array, "..."]


@validated
class Oscillator(AbstractSystem):
    """A mass on a spring and a damper: an impact oscillator, or a stop that gives way (`Joined`).

    Its one coordinate is its displacement x, m, relative to the base: m x'' + c x' + k x = force +
    drive. Without a spring it is a free body: a cart on a rail, a ball that falls. Then histories
    are exact; steady motions hold it by a spring so soft that they are wrong by some 1e-6.

    Raises `ValueError` for a mass or stiffness not above 0, a negative damping, stops and drive
    that are none, or a stop with a position.
    """

    mass: Number = number_field("kg")
    """Mass m, kg."""
    stiffness: Number | None = number_field("N/m", default=None)
    """Stiffness k of its spring, N/m; None: no spring."""
    damping: Number = number_field("N s/m", default=0.0)
    """Damping c, N s/m."""
    stops: tuple[Stop, ...] = eqx.field(converter=as_stops, default=())
    """One or several stops, on either side, with position None."""
    drive: AbstractDrive = eqx.field(default_factory=NoDrive)
    """Base motion, a force on the mass (`PointForce`, its position is not used) or none."""
    force: Number | None = number_field("N", default=None)
    """Force that stays the same, towards +x, N: gravity, a preload; None: none."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not an oscillator."""
        check_positive("mass", self.mass, "kg")
        if self.stiffness is not None:
            check_positive("stiffness", self.stiffness, "N/m", "Leave it out for a free body.")
        if self.force is not None:
            check_range("force", self.force, allowed="a finite force in N")
        check_not_negative("damping", self.damping, "N s/m")
        check_without_places("an Oscillator", self.stops, "There is one place, the mass.")

    def equations(self) -> LinearEquations:
        """Return the equation of the mass as one mode."""
        mass, one = jnp.asarray(self.mass, float), jnp.ones(1)
        stiffness = self._unit_stiffness() if self.stiffness is None else self.stiffness
        root = jnp.sqrt(jnp.asarray(stiffness) * mass)
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
            stiffness_sign=0 * one if self.stiffness is None else None,
            free=self.stiffness is None,
            load=None if self.force is None else self.force / mass * one,
        )

    def _unit_stiffness(self) -> Float[Array, ""]:
        """Stiffness in whose natural frequency the time of a free body is counted, N/m."""
        slopes = [contact_slope(stop) for stop in self.stops]
        hardest = jnp.max(jnp.stack(slopes)) if slopes else jnp.zeros(())
        return lax.stop_gradient(jnp.where(hardest > 0, hardest, 1.0))

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
