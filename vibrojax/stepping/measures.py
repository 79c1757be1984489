"""What is measured of a response while it is marched: extremes, means, contacts."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from vibrojax._tools.trigonometry import cosine, sine
from vibrojax.stepping.cubic import cubic_maximum

MOST_EVENTS = 16
"""Touches and departures of a motion that are noted: room for eight contacts."""


class Segment(NamedTuple):
    """A step, on which the response is a cubic: (start, end) of values and rates.

    All but what touches and changes may have a first axis of steps one after another.
    """

    duration: Float[Array, "*lanes"]
    angle: Float[Array, "*lanes"]
    """Phase of the drive at the start, rad."""
    angle_rate: Float[Array, "*lanes"]
    response: tuple[Float[Array, "*lanes"], Float[Array, "*lanes"]]
    response_rate: tuple[Float[Array, "*lanes"], Float[Array, "*lanes"]]
    force: Float[Array, "*lanes"]
    """Largest contact force in the step, N."""
    touches: Bool[Array, "*lanes"]
    entries: Int[Array, "*lanes"]
    """How many stops were touched at the end of the step."""
    changed: Int[Array, "*lanes"] | None = None
    """Stop that changed its contact at the end, -1 where none did; None where nobody notes it."""


class EventLog(NamedTuple):
    """Which stops changed contact, in order of time."""

    first_phase: Int[Array, "*lanes"]
    """Set of touching stops at the beginning."""
    stop: Int[Array, "events *lanes"]
    """-1 where there is no event."""
    angle: Float[Array, "events *lanes"]
    """Drive phase, rad."""
    number: Int[Array, "*lanes"]
    """Of events; more than there is room for when above the length."""

    def add(
        self, stop: Int[Array, "*lanes"], angle: Float[Array, "*lanes"], kept: Bool[Array, "*lanes"]
    ) -> "EventLog":
        """Note an event where a stop changed its contact in a step that was kept."""
        happened = kept & (stop >= 0)
        place = jnp.arange(MOST_EVENTS).reshape((-1,) + (1,) * stop.ndim)
        here = happened & (place == self.number)
        return self._replace(
            stop=jnp.where(here, stop, self.stop),
            angle=jnp.where(here, angle, self.angle),
            number=self.number + happened,
        )


def no_events(first_phase: Int[Array, "*lanes"]) -> EventLog:
    """Begin a log."""
    room = (MOST_EVENTS, *first_phase.shape)
    zero = jnp.zeros(room)
    return EventLog(first_phase, jnp.full(room, -1, jnp.int32), zero, jnp.zeros_like(first_phase))


class Measures(NamedTuple):
    """Running sums and extremes over the steps of a lane."""

    time: Float[Array, "*lanes"]
    highest: Float[Array, "*lanes"]
    lowest: Float[Array, "*lanes"]
    integral_of_square: Float[Array, "*lanes"]
    integral_with_sine: Float[Array, "*lanes"]
    integral_with_cosine: Float[Array, "*lanes"]
    force: Float[Array, "*lanes"]
    contact_time: Float[Array, "*lanes"]
    contacts: Int[Array, "*lanes"]
    events: EventLog | None = None
    """Of steppers that land on every change of contact."""

    def add(self, part: Segment, kept: Bool[Array, "*lanes"]) -> "Measures":
        """Add a step where it was kept.

        Integrals by the trapezoidal rule with its end correction, of fourth order; extremes of the
        cubic through both ends.
        """
        (y0, y1), (v0, v1), h = part.response, part.response_rate, part.duration
        high = cubic_maximum(y0, v0 * h, y1, v1 * h)
        low = -cubic_maximum(-y0, -v0 * h, -y1, -v1 * h)

        def integral(f0, g0, f1, g1):
            return h / 2 * (f0 + f1) + h**2 / 12 * (g0 - g1)

        end = part.angle + part.angle_rate * h
        s0, c0, s1, c1 = sine(part.angle), cosine(part.angle), sine(end), cosine(end)
        w = part.angle_rate
        square = integral(y0**2, 2 * y0 * v0, y1**2, 2 * y1 * v1)
        with_sine = integral(y0 * s0, v0 * s0 + w * y0 * c0, y1 * s1, v1 * s1 + w * y1 * c1)
        with_cosine = integral(y0 * c0, v0 * c0 - w * y0 * s0, y1 * c1, v1 * c1 - w * y1 * s1)

        def plus(total, value):
            value = jnp.sum(value, axis=0) if value.ndim > total.ndim else value
            return total + jnp.where(kept, value, 0)

        def furthest(far, value, of):
            value = _folded(value, of) if value.ndim > far.ndim else value
            return jnp.where(kept, of(far, value), far)

        events = self.events
        if events is not None and part.changed is not None:
            last = end[-1] if end.ndim > kept.ndim else end
            events = events.add(part.changed, last, kept)
        return Measures(
            time=plus(self.time, h),
            highest=furthest(self.highest, high, jnp.maximum),
            lowest=furthest(self.lowest, low, jnp.minimum),
            integral_of_square=plus(self.integral_of_square, square),
            integral_with_sine=plus(self.integral_with_sine, with_sine),
            integral_with_cosine=plus(self.integral_with_cosine, with_cosine),
            force=furthest(self.force, part.force, jnp.maximum),
            contact_time=plus(self.contact_time, jnp.where(part.touches, h, 0.0)),
            contacts=plus(self.contacts, part.entries),
            events=events,
        )


def _folded(values: Array, of: Callable[[Array, Array], Array]) -> Array:
    """Extreme along the first axis, by halves.

    JAX's derivative of a reduction compares it with what it was made of, which XLA may compute
    again and differently: then it is NaN.
    """
    while len(values) > 1:
        half = len(values) // 2
        values = jnp.concatenate(
            [of(values[:half], values[-half:]), values[half : len(values) - half]]
        )
    return values[0]


def no_measures(like: Float[Array, "*lanes"]) -> Measures:
    """Measures before the first step."""
    zero = jnp.zeros_like(like)
    far = jnp.full_like(like, jnp.inf)
    return Measures(zero, -far, far, zero, zero, zero, zero, zero, jnp.zeros(like.shape, jnp.int32))
