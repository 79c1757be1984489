"""An inverted pendulum of elastic links on a moving hinge, between two limiters."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vibrojax._tools.checks import (
    check_choice,
    check_count,
    check_not_negative,
    check_positive,
    check_range,
    concrete,
    number_field,
)
from vibrojax._tools.described import described
from vibrojax._tools.kinds import is_list
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive, BaseMotion, NoDrive
from vibrojax.model.laws import AbstractContactLaw, KelvinVoigt
from vibrojax.model.linearised_pendulum import LinearisedPendulum, natural_frequencies
from vibrojax.model.pendulum_equations import PendulumEquations
from vibrojax.model.stops import Stop
from vibrojax.model.systems import AbstractSystem

Number = float | Float[Array, "..."]


@validated
class Limiters(eqx.Module):
    """Two stops that move with the base, one on each side of the pendulum, at one height.

    Source: Litak et al., fig. 1 and table 1. Raises `ValueError` for a height or a distance that
    is not above 0, a negative smoothing, or a law that is none.
    """

    height: Number = number_field("m")
    """Height h above the hinge, m."""
    distance: Number = number_field("m")
    """Distance from one limiter to the other, m; the pendulum is a line in the middle."""
    law: AbstractContactLaw  # pyright: ignore[reportGeneralTypeIssues]
    """Force as a function of penetration and rate."""
    smoothing: Number | None = number_field(default=0.0)
    """Width, m of penetration, over which the corner of the force is rounded; 0 keeps it.

    The printed limiters are so stiff that the pendulum rests on them 4 micrometres deep.
    """

    def __check_init__(self) -> None:
        """Refuse concrete values that are no limiters."""
        check_positive("height", self.height, "m (the hinge)", "It is measured from the hinge.")
        check_positive("distance", self.distance, "m")
        if self.smoothing is not None:
            check_not_negative("smoothing", self.smoothing, "m")

    def stops(self) -> tuple[Stop, Stop]:
        """Return the stop on the +x side and the one on the -x side."""
        gap = self.distance / 2
        right, left = (Stop(None, gap, self.law, side, self.smoothing) for side in (1, -1))
        return right, left

    def __repr__(self) -> str:
        return described(self)


@validated
class ElasticPendulum(AbstractSystem):
    """An inverted pendulum of rigid links with springs between them, hinged to a moving base.

    Angles are absolute, from the upward vertical, the first being that of the bearing. The hinge
    is free but for its damping; two limiters that move with the base keep the pendulum from
    falling. Source: Litak et al., eqs. 1 to 6 and table 1.

    Raises `ValueError` for a length, section, modulus or density that is not above 0, a negative
    mass, damping or gravity, fewer than 2 links, a limiter height above the tip or not above the
    hinge, or a drive other than `BaseMotion` and `NoDrive`.
    """

    length: Number = number_field("m")
    """Length L from hinge to tip, m."""
    width: Number = number_field("m")
    """Width of the section, m."""
    thickness: Number = number_field("m")
    """Thickness of the section in the direction of motion, m."""
    youngs_modulus: Number = number_field("Pa")
    """Young's modulus E, Pa; a joint between links of length l has the stiffness k = E I/l."""
    density: Number = number_field("kg/m3")
    """Density, kg/m3."""
    limiters: Limiters | None = None
    """The two limiters, or None."""
    drive: AbstractDrive = eqx.field(default_factory=NoDrive)
    """Motion of the base across the pendulum, or none."""
    tip_mass: Number = number_field(default=0.0)
    """Mass at the tip, kg."""
    joint_damping: Number = number_field("N m s/rad", default=0.0)
    """Damping beta of every joint between two links, N m s/rad."""
    bearing_damping: Number = number_field("N m s/rad", default=0.0)
    """Damping c0 of the hinge, N m s/rad."""
    gravity: Number = number_field("m/s2", default=9.81)
    """Acceleration of gravity, m/s2."""
    num_links: int = eqx.field(static=True, default=17)
    """How many rigid links there are."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are no pendulum."""
        check_positive("length", self.length, "m")
        check_positive("width", self.width, "m")
        check_positive("thickness", self.thickness, "m")
        check_positive("youngs_modulus", self.youngs_modulus, "Pa")
        check_positive("density", self.density, "kg/m3")
        check_not_negative("tip_mass", self.tip_mass, "kg")
        check_not_negative("joint_damping", self.joint_damping, "N m s/rad")
        check_not_negative("bearing_damping", self.bearing_damping, "N m s/rad")
        check_not_negative("gravity", self.gravity, "m/s2")
        check_count("num_links", self.num_links, least=2, most=1000)
        if self.limiters is not None:
            length, height = concrete(self.length), self.limiters.height
            if length is not None and (length.ndim == 0 or not is_list(height)):
                shortest = float(length.min())
                check_range(
                    "limiters.height",
                    height,
                    0.0,
                    shortest,
                    include_low=False,
                    allowed=f"above 0 (hinge) and at most {shortest:g} m (tip)",
                    advice="Put the limiters beside the pendulum, or make it longer.",
                )
        if not isinstance(self.drive, BaseMotion | NoDrive):
            raise ValueError(f"drive must be BaseMotion or NoDrive, got {self.drive!r}.")

    @property
    def link_length(self) -> Number:
        """Length l of a link, m."""
        return self.length / self.num_links

    @property
    def joint_stiffness(self) -> Number:
        """Stiffness k = E I/l of a joint, N m/rad."""
        return self.youngs_modulus * self.width * self.thickness**3 / 12 / self.link_length

    def equations(self) -> PendulumEquations:
        """Compute inertias, stiffness and damping of the links."""
        n, link = self.num_links, jnp.asarray(self.link_length, float)
        mass = self.density * self.width * self.thickness * link
        place = jnp.arange(1, n + 1)
        carried = mass * (n - place) + self.tip_mass
        moment = link * (mass / 2 + carried)
        above = jnp.minimum(carried[:, None], carried[None, :])
        inertia = link**2 * (mass / 2 + above)
        own = link**2 * (mass / 4 + carried) + mass * (link**2 + self.thickness**2) / 12
        inertia = jnp.where(np.eye(n, dtype=bool), own, inertia)
        path = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        path[0, 0] = path[-1, -1] = 1.0
        path, hinge = jnp.asarray(path), jnp.zeros((n, n)).at[0, 0].set(1.0)
        height = jnp.asarray(0.0 if self.limiters is None else self.limiters.height, float)
        # A limiter at a joint belongs to the link below it; a hair above it is round-off.
        facing = jnp.clip(jnp.ceil(height / link - 1e-9), 1, n)
        return PendulumEquations(
            stops=() if self.limiters is None else self.limiters.stops(),
            inertia=inertia,
            moment=moment,
            stiffness=self.joint_stiffness * path,
            damping=self.joint_damping * path + self.bearing_damping * hinge,
            gravity=jnp.asarray(self.gravity, float),
            link_length=link,
            limiter_height=height,
            below=(place < facing).astype(float),
            facing=(place == facing).astype(float),
        )

    @validated(traceable=True)
    def natural_frequencies(self, support: str = "hinged") -> Float[Array, " modes"]:
        """Return the natural frequencies about the vertical, Hz, lowest first.

        A frequency below 0 stands for a mode that falls away, at the rate 2 pi |f|. With the
        support `hinged` the limiters are out of reach, with `propped` the pendulum is held at
        their height, with `clamped` its root cannot turn (Litak et al., table 1: first mode above
        9 Hz). Raises `ValueError` for another support, or `propped` without limiters.
        """
        check_choice("support", support, ("hinged", "propped", "clamped"))
        if support == "propped" and self.limiters is None:
            raise ValueError("support = 'propped' needs limiters, which this pendulum has not.")
        root = 2 * jnp.asarray(self.joint_stiffness) if support == "clamped" else jnp.zeros(())
        return natural_frequencies(self.equations(), root, support == "propped")

    @validated(traceable=True)
    def linearised(self, num_modes: int = 6) -> LinearisedPendulum:
        """Return the small motions about the vertical in the first modes of the free pendulum.

        Their damping matrix is kept whole: without what couples the modes the motions of period 3
        are lost. Raises `ValueError` for fewer than 1 mode, more modes than links, or no gravity.

        `num_modes` is how many modes are kept.
        """
        return LinearisedPendulum(pendulum=self, num_modes=num_modes)  # pyright: ignore[reportCallIssue]


