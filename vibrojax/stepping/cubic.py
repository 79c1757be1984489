"""The cubic through values and slopes at both ends of an interval, in arrays of JAX.

And the quintic that has the right curvatures there too.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

Values = Float[Array, "..."]
Places = Float[ArrayLike, "..."]


class Cubic(NamedTuple):
    """value + u (slope + u (curve + u bend)) over the share u in [0, 1] of an interval."""

    value: Values
    slope: Values
    curve: Values
    bend: Values

    def at(self, u: Places) -> Values:
        """Value at some shares of the interval."""
        return self.value + u * (self.slope + u * (self.curve + u * self.bend))

    def slope_at(self, u: Places) -> Values:
        """Slope there, per interval."""
        return self.slope + u * (2 * self.curve + 3 * u * self.bend)

    def peak(self) -> tuple[Values, Values]:
        """Where in (0, 1) the maximum lies, and its value; 0.5 and -inf where there is none."""
        square = self.curve**2 - 3 * self.bend * self.slope
        # The derivative of a root that is not taken must be finite too.
        root = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
        # The form of the quotient that does not cancel when the bend goes to 0.
        below = root - self.curve
        inside = (square > 0) & (self.slope * below > 0) & (abs(self.slope) < abs(below))
        u = jnp.where(inside, self.slope / jnp.where(inside, below, 1.0), 0.5)
        return u, jnp.where(inside, self.at(u), -jnp.inf)

    def root(
        self,
        low: Places = 0.0,
        high: Places = 1.0,
        guess: Values | None = None,
        *,
        rounds: int = 8,
    ) -> Values:
        """Zero between two shares, at which the signs differ: Newton's method, safeguarded."""
        rises = self.at(low) <= 0
        zero = jnp.zeros_like(self.value)
        low, high = zero + low, zero + high
        u = (low + high) / 2 if guess is None else guess
        for _ in range(rounds):
            value, slope = self.at(u), self.slope_at(u)
            before = (value <= 0) == rises
            low, high = jnp.where(before, u, low), jnp.where(before, high, u)
            newton = u - value / jnp.where(slope == 0, 1.0, slope)
            u = jnp.where((newton > low) & (newton < high), newton, (low + high) / 2)
        return u


def cubic_between(start: Values, start_slope: Values, end: Values, end_slope: Values) -> Cubic:
    """Cubic with these end values and end slopes, slopes per interval."""
    rise = end - start
    curve = 3 * rise - 2 * start_slope - end_slope
    return Cubic(start, start_slope, curve, start_slope + end_slope - 2 * rise)


def cubic_maximum(start: Values, start_slope: Values, end: Values, end_slope: Values) -> Values:
    """Maximum on [0, 1] of the cubic with these end values and end slopes."""
    _, peak = cubic_between(start, start_slope, end, end_slope).peak()
    higher = jnp.where(start > end, start, end)
    return jnp.where(peak > higher, peak, higher)


def largest(values: Values) -> Values:
    """Largest values along the last axis, with the derivatives of those that are.

    Those of `jnp.max` are NaN where XLA computes the values once more and rounds them otherwise:
    then none of them equals the largest.
    """
    return jnp.take_along_axis(values, jnp.argmax(values, -1, keepdims=True), -1)[..., 0]


def quintic_maximum(
    start: tuple[Values, ...], end: tuple[Values, ...]
) -> tuple[Bool[Array, "..."], Values, Values]:
    """Maximum on [0, 1] of quintics from values and two derivatives at both ends.

    Returns whether it is between the ends, where, and the value there. It is taken where the cubic
    has its maximum: the quintic's is higher by what is of the order of the quintic's own error.
    """
    (y0, v0, a0), (y1, v1, a1) = start, end
    cubic = cubic_between(y0, v0, y1, v1)
    u, peak = cubic.peak()
    first, last = a0 / 2 - cubic.curve, a1 / 2 - cubic.curve - 3 * cubic.bend
    more = (u * (1 - u)) ** 2 * (first * (1 - u) + last * u)
    highest = jnp.maximum(y0, y1)
    inside = peak + more > highest
    place = jnp.where(inside, u, jnp.where(y1 > y0, 1.0, 0.0))
    return inside, place, jnp.where(inside, peak + more, highest)
