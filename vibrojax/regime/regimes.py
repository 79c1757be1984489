"""Which regime a system is in, over drive frequency, numbers of the rig and starts."""

from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from vibrojax._tools.checks import check_count, check_positive, check_range, check_seed
from vibrojax._tools.described import in_short, recipe
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.frequencies import check_drive, frequency_axis
from vibrojax.ensemble.lanes import Lanes, lanes_of
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.regime.poincare_map import PoincareMap
from vibrojax.regime.regime_points import RegimePlan, regime_plan, regime_points
from vibrojax.regime.regimes_result import Regimes
from vibrojax.stepping.choice import choose_method
from vibrojax.stepping.method import AbstractMethod, check_settings
from vibrojax.sweep.swept_lanes import rigs_of

Array = np.ndarray


@validated
def regimes(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    starts: int | ArrayLike | Sequence[Any] | None = None,
    start_size: float | None = None,
    seed: int = 0,
    transient: int = 200,
    periods: int = 200,
    max_period: int = 20,
    tolerance: float = 0.02,
    lyapunov: bool = True,
    samples_per_period: int = 64,
    barrier: float = 0.0,
    spectrum: bool = True,
    step_tolerance: float = 1e-4,
    steps_per_period: int | None = None,
    method: AbstractMethod | None = None,
    progress: bool | None = None,
    **axes: Any,
) -> Regimes:
    """Find which kind of motion a system settles to: periodic (of what order), chaotic, ...

    Every combination of the axes, the frequencies and the starts is a lane of its own. It marches
    the transient, then its states at the drive periods say of what period it is, a tangent
    carried along gives the largest Lyapunov exponent, and samples in between what the response
    and the other observables of the system do.

    Parameters:
        system: the rig, or a function from named numbers to a rig; then further keywords are its
            arguments, and lists among them are axes, crossed, which the result carries by name.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency_ratio: drive frequencies over the first linear natural frequency of the
            unstopped system, increasing, one or more.
        frequency: the same in Hz; give one of the two.
        starts: initial states at drive phase 0, each as of `simulate` (what
            `system.state(displacement=...)` makes, or a state in the coordinates of the system),
            shape (starts, states), or how many random ones; at rest by default.
        start_size: of random starts, the rms displacement of the response by their q, m; by
            default the largest clearance of the stops. States of equal energy are equally likely.
        seed: of the random starts.
        transient: drive periods marched before anything is looked at.
        periods: drive periods observed.
        max_period: longest period looked for, in drive periods.
        tolerance: relative return that makes a period, see `period_number`.
        lyapunov: whether the exponent is computed; without it a motion that has no period is
            undecided.
        samples_per_period: samples of the observables per drive period.
        barrier: displacement of the response, m, between two wells, for `cross_well`.
        spectrum: whether spectra of the displacement are kept.
        step_tolerance: relative error of the steps to aim at.
        steps_per_period: steps of the march, instead of those chosen.
        method: how to step; by default what suits the system.
        progress: show a progress bar; by default on long runs in a terminal.

    Raises `ValueError` for frequencies that are empty, not finite or not increasing, starts of the
    wrong shape, an unknown keyword, a system without a drive, or settings that cannot work.
    """
    axis, grid = frequency_axis(frequency_ratio, frequency)
    plan = regime_plan(
        transient=transient,
        periods=periods,
        max_period=max_period,
        tolerance=tolerance,
        lyapunov=lyapunov,
        samples_per_period=samples_per_period,
        barrier=barrier,
        spectrum=spectrum,
    )
    check_seed(seed)
    lanes = lanes_of(system, axes, zipped)
    chosen = regime_method(lanes.sample, axis, method, step_tolerance, steps_per_period)
    states = start_states(lanes.sample, starts, start_size, seed)
    poincare = PoincareMap.of(chosen, rigs_of(lanes.systems))
    rigs = int(np.prod(lanes.shape))
    shape = (*lanes.shape, *((len(states),) if starts is not None else ()), len(grid))
    rig, start, at = np.indices((rigs, len(states), len(grid))).reshape(3, -1)
    angular = grid[at] * frequency_unit(poincare, axis)[rig]
    with progress_bar("regimes", len(rig), progress) as bar:
        found, _ = regime_points(poincare, rig, angular, states[start], plan, bar.update)
    variables = {n: v.reshape(*shape, *v.shape[1:]) for n, v in found.items()}
    own = {"start": np.arange(len(states))} if starts is not None else {}
    _, ratio_units = lanes.sample.drive.reference
    return Regimes(
        axis=axis,
        frequencies=grid,
        axes=lanes.axes | own,
        variables=variables,
        orders=plan.sampling.orders if spectrum else None,
        starts=states,
        ratio_units=ratio_units,
        attributes=attributes_of("vibrojax regimes", lanes, chosen, plan),
    )


