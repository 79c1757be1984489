"""What happens in the pieces of a motion whose stops are linear in contact, by its propagators."""

from collections.abc import Iterator
from functools import lru_cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.history.exact_pieces import exact_pieces, over_pieces
from vibrojax.history.finer_steps import Cells
from vibrojax.model.equations import LinearEquations
from vibrojax.model.stop_forces import memory_by_stop
from vibrojax.model.systems import Motion
from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.stepping.cubic import cubic_between, cubic_maximum
from vibrojax.stepping.phase_motion import begin_phase, follow, read_stops, touching_bits

Nodes = tuple[Float[AnyArray, " places"], Float[AnyArray, " places"]]


@lru_cache
def _nodes(places: int) -> Nodes:
    """Places and weights of Gauss-Lobatto quadrature on [0, 1], enough for squared motions."""
    count = 6 + 3 * places // 4
    nodes = np.pad(scipy.special.roots_jacobi(count - 2, 1, 1)[0], 1, constant_values=(-1.0, 1.0))
    weights = 1 / (count * (count - 1) * scipy.special.eval_legendre(count - 1, nodes) ** 2)
    return (1 + nodes) / 2, weights


def cells(
    motion: Motion, time: Float[np.ndarray, " samples"], states: Float[np.ndarray, "samples states"]
) -> Iterator[Cells]:
    """Return every piece of the motion. Raises `ValueError` for samples too far apart."""
    pieces, places = exact_pieces(motion, time, states)
    linear = motion.equations.linear_between_contacts
    measure = eqx.Partial(_measure_batch, motion.prepared, linear, _nodes(places))
    found = over_pieces(measure, places, pieces, pieces.end - pieces.start)
    stops = np.arange(motion.prepared.num_stops)[:, None]
    touching = (pieces.phase >> stops) & 1 == 1
    yield Cells(
        number=np.arange(pieces.phase.size),
        interval=pieces.interval,
        start=np.where(touching, time[pieces.interval] + pieces.start, 0.0),
        end=np.where(touching, time[pieces.interval] + pieces.end, 0.0),
        here=touching,
        there=touching,
        **found,
    )


@compiled
def _measure_batch(
    phases: ContactPhases,
    equations: LinearEquations,
    nodes: Nodes,
    phase: Int[Array, ""],
    lanes: tuple[Array, ...],
    length: Float[Array, " lanes"],
) -> dict[str, Array]:
    share, weights = nodes
    motion = begin_phase(phases, phase, *lanes)
    time = length[:, None] * share
    blocks = follow(phases, phase, motion, time)
    q, v, memory = equations.split(jnp.tensordot(phases.to_state[phase], blocks[0], axes=1))

    def integral(values: Float[Array, "*rows lanes nodes"]) -> Float[Array, "*rows lanes"]:
        return length * (values @ weights)

    mass = equations.modal_mass[:, None, None]
    damping = 2 * equations.damping_ratio * equations.angular_frequency
    deceleration = damping[:, None, None] * v
    if equations.damping_coupling is not None:
        deceleration = deceleration + jnp.tensordot(equations.damping_coupling, v, axes=1)
    if equations.internal is not None:  # what they take counts as lost
        pull = jnp.tensordot(equations.internal.acceleration, memory[: equations.internal_size], 1)
        deceleration = deceleration - pull
    _, _, rate, amplitude, level, slope = lanes
    angle = motion.angle[:, None] + rate[:, None] * time
    drive = amplitude.real[:, None] * jnp.sin(angle) + amplitude.imag[:, None] * jnp.cos(angle)
    drive = drive + level[:, None] + slope[:, None] * time
    power = drive * jnp.tensordot(equations.modal_mass * equations.input_map, v, axes=1)
    if equations.load is not None:
        power = power + jnp.tensordot(equations.modal_mass * equations.load, v, axes=1)

    depth, depth_rate, acceleration = read_stops(phases, phase, blocks)
    held = touching_bits(phases, phase)[:, None, None]
    k, c = held * phases.stiffness[:, None, None], held * phases.damping[:, None, None]
    force, change = k * depth + c * depth_rate, k * depth_rate + c * acceleration
    stored, loss = k * depth**2 / 2, integral(c * depth_rate**2)
    kept = memory_by_stop(equations.stops, equations.memory_of_stops(memory))
    for s, (stop, own) in enumerate(zip(equations.stops, kept, strict=True)):
        if own is not None:  # the depth above is that below its surface
            speed = jnp.tensordot(equations.stop_map[s], v, axes=1)
            moved = jnp.tensordot(equations.stop_map[s], q, axes=1) - phases.gap[s]
            depth, depth_rate = depth.at[s].set(moved), depth_rate.at[s].set(speed)
            stored = stored.at[s].set(stop.stored_energy(moved, own))
            given_back = stored[s, :, -1] - stored[s, :, 0]
            loss = loss.at[s].set(integral(force[s] * speed) - given_back)
    cell = length[:, None] * jnp.diff(share)

    def top(
        values: Float[Array, "stops lanes nodes"], slopes: Float[Array, "stops lanes nodes"]
    ) -> Float[Array, "stops lanes"]:
        ends = (values[..., :-1], slopes[..., :-1] * cell, values[..., 1:], slopes[..., 1:] * cell)
        return jnp.max(cubic_maximum(*ends), axis=-1)

    return {
        "beam_loss": integral(mass * v * deceleration),
        "input_work": integral(power),
        "loss": loss,
        "impulse": integral(force),
        "highest": top(force, change),
        "lowest": -top(-force, -change),
        "deepest": top(depth, depth_rate),
        "stored_start": stored[..., 0],
        "stored_end": stored[..., -1],
        "rate_start": depth_rate[..., 0],
        "rate_end": depth_rate[..., -1],
    }


