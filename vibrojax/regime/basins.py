"""Basins of attraction: where the motions lead that start from a plane of states, or from a box."""

import inspect
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from vibrojax._tools.checks import (
    axis_of,
    check_choice,
    check_count,
    check_not_negative,
    check_range,
    check_seed,
    nearest,
)
from vibrojax._tools.described import in_short, recipe
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.frequencies import check_drive, frequency_axis
from vibrojax.ensemble.lanes import lanes_of
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem
from vibrojax.regime.attractors import Attractors, BasinPlan, find_attractors
from vibrojax.regime.basins_result import Basins
from vibrojax.regime.poincare_map import PoincareMap
from vibrojax.stepping.choice import choose_method
from vibrojax.stepping.method import AbstractMethod
from vibrojax.sweep.swept_lanes import rigs_of

Start = Callable[..., Any]
"""Function of two named numbers to a state, as one array or as (q, q')."""


@validated
def basins(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    start: Start,
    frequency: ArrayLike | Sequence[float] | None = None,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    starts: str = "grid",
    samples: int = 1000,
    seed: int = 0,
    transient: int = 200,
    periods: int = 24,
    max_period: int = 12,
    tolerance: float | int = 0.01,
    barrier: float | int = 0.0,
    distinguish_phases: bool = False,
    method: AbstractMethod | None = None,
    units: dict[str, str] | None = None,
    progress: bool | None = None,
    **axes: Any,
) -> Basins:
    """Find the attractors that a plane of starts leads to, and the basin of each.

        def start(angle, rate):
            return angle * shape, rate * shape          # (q, q') at drive phase 0

        found = vj.basins(rig, frequency=5.7, start=start,
                          angle=np.linspace(-0.2, 0.2, 100), rate=np.linspace(-5, 5, 100),
                          units=dict(angle="rad", rate="rad/s"))

    Every start is marched in windows of `periods` drive periods until its motion returns and is
    near an attractor, itself followed closer to its limit by a few of the starts; what has arrived
    stops marching. Two orbits that are shifts of one another by whole drive periods are one
    attractor. The period is the smallest within the tolerance.

    Parameters:
        system: the rig, or a function from named numbers to a rig; then further keywords are its
            arguments, and lists among them are axes, crossed.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        start: function of two numbers, whose names it gives, to a state at drive phase 0, as of
            `simulate`: q and q' in the coordinates of the system, of shape (coordinates,) each (and
            the memories of stops that have one), or what `system.state(displacement=...)` makes.
        frequency, frequency_ratio: of the drive, in Hz or over the first linear natural frequency;
            one number or an increasing list, which is an axis. Give one of the two.
        starts: `grid`, of all pairs of the two lists of numbers, or `random`, uniform in the box
            that they span.
        samples: how many random starts.
        seed: of the random starts.
        transient: drive periods after which what has not settled has one window left.
        periods: drive periods of a window, at least 2 max_period.
        max_period: longest period looked for, in drive periods.
        tolerance: relative return (in the norm of energy) that makes a period, and distance within
            which two states on an orbit are the same.
        barrier: displacement between the wells, m, for `cross_well`.
        distinguish_phases: count the n shifts of a period-n orbit as n attractors.
        method: how to step, as of `frequency_sweep`.
        units: of the two numbers, by name, for datasets and pictures.
        progress: show a progress bar; by default on long runs in a terminal.
        axes: the two lists of numbers of `start`, increasing, and arguments of `system`.

    Standard errors and intervals of the shares assume independent random starts (Menck et al.
    2013); for a grid see also `Basins.boundary_share`. Raises `ValueError` for unknown or missing
    names, states of the wrong shape, lists that do not increase, or settings that cannot work.
    """
    check_choice("starts", starts, ("grid", "random"))
    plan = basin_plan(transient, periods, max_period, tolerance, barrier, distinguish_phases)
    given: Any = frequency_ratio if frequency is None else frequency
    single = np.ndim(given) == 0
    axis, grid = frequency_axis(frequency_ratio, frequency)
    names = numbers_of(start)
    unit_of = _units(names, units)
    places = places_of(names, axes, starts, samples, seed)
    own = {name: value for name, value in axes.items() if name not in names}
    lanes = lanes_of(system, own, zipped)
    check_drive(lanes.sample)
    equations = lanes.sample.equations()
    states = states_of(start, places, starts, equations)
    chosen = choose_method(lanes.sample, method, 1e-4, None)
    poincare = PoincareMap.of(chosen, rigs_of(lanes.systems))
    from tqdm import tqdm

    hidden = None if progress is None else not progress
    total = len(states) * len(grid) * int(np.prod(lanes.shape))
    delay = 2.0 if progress is None else 0.0
    with tqdm(total=total, desc="basins", disable=hidden, delay=delay, unit="start") as bar:
        found = attractors_over(poincare, axis, grid, states, plan, bar.update)
    outer = lanes.axes | ({} if single else {axis: grid})
    shape = tuple(len(values) for values in outer.values())
    inner = tuple(len(values) for values in places.values())
    return Basins(
        axes=outer,
        starts=places,
        sampling=starts,
        units=unit_of,
        attributes={
            "title": "vibrojax basins of attraction",
            "rig": lanes.description,
            "method": recipe(chosen),
            "settings": repr(plan),
            axis: repr(grid.tolist()),
            "starts": starts if starts == "grid" else f"random, seed {seed}",
            "vibrojax_version": version("vibrojax"),
            "jax_version": version("jax"),
        },
        **_tables(found, shape, inner if starts == "grid" else inner[:1]),
    )


