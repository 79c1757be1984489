"""Stops: where they are, when they are touched, and the rounded corner of their force."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import (
    check_choice,
    check_not_negative,
    check_position,
    check_range,
    concrete,
    number_field,
)
from vibrojax._tools.described import described
from vibrojax._tools.signatures import validated
from vibrojax.model.laws import (
    AbstractContactLaw,
    AbstractMemoryLaw,
    is_linear,
    stored_energy,
)

Values = Float[Array, "..."]
Number = float | Values

DEFAULT_SMOOTHING = 1e-3
"""Width of the rounded corner of the contact force when a `Stop` gives none, in gaps."""


def smooth_ramp(penetration: Values, width: ArrayLike) -> Values:
    """Round the corner of max(d, 0): exactly 0 for d <= 0, exactly d for d >= width, C2 between.

    The quintic 6 u^3 - 8 u^4 + 3 u^5 (u = d/width) has no offset beyond the width, so the force
    of a deep contact is not changed. A width of 0 keeps the corner.
    """
    rounded = jnp.asarray(width) > 0
    safe = jnp.where(rounded, width, 1.0)
    u = jnp.clip(penetration / safe, 0.0, 1.0)
    polynomial = safe * u**3 * (6.0 - 8.0 * u + 3.0 * u**2)
    linear = jnp.maximum(penetration, 0.0)
    return jnp.where(rounded & (penetration < safe), polynomial, linear)


def smooth_switch(penetration: Values, width: ArrayLike) -> Values:
    """Go from 0 (d <= 0) to 1 (d >= width) as a C2 polynomial; a jump when the width is 0."""
    rounded = jnp.asarray(width) > 0
    safe = jnp.where(rounded, width, 1.0)
    u = jnp.clip(penetration / safe, 0.0, 1.0)
    polynomial = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    jump = jnp.where(penetration > 0, 1.0, 0.0)
    return jnp.where(rounded, polynomial, jump)


@validated
class Stop(eqx.Module):
    """A stop screwed to the base of the beam.

    Raises `ValueError` for a position outside (0, 1], a gap that is not finite, a negative
    smoothing, a side other than +1 and -1, or a law that is not an `AbstractContactLaw`. Source:
    Gandhi and Vyas 2017, fig. 3 and eq. 7.
    """

    position: Number | None = number_field()
    """Place along the beam, s1 = x/L; None for a `MatrixSystem`, whose `stop_map` places it."""
    gap: Number = number_field("m")
    """Clearance lambda between the undeformed beam and the stop, m. Negative: the stop is
    preloaded, pressed in by so much where the beam is undeformed."""
    law: AbstractContactLaw  # pyright: ignore[reportGeneralTypeIssues]
    """Force as a function of penetration and rate."""
    side: int = eqx.field(static=True, default=1)
    """+1: the stop is above the beam (y > 0); -1: below."""
    smoothing: Number | None = number_field(default=None)
    """Width, m of penetration, over which the corner of the force at touch is rounded.

    None (the default): methods that locate the touch keep the corner exact, the others round it
    over 1e-3 gap. A number: every method rounds over that width, 0 keeps the corner everywhere.
    """

    def __check_init__(self) -> None:
        """Refuse concrete values that are not a stop."""
        check_position("position", self.position)
        check_range("gap", self.gap, allowed="a finite length in m")
        check_choice("side", self.side, (1, -1))
        if self.smoothing is not None:
            check_not_negative("smoothing", self.smoothing, "m")

    @property
    def width(self) -> ArrayLike:
        """Width of the rounded corner for methods that need one, m."""
        return DEFAULT_SMOOTHING * abs(self.gap) if self.smoothing is None else self.smoothing

    @property
    def is_linear(self) -> bool:
        """Whether the stop is exactly linear in contact and free of force out of it."""
        width = concrete(self.smoothing)
        exact = self.smoothing is None or (width is not None and bool((width == 0).all()))
        return exact and is_linear(self.law)

    @property
    def memory_size(self) -> int:
        """How many internal states of its own the law has."""
        return self.law.memory_size if isinstance(self.law, AbstractMemoryLaw) else 0

    def force(self, penetration: Values, rate: Values, memory: Values | None = None) -> Values:
        """Return the rounded contact force, N, for any penetration (m) and its rate (m/s).

        Positive when it pushes the body away from the stop. The rate is switched on over the same
        width as the penetration. Without its `memory` a law that has one was at rest before.
        """
        width = self.width
        engaged = smooth_switch(penetration, width)
        return self._law_force(smooth_ramp(penetration, width), engaged * rate, memory)

    def exact_force(
        self, penetration: Values, rate: Values, memory: Values | None = None
    ) -> Values:
        """Return the contact force with its corner kept, N.

        `penetration` (m, positive in contact) and `rate` (m/s) are arrays of one shape.
        Without `memory` a law that has one was at rest before.
        """
        touching = penetration > 0
        depth, speed = jnp.maximum(penetration, 0.0), jnp.where(touching, rate, 0.0)
        return jnp.where(touching, self._law_force(depth, speed, memory), 0.0)

    def _law_force(self, depth, rate, memory):
        if memory is None or not isinstance(self.law, AbstractMemoryLaw):
            return self.law.force(depth, rate)
        return self.law.force_with_memory(depth, rate, memory)

    def memory_rate(self, penetration: Values, rate: Values, memory: Values) -> Values:
        """Return how fast the memory of the law changes, for any penetration (m), per s.

        `rate` is that of the penetration (m/s), `memory` the state of the law. For laws
        with memory only: another raises `AssertionError`.
        """
        assert isinstance(self.law, AbstractMemoryLaw)
        width = self.width
        engaged = smooth_switch(penetration, width)
        return self.law.memory_rate(smooth_ramp(penetration, width), engaged * rate, memory)

    def stored_energy(self, penetration: Values, memory: Values | None = None) -> Values:
        """Return the energy that the stop could give back, J, its corner kept.

        `penetration` in m; without its `memory` a law that has one was at rest before.
        """
        return stored_energy(self.law, jnp.maximum(penetration, 0.0), memory)

    def __repr__(self) -> str:
        return described(self)


def as_stops(stops: Stop | tuple[Stop, ...] | list[Stop]) -> tuple[Stop, ...]:
    """Return one stop or several as a tuple."""
    return (stops,) if isinstance(stops, Stop) else tuple(stops)
