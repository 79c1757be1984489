"""Basins of attraction: where the motions lead that start from a plane of states, or from a box."""

import inspect
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from vibrojax._tools.checks import axis_of, check_count, check_seed, nearest
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.progress import progress_bar
from vibrojax.ensemble.ranges import Range
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem
from vibrojax.regime.attractors import Attractors, find_attractors
from vibrojax.regime.basins_result import Basins
from vibrojax.regime.poincare_map import PoincareMap, Report
from vibrojax.regime.regime_points import made_ready
from vibrojax.regime.regimes import start_states
from vibrojax.regime.settings import BasinSettings

Start = Callable[..., Any]
"""Function of two named numbers to a state, as one array or as (q, q')."""


@validated
def basins(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    start: Start | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    starts: int | ArrayLike | Sequence[Any] | None = None,
    start_size: float | None = None,
    seed: int = 0,
    settings: BasinSettings | None = None,
    units: dict[str, str] | None = None,
    progress: bool | None = None,
    **axes: Any,
) -> Basins:
    """Find the attractors that many starts lead to, and the basin of each.

        vj.basins(rig, frequency_ratio=1.15, starts=64)     # is there another motion?

        def start(angle, rate):
            return angle * shape, rate * shape          # (q, q') at drive phase 0

        vj.basins(rig, frequency=5.7, start=start, angle=np.linspace(-0.2, 0.2, 100),
                  rate=np.linspace(-5, 5, 100), units=dict(angle="rad", rate="rad/s"))

    Every start is marched in windows of `settings.periods` drive periods until its motion returns
    and is near an attractor, itself followed closer to its limit by a few of the starts; what has
    arrived stops marching. Two orbits that are shifts of one another by whole drive periods are
    one attractor. The period is the smallest within the tolerance.

    Parameters:
        system: the rig, or a function from named numbers to a rig; then further keywords are its
            arguments, and lists among them are axes, crossed.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        start: function of two numbers, whose names it gives, to a state at drive phase 0, as of
            `simulate`: q and q' in the coordinates of the system, of shape (coordinates,) each (and
            the memories of stops that have one), or what `system.state(displacement=...)` makes.
        frequency, frequency_ratio: of the drive, in Hz or over the first linear natural frequency;
            one number or an increasing list, which is an axis. Give one of the two.
        starts: without `start`, the states themselves or how many random ones, as of `regimes` (64
            by default); with it, how many are drawn where its numbers are ranges (1000 by default).
        start_size: size of random states, as of `regimes`.
        seed: of the random starts.
        settings: `vj.BasinSettings(transient=..., periods=..., ...)`.
        units: of the two numbers, by name, for datasets and pictures.
        progress: show a progress bar; by default on long runs in a terminal.
        axes: the two numbers of `start`, as increasing lists, whose pairs make a grid, or as
            `vj.Range(low, high)`, a box in which starts are drawn uniformly; and arguments of
            `system`.

    Standard errors and intervals of the shares assume independent random starts (Menck et al.
    2013); for a grid see also `Basins.boundary_share`. Raises `ValueError` for unknown or missing
    names, states of the wrong shape, or lists that do not increase.
    """
    settings = settings or BasinSettings()
    given: Any = frequency_ratio if frequency is None else frequency
    check_seed(seed)
    made = None if start is None else Starts.of(start, axes, starts, 1000, seed)
    if made is not None and start_size is not None:
        raise ValueError("start_size is for random states: leave it out beside start.")
    names = [] if made is None else list(made.numbers)
    for name in units or ():
        if name not in names:
            raise ValueError(
                f"units are of the numbers of start, got {in_short(name)}. {nearest(name, names)}"
            )
    own = {name: value for name, value in axes.items() if name not in names}
    ready = made_ready(
        "basins of attraction", system, own, zipped, frequency_ratio, frequency, settings
    )
    lanes, grid = ready.lanes, ready.grid
    if made is None:
        states = start_states(lanes.sample, 64 if starts is None else starts, start_size, seed)
        places, sampling = {}, "random"
    else:
        states = made.states(lanes.sample.equations())
        places, sampling = made.places, made.sampling
    total = len(states) * len(grid) * math.prod(lanes.shape)
    with progress_bar("basins", total, progress, unit="start") as bar:
        found = attractors_over(ready.poincare(), ready.axis, grid, states, settings, bar.update)
    outer = lanes.axes | ({} if np.ndim(given) == 0 else {ready.axis: grid})
    inner = tuple(map(len, places.values())) if sampling == "grid" else (len(states),)
    words = {"starts": sampling if sampling == "grid" else f"random, seed {seed}"}
    return Basins(
        axes=outer,
        starts=places,
        start_states=states,
        sampling=sampling,
        systems=lanes.systems,
        frequency_axis=ready.axis,
        frequencies=grid,
        units=units or {},
        attributes=ready.attributes | {ready.axis: repr(grid.tolist())} | words,
        **_tables(found, tuple(map(len, outer.values())), inner),
    )


