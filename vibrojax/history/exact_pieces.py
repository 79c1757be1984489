"""The motion between the samples of a history, exactly, where the stops are linear in contact.

From every sample the motion is followed with the propagators of its phase (`ContactPhases`) to the
first event of any stop, located by Newton's method on the propagator itself; there the phase
changes, and so on to the next sample. What comes out are pieces on which everything is smooth.
Pieces are worked through in batches of one phase and one length, so that compiled code is reused.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int, Shaped

from vibrojax._tools.compiled import compiled
from vibrojax.model.drives import AbstractSignal
from vibrojax.model.first_order import first_order
from vibrojax.model.systems import Motion
from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.stepping.cubic import Cubic, cubic_between
from vibrojax.stepping.phase_motion import (
    OfStops,
    PerLane,
    Phase,
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


class Pieces(NamedTuple):
    """Stretches of a motion in one phase each, in order of time."""

    interval: Int[np.ndarray, " pieces"]
    start: Float[np.ndarray, " pieces"]
    """s after the sample before it."""
    end: Float[np.ndarray, " pieces"]
    phase: Int[np.ndarray, " pieces"]
    state: Float[np.ndarray, "states pieces"]
    """(q, q') where the piece begins."""
    angle: Float[np.ndarray, " pieces"]
    """Drive phase there, rad."""
    rate: Float[np.ndarray, " pieces"]
    """Of the drive phase, rad/s: of a chirp in the middle of the interval, as the amplitude."""
    amplitude: Complex[np.ndarray, " pieces"]
    level: Float[np.ndarray, " pieces"]
    """Input of a signal there, m/s2 or N, 0 of a drive with a phase."""
    slope: Float[np.ndarray, " pieces"]
    """Its rate, per s."""

    def at(self, index: Any) -> "Pieces":
        """Return some of them."""
        return Pieces(*(column[..., index] for column in self))


@compiled
def _begun(
    motion: Motion,
    states: Float[Array, "states intervals"],
    time: Float[Array, " intervals"],
    duration: Float[Array, " intervals"],
    near: Number,
) -> tuple[Array, ...]:
    """Phase of contact of every sample (near zero depth the direction decides) and the drive."""
    phases, equations = motion.prepared, motion.equations.linear_between_contacts
    assert equations is not None  # checked before
    form, lags = first_order(equations), [stop.memory_size > 0 for stop in equations.stops]
    depth, rate = form.depth @ states - form.gap[:, None], form.rate @ states

    def indicator(rate: OfStops, acceleration: OfStops) -> tuple[OfStops, OfStops]:
        unit = equations.angular_frequency[0]
        return contact_indicator(depth, rate, *pushes_of(phases, unit, depth, rate, acceleration))

    value, _ = indicator(rate, jnp.zeros_like(depth))
    force = form.stiffness[:, None] * depth + form.damping[:, None] * rate
    change = form.flow @ states - form.push @ jnp.where(value > 0, force, 0.0)
    drive_input = motion.drive.input(motion.waveform, time)
    change = change + form.load[:, None] + form.input[:, None] * drive_input
    rate = jnp.where(np.reshape(lags, (-1, 1)), form.depth @ change, rate)
    value, slope = indicator(rate, form.rate @ change)
    touching = jnp.where(jnp.abs(value) <= near, slope > 0, value > 0)
    bits = (1 << np.arange(phases.num_stops))[:, None]
    phase, still = jnp.sum(jnp.where(touching, bits, 0), axis=0), jnp.zeros_like(time)
    if isinstance(motion.waveform, AbstractSignal):
        change = motion.drive.input(motion.waveform, time + duration) - drive_input
        turn = jnp.full_like(time, equations.angular_frequency[0])
        return phase, states, still, turn, still + 0j, drive_input, change / duration
    angle, _, _ = motion.waveform.phase(time)
    _, turn, second = motion.waveform.phase(time + duration / 2)
    angle = angle - 2 * np.pi * jnp.round(angle / (2 * np.pi))
    amplitude = motion.drive.complex_amplitude(turn, second)
    return phase, states, angle, turn, amplitude, still, still


@compiled
def _first_event(
    phases: ContactPhases,
    unit_rate: Number,
    near: Number,
    places: int,
    phase: Phase,
    lanes: tuple[Array, ...],
    length: PerLane,
    last: Int[Array, " lanes"],
) -> tuple[PerLane, Int[Array, " lanes"], Float[Array, "states lanes"]]:
    """Find the first event of lanes in one phase within a time `length`.

    Returns when it is, which stop changes its contact there (-1: none), and the state.
    """
    motion = begin_phase(phases, phase, *lanes)
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
    now = jnp.any(at_once, axis=0)
    end = jnp.where(now, 0.0, jnp.minimum(end, length))
    flips = jnp.where(now, jnp.argmax(at_once, axis=0), jnp.where(found & ~missed, stop, -1))
    blocks, _, _ = follow(phases, phase, motion, end)
    return end, flips, phases.to_state[phase] @ blocks


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


def over_pieces(
    function: Callable[..., Any],
    places: int,
    pieces: Pieces,
    *columns: Shaped[np.ndarray, " pieces"],
) -> Any:
    """Call `function(phase, lanes, *columns)` batch by batch; what it returns has lanes last."""
    size, parts, order = max(64, 16384 // places), [], []
    for phase in np.unique(pieces.phase):
        (alike,) = np.nonzero(pieces.phase == phase)
        for k in range(0, alike.size, size):
            items = alike[k : k + size]
            filled = np.pad(items, (0, size - items.size), mode="edge")
            lanes = tuple(jnp.asarray(column[..., filled]) for column in pieces[4:])
            rest = (jnp.asarray(column[filled]) for column in columns)
            found = function(jnp.asarray(int(phase)), lanes, *rest)
            parts.append(jax.tree.map(lambda a, n=items.size: np.asarray(a)[..., :n], found))
            order.append(items)
    back = np.argsort(np.concatenate(order))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1)[..., back], *parts)


