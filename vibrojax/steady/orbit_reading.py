"""What is read off an exact periodic motion: amplitudes, forces, contact, and its validity."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from vibrojax._tools.trigonometry import cosine_and_sine
from vibrojax.steady.contact_times import Events, PiecewiseMotion, Tables, forced, moved_on
from vibrojax.steady.exact_means import mean_square_and_harmonic
from vibrojax.stepping.cubic import Cubic, cubic_between, cubic_maximum, largest
from vibrojax.stepping.phase_motion import driven_blocks, stop_push

lax = jax.lax

Rows = Float[Array, "rows places"]
Segments = Int[Array, " places"]

GRID = 128
"""Places per drive period at which a motion is looked at before its extremes are refined."""
IN_CONTACT = 64
"""Further places in the time of contact."""
SHARES = np.linspace(0.0, 1.0, 17)
"""Places between two neighbours of those, next to an extreme."""
PEAKS = 3
"""How many of the highest peaks of the force, as seen from these places, are looked at closely."""
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
    stops = tables.phases.num_stops
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
    ends = jnp.arange(motion.start.size)
    angles = jnp.concatenate([angle, inside, motion.start, motion.stop])
    segment = jnp.concatenate([segment_of(motion, angle), place, ends, ends])
    seen = look(tables, motion, segment, angles)
    rows, angles, held_there = (
        a[..., : grid + IN_CONTACT] for a in (seen, angles, held[segment].T)
    )
    response = rows[3 * stops, :grid]

    # The extremes again, finely.
    width = whole / grid
    rate = rows[3 * stops + 1, :grid] * (width / tables.angular_frequency)
    cells = (response, rate, jnp.roll(response, -1), jnp.roll(rate, -1))
    chosen = [jnp.argmax(cubic_maximum(*(sign * c for c in cells))) for sign in (1.0, -1.0)]
    near = angle[jnp.stack(chosen)][:, None] + width * SHARES
    free = jnp.where(held_there, -jnp.inf, rows[:stops])
    centres = [angles[jnp.argmax(free[s])] for s in range(stops)]
    around = [centre + width * s for centre in centres for s in (SHARES - 1, SHARES)]
    near = jnp.concatenate([near.reshape(-1), *around])
    near = begin + jnp.mod(near - begin, whole)
    highest_force = _ForceCells.of(tables, motion, held, place, inside, seen[:, grid:])
    fine_segment = jnp.concatenate([segment_of(motion, near), highest_force.segments])
    fine = look(tables, motion, fine_segment, jnp.concatenate([near, highest_force.angles]))
    peak = highest_force.peak(tables, fine[:, near.size :])
    fine, fine_held = fine[:, : near.size], held[fine_segment[: near.size]].T
    step = width / (SHARES.size - 1) / tables.angular_frequency

    def top(row: int, sign: float) -> Float[Array, ""]:
        own = slice(row * SHARES.size, (row + 1) * SHARES.size)
        y, v = sign * fine[3 * stops, own], sign * fine[3 * stops + 1, own] * step
        return sign * largest(cubic_maximum(y[:-1], v[:-1], y[1:], v[1:]))

    highest, lowest = top(0, 1.0), top(1, -1.0)
    breach = -jnp.inf * jnp.ones(())
    for s in range(stops):
        breach = jnp.maximum(breach, jnp.max(_breach(tables, s, rows, held_there[s])))
        breach = jnp.maximum(breach, jnp.max(_breach(tables, s, fine, fine_held[s])))
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


class _ForceCells(NamedTuple):
    """Ways in contact, from a place to the next, in which the force may be largest."""

    angles: Float[Array, " places"]
    """Places in these ways, those of one after those of the other."""
    segments: Segments
    held: Bool[Array, "stops cells"]
    length: Float[Array, " cells"]

    @classmethod
    def of(
        cls,
        tables: Tables,
        motion: PiecewiseMotion,
        held: Bool[Array, "segments stops"],
        place: Segments,
        inside: Float[Array, " places"],
        rows: Float[Array, "rows all_places"],
    ) -> "_ForceCells":
        """Choose those with the highest peaks of a cubic.

        `rows` are of the places inside segments, then of the beginnings and ends of all segments:
        where a stop has damping, the force may be largest at the moment of touch.
        """
        count, every = place.size, jnp.arange(motion.start.size)
        first, last = count + every, count + every.size + every
        before = jnp.where(jnp.diff(place, prepend=-1) > 0, first[place], np.arange(count) - 1)
        # From the last place of a segment to its end: all of it where it has no place.
        final = jnp.searchsorted(place, every, side="right") - 1
        final = jnp.where((final >= 0) & (place[final] == every), final, first)
        low, high = jnp.append(before, final), jnp.append(np.arange(count), last)
        own = jnp.append(place, every)
        angles = jnp.concatenate([inside, motion.start, motion.stop])
        length = angles[high] - angles[low]
        counts = held[own].T & (length > 0)
        force, rate = _push(tables, rows)
        rate = rate / tables.angular_frequency
        top = cubic_maximum(
            force[:, low], rate[:, low] * length, force[:, high], rate[:, high] * length
        )
        _, best = lax.top_k(jnp.max(jnp.where(counts, top, 0.0), axis=0, initial=0.0), PEAKS)
        near = angles[low[best]][:, None] + length[best][:, None] * SHARES
        return cls(
            near.reshape(-1), jnp.repeat(own[best], SHARES.size), counts[:, best], length[best]
        )

    def peak(self, tables: Tables, rows: Rows) -> Float[Array, ""]:
        """Return the largest force, N, from the rows at the places; 0 where none is positive."""
        if not self.held.size:
            return jnp.zeros(())
        step = self.length / (SHARES.size - 1) / tables.angular_frequency
        force, rate = (a.reshape(*self.held.shape, SHARES.size) for a in _push(tables, rows))
        rate = rate * step[:, None]
        top = cubic_maximum(force[..., :-1], rate[..., :-1], force[..., 1:], rate[..., 1:])
        return largest(jnp.where(self.held[..., None] & (top > 0), top, 0.0).reshape(-1))


def _push(
    tables: Tables, rows: Rows
) -> tuple[Float[Array, "stops places"], Float[Array, "stops places"]]:
    """Force of each stop as if it were touched, N, and its rate, N/s."""
    phases, stops = tables.phases, tables.phases.num_stops
    depth, rate, bend = (rows[k * stops : (k + 1) * stops] for k in range(3))
    k, c = phases.stiffness[:, None], phases.damping[:, None]
    return k * depth + c * rate, k * rate + c * bend


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