def basin_plan(
    transient: int,
    periods: int,
    max_period: int,
    tolerance: float | int,
    barrier: float | int,
    distinguish_phases: bool,
) -> BasinPlan:
    """Check the settings of a search for attractors. Raises `ValueError` as `basins` does."""
    check_not_negative("transient", transient, "drive periods")
    check_count("transient", transient, least=0)
    check_count("max_period", max_period)
    check_count("periods", periods, least=2 * max_period)
    low, high, allowed = 0.0, 0.2, "above 0, up to 0.2"
    check_range("tolerance", tolerance, low, high, include_low=False, allowed=allowed)
    check_range("barrier", barrier, allowed="a finite displacement in m")
    return BasinPlan(transient, periods, max_period, tolerance, barrier, distinguish_phases)


def numbers_of(start: Any) -> tuple[str, ...]:
    """Return the names of the two numbers of a function of starts.

    Raises `ValueError` for what is no function of two numbers.
    """
    needed = [p for p in inspect.signature(start).parameters.values() if p.default is p.empty]
    if len(needed) != 2 or any(p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL) for p in needed):
        raise ValueError(
            "start must be a function of two named numbers to (q, q'), got one of "
            f"{', '.join(p.name for p in needed) or 'nothing'}."
        )
    return tuple(p.name for p in needed)


def places_of(
    names: tuple[str, ...], axes: dict[str, Any], starts: str, samples: int, seed: int
) -> dict[str, Float[np.ndarray, " numbers"]]:
    """Return the two numbers of the starts: the axes of the grid, or those of random starts.

    Raises `ValueError` for a missing name, a list that is not one of increasing numbers, or a count
    below 1.
    """
    found = {}
    for name in names:
        if name not in axes:
            raise ValueError(
                f"Give a list of {name}, a number of start. {nearest(name, [*axes] or ['nothing'])}"
            )
        values = axis_of(name, axes[name])
        if len(values) < 2 or not (np.diff(values) > 0).all():
            raise ValueError(
                f"{name} must be a list of at least two increasing numbers, "
                f"got {in_short(axes[name])}."
            )
        found[name] = values
    check_count("samples", samples)
    check_seed(seed)
    if starts == "grid":
        return found
    generator = np.random.default_rng(seed)
    return {
        name: generator.uniform(values[0], values[-1], samples) for name, values in found.items()
    }


def states_of(
    start: Start,
    places: dict[str, Float[np.ndarray, " numbers"]],
    starts: str,
    equations: AbstractEquations,
) -> Float[np.ndarray, "starts states"]:
    """Return the states of all starts, the second number of a grid running fastest.

    Raises `ValueError` where the function does not return states of the right shape.
    """
    numbers = list(places.values())
    if starts == "grid":
        numbers = [a.ravel() for a in np.meshgrid(*numbers, indexing="ij")]

    def state(*pair: Any) -> Any:
        given = dict(zip(places, pair, strict=True))
        return as_state("what start returns", start(**given), equations)

    first = state(*(float(a[0]) for a in numbers))
    try:
        made = np.asarray(jax.vmap(state)(*(jnp.asarray(a) for a in numbers)))
    except (jax.errors.JAXTypeError, TypeError):  # a function of plain numpy
        made = np.stack([state(*map(float, pair)) for pair in zip(*numbers, strict=True)])
    if not np.isfinite(made).all() or first.shape != made.shape[1:]:
        at = int(np.argmin(np.isfinite(made).all(axis=1)))
        pair = ", ".join(f"{n}={a[at]:g}" for n, a in zip(places, numbers, strict=True))
        raise ValueError(f"start must return finite numbers, got {in_short(made[at])} for {pair}.")
    return made


def attractors_over(
    poincare: PoincareMap,
    axis: str,
    grid: Float[np.ndarray, " frequencies"],
    states: Float[np.ndarray, "starts states"],
    plan: BasinPlan,
    report: Callable[[int], object] = lambda count: None,
) -> list[Attractors]:
    """Find the attractors of every rig at every frequency, frequencies running fastest."""
    first = np.asarray(poincare.prepared.first_frequency)
    unit = first if axis == "frequency_ratio" else np.full(len(first), 2 * np.pi)
    rig = np.repeat(np.arange(len(first)), len(grid))
    angular = np.tile(grid, len(first)) * unit[rig]
    starts = np.broadcast_to(states, (len(rig), *states.shape))
    return find_attractors(poincare, rig, angular, starts, plan, report)


def _units(names: tuple[str, ...], units: dict[str, str] | None) -> dict[str, str]:
    units = {} if units is None else units
    for name in units:
        if name not in names:
            raise ValueError(
                f"units are of the numbers of start, got {in_short(name)}. {nearest(name, names)}"
            )
    return units


def _tables(found: list[Attractors], shape: tuple[int, ...], inner: tuple[int, ...]) -> Any:
    """Put the attractors of all places side by side."""
    most = max((len(one.period) for one in found), default=0)

    def rows(name: str, missing: Any) -> np.ndarray:
        table = np.full((len(found), most), missing)
        for row, one in zip(table, found, strict=True):
            values = getattr(one, name)
            row[: len(values)] = values
        return table.reshape((*shape, most))

    def each(name: str) -> np.ndarray:
        return np.stack([getattr(one, name) for one in found]).reshape((*shape, *inner))

    return {
        "attractor": each("number"),
        "periods_marched": each("periods_marched"),
        "period": rows("period", -1),
        "cross_well": rows("cross_well", False),
        "mean_displacement": rows("mean_displacement", np.nan),
        "strain_power_rms": rows("strain_power_rms", np.nan),
    }
