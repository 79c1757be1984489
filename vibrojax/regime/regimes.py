"""Which regime a system is in, over drive frequency, numbers of the rig and starts."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import ArrayLike, Float

from vibrojax._tools.checks import check_count, check_positive, check_seed
from vibrojax._tools.compiled import compiled
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.progress import progress_bar
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem, as_arrays, equations_of
from vibrojax.regime.regime_points import made_ready, regime_points
from vibrojax.regime.settings import RegimeSettings
from vibrojax.regime.table import Regimes

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
    settings: RegimeSettings | None = None,
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
        settings: `vj.RegimeSettings(transient=..., periods=..., ...)`.
        progress: show a progress bar; by default on long runs in a terminal.

    Raises `ValueError` for frequencies that are empty, not finite or not increasing, starts of the
    wrong shape, an unknown keyword, or a system without a drive.
    """
    settings = settings or RegimeSettings()
    check_seed(seed)
    ready = made_ready("regimes", system, axes, zipped, frequency_ratio, frequency, settings)
    lanes, grid = ready.lanes, ready.grid
    states = start_states(lanes.sample, starts, start_size, seed)
    poincare = ready.poincare()
    own = {"start": np.arange(len(states))} if starts is not None else {}
    shape = (*lanes.shape, *map(len, own.values()), len(grid))
    rig, start, at = np.indices((math.prod(lanes.shape), len(states), len(grid))).reshape(3, -1)
    angular = poincare.angular_frequency(ready.axis, rig, grid[at])
    with progress_bar("regimes", len(rig), progress) as bar:
        found, _ = regime_points(poincare, rig, angular, states[start], settings, bar.update)
    return Regimes(
        axis=ready.axis,
        frequencies=grid,
        axes=lanes.axes | own,
        variables={n: v.reshape(*shape, *v.shape[1:]) for n, v in found.items()},
        orders=settings.orders,
        starts=states,
        ratio_units=lanes.sample.drive.reference[1],
        attributes=ready.attributes,
    )


def start_states(
    sample: AbstractSystem, starts: Any, start_size: float | None, seed: int
) -> Float[Array, "starts states"]:
    """Return the states to start from, random ones outside of the stops.

    Raises `ValueError` for states of the wrong shape, or random ones of no known size.
    """
    equations = equations_of(as_arrays(sample))
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


@compiled
def _stiffness(equations: AbstractEquations, rest: jax.Array) -> jax.Array:
    def pull(q: jax.Array) -> jax.Array:
        return equations.linear_force(q, rest) - equations.smooth_force(q, rest)

    return jax.jacfwd(pull)(rest)


@compiled
def _depths(equations: AbstractEquations, q: jax.Array) -> jax.Array:
    return jax.vmap(equations.penetration)(q)


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
    stiffness, mass = np.asarray(_stiffness(equations, rest)), np.asarray(equations.mass(rest))
    squares, shapes = scipy.linalg.eigh((stiffness + stiffness.T) / 2, mass)
    squares = np.maximum(np.abs(squares), 1e-9 * np.abs(squares).max())
    shapes_of_energy = shapes / np.sqrt(squares)
    draw = np.random.default_rng(seed).normal(size=(2, count, n))
    q, rate = draw[0] @ shapes_of_energy.T, draw[1] @ shapes.T
    slope = np.asarray(jax.grad(equations.response)(rest))
    scale = start_size / np.linalg.norm(slope @ shapes_of_energy)
    q, rate = scale * q, scale * rate
    for _ in range(60):  # drawn back until none begins inside of a stop
        inside = np.asarray(_depths(equations, jnp.asarray(q)) > 0).any(axis=1)
        if not inside.any():
            break
        q[inside] *= 0.8
    return np.concatenate([q, rate, np.zeros((count, size - 2 * n))], axis=1)
