"""Periodic motions as exact solutions between contact times.

With linear stops every phase of a motion has its exact propagator (`ContactPhases`). A periodic
motion is then known from one state and the sequence in which stops are touched and left: no
samples, no harmonics, no rounding, and no search, since the contact times only have to be
corrected. Whether the motion keeps to its sequence (a virtual orbit does not) is checked when it
is read.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Complex, Float, Int

from vibrojax.model.drives import AbstractDrive
from vibrojax.stepping.contact_phases import ContactPhases, forced_blocks, resonant_blocks
from vibrojax.stepping.elementary import varied
from vibrojax.stepping.forcing import steady_readout
from vibrojax.stepping.phase_motion import driven_blocks, free_blocks, stop_push

lax = jax.lax

ITERATIONS = 8
"""Newton's steps to an orbit."""
TO_SECOND = 3
"""Newton's steps from a solution with which its first and second derivatives are right: where the
force jumps at a change of contact, what is missing to its time in one step is put right in the
next."""

Phase = Int[ArrayLike, ""]
Angle = Float[ArrayLike, ""]


class Events(NamedTuple):
    """Which stops change contact, in order of time."""

    stop: Int[Array, " events"]
    """Index of the stop that changes its contact; -1 where there is no event."""
    first_phase: Int[Array, ""]
    """Set of touching stops at the section."""
    section: Float[Array, ""]
    """Drive phase (rad) at which the state is taken."""

    @property
    def number(self) -> Int[Array, ""]:
        """How many events there are."""
        return jnp.sum(self.stop >= 0, dtype=jnp.int32)


class Orbit(NamedTuple):
    """A motion: its state at the section and the drive phases (rad) of its events."""

    state: Float[Array, " states"]
    times: Float[Array, " events"]


class Tables(NamedTuple):
    """What one lane needs at one drive frequency."""

    phases: ContactPhases
    steady: Complex[Array, "phases states"]
    driven: Complex[Array, "phases states"] | None
    """Input of blocks in resonance, which have no steady response; None where there are none."""
    rows: Complex[Array, "phases rows"]
    """What the read-out rows see of the steady response."""
    angular_frequency: Float[Array, ""]


def tables_of(
    phases: ContactPhases,
    drive: AbstractDrive,
    angular_frequency: Float[Array, ""],
    *,
    resonant: bool = True,
) -> Tables:
    """Tabulate the steady response of every phase; `resonant` unless no block can be."""
    zero = jnp.zeros_like(angular_frequency)
    amplitude = drive.complex_amplitude(angular_frequency, zero)
    steady = forced_blocks(phases, amplitude, angular_frequency)
    driven = resonant_blocks(phases, amplitude, angular_frequency) if resonant else None
    rows = steady_readout(phases, steady, driven, angular_frequency)
    return Tables(phases, steady, driven, rows, angular_frequency)


def forced(tables: Tables, phase: Phase, angle: Angle) -> Float[Array, " states"]:
    """Block coordinates of rest and the steady response at a drive phase."""
    steady = tables.steady[phase]
    wave = jnp.sin(angle) * steady.real + jnp.cos(angle) * steady.imag
    return wave + tables.phases.rest[phase]


def moved_on(
    tables: Tables, phase: Phase, blocks: Float[Array, " states"], begun: Angle, angle: Angle
) -> Float[Array, " states"]:
    """Advance block coordinates of a motion over a drive angle from the phase `begun`."""
    phases, w = tables.phases, tables.angular_frequency
    driven = None if tables.driven is None else tables.driven[phase]
    decay, rate = phases.exponent[phase], phases.rate[phase]
    return driven_blocks(decay, rate, blocks, driven, begun, w, angle / w)


def _lateness(
    tables: Tables,
    phase: Phase,
    stop: Int[Array, ""],
    moved: Float[Array, " states"],
    angle: Angle,
) -> Float[Array, ""]:
    """First-order time (rad) by which the stop's change of contact comes later than the angle."""
    phases, stops = tables.phases, tables.phases.num_stops
    sine, cosine_ = jnp.sin(angle), jnp.cos(angle)

    def read(row: Int[Array, ""]) -> Float[Array, ""]:
        steady = tables.rows[phase, row]
        forced = sine * steady.real + cosine_ * steady.imag
        return phases.readout[phase, row] @ moved + phases.readout_rest[phase, row] + forced

    value, slope = read(stop), read(stops + stop)
    if not all(phases.can_pull):
        leaves_by_depth = jnp.asarray(phases.can_pull)[stop] | ((phase >> stop) & 1 == 0)
        value, slope = stop_push(
            phases.stiffness[stop],
            phases.damping[stop],
            leaves_by_depth,
            tables.angular_frequency,
            value,
            slope,
            read(2 * stops + stop),
        )
    slope = lax.stop_gradient(slope / tables.angular_frequency)
    return -value / jnp.where(slope == 0, 1.0, slope)


