"""Bifurcation diagrams: what a motion becomes while one parameter goes up and down."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from vibrojax._tools.checks import check_increasing, nearest
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.frequencies import DIRECTIONS
from vibrojax.ensemble.lanes import Lanes
from vibrojax.ensemble.progress import progress_bar
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.regime.regime_points import carried_points, made_ready
from vibrojax.regime.settings import RegimeSettings
from vibrojax.regime.table import BifurcationDiagram


def diagram_settings() -> RegimeSettings:
    """Return the settings of diagrams and maps by default: less than `regimes` looks at."""
    return RegimeSettings(periods=100, max_period=16, samples_per_period=32, spectrum=False)


@validated
def bifurcation_diagram(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    along: str | None = None,
    start: ArrayLike | Sequence[Any] | None = None,
    settings: RegimeSettings | None = None,
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
        start: state at drive phase 0 of the first value, as of `simulate`: what
            `system.state(displacement=...)` makes, or a state in the coordinates of the system; at
            rest by default.
        settings: `vj.RegimeSettings(direction=..., transient=..., ...)`, at every value; by default
            with periods=100, max_period=16, samples_per_period=32 and no spectrum.
        progress: show a progress bar; by default on long runs in a terminal.
        axes: arguments of `system`.

    Raises `ValueError` where it is not clear what to go along, for values that do not increase, an
    unknown keyword, or a system without a drive.
    """
    settings = settings or diagram_settings()
    ready = made_ready(
        "bifurcation diagram", system, axes, zipped, frequency_ratio, frequency, settings
    )
    sample = ready.lanes.sample
    paths = _lanes_along(ready.lanes, ready.axis, ready.grid, along)
    equations = as_arrays(sample).equations()
    state = np.zeros(equations.state_size)
    if start is not None:
        state = np.asarray(as_state("start", start, equations))
    poincare = ready.poincare()
    ways = DIRECTIONS[settings.direction]
    rig = np.repeat(paths.rig, len(ways), axis=0)
    angular = poincare.angular_frequency(
        ready.axis, rig, np.repeat(paths.frequency, len(ways), axis=0)
    )
    backward = np.tile([way == "backward" for way in ways], len(paths.rig))
    with progress_bar("bifurcation diagram", rig.size, progress) as bar:
        begin = np.repeat(state[None], len(rig), axis=0)
        found = carried_points(poincare, rig, angular, backward, begin, settings, bar.update)
    del found["state"]
    shape = (*(len(v) for v in paths.axes.values()), len(ways))
    return BifurcationDiagram(
        parameter=paths.name,
        values=paths.values,
        directions=ways,
        axes=paths.axes,
        variables={n: v.reshape(*shape, *v.shape[1:]) for n, v in found.items()},
        orders=settings.orders,
        ratio_units=sample.drive.reference[1],
        attributes=ready.attributes,
    )


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
    check_increasing(along, values, "Sort it; the other direction is made for you.")
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
