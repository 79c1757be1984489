"""Sweeps as the response of a map: every lane followed along the frequency."""

from typing import Any

import equinox as eqx
import numpy as np

from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import DIRECTIONS
from vibrojax.maps.responses import AbstractMapResponse, Computed, Folds, Grid, Points
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.status import Status
from vibrojax.stepping.method import AbstractMethod
from vibrojax.sweep.frequency_response import CURVES as SWEPT_CURVES
from vibrojax.sweep.frequency_sweep import check_sweep, sweep_plan
from vibrojax.sweep.swept_lanes import before_jumps, numbers_of_jumps, sweep_rigs


@validated
class SettledSweep(AbstractMapResponse):
    """Sweeps with the state carried along, as `frequency_sweep` makes them.

    Settings are those of `frequency_sweep`. Raises `ValueError` for settings that cannot work.
    """

    direction: str = eqx.field(static=True, default="both")
    """`both`, `forward` or `backward`."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Error to expect relative to the response."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps per drive period, instead of those the tolerance asks for."""
    method: AbstractMethod | None = None
    """How motions are stepped; None: as suits the system."""
    max_period: int = eqx.field(static=True, default=8)
    """Longest period looked for, in drive periods."""
    max_periods: int = eqx.field(static=True, default=600)
    """Most drive periods marched at a point."""
    refine_jumps: float | None = eqx.field(static=True, default=1e-4)
    """Width to which jumps are refined, as a share of the frequency; None: not at all."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work; what depends on the system is checked beside it."""
        check_sweep(
            self.direction,
            self.tolerance,
            self.steps_per_period,
            self.max_period,
            self.max_periods,
            self.refine_jumps,
        )

    def _plan(self, sample: AbstractSystem, grid: Grid) -> Any:
        return sweep_plan(
            sample,
            grid.axis,
            grid.values,
            direction=self.direction,
            tolerance=self.tolerance,
            steps_per_period=self.steps_per_period,
            method=self.method,
            max_period=self.max_period,
            max_periods=self.max_periods,
            refine_jumps=self.refine_jumps,
        )

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse what `frequency_sweep` refuses."""
        self._plan(sample, grid)

    def march_method(self, sample: AbstractSystem, grid: Grid) -> AbstractMethod:
        """Return that of the sweep."""
        return self._plan(sample, grid).method

    def ways(self) -> tuple[str, list[Any]]:
        """Return the directions."""
        return "direction", list(DIRECTIONS[self.direction])

    @property
    def variables(self) -> tuple[str, ...]:
        """Those of a `FrequencyResponse`."""
        return SWEPT_CURVES

    @property
    def offered(self) -> tuple[str, ...]:
        """All but what needs both directions, where there is one."""
        names = (
            "peak_amplitude_ratio",
            "peak_frequency",
            "resonance_shift",
            "largest_contact_force",
            "jump_up",
            "jump_down",
            "hysteresis_width",
            "hysteresis_area",
            "aperiodic_fraction",
            "natural_frequency",
        )
        both = self.direction == "both"
        return names if both else tuple(n for n in names if n != "hysteresis_area")

    @property
    def lane_words(self) -> tuple[str, str, str]:
        """As bad as its worst point; one that grows without bound counts as diverged."""
        return Status.settled.name, Status.aperiodic.name, Status.diverged.name

    @property
    def point_words(self) -> tuple[str, ...]:
        """Those of `Status`."""
        return tuple(status.name for status in Status)

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Sweep the rigs of a block."""
        sample = maker.sample(tuple(int(i[0]) for i in index))
        swept = sweep_rigs(self._plan(sample, grid), maker.rigs(index))
        jumps = numbers_of_jumps(swept)
        curves = swept.curves
        worst = np.minimum(curves["status"].max(axis=(1, 2)), Status.diverged.value)
        settled = curves["status"] == Status.settled.value
        return Computed(
            curves=curves,
            numbers={
                "jump_up": jumps["jump_up"],
                "jump_down": jumps["jump_down"],
                "natural_frequency": swept.natural_frequency,
            },
            points=Points(swept.states, np.where(settled, curves["period"], 0)),
            lane_status=worst,
            lane_steps=curves["steps"].sum(axis=(1, 2), dtype=np.int64),
            folds={n: Folds(*before) for n, before in before_jumps(swept).items()},
        )
