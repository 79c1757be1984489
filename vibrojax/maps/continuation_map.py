"""Maps of branches: every rig's branch is followed and solved anew at the frequencies asked for."""

import jax
import numpy as np

from vibrojax._tools.described import recipe
from vibrojax.branches.along import check_continued, frequency_paths
from vibrojax.branches.plan import Plan
from vibrojax.branches.points import CURVES, TURNS, BranchPoints
from vibrojax.branches.resampling import resample
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.branches.work import follow_branches
from vibrojax.maps.measures import PLACES
from vibrojax.maps.responses import AbstractMapResponse, Computed, Folds, Grid, Layout, Points
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem


class ContinuationMap(AbstractMapResponse):
    """Branches of periodic responses through their folds, resampled on the frequency axis.

    The branch is followed over the range of the frequencies. Where it passes a frequency several
    times the answers lie along `crossing`, in order along the branch.
    """

    settings: ContinuationSettings

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse what `continue_response` refuses."""
        if len(grid.values) < 2:
            raise ValueError(
                f"A branch needs a range to be followed: give several values of {grid.axis}, or "
                "use response='periodic' at one."
            )
        check_continued(sample)
        self._plan(sample, grid, 1)

    def _plan(self, sample: AbstractSystem, grid: Grid, lanes: int) -> Plan:
        return self.settings.plan(
            sample,
            axis=grid.axis,
            low=float(grid.values[0]),
            high=float(grid.values[-1]),
            labels=[{} for _ in range(lanes)],
            description=recipe(sample),
        )

    @property
    def layout(self) -> Layout:
        """Variables of a `Branch` and its stability; where it folds and first touches."""
        words = ("completed", "incomplete", "lost")
        offered = (
            "peak_amplitude_ratio",
            "peak_frequency",
            "resonance_shift",
            "largest_contact_force",
            "fold",
            "grazing",
            "hysteresis_width",
            "natural_frequency",
        )
        crossings = tuple(range(self.settings.max_crossings))
        return Layout((*CURVES, "stable"), offered, words, words, "crossing", crossings)

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Follow the branches of a block."""
        sample = maker.first_of(index)
        lanes = int(np.prod([len(i) for i in index], dtype=int))
        plan = self._plan(sample, grid, lanes)
        paths = frequency_paths(maker.systems(index), grid.axis == "frequency_ratio", plan.exact)
        branches = follow_branches(plan, paths)
        curves, states = [], []
        for branch in branches:
            own, state = self._resampled(branch, grid.values)
            curves.append(own)
            states.append(state)
        stacked = jax.tree.map(lambda *a: np.stack(a), *curves)
        found = np.isfinite(stacked["amplitude_ratio"])
        done = np.array([b.completed for b in branches])
        folds = jax.tree.map(lambda *a: np.stack(a), *map(_folds, branches))
        first, further = (
            Folds(*(a[:, part] for a in folds)) for part in (slice(PLACES), slice(PLACES, None))
        )
        return Computed(
            curves=stacked,
            numbers={
                "fold": first.bracket[..., 0],
                "further_folds": further.bracket[..., 0],
                "grazing": np.stack([_places(b.grazings) for b in branches]),
                "natural_frequency": np.array([b.natural_frequency for b in branches]),
            },
            points=Points(np.stack(states), np.where(found, self.settings.period, 0)),
            lane_status=np.where(done, 0, 1),
            lane_steps=np.array([b.ticks for b in branches], np.int64),
            folds={"fold": first, "further_folds": further},
        )

    def _resampled(self, branch: BranchPoints, values: np.ndarray) -> tuple[dict, np.ndarray]:
        """Return the curves over (crossings, frequencies) and the states behind them."""
        names = self.layout.variables
        shape = (self.settings.max_crossings, len(values))
        size = branch.initial_state.shape[1]
        curves = {name: np.full(shape, np.nan) for name in names}
        states = np.full((*shape, size), np.nan)
        if len(branch.values) > 1:
            solved = resample(branch, values)
            kept = min(self.settings.max_crossings, solved.sizes["crossing"])
            for name in names:
                curves[name][:kept] = solved[name].values.T[:kept]
            states[:kept] = np.moveaxis(solved["initial_state"].values, 0, 1)[:kept]
        return curves, states


def _places(found: np.ndarray) -> np.ndarray:
    """Return so many places of a branch as are kept, filled up with NaN."""
    places = np.full(PLACES, np.nan)
    places[: min(PLACES, len(found))] = found[:PLACES]
    return places


def _folds(branch: BranchPoints) -> Folds:
    """Return the first folds of a branch, then the lowest and the highest of all further ones."""
    folds = [point for point in branch.special_points if point.kind in TURNS]
    further = sorted(folds[PLACES:], key=float)
    kept = dict(enumerate(folds[:PLACES]))
    if further:
        kept |= {PLACES: further[0], PLACES + 1: further[-1]}
    found = Folds(
        bracket=np.full((PLACES + 2, 2), np.nan),
        states=np.full((PLACES + 2, branch.initial_state.shape[1]), np.nan),
        free=np.zeros(PLACES + 2, bool),
        period=np.full(PLACES + 2, branch.period),
    )
    for k, point in kept.items():
        found.bracket[k] = point.parameter
        found.free[k] = point.contact_force == 0
        if point.initial_state is not None:
            found.states[k] = point.initial_state
    return found
