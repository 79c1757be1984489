"""What is read off an exact periodic motion: amplitudes, forces, contact, and its validity."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from vibrojax._tools.trigonometry import cosine_and_sine
from vibrojax.steady.contact_times import Events, PiecewiseMotion, Tables, forced, moved_on
from vibrojax.steady.exact_means import mean_square_and_harmonic
from vibrojax.stepping.cubic import Cubic, cubic_between, cubic_maximum
from vibrojax.stepping.phase_motion import driven_blocks, stop_push

lax = jax.lax

Rows = Float[Array, "rows places"]
Segments = Int[Array, " places"]

GRID = 128
"""Places per drive period at which a motion is looked at before its extremes are refined."""
IN_CONTACT = 64
"""Further places in the time of contact."""
FINE = 33
"""Places around an extreme."""
BREACH = 1e-8
"""Largest breach of the sequence of events, over the size of the motion."""


class Reading(NamedTuple):
    """What is read off a motion."""

    highest: Float[Array, ""]
    """Largest reported displacement, m."""
    lowest: Float[Array, ""]
    mean_square: Float[Array, ""]
    first_harmonic: Float[Array, ""]
    contact_force: Float[Array, ""]
    contact_fraction: Float[Array, ""]
    contacts: Int[Array, ""]
    breach: Float[Array, ""]
    """How far the motion breaks its sequence of events, m; about 0 or less where it keeps to it."""
    ordered: Bool[Array, ""]
    initial_state: Float[Array, " states"]
    """(q, q') at drive phase 0."""
    depth: Float[Array, "stops places"]
    """Depths at equal intervals from drive phase 0 over the period of the motion, m."""
    change: Float[Array, "stops places"]
    """Their change per interval."""


def look(
    tables: Tables, motion: PiecewiseMotion, segment: Segments, angle: Float[Array, " places"]
) -> Rows:
    """Rows (as of `ContactPhases.readout`) at some drive phases, each of a given segment."""
    phases, phase = tables.phases, motion.phase[segment]
    time = (angle - motion.start[segment]) / tables.angular_frequency
    moved = driven_blocks(
        jnp.moveaxis(phases.exponent, 0, -1)[:, :, phase],
        phases.rate.T[:, phase],
        motion.blocks[:, segment],
        None if tables.driven is None else tables.driven.T[:, phase],
        motion.start[segment],
        tables.angular_frequency,
        time,
    )
    cosine, sine = cosine_and_sine(angle)

    def rows_of(p: int) -> Rows:
        value = phases.readout[p] @ moved + phases.readout_rest[p][:, None]
        wave = tables.rows[p]
        return value + wave.real[:, None] * sine + wave.imag[:, None] * cosine

    rows = rows_of(0)
    for p in range(1, 2**phases.num_stops):
        rows = jnp.where(phase == p, rows_of(p), rows)
    return rows


def segment_of(
    motion: PiecewiseMotion, angle: Float[ArrayLike, "*places"]
) -> Int[Array, "*places"]:
    """Index of the segment of a motion in which a drive phase (rad) after its section lies."""
    found = jnp.searchsorted(motion.stop, angle, side="left")
    return jnp.minimum(found, motion.stop.size - 1)


def read_motion(tables: Tables, events: Events, motion: PiecewiseMotion, period: int) -> Reading:
    """Read amplitudes, forces and contact off a motion, and check that it keeps to its events."""
    phases, stops = tables.phases, tables.phases.num_stops
    begin, whole = events.section, 2 * np.pi * period
    length = jnp.maximum(motion.stop - motion.start, 0.0)
    held = ((motion.phase[:, None] >> np.arange(stops)) & 1) == 1
    in_contact = jnp.any(held, axis=1)

    # Everywhere, starting from drive phase 0; then more closely in contact.
    grid = GRID * period
    angle = whole * jnp.arange(grid) / grid
    angle = jnp.where(angle < begin, angle + whole, angle)
    touched = jnp.cumsum(jnp.where(in_contact, length, 0.0))
    share = (np.arange(IN_CONTACT) + 0.5) / IN_CONTACT * touched[-1]
    place = jnp.minimum(jnp.searchsorted(touched, share), touched.size - 1)
    inside = motion.stop[place] - (touched[place] - share)
    angles = jnp.concatenate([angle, inside])
    segment = jnp.concatenate([segment_of(motion, angle), place])
    rows = look(tables, motion, segment, angles)
    response = rows[3 * stops, :grid]

    # The extremes again, finely.
    width = whole / grid
    force = _force(tables, rows, held[segment].T)
    total = jnp.max(force, axis=0, initial=0.0)
    centres = [angle[jnp.argmax(response)], angle[jnp.argmin(response)], angles[jnp.argmax(total)]]
    free = jnp.where(held[segment].T, -jnp.inf, rows[:stops])
    centres += [angles[jnp.argmax(free[s])] for s in range(stops)]
    offsets = jnp.linspace(-width, width, FINE)
    near = jnp.stack(centres)[:, None] + offsets
    near = begin + jnp.mod(near - begin, whole)
    # With them the moments of touch, where the force of a stop with damping is largest.
    places = motion.start.size
    fine_segment = jnp.concatenate([segment_of(motion, near.reshape(-1)), jnp.arange(places)])
    fine = look(tables, motion, fine_segment, jnp.concatenate([near.reshape(-1), motion.start]))
    fine, at_start = fine[:, :-places], fine[:, -places:]
    fine_segment = fine_segment[:-places]
    held_there = held[fine_segment].T
    fine_force = _force(tables, fine, held_there)
    step = 2 * width / (FINE - 1) / tables.angular_frequency

    def top(
        values: Float[Array, " all_places"],
        slopes: Float[Array, " all_places"],
        row: int,
        mask: Bool[Array, " all_places"] | None = None,
    ) -> Float[Array, ""]:
        y, v = (a.reshape(len(centres), FINE)[row] for a in (values, slopes))
        best = cubic_maximum(y[:-1], v[:-1] * step, y[1:], v[1:] * step)
        if mask is not None:
            whole_cell = mask.reshape(len(centres), FINE)[row]
            best = jnp.where(whole_cell[:-1] & whole_cell[1:], best, 0.0)
        return jnp.max(best)

    value, rate = fine[3 * stops], fine[3 * stops + 1]
    highest, lowest = top(value, rate, 0), -top(-value, -rate, 1)
    peak = jnp.zeros(())
    breach = -jnp.inf * jnp.ones(())
    for s in range(stops):
        k, c = phases.stiffness[s], phases.damping[s]
        slope = k * fine[stops + s] + c * fine[2 * stops + s]
        touching = held_there[s]
        cell = top(fine_force[s], jnp.where(touching, slope, 0.0), 2, touching)
        peak = jnp.maximum(jnp.maximum(peak, jnp.max(force[s])), cell)
        breach = jnp.maximum(breach, jnp.max(_breach(tables, s, rows, held[segment].T[s])))
        breach = jnp.maximum(breach, jnp.max(_breach(tables, s, fine, held_there[s])))
    if stops:
        long_enough = held & (length > 0)[:, None]
        peak = jnp.maximum(peak, jnp.max(_force(tables, at_start, long_enough.T)))
    if tables.driven is None:
        mean_square, harmonic = mean_square_and_harmonic(tables, motion, period)
    else:
        mean_square = jnp.mean(response**2)
        harmonic = 2 * jnp.hypot(*(jnp.mean(response * f(angle)) for f in (jnp.sin, jnp.cos)))
    entered = (events.stop >= 0) & (motion.phase[1:] > motion.phase[:-1])
    origin = jnp.where(begin > 0, whole, 0.0)
    at = segment_of(motion, origin)
    return Reading(
        highest=highest,
        lowest=lowest,
        mean_square=mean_square,
        first_harmonic=harmonic,
        contact_force=peak,
        contact_fraction=touched[-1] / whole,
        contacts=jnp.sum(entered, dtype=jnp.int32),
        breach=breach,
        ordered=jnp.all(motion.stop - motion.start >= 0),
        initial_state=state_in(tables, motion, at, origin),
        depth=rows[:stops, :grid],
        change=rows[stops : 2 * stops, :grid] * (width / tables.angular_frequency),
    )


def keeps_to_events(tables: Tables, reading: Reading) -> Bool[Array, ""]:
    """Whether a motion keeps to its sequence of events."""
    size = jnp.maximum(
        jnp.max(jnp.abs(tables.phases.gap), initial=0.0),
        jnp.maximum(reading.highest, -reading.lowest),
    )
    return reading.ordered & ~(reading.breach > BREACH * size)


def _force(
    tables: Tables, rows: Rows, held: Bool[Array, "stops places"]
) -> Float[Array, "stops places"]:
    phases, stops = tables.phases, tables.phases.num_stops
    value = phases.stiffness[:, None] * rows[:stops]
    value = value + phases.damping[:, None] * rows[stops : 2 * stops]
    return jnp.where(held, value, 0.0)


def state_in(
    tables: Tables,
    motion: PiecewiseMotion,
    segment: Int[ArrayLike, ""],
    angle: Float[ArrayLike, ""],
) -> Float[Array, " states"]:
    """State of a motion at a drive phase (rad) of a given segment."""
    phase, begun = motion.phase[segment], motion.start[segment]
    moved = moved_on(tables, phase, motion.blocks[:, segment], begun, angle - begun)
    return tables.phases.to_state[phase] @ (moved + forced(tables, phase, angle))


def _breach(
    tables: Tables, stop: int, rows: Rows, touching: Bool[Array, " places"]
) -> Float[Array, " places"]:
    """How far a place breaks its phase, m: positive where it should be in the other one."""
    phases, stops = tables.phases, tables.phases.num_stops
    depth = rows[stop]
    push, _ = stop_push(
        phases.stiffness[stop],
        phases.damping[stop],
        np.asarray(phases.can_pull[stop]),
        tables.angular_frequency,
        depth,
        rows[stops + stop],
        rows[2 * stops + stop],
    )
    inside = jnp.minimum(depth, push)
    return jnp.where(touching, -inside, inside)


def state_at(
    tables: Tables,
    motion: PiecewiseMotion,
    section: Float[Array, ""],
    begin: Float[Array, ""],
    period: int,
) -> Float[Array, " states"]:
    """State of a motion at a drive phase (rad)."""
    angle = begin + jnp.mod(section - begin, 2 * np.pi * period)
    return state_in(tables, motion, segment_of(motion, angle), angle)


class Crossings(NamedTuple):
    """A first guess of a motion, read off sampled depths."""

    events: Events
    times: Float[Array, " events"]
    number: Int[Array, ""]
    """Events found; more than there is room for when above the length of `times`."""


def find_crossings(
    depth: Float[Array, "stops samples"],
    change: Float[Array, "stops samples"],
    room: int,
    period: int,
) -> Crossings:
    """Find where sampled depths (and their change per sample) cross zero, in order of time.

    Between samples the depth is the cubic through both ends, so a touch shorter than a sample is
    seen too. The section is put in the middle of the longest phase.
    """
    stops, samples = depth.shape
    f0, g0 = depth, change
    f1, g1 = jnp.roll(depth, -1, axis=1), jnp.roll(change, -1, axis=1)
    crossed = (f0 > 0) != (f1 > 0)
    # A cubic with both ends on one side that reaches over to the other one crosses twice.
    sign = jnp.where(f0 > 0, -1.0, 1.0)
    cubic = cubic_between(sign * f0, sign * g0, sign * f1, sign * g1)
    turning, height = cubic.peak()
    hidden = ~crossed & (height > 0)
    first = (crossed | hidden).T
    both = jnp.stack([first, hidden.T], axis=-1).reshape(-1)  # samples, stops, first or second
    count = jnp.sum(both, dtype=jnp.int32)
    (index,) = jnp.nonzero(both, size=room, fill_value=both.size)
    used = index < both.size
    second = index % 2 == 1
    stop = (index // 2) % stops
    time = jnp.minimum(index // (2 * stops), samples - 1)
    is_hidden = hidden[stop, time]
    low = jnp.where(second, turning[stop, time], 0.0)
    high = jnp.where(is_hidden & ~second, turning[stop, time], 1.0)
    u = Cubic(*(c[stop, time] for c in cubic)).root(low, high)
    whole = 2 * np.pi * period
    angle = jnp.where(used, (time + u) * (whole / samples), jnp.inf)
    order = jnp.argsort(angle)
    angle, stop = angle[order], jnp.where(used[order], stop[order], -1)
    after = jnp.append(angle[1:], jnp.inf)
    after = jnp.where(jnp.isfinite(after), after, angle[0] + whole)
    length = jnp.where(stop >= 0, after - angle, -1.0)
    longest = jnp.argmax(length)
    section = jnp.where(count > 0, angle[longest] + length[longest] / 2, 0.0)
    section = jnp.where(section >= whole, section - whole, section)
    later = jnp.where(stop >= 0, jnp.where(angle < section, angle + whole, angle), section + whole)
    again = jnp.argsort(later)
    place = jnp.round(section / (whole / samples)).astype(jnp.int32) % samples
    bits = jnp.asarray([1 << s for s in range(stops)], jnp.int32)
    touching = jnp.sum(jnp.where(depth[:, place] > 0, bits, 0), dtype=jnp.int32)
    events = Events(stop[again].astype(jnp.int32), touching, section)
    return Crossings(events, later[again], count)