class PiecewiseMotion(NamedTuple):
    """A motion followed through its events; one column per phase passed."""

    end: Float[Array, " states"]
    times: Float[Array, " events"]
    """Event times, corrected once."""
    phase: Int[Array, " segments"]
    blocks: Float[Array, "states segments"]
    """Block coordinates where the segment begins."""
    start: Float[Array, " segments"]
    stop: Float[Array, " segments"]
    jacobian: Float[Array, "states states"] | None
    """Of the end in the state at the section, the change of the event times included."""


def follow_events(
    tables: Tables,
    events: Events,
    orbit: Orbit,
    period: int,
    *,
    with_jacobian: bool = False,
) -> PiecewiseMotion:
    """Follow a motion from the section through its events, over `period` drive periods.

    Every event is moved to where its stop changes contact, to first order: at a motion whose times
    are right nothing moves, and the first derivative includes the change of the times (saltation);
    `motion_from` has the second. Only forward mode goes through the loop.
    """
    phases = tables.phases
    room = orbit.times.size
    last = events.section + 2 * np.pi * period
    size = room + 1
    zero = jnp.zeros(size) + last
    start = (
        orbit.state,
        events.first_phase,
        events.section,
        orbit.times,
        jnp.zeros(size, jnp.int32) + events.first_phase,
        jnp.zeros((orbit.state.size, size)),
        zero,
        zero,
        jnp.eye(orbit.state.size) if with_jacobian else None,
    )

    def segment(j: Int[Array, ""], carry: tuple[Any, ...]) -> tuple[Any, ...]:
        state, phase, begun, times, phases_passed, blocks_passed, starts, ends, push = carry
        final = j >= room
        k = jnp.minimum(j, room - 1)
        stop = jnp.where(final, -1, events.stop[k])
        used, s = stop >= 0, jnp.maximum(stop, 0)
        angle = jnp.where(used, times[k], last)
        blocks = phases.from_state[phase] @ state - forced(tables, phase, begun)
        if phases.num_stops:
            moved = moved_on(tables, phase, blocks, begun, angle - begun)
            # Far from the motion a full correction could throw an event out of its order.
            following = jnp.where(k + 1 < room, times[jnp.minimum(k + 1, room - 1)], last)
            room_left = jnp.minimum(jnp.minimum(angle - begun, following - angle), 1.0)
            limit = 0.4 * lax.stop_gradient(jnp.maximum(room_left, 0.0))
            late = _lateness(tables, phase, s, moved, angle)
            angle = angle + jnp.where(used, jnp.clip(late, -limit, limit), 0.0)
        moved = moved_on(tables, phase, blocks, begun, angle - begun)
        state = phases.to_state[phase] @ (moved + forced(tables, phase, angle))
        return (
            state,
            jnp.where(used, phase ^ (1 << s), phase),
            angle,
            times.at[k].set(jnp.where(final, times[k], angle)),
            phases_passed.at[j].set(phase),
            blocks_passed.at[:, j].set(blocks),
            starts.at[j].set(begun),
            ends.at[j].set(angle),
            None if push is None else _push(tables, phase, s, used, push, angle - begun),
        )

    steps = jnp.minimum(events.number, room) + 1
    start = varied(start, tables.angular_frequency, orbit.state)
    end, phase, _, times, passed, blocks, starts, ends, push = lax.fori_loop(
        0, steps, segment, start
    )
    passed = jnp.where(jnp.arange(size) < steps, passed, phase)
    return PiecewiseMotion(end, times, passed, blocks, starts, ends, push)


