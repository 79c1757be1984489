"""Contact laws: the force of a stop as a function of penetration and its rate.

`docs/how_to/contact_laws.md` shows how to write one's own. Laws are elementwise and never look at
the gap: the `Stop` decides when there is contact and rounds the corner of the force.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import (
    check_not_negative,
    check_positive,
    check_range,
    number_field,
)
from vibrojax._tools.described import described
from vibrojax._tools.signatures import validated
from vibrojax.model.restitution import approach_of, check_restitution, damping_ratio_of

Values = Float[Array, "..."]
Number = float | Values

_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


class AbstractContactLaw(eqx.Module):
    """Force of a stop on the body as a function of penetration and rate; force(0, 0) is 0."""

    @abstractmethod
    def force(self, penetration: Values, rate: Values) -> Values:
        """Return the force that resists penetration, N, positive when it pushes the body off.

        `penetration` (m) is at least 0 and `rate` (m/s) is its derivative.
        """

    def with_shorter_contacts(self, factor: Number) -> "AbstractContactLaw | None":
        """Return the law stiffened so that contacts last 1/`factor` as long, as much being lost.

        None for a law that does not say: what a rigid stop would do is then not estimated.
        """
        return None

    def __repr__(self) -> str:
        return described(self)


class AbstractLinearLaw(AbstractContactLaw):
    """A law that is linear in contact: motions between contacts and in them are then exact."""

    @abstractmethod
    def linear_coefficients(self) -> tuple[ArrayLike, ArrayLike]:
        """Return (stiffness N/m, damping N s/m)."""

    @property
    @abstractmethod
    def can_pull(self) -> bool:
        """Whether the force may become negative at separation."""


class AbstractMemoryLaw(AbstractContactLaw):
    """A law with internal states of its own, its `memory`, which are 0 in a stop at rest.

    The memory goes on changing while nothing touches the stop, whose penetration then is 0. It is
    one number, or with a `memory_size` above 1 an array with as many along its first axis.
    """

    @property
    def memory_size(self) -> int:
        """How many internal states there are."""
        return 1

    @property
    def relaxes_linearly(self) -> bool:
        """Whether the law is linear in contact and out of it, as `linear_contact` says."""
        return False

    def linear_contact(self) -> "LinearContact | None":
        """Return the law as one that is linear in contact and out of it; None where it is not."""
        return None

    @abstractmethod
    def force_with_memory(self, penetration: Values, rate: Values, memory: Values) -> Values:
        """Return the force that resists penetration, N, positive when it pushes the body off.

        `penetration` (m) is at least 0, `rate` (m/s) its derivative, `memory` the internal state.
        """

    @abstractmethod
    def memory_rate(self, penetration: Values, rate: Values, memory: Values) -> Values:
        """Return how fast the `memory` changes, per s, at a `penetration` (m) and `rate` (m/s)."""

    @abstractmethod
    def stored_energy_with_memory(self, penetration: Values, memory: Values) -> Values:
        """Return the energy that the stop could give back at `penetration` (m) and `memory`, J."""

    def force(self, penetration: Values, rate: Values) -> Values:
        """Return the force of a stop that was at rest before, N."""
        return self.force_with_memory(penetration, rate, _at_rest(self, penetration))


def _at_rest(law: AbstractMemoryLaw, penetration: Values) -> Values:
    """Return the memory of a stop at rest, at every penetration."""
    several = () if law.memory_size == 1 else (law.memory_size,)
    return jnp.zeros_like(penetration, shape=(*several, *jnp.shape(penetration)))


class LinearContact(NamedTuple):
    """A law that is linear in contact, and relaxes linearly out of it.

    The force is stiffness (d - surface) + damping d', where the surface of the stop, left alone, is
    at the sum of shares times memories, and every memory z follows it: z' = (d - z)/time.
    """

    stiffness: ArrayLike
    """Of a sudden compression, N/m."""
    damping: ArrayLike
    """N s/m."""
    shares: tuple[ArrayLike, ...] = ()
    times: tuple[ArrayLike, ...] = ()
    """Relaxation times, s."""


def is_linear(law: AbstractContactLaw) -> bool:
    """Whether a law is linear in contact, and relaxes linearly out of it if it does."""
    relaxes = isinstance(law, AbstractMemoryLaw) and law.relaxes_linearly
    return relaxes or isinstance(law, AbstractLinearLaw)


def linear_contact(law: AbstractContactLaw) -> LinearContact | None:
    """Return the law as one that is linear in contact and out of it; None where it is not."""
    if isinstance(law, AbstractLinearLaw):
        return LinearContact(*law.linear_coefficients())
    return law.linear_contact() if isinstance(law, AbstractMemoryLaw) else None


def linear_coefficients(law: AbstractContactLaw) -> tuple[ArrayLike, ArrayLike] | None:
    """Return (stiffness N/m, damping N s/m) of a law that is linear in contact, else None."""
    return law.linear_coefficients() if isinstance(law, AbstractLinearLaw) else None


def can_pull(law: AbstractContactLaw) -> bool:
    """Whether a law that is linear in contact lets go where its depth is 0, whatever the force.

    The depth of a stop that relaxes counts from its surface: there the force is 0.
    """
    return law.can_pull if isinstance(law, AbstractLinearLaw) else is_linear(law)


def stored_energy(
    law: AbstractContactLaw, penetration: Values, memory: Values | None = None
) -> Values:
    """Return the energy that a stop could give back, J: the work of the force at rate 0."""
    if isinstance(law, AbstractMemoryLaw):
        memory = _at_rest(law, penetration) if memory is None else memory
        return law.stored_energy_with_memory(penetration, memory)
    coefficients = linear_coefficients(law)
    if coefficients is not None:
        return jnp.asarray(coefficients[0]) * penetration**2 / 2
    # Places crowd at the touch, where the force may rise as any power.
    share = ((1 + _PLACES) / 2) ** 2
    depths = jnp.asarray(penetration)[..., None] * share
    force = law.force(depths, jnp.zeros_like(depths))
    return penetration * jnp.sum(force * (_WEIGHTS * (1 + _PLACES) / 2), axis=-1)


def _power(penetration: Values, exponent: ArrayLike) -> Values:
    """penetration ** exponent, 0 out of contact with all its derivatives."""
    touching = penetration > 0
    return jnp.where(touching, jnp.where(touching, penetration, 1.0) ** exponent, 0.0)


def _check_exponent(exponent: object) -> None:
    allowed, advice = "from 1 (a linear spring) to 5", "Hertz contact of a sphere has 1.5."
    check_range("exponent", exponent, 1.0, 5.0, allowed=allowed, advice=advice)


@validated
class KelvinVoigt(AbstractLinearLaw):
    """Spring and dashpot in parallel, F = stiffness d + damping d' while d > 0.

    As printed the dashpot may pull the body back at separation; `tension=False` lets go when the
    force has fallen to zero. Source: Gandhi and Vyas 2017, eq. 7; Ledezma-Ramirez et al., eq. 7
    with the offset of the gap that is missing there.

    Raises `ValueError` for a negative stiffness or damping.
    """

    stiffness: Number = number_field("N/m")
    """Contact stiffness Ks, N/m."""
    damping: Number = number_field("N s/m", default=0.0)
    """Contact damping Cs, N s/m."""
    tension: bool = eqx.field(static=True, default=True)
    """Whether the stop may pull, as the printed law does."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a stop."""
        check_not_negative("stiffness", self.stiffness, "N/m")
        check_not_negative("damping", self.damping, "N s/m")

    @classmethod
    @validated(traceable=True)
    def from_restitution(
        cls, restitution: Number, *, stiffness: Number, mass: Number, tension: bool = True
    ) -> "KelvinVoigt":
        """Make the law from which a free mass comes back with `restitution` times its speed.

        So at any speed. The damping is 2 z sqrt(stiffness mass) with -ln e = pi z/sqrt(1 - z^2), or
        without tension -ln e = 2 z arccos(z)/sqrt(1 - z^2). Numbers may be batched and
        differentiated. Source: Nagurka and Huang 2004; Schwager and Poeschel 2007.

        Parameters:
            restitution: e, above 0 and at most 1.
            stiffness: N/m; `check_resolution` says which is stiff enough.
            mass: that hits the stop, kg: of a beam `mass_at` the stop.
            tension: whether the stop may pull, and so lets go at depth 0; else at force 0.

        Raises `ValueError` for a restitution outside (0, 1], or a stiffness or mass not above 0.
        """
        check_restitution(restitution)
        check_positive("stiffness", stiffness, "N/m")
        check_positive("mass", mass, "kg")
        ratio = damping_ratio_of(restitution, tension)
        return cls(stiffness, 2 * ratio * jnp.sqrt(jnp.asarray(stiffness) * mass), tension)

    def with_shorter_contacts(self, factor: Number) -> "KelvinVoigt":
        """Return the law with stiffness times factor^2 and damping times `factor`."""
        return replace(self, stiffness=self.stiffness * factor**2, damping=self.damping * factor)

    def force(self, penetration: Values, rate: Values) -> Values:
        """Return stiffness d + damping d', cut off below zero without tension."""
        force = self.stiffness * penetration + self.damping * rate
        return force if self.tension else jnp.maximum(force, 0.0)

    def linear_coefficients(self) -> tuple[ArrayLike, ArrayLike]:
        """Return (stiffness, damping)."""
        return self.stiffness, self.damping

    @property
    def can_pull(self) -> bool:
        """Whether the force may become negative at separation."""
        return self.tension


