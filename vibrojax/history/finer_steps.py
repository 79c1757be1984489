"""The motion between the samples of a history, stepped again from every sample.

For contact laws that are not linear: `ExponentialSplitting` in as many steps as a tolerance of 1e-6
asks for. A step is half a drift, a kick, half a drift; the work of a kick on the stop is its
impulse times the mean of the rates before and after it, exactly as the beam loses it.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.model.stop_forces import memory_by_stop, stop_forces
from vibrojax.model.systems import Motion
from vibrojax.stepping.cubic import cubic_between
from vibrojax.stepping.splitting import contact_of, kick, steps_of
from vibrojax.stepping.splitting_step import driven_step

TOLERANCE = 1e-6
FINEST = 0.1
"""Longest step, in radians of the highest mode."""
PLACES = (0.5 - 0.5 / math.sqrt(3), 0.5 + 0.5 / math.sqrt(3))
"""Gauss-Legendre quadrature of the losses in half a drift, both of weight 1/2."""


class Cells(NamedTuple):
    """Parts of a motion, each within a sample interval, and what happens in them."""

    number: Int[np.ndarray, " cells"]
    """From 0 at the start of the motion."""
    interval: Int[np.ndarray, " cells"]
    beam_loss: Float[np.ndarray, "modes cells"]
    """J."""
    input_work: Float[np.ndarray, " cells"]
    start: Float[np.ndarray, "stops cells"]
    """When the contact in it begins, and ends, s."""
    end: Float[np.ndarray, "stops cells"]
    here: Bool[np.ndarray, "stops cells"]
    """Whether the stop is touched where the cell begins, and ends."""
    there: Bool[np.ndarray, "stops cells"]
    highest: Float[np.ndarray, "stops cells"]
    """Largest force, N."""
    lowest: Float[np.ndarray, "stops cells"]
    deepest: Float[np.ndarray, "stops cells"]
    """Largest penetration, m."""
    impulse: Float[np.ndarray, "stops cells"]
    """N s."""
    loss: Float[np.ndarray, "stops cells"]
    """J."""
    stored_start: Float[np.ndarray, "stops cells"]
    """Energy in the stop, J."""
    stored_end: Float[np.ndarray, "stops cells"]
    rate_start: Float[np.ndarray, "stops cells"]
    """Speed into the stop, m/s, where the contact begins, and ends."""
    rate_end: Float[np.ndarray, "stops cells"]


OF_STOPS = Cells._fields[Cells._fields.index("start") :]
"""What cells have of every stop."""


class _Place(NamedTuple):
    """Where lanes are between two steps, by stop."""

    depth: AnyArray
    rate: AnyArray
    force: AnyArray
    stored: AnyArray
    value: AnyArray
    """Positive in contact: depth (m), or the force (N) of a stop with memory."""
    slope: AnyArray
    """Its rate."""


def substeps(motion: Motion, interval: float) -> int:
    """How many steps to take in an interval (s)."""
    equations = motion.equations.linear_between_contacts
    assert equations is not None  # checked before
    rate = motion.clock
    steps = int(steps_of(equations, rate, jnp.asarray(TOLERANCE)))
    share = interval * float(rate) / (2 * np.pi)
    highest = float(jnp.max(equations.angular_frequency))
    return max(4, math.ceil(steps * share - 1e-6), math.ceil(highest * interval / FINEST))


def _place(motion: Motion, state: Float[Array, " states"], time: Float[Array, ""]) -> _Place:
    equations = motion.equations.linear_between_contacts
    assert equations is not None  # checked before
    q, v, memory = equations.split(state)
    stops = equations.stops
    depth, rate = equations.penetration(q), equations.stop_map @ v

    def per_stop(read, depth, memory):
        kept = memory_by_stop(stops, memory)  # each stop with the memory that it has
        values = [read(s, depth[i], rate[i], kept[i]) for i, s in enumerate(stops)]
        return jnp.stack(values) if values else jnp.zeros_like(depth)

    def exact(depth, memory):
        return per_stop(lambda s, d, r, m: s.exact_force(d, r, m), depth, memory)

    force = stop_forces(stops, depth, rate, memory)
    stored = per_stop(lambda s, d, r, m: s.stored_energy(d, m), depth, memory)
    changes = rate, equations.memory_rates(q, v, memory)
    value, slope = jax.jvp(exact, (depth, memory), changes)
    lagging = jnp.asarray([s.memory_size > 0 for s in stops], bool)
    value, slope = jnp.where(lagging, value, depth), jnp.where(lagging, slope, rate)
    return _Place(depth, rate, force, stored, value, slope)


def _step(motion: Motion, state, start, h):
    """Take one step of one lane; returns the state and what it lost, worked and received."""
    equations = motion.equations.linear_between_contacts
    assert equations is not None  # checked before
    w, zeta, n = equations.angular_frequency, equations.damping_ratio, equations.size
    received = equations.modal_mass * equations.input_map
    at, drive_at, flow = driven_step(motion, equations, start, h)
    half, *early = (flow(x / 2) for x in (1.0, *PLACES))

    def lost(q, v, share):
        """Losses of the modes and work of the input over half a step from (q, v)."""
        loss, work = jnp.zeros(n), jnp.zeros(())
        for place, x in zip(early, PLACES, strict=True):
            there = share + x / 2
            _, speed = place(q, v, share)
            speed = speed + at(there)[n : 2 * n]
            loss = loss + h / 4 * 2 * zeta * w * equations.modal_mass * speed**2
            work = work + h / 4 * drive_at(there) * (received @ speed)
        return loss, work

    q, v, memory = equations.split(state - at(0.0))
    loss, work = lost(q, v, 0.0)
    q, v = half(q, v, 0.0)
    contact = contact_of(equations, 0)
    forced_q, forced_v, _ = equations.split(at(0.5))
    rate = contact.towards @ (v + forced_v)
    impulse = jnp.zeros_like(rate)
    if equations.stops:
        depth = contact.towards @ (q + forced_q) - contact.gap
        impulse, memory = kick(contact, depth, rate, memory, h)
        v = v - contact.push @ impulse
    taken = impulse * (rate + contact.towards @ (v + forced_v)) / 2
    later, more = lost(q, v, 0.5)
    state = jnp.concatenate([*half(q, v, 0.5), memory]) + at(1.0)
    return state, (loss + later, work + more, impulse, taken)


@compiled
def _march(motion, states, start, h, *, steps, read):
    """Step lanes on from their samples; `read` says what is kept of every place."""

    def lane(state, start):
        def one(state, i):
            state, happened = _step(motion, state, start + i * h, h)
            return state, (read(motion, state, start + (i + 1) * h), happened)

        _, (seen, happened) = jax.lax.scan(one, state, jnp.arange(steps))
        first = read(motion, state, start)
        return happened, jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, seen)

    return jax.vmap(lane)(states, start)


def _marched(
    motion: Motion,
    time: Float[np.ndarray, " samples"],
    states: Float[np.ndarray, "samples states"],
    read: Callable[..., Any],
) -> Iterator[tuple[Int[np.ndarray, " items"], Any, Any]]:
    """March all intervals, batch by batch: yields items and what `_march` returns of them."""
    interval = float(np.mean(np.diff(time)))
    steps = substeps(motion, interval)
    size = max(16, 16384 // steps)
    for k in range(0, time.size - 1, size):
        items = np.arange(k, min(k + size, time.size - 1))
        filled = np.pad(items, (0, size - items.size), mode="edge")
        numbers = (jnp.asarray(states[filled]), jnp.asarray(time[filled]))
        found = _march(motion, *numbers, jnp.asarray(interval / steps), steps=steps, read=read)
        yield items, *jax.tree.map(lambda a, n=items.size: np.asarray(a)[:n], found)


def largest(
    motion: Motion,
    time: Float[np.ndarray, " samples"],
    states: Float[np.ndarray, "samples states"],
    quantity: str,
    shape: Float[np.ndarray, " coordinates"],
    start: float,
) -> tuple[float, float]:
    """Return the value of largest modulus from `start` (s) on, and its time, as `exact_cells`."""
    # At the end of the history, its last interval.
    begin = int(np.clip(np.searchsorted(time, start, side="right") - 1, 0, time.size - 2))
    time, states = time[begin:], states[begin:]
    read = eqx.Partial(_read_quantity, quantity=quantity, shape=jnp.asarray(shape))
    best = (-np.inf, 0.0, 0.0)
    for items, _, values in _marched(motion, time, states, read):
        share = np.linspace(0.0, 1.0, values.shape[1])
        times = time[items][:, None] + share * np.diff(time)[items][:, None]
        size = values if quantity == "contact_force" else np.abs(values)
        size = np.where(times >= start, size, -np.inf)
        at = np.unravel_index(np.argmax(size), size.shape)
        best = max(best, (float(size[at]), float(values[at]), float(times[at])))
    return best[1:]


def _read_quantity(motion, state, time, *, quantity, shape):
    q, v, memory = motion.equations.split(state)
    if quantity == "contact_force":
        return jnp.sum(_place(motion, state, time).force)
    if quantity == "acceleration":
        drive_input = motion.drive.input(motion.waveform, time)
        return shape @ motion.equations.acceleration(q, v, drive_input, memory)
    return shape @ {"displacement": q, "velocity": v}[quantity]


def cells(
    motion: Motion, time: Float[np.ndarray, " samples"], states: Float[np.ndarray, "samples states"]
) -> Iterator[Cells]:
    """Yield every step of the motion, batch by batch."""
    for items, (lost, worked, impulse, taken), places in _marched(motion, time, states, _place):
        steps = worked.shape[1]
        duration = np.diff(time)[items][:, None] * np.ones(steps) / steps
        origin = (time[items][:, None] + duration * np.arange(steps)).ravel()
        h = duration.ravel()

        def rows(values: np.ndarray) -> np.ndarray:
            return values.reshape(-1, values.shape[-1]).T

        before: Any = _Place(*(rows(a[:, :-1]) for a in places))
        after: Any = _Place(*(rows(a[:, 1:]) for a in places))
        here, there = before.value > 0, after.value > 0
        u = _crossing(before, after, h)
        begin, over = np.where(here, 0.0, u), np.where(there, 1.0, u)
        forces = np.where(here, before.force, 0.0), np.where(there, after.force, 0.0)
        faster = after.rate - before.rate
        yield Cells(
            number=(items[:, None] * steps + np.arange(steps)).ravel(),
            interval=np.repeat(items, steps),
            beam_loss=rows(lost),
            input_work=worked.ravel(),
            start=origin + begin * h,
            end=origin + over * h,
            here=here,
            there=there,
            highest=np.maximum(*forces),
            lowest=np.minimum(*forces),
            deepest=np.maximum(np.maximum(before.depth, after.depth), 0.0),
            impulse=rows(impulse),
            loss=rows(taken) - (after.stored - before.stored),
            stored_start=before.stored,
            stored_end=after.stored,
            rate_start=before.rate + begin * faster,
            rate_end=before.rate + over * faster,
        )


def _crossing(before: _Place, after: _Place, h: Float[np.ndarray, " cells"]):
    """Share of a step at which contact begins or ends."""
    f0, f1, d0, d1 = before.value, after.value, before.slope * h, after.slope * h
    # A force that is cut off at zero is continued from the side on which it is not.
    inside, slope = np.where(f0 > 0, f0, f1), np.where(f0 > 0, d0, d1)
    straight = np.where(f0 > 0, 0.0, 1.0) - inside / np.where(slope == 0, 1.0, slope)
    cut = (f0 == 0) | (f1 == 0)
    u = np.clip(np.where(cut, straight, f0 / np.where(f0 == f1, 1.0, f0 - f1)), 0.0, 1.0)
    cubic = cubic_between(*map(jnp.asarray, (f0, d0, f1, d1)))
    return np.where(cut, u, cubic.root(guess=jnp.asarray(u), rounds=4))
