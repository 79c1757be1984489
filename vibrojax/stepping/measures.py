"""What is measured of a response while it is marched: extremes, means, contacts."""

from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax.stepping.cubic import cubic_maximum

MOST_EVENTS = 16
"""Touches and departures of a motion that are noted: room for eight contacts."""


class Segment(NamedTuple):
    """A step, on which the response is a cubic: (start, end) of values and rates."""

    duration: Float[Array, "*lanes"]
    wave: tuple[Float[Array, "2 *lanes"], Float[Array, "2 *lanes"]]
    """Sine and cosine of the drive phase."""
    angular_frequency: Float[Array, "*lanes"]
    response: tuple[Float[Array, "*lanes"], Float[Array, "*lanes"]]
    response_rate: tuple[Float[Array, "*lanes"], Float[Array, "*lanes"]]
    force: Float[Array, "*lanes"]
    """Largest contact force in the step, N."""
    touches: Bool[Array, "*lanes"]
    entries: Int[Array, "*lanes"]
    """How many stops were touched at the end of the step."""


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
        place = jnp.arange(len(self.stop)).reshape((-1,) + (1,) * stop.ndim)
        here = happened & (place == self.number)
        return self._replace(
            stop=jnp.where(here, stop, self.stop),
            angle=jnp.where(here, angle, self.angle),
            number=self.number + happened,
        )


def no_events(first_phase: Int[Array, "*lanes"], room: int) -> EventLog:
    """Begin a log with room for so many events."""
    shape = (room, *first_phase.shape)
    zero = jnp.zeros(shape)
    return EventLog(first_phase, jnp.full(shape, -1, jnp.int32), zero, jnp.zeros_like(first_phase))


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
    nearest: Float[Array, "2 stops *lanes"] | None = None
    """How near every stop came to a change of contact and turned back, m: negative, or -inf. Then
    the drive phase there, rad, counted on from the start."""

    @property
    def sums(self) -> tuple[Any, ...]:
        """Without events, and how near stops came."""
        return self[:-2]

    def add(self, part: Segment, kept: Bool[Array, "*lanes"]) -> "Measures":
        """Add a step where it was kept.

        Integrals by the trapezoidal rule with its end correction, of fourth order; extremes of the
        cubic through both ends.
        """
        (y0, y1), (v0, v1), h = part.response, part.response_rate, part.duration
        ((s0, c0), (s1, c1)), w = part.wave, part.angular_frequency

        def integral(f0, g0, f1, g1):
            return h / 2 * (f0 + f1) + h**2 / 12 * (g0 - g1)

        high = cubic_maximum(y0, v0 * h, y1, v1 * h)
        low = -cubic_maximum(-y0, -v0 * h, -y1, -v1 * h)
        square = integral(y0**2, 2 * y0 * v0, y1**2, 2 * y1 * v1)
        with_sine = integral(y0 * s0, v0 * s0 + w * y0 * c0, y1 * s1, v1 * s1 + w * y1 * c1)
        with_cosine = integral(y0 * c0, v0 * c0 - w * y0 * s0, y1 * c1, v1 * c1 - w * y1 * s1)
        counted = self.passed(h, part.touches, part.entries, kept)
        return counted.integrated(square, with_sine, with_cosine, kept).reached(
            high, low, part.force, kept
        )

    def passed(
        self,
        duration: Float[Array, "*lanes"],
        touches: Bool[Array, "*lanes"],
        entries: Int[Array, "*lanes"],
        kept: Bool[Array, "*lanes"],
    ) -> "Measures":
        """Count times and contacts where a step was kept."""
        return self._replace(
            time=self.time + jnp.where(kept, duration, 0.0),
            contact_time=self.contact_time + jnp.where(kept & touches, duration, 0.0),
            contacts=self.contacts + jnp.where(kept, entries, 0),
        )

    def noted(
        self, stop: Int[Array, "*lanes"], angle: Float[Array, "*lanes"], kept: Bool[Array, "*lanes"]
    ) -> "Measures":
        """Note where a stop changed its contact, if that is asked for."""
        if self.events is None:
            return self
        return self._replace(events=self.events.add(stop, angle, kept))

    def integrated(
        self,
        square: Float[Array, "*lanes"],
        with_sine: Float[Array, "*lanes"],
        with_cosine: Float[Array, "*lanes"],
        kept: Bool[Array, "*lanes"],
    ) -> "Measures":
        """Add integrals over a part of the motion where it was kept."""
        return self._replace(
            integral_of_square=self.integral_of_square + jnp.where(kept, square, 0.0),
            integral_with_sine=self.integral_with_sine + jnp.where(kept, with_sine, 0.0),
            integral_with_cosine=self.integral_with_cosine + jnp.where(kept, with_cosine, 0.0),
        )

    def reached(
        self,
        high: Float[Array, "*lanes"],
        low: Float[Array, "*lanes"],
        force: Float[Array, "*lanes"],
        kept: Bool[Array, "*lanes"],
    ) -> "Measures":
        """Take note of extremes of a part of the motion where it was kept."""
        return self._replace(
            highest=jnp.where(kept, jnp.maximum(self.highest, high), self.highest),
            lowest=jnp.where(kept, jnp.minimum(self.lowest, low), self.lowest),
            force=jnp.where(kept, jnp.maximum(self.force, force), self.force),
        )


def no_measures(like: Float[Array, "*lanes"]) -> Measures:
    """Measures before the first step."""
    zero = jnp.zeros_like(like)
    far = jnp.full_like(like, jnp.inf)
    return Measures(zero, -far, far, zero, zero, zero, zero, zero, jnp.zeros(like.shape, jnp.int32))


def ratios_of(m: Measures, window: Any, reference: Any, xp: ModuleType = np) -> dict[str, Any]:
    """Turn sums over so many drive periods into variables, in arrays of numpy or of JAX."""
    time = xp.where(m.time > 0, m.time, 1.0)
    harmonic = xp.hypot(m.integral_with_sine, m.integral_with_cosine) * 2 / time
    return {
        "amplitude_ratio": (m.highest - m.lowest) / 2 / reference,
        "peak_ratio": xp.maximum(m.highest, -m.lowest) / reference,
        "rms_ratio": xp.sqrt(m.integral_of_square / time) / reference,
        "first_harmonic_ratio": harmonic / reference,
        "contact_force": m.force,
        "contact_fraction": m.contact_time / time,
        "contacts_per_period": m.contacts / window,
    }
