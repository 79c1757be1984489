"""What happens between the samples of a history: contacts, energies and true peaks.

Exactly where the stops are linear in contact (`exact_pieces`), else by the steps of
`ExponentialSplitting` taken again from every sample (`finer_steps`).
"""

from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from vibrojax._tools.types import AnyArray
from vibrojax.history import finer_steps
from vibrojax.history.exact_pieces import (
    Drives,
    Pieces,
    batch_size,
    batches,
    exact_pieces,
    lanes_of,
    places_for,
    starting_phases,
)
from vibrojax.history.finer_steps import Flow, Rows
from vibrojax.model.equations import LinearEquations
from vibrojax.model.systems import Motion
from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.stepping.cubic import cubic_between, cubic_maximum
from vibrojax.stepping.phase_motion import begin_phase, follow, read_stops, touching_bits

Nodes = Float[AnyArray, " nodes"]
Times = Float[np.ndarray, " samples"]
States = Float[np.ndarray, "samples states"]


def contact_rows(motion: Motion, time: Times, states: States) -> list[Rows]:
    """Return for each stop the stretches in which it is touched, in order of time.

    Raises `ValueError` for systems that are not linear but for their stops, for damping that
    couples the modes together with stops that are not linear in contact, and for samples too far
    apart.
    """
    _check(motion)
    if motion.prepared is None:
        return finer_steps.contact_rows(motion, time, states)
    pieces, drives = exact_pieces(motion, time, states)
    measured = _measure(motion, time, pieces, drives)
    begin = time[pieces.interval] + pieces.start
    end = time[pieces.interval] + pieces.end
    rows = []
    for stop in range(motion.prepared.num_stops):
        (on,) = np.nonzero((pieces.phase >> stop) & 1)
        follows = np.zeros(on.size, bool)
        follows[1:] = np.diff(on) == 1
        own = {name: values[stop][on] for name, values in measured.by_stop.items()}
        rows.append(
            Rows(
                start=begin[on],
                end=end[on],
                follows=follows,
                touched=on > 0,
                departed=on < pieces.phase.size - 1,
                **own,
            )
        )
    return rows


def flow(motion: Motion, time: Times, states: States) -> Flow:
    """Return losses and work over every interval, and the energy of the stops at every sample.

    Raises `ValueError` as `contact_rows` does.
    """
    _check(motion)
    if motion.prepared is None:
        return finer_steps.flow(motion, time, states)
    phases = motion.prepared
    pieces, drives = exact_pieces(motion, time, states)
    measured = _measure(motion, time, pieces, drives)
    stops = np.arange(phases.num_stops)[:, None]
    loss = measured.by_stop["loss"].copy()
    # A stop let go with energy in it loses that; one touched deep is taken to have kept it.
    touching = (pieces.phase >> stops) & 1 == 1
    left, entered = touching[:, :-1] & ~touching[:, 1:], ~touching[:, :-1] & touching[:, 1:]
    loss[:, :-1] += np.where(left, measured.by_stop["stored_end"][:, :-1], 0.0)
    loss[:, :-1] -= np.where(entered, measured.by_stop["stored_start"][:, 1:], 0.0)

    def per_interval(
        values: Float[np.ndarray, "rows pieces"],
    ) -> Float[np.ndarray, "intervals rows"]:
        sums = [np.bincount(pieces.interval, v, time.size - 1) for v in values]
        return np.array(sums).reshape(-1, time.size - 1).T

    held = (starting_phases(motion, time, states)[None] >> stops) & 1 == 1
    depth = np.asarray(phases.towards_stop) @ states[:, : phases.num_blocks].T
    depth = depth - np.asarray(phases.gap)[:, None]
    stored = np.where(held, np.asarray(phases.stiffness)[:, None] * depth**2 / 2, 0.0)
    return Flow(
        beam_loss=per_interval(measured.beam_loss),
        contact_loss=per_interval(loss),
        input_work=per_interval(measured.input_work[None])[:, 0],
        stop_energy=stored.T,
    )


