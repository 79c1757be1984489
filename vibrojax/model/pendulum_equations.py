"""Equations of motion of a pendulum of elastic links between limiters."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax._tools.trigonometry import cosine, cosine_and_sine, sine
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.stops import Stop

Links = Float[Array, " links"]


class PendulumEquations(AbstractEquations):
    """Equations of motion of the links, in their angles from the upward vertical.

    sum_j a_ij cos(q_i - q_j) q_j'' + sum_j a_ij sin(q_i - q_j) q_j'^2 - g b_i sin q_i
    + k (K q)_i + beta (K q')_i + c0 q_1' [i = 1] = b_i cos q_i a(t) + contact, with a(t) minus the
    acceleration of the base. Source: Litak et al., eqs. 1 to 6, multiplied out.
    """

    stops: tuple[Stop, ...]
    inertia: Float[Array, "links links"]
    """a_ij, kg m2: the mass matrix of the straight pendulum."""
    moment: Links
    """b_i, kg m: what gravity and the motion of the base act on."""
    stiffness: Float[Array, "links links"]
    """Of the joints, N m/rad."""
    damping: Float[Array, "links links"]
    """Of joints and bearing, N m s/rad."""
    gravity: Float[Array, ""]
    """m/s2."""
    link_length: Float[Array, ""]
    """m."""
    limiter_height: Float[Array, ""]
    """m above the hinge."""
    below: Links
    """1 for the links below the one that faces the limiters, else 0."""
    facing: Links
    """1 for the link that faces the limiters, else 0."""

    @property
    def size(self) -> int:
        """How many links there are."""
        return self.moment.shape[0]

    @property
    def coordinate_units(self) -> str:
        """Unit of the coordinates: angles."""
        return "rad"

    def mass(self, q: Links) -> Float[Array, "links links"]:
        """Return the mass matrix, kg m2."""
        return self.inertia * jnp.cos(q[:, None] - q[None, :])

    def mass_times(self, q: Links, vector: Links) -> Links:
        """Return the mass matrix times a vector by two constant products."""
        c, s = cosine_and_sine(q)
        return c * (self.inertia @ (c * vector)) + s * (self.inertia @ (s * vector))

    def linear_force(self, q: Links, rate: Links) -> Links:
        """Return the moments of joints and bearing, N m."""
        return self.stiffness @ q + self.damping @ rate

    def smooth_force(self, q: Links, rate: Links) -> Links:
        """Return the moments of gravity and of the turning of the links, N m."""
        (c, s), square = cosine_and_sine(q), rate**2
        turning = s * (self.inertia @ (c * square)) - c * (self.inertia @ (s * square))
        return self.gravity * self.moment * s - turning

    def input(self, q: Links) -> Links:
        """Return the moments of a unit input (base acceleration with its sign changed), kg m."""
        return self.moment * cosine(q)

    def penetration(self, q: Links) -> Float[Array, " stops"]:
        """Return how deep the limiters are in the face of their link, m."""
        if not self.stops:
            return jnp.zeros(0)
        c, s = cosine_and_sine(q)
        across, along = self.link_length * (self.below @ s), self.link_length * (self.below @ c)
        c, s = self.facing @ c, self.facing @ s
        reach = across * c + (self.limiter_height - along) * s
        return jnp.stack([stop.side * reach - stop.gap * c for stop in self.stops])

    def response(self, q: Links) -> Float[Array, ""]:
        """Return the displacement of the tip relative to the base, m."""
        return self.link_length * jnp.sum(sine(q))

    def observables(self, q: Links) -> dict[str, Float[Array, ""]]:
        """Return what can be watched of a motion; see `pendulum_observables`."""
        energy = {"strain_energy": self.strain_energy(q)}
        return pendulum_observables(q, self.link_length) | energy

    def kinetic_energy(self, q: Links, rate: Links) -> Float[Array, ""]:
        """Return the kinetic energy relative to the base, J (Litak et al., eq. 1)."""
        return rate @ self.mass_times(q, rate) / 2

    def potential_energy(self, q: Links) -> Float[Array, ""]:
        """Return the energy of the joints and of the height, J (Litak et al., eq. 2)."""
        return self.strain_energy(q) + self.gravity * (self.moment @ cosine(q))


def pendulum_observables(
    angles: Links, link_length: Float[Array, ""]
) -> dict[str, Float[Array, ""]]:
    """Read displacement of the tip (m), bearing angle (rad) and chord reduction (m) off angles.

    The chord reduction, of Litak et al., fig. 4c, is the length less the distance from hinge to
    tip: a measure of bending.
    """
    # Summed over pairs of links: length minus chord would cancel to nothing for small bending.
    apart = angles[:, None] - angles[None, :]
    versed = jnp.sum(2 * jnp.sin(apart / 2) ** 2)
    count = angles.shape[0]
    chord = jnp.sqrt(count**2 - versed)
    return {
        "displacement": link_length * jnp.sum(jnp.sin(angles)),
        "bearing_angle": angles[0],
        "chord_reduction": link_length * versed / (count + chord),
    }
