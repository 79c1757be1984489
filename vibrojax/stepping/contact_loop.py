"""The loop of exact contact: one attempt after another, each lane at its own pace."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from vibrojax._tools.trigonometry import cosine
from vibrojax.stepping.contact_phases import ContactPhases, spread
from vibrojax.stepping.cubic import cubic_between, cubic_maximum
from vibrojax.stepping.elementary import apply_matrix, computed_once, where_needed
from vibrojax.stepping.forcing import Forcing
from vibrojax.stepping.measures import Measures, Segment
from vibrojax.stepping.phase_motion import contact_indicator, stop_push
from vibrojax.stepping.resonance import driven_growth

lax = jax.lax

Number = Float[Array, "*#lanes"]
Phase = Int[Array, "*#lanes"]
Whether = Bool[Array, "*#lanes"]
Blocks = Float[Array, "2 blocks *#lanes"]
PerStop = Float[Array, "stops *#lanes"]
Which = Bool[Array, "stops *#lanes"]
Rows = Float[Array, "rows *#lanes"]

_PLACES = (0.15, 0.325, 0.5, 0.675, 0.85)
"""Where along a step the cubics are asked how far from zero they stay."""


class Flight(NamedTuple):
    """Where a lane is: the carry of the loop."""

    blocks: Float[Array, "2 blocks *#lanes"]
    phase: Int[Array, "*#lanes"]
    time: Float[Array, "*#lanes"]
    step: Float[Array, "*#lanes"]
    reading: Float[Array, "rows *#lanes"]
    finished: Int[Array, "*#lanes"]
    attempts: Int[Array, "*#lanes"]
    measures: Measures | None


def pick(index: Int[Array, "*#lanes"], table: Array) -> Array:
    """Take the row of each lane: `where` for the usual two, which XLA fuses; no gather."""
    chosen = table[0]
    for i in range(1, table.shape[0]):
        chosen = jnp.where(index == i, table[i], chosen)
    return chosen


def _wiggle(phases: ContactPhases) -> Float[Array, "phases stops blocks *lanes"]:
    """What a unit of every block adds to the largest error of the cubic for a depth, over h^4.

    The cubic through values and slopes is off by at most h^4/384 times the fourth derivative.
    """
    n = phases.num_blocks
    rows = phases.readout[:, : phases.num_stops]
    size = jnp.sqrt(rows[:, :, :n] ** 2 + rows[:, :, n:] ** 2)
    rate = jnp.max(phases.exponent**2, axis=1) + phases.rate**2
    return size * rate[:, None] ** 2 / 384


class ContactLoop:
    """The attempt of one step, over tables that stay fixed while the loop runs."""

    def __init__(self, phases: ContactPhases, force: Forcing, observe: bool):
        self.phases, self.force, self.observe = phases, force, observe
        self.lanes = force.angular_frequency.ndim
        self.stops, self.n = phases.num_stops, phases.num_blocks
        self.count = 2**self.stops
        self.exponent = spread(phases.exponent, 3, self.lanes)
        self.rate = spread(phases.rate, 2, self.lanes)
        self.oscillates = spread(phases.oscillates, 2, self.lanes) > 0
        self.wiggle = spread(_wiggle(phases), 3, self.lanes)
        self.period = 2 * jnp.pi / force.angular_frequency
        # Velocity is read after a change of phase only by laws and measures that ask for it.
        self.reread = observe or not all(phases.can_pull)
        rows = 3 * self.stops + 2 if observe else (3 if self.reread else 2) * self.stops
        readout = phases.readout[:, :rows]
        self.readout = readout.reshape(-1, *readout.shape[2:])
        self.readout_rest = spread(phases.readout_rest, 2, self.lanes)[:, :rows]
        self.readout_wave = force.readout[:, :rows].real, force.readout[:, :rows].imag
        change = phases.change
        self.change = change.reshape(-1, *change.shape[3:])
        self.change_rest = spread(phases.change_rest, 3, self.lanes)
        self.change_wave = force.change.real, force.change.imag
        self.resonant = jnp.any(force.driven != 0)
        self.bits = self.column([1 << s for s in range(self.stops)]).astype(np.int32)

    def phase_of(self, touching: Which) -> Phase:
        """Index of the phase in which these stops touch."""
        return jnp.sum(jnp.where(touching, self.bits, 0), axis=0, dtype=jnp.int32)

    def column(self, values: Sequence[float | int]) -> Shaped[np.ndarray, "rows *ones"]:
        """Put one value per row, the same for all lanes."""
        return np.asarray(values).reshape((len(values),) + (1,) * self.lanes)

    def phasor(self, time: Number) -> Float[Array, "2 *#lanes"]:
        """Sine and cosine of the drive phase, as one array."""
        angle = self.force.start_phase + self.force.angular_frequency * time
        return cosine(angle - self.column([np.pi / 2, 0.0]))

    def read(self, blocks: Blocks, phase: Phase, sine: Number, cosine_: Number) -> Rows:
        """Read depths and speeds (and more, where needed) off block coordinates."""
        flat = blocks.reshape(2 * self.n, *blocks.shape[2:])
        rows = apply_matrix(self.readout, flat)
        rows = rows.reshape(self.count, -1, *rows.shape[1:])
        return (
            pick(phase, rows + self.readout_rest)
            + pick(phase, self.readout_wave[0]) * sine
            + pick(phase, self.readout_wave[1]) * cosine_
        )

    def touching(self, phase: Phase) -> Which:
        """Which stops are in contact."""
        return (phase & self.bits) > 0

    def contact(self, reading: Rows) -> tuple[PerStop, PerStop]:
        """Indicator of contact of each stop (positive in contact) and its rate, m and m/s."""
        k = self.stops
        depth, speed = reading[:k], reading[k : 2 * k]
        if all(self.phases.can_pull):
            return depth, speed
        # Without tension contact also ends where the force does.
        push = stop_push(
            spread(self.phases.stiffness, 1, self.lanes),
            spread(self.phases.damping, 1, self.lanes),
            self.column(self.phases.can_pull),
            self.force.angular_frequency,
            depth,
            speed,
            reading[2 * k : 3 * k],
        )
        return contact_indicator(depth, speed, *push)

    def factors(
        self, phase: Phase, oscillates: Bool[Array, "blocks *#lanes"], step: Number
    ) -> Blocks:
        """Growth of both rows of every block over a step: decay times (cosine, sine)."""
        decay, rate = pick(phase, self.exponent), pick(phase, self.rate)
        quarter = self.column([0.0, np.pi / 2])[:, None]
        turn = jnp.where(oscillates, rate * step - quarter, 0.0)
        return jnp.exp(decay * step) * cosine(turn)

    def rotate(
        self, factor: Blocks, oscillates: Bool[Array, "blocks *#lanes"], blocks: Blocks
    ) -> Blocks:
        """Advance block coordinates by their factors: a rotation, or two exponentials."""
        sign = self.column([-1.0, 1.0])[:, None]
        along = jnp.where(oscillates, factor[:1], factor)
        across = jnp.where(oscillates, factor[1:], 0.0)
        return along * blocks + sign * across * blocks[::-1]

    def drift(self, blocks: Blocks, phase: Phase, time: Number) -> Blocks:
        """First-order motion over a short time: the Newton correction of a crossing."""
        decay, rate = pick(phase, self.exponent), pick(phase, self.rate)
        sign = self.column([-1.0, 1.0])[:, None]
        return blocks + time * (decay * blocks + sign * rate * blocks[::-1])

    def pushed(self, blocks: Blocks, phase: Phase, time: Number, step: Number) -> Blocks:
        """Add what the drive does over a step to the blocks that it turns in resonance."""

        def add():
            decay, rate = pick(phase, self.exponent)[0], pick(phase, self.rate)
            driven = pick(phase, self.force.driven)
            frequency = self.force.angular_frequency
            angle = self.force.start_phase + frequency * time
            added = driven_growth(decay, rate, driven, angle, frequency, step)
            return blocks + added.reshape(blocks.shape)

        return where_needed(self.resonant, add, blocks)

    def cubic_error(self, blocks: Blocks, phase: Phase, step: Number) -> PerStop:
        """Bound of the error of the cubics through the depths over a step, m."""
        blocks = lax.stop_gradient(blocks)
        size = jnp.sqrt(blocks[0] ** 2 + blocks[1] ** 2)
        wiggle = lax.stop_gradient(pick(phase, self.wiggle))
        return jnp.sum(wiggle * size, axis=1) * lax.stop_gradient(step) ** 4

    def proposal(
        self,
        start: PerStop,
        start_rate: PerStop,
        end: PerStop,
        end_rate: PerStop,
        step: Number,
        error: PerStop,
        touching: Which,
        tolerance: Number,
    ) -> Number:
        """Fraction of the step up to the first crossing of any stop; 1 where there is none."""
        sign = jnp.where(touching, -1.0, 1.0)
        f0, f1 = jnp.minimum(sign * start, 0.0), sign * end
        d0, d1 = sign * start_rate * step, sign * end_rate * step
        cubic = cubic_between(f0, d0, f1, d1)
        crossed = f1 > tolerance
        # Newton on the cubic from the secant; from the turning point when the step starts on it.
        secant = -f0 / jnp.where(crossed, f1 - f0, 1.0)
        curve = jnp.where(cubic.curve == 0, 1.0, cubic.curve)
        turning = jnp.where(d0 > 0, 0.5, jnp.clip(-d0 / curve, 0, 1))
        u = jnp.clip(jnp.where(f0 > -tolerance, turning, secant), 0.02, 0.95)
        # Short of the end, so that a cubic that misleads cannot hold the lane up.
        u = jnp.clip(cubic.root(guess=u, rounds=4), 0.005, 0.95)
        # A touch and go inside the step shows as a maximum above zero.
        top, height = cubic.peak()
        hidden = ~crossed & (d0 > 0) & (top > 0.01) & (top < 0.99) & (height > tolerance)
        # Where the cubic may be wrong by more than its distance from zero, the step is halved.
        reach = jnp.where(error > tolerance, 16.0 * error, 0.0)
        doubt = jnp.zeros(crossed.shape, bool)
        for x in _PLACES:
            doubt = doubt | (cubic.at(x) + reach * (x * (1 - x)) ** 2 > tolerance)
        accepted = jnp.where(doubt & ~crossed, 0.5, 1.0)
        found = jnp.where(crossed, u, jnp.where(hidden, top, accepted))
        return jnp.min(found, axis=0, initial=1.0)

    def attempt(self, flight: Flight, live: Whether, tick: Int[Array, ""], until: Number) -> Flight:
        """Try one step in every live lane; `until` is the time at which a lane's run ends."""
        once = lambda f: computed_once(tick, f)  # noqa: E731
        force, phase, step = self.force, flight.phase, flight.step
        tolerance = force.depth_tolerance
        oscillates = pick(phase, self.oscillates)
        factors = once(lambda: self.factors(phase, oscillates, step))
        moved = self.rotate(factors, oscillates, flight.blocks)
        moved = self.pushed(moved, phase, flight.time, step)
        time = flight.time + step
        wave = once(lambda: self.phasor(time))
        reading = once(lambda: self.read(moved, phase, wave[0], wave[1]))
        touching = self.touching(phase)
        start, start_rate = self.contact(flight.reading)
        end, end_rate = self.contact(reading)

        error = self.cubic_error(flight.blocks, phase, step)
        seen = lax.stop_gradient((start, start_rate, end, end_rate, step, error))

        def propose():
            return self.proposal(*seen, touching, tolerance)

        fraction = once(propose)
        kept = live & (fraction >= 1.0)
        outward = jnp.where(touching, -end_rate, end_rate)
        arrived = (jnp.abs(end) <= tolerance) & (outward > 0) & kept
        # One stop changes at a time; another one that arrived too is found by the next attempt.
        first = jnp.cumsum(arrived.astype(jnp.int32), axis=0) == 1
        arrived = arrived & first
        flips = jnp.any(arrived, axis=0)
        arriving = jnp.sum(jnp.where(arrived, end, 0.0), axis=0)
        speed = lax.stop_gradient(jnp.sum(jnp.where(arrived, end_rate, 0.0), axis=0))
        limit = 0.02 * lax.stop_gradient(step)

        def newton():
            late = jnp.where(flips, -arriving / jnp.where(speed == 0, 1.0, speed), 0.0)
            return jnp.clip(late, -limit, limit)

        late = once(newton)
        landed = self.pushed(self.drift(moved, phase, late), phase, time, late)
        time = time + late
        turn = force.angular_frequency * late
        sine, cosine_ = wave[0] + turn * wave[1], wave[1] - turn * wave[0]
        blocks, new_phase = landed, phase
        if self.stops:
            blocks, new_phase = self.change_phase(landed, phase, arrived, flips, sine, cosine_)
        done = kept & (time >= until - 1e-12 * step)

        def act():
            return jnp.where(kept, jnp.where(flips, 2, 1), 0).astype(jnp.int32)

        action = once(act)
        blocks = jnp.where(action == 2, blocks, jnp.where(action == 1, moved, flight.blocks))
        new_phase = jnp.where(action == 2, new_phase, phase)
        if self.reread:
            fresh = self.read(blocks, new_phase, sine, cosine_)
            settled = jnp.where(action > 0, fresh, flight.reading)
        else:
            settled = jnp.where(action > 0, reading, flight.reading)
        measures = flight.measures
        if measures is not None:
            segment = self.segment(flight, reading, step + late, touching, arrived)
            measures = measures.add(segment, kept)
        ended = jnp.where(done, 0.0, time)
        following = self.next_step(settled, new_phase, until - ended)
        return Flight(
            blocks=blocks,
            phase=new_phase,
            time=jnp.where(kept, ended, flight.time),
            step=jnp.where(live, jnp.where(kept, following, fraction * step), step),
            reading=settled,
            finished=flight.finished + done,
            attempts=flight.attempts + live,
            measures=measures,
        )

    def change_phase(
        self,
        landed: Blocks,
        phase: Phase,
        arrived: Which,
        flips: Whether,
        sine: Number,
        cosine_: Number,
    ) -> tuple[Blocks, Phase]:
        """Go over to the block coordinates of the phase that the arrived stop leads to."""
        flat = landed.reshape(2 * self.n, *landed.shape[2:])
        rows = apply_matrix(self.change, flat)
        rows = rows.reshape(self.count, self.stops, 2 * self.n, *rows.shape[1:])
        rows = rows + self.change_rest
        rows = rows + self.change_wave[0] * sine + self.change_wave[1] * cosine_
        by_stop = pick(phase, rows)
        changed = by_stop[0]
        for s in range(1, self.stops):
            changed = jnp.where(arrived[s], by_stop[s], changed)
        flipped = phase ^ self.phase_of(arrived)
        return changed.reshape(landed.shape), jnp.where(flips, flipped, phase)

    def next_step(self, reading: Rows, phase: Phase, left: Number) -> Number:
        """Longest step, cut where the present speeds would bring a stop to its crossing."""
        longest = self.force.longest_step
        if self.stops:
            value, rate = (lax.stop_gradient(a) for a in self.contact(reading))
            sign = jnp.where(self.touching(phase), -1.0, 1.0)
            closing = (sign * rate > 0) & (sign * value < 0)
            soon = jnp.where(closing, -value / jnp.where(closing, rate, 1.0), np.inf)
            soon = jnp.min(soon, axis=0)
            longest = jnp.where(soon > 0, jnp.minimum(soon, longest), longest)
        return jnp.minimum(longest, left)

    def segment(
        self, flight: Flight, reading: Rows, duration: Number, touching: Which, arrived: Which
    ) -> Segment:
        """What the measures see of an accepted step."""
        k = self.stops
        start = flight.reading
        stiffness = spread(self.phases.stiffness, 1, self.lanes)
        damping = spread(self.phases.damping, 1, self.lanes)

        def force_of(r):
            depth, speed, acceleration = r[:k], r[k : 2 * k], r[2 * k : 3 * k]
            value = stiffness * depth + damping * speed
            return value, stiffness * speed + damping * acceleration

        (f0, g0), (f1, g1) = force_of(start), force_of(reading)
        peak = jnp.where(touching, cubic_maximum(f0, g0 * duration, f1, g1 * duration), 0.0)
        angle = self.force.start_phase + self.force.angular_frequency * flight.time
        numbers = self.column(range(k))
        return Segment(
            duration=duration,
            angle=angle,
            angle_rate=self.force.angular_frequency,
            response=(start[3 * k], reading[3 * k]),
            response_rate=(start[3 * k + 1], reading[3 * k + 1]),
            force=jnp.max(peak, axis=0, initial=0.0),
            touches=jnp.any(touching, axis=0),
            entries=jnp.sum(arrived & ~touching, axis=0, dtype=jnp.int32),
            changed=jnp.sum(jnp.where(arrived, numbers + 1, 0), axis=0, dtype=jnp.int32) - 1,
        )
