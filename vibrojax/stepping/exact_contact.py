"""Marching through linear contact without error of integration.

Flight and contact are both linear (`contact_phases`), so a lane flies on exact propagators and the
only approximation is where it changes phase. In every round a lane looks ahead (`outlook`), goes
where the first change of contact is for certain, or as far as there is none, and lands by the root
of the parabola there; the state goes over to the block coordinates of the new phase. The landing
carries the derivative of the crossing time, so forward-mode derivatives are those of the
non-smooth motion, saltation included.

Every array has the lanes as trailing axes, for speed only (XLA then vectorises over lanes): with
no such axes it is the code of one lane.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from vibrojax.model.drives import AbstractDrive, AbstractWaveform
from vibrojax.model.systems import Motion
from vibrojax.stepping.contact_loop import ContactLoop, Flight
from vibrojax.stepping.contact_phases import ContactPhases, spread
from vibrojax.stepping.elementary import apply_matrix
from vibrojax.stepping.forcing import Forcing, forcing
from vibrojax.stepping.gauge import Ruler, no_stretches
from vibrojax.stepping.measures import MOST_EVENTS, Measures, no_events, no_measures
from vibrojax.stepping.phase_motion import contact_indicator, stop_push
from vibrojax.stepping.replay import replayed_while
from vibrojax.stepping.runs import AbstractRun

lax = jax.lax

ROUNDS = 4000
"""Rounds in a drive period before a lane is given up, unless given otherwise."""
GIVEN_UP = jnp.inf
"""State of a lane that was given up; NaN is one whose motion stopped being finite."""
TOGETHER = 0.3
"""Share of the lanes of a run that reach the end of their period before any goes on."""


def march(
    phases: ContactPhases,
    force: Forcing,
    state: Float[Array, "states *#lanes"],
    periods: int | Int[Array, "*#lanes"] = 1,
    *,
    ruler: Ruler | None = None,
    room: int = MOST_EVENTS,
    rounds: int = ROUNDS,
) -> tuple[Float[Array, "states *#lanes"], Int[Array, "*#lanes"], Measures | None]:
    """March every lane over its number of drive periods, each at its own pace.

    Returns the states (q, q'), the rounds made, and the measures where there is a `ruler` for them,
    with as many changes of contact noted as there is room for.
    A lane that takes more than so many `rounds` for a drive period is left where it is,
    with fewer periods behind it, and its state is `GIVEN_UP`: the caller flags it.
    """
    loop = ContactLoop(phases, force, ruler)
    target = jnp.broadcast_to(jnp.asarray(periods, jnp.int32), loop.period.shape)
    flight = run(loop, state, loop.period, target, None, room, rounds)
    end = loop.state_of(flight.blocks, flight.phase, flight.time)
    end = _or_lost(end, flight.finished >= target, state)
    return end, flight.rounds, flight.measures


def _or_lost(
    end: Float[Array, "states *#lanes"],
    arrived: Bool[Array, "*#lanes"],
    start: Float[Array, "states *#lanes"],
) -> Float[Array, "states *#lanes"]:
    """States of lanes that arrived; of the others, also of those lost before, why they did not."""
    before = jnp.any(start == GIVEN_UP, axis=0)
    given_up = jnp.all(jnp.isfinite(end), axis=0) | before
    return jnp.where(arrived & ~before, end, jnp.where(given_up, GIVEN_UP, jnp.nan))


class ExactRun(AbstractRun):
    """Lanes in exact contact: who arrives waits for some of the others, not for the slowest."""

    def __init__(self, phases: ContactPhases, force: Forcing, rounds: int = ROUNDS):
        self.loop, self.rounds = ContactLoop(phases, force), rounds

    def begin(self, state: Float[Array, "states *lanes"]) -> Flight:
        """Put lanes at the beginning of a drive period."""
        return enter(self.loop, state)

    def go_on(
        self, lanes: Flight, live: Bool[Array, "*lanes"]
    ) -> tuple[Flight, Bool[Array, "*lanes"]]:
        """Take live lanes further until enough are at the end of their period, or given up."""
        loop, most, enough = self.loop, self.rounds, jnp.ceil(TOGETHER * jnp.sum(live))

        def arrived(flight: Flight) -> Bool[Array, "*lanes"]:
            return live & ((flight.finished > 0) | (flight.rounds >= most))

        def round_(carry: tuple[Flight, Int[Array, ""]]) -> tuple[Flight, Int[Array, ""]]:
            flight, tick = carry
            return loop.round(flight, live & ~arrived(flight), tick, loop.period), tick + 1

        flight, _ = lax.while_loop(
            lambda carry: jnp.sum(arrived(carry[0])) < enough, round_, (lanes, jnp.int32(0))
        )
        return flight, arrived(flight)

    def arrived_at(
        self, lanes: Flight
    ) -> tuple[Float[Array, "states *lanes"], Int[Array, "*lanes"]]:
        """Return the states of lanes at the end of their period, and the rounds it took."""
        end = self.loop.state_of(lanes.blocks, lanes.phase, jnp.zeros_like(lanes.time))
        return _or_lost(end, lanes.finished > 0, end), lanes.rounds


def step_from(
    phases: ContactPhases,
    motion: Motion,
    state: Float[Array, " states"],
    start: Float[Array, ""],
    duration: Float[Array, ""],
    max_attempts: int | None,
) -> Float[Array, " states"]:
    """Advance one lane from a time (s) over a duration, for any waveform.

    Harmonic drives are exact; of a chirp the step takes the frequency and amplitude of its middle.
    With `max_attempts` reverse mode can differentiate the loop, of that many rounds at the most;
    else `vmap` runs the lanes in one loop with the layout of `march`. The state is `GIVEN_UP` if
    the rounds did not suffice.
    """
    numbers = phases, motion.drive, motion.waveform, state, start, duration
    numbers = jax.tree.map(lambda a: jnp.asarray(a, float), numbers)
    if max_attempts is None:
        return _step(*numbers)
    return _step_lanes(*numbers, max_attempts=max_attempts)


@partial(jax.jit, static_argnames=("max_attempts", "lanes"))  # diffrax traces a step three times
def _step_lanes(
    phases: ContactPhases,
    drive: AbstractDrive,
    waveform: AbstractWaveform,
    state: Float[Array, "states *#lanes"],
    start: Float[Array, "*#lanes"],
    duration: Float[Array, "*#lanes"],
    *,
    max_attempts: int | None = None,
    lanes: tuple[int, ...] = (),
) -> Float[Array, "states *lanes"]:
    phase, _, _ = waveform.phase(start)
    _, rate, second = waveform.phase(start + duration / 2)
    start_phase = phase - 2 * jnp.pi * jnp.round(phase / (2 * jnp.pi))
    amplitude = drive.complex_amplitude(rate, second)
    amplitude, rate, start_phase, duration = (
        jnp.broadcast_to(a, lanes) for a in (amplitude, rate, start_phase, duration)
    )
    state = jnp.broadcast_to(spread(state, 1, len(lanes)), (state.shape[0], *lanes))
    force = forcing(phases, amplitude, rate, start_phase)
    loop = ContactLoop(phases, force)
    flight = run(loop, state, duration, jnp.ones(lanes, jnp.int32), max_attempts)
    end = loop.state_of(flight.blocks, flight.phase, duration)
    return _or_lost(end, flight.finished > 0, state)


@jax.custom_batching.custom_vmap
def _step_any_lanes(*numbers: Any) -> Float[Array, " states"]:
    return _step_lanes(*numbers)


@_step_any_lanes.def_vmap
def _step_batched(
    axis_size: int, in_batched: Any, *numbers: Any
) -> tuple[Float[Array, "lanes states"], bool]:
    # Lanes go last, as the loop wants them: `vmap` itself would put them first, ten times slower.
    lanes_last = jax.tree.map(
        lambda is_batched, a: jnp.moveaxis(a, 0, -1) if is_batched else a,
        tuple(in_batched),
        numbers,
    )
    return jnp.moveaxis(_step_lanes(*lanes_last, lanes=(axis_size,)), -1, 0), True


@jax.custom_jvp
def _step(*numbers: Any) -> Float[Array, " states"]:
    return _step_any_lanes(*numbers)


@_step.defjvp
def _step_jvp(numbers: Any, changes: Any) -> tuple[Float[Array, " states"], Any]:
    # A rule for vmap cannot be differentiated under another vmap: derivatives go without it.
    return jax.jvp(_step_lanes, numbers, changes)


def enter(
    loop: ContactLoop, state: Float[Array, "states *#lanes"], room: int = MOST_EVENTS
) -> Flight:
    """Put a state (q, q') at time 0 into block coordinates."""
    force, phases = loop.force, loop.phases
    zero = jnp.zeros_like(force.angular_frequency)
    tolerance = _no_depth(loop, state)
    position = apply_matrix(phases.towards_stop, state)
    speed = apply_matrix(phases.speed_towards_stop, state)
    depth = position - spread(phases.gap, 1, loop.lanes)
    stiffness, damping = (spread(a, 1, loop.lanes) for a in (phases.stiffness, phases.damping))
    can_pull, w = loop.column(phases.can_pull).astype(bool), force.angular_frequency
    pushes = stop_push(stiffness, damping, can_pull, w, depth, speed, jnp.zeros_like(depth))
    indicator, rate = contact_indicator(depth, speed, *pushes)
    touching = indicator > 0
    if all(phases.can_pull):
        # As close as a landing counts as crossing: where it is going says on which side it is.
        touching = jnp.where(jnp.abs(indicator) <= tolerance, rate > 0, touching)
    phase = jnp.broadcast_to(loop.phase_of(touching), zero.shape)

    blocks = loop.blocks_of(state, phase, zero)
    count = jnp.zeros(zero.shape, jnp.int32)
    measures = passed = None
    if loop.gauge is not None:
        measures = no_measures(zero)._replace(events=no_events(phase, room))
        if loop.gauge.ruler.nearest:
            nowhere = jnp.zeros((phases.num_stops, *zero.shape))
            measures = measures._replace(nearest=jnp.stack([nowhere - jnp.inf, nowhere]))
        passed = no_stretches(blocks)
    return Flight(
        blocks, phase, zero, zero + 1, zero, count, count, count, tolerance, measures, passed
    )


def _no_depth(loop: ContactLoop, state: Float[Array, "states *#lanes"]) -> Float[Array, "*lanes"]:
    """Depth, m, that counts as none."""
    # A stop without gap on a body without drive has no length of its own: take the state's.
    phases, w = loop.phases, loop.force.angular_frequency
    rows = (
        spread(phases.towards_stop, 2, loop.lanes),
        spread(phases.speed_towards_stop, 2, loop.lanes),
    )
    weight = jnp.abs(rows[0]) + jnp.abs(rows[1]) / w
    size = jnp.sum(weight * lax.stop_gradient(jnp.abs(state)), axis=1)
    size = jnp.max(size, axis=0, initial=0.0)
    return jnp.maximum(loop.force.depth_tolerance, 1e-9 * size)


def run(
    loop: ContactLoop,
    state: Float[Array, "states *#lanes"],
    duration: Float[Array, "*#lanes"],
    target: Int[Array, "*#lanes"],
    max_attempts: int | None,
    room: int = MOST_EVENTS,
    rounds: int = ROUNDS,
) -> Flight:
    """Fly every lane `target` times over the duration, starting each time at drive time 0."""
    flight = enter(loop, state, room)
    budget = jnp.minimum(target.astype(float) * rounds, 2e9).astype(jnp.int32)

    def left(flight: Flight) -> Bool[Array, "*lanes"]:
        return (flight.finished < target) & (flight.rounds < budget)

    def live(flight: Flight) -> Bool[Array, "*lanes"]:
        # Who has no place to note where it was waits until that is measured.
        return left(flight) & (True if flight.passed is None else flight.passed.has_room())

    def round_(flight: Flight, tick: Int[Array, ""]) -> Flight:
        return loop.round(flight, live(flight), tick, duration)

    if max_attempts is not None:
        return replayed_while(lambda f: jnp.any(live(f)), round_, flight, max_attempts)

    def further(flight: Flight) -> Flight:
        return lax.while_loop(
            lambda carry: jnp.any(live(carry[0])),
            lambda carry: (round_(*carry), carry[1] + 1),
            (flight, jnp.int32(0)),
        )[0]

    if loop.gauge is None:
        return further(flight)
    return lax.while_loop(
        lambda flight: jnp.any(left(flight)), lambda flight: loop.measured(further(flight)), flight
    )
