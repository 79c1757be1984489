"""Time histories of one lane."""

import math
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import (
    check_choice,
    check_count,
    check_one,
    check_one_number,
    check_positive,
    concrete,
)
from vibrojax._tools.signatures import validated
from vibrojax.history.history import History
from vibrojax.model.drives import AbstractWaveform, Harmonic
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem, Motion, as_arrays, check_is_system, equations_of
from vibrojax.stepping.choice import choose_method, prepare_motion
from vibrojax.stepping.method import AbstractMethod, ExactContact

MOST_SAMPLES = 100_000_000
ATTEMPTS = 256
"""Most attempts per step that reverse mode keeps; those not made cost nothing."""


@validated(traceable=True)
def motion(
    system: AbstractSystem,
    *,
    frequency: ArrayLike | None = None,
    frequency_ratio: ArrayLike | None = None,
    waveform: AbstractWaveform | None = None,
) -> Motion:
    """Put the equations of a system and its drive in time together: the `args` of the solvers.

    Give at most one of `frequency` (Hz), `frequency_ratio` (to the first natural frequency of the
    unstopped system) and `waveform` (`Harmonic`, `Chirp`). Raises `ValueError` for more than one.
    """
    check_one("frequency", frequency, "Hz")
    check_one("frequency_ratio", frequency_ratio, "ratio")
    given = [x for x in (frequency, frequency_ratio, waveform) if x is not None]
    if len(given) > 1:
        raise ValueError("Give one of frequency, frequency_ratio and waveform, not several.")
    equations = equations_of(as_arrays(system))
    if waveform is None:
        if frequency is None:
            if equations.linear_between_contacts is None:
                raise ValueError(
                    "This system has no natural frequency: give frequency in Hz, which sets the "
                    "steps where nothing drives."
                )
            natural = equations.linear_between_contacts.angular_frequency[0] / (2 * jnp.pi)
            # Without a drive the first natural frequency only serves as a clock.
            frequency = natural * (1.0 if frequency_ratio is None else frequency_ratio)
        waveform = Harmonic(jnp.asarray(frequency))
    drive, waveform = as_arrays(system.drive), as_arrays(waveform)
    return Motion(equations, drive, waveform, prepare_motion(system, equations))


@validated(traceable=True)
def simulate(
    system: AbstractSystem,
    *,
    frequency: ArrayLike | None = None,
    frequency_ratio: ArrayLike | None = None,
    waveform: AbstractWaveform | None = None,
    periods: float | int | None = None,
    duration: ArrayLike | None = None,
    samples_per_period: int = 128,
    samples: int | None = None,
    sampling_rate: float | int | None = None,
    initial_state: Any = None,
    release: ArrayLike | None = None,
    solver: diffrax.AbstractSolver[Any] | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController[Any, Any] | None = None,
    tolerance: float = 1e-6,
    gradient: str = "reverse",
    max_steps: int | None = None,
) -> History:
    """Integrate the motion and return its time history at equal intervals.

    Parameters:
        system: what moves.
        frequency, frequency_ratio, waveform: the drive in time, one of them (Hz; ratio to the
            first natural frequency; `Harmonic` or `Chirp`). None for a system without a drive.
        periods: how long, in drive periods (of the first mode where nothing drives).
        duration: how long, s, instead of periods.
        samples_per_period: samples per such period.
        samples: number of intervals over the whole time, instead.
        sampling_rate: samples per second (Hz), instead: at least twice the highest natural
            frequency of the model, as an analyser would have to sample it.
        initial_state: at drive phase 0: what `system.state(displacement=..., velocity=...)` makes
            of displacements, one of `history.states`, or a state itself, as one array (states,) or
            as (q, q') and the memories of stops that are not at rest. Of a beam and of matrices q
            (m) and q' (m/s) are coordinates of their modes. At rest by default.
        release: instead, let the beam go from the static deflection with this tip displacement, m.
        solver: any diffrax solver. By default `ExactContact` where the stops are linear in
            contact, else `ExponentialSplitting`, or `LinearlyImplicit` for a system that is not
            linear; these take equal steps, others a PID controller.
        stepsize_controller: for other solvers; by default `PIDController(tolerance, tolerance)`
            with steps of at most a fortieth of a period, lest a contact be stepped over.
        tolerance: relative error to aim at.
        gradient: `reverse` (`jax.grad`, `jax.vjp`) or `forward` (`jax.jvp`, `jax.jacfwd`): which
            derivative will be taken through the history. Values are the same.
        max_steps: limit of diffrax on the number of steps.

    Raises `ValueError` for settings that contradict each other or cannot work, or a release that
    starts inside a stop. The history has a `status`; a solver that fails is flagged there.
    """
    task = task_of(
        system,
        frequency=frequency,
        frequency_ratio=frequency_ratio,
        waveform=waveform,
        periods=periods,
        duration=duration,
        samples_per_period=samples_per_period,
        samples=samples,
        sampling_rate=sampling_rate,
        initial_state=initial_state,
        release=release,
        solver=solver,
        stepsize_controller=stepsize_controller,
        tolerance=tolerance,
        gradient=gradient,
        max_steps=max_steps,
    )
    return solve(task)


