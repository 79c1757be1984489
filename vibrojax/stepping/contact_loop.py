"""The loop of exact contact: every lane from one change of contact to the next, at its own pace."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from vibrojax._tools.trigonometry import cosine_and_sine
from vibrojax.stepping.contact_phases import ContactPhases, spread
from vibrojax.stepping.elementary import apply_matrix, computed_once, pick, where_needed
from vibrojax.stepping.forcing import Forcing
from vibrojax.stepping.gauge import Gauge, Ruler, Stretches
from vibrojax.stepping.measures import Measures
from vibrojax.stepping.outlook import Sight, outlook_of
from vibrojax.stepping.resonance import driven_growth
from vibrojax.stepping.signals import turning_of, with_wave
from vibrojax.stepping.turns import short_turn, turn_over, turned

lax = jax.lax

Number = Float[Array, "*#lanes"]
Phase = Int[Array, "*#lanes"]
Whether = Bool[Array, "*#lanes"]
Blocks = Float[Array, "2 blocks *#shape"]
Which = Bool[Array, "stops *#lanes"]
Wave = Float[Array, "2 *#shape"]
Tick = Int[Array, ""]
Signed = tuple[Float[Array, "2 turning kinds signals *lanes"], Float[Array, "signals *lanes"]]


class Flight(NamedTuple):
    """Where a lane is: the carry of the loop."""

    blocks: Float[Array, "2 blocks *#lanes"]
    phase: Int[Array, "*#lanes"]
    time: Float[Array, "*#lanes"]
    scale: Float[Array, "*#lanes"]
    """Grid to look on, over the usual one."""
    hint: Float[Array, "*#lanes"]
    """Time to where a crossing has been found, s; 0 where none has."""
    hinted: Int[Array, "*#lanes"]
    """Stop that crosses there."""
    finished: Int[Array, "*#lanes"]
    rounds: Int[Array, "*#lanes"]
    tolerance: Float[Array, "*#lanes"]
    """Depth, m, that counts as none."""
    measures: Measures | None
    passed: Stretches | None
    """What is to be measured yet."""


class Landing(NamedTuple):
    """What becomes of a lane where it has been taken to."""

    again: Bool[Array, "*lanes"]
    """Whether it was taken too far, or not near enough: it tries again, with a hint."""
    stop: Int[Array, "*lanes"]
    """Stop that changes its contact; -1 for none."""
    late: Float[Array, "*lanes"]
    """What is left to the crossing, s."""
    hint: Float[Array, "*lanes"]
    hinted: Int[Array, "*lanes"]


class ContactLoop:
    """One round of all lanes, over tables that stay fixed while the loop runs."""

    def __init__(self, phases: ContactPhases, force: Forcing, ruler: Ruler | None = None):
        self.phases, self.force = phases, force
        self.lanes = force.angular_frequency.ndim
        self.stops, self.n = phases.num_stops, phases.num_blocks
        self.count = 2**self.stops
        self.exponent = spread(phases.exponent, 3, self.lanes)
        self.rate = spread(phases.rate, 2, self.lanes)
        self.period = 2 * jnp.pi / force.angular_frequency
        turning = turning_of(phases, force)
        self.outlook = outlook_of(phases, force, turning) if self.stops else None
        self.change_rest = spread(phases.change_rest, 3, self.lanes)
        self.change_wave = force.change.real, force.change.imag
        self.resonant = jnp.any(force.driven != 0)
        self.gauge = None
        if ruler is not None:
            self.gauge = Gauge(phases, force, turning, ruler, self.grown, self.resonant)
        self.bits = self.column([1 << s for s in range(self.stops)]).astype(np.int32)
        self.numbers = self.column(range(self.stops)).astype(np.int32)

    def phase_of(self, touching: Which) -> Phase:
        """Index of the phase in which these stops touch."""
        return jnp.sum(jnp.where(touching, self.bits, 0), axis=0, dtype=jnp.int32)

    def touching(self, phase: Phase) -> Which:
        """Which stops are in contact."""
        return (phase & self.bits) > 0

    def column(self, values: Sequence[float | int]) -> Shaped[np.ndarray, "rows *ones"]:
        """Put one value per row, the same for all lanes."""
        return np.asarray(values).reshape((len(values),) + (1,) * self.lanes)

    def phasor(self, time: Float[Array, "*#where"]) -> Wave:
        """Sine and cosine of the drive phase, as one array."""
        angle = self.force.start_phase + self.force.angular_frequency * time
        return jnp.stack(cosine_and_sine(angle)[::-1])

    def blocks_of(
        self, state: Float[Array, "states *#lanes"], phase: Phase, time: Number
    ) -> Float[Array, "2 blocks *lanes"]:
        """Block coordinates of a state (q, q') in its phase of contact."""
        from_state = pick(phase, spread(self.phases.from_state, 3, self.lanes))
        flat = apply_matrix(from_state, state) - self.still(phase, time)
        return flat.reshape(2, self.n, *flat.shape[1:])

    def state_of(self, blocks: Blocks, phase: Phase, time: Number) -> Float[Array, "states *lanes"]:
        """State (q, q') of block coordinates."""
        flat = blocks.reshape(2 * self.n, *blocks.shape[2:])
        to_state = pick(phase, spread(self.phases.to_state, 3, self.lanes))
        return apply_matrix(to_state, flat + self.still(phase, time))

    def still(self, phase: Phase, time: Number) -> Float[Array, "states *lanes"]:
        """Block coordinates of rest and the steady response."""
        steady, (sine, cosine) = pick(phase, self.force.blocks), self.phasor(time)
        rest = pick(phase, spread(self.phases.rest, 2, self.lanes))
        return rest + steady.real * sine + steady.imag * cosine

    def pushed(self, blocks: Blocks, phase: Phase, time: Number, step: Number) -> Blocks:
        """Add what the drive does over a step to the blocks that it turns in resonance."""
        return where_needed(self.resonant, lambda: blocks + self.grown(phase, time, step), blocks)

    def grown(self, phase: Phase, time: Number, step: Number) -> Blocks:
        """What the drive in resonance adds over steps, which may have an axis before the lanes."""
        decay, rate = pick(phase, self.exponent)[0], pick(phase, self.rate)
        driven, w = pick(phase, self.force.driven), self.force.angular_frequency
        if step.ndim > self.lanes:
            decay, rate, driven = decay[:, None], rate[:, None], driven[:, None]
        angle = self.force.start_phase + w * time
        added = driven_growth(decay, rate, driven, angle, w, step)
        return added.reshape(2, self.n, *added.shape[1:])

    def round(self, flight: Flight, live: Whether, tick: Tick, until: Number) -> Flight:
        """Take live lanes to their next change of contact, or to the time at which a run ends."""
        once = lambda f: computed_once(tick, f)  # noqa: E731
        phase, left = flight.phase, until - flight.time
        touching = self.touching(phase)
        decay, rate = pick(phase, self.exponent), pick(phase, self.rate)
        outlook = self.outlook
        signed = None if outlook is None else once(lambda: outlook.signed(phase))
        sight = self.look(flight, touching, signed, tick)
        whole = sight.time >= left
        span = jnp.where(whole, left, sight.time)
        creeps = None if outlook is None else outlook.creeps
        turn = once(lambda: turn_over(decay, rate, span, creeps))
        moved = once(lambda: turned(turn, flight.blocks))
        moved = self.pushed(moved, phase, flight.time, span)
        expected = jnp.where(whole, -1, sight.stop)
        landing = self.land(flight, moved, span, expected, signed, tick)
        arrived = flight.time + span + landing.late
        rest = lambda: turned(short_turn(decay, rate, landing.late), moved)  # noqa: E731
        landed = self.pushed(once(rest), phase, flight.time + span, landing.late)
        kept, flips = live & ~landing.again, live & (landing.stop >= 0)

        def changed() -> Array:
            changed = self.change_phase(landed, phase, landing.stop, arrived)
            return jnp.where(kept, jnp.where(flips, changed, landed), flight.blocks)

        new_phase = phase ^ self.phase_of(flips & (self.numbers == landing.stop))
        done = kept & whole & ~flips
        measures, passed = flight.measures, flight.passed
        if self.gauge is not None and measures is not None and passed is not None:
            duration = span + landing.late
            angle = self.force.start_phase + self.force.angular_frequency * arrived
            angle = angle + 2 * np.pi * flight.finished
            entries = jnp.sum((landing.stop == self.numbers) & ~touching, axis=0, dtype=jnp.int32)
            measures = measures.passed(duration, jnp.any(touching, axis=0), entries, kept)
            measures = measures.noted(landing.stop, angle, kept)
            begun = with_wave(flight.blocks, self.phasor(flight.time))
            since_start = flight.time + self.period * flight.finished
            stretch = self.gauge.stretch(begun, phase, since_start, duration, touching)
            passed = passed.add(stretch, kept)
        return Flight(
            blocks=once(changed) if self.stops else jnp.where(kept, landed, flight.blocks),
            phase=new_phase,
            time=jnp.where(kept, jnp.where(done, 0.0, arrived), flight.time),
            scale=jnp.where(kept, sight.scale, flight.scale),
            hint=jnp.where(live, landing.hint, flight.hint),
            hinted=jnp.where(live, landing.hinted, flight.hinted),
            finished=flight.finished + done,
            rounds=flight.rounds + live,
            tolerance=flight.tolerance,
            measures=measures,
            passed=passed,
        )

    def measured(self, flight: Flight) -> Flight:
        """Measure what lanes have gone through."""
        gauge, passed, measures = self.gauge, flight.passed, flight.measures
        if gauge is None or passed is None or measures is None:
            return flight
        measures = gauge.measure(passed, measures, self.touching, self.phasor)
        return flight._replace(passed=passed.forgotten(), measures=measures)

    def look(self, flight: Flight, touching: Which, signed: Signed | None, tick: Tick) -> Sight:
        """How far a lane may go, or is to go to land on a crossing."""
        time, stop = jnp.full_like(flight.scale, jnp.inf), jnp.full_like(flight.phase, -1)
        sight = Sight(time, stop, flight.scale)
        if self.outlook is not None and signed is not None:
            wave = self.phasor(flight.time)
            seen = self.outlook, flight.blocks, wave, flight.scale, flight.tolerance, signed
            outlook, blocks, wave, scale, tolerance, signed = lax.stop_gradient(seen)
            phase = flight.phase
            sight = outlook.look(blocks, phase, touching, wave, scale, tolerance, signed, tick)
            hinted = flight.hint > 0
            time = jnp.where(hinted, flight.hint, sight.time)
            stop = jnp.where(hinted, flight.hinted, sight.stop)
        return Sight(time, stop, sight.scale)

    def land(
        self,
        flight: Flight,
        moved: Blocks,
        span: Number,
        expected: Phase,
        signed: Signed | None,
        tick: Tick,
    ) -> Landing:
        """What becomes of lanes that went for a time, to where a stop was `expected` to change."""
        phase, begun, tolerance = flight.phase, flight.time, flight.tolerance
        touching = self.touching(phase)
        none = jnp.full(span.shape, -1, jnp.int32)
        if self.outlook is None or signed is None:
            return Landing(none > 0, none, 0 * span, 0 * span, none)
        outlook, wave = self.outlook, computed_once(tick, lambda: self.phasor(begun + span))
        read = computed_once(tick, lambda: outlook.read(moved, wave, *signed))
        shortest = pick(phase, self.outlook.shortest)
        value, slope, _ = self.outlook.breach(touching, read)
        late, real = self.outlook.crossing(touching, read)
        real &= (jnp.abs(late) <= shortest) | (late > -span)
        over, awaited = value > tolerance, self.numbers == expected
        # A motion that begins on a stop, as near as counts, is there already.
        here = awaited & ~real & (jnp.abs(value) <= tolerance) & (slope > 0)
        late = jnp.where(here, 0.0, late)
        asked = (here | real) & (over | awaited)
        who = jnp.argmin(jnp.where(asked, late, jnp.inf), axis=0).astype(jnp.int32)
        nearest = pick(who, late)
        found = jnp.any(asked, axis=0)
        lands = found & (jnp.abs(nearest) <= shortest)
        again = ~lands & (found | jnp.any(over, axis=0))
        better = jnp.where(found, jnp.clip(span + nearest, 0.05 * span, 1.5 * span), 0.5 * span)
        return Landing(
            again=again,
            stop=jnp.where(lands, who, -1),
            late=jnp.where(lands, nearest, 0.0),
            hint=lax.stop_gradient(jnp.where(again, better, 0.0)),
            hinted=who,
        )

    def change_phase(
        self, landed: Blocks, phase: Phase, stop: Phase, time: Number
    ) -> Float[Array, "2 blocks *lanes"]:
        """Block coordinates of the phase that a stop's change of contact leads to."""
        flat = landed.reshape(2 * self.n, *landed.shape[2:])
        sine, cosine = self.phasor(time)
        change = self.phases.change
        if change.ndim > 4:  # every lane has its own
            rows = apply_matrix(pick(stop, pick(phase, change)), flat)
        else:
            rows = apply_matrix(change.reshape(-1, 2 * self.n), flat)
            rows = pick(stop, pick(phase, rows.reshape(*change.shape[:3], *flat.shape[1:])))
        real, imaginary, rest = (
            pick(stop, pick(phase, a)) for a in (*self.change_wave, self.change_rest)
        )
        return (rows + rest + real * sine + imaginary * cosine).reshape(landed.shape)
