"""What a sweep is to do, and what it gives: shared by its engine and the refining of its jumps."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.results.status import LOST
from vibrojax.steady.lane_pool import LanePool
from vibrojax.steady.settled import Settled
from vibrojax.stepping.measures import ratios_of
from vibrojax.stepping.prepared_rigs import Prepared
from vibrojax.stepping.stepper import AbstractStepper
from vibrojax.sweep.jumps import Jumps


class SweepPlan(NamedTuple):
    """What a sweep is to do, apart from the rigs it is done with."""

    axis: str
    """`frequency_ratio` or `frequency` (Hz)."""
    grid: Float[np.ndarray, " frequencies"]
    directions: tuple[str, ...]
    stepper: AbstractStepper
    tolerance: float
    max_period: int
    max_periods: int | None
    refine_jumps: float | None
    settle: str


class Swept(NamedTuple):
    """States of the rigs of a sweep. Curves have the shape (rigs, directions, frequencies)."""

    curves: dict[str, np.ndarray]
    states: Float[np.ndarray, "rigs directions frequencies states"]
    """(q, q') at drive phase 0."""
    jumps: Jumps
    natural_frequency: Float[np.ndarray, " rigs"]
    """Hz."""


def variables_of(arrived: Settled, reference: Float[np.ndarray, " lanes"]) -> dict[str, np.ndarray]:
    """Return the variables of some lanes."""
    values = ratios_of(arrived.measures, arrived.window, reference)
    lost = np.isin(arrived.status, LOST)
    return {name: np.where(lost, np.nan, v) for name, v in values.items()} | {
        "period": arrived.period,
        "status": arrived.status,
        "periods_marched": arrived.periods_marched,
        "steps": arrived.steps,
    }


def pool_of(plan: SweepPlan, prepared: Prepared, rig: np.ndarray) -> LanePool:
    """Lanes of the rigs of a sweep, one for each of `rig`."""
    tolerance = 1e-2 * plan.tolerance
    resonances = np.asarray(prepared.resonances)[:, rig]
    follow = plan.settle == "follow"
    return LanePool(
        prepared.march, rig, resonances, tolerance, plan.max_period, plan.max_periods, follow
    )