class Starts(NamedTuple):
    """Where motions start: what a function makes of two named numbers."""

    start: Start
    numbers: dict[str, Any]
    """By name: `vj.Range`, the sides of a box, or increasing values, the axes of a grid."""
    places: dict[str, Float[np.ndarray, " numbers"]]
    """Axes of the grid, or the numbers of every random start."""
    sampling: str
    """`grid` or `random`."""
    drawn: int | None
    """How many there are at random; None on a grid."""
    seed: int

    @property
    def size(self) -> int:
        """How many starts there are."""
        return self.drawn or math.prod(map(len, self.places.values()))

    @classmethod
    def of(
        cls, start: Start, given: dict[str, Any], starts: Any, default: int, seed: int
    ) -> "Starts":
        """Take the numbers of `start` from what was given, beside which others may stand.

        Raises `ValueError` for what is no function of two numbers, a missing name, what is neither
        ranges nor lists of increasing numbers, or a number of starts where the lists say it.
        """
        needed = [p for p in inspect.signature(start).parameters.values() if p.default is p.empty]
        names = [p.name for p in needed]
        if len(needed) != 2 or any(p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL) for p in needed):
            raise ValueError(
                "start must be a function of two named numbers to (q, q'), got one of "
                f"{', '.join(names) or 'nothing'}."
            )
        for name in names:
            if name not in given:
                raise ValueError(
                    f"Give a list of {name}, a number of start, or a vj.Range. "
                    f"{nearest(name, [*given] or ['nothing'])}"
                )
        numbers = {name: given[name] for name in names}
        if all(isinstance(own, Range) for own in numbers.values()):
            count = default if starts is None else starts
            check_count("starts", count)
            generator = np.random.default_rng(seed)
            box = {n: generator.uniform(own.low, own.high, count) for n, own in numbers.items()}
            return cls(start, numbers, box, "random", count, seed)
        axes = {}
        for name, own in numbers.items():
            axes[name] = np.empty(0) if isinstance(own, Range) else axis_of(name, own)
            if len(axes[name]) < 2 or not (np.diff(axes[name]) > 0).all():
                raise ValueError(
                    f"{name} must be a list of at least two increasing numbers (or both numbers a "
                    f"vj.Range, for random starts), got {in_short(own)}."
                )
        if starts is not None:
            raise ValueError(
                f"starts = {in_short(starts)} is for random ones: give {' and '.join(names)} as "
                "vj.Range(low, high), or leave starts out."
            )
        return cls(start, axes, axes, "grid", None, seed)

    def states(self, equations: AbstractEquations) -> Float[np.ndarray, "starts states"]:
        """Return the states of all starts, the second number of a grid running fastest.

        Raises `ValueError` where the function does not return states of the right shape.
        """
        numbers = list(self.places.values())
        if self.sampling == "grid":
            numbers = [a.ravel() for a in np.meshgrid(*numbers, indexing="ij")]

        def state(*pair: Any) -> Any:
            given = dict(zip(self.places, pair, strict=True))
            return as_state("what start returns", self.start(**given), equations)

        first = state(*(float(a[0]) for a in numbers))
        try:
            made = np.asarray(jax.vmap(state)(*(jnp.asarray(a) for a in numbers)))
        except (jax.errors.JAXTypeError, TypeError):  # a function of plain numpy
            made = np.stack([state(*map(float, pair)) for pair in zip(*numbers, strict=True)])
        if not np.isfinite(made).all() or first.shape != made.shape[1:]:
            at = int(np.argmin(np.isfinite(made).all(axis=1)))
            pair = ", ".join(f"{n}={a[at]:g}" for n, a in zip(self.places, numbers, strict=True))
            raise ValueError(
                f"start must return finite numbers, got {in_short(made[at])} for {pair}."
            )
        return made


def attractors_over(
    poincare: PoincareMap,
    axis: str,
    grid: Float[np.ndarray, " frequencies"],
    states: Float[np.ndarray, "starts states"],
    settings: BasinSettings,
    report: Report | None = None,
) -> list[Attractors]:
    """Find the attractors of every rig at every frequency, frequencies running fastest."""
    rigs = len(poincare.natural_frequency)
    rig, value = np.repeat(np.arange(rigs), len(grid)), np.tile(grid, rigs)
    angular = poincare.angular_frequency(axis, rig, value)
    starts = np.broadcast_to(states, (len(rig), *states.shape))
    return find_attractors(poincare, rig, angular, starts, settings, report)


def _tables(found: list[Attractors], shape: tuple[int, ...], inner: tuple[int, ...]) -> Any:
    """Put the attractors of all places side by side."""
    most = max(len(one.described["period"]) for one in found)
    missing = {"period": -1, "cross_well": False}

    def table(name: str) -> np.ndarray:
        rows = [one.described[name] for one in found]
        empty = np.full((len(found), most, *rows[0].shape[1:]), missing.get(name, np.nan))
        for row, values in zip(empty, rows, strict=True):
            row[: len(values)] = values
        return empty.reshape((*shape, *empty.shape[1:]))

    return {name: table(name) for name in found[0].described} | {
        "attractor": np.reshape([one.number for one in found], (*shape, *inner)),
        "periods_marched": np.reshape([one.periods_marched for one in found], (*shape, *inner)),
    }
