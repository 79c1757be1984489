"""Bifurcation diagrams: what a motion becomes while one parameter goes up and down."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from vibrojax._tools.checks import check_choice, nearest
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.frequencies import DIRECTIONS, frequency_axis
from vibrojax.ensemble.lanes import Lanes, lanes_of
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.regime.bifurcation_result import BifurcationDiagram
from vibrojax.regime.poincare_map import PoincareMap
from vibrojax.regime.regime_points import carried_points, regime_plan
from vibrojax.regime.regimes import (
    attributes_of,
    frequency_unit,
    progress_bar,
    regime_method,
    start_states,
)
from vibrojax.stepping.method import AbstractMethod
from vibrojax.sweep.swept_lanes import rigs_of


@validated
def bifurcation_diagram(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    along: str | None = None,
    direction: str = "both",
    start: ArrayLike | Sequence[Any] | None = None,
    transient: int = 200,
    periods: int = 100,
    max_period: int = 16,
    tolerance: float = 0.02,
    lyapunov: bool = True,
    samples_per_period: int = 32,
    barrier: float = 0.0,
    spectrum: bool = False,
    step_tolerance: float = 1e-4,
    steps_per_period: int | None = None,
    method: AbstractMethod | None = None,
    progress: bool | None = None,
    **axes: Any,
) -> BifurcationDiagram:
    """Carry a motion along one parameter, up and down, and return what it becomes.

    At every value the motion goes on from where the last one ended, so that branches that coexist
    show as a difference between the directions. All directions and other axes are lanes of one
    batch.

    Parameters:
        system: the rig, or a function from named numbers to a rig; then further keywords are its
            arguments, and lists among them are axes.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency_ratio, frequency: drive frequency, one of the two (ratio to the first natural
            frequency of the unstopped system, or Hz): a number, or increasing values.
        along: name of the parameter that the motion is carried along: `frequency`, or a keyword
            with a list. By default the frequency where it is a list, else the only list.
        direction: `both`, `forward` (upwards) or `backward`.
        start: state at drive phase 0 of the first value, as of `simulate`: what
            `system.state(displacement=...)` makes, or a state in the coordinates of the system; at
            rest by default.
        transient: drive periods marched at every value before anything is looked at.
        periods: drive periods observed at every value.
        max_period, tolerance, lyapunov, samples_per_period, barrier: as in `regimes`.
        spectrum, step_tolerance, steps_per_period, method, progress: as in `regimes`.

    Raises `ValueError` where it is not clear what to go along, for values that do not increase, an
    unknown keyword, a system without a drive, or settings that cannot work.
    """
    axis, grid = frequency_axis(frequency_ratio, frequency)
    check_choice("direction", direction, tuple(DIRECTIONS))
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
    lanes = lanes_of(system, axes, zipped)
    paths = _lanes_along(lanes, axis, grid, along)
    chosen = regime_method(lanes.sample, axis, method, step_tolerance, steps_per_period)
    state = _first_state(lanes.sample, start)
    poincare = PoincareMap.of(chosen, rigs_of(lanes.systems))
    ways = DIRECTIONS[direction]
    count = len(paths.rig)
    rig = np.repeat(paths.rig, len(ways), axis=0)
    angular = np.repeat(paths.frequency, len(ways), axis=0) * frequency_unit(poincare, axis)[rig]
    backward = np.tile([way == "backward" for way in ways], count)
    with progress_bar("bifurcation diagram", rig.size, progress) as bar:
        begin = np.repeat(state, len(rig), axis=0)
        found = carried_points(poincare, rig, angular, backward, begin, plan, bar.update)
    del found["state"]
    shape = (*(len(v) for v in paths.axes.values()), len(ways))
    _, ratio_units = lanes.sample.drive.reference
    return BifurcationDiagram(
        parameter=paths.name,
        values=paths.values,
        directions=ways,
        axes=paths.axes,
        variables={n: v.reshape(*shape, *v.shape[1:]) for n, v in found.items()},
        orders=plan.sampling.orders if spectrum else None,
        ratio_units=ratio_units,
        attributes=attributes_of("vibrojax bifurcation diagram", lanes, chosen, plan),
    )


def _first_state(sample: AbstractSystem, start: Any) -> Float[np.ndarray, "1 states"]:
    """Return the state to start from, at rest where none is given.

    Raises `ValueError` for what is no state.
    """
    if start is None:
        return start_states(sample, None, None, 0)
    return np.asarray(as_state("start", start, as_arrays(sample).equations()))[None]


class _LanesAlong(NamedTuple):
    """What the lanes go along, values as the last axis."""

    name: str
    values: Float[np.ndarray, " values"]
    axes: dict[str, np.ndarray]
    """What else varies."""
    rig: Int[np.ndarray, "lanes values"]
    frequency: Float[np.ndarray, "lanes values"]
    """In the unit that was asked for."""


def _lanes_along(lanes: Lanes, axis: str, grid: np.ndarray, along: str | None) -> _LanesAlong:
    lists = dict(lanes.axes)
    if len(grid) > 1 or not lists:
        lists[axis] = grid
    if along is None:
        along = axis if axis in lists else next(iter(lists))
        if along != axis and len(lists) > 1:
            raise ValueError(
                f"{' and '.join(lists)} are lists: say which the motion is carried along, such as "
                f"along={along!r}."
            )
    if along not in lists:
        raise ValueError(f"along must name a list, got {along!r}. {nearest(str(along), lists)}")
    values = lists[along]
    if values.dtype.kind != "f":
        raise ValueError(
            f"along must name one list of numbers, got {along!r}: a motion is not carried along "
            "numbers that go together, or texts. Let the function compute the others from one."
        )
    if (np.diff(values) <= 0).any():
        at = int(np.flatnonzero(np.diff(values) <= 0)[0])
        raise ValueError(
            f"{along} must increase strictly, got {values[at]} then {values[at + 1]} at index "
            f"{at + 1}. Sort it; the other direction is made for you."
        )
    others = {name: v for name, v in lists.items() if name != along}
    rig = np.arange(int(np.prod(lanes.shape))).reshape(*lanes.shape, 1)
    frequency = np.asarray(grid, float)
    shape = (*lanes.shape, len(grid))
    names = [*lanes.axes, axis]
    place = names.index(along)

    def arranged(array: np.ndarray) -> np.ndarray:
        full = np.broadcast_to(array, shape)
        return np.moveaxis(full, place, -1).reshape(-1, len(values))

    return _LanesAlong(along, values, others, arranged(rig), arranged(frequency))