@validated(traceable=True)
def default_pendulum(
    *,
    limiter_height: Number = 0.04,
    limiter_distance: Number = 0.012,
    contact_stiffness: Number = 1e4,
    contact_damping: Number = 1e2,
    base_amplitude: Number = 6.33e-3,
    joint_damping_time: Number = 2.91e-4,
    bearing_damping: Number = 1.44e-3,
    tip_mass: Number = 1.129e-3,
    length: Number = 0.195,
    width: Number = 0.017,
    thickness: Number = 3e-3,
    youngs_modulus: Number = 350e6,
    density: Number = 850.0,
    gravity: Number = 9.81,
    num_links: int = 17,
) -> ElasticPendulum:
    """Make the inverted elastic pendulum of Litak et al., table 1.

    Any number can be changed by name, swept or differentiated. PRINTED: limiter_distance,
    contact_stiffness, contact_damping, the beam, tip_mass and num_links. INFERRED, because the
    paper does not say: limiter_height (m), base_amplitude (m), bearing_damping (N m s/rad) and
    joint_damping_time (s), the damping of a joint over its stiffness.

    Parameters:
        limiter_height: of the limiters above the hinge, m.
        limiter_distance: from one limiter to the other, m.
        contact_stiffness: of a limiter, N/m.
        contact_damping: of a limiter, N s/m.
        base_amplitude: amplitude of the base, m.
        joint_damping_time: damping of a joint over its stiffness, s.
        bearing_damping: of the hinge, N m s/rad.
        tip_mass: kg.
        length: from hinge to tip, m.
        width: of the section, m.
        thickness: of the section in the direction of motion, m.
        youngs_modulus: Pa.
        density: kg/m3.
        gravity: m/s2.
        num_links: how many rigid links there are.

    Raises `ValueError` for numbers that are no pendulum.
    """
    check_positive("limiter_height", limiter_height, "m")
    check_positive("limiter_distance", limiter_distance, "m")
    check_not_negative("contact_stiffness", contact_stiffness, "N/m")
    check_not_negative("contact_damping", contact_damping, "N s/m")
    check_not_negative("base_amplitude", base_amplitude, "m")
    check_not_negative("joint_damping_time", joint_damping_time, "s")
    law = KelvinVoigt(contact_stiffness, contact_damping, tension=False)
    undamped = ElasticPendulum(
        length=length,
        width=width,
        thickness=thickness,
        youngs_modulus=youngs_modulus,
        density=density,
        limiters=Limiters(limiter_height, limiter_distance, law),
        drive=BaseMotion(base_amplitude),
        tip_mass=tip_mass,
        bearing_damping=bearing_damping,
        gravity=gravity,
        num_links=num_links,
    )
    return replace(undamped, joint_damping=joint_damping_time * undamped.joint_stiffness)
