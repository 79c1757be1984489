"""Maps of basins: at every point how many attractors there are, and what share they have."""

import json
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_seed
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.ranges import Range
from vibrojax.maps.fingerprints import identity_of
from vibrojax.maps.responses import AbstractMapResponse, Computed, Grid, Layout, Points
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.store_files import digest
from vibrojax.model.systems import AbstractSystem
from vibrojax.regime.attractors import Attractors
from vibrojax.regime.basins import Start, Starts, attractors_over
from vibrojax.regime.basins_result import standard_error
from vibrojax.regime.poincare_map import PoincareMap
from vibrojax.regime.settings import BasinSettings

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

        vj.parameter_map(make, frequency=..., response=vj.maps.BasinFractions(
            start, angle=vj.Range(-0.2, 0.2), rate=vj.Range(-5.0, 5.0)))

    At every frequency: `attractors` (motions without a period are one or two), `periodic_share`
    (starts that become periodic), `largest_share` (of the most attracting), both with their
    standard errors (binomial; independent random starts), `cross_well_share` and `diverged_share`.
    The starts, as of `basins`, are the same everywhere. Raises `ValueError` for what `basins`
    refuses.
    """

    starts: Starts
    """The function of two named numbers, and where the starts are."""
    settings: BasinSettings
    """Settings of `basins`."""

    def __init__(
        self,
        start: Start,
        *,
        starts: int | None = None,
        seed: int = 0,
        settings: BasinSettings | None = None,
        **numbers: Range | ArrayLike | Sequence[float],
    ) -> None:
        check_seed(seed)
        self.starts = Starts.of(start, numbers, starts, 200, seed)
        for name in numbers:
            if name not in self.starts.numbers:
                known = ", ".join(self.starts.numbers)
                raise ValueError(f"Unknown argument {name!r}: start takes {known}.")
        self.settings = settings or BasinSettings()

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse a system that nothing drives, and starts that do not fit it."""
        self.settings.stepper_of(sample, grid.axis)
        self.starts.states(sample.equations())

    @property
    def layout(self) -> Layout:
        """Numbers of attractors and shares of the starts; a lane is as bad as its worst start."""
        return Layout(
            VARIABLES,
            ("most_attractors", "least_periodic_share", "natural_frequency"),
            ("periodic", "aperiodic", "lost"),
            (),
            further=64 * self.starts.size,
        )

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Find the attractors of every point of a block."""
        sample = maker.first_of(index)
        states = self.starts.states(sample.equations())
        poincare = PoincareMap(self.settings.stepper_of(sample, grid.axis), maker.rigs(index))
        found = attractors_over(poincare, grid.axis, grid.values, states, self.settings)
        shape = (len(poincare.natural_frequency), 1, len(grid.values))
        rows = [_shares(one) for one in found]
        curves = {name: np.array([row[name] for row in rows]).reshape(shape) for name in VARIABLES}
        worst = np.where(curves["periodic_share"] + curves["diverged_share"] < 1.0, 1, 0)
        worst = np.where(curves["diverged_share"] > 0, 2, worst)
        marched = [one.periods_marched.sum() for one in found]
        return Computed(
            curves=curves,
            numbers={"natural_frequency": poincare.natural_frequency},
            points=Points(np.full((*shape, states.shape[1]), np.nan), np.zeros(shape, int)),
            lane_status=worst.max(axis=(1, 2)),
            lane_steps=np.reshape(marched, shape).sum(axis=(1, 2), dtype=np.int64),
        )

    @property
    def recipe(self) -> str:
        """The settings as Python, and a digest of the function of the starts."""
        # What decides the values: a store of another function of starts is refused.
        given = self.starts
        text = digest(json.dumps(identity_of(given.start)))
        name = getattr(given.start, "__name__", "start")
        numbers = ", ".join(
            f"{n}={tuple(v.tolist()) if isinstance(v, np.ndarray) else v!r}"
            for n, v in given.numbers.items()
        )
        return (
            f"BasinFractions({name}, {numbers}, starts={given.drawn!r}, seed={given.seed}, "
            f"settings={eqx.tree_pformat(self.settings)})  # start {text}"
        )

    def __repr__(self) -> str:
        return self.recipe


def _shares(found: Attractors) -> dict[str, float]:
    """Return the variables of one point."""
    count, period = len(found.number), found.described["period"]
    share = np.bincount(found.number, minlength=len(period) + 1) / count
    own = share[1:]
    periodic, largest = float(own[period > 0].sum()), float(own.max(initial=0.0))
    return {
        "attractors": float(len(period)),
        "periodic_share": periodic,
        "periodic_share_error": float(standard_error(periodic, count)),
        "largest_share": largest,
        "largest_share_error": float(standard_error(largest, count)),
        "cross_well_share": float(own[found.described["cross_well"]].sum()),
        "diverged_share": float(share[0]),
    }
