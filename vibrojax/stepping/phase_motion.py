"""The motion within a phase of contact: its blocks over a time, and what says that it ends."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Complex, Float, Int, Shaped

from vibrojax._tools.trigonometry import cosine_and_sine
from vibrojax._tools.types import AnyArray
from vibrojax.stepping.contact_phases import (
    ContactPhases,
    block_rest,
    forced_blocks,
    resonant_blocks,
)
from vibrojax.stepping.resonance import driven_growth
from vibrojax.stepping.turns import turn_over, turned

Stops = Float[Array, "*#stops"]
EveryStop = Float[Array, "*stops"]

PerLane = Float[Array, " lanes"]
OfStops = Float[Array, "stops *where"]
Phase = Int[Array, ""]


def free_blocks(
    decay: Float[Array, "2 blocks *#places"],
    rate: Float[Array, "blocks *#places"],
    blocks: Float[Array, "states *#places"],
    time: Float[ArrayLike, "*#places"],
) -> Float[Array, "states *places"]:
    """Advance the block coordinates of a free motion over a time, s.

    Real pairs have rate 0: cosine 1, sine 0, each row with its own exponent.
    """
    turn = turn_over(decay, rate, jnp.asarray(time))
    return jnp.concatenate(list(turned(turn, jnp.stack(jnp.split(blocks, 2)))))


def driven_blocks(
    decay: Float[Array, "2 blocks *#places"],
    rate: Float[Array, "blocks *#places"],
    blocks: Float[Array, "states *#places"],
    driven: Complex[Array, "states *#places"] | None,
    angle: Float[ArrayLike, "*#places"],
    angular_frequency: Float[Array, "*#places"],
    time: Float[ArrayLike, "*#places"],
) -> Float[Array, "states *places"]:
    """Advance block coordinates from the drive phase `angle`, with the input `driven`.

    `driven` is that of blocks in resonance, None where there are none; the others take no more from
    the drive than their steady response, which is not part of these coordinates.
    """
    moved = free_blocks(decay, rate, blocks, time)
    if driven is None:
        return moved
    return moved + driven_growth(decay[0], rate, driven, angle, angular_frequency, time)


def stop_push(
    stiffness: Float[AnyArray, "*#stops"],
    damping: Float[AnyArray, "*#stops"],
    can_pull: Bool[AnyArray, "*#stops"],
    angular_frequency: Stops,
    depth: Stops,
    rate: Stops,
    acceleration: Stops,
) -> tuple[EveryStop, EveryStop]:
    """Force of stops as a depth, m, and its rate; the depth itself where a stop may pull."""
    unit = stiffness + damping * angular_frequency
    pushes = (unit > 0) & ~can_pull
    safe = jnp.where(unit > 0, unit, 1.0)
    push = (stiffness * depth + damping * rate) / safe
    slope = (stiffness * rate + damping * acceleration) / safe
    return jnp.where(pushes, push, depth), jnp.where(pushes, slope, rate)


def contact_indicator(
    depth: Stops, rate: Stops, push: Stops, push_rate: Stops
) -> tuple[EveryStop, EveryStop]:
    """Smaller one of depth and push (positive in contact), m, and its rate, m/s."""
    by_depth = depth <= push
    return jnp.where(by_depth, depth, push), jnp.where(by_depth, rate, push_rate)


class PhaseMotion(NamedTuple):
    """The motion of lanes in one phase, from where their pieces begin."""

    blocks: Float[Array, "states lanes"]
    """Block coordinates of the free part."""
    steady: Complex[Array, "states lanes"]
    driven: Complex[Array, "states lanes"]
    """Input of blocks in resonance, which have no steady response."""
    angle: Float[Array, " lanes"]
    rate: Float[Array, " lanes"]
    level: Float[Array, "states lanes"]
    """What blocks follow at the beginning under an input that runs straight."""
    slope: Float[Array, "states lanes"]
    """Its rate, per s."""


def begin_phase(
    phases: ContactPhases,
    phase: Phase,
    state: Float[Array, "states lanes"],
    angle: PerLane,
    rate: PerLane,
    amplitude: Complex[Array, " lanes"],
    level: PerLane,
    slope: PerLane,
) -> PhaseMotion:
    """Put states of one phase into block coordinates.

    The input is Im(amplitude exp(i (angle + rate t))) + level + slope t.
    """
    steady = forced_blocks(phases, amplitude, rate)[phase]
    driven = resonant_blocks(phases, amplitude, rate)[phase]
    wave = steady.real * jnp.sin(angle) + steady.imag * jnp.cos(angle)
    decay, turn = phases.exponent[phase][..., None], phases.rate[phase][:, None]
    input_ = phases.input[phase][:, None]
    sloping = block_rest(decay, turn, input_ * slope)
    followed = block_rest(decay, turn, input_ * level - sloping)
    blocks = phases.from_state[phase] @ state - phases.rest[phase][:, None] - wave - followed
    return PhaseMotion(blocks, steady, driven, angle, rate, followed, sloping)


def follow(
    phases: ContactPhases, phase: Phase, motion: PhaseMotion, time: Float[Array, "lanes *places"]
) -> tuple[Float[Array, "states lanes *places"], ...]:
    """Block coordinates and their first two derivatives, some time (s) into it."""
    places = time.ndim - 1

    def wide(a: Shaped[Array, "*shape"]) -> Shaped[Array, "*shape_and_places"]:
        return a.reshape(a.shape + (1,) * places)

    decay, turn = wide(phases.exponent[phase][..., None]), wide(phases.rate[phase][:, None])
    blocks, steady, driven, begun, rate, level, slope = map(wide, motion)
    moved = driven_blocks(decay, turn, blocks, driven, begun, rate, time)

    def derived(z: Float[Array, "states lanes *places"]) -> Float[Array, "states lanes *places"]:
        first, second = jnp.split(z, 2)
        along = decay[0] * first - turn * second
        return jnp.concatenate([along, turn * first + decay[1] * second])

    drive = begun + rate * time
    cosine, sine = cosine_and_sine(drive)
    rest = phases.rest[phase].reshape((-1,) + (1,) * time.ndim)
    change = derived(moved) + driven.real * sine + driven.imag * cosine
    driven_change = rate * (driven.real * cosine - driven.imag * sine)
    real, imag = steady.real * sine, steady.imag * sine
    wave = real + steady.imag * cosine
    # d/dt of Im(Z exp(i angle)) is Im(i w Z exp(i angle)).
    wave_change = rate * (steady.real * cosine - imag)
    second_change = derived(change) + driven_change - rate**2 * wave
    straight = level + slope * time
    return moved + rest + wave + straight, change + wave_change + slope, second_change


def read_stops(
    phases: ContactPhases, phase: Phase, blocks: tuple[Float[Array, "states *where"], ...]
) -> tuple[OfStops, OfStops, OfStops]:
    """Depths of the stops, their rates and accelerations, from what `follow` returns."""
    rows = phases.towards_stop @ phases.to_state[phase]
    depth, rate, acceleration = (jnp.tensordot(rows, b, axes=1) for b in blocks)
    return depth - _column(phases.gap, depth), rate, acceleration


def _column(values: Shaped[AnyArray, " stops"], like: OfStops) -> Shaped[Array, "stops *ones"]:
    return jnp.reshape(jnp.asarray(values), (-1,) + (1,) * (like.ndim - 1))


def touching_bits(phases: ContactPhases, phase: Phase) -> Bool[Array, " stops"]:
    """Which stops touch in a phase."""
    return (phase >> jnp.arange(phases.num_stops)) & 1 == 1


def pushes_of(
    phases: ContactPhases,
    unit_rate: Float[Array, ""],
    depth: OfStops,
    rate: OfStops,
    acceleration: OfStops,
) -> tuple[OfStops, OfStops]:
    """Force of a stop as a depth (m), and its rate; the depth itself where it may pull."""
    return stop_push(
        _column(phases.stiffness, depth),
        _column(phases.damping, depth),
        _column(np.asarray(phases.can_pull, bool), depth),
        unit_rate,
        depth,
        rate,
        acceleration,
    )


def breach_of(
    phases: ContactPhases,
    phase: Phase,
    unit_rate: Float[Array, ""],
    stops_read: tuple[OfStops, OfStops, OfStops],
) -> tuple[OfStops, OfStops]:
    """How far a stop is in the wrong phase (positive: it changes contact), and its rate."""
    inside, inside_rate = pushes_of(phases, unit_rate, *stops_read)
    depth, rate, _ = stops_read
    outside, outside_rate = contact_indicator(depth, rate, inside, inside_rate)
    touches = _column(touching_bits(phases, phase), inside)
    return jnp.where(touches, -inside, outside), jnp.where(touches, -inside_rate, outside_rate)
