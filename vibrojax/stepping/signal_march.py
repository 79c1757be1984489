"""Marching under an input that is linear between samples, through linear contact, exactly.

As long as contact does not change, the motion is known at many samples ahead by one product with a
table, and depth and push of every stop between two samples are a cubic, but for a bounded rest. The
first interval in which that leaves room for a change of contact is looked at more closely: by power
series from step to step, on which the change is found for certain and landed on.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax.stepping.input_phases import (
    Ahead,
    InputPhases,
    first_change,
    series,
    tables_ahead,
    value_and_slope,
)
from vibrojax.stepping.replay import replayed_while

lax = jax.lax

AHEAD = 32
"""Samples that are computed at once."""
MOST_KEPT = 64
"""Samples between two that are kept, up to which a segment holds several of those."""
ROUNDS = 2000
"""Rounds in a segment, a few for a contact, before a motion is given up."""

Carried = Float[Array, " carried"]


class Place(NamedTuple):
    """Where a march is within a segment."""

    carried: Carried
    phase: Int[Array, ""]
    sample: Int[Array, ""]
    """Of the segment, from 0."""
    time: Float[Array, ""]
    """After that sample, times w."""
    closely: Bool[Array, ""]
    """Whether the interval that follows is one to look at closely."""
    rounds: Int[Array, ""]
    kept: Float[Array, "room carried"]
    """What was carried at the samples of the segment after the first."""


class Segment(eqx.Module):
    """How a march goes over a segment of samples."""

    phases: InputPhases
    ahead: Ahead | None
    """None: every interval is looked at closely."""
    samples: int = eqx.field(static=True)
    """Intervals in a segment."""
    keeps: bool = eqx.field(static=True)
    """Whether all samples are kept, not only the last."""
    reverse: bool = eqx.field(static=True)

    def __call__(
        self,
        begun: tuple[Carried, Int[Array, ""]],
        inputs: tuple[Float[Array, " inputs"], Float[Array, ""]],
    ) -> tuple[tuple[Carried, Int[Array, ""]], Float[Array, "samples carried"]]:
        """Go over one segment: `inputs` at its samples and as many ahead, and their interval."""
        carried, phase = begun
        values, step = inputs
        room = self.samples + AHEAD if self.keeps and self.ahead is not None else 1
        zero = jnp.zeros((), jnp.int32)
        place = Place(
            carried,
            phase,
            zero,
            jnp.zeros(()),
            jnp.asarray(self.ahead is None),
            zero,
            jnp.zeros((room, carried.shape[0])),
        )

        def going(place: Place) -> Bool[Array, ""]:
            return (place.sample < self.samples) & (place.rounds < ROUNDS)

        fine, far = partial(self.fine, values=values, step=step), partial(self.far, values=values)

        def on(place: Place, _: Any = None) -> Place:
            if self.ahead is None:
                place = fine(place)
            elif not self.phases.num_stops:
                place = far(place)
            else:
                place = lax.cond(place.closely, fine, far, place)
            return place._replace(rounds=place.rounds + 1)

        if self.reverse:
            place = replayed_while(going, on, place, ROUNDS)
        else:
            place = lax.while_loop(going, on, place)
        arrived = place.sample >= self.samples
        end = jnp.where(arrived, place.carried, jnp.inf)
        kept = place.kept[: self.samples] if room > 1 else end[None]
        return (end, place.phase), kept

    def far(self, place: Place, values: Float[Array, " inputs"]) -> Place:
        """Go on by as many samples ahead as contact is certain not to change."""
        phases, tables = self.phases, self.ahead
        assert tables is not None  # asked for where there are tables
        coming = lax.dynamic_slice_in_dim(values, place.sample, AHEAD + 1)
        known = jnp.concatenate([place.carried, coming])
        found = tables.table[place.phase] @ known
        left = jnp.minimum(self.samples - place.sample, AHEAD)
        count = left
        if phases.num_stops:
            quiet = self._quiet(place.phase, jnp.concatenate([place.carried[None], found]), coming)
            count = jnp.minimum(jnp.sum(jnp.cumprod(quiet)), left)
        reached = jnp.where(count > 0, found[jnp.maximum(count - 1, 0)], place.carried)
        kept = place.kept
        if kept.shape[0] > 1:  # what lies beyond the samples reached is written over later
            kept = lax.dynamic_update_slice_in_dim(kept, found, place.sample, axis=0)
        return place._replace(
            carried=reached,
            sample=place.sample + count.astype(jnp.int32),
            closely=count < left,
            kept=kept,
        )

    def _quiet(
        self,
        phase: Int[Array, ""],
        carried: Float[Array, "samples carried"],
        inputs: Float[Array, " samples"],
    ) -> Bool[Array, " intervals"]:
        """Whether contact is certain not to change in the intervals between samples."""
        phases, tables, m = self.phases, self.ahead, self.phases.carried
        assert tables is not None
        carried, inputs = lax.stop_gradient((carried, inputs))
        step, matrix = lax.stop_gradient((tables.step, phases.matrix[phase]))
        rows = lax.stop_gradient(jnp.concatenate([phases.depth, phases.push]))
        z = jnp.concatenate([carried, inputs[:, None]], axis=1)
        value = carried @ rows[:, :m].T
        slope = z @ (rows @ matrix)[:, : m + 1].T * (step / 3)
        change = jnp.diff(inputs)[:, None] / step
        size = jnp.abs(jnp.concatenate([z[:-1], change], axis=1))
        rest = size @ tables.bound[phase].reshape(len(rows), -1).T
        rest = rest + 1e-15 * (size @ jnp.abs(rows).T)
        # A cubic stays between the least and the largest of these.
        corners = value[:-1], value[:-1] + slope[:-1], value[1:] - slope[1:], value[1:]
        corners = jnp.stack(corners)
        least, most = jnp.min(corners, axis=0) - rest, jnp.max(corners, axis=0) + rest
        depth_most, push_most = jnp.split(most, 2, axis=1)
        _, push_least = jnp.split(least, 2, axis=1)
        in_flight = (depth_most < 0) | (push_most < 0)
        quiet = jnp.all(jnp.where(self._touching(phase), push_least > 0, in_flight), axis=1)
        # What is lost may go on.
        return quiet | ~jnp.isfinite(jnp.sum(carried[:-1], axis=1))

    def _touching(self, phase: Int[Array, ""]) -> Bool[Array, " stops"]:
        return (phase >> np.arange(self.phases.num_stops)) & 1 == 1

    def fine(self, place: Place, values: Float[Array, " inputs"], step: Float[Array, ""]) -> Place:
        """Go on by one step of a power series, to its end or to the first change of contact."""
        phases, m = self.phases, self.phases.carried
        start = values[place.sample]
        slope = (values[place.sample + 1] - start) / step
        z = jnp.concatenate([place.carried, jnp.stack([start + slope * place.time, slope])])
        left = step - place.time
        last = left <= phases.longest[place.phase]
        length = jnp.where(last, left, phases.longest[place.phase])
        terms = series(phases.matrix[place.phase], z, length)
        share, stop, phase = jnp.ones(()), jnp.int32(-1), place.phase
        if phases.num_stops:
            depth, push = terms @ phases.depth.T, terms @ phases.push.T
            rows = jnp.stack([phases.depth, phases.push])
            noise = 1e-15 * (jnp.abs(rows) @ jnp.abs(z))
            touching = self._touching(phase)
            share, stop, by_depth = first_change(*lax.stop_gradient((depth, push, noise)), touching)
            found = stop >= 0
            # One step of Newton's method has the derivative of the time of the change.
            own = jnp.where(by_depth, depth[:, stop], push[:, stop])
            value, rate = value_and_slope(own, share)
            rate = lax.stop_gradient(jnp.where(found, rate, 1.0))
            moved = jnp.where(found & (rate != 0), value / jnp.where(rate == 0, 1.0, rate), 0.0)
            # Where the rounding of a graze leads far off, the place that was found is kept.
            near = jnp.abs(lax.stop_gradient(moved)) < 1e-6
            share = share - jnp.where(near, moved, 0.0)
            phase = jnp.where(found, phase ^ (1 << jnp.maximum(stop, 0)), phase)
        end, _ = value_and_slope(terms, share)
        arrived = last & (stop < 0)
        kept = place.kept
        if kept.shape[0] > 1:
            noted = jnp.where(arrived, end[:m], kept[place.sample])
            kept = kept.at[place.sample].set(noted)
        return place._replace(
            carried=end[:m],
            phase=phase.astype(jnp.int32),
            sample=place.sample + arrived,
            time=jnp.where(arrived, 0.0, place.time + share * length),
            closely=~arrived if self.ahead is not None else place.closely,
            kept=kept,
        )


def march_equal(
    phases: InputPhases,
    carried: Carried,
    values: Float[Array, " inputs"],
    step: Float[Array, ""],
    *,
    stride: int,
    count: int,
    reverse: bool,
) -> Float[Array, "samples carried"]:
    """March over equal intervals (s); return what is carried at every `stride`-th sample.

    `values` are the inputs (m/s2 or N) at `count` times `stride` intervals, kept beyond.
    """
    keeps = stride <= MOST_KEPT
    samples = stride * -(-AHEAD // stride) if keeps else stride
    segments = -(-count * stride // samples)
    room = np.minimum(np.arange(segments * samples + samples), values.shape[0] - 1)
    parts = values[room].reshape(segments + 1, samples)
    windows = jnp.concatenate([parts[:-1], parts[1:, :AHEAD]], axis=1)
    unit_step = step * phases.unit
    tables = tables_ahead(phases, unit_step, AHEAD)
    segment = Segment(phases, tables, samples, keeps, reverse)
    first = phases.first_phase(carried, values[0])

    def one(begun: tuple, values: Array) -> tuple:
        begun, kept = segment(begun, (values, unit_step))
        return begun, kept[stride - 1 :: stride] if keeps else kept

    one = jax.checkpoint(one) if reverse else one
    _, found = lax.scan(one, (carried, first), windows)
    found = found.reshape(-1, carried.shape[0])[:count]
    return jnp.concatenate([carried[None], found])


def march_unequal(
    phases: InputPhases,
    carried: Carried,
    values: Float[Array, " knots"],
    time: Float[Array, " knots"],
    *,
    reverse: bool,
) -> Float[Array, "knots carried"]:
    """March over the intervals between times (s), which may be of any length, or none."""
    segment = Segment(phases, None, 1, True, reverse)
    first = phases.first_phase(carried, values[0])
    steps = jnp.diff(time) * phases.unit
    # Between two knots at one time there is no way, and no slope.
    apart = steps > 0
    safe = jnp.where(apart, steps, 1.0)

    def one(begun: tuple, inputs: tuple) -> tuple:
        way, apart = inputs
        ended, _ = segment(begun, way)
        begun = jax.tree.map(lambda new, old: jnp.where(apart, new, old), ended, begun)
        return begun, begun[0]

    one = jax.checkpoint(one) if reverse else one
    windows = jnp.stack([values[:-1], values[1:]], axis=1)
    _, found = lax.scan(one, (carried, first), ((windows, safe), apart))
    return jnp.concatenate([carried[None], found])
