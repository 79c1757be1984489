"""Maps of basins: at every point how many attractors there are, and what share they have."""

import json
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import axis_of, check_choice
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import check_drive
from vibrojax.maps.fingerprints import identity_of
from vibrojax.maps.responses import AbstractMapResponse, Computed, Grid, Points
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.store_files import digest
from vibrojax.model.systems import AbstractSystem
from vibrojax.regime.attractors import Attractors, BasinPlan
from vibrojax.regime.basins import (
    Start,
    attractors_over,
    basin_plan,
    numbers_of,
    places_of,
    states_of,
)
from vibrojax.regime.basins_result import standard_error
from vibrojax.regime.poincare_map import PoincareMap
from vibrojax.stepping.choice import choose_method
from vibrojax.stepping.method import AbstractMethod

VARIABLES = (
    "attractors",
    "periodic_share",
    "periodic_share_error",
    "largest_share",
    "largest_share_error",
    "cross_well_share",
    "diverged_share",
)


@validated
class BasinFractions(AbstractMapResponse):
    """How many attractors a box of starts leads to, and the shares of their basins.

        vj.parameter_map(make, frequency=..., response=vj.BasinFractions(
            start, angle=(-0.2, 0.2), rate=(-5.0, 5.0)))

    At every frequency: `attractors` (motions without a period are one or two), `periodic_share`
    (starts that become periodic), `largest_share` (of the most attracting), both with their
    standard errors (binomial; independent random starts), `cross_well_share` and `diverged_share`.
    Settings are those of `basins`; the starts are the same everywhere. Raises `ValueError` for
    settings that cannot work.
    """

    start: Start = eqx.field(static=True)
    """Function of two named numbers to a state (q, q')."""
    numbers: dict[str, tuple[float, ...]] = eqx.field(static=True)
    """Ends of the box, or lists for a grid, by the names of the two numbers."""
    starts: str = eqx.field(static=True)
    """`random`, or `grid` over the lists of `numbers`."""
    samples: int = eqx.field(static=True)
    """How many random starts there are."""
    seed: int = eqx.field(static=True)
    """Of the random starts."""
    plan: BasinPlan = eqx.field(static=True)
    """Settings of `basins`: transient, periods, max_period, tolerance, barrier."""
    method: AbstractMethod | None
    """How motions are stepped; None: as suits the system."""

    def __init__(
        self,
        start: Start,
        *,
        starts: str = "random",
        samples: int = 200,
        seed: int = 0,
        transient: int = 200,
        periods: int = 24,
        max_period: int = 12,
        tolerance: float | int = 0.01,
        barrier: float | int = 0.0,
        method: AbstractMethod | None = None,
        **numbers: ArrayLike | Sequence[float],
    ) -> None:
        check_choice("starts", starts, ("grid", "random"))
        names = numbers_of(start)
        for name in numbers:
            if name not in names:
                raise ValueError(f"Unknown argument {name!r}: start takes {', '.join(names)}.")
        places_of(names, numbers, starts, samples, seed)
        self.start = start
        self.numbers = {n: tuple(axis_of(n, numbers[n]).tolist()) for n in names}
        self.starts, self.samples, self.seed = starts, samples, seed
        self.plan = basin_plan(transient, periods, max_period, tolerance, barrier, False)
        self.method = method

    def _states(self, sample: AbstractSystem) -> np.ndarray:
        equations = sample.equations()
        names = tuple(self.numbers)
        places = places_of(names, self.numbers, self.starts, self.samples, self.seed)
        return states_of(self.start, places, self.starts, equations)

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse a system that nothing drives, and starts that do not fit it."""
        check_drive(sample)
        choose_method(sample, self.method, 1e-4, None)
        self._states(sample)

    def ways(self) -> tuple[str, list[Any]]:
        """Return that there is one answer at a frequency."""
        return "", []

    @property
    def variables(self) -> tuple[str, ...]:
        """Numbers of attractors and shares of the starts."""
        return VARIABLES

    @property
    def offered(self) -> tuple[str, ...]:
        """The most attractors and the least share of periodic starts of a curve."""
        return ("most_attractors", "least_periodic_share", "natural_frequency")

    @property
    def lane_words(self) -> tuple[str, str, str]:
        """As bad as the worst of all starts."""
        return "periodic", "aperiodic", "diverged"

    @property
    def bytes_per_point(self) -> int:
        """Memory of all starts of a point."""
        count = self.samples
        if self.starts == "grid":
            count = int(np.prod([len(values) for values in self.numbers.values()]))
        return 8 * 64 * count

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Find the attractors of every point of a block."""
        sample = maker.sample(tuple(int(i[0]) for i in index))
        states = self._states(sample)
        method = choose_method(sample, self.method, 1e-4, None)
        poincare = PoincareMap.of(method, maker.rigs(index))
        found = attractors_over(poincare, grid.axis, grid.values, states, self.plan)
        first = np.asarray(poincare.prepared.first_frequency)
        shape = (len(first), 1, len(grid.values))
        rows = [_shares(one) for one in found]
        curves = {name: np.array([row[name] for row in rows]).reshape(shape) for name in VARIABLES}
        worst = np.where(curves["periodic_share"] + curves["diverged_share"] < 1.0, 1, 0)
        worst = np.where(curves["diverged_share"] > 0, 2, worst)
        marched = [one.periods_marched.sum() for one in found]
        return Computed(
            curves=curves,
            numbers={"natural_frequency": first / (2 * np.pi)},
            points=Points(np.full((*shape, states.shape[1]), np.nan), np.zeros(shape, int)),
            lane_status=worst.max(axis=(1, 2)),
            lane_steps=np.reshape(marched, shape).sum(axis=(1, 2), dtype=np.int64),
            folds={},
        )

    @property
    def recipe(self) -> str:
        """The settings as Python, and a digest of the function of the starts."""
        # What decides the values: a store of another function of starts is refused.
        text = digest(json.dumps(identity_of(self.start)))
        name = getattr(self.start, "__name__", "start")
        numbers = ", ".join(f"{n}={v!r}" for n, v in self.numbers.items())
        settings = ", ".join(f"{n}={v!r}" for n, v in self.plan._asdict().items() if n in SETTINGS)
        return (
            f"BasinFractions({name}, {numbers}, starts={self.starts!r}, samples={self.samples}, "
            f"seed={self.seed}, {settings}, method={eqx.tree_pformat(self.method)})  # start {text}"
        )

    def __repr__(self) -> str:
        return self.recipe


SETTINGS = ("transient", "periods", "max_period", "tolerance", "barrier")


def _shares(found: Attractors) -> dict[str, float]:
    """Return the variables of one point."""
    count = len(found.number)
    share = np.bincount(found.number, minlength=len(found.period) + 1) / count
    own = share[1:]
    periodic = float(own[found.period > 0].sum())
    largest = float(own.max(initial=0.0))
    return {
        "attractors": float(len(found.period)),
        "periodic_share": periodic,
        "periodic_share_error": float(standard_error(periodic, count)),
        "largest_share": largest,
        "largest_share_error": float(standard_error(largest, count)),
        "cross_well_share": float(own[found.cross_well].sum()),
        "diverged_share": float(share[0]),
    }
