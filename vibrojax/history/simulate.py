"""Time histories of one motion, or of several in one loop."""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, overload

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import (
    axis_of,
    check_choice,
    check_count,
    check_one,
    check_positive,
    concrete,
)
from vibrojax._tools.compiled import compiled
from vibrojax._tools.kinds import is_list
from vibrojax._tools.programs import rounded_up
from vibrojax._tools.signatures import check_not_traced, check_one_lane, validated
from vibrojax.ensemble.arguments import Zipped, arguments_of
from vibrojax.ensemble.lanes import check_no_numbers, lanes_of
from vibrojax.history.histories import Histories
from vibrojax.history.history import History, history_of
from vibrojax.history.sample_grid import longest_step, parts_under_signal, sample_grid
from vibrojax.model.drives import AbstractWaveform, Harmonic
from vibrojax.model.signals import Tones
from vibrojax.model.states import as_state
from vibrojax.model.systems import (
    AbstractSystem,
    Motion,
    as_arrays,
    check_made,
    equations_of,
)
from vibrojax.stepping.choice import choose_stepper, prepare_motion
from vibrojax.stepping.signal_grid import SignalGrid, march_on_grid
from vibrojax.stepping.stepper import AbstractStepper, ExactContact

MOST_STEPS = 1_000_000
"""Steps of a solver that chooses them, unless `max_steps` says otherwise."""
MANY = 2**16
"""Samples above which there are four programs from one power of two to the next; else one."""
SAMPLED = ("time", "coordinates", "rates", "accelerations", "contact_force", "memory")
"""What a history has for every sample."""
ATTEMPTS = 256
"""Most rounds per step that reverse mode keeps; those not made cost nothing."""
One = float | int | Array | np.number[Any] | None
"""One number, or none: what is no list."""


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
    unstopped system) and `waveform` (`Harmonic`, `Chirp`, `Tones`, `Sampled`). Raises `ValueError`
    for more than one.
    """
    check_one("frequency", frequency, "Hz")
    check_one("frequency_ratio", frequency_ratio, "ratio")
    given = [x for x in (frequency, frequency_ratio, waveform) if x is not None]
    if len(given) > 1:
        raise ValueError("Give one of frequency, frequency_ratio and waveform, not several.")
    equations = equations_of(as_arrays(system))
    linear = equations.linear_between_contacts
    if waveform is None and frequency is None:
        if linear is None:
            raise ValueError(
                "This system has no natural frequency: give frequency in Hz, which sets the "
                "steps where nothing drives."
            )
        # Without a drive the first natural frequency only serves as a clock.
        ratio = 1.0 if frequency_ratio is None else frequency_ratio
        frequency = equations.first_frequency / (2 * jnp.pi) * ratio
    with jax.ensure_compile_time_eval():  # known numbers stay known inside of jit
        if waveform is None:
            waveform = Harmonic(jnp.asarray(frequency))
        if linear is not None and linear.free and isinstance(waveform, Harmonic):
            # The march under signals needs no natural frequencies.
            waveform = Tones(jnp.asarray(waveform.frequency)[None])
        drive, waveform = as_arrays(system.drive), as_arrays(waveform)
    return Motion(equations, drive, waveform, prepare_motion(system, equations))


@overload
def simulate(
    system: AbstractSystem,
    *,
    frequency: One = None,
    frequency_ratio: One = None,
    release: One = None,
    initial_states: None = None,
    **settings: Any,
) -> History: ...


@overload
def simulate(
    system: AbstractSystem | Callable[..., AbstractSystem], *zipped: Zipped, **arguments: Any
) -> Histories | Any: ...


@validated(traceable=True)
def simulate(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency: ArrayLike | Sequence[float] | None = None,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    waveform: AbstractWaveform | None = None,
    release: ArrayLike | Sequence[float] | None = None,
    initial_state: Any = None,
    initial_states: ArrayLike | Sequence[Any] | None = None,
    periods: float | int | None = None,
    duration: ArrayLike | None = None,
    samples_per_period: int = 128,
    samples: int | None = None,
    sampling_rate: float | int | None = None,
    stepper: diffrax.AbstractSolver[Any] | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController[Any, Any] | None = None,
    tolerance: float = 1e-6,
    gradient: str = "reverse",
    max_steps: int | None = None,
    **numbers: Any,
) -> Any:
    """Integrate the motion and return its history at equal intervals; of a list, all histories.

        history = vj.simulate(vj.default_rig(), frequency_ratio=1.1, periods=40)
        histories = vj.simulate(rig, force=[2.0, 6.0, 12.0], frequency=16.0, duration=10.0)
        histories.at(force=6.0).contacts()

    Without a list the result is a `History`, which JAX can trace and differentiate. Any list makes
    it `Histories`, one for every combination, integrated in one loop that is compiled once.

    Parameters:
        system: what moves, or a function that makes it from named numbers.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency, frequency_ratio, waveform: the drive in time, one of them (Hz; ratio to the
            first natural frequency; `Harmonic`, `Chirp`, `Tones` or `Sampled`), the first two one
            number, or a list as an axis. None for a system without a drive.
        release: let the beam go from the static deflection with this tip displacement, m; or a
            list as an axis.
        initial_state: instead, at drive phase 0: what `system.state(displacement=...,
            velocity=...)` makes of displacements, one of `history.states`, or a state itself, as
            one array (states,) or as (q, q') and the memories of stops that are not at rest. Of a
            beam and of matrices q (m) and q' (m/s) are coordinates of their modes. At rest by
            default.
        initial_states: a list of such states: the axis `start`, counted from 1.
        periods: how long, in drive periods (of the first mode where nothing drives).
        duration: how long, s, instead of periods; under a `Sampled` its whole record by default.
        samples_per_period: samples per such period; of the fastest of `Tones`. A `Sampled` has the
            samples of its record.
        samples: number of intervals over the whole time, instead.
        sampling_rate: samples per second (Hz), instead: at least twice the highest natural
            frequency of the model, as an analyser would have to sample it.
        stepper: any diffrax solver. By default `ExactContact` where the stops are linear in
            contact, else `ExponentialSplitting`, or `LinearlyImplicit` for a system that is not
            linear; these take equal steps, others a PID controller.
        stepsize_controller: for other solvers; by default `PIDController(tolerance, tolerance)`
            with steps of at most a fortieth of a period, lest a contact be stepped over.
        tolerance: relative error to aim at.
        gradient: `reverse` (`jax.grad`, `jax.vjp`) or `forward` (`jax.jvp`, `jax.jacfwd`): which
            derivative will be taken through the history. Values are the same.
        max_steps: limit of diffrax on the number of steps.
        numbers: arguments of the function; a list is an axis, axes are crossed.

    Raises `ValueError` for settings that contradict each other or cannot work, a release that
    starts inside a stop, or histories of different lengths, before anything is integrated. A
    history has a `status`; a stepper that fails is flagged there.
    """
    check_choice("gradient", gradient, ("reverse", "forward"))
    if max_steps is not None:
        check_count("max_steps", max_steps)
    numbered: dict[str, Any] = {
        "frequency": frequency,
        "frequency_ratio": frequency_ratio,
        "release": release,
    }
    axes = {name: axis_of(name, value) for name, value in numbered.items() if is_list(value)}
    starts = _starts(initial_state, initial_states, release, numbers)
    if initial_states is not None:
        axes["start"] = np.arange(1, len(starts) + 1)
    numbered["start"] = 1
    grid = periods, duration, samples_per_period, samples, sampling_rate

    def task(one: AbstractSystem, values: dict[str, Any], gradient: str) -> Task:
        start, release = starts[values.pop("start") - 1], values.pop("release")
        drive = values | {"waveform": waveform}
        stepping = stepper, stepsize_controller, tolerance, gradient, max_steps
        return _task(one, drive, release, start, grid, stepping)

    if not (axes or zipped or any(isinstance(n, Zipped) or is_list(n) for n in numbers.values())):
        return _solved(solve, task(_made(system, numbers), numbered, gradient))
    check_not_traced("simulate over lists", "system", system)
    lanes = lanes_of(system, numbers, zipped)
    tasks = [
        task(
            jax.tree.map(lambda a, k=k: a[k], lanes.systems),
            numbered | dict(zip(axes, row, strict=True)),
            "forward",
        )
        for k in range(math.prod(lanes.shape))
        for row in itertools.product(*axes.values())
    ]
    return Histories(lanes.axes | axes, _solved(_solve_all, _stacked(tasks)))


def _starts(one: Any, several: Any, release: Any, numbers: dict[str, Any]) -> list[Any]:
    """Return the states to start from, a single None for rest."""
    given = {"initial_state": one, "initial_states": several, "release": release}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise ValueError(f"Give {' or '.join(names)}, not both.")
    if several is None:
        return [one]
    if "start" in numbers:
        raise ValueError("initial_states are the axis `start`: rename that of the function.")
    if not is_list(several) or not len(several):
        raise ValueError(f"initial_states must be a list of (q, q'), got {several!r}.")
    return list(several)


def _made(
    system: AbstractSystem | Callable[..., AbstractSystem], numbers: dict[str, Any]
) -> AbstractSystem:
    """Return the system of numbers that JAX may be tracing."""
    if isinstance(system, AbstractSystem):
        check_no_numbers(numbers, ())
        return system
    made = system(**arguments_of(system, (), numbers).fixed)
    if not isinstance(made, AbstractSystem):
        check_made(system, made)
    check_one_lane("system", made)
    return made


class Task(NamedTuple):
    """All that the integration of one lane needs."""

    system: AbstractSystem
    run: Motion
    stepper: diffrax.AbstractSolver[Any]
    controller: diffrax.AbstractStepSizeController[Any, Any]
    adjoint: diffrax.AbstractAdjoint
    times: Float[Array, " samples"]
    state: Float[Array, " states"]
    step: Float[Array, ""] | None
    """Length of all steps, s; None where the controller chooses."""
    max_steps: int
    signal: SignalGrid | None
    """Knots of an exact march under a signal; None: diffrax steps."""
    reverse: bool


def _task(system, drive, release, start, grid, stepping) -> Task:
    """Check what `simulate` was asked of one motion and get it ready."""
    for name, unit in (("frequency", "Hz"), ("frequency_ratio", "ratio")):
        check_positive(name, drive[name], unit)
    if system.drive.reference[1] != "m" and all(value is None for value in drive.values()):
        raise ValueError(
            "The system has a drive: give frequency (Hz), frequency_ratio or waveform."
        )
    run = motion(system, **drive)
    sampled = sample_grid(run, *grid)
    state = _initial_state(system, run, start, release)
    stepper, controller, tolerance, gradient, max_steps = stepping
    if stepper is None or isinstance(stepper, AbstractStepper):
        stepper = choose_stepper(system, stepper, tolerance, None)
    step, most, signal = None, MOST_STEPS, None
    if isinstance(stepper, ExactContact) and sampled.signal is not None:
        signal = sampled.signal
    elif isinstance(stepper, AbstractStepper):
        if isinstance(stepper, ExactContact):
            attempts = (stepper.max_attempts or ATTEMPTS) if gradient == "reverse" else None
            stepper = ExactContact(stepper.tolerance, stepper.steps_per_period, attempts)
        parts, count = math.ceil(stepper.steps(run) / sampled.per_period), len(sampled.times)
        parts = parts_under_signal(run, sampled, parts)
        step = (sampled.times[-1] - sampled.times[0]) / ((count - 1) * parts)
        most = _roomy(count) * _roomy(parts) + 16
        controller = diffrax.ConstantStepSize()
    elif controller is None:
        drive = run.strength / run.clock**2  # quasi-static
        unit = jnp.max(jnp.abs(run.equations.input(jnp.zeros(run.equations.size))))
        atol = 1e-3 * tolerance * (jnp.max(jnp.abs(state)) + drive * unit)
        longest = longest_step(run, sampled)
        controller = diffrax.PIDController(rtol=tolerance, atol=atol, dtmax=longest)
    reverse = gradient == "reverse"
    adjoint = diffrax.RecursiveCheckpointAdjoint() if reverse else diffrax.ForwardMode()
    return Task(
        as_arrays(system),
        run,
        stepper,
        controller,
        adjoint,
        sampled.times,
        state,
        step,
        max_steps or most,
        signal,
        reverse,
    )


def _initial_state(system, run, initial_state, release):
    if release is not None:
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


def _roomy(count: int) -> int:
    """Return the next count for which there is a program."""
    return rounded_up(count, 1 if count <= MANY else 3)


def _solved(program: Callable[[Task], History], task: Task) -> History:
    """Solve a task by the program for histories of about its length."""
    if task.signal is not None:
        return program(task)
    *lanes, count = task.times.shape
    room = [(0, 0)] * len(lanes) + [(0, _roomy(count) - count)]
    history = program(task._replace(times=jnp.pad(task.times, room, mode="edge")))
    own = (slice(None),) * len(lanes) + (slice(count),)

    def sampled(history: History) -> list[Any]:
        return [getattr(history, name) for name in SAMPLED]

    return eqx.tree_at(sampled, history, [a[own] for a in sampled(history)])


@compiled
def solve(task: Task) -> History:
    """Integrate one lane."""
    if task.signal is not None:
        states = march_on_grid(task.run, task.signal, task.state, reverse=task.reverse)
        ended = diffrax.RESULTS.successful
        return history_of(task.system, task.run, task.times, states, ended)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(task.run.vector_field),
        task.stepper,
        t0=task.times[0],
        t1=task.times[-1],
        dt0=task.step,
        y0=task.state,
        args=task.run,
        saveat=diffrax.SaveAt(ts=task.times),
        stepsize_controller=task.controller,
        adjoint=task.adjoint,
        max_steps=task.max_steps,
        throw=False,
    )
    states = jnp.asarray(solution.ys)
    return history_of(task.system, task.run, task.times, states, solution.result)


@compiled
def _solve_all(tasks: Task) -> History:
    return eqx.filter_vmap(solve)(tasks)


def _stacked(tasks: list[Task]) -> Task:
    """Stack what the lanes have of their own."""
    lengths = sorted({len(task.times) for task in tasks})
    if len(lengths) > 1:
        raise ValueError(
            f"The histories would have {lengths[0]} to {lengths[-1]} samples. Give samples, or "
            "periods with samples_per_period, so that all have as many."
        )
    most = max(task.max_steps for task in tasks)
    tasks = [task._replace(max_steps=most) for task in tasks]
    return jax.tree.map(
        lambda *leaves: jnp.stack(leaves) if eqx.is_array(leaves[0]) else leaves[0], *tasks
    )
