"""Maps of branches: every rig's branch is followed and solved anew at the frequencies asked for."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from vibrojax._tools.checks import check_count, check_range
from vibrojax._tools.described import recipe
from vibrojax._tools.signatures import validated
from vibrojax.branches.along import check_continued
from vibrojax.branches.continuation import LONGEST_STEP
from vibrojax.branches.continue_response import samples_of
from vibrojax.branches.lane_paths import frequency_paths
from vibrojax.branches.plan import Plan, Resolution
from vibrojax.branches.points import CURVES, BranchPoints
from vibrojax.branches.resampling import resample
from vibrojax.branches.work import BranchWork
from vibrojax.maps.measures import PLACES
from vibrojax.maps.responses import AbstractMapResponse, Computed, Folds, Grid, Points
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.methods import HarmonicBalance
from vibrojax.stepping.choice import is_exact


@validated
class ContinuationCurve(AbstractMapResponse):
    """Branches of periodic responses through their folds, resampled on the frequency axis.

    Settings are those of `continue_response`; the branch is followed over the range of the
    frequencies. Where it passes a frequency several times the answers lie along `crossing`, in
    order along the branch. Raises `ValueError` for settings that cannot work.
    """

    period: int = eqx.field(static=True, default=1)
    """Drive periods after which the motion repeats."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Error to expect relative to the response."""
    method: HarmonicBalance | None = None
    """`HarmonicBalance()` with its samples; None: by the tolerance."""
    max_points: int = eqx.field(static=True, default=2000)
    """Most points of a branch."""
    longest_step: float = eqx.field(static=True, default=LONGEST_STEP)
    """Longest step along the branch, in its arclength."""
    max_crossings: int = eqx.field(static=True, default=3)
    """Answers kept at a frequency; further ones are left out."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_count("period", self.period)
        check_count("max_points", self.max_points, least=10)
        check_count("max_crossings", self.max_crossings)
        low, high = 0.0, 0.1
        allowed = "above 0, up to 0.1"
        check_range("tolerance", self.tolerance, low, high, include_low=False, allowed=allowed)
        check_range("longest_step", self.longest_step, 1e-4, 1.0, allowed="from 1e-4 to 1")

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse what `continue_response` refuses."""
        if len(grid.values) < 2:
            raise ValueError(
                f"A branch needs a range to be followed: give several values of {grid.axis}, or "
                "use response='periodic' at one."
            )
        check_continued(sample)
        samples_of(self.method or HarmonicBalance(), self.tolerance, is_exact(sample))

    def ways(self) -> tuple[str, list[Any]]:
        """Return the numbers of the crossings."""
        return "crossing", list(range(self.max_crossings))

    @property
    def variables(self) -> tuple[str, ...]:
        """Those of a `Branch`, and its stability."""
        return (*CURVES, "stable")

    @property
    def offered(self) -> tuple[str, ...]:
        """Measures of the curve, and where the branch folds and first touches."""
        return (
            "peak_amplitude_ratio",
            "peak_frequency",
            "resonance_shift",
            "largest_contact_force",
            "fold",
            "grazing",
            "hysteresis_width",
            "natural_frequency",
        )

    @property
    def lane_words(self) -> tuple[str, str, str]:
        """Whether the branch reached the end of the range."""
        return "completed", "incomplete", "diverged"

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Follow the branches of a block."""
        sample = maker.sample(tuple(int(i[0]) for i in index))
        exact = is_exact(sample)
        lanes = int(np.prod([len(i) for i in index], dtype=int))
        method = self.method or HarmonicBalance()
        plan = Plan(
            axis=grid.axis,
            low=float(grid.values[0]),
            high=float(grid.values[-1]),
            labels=[{} for _ in range(lanes)],
            period=self.period,
            exact=exact,
            resolution=Resolution(samples_of(method, self.tolerance, exact), method.harmonics),
            max_points=self.max_points,
            longest_step=self.longest_step,
            ratio_units=sample.drive.reference[1],
            description=recipe(sample),
        )
        paths = frequency_paths(maker.systems(index), grid.axis == "frequency_ratio", exact)
        branches = BranchWork(plan, paths).run()
        curves, states = [], []
        for branch in branches:
            own, state = self._resampled(branch, grid.values)
            curves.append(own)
            states.append(state)
        stacked = jax.tree.map(lambda *a: np.stack(a), *curves)
        found = np.isfinite(stacked["amplitude_ratio"])
        done = np.array([b.completed for b in branches])
        return Computed(
            curves=stacked,
            numbers={
                "fold": np.stack([_places(b.folds) for b in branches]),
                "grazing": np.stack([_places(b.grazings) for b in branches]),
                "natural_frequency": np.array([b.natural_frequency for b in branches]),
            },
            points=Points(np.stack(states), np.where(found, self.period, 0)),
            lane_status=np.where(done, 0, 1),
            lane_steps=np.array([b.ticks for b in branches], np.int64),
            folds={"fold": Folds(*map(np.stack, zip(*map(_folds, branches), strict=True)))},
        )

    def _resampled(self, branch: BranchPoints, values: np.ndarray) -> tuple[dict, np.ndarray]:
        """Return the curves over (crossings, frequencies) and the states behind them."""
        names = self.variables
        shape = (self.max_crossings, len(values))
        size = branch.initial_state.shape[1]
        curves = {name: np.full(shape, np.nan) for name in names}
        states = np.full((*shape, size), np.nan)
        if len(branch.values) > 1:
            solved = resample(branch, values)
            kept = min(self.max_crossings, solved.sizes["crossing"])
            for name in names:
                curves[name][:kept] = solved[name].values.T[:kept]
            states[:kept] = np.moveaxis(solved["initial_state"].values, 0, 1)[:kept]
        return curves, states


def _places(found: np.ndarray) -> np.ndarray:
    """Return so many places of a branch as are kept, filled up with NaN."""
    places = np.full(PLACES, np.nan)
    places[: min(PLACES, len(found))] = found[:PLACES]
    return places


def _folds(branch: BranchPoints) -> tuple[np.ndarray, np.ndarray]:
    """Return the states at the folds that `_places` keeps, and whether they touch nothing."""
    states = np.full((PLACES, branch.initial_state.shape[1]), np.nan)
    free = np.zeros(PLACES, bool)
    folds = [point for point in branch.special_points if point.kind == "fold"]
    for k, point in enumerate(folds[:PLACES]):
        free[k] = point.contact_force == 0
        if point.initial_state is not None:
            states[k] = point.initial_state
    return states, free