def _push(
    tables: Tables,
    phase: Phase,
    stop: Int[Array, ""],
    used: Bool[Array, ""],
    matrix: Float[Array, "states states"],
    angle: Angle,
) -> Float[Array, "states states"]:
    """Carry the Jacobian through a phase and the change of contact at its end."""
    phases = tables.phases
    time = angle / tables.angular_frequency
    decay, rate = phases.exponent[phase][..., None], phases.rate[phase][:, None]
    moved = free_blocks(decay, rate, phases.from_state[phase] @ matrix, time)
    matrix = phases.to_state[phase] @ moved
    if not phases.num_stops:
        return matrix
    # Saltation: where the force jumps (by damping times rate, at zero depth) the velocities of
    # neighbouring motions jump in proportion to their depth.
    entering = (phase >> stop) & 1 == 0
    releases = jnp.asarray(phases.can_pull)[stop]
    sign = jnp.where(entering, -1.0, jnp.where(releases, 1.0, 0.0))
    jump = jnp.where(used, sign * phases.damping[stop], 0.0)
    depth = phases.towards_stop[stop] @ matrix
    return matrix + jump * phases.push_off[:, stop, None] * depth[None]


class Solved(NamedTuple):
    """A periodic motion found by Newton's method."""

    orbit: Orbit
    residual: Float[Array, ""]
    """Largest of the return of the state and the last moves of the events, relative."""
    jacobian: Float[Array, "states states"]
    """Of the period map, in units of energy: the monodromy matrix."""
    motion: PiecewiseMotion


def solve_orbit(tables: Tables, events: Events, orbit: Orbit, period: int) -> Solved:
    """Newton's method on the state at the section, the event times following."""
    n, weight = orbit.state.size, tables.phases.weight
    guess = weight * orbit.state
    energy = jnp.sqrt(jnp.sum(guess**2))
    size = jnp.where(energy > 0, energy, 1.0)

    def newton(carry: tuple[Any, ...], last: Bool[Array, ""]) -> tuple[tuple[Any, ...], None]:
        x, times, _ = carry
        orbit = Orbit(x * (size / weight), times)
        motion = follow_events(tables, events, orbit, period, with_jacobian=True)
        assert motion.jacobian is not None
        matrix = weight[:, None] * motion.jacobian / weight
        back = motion.end * (weight / size) - x
        used = events.stop >= 0
        error = jnp.maximum(
            jnp.max(jnp.abs(back)),
            jnp.max(jnp.where(used, jnp.abs(motion.times - times), 0.0), initial=0.0),
        )
        change = jnp.linalg.solve(jnp.eye(n) - matrix, back)
        length = jnp.max(jnp.abs(change))
        change = change * jnp.minimum(1.0, 0.5 / jnp.where(length > 0, length, 1.0))
        return (
            jnp.where(last, x, x + change),
            jnp.where(last, times, motion.times),
            (error, matrix, motion._replace(jacobian=None)),
        ), None

    room = orbit.times.size + 1
    nothing = PiecewiseMotion(
        end=orbit.state,
        times=orbit.times,
        phase=jnp.zeros(room, jnp.int32),
        blocks=jnp.zeros((n, room)),
        start=jnp.zeros(room),
        stop=jnp.zeros(room),
        jacobian=None,
    )
    carry = guess / size, orbit.times, (jnp.asarray(jnp.inf), jnp.zeros((n, n)), nothing)
    rounds = jnp.arange(ITERATIONS + 1) == ITERATIONS
    (x, times, (error, matrix, motion)), _ = lax.scan(newton, carry, rounds)
    return Solved(Orbit(x * size / weight, times), error, matrix, motion)


def motion_from(
    tables: Tables,
    events: Events,
    orbit: Orbit,
    jacobian: Float[Array, "states states"],
    solved: Bool[Array, ""],
    period: int,
) -> PiecewiseMotion:
    """Return the motion of an orbit, with the first and second derivatives of the solution.

    These are by the `tables`: steps of Newton's method from the solution, all else held, have its
    value and its implicit derivatives. Where it is not `solved` it stays where it is.
    """
    still = jnp.eye(orbit.state.size) - jacobian

    def newton(orbit: Orbit, _: None) -> tuple[Orbit, PiecewiseMotion]:
        motion = follow_events(tables, events, orbit, period)
        gap = jnp.where(solved, motion.end - orbit.state, 0.0)
        return Orbit(orbit.state + jnp.linalg.solve(still, gap), motion.times), motion

    # The last motion is that of the last step's orbit.
    _, motions = lax.scan(newton, orbit, length=TO_SECOND + 1)
    return jax.tree.map(lambda a: a[-1], motions)
