"""Sweeps as the response of a map: every lane followed along the frequency."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from vibrojax.ensemble.frequencies import DIRECTIONS
from vibrojax.maps.responses import (
    MARCHED,
    STATUS,
    AbstractMapResponse,
    Computed,
    Folds,
    Grid,
    Layout,
    Points,
    worst_of,
)
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.status import Status
from vibrojax.stepping.stepper import AbstractStepper
from vibrojax.sweep.frequency_response import CURVES
from vibrojax.sweep.plan import Swept
from vibrojax.sweep.settings import SweepSettings
from vibrojax.sweep.swept_lanes import compile_ahead, numbers_of_jumps, sweep_rigs


class SweepMap(AbstractMapResponse):
    """Sweeps with the state carried along, as `frequency_sweep` makes them."""

    settings: SweepSettings

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse what `frequency_sweep` refuses."""
        self.settings.plan(sample, grid.axis, grid.values)

    def without_jumps(self) -> "SweepMap":
        """Return the same without a search for where the responses jump."""
        return SweepMap(replace(self.settings, refine_jumps=None))

    def march_stepper(self, sample: AbstractSystem, grid: Grid) -> AbstractStepper:
        """Return that of the sweep."""
        return self.settings.plan(sample, grid.axis, grid.values).stepper

    @property
    def layout(self) -> Layout:
        """Variables of a `FrequencyResponse`; the area needs both directions."""
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
        ways = DIRECTIONS[self.settings.direction]
        offered = tuple(n for n in names if len(ways) == 2 or n != "hysteresis_area")
        return Layout(CURVES, offered, MARCHED, STATUS, "direction", ways)

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Sweep the rigs of a block."""
        sample = maker.first_of(index)
        plan = self.settings.plan(sample, grid.axis, grid.values)
        prepared = maker.prepared(index, plan.stepper, lambda kinds: compile_ahead(plan, kinds))
        swept = sweep_rigs(plan, prepared)
        jumps = numbers_of_jumps(swept)
        curves = swept.curves
        settled = curves["status"] == Status.settled.value
        return Computed(
            curves=curves,
            numbers={
                "jump_up": jumps["jump_up"],
                "jump_down": jumps["jump_down"],
                "natural_frequency": swept.natural_frequency,
            },
            points=Points(swept.states, np.where(settled, curves["period"], 0)),
            lane_status=worst_of(curves["status"]),
            lane_steps=curves["steps"].sum(axis=(1, 2), dtype=np.int64),
            folds={
                "jump_up": _behind(swept, swept.jumps.rises),
                "jump_down": _behind(swept, ~swept.jumps.rises),
            },
        )


def _behind(swept: Swept, wanted: Bool[np.ndarray, "rigs directions"]) -> Folds:
    """Return the motions from which the responses jump, up or down."""
    jumps, count = swept.jumps, len(swept.states)
    found = Folds(
        bracket=np.full((count, 2), np.nan),
        states=np.full((count, swept.states.shape[-1]), np.nan),
        free=np.zeros(count, bool),
        period=np.zeros(count, np.int64),
    )
    rig, way = np.nonzero(jumps.exists & wanted)
    bracket, period = jumps.bracket[rig, way], swept.curves["period"]
    at_fold = np.diff(bracket)[:, 0] == 0
    found.bracket[rig], found.states[rig] = bracket, jumps.state[rig, way]
    found.free[rig] = jumps.free[rig, way] & ~at_fold
    found.period[rig] = np.where(at_fold, 1, period[rig, way, jumps.before[rig, way]])
    return found
