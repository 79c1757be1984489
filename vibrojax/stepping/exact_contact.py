"""Marching through linear contact without error of integration.

Flight and contact are both linear (`contact_phases`), so a lane flies on exact propagators and the
only approximation is where it changes phase. Each lane tries a step of its own length. When the
cubic through the depths of a stop at both ends crosses zero, the step is tried again up to the
crossing; once the depth there is within `event_tolerance`, a Newton correction lands on the
crossing and the state goes over to the block coordinates of the new phase. The correction is what
carries the derivative of the crossing time, so forward-mode derivatives are those of the
non-smooth motion, saltation included.

Every array has the lanes as trailing axes, for speed only (XLA then vectorises over lanes): with
no such axes it is the code of one lane.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax.stepping.contact_loop import ContactLoop, leave, run
from vibrojax.stepping.contact_phases import ContactPhases, spread
from vibrojax.stepping.forcing import Forcing, forcing, longest_step
from vibrojax.stepping.measures import Measures
from vibrojax.systems.base import Motion


def march(
    phases: ContactPhases,
    force: Forcing,
    state: Float[Array, "states *#lanes"],
    periods: int | Int[Array, "*#lanes"] = 1,
    *,
    observe: bool = False,
) -> tuple[Float[Array, "states *#lanes"], Int[Array, "*#lanes"], Measures | None]:
    """March every lane over its number of drive periods, each at its own pace.

    Returns the states (q, q'), the attempts made, and the measures where `observe` asks for them.
    A lane that takes more than `RETRIES` attempts for every step of the grid is left where it is,
    with fewer periods behind it, and its state is NaN: the caller flags it.
    """
    loop = ContactLoop(phases, force, observe)
    target = jnp.broadcast_to(jnp.asarray(periods, jnp.int32), loop.period.shape)
    flight = run(loop, state, loop.period, target, None)
    end = leave(loop, flight, flight.time)
    end = jnp.where(flight.finished >= target, end, jnp.nan)
    return end, flight.attempts, flight.measures


def step_from(
    phases: ContactPhases,
    motion: Motion,
    state: Float[Array, " states"],
    start: Float[Array, ""],
    duration: Float[Array, ""],
    tolerance: Float[ArrayLike, ""],
    max_attempts: int | None,
) -> Float[Array, " states"]:
    """Advance one lane from a time (s) over a duration, for any waveform.

    Harmonic drives are exact; of a chirp the step takes the frequency and amplitude of its middle.
    With `max_attempts` the loop has that fixed length, which reverse mode can differentiate; else
    `vmap` runs the lanes in one loop with the layout of `march`. The state is NaN if the attempts
    did not suffice.
    """
    numbers = phases, motion.drive, motion.waveform, state, start, duration, tolerance
    numbers = jax.tree.map(lambda a: jnp.asarray(a, float), numbers)
    if max_attempts is None:
        return _step(*numbers)
    return _step_lanes(*numbers, max_attempts=max_attempts)


def _step_lanes(
    phases, drive, waveform, state, start, duration, tolerance, *, max_attempts=None, lanes=()
):
    phase, _, _ = waveform.phase(start)
    _, rate, second = waveform.phase(start + duration / 2)
    start_phase = phase - 2 * jnp.pi * jnp.round(phase / (2 * jnp.pi))
    amplitude = drive.complex_amplitude(rate, second)
    amplitude, rate, start_phase, duration = (
        jnp.broadcast_to(a, lanes) for a in (amplitude, rate, start_phase, duration)
    )
    state = jnp.broadcast_to(spread(state, 1, len(lanes)), (state.shape[0], *lanes))
    step = jnp.minimum(longest_step(phases, rate, tolerance, None), duration)
    force = forcing(phases, amplitude, rate, start_phase, step, tolerance / 2)
    loop = ContactLoop(phases, force, observe=False)
    flight = run(loop, state, duration, jnp.ones(lanes, jnp.int32), max_attempts)
    return jnp.where(flight.finished > 0, leave(loop, flight, duration), jnp.nan)


@jax.custom_batching.custom_vmap
def _step_any_lanes(*numbers):
    return _step_lanes(*numbers)


@_step_any_lanes.def_vmap
def _step_batched(axis_size, in_batched, *numbers):
    # Lanes go last, as the loop wants them: `vmap` itself would put them first, ten times slower.
    lanes_last = jax.tree.map(
        lambda is_batched, a: jnp.moveaxis(a, 0, -1) if is_batched else a,
        tuple(in_batched),
        numbers,
    )
    return jnp.moveaxis(_step_lanes(*lanes_last, lanes=(axis_size,)), -1, 0), True


@jax.custom_jvp
def _step(*numbers):
    return _step_any_lanes(*numbers)


@_step.defjvp
def _step_jvp(numbers, changes):
    # A rule for vmap cannot be differentiated under another vmap: derivatives go without it.
    return jax.jvp(_step_lanes, numbers, changes)
