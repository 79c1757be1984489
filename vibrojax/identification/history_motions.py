"""Motions of many trial rigs at the times of a measurement, with their derivatives.

A motion is propagated from sample to sample, exactly where the stops are linear, and everything
that decides it is carried along in forward mode: the numbers sought, the shift of the time axis
and, of a steady motion, the state it starts from.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.identification.record_numbers import Recorded, Sensors, apart
from vibrojax.model.drives import AbstractDrive, AbstractWaveform, BaseMotion, Harmonic, NoDrive
from vibrojax.model.equations import LinearEquations
from vibrojax.model.signals import Sampled
from vibrojax.model.systems import Motion, as_arrays
from vibrojax.steady.starting import stepper
from vibrojax.stepping import splitting
from vibrojax.stepping.contact_phases import ContactPhases, contact_phases
from vibrojax.stepping.linearly_implicit import STEPS
from vibrojax.stepping.signal_grid import SignalGrid, march_on_grid
from vibrojax.stepping.stepper import ExactContact, ExponentialSplitting

lax = jax.lax

LONGEST = 6
"""Drive periods after which a steady motion may repeat."""
MOST_PERIODS = 600
APPROACH, APPROACH_PERIODS = 0.4, 150
"""How far away the drive frequency starts, relative, and in how many periods it arrives."""
BETWEEN_SAMPLES = 8
"""Fewest steps between two samples where nothing says how short contacts are."""
RETURNED = 1e-4
"""Relative return after which a march is left to Newton's method."""


class Plan(NamedTuple):
    """What is measured, and how the motion begins; all of it decided before anything compiles."""

    channels: tuple[str, ...]
    position: float | None
    absolute: bool
    begins: str
    """`settled`, `start`: from a state, or `signal`: from a state, with a drive as measured."""
    is_ratio: bool
    """Whether the drive frequency is a ratio to the first natural one; else Hz."""
    driven: bool
    aligned: bool
    exact: bool
    jumps: bool
    """Whether forces set in with a jump, of a motion that begins within the record."""
    delayed: bool
    """Whether channels have clocks of their own."""
    fitted: tuple[int, ...]
    """Places, among the numbers of the record, of those that come with the rig."""
    together: bool = False
    """Whether all samples are some of an equally spaced drive as measured."""


class Seen(NamedTuple):
    """When each lane was looked at, and what was seen then."""

    time: Float[AnyArray, "*lanes samples"]
    """s."""
    owner: Int[AnyArray, "*lanes samples"]
    """Channel by whose clock this time is, where clocks differ."""
    channel: Int[AnyArray, "*lanes observations"]
    sample: Int[AnyArray, "*lanes observations"]


class Rig(eqx.Module):
    """A trial rig made ready: all that depends on its numbers."""

    equations: LinearEquations
    drive: AbstractDrive
    phases: ContactPhases | None
    """Propagators, where the stops are linear."""
    angular_frequency: Float[Array, "..."]
    """Of the drive, or of the first mode where nothing drives, rad/s."""
    sensor: Float[Array, "*lanes coordinates"]
    """Displacement at the sensor, by coordinate."""
    sensors: Sensors
    start: Float[Array, "*lanes states"]
    """(q, q', internal states) where the motion is not settled."""
    record: Float[Array, "*lanes 2 samples"]
    """Times (s) and values of a drive as measured; without samples where there is none."""
    weight: Float[Array, "*lanes states"]
    """Weights that make states comparable: norms of weighted states are energies."""


class Passed(NamedTuple):
    """Motions at the measured times, with derivatives along the last axis.

    That axis has the numbers, the shift and, of steady motions, the state at the start.
    """

    values: Float[AnyArray, "lanes size"]
    end: Float[AnyArray, "lanes states"]
    """State after the period of the motion."""
    derivative: Float[AnyArray, "lanes size directions"]
    end_derivative: Float[AnyArray, "lanes states directions"]


def start_of(system: Any, equations: LinearEquations, begun: Float[Array, " 2"]) -> tuple:
    """Return (q, q') for what is reported of displacement and velocity at the beginning."""
    if system.reported_place is not None:
        return system.static_shape(begun[0]), system.static_shape(begun[1])
    # As a blow at the sensor makes it; pulled there, but for what nothing holds.
    struck = equations.response_map / equations.modal_mass
    pulled = struck if equations.free else struck / equations.angular_frequency**2
    shape = lambda way: way / (equations.response_map @ way)  # noqa: E731
    return begun[0] * shape(pulled), begun[1] * shape(struck)


