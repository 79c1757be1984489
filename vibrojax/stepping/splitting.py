"""Exponential splitting: the linear modes advance exactly, contact is a kick.

One step is half a drift, a kick, half a drift. The drift is the exact flow of the damped modes
about their steady response to the drive, so neither mode 5 nor the drive limits the step. The kick
is that of Takahashi and Imada (1984): the force is corrected by its own gradient,
f - h^2/12 f' G f with G the mobility of the contact points, which removes the leading error of a
force that depends on position (the damping of a contact keeps its error of second order). For
every contact law; in lanes it carries trailing axes as `exact_contact` does.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.trigonometry import cosine_and_sine
from vibrojax.model.equations import LinearEquations
from vibrojax.model.stop_forces import (
    contact_slope,
    forces_and_slopes,
    memory_rates,
    touching_stops,
)
from vibrojax.model.stops import Stop
from vibrojax.stepping.contact_phases import spread
from vibrojax.stepping.cubic import cubic_maximum
from vibrojax.stepping.elementary import computed_once, solve_small, where_needed
from vibrojax.stepping.measures import Measures, Segment, no_measures
from vibrojax.stepping.resonance import driven_growth, is_resonant

Modes = Float[Array, "modes *#lanes"]
Lanes = Float[Array, "*#lanes"]
PerStop = Float[Array, "stops *#lanes"]
Memories = Float[Array, "memories *#lanes"]
Scalar = Float[Array, ""]

lax = jax.lax


class Drift(NamedTuple):
    """Exact flow of every mode over a time: (q, q') to (qq q + qv q', vq q + vv q')."""

    qq: Modes
    qv: Modes
    vq: Modes
    vv: Modes

    def __call__(self, q: Modes, v: Modes) -> tuple[Modes, Modes]:
        """Advance displacements and velocities."""
        return self.qq * q + self.qv * v, self.vq * q + self.vv * v


def drift(angular_frequency: Modes, damping_ratio: Modes, time: Lanes) -> Drift:
    """Compute the flow of q'' + 2 zeta w q' + w^2 q = 0 over `time`, any damping ratio."""
    w, zeta = angular_frequency, damping_ratio
    under, over = zeta < 1, zeta > 1
    spin = w * jnp.sqrt(jnp.where(under, 1 - zeta**2, 1.0))
    spread_ = w * jnp.sqrt(jnp.where(over, zeta**2 - 1, 1.0))
    decay = jnp.exp(-zeta * w * time)
    fast = jnp.exp(-(zeta * w + spread_) * time)
    slow = jnp.exp(jnp.where(over, spread_ - zeta * w, 0.0) * time)
    cosine, sine = cosine_and_sine(spin * time)
    even = jnp.where(under, decay * cosine, jnp.where(over, (slow + fast) / 2, decay))
    turning = decay * sine / spin
    sinh = (slow - fast) / (2 * spread_)
    odd = jnp.where(under, turning, jnp.where(over, sinh, decay * time))
    return Drift(even + zeta * w * odd, odd, -(w**2) * odd, even - zeta * w * odd)


def check_uncoupled(equations: LinearEquations) -> None:
    """Raise `ValueError` unless every mode moves alone, about 0: they drift one by one."""
    if not equations.is_modal:
        raise ValueError(
            "ExponentialSplitting needs modes that neither damping nor internal states couple, of "
            "a body that is held, without a constant force. Use ExactContact(), "
            "LinearlyImplicit() or a diffrax solver."
        )


def steady(
    equations: LinearEquations, amplitude: Complex[Array, "*#lanes"], angular_frequency: Lanes
) -> tuple[Complex[Array, "states *#lanes"], Complex[Array, "modes *#lanes"]]:
    """Complex amplitude of the state in the steady response without stops.

    Modes in resonance have none here; the second result is their input, to be integrated
    (`driven_drift`), 0 elsewhere. Raises `ValueError` when the damping couples the modes.
    """
    check_uncoupled(equations)
    omega, lanes = angular_frequency, angular_frequency.ndim
    w = spread(equations.angular_frequency, 1, lanes)
    zeta = spread(equations.damping_ratio, 1, lanes)
    dynamic = w**2 - omega**2 + 2j * zeta * w * omega
    push = spread(equations.input_map, 1, lanes) * amplitude
    resonant = is_resonant(dynamic, omega)
    q = jnp.where(resonant, 0.0, push / jnp.where(resonant, 1.0, dynamic))
    still = jnp.zeros((equations.memory_size, *q.shape[1:]), q.dtype)
    return jnp.concatenate([q, 1j * omega * q, still]), jnp.where(resonant, push, 0.0)


def driven_drift(
    equations: LinearEquations,
    driven: Complex[Array, "modes *#lanes"],
    angular_frequency: Lanes,
    time: Lanes,
) -> Complex[Array, "2 modes *#lanes"]:
    """Complex amplitudes of what modes in resonance gain in q and q' over a time.

    With them the gain is Im(amplitude exp(i phase)), by the drive phase at which the time begins.
    """
    lanes = angular_frequency.ndim
    w = spread(equations.angular_frequency, 1, lanes)
    zeta = jnp.minimum(spread(equations.damping_ratio, 1, lanes), 0.5)
    # The rows of a block are (q' + zeta w q) / spin and q; modes in resonance are lightly damped.
    spin = w * jnp.sqrt(1 - zeta**2)
    decay, rate, first = jnp.broadcast_arrays(-zeta * w, spin, driven / spin)

    def gain(angle):
        rows = jnp.concatenate([first, jnp.zeros_like(first)])
        added = driven_growth(decay, rate, rows, angle, angular_frequency, time)
        z, q = jnp.split(added, 2)
        return jnp.stack([q, rate * z + decay * q])

    return gain(np.pi / 2) + 1j * gain(0.0)


def driven_flow(
    equations: LinearEquations,
    driven: Complex[Array, " modes"],
    angular_frequency: Scalar,
    time: Scalar,
) -> Callable[..., Float[Array, "2 modes"]]:
    """Return the flow of (q, q') of one lane over a time, from a drive phase.

    About the steady response; modes in resonance are driven by their input as of `steady`.
    """
    free = drift(equations.angular_frequency, equations.damping_ratio, time)
    gained = driven_drift(equations, driven, angular_frequency, time)

    def flow(q, v, angle):
        return jnp.stack(free(q, v)) + gained.real * jnp.sin(angle) + gained.imag * jnp.cos(angle)

    return flow


class Contact(NamedTuple):
    """The stops as a kick sees them."""

    stops: tuple[Stop, ...]
    towards: Float[Array, "stops modes *#lanes"]
    push: Float[Array, "modes stops *#lanes"]
    mobility: Float[Array, "stops stops *#lanes"]
    gap: PerStop


def contact_of(equations: LinearEquations, lanes: int) -> Contact:
    """Gather what the kick needs; numbers shared by all lanes get as many trailing axes."""
    towards, push = equations.stop_map, equations.force_map
    gaps = [jnp.asarray(stop.gap, float) for stop in equations.stops]
    return Contact(
        stops=equations.stops,
        towards=towards,
        push=push,
        mobility=spread(jnp.einsum("sm...,mt...->st...", towards, push), 2, lanes),
        gap=spread(jnp.stack(gaps), 1, lanes) if gaps else jnp.zeros((0,) + (1,) * lanes),
    )


def _apply(matrix, vector):
    matrix = spread(matrix, 2, vector.ndim - 1)
    return jnp.sum(matrix * vector[None], axis=1)


def kick(
    contact: Contact, depth: PerStop, rate: PerStop, memory: Memories, step: Lanes
) -> tuple[PerStop, Memories]:
    """Impulse of each stop in a step, and the memories after it.

    Rate and memories are taken in the middle of the kick. For a linear dashpot, and for a memory
    that relaxes linearly, that is a linear equation: stable for any damping or relaxation time.
    """
    middle_memory = _middle_memory(contact.stops, depth, rate, memory, step)
    force, stiffness, damping = forces_and_slopes(contact.stops, depth, rate, middle_memory)
    if len(contact.stops) == 1:
        middle = force / (1 + step / 2 * damping * contact.mobility[0])
    else:
        # Few stops, rarely touching at once: two passes of Gauss-Seidel on the implicit damping.
        middle = force
        for _ in range(2):
            others = jnp.einsum("st...,t...->s...", contact.mobility, middle)
            own = jnp.stack([contact.mobility[i, i] for i in range(len(contact.stops))])
            lag = step / 2 * damping
            middle = (force - lag * (others - own * middle)) / (1 + lag * own)
    correction = stiffness * jnp.einsum("st...,t...->s...", contact.mobility, middle)
    corrected = middle - step**2 / 12 * correction
    return step * corrected, 2 * middle_memory - memory


def _middle_memory(stops, depth, rate, memory, step):
    """Memories half a step on, the depths held: one Newton step of the implicit midpoint rule."""
    if not memory.shape[0]:
        return memory
    middle, at = [], 0
    for i, stop in enumerate(stops):
        size = stop.memory_size
        if not size:
            continue
        here = slice(i, i + 1)
        rates = partial(memory_rates, (stop,), depth[here], rate[here])
        held = memory[at : at + size]
        speed, change = jax.linearize(rates, held)
        units = jnp.eye(size, dtype=held.dtype).reshape(size, size, *(1,) * (held.ndim - 1))
        slope = jnp.stack([change(jnp.broadcast_to(u, held.shape)) for u in units], axis=1)
        middle.append(held + solve_small(-step / 2 * slope, step / 2 * speed))
        at += size
    return jnp.concatenate([*middle, memory[at:] / 2])  # what idles is gone after a step


def contact_rate(equations: LinearEquations) -> Lanes:
    """Angular frequency of the contact points on their stops, rad/s: sets the step."""
    rates = [jnp.zeros_like(equations.angular_frequency[0])]
    for i, stop in enumerate(equations.stops):
        mobility = jnp.sum(equations.stop_map[i] * equations.force_map[:, i], axis=0)
        rates.append(jnp.sqrt(jnp.maximum(contact_slope(stop) * mobility, 0.0)))
    return jnp.max(jnp.stack(jnp.broadcast_arrays(*rates)), axis=0)


def steps_for(
    equations: LinearEquations, angular_frequency: Lanes, tolerance: Lanes
) -> Int[Array, ""]:
    """Steps per drive period for an error near the tolerance (measured: see benchmarks)."""
    rate = jnp.maximum(contact_rate(equations), equations.angular_frequency[0])
    per_radian = 8.0 * jnp.sqrt(1e-3 / jnp.min(tolerance))
    longest = jnp.max(rate / angular_frequency) * 2 * np.pi * per_radian
    return jnp.ceil(jnp.maximum(longest, 64.0)).astype(jnp.int32)


steps_of = compiled(steps_for)
"""The same, as a program of its own."""


def march(
    equations: LinearEquations,
    amplitude: Complex[Array, "*#lanes"],
    angular_frequency: Lanes,
    state: Float[Array, "states *#lanes"],
    periods: Int[Array, "*#lanes"],
    steps: Int[Array, ""],
    *,
    observe: bool = False,
) -> tuple[Float[Array, "states *#lanes"], Int[Array, "*#lanes"], Measures | None]:
    """March every lane over its number of drive periods in `steps` equal steps a period.

    The drifts of neighbouring steps are one. Returns the states, steps, and the measures.
    """
    lanes = angular_frequency.ndim
    contact = contact_of(equations, lanes)
    modes = equations.angular_frequency.shape[0]
    w = spread(equations.angular_frequency, 1, lanes)
    zeta = spread(equations.damping_ratio, 1, lanes)
    tip = spread(equations.response_map, 1, lanes)
    h = 2 * jnp.pi / angular_frequency / steps
    whole, half, back = drift(w, zeta, h), drift(w, zeta, h / 2), drift(w, zeta, -h / 2)
    forced, driven = steady(equations, amplitude, angular_frequency)
    resonant = jnp.any(driven != 0)
    gained, gained_half = (
        driven_drift(equations, driven, angular_frequency, time) for time in (h, h / 2)
    )
    seen = _apply(contact.towards, forced[:modes])
    seen_rate = 1j * angular_frequency * seen
    tip_forced = jnp.sum(tip * forced[:modes], axis=0)
    turn = angular_frequency * h
    spin = jnp.cos(turn), jnp.sin(turn)

    def real(value, wave):
        return value.real * wave[0] + value.imag * wave[1]

    def pushed(moved, gain, wave):
        q, v = moved
        return where_needed(
            resonant, lambda: (q + real(gain[0], wave), v + real(gain[1], wave)), (q, v)
        )

    def depth_of(q, v, wave):
        depth = _apply(contact.towards, q) + real(seen, wave) - contact.gap
        return depth, _apply(contact.towards, v) + real(seen_rate, wave)

    def tips(q, v, wave):
        y = jnp.sum(tip * q, axis=0) + real(tip_forced, wave)
        return y, jnp.sum(tip * v, axis=0) + real(1j * angular_frequency * tip_forced, wave)

    def one(i, carry, live):
        # The carry stands in the middle of step i, just before its kick.
        q, v, memory, wave, measures = carry
        depth, rate = depth_of(q, v, wave)
        if contact.stops:
            impulse, memory1 = computed_once(i, lambda: kick(contact, depth, rate, memory, h))
            kicked = v - _apply(contact.push, impulse)
        else:
            kicked, memory1 = v, memory
        q1, v1 = pushed(whole(q, kicked), gained, wave)
        wave1 = jnp.stack(
            [wave[0] * spin[0] + wave[1] * spin[1], wave[1] * spin[0] - wave[0] * spin[1]]
        )
        if measures is not None:
            (y0, s0), (y1, s1) = tips(q, kicked, wave), tips(q1, v1, wave1)
            entered = jnp.zeros(live.shape, jnp.int32)
            force, touches = jnp.zeros_like(y0), jnp.zeros(live.shape, bool)
            if contact.stops:
                depth1, rate1 = depth_of(q1, v1, wave1)
                f0, k0, _ = forces_and_slopes(contact.stops, depth, rate, memory)
                f1, k1, _ = forces_and_slopes(contact.stops, depth1, rate1, memory1)
                peak = cubic_maximum(f0, k0 * rate * h, f1, k1 * rate1 * h)
                force = jnp.max(peak, axis=0)
                here = touching_stops(contact.stops, depth, f0)
                there = touching_stops(contact.stops, depth1, f1)
                touches = jnp.any(here, axis=0)
                entered = jnp.sum(~here & there, axis=0, dtype=jnp.int32)
            both, tip, speed = (wave, wave1), (y0, y1), (s0, s1)
            part = Segment(h, both, angular_frequency, tip, speed, force, touches, entered)
            measures = measures.add(part, live)
        return q1, v1, memory1, wave1, measures

    def period(carry):
        x, done, measures = carry
        live = done < periods
        zero, unit = jnp.zeros_like(h), jnp.ones_like(h)
        q, v, memory = equations.split(x - real(forced, (zero, unit)))
        q, v = pushed(half(q, v), gained_half, (zero, unit))
        start = jnp.stack([jnp.sin(turn / 2), jnp.cos(turn / 2)])
        begin = q, v, memory, start, measures
        q, v, memory, _, measures = lax.fori_loop(0, steps, lambda i, c: one(i, c, live), begin)
        # Half a step back: what the drive gave in it is taken off first.
        q, v = pushed((q, v), -gained_half, (zero, unit))
        x1 = jnp.concatenate([*back(q, v), memory]) + real(forced, (zero, unit))
        return jnp.where(live, x1, x), done + live, measures

    zero = jnp.zeros(angular_frequency.shape, jnp.int32)
    first = no_measures(jnp.zeros_like(angular_frequency)) if observe else None
    periods = jnp.broadcast_to(jnp.asarray(periods, jnp.int32), zero.shape)
    start = (jnp.broadcast_to(state, (equations.state_size, *zero.shape)), zero, first)
    end, done, measures = lax.while_loop(lambda c: jnp.any(c[1] < periods), period, start)
    return end, done * steps, measures