def largest(
    motion: Motion,
    time: Float[np.ndarray, " samples"],
    states: Float[np.ndarray, "samples states"],
    quantity: str,
    shape: Float[np.ndarray, " coordinates"],
    start: float,
) -> tuple[float, float]:
    """Return the value of largest modulus from `start` (s) on, and its time (s).

    `quantity` is `displacement`, `velocity`, `acceleration` or `contact_force`, `shape` what each
    coordinate adds to it; of `contact_force` the largest value, all stops together.
    """
    pieces, places = exact_pieces(motion, time, states)
    end = time[pieces.interval] + pieces.end
    pieces = pieces.at(end >= min(start, np.max(end)))  # by round-off all may end before
    origin = time[pieces.interval] + pieces.start
    begin = np.maximum(start - origin, 0.0)
    length = np.maximum(pieces.end - pieces.start - begin, 0.0)
    extremes = eqx.Partial(_extremes, motion.prepared, jnp.asarray(shape), _nodes(places), quantity)
    value, at = over_pieces(extremes, places, pieces, begin, length)
    best = int(np.argmax(value if quantity == "contact_force" else np.abs(value)))
    return float(value[best]), float(origin[best] + at[best])


@compiled
def _extremes(
    phases: ContactPhases,
    shape: Float[Array, " coordinates"],
    nodes: Nodes,
    quantity: str,
    phase: Int[Array, ""],
    lanes: tuple[Array, ...],
    begin: Float[Array, " lanes"],
    length: Float[Array, " lanes"],
) -> tuple[Float[Array, " lanes"], Float[Array, " lanes"]]:
    motion, n = begin_phase(phases, phase, *lanes), len(shape)
    to_state = phases.to_state[phase]
    to_q, to_v = to_state[:n], to_state[n : 2 * n]
    held = touching_bits(phases, phase).astype(to_q.dtype)
    k, c, towards = held * phases.stiffness, held * phases.damping, phases.towards_stop @ to_state
    zero = jnp.zeros(len(to_state))
    # Rows that read the quantity off the blocks and off their rates.
    rows, rate_rows = {
        "displacement": (shape @ to_q, zero),
        "velocity": (zero, shape @ to_q),
        "acceleration": (zero, shape @ to_v),
        "contact_force": (k @ towards, c @ towards),
    }[quantity]
    offset = k @ phases.gap if quantity == "contact_force" else 0.0

    def look(time: Float[Array, "lanes *nodes"]) -> list[Float[Array, "lanes *nodes"]]:
        blocks = follow(phases, phase, motion, time)
        here, slope = (
            jnp.tensordot(rows, blocks[i], axes=1) + jnp.tensordot(rate_rows, blocks[i + 1], axes=1)
            for i in (0, 1)
        )
        return [here - offset, slope]

    share, _ = nodes
    time = begin[:, None] + length[:, None] * share
    value, slope = look(time)
    cell = length[:, None] * jnp.diff(share)

    def best(sign: float) -> tuple[Float[Array, " lanes"], ...]:
        """Largest value of a sign: by the cubics of the cells, then by the motion itself."""
        y, d = sign * value, sign * slope
        f0, f1, d0, d1 = y[:, :-1], y[:, 1:], d[:, :-1] * cell, d[:, 1:] * cell
        first = jnp.argmax(cubic_maximum(f0, d0, f1, d1), axis=1)[:, None]
        f0, f1, d0, d1, width, at = (
            jnp.take_along_axis(a, first, axis=1)[:, 0]
            for a in (f0, f1, d0, d1, cell, time[:, :-1])
        )
        u, height = cubic_between(f0, d0, f1, d1).peak()
        inside = at + jnp.where(height > f0, u, 0.0) * width
        times = jnp.stack([inside, at, at + width])
        values = jnp.stack([sign * look(inside)[0], f0, f1])
        pick = jnp.argmax(values, axis=0)[None]
        return tuple(jnp.take_along_axis(a, pick, axis=0)[0] for a in (values, times))

    up, up_at = best(1.0)
    if quantity == "contact_force":
        return up, up_at
    down, down_at = best(-1.0)
    return jnp.where(up >= down, up, -down), jnp.where(up >= down, up_at, down_at)