def rig_of(system: Any, plan: Plan, frequency, numbers, record) -> Rig:
    """Make a trial rig ready: `numbers` are those of its record."""
    if isinstance(system, Recorded):
        numbers = numbers.at[jnp.array(plan.fitted)].set(system.numbers)
        system = system.system
    begun, sensors = apart(numbers)
    equations = system.equations()
    unit = equations.drive_unit(plan.is_ratio)
    sensor = equations.response_map
    if plan.position is not None:
        sensor = system.shape_at(plan.position)
    q = v = jnp.zeros(equations.size)
    if plan.begins != "settled":
        q, v = start_of(system, equations, begun)
    return Rig(
        equations=equations,
        drive=as_arrays(system.drive) if plan.driven else NoDrive(),
        phases=contact_phases(equations) if plan.exact else None,
        angular_frequency=frequency * unit,
        sensor=sensor,
        sensors=sensors,
        start=jnp.concatenate([q, v, jnp.zeros(equations.memory_size)]),
        record=record,
        weight=equations.energy_weight,
    )


def _motion(rig: Rig) -> Motion:
    waveform: AbstractWaveform = Harmonic(rig.angular_frequency / (2 * jnp.pi))
    if rig.record.shape[-1]:
        waveform = Sampled(*rig.record)
    return Motion(rig.equations, rig.drive, waveform, rig.phases)


def _advance(motion: Motion, exact: bool, fewest: int, start, duration, state):
    """State of one lane after a duration (s)."""
    equations = motion.equations.linear_between_contacts
    assert equations is not None  # checked before
    method = stepper(equations, exact)
    if isinstance(method, ExactContact):
        return method.advance(motion, start, duration, state, None)
    rate = motion.clock
    # An interval of length zero would have no derivative.
    duration = duration + 1e-12 / rate
    per_period = STEPS
    if isinstance(method, ExponentialSplitting):
        per_period = splitting.steps_for(equations, rate, jnp.asarray(method.tolerance))
        fewest = 1
    steps = jnp.ceil(lax.stop_gradient(duration * per_period * rate) / (2 * jnp.pi))
    steps = jnp.maximum(steps, fewest).astype(jnp.int32)
    part = duration / steps
    kept = method.init(None, 0.0, part, state, motion)

    def one(k, state):
        return method.advance(motion, start + k * part, part, state, kept)

    return lax.fori_loop(0, steps, one, state)


def _driven_states(rig: Rig, plan: Plan, times: Float[Array, " samples"]):
    """States (samples, states) at times (s) under a drive as measured."""
    moments = rig.record[0]
    if plan.exact and plan.together:
        step = (moments[-1] - moments[0]) / (moments.shape[0] - 1)
        place = jnp.round((times - moments[0]) / step).astype(int)
        grid = SignalGrid(moments, None, 1)
        return march_on_grid(_motion(rig), grid, rig.start, reverse=False)[place]
    knots = jnp.sort(jnp.concatenate([moments, times]))
    place = jnp.searchsorted(knots, times)
    if plan.exact:
        return march_on_grid(_motion(rig), SignalGrid(knots, place, 1), rig.start, reverse=False)
    return _states(rig, False, rig.start, knots, knots[0])[place]


def _states(
    rig: Rig,
    exact: bool,
    state,
    times: Float[Array, " samples"],
    begun: ArrayLike = 0.0,
    fewest: int = BETWEEN_SAMPLES,
):
    """States (samples, states) at rising times (s), from when the state is given."""
    motion = _motion(rig)

    def step(carry, time):
        state, before = carry
        state = _advance(motion, exact, fewest, before, time - before, state)
        return (state, time), state

    _, states = lax.scan(step, (state, jnp.zeros_like(times[0]) + begun), times)
    return states


def _signals(rig: Rig, plan: Plan, times, states) -> Float[Array, "channels samples"]:
    """What is there to be shown, before the sensors' gains and offsets."""
    motion = _motion(rig)
    equations = motion.sharp_equations()
    moving = plan.absolute and isinstance(rig.drive, BaseMotion)
    base = rig.drive.amplitude if isinstance(rig.drive, BaseMotion) and moving else 0.0
    w, measured = rig.angular_frequency, plan.begins == "signal"

    def read(time, state):
        q, v, memory = equations.split(state)
        held = (memory,) if equations.memory_size else ()
        angle = w * time
        shown = []
        for name in plan.channels:
            if name == "displacement":
                shown.append(rig.sensor @ q + base * jnp.sin(angle))
            elif name == "velocity":
                shown.append(rig.sensor @ v + base * w * jnp.cos(angle))
            elif name == "acceleration":
                push = rig.drive.input(motion.waveform, time)
                a = rig.sensor @ equations.acceleration(q, v, push, *held)
                of_base = -push * moving if measured else -base * w**2 * jnp.sin(angle)
                shown.append(a + of_base)
            else:
                shown.append(jnp.sum(equations.contact_forces(q, v, *held)))
        return jnp.stack(shown)

    return jax.vmap(read)(times, states).T