def largest(
    motion: Motion,
    time: Times,
    states: States,
    quantity: str,
    shape: Float[np.ndarray, " coordinates"],
    start: float,
) -> tuple[float, float]:
    """Return the value of largest modulus from `start` (s) on, and its time (s).

    `quantity` is `displacement`, `velocity`, `acceleration` or `contact_force`, `shape` what each
    coordinate adds to it; of `contact_force` the largest value, all stops together. Raises
    `ValueError` as `contact_rows` does.
    """
    _check(motion)
    if motion.prepared is None:
        return finer_steps.largest(motion, time, states, quantity, shape, start)
    phases = motion.prepared
    pieces, drives = exact_pieces(motion, time, states)
    origin = time[pieces.interval]
    begin = np.maximum(pieces.start, start - origin) - pieces.start
    length = pieces.end - pieces.start - begin
    kept = origin + pieces.end >= start
    pieces = Pieces(*(column[kept] for column in pieces))
    begin, length, origin = begin[kept], np.maximum(length[kept], 0.0), origin[kept]
    places = places_for(phases, float(np.max(np.diff(time))))
    value, at = np.zeros(length.size), np.zeros(length.size)
    for p, items, filled in batches(pieces.phase, batch_size(places)):
        found = _extremes(
            phases,
            jnp.asarray(p),
            lanes_of(pieces, drives, filled),
            jnp.asarray(begin[filled]),
            jnp.asarray(length[filled]),
            jnp.asarray(shape),
            _nodes(places),
            quantity=quantity,
        )
        value[items], at[items] = (np.asarray(a)[: items.size] for a in found)
    best = int(np.argmax(value if quantity == "contact_force" else np.abs(value)))
    return float(value[best]), float(origin[best] + pieces.start[best] + at[best])


def _check(motion: Motion) -> None:
    linear = motion.equations.linear_between_contacts
    if linear is None:
        raise ValueError(
            "The motion between samples is known of systems that are linear but for their stops "
            f"(ImpactingBeam, MatrixSystem), not of {type(motion.equations).__name__}."
        )
    if linear.stiffness_sign is not None:
        raise ValueError(
            "The motion between samples is not known of systems with modes that fall away from "
            "rest (LinearisedPendulum). Read contact_force and quantity(...) of a history with "
            "more samples_per_period."
        )
    if motion.prepared is None and linear.damping_coupling is not None:
        raise ValueError(
            "The damping couples the modes and a stop is not linear in contact: for this the "
            "motion between samples is not known. Use KelvinVoigt stops without smoothing, or "
            "proportional damping."
        )


class _Measured(NamedTuple):
    """What is measured on pieces; stops and modes along the first axis."""

    by_stop: dict[str, Float[np.ndarray, "stops pieces"]]
    beam_loss: Float[np.ndarray, "modes pieces"]
    input_work: Float[np.ndarray, " pieces"]


def _measure(motion: Motion, time: Times, pieces: Pieces, drives: Drives) -> _Measured:
    phases, linear = motion.prepared, motion.equations.linear_between_contacts
    assert linear is not None
    places = places_for(phases, float(np.max(np.diff(time))))
    length = pieces.end - pieces.start
    columns: dict[str, np.ndarray] = {}
    for p, items, filled in batches(pieces.phase, batch_size(places)):
        part = _measure_batch(
            phases,
            linear,
            jnp.asarray(p),
            lanes_of(pieces, drives, filled),
            jnp.asarray(length[filled]),
            _nodes(places),
        )
        for name, values in part.items():
            whole = columns.setdefault(name, np.zeros((*values.shape[:-1], length.size)))
            whole[..., items] = np.asarray(values)[..., : items.size]
    return _Measured(columns, columns.pop("beam_loss"), columns.pop("input_work"))


@lru_cache
def _nodes(places: int) -> tuple[Nodes, Nodes]:
    """Places and weights of Gauss-Lobatto quadrature on [0, 1], enough for squared motions."""
    count = 6 + 3 * places // 4
    polynomial = np.polynomial.legendre.Legendre.basis(count - 1)
    slope = polynomial.deriv()
    inner = np.sort(slope.roots().real)
    for _ in range(3):
        inner = inner - slope(inner) / slope.deriv()(inner)
    nodes = np.concatenate([[-1.0], inner, [1.0]])
    weights = 2 / (count * (count - 1) * polynomial(nodes) ** 2)
    return (1 + nodes) / 2, weights / 2


