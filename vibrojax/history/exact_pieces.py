"""The motion between the samples of a history, exactly, where the stops are linear in contact.

From every sample the motion is followed with the propagators of its phase (`ContactPhases`) to the
first event of any stop, located by Newton's method on the propagator itself; there the phase
changes, and so on to the next sample. What comes out are pieces on which everything is smooth.
Pieces are worked through in batches of one phase and one length, so that compiled code is reused.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int, Shaped

from vibrojax.model.equations import LinearEquations
from vibrojax.model.systems import Motion
from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.stepping.cubic import Cubic, cubic_between
from vibrojax.stepping.phase_motion import (
    OfStops,
    PerLane,
    Phase,
    PhaseMotion,
    begin_phase,
    breach_of,
    contact_indicator,
    follow,
    pushes_of,
    read_stops,
)

Number = Float[Array, ""]

MOST_ROUNDS = 64
"""Events within one sample interval before it is given up."""
MOST_PLACES = 256
"""Places at which an interval is looked at."""
NEAR = 1e-12
"""Depth, by the largest displacement, below which the direction says whether a stop is touched."""


class Drives(NamedTuple):
    """What drives every interval: of a chirp the frequency and amplitude of its middle."""

    angle: Float[np.ndarray, " intervals"]
    """Drive phase where the interval begins, rad."""
    rate: Float[np.ndarray, " intervals"]
    amplitude: Complex[np.ndarray, " intervals"]


class Pieces(NamedTuple):
    """Stretches of a motion in one phase each, in order of time."""

    interval: Int[np.ndarray, " pieces"]
    start: Float[np.ndarray, " pieces"]
    """s after the sample before it."""
    end: Float[np.ndarray, " pieces"]
    phase: Int[np.ndarray, " pieces"]
    state: Float[np.ndarray, "pieces states"]
    """(q, q') where the piece begins."""


def drives_of(motion: Motion, time: Float[np.ndarray, " samples"]) -> Drives:
    """Tabulate the drive of every interval."""
    angle, rate, amplitude = _drives(motion, jnp.asarray(time[:-1]), jnp.asarray(np.diff(time)))
    angle = np.asarray(angle)
    turns = np.round(angle / (2 * np.pi))
    return Drives(angle - 2 * np.pi * turns, np.asarray(rate), np.asarray(amplitude))


@eqx.filter_jit
def _drives(
    motion: Motion, start: Float[Array, " intervals"], duration: Float[Array, " intervals"]
) -> tuple[Float[Array, " intervals"], Float[Array, " intervals"], Complex[Array, " intervals"]]:
    angle, _, _ = motion.waveform.phase(start)
    _, rate, second = motion.waveform.phase(start + duration / 2)
    return angle, rate, motion.drive.complex_amplitude(rate, second)


@eqx.filter_jit
def _starting_phase(
    phases: ContactPhases,
    equations: LinearEquations,
    states: Float[Array, "states samples"],
    drive_input: Float[Array, " samples"],
    unit_rate: Number,
    near: Number,
) -> Int[Array, " samples"]:
    """Phase of every sample: near zero depth the direction decides."""
    n = phases.num_blocks
    q, v = states[:n], states[n:]
    depth = phases.towards_stop @ q - phases.gap[:, None]
    rate = phases.towards_stop @ v

    def indicator(acceleration: OfStops) -> tuple[OfStops, OfStops]:
        return contact_indicator(
            depth, rate, *pushes_of(phases, unit_rate, depth, rate, acceleration)
        )

    value, _ = indicator(jnp.zeros_like(depth))
    force = phases.stiffness[:, None] * depth + phases.damping[:, None] * rate
    free = jax.vmap(equations.linear_force, in_axes=1, out_axes=1)(q, v)
    acceleration = equations.input_map[:, None] * drive_input - free / equations.modal_mass[:, None]
    acceleration = acceleration - phases.push_off @ jnp.where(value > 0, force, 0.0)
    value, slope = indicator(phases.towards_stop @ acceleration)
    touching = jnp.where(jnp.abs(value) <= near, slope > 0, value > 0)
    bits = (1 << np.arange(phases.num_stops))[:, None]
    return jnp.sum(jnp.where(touching, bits, 0), axis=0)


class _Cut(NamedTuple):
    time: PerLane
    """Where the piece ends, s after its start."""
    stop: Int[Array, " lanes"]
    """Which stop changes its contact there; -1 for none."""
    state: Float[Array, "states lanes"]


@eqx.filter_jit
def _first_event(
    phases: ContactPhases,
    phase: Phase,
    lanes: tuple[Array, ...],
    length: PerLane,
    last: Int[Array, " lanes"],
    unit_rate: Number,
    near: Number,
    *,
    places: int,
) -> _Cut:
    """Find the first event of lanes in one phase within a time `length`."""
    motion = begin_phase(phases, phase, *lanes)
    if not phases.num_stops:
        return _cut(phases, phase, motion, length, jnp.full(length.shape, -1))
    cell = length / places
    time = cell[:, None] * jnp.arange(places + 1)

    def breach(time: Float[Array, "lanes *places"]) -> tuple[OfStops, OfStops]:
        return breach_of(
            phases, phase, unit_rate, read_stops(phases, phase, follow(phases, phase, motion, time))
        )

    value, slope = breach(time)
    slope = slope * cell[:, None]
    begun, rising = value[..., 0], slope[..., 0] > near
    other = jnp.arange(phases.num_stops)[:, None] != last
    at_once = other & ((begun > near) | ((jnp.abs(begun) <= near) & rising))
    value = value.at[..., 0].set(jnp.minimum(begun, 0.0))
    f0, f1, d0, d1 = value[..., :-1], value[..., 1:], slope[..., :-1], slope[..., 1:]
    crossed = f1 > 0
    cubic = cubic_between(f0, d0, f1, d1)
    top, height = cubic.peak()
    found = crossed | (height > near)
    first = jnp.argmax(jnp.any(found, axis=0), axis=-1)

    def there(a: Shaped[Array, "stops lanes places"]) -> Shaped[Array, "stops lanes"]:
        return jnp.take_along_axis(a, first[None, :, None], axis=-1)[..., 0]

    crossed, top, found = map(there, (crossed, top, found))
    cubic = Cubic(*map(there, cubic))
    # From a start on the crossing itself the motion first goes away from it.
    dip, _ = Cubic(*(-c for c in cubic)).peak()
    high = jnp.where(crossed, 1.0, top)
    low = jnp.where((cubic.slope < 0) & (dip > 0) & (dip < high), dip, 0.0)
    guess = cubic.root(low, high)
    stop = jnp.argmin(jnp.where(found, guess, jnp.inf), axis=0)

    def of_stop(a: Shaped[Array, "stops lanes"]) -> Shaped[Array, " lanes"]:
        return jnp.take_along_axis(a, stop[None], axis=0)[0]

    hidden = ~of_stop(crossed)
    low, high, u, found = map(of_stop, (low, high, guess, found))

    def exact(u: PerLane) -> tuple[PerLane, PerLane]:
        value, slope = breach((first + u) * cell)
        return of_stop(value), of_stop(slope) * cell

    # A touch that only the cubic makes between two places: the piece is cut, nothing changes.
    missed = hidden & (exact(high)[0] <= 0)

    def closer(_: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
        u, low, high = carry
        value, slope = exact(u)
        low, high = jnp.where(value > 0, low, u), jnp.where(value > 0, u, high)
        newton = u - value / jnp.where(slope == 0, 1.0, slope)
        return jnp.where((newton >= low) & (newton <= high), newton, (low + high) / 2), low, high

    top = high
    u, _, _ = jax.lax.fori_loop(0, 9, closer, (u, low, high))
    end = jnp.where(found, (first + jnp.where(missed, top, u)) * cell, length)
    flips = jnp.where(found & ~missed, stop, -1)
    now = jnp.any(at_once, axis=0)
    end = jnp.where(now, 0.0, jnp.minimum(end, length))
    return _cut(phases, phase, motion, end, jnp.where(now, jnp.argmax(at_once, axis=0), flips))


def _cut(
    phases: ContactPhases,
    phase: Phase,
    motion: PhaseMotion,
    end: PerLane,
    stop: Int[Array, " lanes"],
) -> _Cut:
    blocks, _, _ = follow(phases, phase, motion, end)
    return _Cut(end, stop, phases.to_state[phase] @ blocks)


def places_for(phases: ContactPhases, interval: float) -> int:
    """How many places show all of the motion over an interval (s): 0.3 rad of the fastest rate.

    Raises `ValueError` when the history is sampled too coarsely for that.
    """
    fastest = float(np.max(np.asarray(phases.rate)))
    # A contact so damped that it does not oscillate asks for its decay to be resolved, to a limit.
    decay = min(float(np.max(np.abs(np.asarray(phases.exponent)))), 19.0 / interval)
    places = 2 ** int(np.ceil(np.log2(max(8.0, max(fastest, decay) * interval / 0.3))))
    if places > MOST_PLACES:
        raise ValueError(
            f"The samples lie {interval:.4g} s apart, {fastest * interval / (2 * np.pi):.3g} "
            "periods of the fastest motion of the model: sample finer (samples_per_period)."
        )
    return places


def batches(phase: Int[np.ndarray, " items"], size: int) -> Iterator[tuple[int, Any, Any]]:
    """Yield (phase, items, items filled up to `size`) so that each batch is of one phase."""
    for p in np.unique(phase):
        (all_items,) = np.nonzero(phase == p)
        for k in range(0, all_items.size, size):
            items = all_items[k : k + size]
            yield int(p), items, np.pad(items, (0, size - items.size), mode="edge")


def batch_size(places: int) -> int:
    """Pieces to work through at a time."""
    return max(64, 16384 // places)


def lanes_of(pieces: Pieces, drives: Drives, items: Int[np.ndarray, " lanes"]) -> tuple[Array, ...]:
    """Return state, angle, rate and amplitude of some pieces where they begin."""
    interval = pieces.interval[items]
    rate = drives.rate[interval]
    angle = drives.angle[interval] + rate * pieces.start[items]
    numbers = (pieces.state[items].T, angle, rate, drives.amplitude[interval])
    return tuple(jnp.asarray(a) for a in numbers)


def starting_phases(
    motion: Motion, time: Float[np.ndarray, " samples"], states: Float[np.ndarray, "samples states"]
) -> Int[np.ndarray, " samples"]:
    """Return the phase of every sample."""
    phases, equations = motion.prepared, motion.equations.linear_between_contacts
    assert equations is not None
    drive_input = motion.drive.input(motion.waveform, jnp.asarray(time))
    unit_rate, near = _scales(phases, equations, states)
    columns = jnp.asarray(states.T)
    return np.asarray(_starting_phase(phases, equations, columns, drive_input, unit_rate, near))


def _scales(
    phases: ContactPhases, equations: LinearEquations, states: Float[np.ndarray, "samples states"]
) -> tuple[Number, Number]:
    unit_rate = equations.angular_frequency[0]
    q = states[:, : phases.num_blocks]
    reach = np.max(np.abs(q) @ np.abs(np.asarray(phases.towards_stop)).T, initial=0.0)
    return unit_rate, jnp.asarray(NEAR * (reach + np.max(np.asarray(phases.gap), initial=0.0)))


def exact_pieces(
    motion: Motion, time: Float[np.ndarray, " samples"], states: Float[np.ndarray, "samples states"]
) -> tuple[Pieces, Drives]:
    """Cut the motion between all samples into pieces of one phase.

    Raises `ValueError` when an interval holds more than `MOST_ROUNDS` events.
    """
    phases, equations = motion.prepared, motion.equations.linear_between_contacts
    duration, drives = np.diff(time), drives_of(motion, time)
    places = places_for(phases, float(np.max(duration)))
    assert equations is not None
    unit_rate, near = _scales(phases, equations, states)
    begun = np.zeros(duration.size)
    phase = starting_phases(motion, time, states)[:-1]
    work = Pieces(np.arange(duration.size), begun, begun, phase, states[:-1])
    last = np.full(duration.size, -1)
    done: list[Pieces] = []
    for _ in range(MOST_ROUNDS):
        left = duration[work.interval] - work.start
        end, stop, after = np.zeros(left.size), np.zeros(left.size, int), np.zeros(work.state.shape)
        for p, items, filled in batches(work.phase, batch_size(places)):
            cut = _first_event(
                phases,
                jnp.asarray(p),
                lanes_of(work, drives, filled),
                jnp.asarray(left[filled]),
                jnp.asarray(last[filled]),
                unit_rate,
                near,
                places=places,
            )
            end[items], stop[items], after[items] = (
                np.asarray(a).T[: items.size] for a in (cut.time, cut.stop, cut.state)
            )
        done.append(work._replace(end=work.start + end))
        (on,) = np.nonzero((stop >= 0) | (end < left * (1 - 1e-12)))
        if not on.size:
            break
        flipped = work.phase[on] ^ np.where(stop[on] >= 0, 1 << np.maximum(stop[on], 0), 0)
        start, last = work.start[on] + end[on], stop[on]
        work = Pieces(work.interval[on], start, start, flipped, after[on])
    else:
        raise ValueError(
            f"More than {MOST_ROUNDS} touches and departures within {np.max(duration):.4g} s, at "
            f"t = {time[work.interval[0]]:.6g} s: sample finer (samples_per_period)."
        )
    whole = Pieces(*(np.concatenate(column) for column in zip(*done, strict=True)))
    order = np.argsort(whole.interval, kind="stable")
    return Pieces(*(column[order] for column in whole)), drives