def regime_method(
    sample: AbstractSystem,
    axis: str,
    method: AbstractMethod | None,
    step_tolerance: float,
    steps_per_period: int | None,
) -> AbstractMethod:
    """Return the method for systems like the sample.

    Raises `ValueError` for a system that nothing drives, one without a natural frequency where a
    ratio to it is asked for, or a method that cannot take it.
    """
    check_steps(step_tolerance, steps_per_period)
    check_drive(sample)
    equations = eqx.filter_eval_shape(as_arrays(sample).equations)
    if axis == "frequency_ratio" and equations.linear_between_contacts is None:
        raise ValueError("This system has no natural frequency: give frequency in Hz.")
    return choose_method(sample, method, step_tolerance, steps_per_period)


def check_steps(step_tolerance: float, steps_per_period: int | None) -> None:
    """Refuse, with a `ValueError`, steps that no method can take."""
    check_range(
        "step_tolerance", step_tolerance, 0.0, 0.1, include_low=False, allowed="above 0, up to 0.1"
    )
    check_settings(step_tolerance, steps_per_period)


def frequency_unit(poincare: PoincareMap, axis: str) -> Float[Array, " rigs"]:
    """Return the angular frequency, rad/s, that stands for 1 on the frequency axis, by rig."""
    first = np.asarray(poincare.prepared.first_frequency)
    return first if axis == "frequency_ratio" else np.full(first.shape, 2 * np.pi)


def start_states(
    sample: AbstractSystem, starts: Any, start_size: float | None, seed: int
) -> Float[Array, "starts states"]:
    """Return the states to start from, random ones outside of the stops.

    Raises `ValueError` for states of the wrong shape, or random ones of no known size.
    """
    equations = as_arrays(sample).equations()
    size = equations.state_size
    if start_size is not None and (isinstance(starts, bool) or not isinstance(starts, int)):
        raise ValueError("start_size is for random starts: give it with a number of them.")
    if starts is None:
        return np.zeros((1, size))
    if isinstance(starts, int) and not isinstance(starts, bool):
        check_count("starts", starts)
        return _random_states(equations, starts, start_size, seed)
    if isinstance(starts, str) or not np.iterable(starts) or not len(list(starts)):
        raise ValueError(
            f"starts must be how many random ones, or states (q, q') of shape (starts, {size}), "
            f"got {in_short(starts)}."
        )
    try:
        return np.stack([as_state("each", one, equations) for one in starts])
    except ValueError as error:
        raise ValueError(
            f"starts must be how many random ones, or states (q, q') of shape (starts, {size}); "
            f"{error}"
        ) from None


def _random_states(equations: Any, count: int, start_size: float | None, seed: int) -> Array:
    n, size = equations.size, equations.state_size
    rest = jnp.zeros(n)
    if start_size is None:
        clearance = -np.asarray(equations.penetration(rest))
        if not clearance.size or clearance.max() <= 0:
            raise ValueError(
                "start_size must be given for random starts of a system without a stop at a "
                "distance: the rms displacement of the response, m."
            )
        start_size = float(clearance.max())
    check_positive("start_size", start_size, "m")
    # Equal energies are equally likely: independent in the modes about rest, also of those that
    # fall away from it, by the size of their stiffness.
    from scipy.linalg import eigh

    def pull(q: jax.Array) -> jax.Array:
        return equations.linear_force(q, rest) - equations.smooth_force(q, rest)

    stiffness = np.asarray(jax.jit(jax.jacfwd(pull))(rest))
    squares, shapes = eigh((stiffness + stiffness.T) / 2, np.asarray(equations.mass(rest)))
    squares = np.maximum(np.abs(squares), 1e-9 * np.abs(squares).max())
    shapes_of_energy = shapes / np.sqrt(squares)
    draw = np.random.default_rng(seed).normal(size=(2, count, n))
    q, rate = draw[0] @ shapes_of_energy.T, draw[1] @ shapes.T
    slope = np.asarray(jax.grad(equations.response)(rest))
    scale = start_size / np.linalg.norm(slope @ shapes_of_energy)
    q, rate = scale * q, scale * rate
    depth = jax.jit(jax.vmap(equations.penetration))
    for _ in range(60):  # drawn back until none begins inside of a stop
        inside = np.asarray(depth(jnp.asarray(q)) > 0).any(axis=1)
        if not inside.any():
            break
        q[inside] *= 0.8
    return np.concatenate([q, rate, np.zeros((count, size - 2 * n))], axis=1)


def progress_bar(name: str, points: int, progress: bool | None) -> Any:
    """Return a progress bar over points; by default on long runs in a terminal."""
    from tqdm import tqdm

    hidden = None if progress is None else not progress
    delay = 2.0 if progress is None else 0.0
    return tqdm(total=points, desc=name, disable=hidden, delay=delay, unit="point")


def attributes_of(
    title: str, lanes: Lanes, method: AbstractMethod, plan: RegimePlan
) -> dict[str, str]:
    """Return what was run, in words."""
    section = plan.section
    return {
        "title": title,
        "rig": lanes.description,
        "method": recipe(method),
        "transient": f"{section.transient} drive periods",
        "periods": f"{section.periods} drive periods",
        "max_period": f"{section.max_period} drive periods",
        "tolerance": f"{section.tolerance:g} (relative return)",
        "vibrojax_version": version("vibrojax"),
        "jax_version": version("jax"),
    }