@compiled
def settle(
    rigs: Rig, plan: Plan
) -> tuple[Float[Array, "visits 2 lanes states"], Int[Array, "2 lanes"]]:
    """March until the motion returns, the frequency coming from below and from above.

    So each lane arrives as a sweep does, and two motions that coexist are both found.

    Returns the last states at drive phase 0, the latest first, and the drive periods after which
    they return.
    """
    march = jax.vmap(stepper(rigs.equations, plan.exact).prepare, out_axes=-1)(
        *jax.tree.map(lambda a: jnp.concatenate([a, a]), (rigs.equations, rigs.drive))
    )
    w = jnp.concatenate([rigs.angular_frequency, rigs.angular_frequency])
    weight = march.energy_weight()
    once = jnp.ones(w.shape, jnp.int32)
    side = jnp.repeat(jnp.array([-APPROACH, APPROACH]), w.size // 2)
    history = jnp.zeros((LONGEST + 1, *weight.shape))

    def step(carry):
        history, count, _ = carry
        off = side * jnp.maximum(1 - count / APPROACH_PERIODS, 0.0)
        state, _, _ = march(history[0] / weight, w * (1 + off), once, False)
        history = jnp.concatenate([(state * weight)[None], history[:-1]])
        size = jnp.linalg.norm(history[0], axis=0)
        gone = jnp.linalg.norm(history[1:] - history[0], axis=1) / size
        return history, count + 1, gone

    def on(carry):
        _, count, gone = carry
        unsettled = jnp.any(jnp.all(gone > RETURNED, axis=0))
        return (count < MOST_PERIODS) & ((count < APPROACH_PERIODS + LONGEST) | unsettled)

    start = history, 0, jnp.full((LONGEST, w.size), jnp.inf)
    history, _, gone = lax.while_loop(on, step, start)
    # One that does not return is left to Newton's method as a motion of one period.
    returned = jnp.any(gone <= RETURNED, axis=0)
    period = jnp.where(returned, jnp.argmax(gone <= RETURNED, axis=0), 0) + 1
    states = jnp.moveaxis(history / weight, 1, -1)
    states = states.reshape(len(states), 2, -1, states.shape[-1])
    return states, period.reshape(2, -1).astype(jnp.int32)


@compiled
def sampled_signals(rigs: Rig, plan: Plan, state, span, count: int):
    """What sensors show (lanes, channels, count) at equal intervals from 0 over a span (s)."""

    def one(rig, state, span):
        times = span * jnp.arange(count) / count
        # So many samples need no steps in between to show where the motion begins.
        states = _states(rig, plan.exact, state, times, fewest=1)
        shown = _signals(rig, plan, times, states)
        return rig.sensors.gain[:, None] * shown + rig.sensors.offset[:, None]

    return jax.vmap(one)(rigs, state, span)


def _before(rig: Rig, plan: Plan, early: Float[Array, " samples"], shown):
    """Let what comes `early` (s, up to 0) move on to the beginning at the velocity it has there."""
    _, v, _ = rig.equations.split(rig.start)
    for row, name in enumerate(plan.channels):
        if name == "displacement":
            shown = shown.at[row].add(rig.sensor @ v * early)
        elif name == "acceleration":
            shown = shown.at[row].set(jnp.where(early < 0, 0.0, shown[row]))
    return shown


@compiled
def pass_through(rigs: Rig, slopes: Rig, plan: Plan, seen: Seen, state, shift, period) -> Passed:
    """Pass through the measured times, each moved by the shift (s) of its lane.

    `state` and `period` (drive periods) are those of a steady motion at drive phase 0.
    """

    def one(rig, slope, seen, state, shift, period):
        settled = plan.begins == "settled"

        def model(rig, shift, state):
            at = seen.time - rig.sensors.delay[seen.owner] if plan.delayed else seen.time
            if plan.begins == "signal":
                at = jnp.maximum(at, rig.record[0, 0]) if plan.delayed else at
                states = _driven_states(rig, plan, at)
                shown, end = _signals(rig, plan, at, states), states[-1]
            else:
                at = at + shift
                length = period * 2 * jnp.pi / rig.angular_frequency
                if settled:
                    at = at - lax.stop_gradient(jnp.floor(at / length)) * length
                early, at = jnp.minimum(at, 0.0), jnp.maximum(at, 0.0)
                order = jnp.argsort(at)
                rising = jnp.append(at[order], length) if settled else at[order]
                states = _states(rig, plan.exact, state if settled else rig.start, rising)
                shown, end = _signals(rig, plan, at, states[jnp.argsort(order)]), states[-1]
                if not settled:
                    shown = _before(rig, plan, early, shown)
            gain, offset, _ = rig.sensors
            shown = gain[:, None] * shown + offset[:, None]
            return shown[seen.channel, seen.sample], end

        numbers, n = slope.angular_frequency.size, state.size if settled else 0
        rows = numbers + 1 + n
        after = lambda a: jnp.concatenate([a, jnp.zeros((rows - numbers, *a.shape[1:]))])  # noqa: E731
        unit = jnp.eye(rows)
        tangents = (
            jax.tree.map(after, slope),
            unit[:, numbers],
            unit[:, numbers + 1 :] if settled else jnp.zeros((rows, state.size)),
        )
        (values, end), slopes_of = jax.vmap(
            lambda t: jax.jvp(model, (rig, shift, state), t), out_axes=(None, -1)
        )(tangents)
        return Passed(values, end, *slopes_of)

    return jax.vmap(one)(rigs, slopes, seen, state, shift, period)
