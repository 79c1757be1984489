"""The motion between the samples of a history, stepped again from every sample.

For contact laws that are not linear: `ExponentialSplitting` in as many steps as a tolerance of 1e-6
asks for. A step is half a drift, a kick, half a drift; the work of a kick on the stop is its
impulse times the mean of the rates before and after it, exactly as the beam loses it.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from vibrojax.model.equations import LinearEquations, memory_by_stop, stop_forces
from vibrojax.model.stops import Stop
from vibrojax.model.systems import Motion
from vibrojax.stepping.cubic import cubic_between
from vibrojax.stepping.splitting import contact_of, driven_flow, kick, steady, steps_for

lax = jax.lax

TOLERANCE = 1e-6
FINEST = 0.1
"""Longest step, in radians of the highest mode."""
_PLACES, _WEIGHTS = (0.5 - 0.5 / math.sqrt(3), 0.5 + 0.5 / math.sqrt(3)), (0.5, 0.5)
"""Gauss-Legendre quadrature of the losses in half a drift."""


class Rows(NamedTuple):
    """Stretches in which one stop is touched, in order of time."""

    start: Float[np.ndarray, " rows"]
    """s."""
    end: Float[np.ndarray, " rows"]
    follows: Bool[np.ndarray, " rows"]
    """Whether the stretch goes on where the one before it ends."""
    touched: Bool[np.ndarray, " rows"]
    """Whether the stop may have been touched first where the stretch begins (False: at time 0)."""
    departed: Bool[np.ndarray, " rows"]
    """Whether it may have been left where it ends (False: at the end of the history)."""
    highest: Float[np.ndarray, " rows"]
    """Largest force, N."""
    lowest: Float[np.ndarray, " rows"]
    deepest: Float[np.ndarray, " rows"]
    """Largest penetration, m."""
    impulse: Float[np.ndarray, " rows"]
    """N s."""
    loss: Float[np.ndarray, " rows"]
    """J."""
    stored_start: Float[np.ndarray, " rows"]
    """Energy in the stop, J."""
    stored_end: Float[np.ndarray, " rows"]
    rate_start: Float[np.ndarray, " rows"]
    """Speed into the stop, m/s."""
    rate_end: Float[np.ndarray, " rows"]


class Flow(NamedTuple):
    """Losses and work over every interval, J, and the energy of the stops at every sample."""

    beam_loss: Float[np.ndarray, "intervals modes"]
    contact_loss: Float[np.ndarray, "intervals stops"]
    input_work: Float[np.ndarray, " intervals"]
    stop_energy: Float[np.ndarray, "samples stops"]


class _Place(NamedTuple):
    """Where lanes are between two steps."""

    depth: Array
    rate: Array
    force: Array
    stored: Array
    value: Array
    """Positive in contact: depth (m), or the force (N) of a stop with memory."""
    slope: Array
    """Its rate."""


def substeps(motion: Motion, interval: float) -> int:
    """How many steps to take in an interval (s)."""
    equations = motion.equations
    assert isinstance(equations, LinearEquations)
    _, rate, _ = motion.waveform.phase(jnp.zeros(()))
    steps = int(_steps(equations, rate, jnp.asarray(TOLERANCE)))
    share = interval * float(rate) / (2 * np.pi)
    highest = float(jnp.max(equations.angular_frequency))
    return max(4, math.ceil(steps * share - 1e-6), math.ceil(highest * interval / FINEST))


_steps = jax.jit(steps_for)


def _per_stop(stops: tuple[Stop, ...], read, depth, rate, memory):
    """Read each stop with the memory that it has."""
    kept = memory_by_stop(stops, memory)
    values = [read(s, depth[i], rate[i], kept[i]) for i, s in enumerate(stops)]
    return jnp.stack(values) if values else jnp.zeros_like(depth)


def _place(equations: LinearEquations, state) -> _Place:
    q, v, memory = equations.split(state)
    stops = equations.stops
    depth, rate = equations.penetration(q), equations.stop_map @ v
    force = stop_forces(stops, depth, rate, memory)
    stored = _per_stop(stops, lambda s, d, r, m: s.stored_energy(d, m), depth, rate, memory)

    def exact(depth, memory):
        return _per_stop(stops, lambda s, d, r, m: s.exact_force(d, r, m), depth, rate, memory)

    changes = rate, equations.memory_rates(q, v, memory)
    value, slope = jax.jvp(exact, (depth, memory), changes)
    lagging = jnp.asarray([s.has_memory for s in stops], bool)
    value, slope = jnp.where(lagging, value, depth), jnp.where(lagging, slope, rate)
    return _Place(depth, rate, force, stored, value, slope)


def _step(motion: Motion, state, start, h):
    """Take one step of one lane; returns the state and what it lost, worked and received."""
    equations = motion.equations
    assert isinstance(equations, LinearEquations)
    phase, _, _ = motion.waveform.phase(start)
    phase_end, _, _ = motion.waveform.phase(start + h)
    middle, rate, second = motion.waveform.phase(start + h / 2)
    amplitude, omega = motion.drive.complex_amplitude(rate, second), (phase_end - phase) / h
    forced, driven = steady(equations, amplitude, omega)
    w, zeta, n = equations.angular_frequency, equations.damping_ratio, equations.size
    half, *early = (driven_flow(equations, driven, omega, x * h / 2) for x in (1.0, *_PLACES))
    received = equations.modal_mass * equations.input_map

    def at(angle):
        return forced.real * jnp.sin(angle) + forced.imag * jnp.cos(angle)

    def lost(q, v, angle):
        """Losses of the modes and work of the input over half a step from (q, v)."""
        loss, work = jnp.zeros(n), jnp.zeros(())
        for place, x, weight in zip(early, _PLACES, _WEIGHTS, strict=True):
            there = angle + x * omega * h / 2
            _, speed = place(q, v, angle)
            speed = speed + at(there)[n : 2 * n]
            drive = amplitude.real * jnp.sin(there) + amplitude.imag * jnp.cos(there)
            loss = loss + weight * h / 2 * 2 * zeta * w * equations.modal_mass * speed**2
            work = work + weight * h / 2 * drive * (received @ speed)
        return loss, work

    q, v, memory = equations.split(state - at(phase))
    loss, work = lost(q, v, phase)
    q, v = half(q, v, phase)
    contact = contact_of(equations, 0)
    forced_q, forced_v, _ = equations.split(at(middle))
    rate = contact.towards @ (v + forced_v)
    impulse = jnp.zeros_like(rate)
    if equations.stops:
        depth = contact.towards @ (q + forced_q) - contact.gap
        impulse, memory = kick(contact, depth, rate, memory, h)
        v = v - contact.push @ impulse
    taken = impulse * (rate + contact.towards @ (v + forced_v)) / 2
    later, more = lost(q, v, middle)
    state = jnp.concatenate([*half(q, v, middle), memory]) + at(phase_end)
    return state, (loss + later, work + more, impulse, taken)


@eqx.filter_jit
def _march(motion, states, start, h, *, steps, read):
    """Step lanes on from their samples; `read` says what is kept of every place."""

    def lane(state, start):
        def one(carry, i):
            state, loss, work = carry
            state, (lost, worked, impulse, taken) = _step(motion, state, start + i * h, h)
            seen = read(motion, state, start + (i + 1) * h)
            return (state, loss + lost, work + worked), (seen, impulse, taken)

        zero = (state, jnp.zeros(motion.equations.size), jnp.zeros(()))
        (_, loss, work), (seen, impulse, taken) = lax.scan(one, zero, jnp.arange(steps))
        first = read(motion, state, start)
        places = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, seen)
        return loss, work, impulse, taken, places

    return jax.vmap(lane)(states, start)


def _read_stops(motion, state, time):
    return _place(motion.equations, state)


def _read_energy(motion, state, time):
    return _place(motion.equations, state).stored


def _read_quantity(motion, state, time, *, quantity, shape):
    q, v, memory = motion.equations.split(state)
    if quantity == "displacement":
        return shape @ q
    if quantity == "velocity":
        return shape @ v
    if quantity == "contact_force":
        return jnp.sum(_place(motion.equations, state).force)
    drive_input = motion.drive.input(motion.waveform, time)
    return shape @ motion.equations.acceleration(q, v, drive_input, memory)


def _batches(motion, time, states, read):
    """March all intervals, batch by batch: yields items and what `_march` returns of them."""
    interval = float(np.mean(np.diff(time)))
    steps = substeps(motion, interval)
    size = max(16, 16384 // steps)
    for k in range(0, time.size - 1, size):
        items = np.arange(k, min(k + size, time.size - 1))
        filled = np.pad(items, (0, size - items.size), mode="edge")
        numbers = (jnp.asarray(states[filled]), jnp.asarray(time[filled]))
        found = _march(motion, *numbers, jnp.asarray(interval / steps), steps=steps, read=read)
        yield items, jax.tree.map(lambda a, n=items.size: np.asarray(a)[:n], found)


def flow(
    motion: Motion, time: Float[np.ndarray, " samples"], states: Float[np.ndarray, "samples states"]
) -> Flow:
    """Return losses and work over every interval, and the energy of the stops at every sample."""
    parts = []
    for _, (loss, work, _, taken, _) in _batches(motion, time, states, _read_energy):
        parts.append((loss, work, taken.sum(axis=1)))
    loss, work, taken = (np.concatenate(column) for column in zip(*parts, strict=True))
    stored = np.asarray(_stored(motion, jnp.asarray(states)))
    return Flow(loss, taken - np.diff(stored, axis=0), work, stored)


@eqx.filter_jit
def _stored(motion, states):
    return jax.vmap(lambda state: _read_energy(motion, state, 0.0))(states)


def largest(
    motion: Motion,
    time: Float[np.ndarray, " samples"],
    states: Float[np.ndarray, "samples states"],
    quantity: str,
    shape: Float[np.ndarray, " coordinates"],
    start: float,
) -> tuple[float, float]:
    """Return the value of largest modulus from `start` (s) on, and its time (s).

    Of `contact_force` the largest value, all stops together.
    """
    begin = max(0, int(np.searchsorted(time, start, side="right")) - 1)
    time, states = time[begin:], states[begin:]
    read = eqx.Partial(_read_quantity, quantity=quantity, shape=jnp.asarray(shape))
    best = (-np.inf, 0.0, 0.0)
    for items, (*_, values) in _batches(motion, time, states, read):
        share = np.linspace(0.0, 1.0, values.shape[1])
        times = time[items][:, None] + share * np.diff(time)[items][:, None]
        size = values if quantity == "contact_force" else np.abs(values)
        size = np.where(times >= start, size, -np.inf)
        at = np.unravel_index(np.argmax(size), size.shape)
        best = max(best, (float(size[at]), float(values[at]), float(times[at])))
    return best[1:]


def contact_rows(
    motion: Motion, time: Float[np.ndarray, " samples"], states: Float[np.ndarray, "samples states"]
) -> list[Rows]:
    """Return for each stop the stretches in which it is touched, in order of time."""
    count, steps = len(motion.equations.stops), 1
    found: list[list[dict[str, np.ndarray]]] = [[] for _ in range(count)]
    for items, (_, _, impulse, taken, places) in _batches(motion, time, states, _read_stops):
        steps = impulse.shape[1]
        origin = time[items][:, None] + np.diff(time)[items][:, None] * np.arange(steps) / steps
        h = (np.diff(time)[items] / steps)[:, None] * np.ones(steps)
        for s in range(count):
            own = _Place(*(a[..., s] for a in places))
            rows = _rows(own, origin, h, impulse[..., s], taken[..., s])
            number = items[:, None] * steps + np.arange(steps)
            rows["number"] = number
            touches = rows.pop("touches")
            found[s].append({name: a[touches] for name, a in rows.items()})
    total = (time.size - 1) * steps
    whole = [
        {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        for parts in found
    ]
    return [_linked(rows, total) for rows in whole]


def _rows(place: _Place, origin, h, impulse, taken):
    """Read every step of one stop, contact or not."""
    before, after = (_Place(*(a[:, cut] for a in place)) for cut in (slice(-1), slice(1, None)))
    here, there = before.value > 0, after.value > 0
    u = _crossing(before, after, h)
    start, end = np.where(here, 0.0, u), np.where(there, 1.0, u)

    def rate(share):
        return before.rate + share * (after.rate - before.rate)

    forces = np.where(here, before.force, 0.0), np.where(there, after.force, 0.0)
    bend = np.maximum(before.depth, after.depth)
    change = after.stored - before.stored
    return {
        "touches": here | there,
        "start": origin + start * h,
        "end": origin + end * h,
        "here": here,
        "there": there,
        "highest": np.maximum(*forces),
        "lowest": np.minimum(*forces),
        "deepest": np.maximum(bend, 0.0),
        "impulse": impulse,
        "loss": taken - change,
        "stored_start": before.stored,
        "stored_end": after.stored,
        "rate_start": rate(start),
        "rate_end": rate(end),
    }


def _crossing(before: _Place, after: _Place, h):
    """Share of a step at which contact begins or ends."""
    f0, f1, d0, d1 = before.value, after.value, before.slope * h, after.slope * h
    # A force that is cut off at zero is continued from the side on which it is not.
    inside, slope = np.where(f0 > 0, f0, f1), np.where(f0 > 0, d0, d1)
    straight = np.where(f0 > 0, 0.0, 1.0) - inside / np.where(slope == 0, 1.0, slope)
    cut = (f0 == 0) | (f1 == 0)
    u = np.clip(np.where(cut, straight, f0 / np.where(f0 == f1, 1.0, f0 - f1)), 0.0, 1.0)
    cubic = cubic_between(*map(jnp.asarray, (f0, d0, f1, d1)))
    return np.where(cut, u, cubic.root(guess=jnp.asarray(u), rounds=4))


def _linked(rows: dict[str, np.ndarray], total: int) -> Rows:
    number, here, there = (rows.pop(name) for name in ("number", "here", "there"))
    follows = np.zeros(number.size, bool)
    follows[1:] = (np.diff(number) == 1) & there[:-1] & here[1:]
    touched, departed = ~(here & (number == 0)), ~(there & (number == total - 1))
    return Rows(follows=follows, touched=touched, departed=departed, **rows)