@validated
class Hertz(AbstractContactLaw):
    """Elastic contact of curved bodies, F = stiffness d^exponent; no energy is lost.

    Source: Hertz 1881; Johnson, Contact Mechanics (1985), eq. 4.23: a sphere of radius R on a
    flat has stiffness 4/3 E* sqrt(R) and exponent 3/2.

    Raises `ValueError` for a negative stiffness or an exponent outside [1, 5].
    """

    stiffness: Number = number_field("N/m^exponent")
    """Contact stiffness, N/m^exponent."""
    exponent: Number = number_field(default=1.5)
    """Power of the penetration."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a stop."""
        check_not_negative("stiffness", self.stiffness, "N/m^exponent")
        _check_exponent(self.exponent)

    def with_shorter_contacts(self, factor: Number) -> "Hertz":
        """Return the law with stiffness times factor^(exponent + 1); `factor` shortens contacts."""
        return replace(self, stiffness=self.stiffness * factor ** (self.exponent + 1))

    def force(self, penetration: Values, rate: Values) -> Values:
        """Return stiffness d^exponent."""
        return self.stiffness * _power(penetration, self.exponent)


@validated
class HuntCrossley(AbstractContactLaw):
    """Contact whose damping grows with depth: F = stiffness d^exponent (1 + 3/2 dissipation d').

    The force is zero at touch whatever the speed, and the stop never pulls. A free mass that
    comes with speed v leaves with u, where mu = 3/2 dissipation and
    mu v - ln(1 + mu v) = -mu u - ln(1 - mu u), for any mass, stiffness and exponent: restitution
    1 - dissipation v at low speeds. Source: Hunt and Crossley 1975, eqs. 10 to 13.

    Raises `ValueError` for a negative stiffness or dissipation, or an exponent outside [1, 5].
    """

    stiffness: Number = number_field("N/m^exponent")
    """Contact stiffness, N/m^exponent."""
    dissipation: Number = number_field("s/m", default=0.0)
    """Loss of restitution per speed of approach (alpha), s/m."""
    exponent: Number = number_field(default=1.5)
    """Power of the penetration."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a stop."""
        check_not_negative("stiffness", self.stiffness, "N/m^exponent")
        check_not_negative("dissipation", self.dissipation, "s/m")
        _check_exponent(self.exponent)

    @classmethod
    @validated(traceable=True)
    def from_restitution(
        cls, restitution: Number, *, speed: Number, stiffness: Number, exponent: Number = 1.5
    ) -> "HuntCrossley":
        """Make the law from which a free mass that comes with `speed` leaves with e times that.

        Slower ones come back with more, faster ones with less: the dissipation is a/(3/2 speed),
        where a - ln(1 + a) = -e a - ln(1 - e a), whatever mass, stiffness and exponent. Numbers may
        be batched and differentiated. Source: Hunt and Crossley 1975, eqs. 10 to 13.

        Parameters:
            restitution: e, above 0 and at most 1.
            speed: of approach, m/s.
            stiffness: N/m^exponent.
            exponent: power of the penetration.

        Raises `ValueError` for a restitution outside (0, 1], a speed or stiffness not above 0, or
        an exponent outside [1, 5].
        """
        check_restitution(restitution)
        check_positive("speed", speed, "m/s")
        check_positive("stiffness", stiffness, "N/m^exponent")
        return cls(stiffness, approach_of(restitution) / (1.5 * jnp.asarray(speed)), exponent)

    def with_shorter_contacts(self, factor: Number) -> "HuntCrossley":
        """Return the law with stiffness times factor^(exponent + 1); `factor` shortens contacts."""
        return replace(self, stiffness=self.stiffness * factor ** (self.exponent + 1))

    def force(self, penetration: Values, rate: Values) -> Values:
        """Return stiffness d^exponent (1 + 3/2 dissipation d'), at least zero."""
        loss = jnp.maximum(1 + 1.5 * self.dissipation * rate, 0.0)
        return self.stiffness * _power(penetration, self.exponent) * loss