def exact_pieces(
    motion: Motion, time: Float[np.ndarray, " samples"], states: Float[np.ndarray, "samples states"]
) -> tuple[Pieces, int]:
    """Cut the motion between all samples into pieces of one phase; also return their `places_for`.

    Raises `ValueError` when an interval holds more than `MOST_ROUNDS` events.
    """
    phases, equations = motion.prepared, motion.equations.linear_between_contacts
    assert equations is not None  # checked before
    duration = np.diff(time)
    places = places_for(phases, float(np.max(duration)))
    reach = np.max(np.abs(states) @ np.abs(np.asarray(phases.towards_stop)).T, initial=0.0)
    near = jnp.asarray(NEAR * (reach + np.max(np.abs(np.asarray(phases.gap)), initial=0.0)))
    columns, moments, lengths = map(jnp.asarray, (states[:-1].T, time[:-1], duration))
    begun = map(np.asarray, _begun(motion, columns, moments, lengths, near))
    work = Pieces(np.arange(duration.size), np.zeros(duration.size), duration, *begun)
    if not phases.num_stops:
        return work, places
    event = eqx.Partial(_first_event, phases, equations.angular_frequency[0], near, places)
    last = np.full(duration.size, -1)
    done: list[Pieces] = []
    for _ in range(MOST_ROUNDS):
        left = duration[work.interval] - work.start
        end, stop, state = over_pieces(event, places, work, left, last)
        done.append(work._replace(end=work.start + end))
        (on,) = np.nonzero((stop >= 0) | (end < left * (1 - 1e-12)))
        if not on.size:
            break
        kept, end, last = work.at(on), end[on], stop[on]
        work = kept._replace(
            start=kept.start + end,
            phase=kept.phase ^ np.where(last >= 0, 1 << np.maximum(last, 0), 0),
            state=state[:, on],
            angle=kept.angle + kept.rate * end,
            level=kept.level + kept.slope * end,
        )
    else:
        raise ValueError(
            f"More than {MOST_ROUNDS} touches and departures within {np.max(duration):.4g} s, at "
            f"t = {time[work.interval[0]]:.6g} s: sample finer (samples_per_period)."
        )
    whole = Pieces(*(np.concatenate(column, axis=-1) for column in zip(*done, strict=True)))
    return whole.at(np.argsort(whole.interval, kind="stable")), places
