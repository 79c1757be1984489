"""One step of exponential splitting for any waveform, and what the drive does within it."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax.model.drives import AbstractSignal
from vibrojax.model.equations import LinearEquations
from vibrojax.model.systems import Motion
from vibrojax.stepping.splitting import (
    check_uncoupled,
    contact_of,
    drift,
    driven_flow,
    kick,
    steady,
)

State = Float[Array, " states"]
Scalar = Float[Array, ""]


class DrivenStep(NamedTuple):
    """What the drive does in a step of one lane, by the share of it that is gone, 0 to 1."""

    at: Callable[[float], State]
    """The states about which modes move freely, stops left out."""
    input: Callable[[float], Scalar]
    """m/s2 or N."""
    flow: Callable[[float], Callable[..., Float[Array, "2 modes"]]]
    """The flow of (q, q') about those states over a share of the step, from another share on."""


def driven_step(
    motion: Motion, equations: LinearEquations, start: Scalar, duration: Scalar
) -> DrivenStep:
    """Return what the drive does in a step from a time (s) on.

    Harmonic drives and straight signals are exact; of a chirp the step takes the frequency and
    amplitude of its middle. Raises `ValueError` when the damping couples the modes.
    """
    if isinstance(motion.waveform, AbstractSignal):
        return _straight(motion, equations, start, duration)
    phase, _, _ = motion.waveform.phase(start)
    phase_end, _, _ = motion.waveform.phase(start + duration)
    middle, rate, second = motion.waveform.phase(start + duration / 2)
    amplitude = motion.drive.complex_amplitude(rate, second)
    frequency = (phase_end - phase) / duration
    forced, driven = steady(equations, amplitude, frequency)

    def angle(share):
        known = {0.0: phase, 0.5: middle, 1.0: phase_end}
        if share in known:
            return known[share]
        begun = phase if share < 0.5 else middle
        return begun + (share - (0.0 if share < 0.5 else 0.5)) * frequency * duration

    def wave(amplitude):
        return lambda share: (
            amplitude.real * jnp.sin(angle(share)) + amplitude.imag * jnp.cos(angle(share))
        )

    def flow(share):
        moved = driven_flow(equations, driven, frequency, share * duration)
        return lambda q, v, begun: moved(q, v, angle(begun))

    return DrivenStep(wave(forced), wave(amplitude), flow)


def _straight(motion, equations, start, duration) -> DrivenStep:
    """Under an input that is linear over the step this is exact; of another it is the chord."""
    check_uncoupled(equations)
    ends = start + jnp.array([0.0, 1.0]) * duration
    first, last = motion.drive.input(motion.waveform, ends)
    slope = (last - first) / duration
    w, zeta = equations.angular_frequency, equations.damping_ratio
    flexibility = equations.input_map / w**2
    lag = 2 * zeta / w * slope
    still = jnp.zeros(equations.memory_size)

    def at(share):
        q = flexibility * (first + share * (last - first) - lag)
        return jnp.concatenate([q, flexibility * slope, still])

    def flow(share):
        free = drift(w, zeta, share * duration)
        return lambda q, v, begun: jnp.stack(free(q, v))

    def input_(share):
        return motion.drive.input(motion.waveform, start + share * duration)

    return DrivenStep(at, input_, flow)


def step_from(motion: Motion, state: State, start: Scalar, duration: Scalar) -> State:
    """Take one step of one lane from a time (s), for any waveform; see `driven_step`."""
    equations = motion.equations.linear_between_contacts
    if equations is None:
        raise ValueError("ExponentialSplitting needs a system that is linear but for its stops.")
    at, _, flow = driven_step(motion, equations, start, duration)
    half = flow(0.5)
    q, v, memory = equations.split(state - at(0.0))
    q, v = half(q, v, 0.0)
    if equations.stops:
        contact = contact_of(equations, 0)
        forced_q, forced_v, _ = equations.split(at(0.5))
        depth = contact.towards @ (q + forced_q) - contact.gap
        rate = contact.towards @ (v + forced_v)
        impulse, memory = kick(contact, depth, rate, memory, duration)
        v = v - contact.push @ impulse
    q, v = half(q, v, 0.5)
    return jnp.concatenate([q, v, memory]) + at(1.0)