class Task(NamedTuple):
    """All that the integration of one lane needs."""

    system: AbstractSystem
    run: Motion
    solver: diffrax.AbstractSolver[Any]
    controller: diffrax.AbstractStepSizeController[Any, Any]
    adjoint: diffrax.AbstractAdjoint
    times: Float[Array, " samples"]
    state: Float[Array, " states"]
    parts: int | None
    """Equal steps in a sample interval; None where the controller chooses."""
    max_steps: int | None


def task_of(
    system: AbstractSystem,
    *,
    frequency: ArrayLike | None,
    frequency_ratio: ArrayLike | None,
    waveform: AbstractWaveform | None,
    periods: float | int | None,
    duration: ArrayLike | None,
    samples_per_period: int,
    samples: int | None,
    sampling_rate: float | int | None,
    initial_state: Any,
    release: ArrayLike | None,
    solver: diffrax.AbstractSolver[Any] | None,
    stepsize_controller: diffrax.AbstractStepSizeController[Any, Any] | None,
    tolerance: float,
    gradient: str,
    max_steps: int | None,
) -> Task:
    """Check what `simulate` was asked and get it ready. Raises `ValueError` as it says."""
    check_is_system(system)
    check_choice("gradient", gradient, ("reverse", "forward"))
    if max_steps is not None:
        check_count("max_steps", max_steps)
    _check_waveform(system, frequency, frequency_ratio, waveform)
    if sampling_rate is not None:
        check_positive("sampling_rate", sampling_rate, "Hz")
        if samples is not None:
            raise ValueError("Give samples or sampling_rate (Hz), not both.")
    run = motion(system, frequency=frequency, frequency_ratio=frequency_ratio, waveform=waveform)
    _, rate, _ = run.waveform.phase(jnp.zeros(()))
    period = 2 * jnp.pi / rate
    if sampling_rate is not None:
        _check_sampling(sampling_rate, run)
    length, per_period, intervals = _grid(
        period, periods, duration, samples_per_period, samples, sampling_rate
    )
    times = length * jnp.linspace(0.0, 1.0, intervals + 1)
    state = _initial_state(system, run, initial_state, release)
    method = solver if isinstance(solver, AbstractMethod) else None
    if solver is None or method is not None:
        solver = choose_method(system, method, tolerance, None)
    if isinstance(solver, AbstractMethod):
        if isinstance(solver, ExactContact):
            most = (solver.max_attempts or ATTEMPTS) if gradient == "reverse" else None
            solver = ExactContact(solver.tolerance, solver.steps_per_period, most)
        parts = math.ceil(solver.steps(run) / per_period)
        controller: diffrax.AbstractStepSizeController[Any, Any] = diffrax.ConstantStepSize()
    else:
        parts, size = None, jnp.max(jnp.abs(state)) + _static_size(system, run)
        controller = stepsize_controller or diffrax.PIDController(
            rtol=tolerance, atol=1e-3 * tolerance * size, dtmax=period / 40
        )
    adjoint = (
        diffrax.RecursiveCheckpointAdjoint() if gradient == "reverse" else diffrax.ForwardMode()
    )
    return Task(as_arrays(system), run, solver, controller, adjoint, times, state, parts, max_steps)


