"""Time histories of several rigs side by side."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import axis_of
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.lanes import lanes_of
from vibrojax.history.histories import Histories
from vibrojax.history.history import History
from vibrojax.history.simulate import Task, solve, task_of
from vibrojax.model.drives import AbstractWaveform
from vibrojax.model.systems import AbstractSystem


@validated
def simulate_each(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency: ArrayLike | Sequence[float] | None = None,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    release: ArrayLike | Sequence[float] | None = None,
    waveform: AbstractWaveform | None = None,
    initial_states: ArrayLike | Sequence[Any] | None = None,
    periods: float | int | None = None,
    duration: float | int | None = None,
    samples_per_period: int = 128,
    samples: int | None = None,
    sampling_rate: float | int | None = None,
    solver: diffrax.AbstractSolver[Any] | None = None,
    tolerance: float = 1e-6,
    **numbers: Any,
) -> Histories:
    """Integrate several motions in one loop, compiled once; the arguments are those of `simulate`.

        histories = vj.simulate_each(rig, force=[2.0, 6.0, 12.0], frequency=16.0, duration=10.0)
        histories.at(force=6.0).contacts()
        chirps = vj.simulate_each(
            pendulum, waveform=vj.Chirp(2.0, 9.0, 15.0), initial_states=starts, duration=15.0
        )
        chirps.cycles("bearing_angle").plot()

    Parameters:
        system: what moves, or a function that makes it from named numbers.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency, frequency_ratio, release: one number, or a list as an axis.
        waveform: the same drive in time for all, instead of a frequency.
        initial_states: a list of states, each as the `initial_state` of `simulate`: the axis
            `start`, counted from 1.
        periods, duration, samples_per_period, samples, sampling_rate: as of `simulate`.
        solver, tolerance: as of `simulate`.
        numbers: arguments of the function; a list is an axis, axes are crossed.

    Raises `ValueError` as `simulate` does for every motion, before anything is integrated, and for
    histories of different lengths.
    """
    of_call = {"frequency": frequency, "frequency_ratio": frequency_ratio, "release": release}
    given = {name: value for name, value in of_call.items() if value is not None}
    swept: dict[str, Any] = {
        name: axis_of(name, value) for name, value in given.items() if np.ndim(value) > 0
    }
    starts = list(initial_states) if np.iterable(initial_states) else []
    if initial_states is not None:
        if release is not None:
            raise ValueError("Give initial_states or release, not both.")
        if "start" in numbers:
            raise ValueError("initial_states are the axis `start`: rename that of the function.")
        if isinstance(initial_states, str) or not np.iterable(initial_states) or not starts:
            raise ValueError(f"initial_states must be a list of (q, q'), got {initial_states!r}.")
        swept["start"] = np.arange(1, len(starts) + 1)
    lanes = lanes_of(system, numbers, zipped)
    single: dict[str, Any] = {name: None for name in of_call} | given

    def task(k: int, values: tuple[Any, ...]) -> Task:
        own = single | dict(zip(swept, values, strict=True))
        start = own.pop("start", None)
        return task_of(
            jax.tree.map(lambda a: a[k], lanes.systems),
            **own,
            waveform=waveform,
            periods=periods,
            duration=duration,
            samples_per_period=samples_per_period,
            samples=samples,
            sampling_rate=sampling_rate,
            initial_state=None if start is None else starts[start - 1],
            solver=solver,
            stepsize_controller=None,
            tolerance=tolerance,
            gradient="forward",
            max_steps=None,
        )

    tasks = [
        task(k, values)
        for k in range(int(np.prod(lanes.shape)))
        for values in itertools.product(*swept.values())
    ]
    return Histories(lanes.axes | swept, _solve_all(_stacked(tasks)))


def _stacked(tasks: list[Task]) -> Task:
    """Stack what the lanes have of their own; all take the steps of the one that needs most."""
    lengths = sorted({len(task.times) for task in tasks})
    if len(lengths) > 1:
        raise ValueError(
            f"The histories would have {lengths[0]} to {lengths[-1]} samples. Give samples, or "
            "periods with samples_per_period, so that all have as many."
        )
    parts = [task.parts for task in tasks]
    most = None if parts[0] is None else max(part or 1 for part in parts)
    tasks = [task._replace(parts=most) for task in tasks]
    return jax.tree.map(
        lambda *leaves: jnp.stack(leaves) if eqx.is_array(leaves[0]) else leaves[0], *tasks
    )


@eqx.filter_jit
def _solve_all(tasks: Task) -> History:
    return eqx.filter_vmap(solve)(tasks)
