"""The cantilever: a clamped beam of constant thickness, tapered in width, with a tip mass."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vibrojax._tools.checks import (
    as_number,
    check_not_negative,
    check_position,
    check_positive,
    check_range,
)
from vibrojax._tools.described import described
from vibrojax._tools.signatures import validated


def _number(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return jnp.asarray(value)
    return as_number(value.item() if isinstance(value, np.generic) else value)


def _field(units: str = "", **default: Any) -> Any:
    return eqx.field(converter=_number, metadata={"units": units}, **default)


@validated
class PointMass(eqx.Module):
    """A small mass fixed on the beam, such as an accelerometer, without rotary inertia.

    Both fields are numbers that can be swept, batched and differentiated.

    Raises `ValueError` when the mass is negative or the position is outside (0, 1]. Values that
    JAX is tracing are not checked.
    """

    mass: float | Float[Array, "..."] = _field("kg")
    """Mass, kg."""
    position: float | Float[Array, "..."] = _field(default=1.0)
    """Place s = x/L in (0, 1], the tip unless another is given."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a mass on the beam."""
        check_not_negative("mass", self.mass, "kg")
        check_position("position", self.position)

    def __repr__(self) -> str:
        return described(self)


def _as_tuple(given: PointMass | Sequence[PointMass]) -> tuple[Any, ...]:
    return (given,) if isinstance(given, PointMass) else tuple(given)


@validated
class Cantilever(eqx.Module):
    """A beam clamped at s = 0, its width b0 (1 - taper s) and its thickness constant, s = x/L.

    Every number of it can be swept, batched and differentiated; the properties are computed from
    them when asked. Source: Gandhi and Vyas 2017, eqs. 2, 4, 13, 16 and 17; the point masses are
    not in the paper.

    Raises `ValueError` when a length, the modulus or the density is not above 0, the taper is
    outside [0, 1), the mass ratio is negative, or a point mass is no `PointMass`. Values that JAX
    is tracing are not checked.
    """

    length: float | Float[Array, "..."] = _field("m")
    """Length L, m."""
    width: float | Float[Array, "..."] = _field("m")
    """Width b0 at the root, m."""
    thickness: float | Float[Array, "..."] = _field("m")
    """Thickness in the direction of motion, m."""
    youngs_modulus: float | Float[Array, "..."] = _field("Pa")
    """Young's modulus E, Pa."""
    density: float | Float[Array, "..."] = _field("kg/m3")
    """Density rho, kg/m3."""
    taper: float | Float[Array, "..."] = _field(default=0.0)
    """Taper mu in [0, 1): the width at the tip is b0 (1 - mu)."""
    mass_ratio: float | Float[Array, "..."] = _field(default=0.0)
    """Tip mass over rho A0 L with the area A0 at the ROOT, not over the mass of the beam."""
    point_masses: tuple[PointMass, ...] = eqx.field(converter=_as_tuple, default=())
    """Masses fixed on the beam besides the tip mass; one, or a list, becomes a tuple."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a beam."""
        check_positive("length", self.length, "m")
        check_positive("width", self.width, "m")
        check_positive("thickness", self.thickness, "m")
        check_positive("youngs_modulus", self.youngs_modulus, "Pa")
        check_positive("density", self.density, "kg/m3")
        check_range(
            "taper",
            self.taper,
            0.0,
            1.0,
            include_high=False,
            allowed="at least 0 and below 1",
            advice="The width at the tip is width * (1 - taper); call the wider end the root.",
        )
        check_not_negative(
            "mass_ratio", self.mass_ratio, "(tip mass / (density * root area * length))"
        )

    @property
    def root_area(self) -> float | Float[Array, "..."]:
        """Area A0 of the section at the root, m2."""
        return self.width * self.thickness

    @property
    def root_inertia(self) -> float | Float[Array, "..."]:
        """Second moment of area I0 of the section at the root, m4."""
        return self.width * self.thickness**3 / 12

    @property
    def reference_mass(self) -> float | Float[Array, "..."]:
        """Mass rho A0 L of the beam without its taper, kg: the unit of mass of the model."""
        return self.density * self.root_area * self.length

    @property
    def tip_mass(self) -> float | Float[Array, "..."]:
        """Mass that `mass_ratio` puts at the tip, kg (Gandhi and Vyas 2017, eq. 17)."""
        return self.mass_ratio * self.reference_mass

    @property
    def frequency_scale(self) -> float | Float[Array, "..."]:
        """sqrt(E I0 / (rho A0 L^4)), rad/s: times beta^2 it is an angular frequency (eq. 13)."""
        stiffness = self.youngs_modulus * self.root_inertia
        return (stiffness / (self.density * self.root_area * self.length**4)) ** 0.5

    def static_flexibility(self, position: float) -> float:
        """Return the deflection of the beam under a unit force at a position x/L, there, m/N."""
        nodes, weights = np.polynomial.legendre.leggauss(40)
        s = position * (nodes + 1) / 2
        inertia = self.root_inertia * (1 - self.taper * s)
        bending = (position - s) ** 2 / (self.youngs_modulus * inertia)
        return float(np.sum(weights * bending) * position / 2 * self.length**3)

    def __repr__(self) -> str:
        return described(self)