def _grid(period, periods, duration, samples_per_period, samples, sampling_rate):
    """Return the length of the run (s), samples per period and the number of intervals."""
    if (periods is None) == (duration is None):
        raise ValueError("Give periods or duration (s), one of the two.")
    check_count("samples_per_period", samples_per_period, least=2)
    if samples is not None:
        check_count("samples", samples)
    if periods is not None:
        check_positive("periods", periods, "(drive periods)")
        length, count = periods * period, periods
    else:
        check_one_number("duration", duration, "s", "Use simulate_each for several motions.")
        length, count = jnp.asarray(duration, float), concrete(duration / period)
    if sampling_rate is not None:
        seconds = concrete(length)
        samples = None if seconds is None else max(1, round(float(seconds) * sampling_rate))
    if count is None or (samples is None and sampling_rate is not None):
        raise ValueError(
            "How many samples the run has depends on values that JAX is tracing: give periods, and "
            "samples_per_period or samples, in place of duration or sampling_rate."
        )
    if samples is None:
        # A duration is covered to its end; a number of periods has its samples exactly.
        samples = count * samples_per_period
        samples = math.ceil(samples) if periods is None else max(1, round(samples))
    if samples > MOST_SAMPLES:
        length_name = "duration" if periods is None else "periods"
        raise ValueError(
            f"{length_name} and samples_per_period, samples or sampling_rate ask for "
            f"{samples:.3g} samples; at most {MOST_SAMPLES:,} fit into a memory. Ask for fewer."
        )
    return length, samples / float(count), samples


def _check_sampling(sampling_rate, run):
    """Refuse a sampling rate (Hz) that cannot show the highest mode."""
    linear = run.equations.linear_between_contacts
    if linear is None:
        return
    highest = concrete(jnp.max(linear.angular_frequency) / (2 * jnp.pi))
    if highest is not None and sampling_rate < 2 * highest:
        raise ValueError(
            f"sampling_rate must be at least twice the highest natural frequency of the model, "
            f"2 x {float(highest):.6g} Hz, got {sampling_rate!r} Hz. Sample faster, or keep fewer "
            "modes."
        )


def _initial_state(system, run, initial_state, release):
    if initial_state is not None and release is not None:
        raise ValueError("Give initial_state or release, not both.")
    if release is not None:
        check_one("release", release, "m", "Use simulate_each for several.")
        q = system.static_shape(release)
        depth = concrete(run.equations.penetration(q))
        if depth is not None and (depth > 0).any():
            raise ValueError(
                f"release = {release!r} m starts {depth.max():.3g} m inside a stop. Release the "
                "beam from the other side, or from less."
            )
        return jnp.concatenate([q, jnp.zeros(run.equations.state_size - q.size)])
    if initial_state is None:
        return jnp.zeros(run.equations.state_size)
    return as_state("initial_state", initial_state, run.equations)


def _static_size(system, run):
    """A size of the state for absolute tolerances: the drive's quasi-static response."""
    _, rate, second = run.waveform.phase(jnp.zeros(()))
    drive = jnp.abs(system.drive.complex_amplitude(rate, second))
    return drive * jnp.max(jnp.abs(run.equations.input(jnp.zeros(run.equations.size)))) / rate**2


@eqx.filter_jit
def solve(task: Task) -> History:
    """Integrate one lane."""
    step, limit = None, 1_000_000
    if task.parts is not None:
        steps = (len(task.times) - 1) * task.parts
        step, limit = (task.times[-1] - task.times[0]) / steps, steps + 16
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(task.run.vector_field),
        task.solver,
        t0=task.times[0],
        t1=task.times[-1],
        dt0=step,
        y0=task.state,
        args=task.run,
        saveat=diffrax.SaveAt(ts=task.times),
        stepsize_controller=task.controller,
        adjoint=task.adjoint,
        max_steps=task.max_steps or limit,
        throw=False,
    )
    states = jnp.asarray(solution.ys)
    return History.of(task.system, task.run, task.times, states, solution.result)


def _check_waveform(system, frequency, frequency_ratio, waveform) -> None:
    for name, value in (("frequency", frequency), ("frequency_ratio", frequency_ratio)):
        if value is not None:
            advice = "Use simulate_each for several."
            check_one_number(name, value, "Hz" if name == "frequency" else "ratio", advice)
    _, unit = system.drive.reference
    if unit != "m" and frequency is None and frequency_ratio is None and waveform is None:
        raise ValueError(
            "The system has a drive: give frequency (Hz), frequency_ratio or waveform."
        )