@eqx.filter_jit
def _measure_batch(
    phases: ContactPhases,
    equations: LinearEquations,
    phase: Int[Array, ""],
    lanes: tuple[Array, ...],
    length: Float[Array, " lanes"],
    nodes: tuple[Nodes, Nodes],
) -> dict[str, Array]:
    share, weights = nodes
    motion, n = begin_phase(phases, phase, *lanes), phases.num_blocks
    time = length[:, None] * share
    blocks = follow(phases, phase, motion, time)
    to_state = phases.to_state[phase]
    v = jnp.tensordot(to_state[n:], blocks[0], axes=1)

    def integral(values: Float[Array, "*rows lanes nodes"]) -> Float[Array, "*rows lanes"]:
        return length * (values @ weights)

    mass = equations.modal_mass[:, None, None]
    damping = 2 * equations.damping_ratio * equations.angular_frequency
    deceleration = damping[:, None, None] * v
    if equations.damping_coupling is not None:
        deceleration = deceleration + jnp.tensordot(equations.damping_coupling, v, axes=1)
    _, _, rate, amplitude = lanes
    angle = motion.angle[:, None] + rate[:, None] * time
    drive = amplitude.real[:, None] * jnp.sin(angle) + amplitude.imag[:, None] * jnp.cos(angle)
    power = drive * jnp.tensordot(equations.modal_mass * equations.input_map, v, axes=1)

    depth, depth_rate, acceleration = read_stops(phases, phase, blocks)
    held = touching_bits(phases, phase)[:, None, None]
    k, c = phases.stiffness[:, None, None], phases.damping[:, None, None]
    force = jnp.where(held, k * depth + c * depth_rate, 0.0)
    slope = jnp.where(held, k * depth_rate + c * acceleration, 0.0)
    stored = jnp.where(held, k * depth**2 / 2, 0.0)
    cell = length[:, None] * jnp.diff(share)

    def top(
        values: Float[Array, "stops lanes nodes"], slopes: Float[Array, "stops lanes nodes"]
    ) -> Float[Array, "stops lanes"]:
        ends = (values[..., :-1], slopes[..., :-1] * cell, values[..., 1:], slopes[..., 1:] * cell)
        return jnp.max(cubic_maximum(*ends), axis=-1)

    return {
        "beam_loss": integral(mass * v * deceleration),
        "input_work": integral(power),
        "loss": integral(jnp.where(held, c * depth_rate**2, 0.0)),
        "impulse": integral(force),
        "highest": top(force, slope),
        "lowest": -top(-force, -slope),
        "deepest": top(depth, depth_rate),
        "stored_start": stored[..., 0],
        "stored_end": stored[..., -1],
        "rate_start": depth_rate[..., 0],
        "rate_end": depth_rate[..., -1],
    }


@eqx.filter_jit
def _extremes(
    phases: ContactPhases,
    phase: Int[Array, ""],
    lanes: tuple[Array, ...],
    begin: Float[Array, " lanes"],
    length: Float[Array, " lanes"],
    shape: Float[Array, " coordinates"],
    nodes: tuple[Nodes, Nodes],
    *,
    quantity: str,
) -> tuple[Float[Array, " lanes"], Float[Array, " lanes"]]:
    share, _ = nodes
    motion, n = begin_phase(phases, phase, *lanes), phases.num_blocks
    rows = shape @ phases.to_state[phase][:n]

    def look(
        time: Float[Array, "lanes *nodes"],
    ) -> tuple[Float[Array, "lanes *nodes"], ...]:
        blocks = follow(phases, phase, motion, time)
        if quantity == "contact_force":
            depth, rate, acceleration = read_stops(phases, phase, blocks)
            held = touching_bits(phases, phase).astype(depth.dtype)
            k, c = held * phases.stiffness, held * phases.damping
            force = jnp.tensordot(k, depth, axes=1) + jnp.tensordot(c, rate, axes=1)
            return force, jnp.tensordot(k, rate, axes=1) + jnp.tensordot(c, acceleration, axes=1)
        if quantity == "acceleration":
            rows_v = shape @ phases.to_state[phase][n:]
            return tuple(jnp.tensordot(rows_v, b, axes=1) for b in blocks[1:])
        order = ("displacement", "velocity").index(quantity)
        return tuple(jnp.tensordot(rows, b, axes=1) for b in blocks[order : order + 2])

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
