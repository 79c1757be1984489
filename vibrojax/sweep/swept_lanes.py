"""The engine of sweeps: rigs through a grid of frequencies in each direction, then their jumps."""

from collections.abc import Callable
from typing import Any

import numpy as np

from vibrojax.results.status import Status
from vibrojax.steady import pool_programs
from vibrojax.steady.fold_ahead import compile_fold_ahead
from vibrojax.steady.settled import Onwards, Settled, place_in_lane
from vibrojax.steady.touch_ahead import compile_touch_ahead
from vibrojax.stepping.prepared_rigs import Prepared
from vibrojax.stepping.resonance import is_unbounded
from vibrojax.sweep.jump_refining import refine
from vibrojax.sweep.jumps import find_jumps
from vibrojax.sweep.plan import SweepPlan, Swept, pool_of, variables_of

FURTHER = 2
"""Times that another jump is looked for where a doubtful one was none."""


class _Grid:
    """Feed of lanes that go through the grid, upwards or downwards."""

    def __init__(self, plan: SweepPlan, lanes: int, states: int, unit: np.ndarray, reference):
        self.grid, self.unit, self.reference = plan.grid, unit, reference
        backward = [d == "backward" for d in plan.directions]
        self.backward = np.tile(backward, lanes // len(backward))
        self.visited = np.zeros(lanes, int)
        self.curves: dict[str, np.ndarray] = {}
        self.states = np.empty((lanes, len(plan.grid), states))

    def column(self, lanes: np.ndarray, more: int | np.ndarray = 0) -> np.ndarray:
        """Where in the grid some lanes are after so many more, held inside beyond its end."""
        last = len(self.grid) - 1
        at = np.minimum(self.visited[lanes] + more, last)
        return np.where(self.backward[lanes], last - at, at)

    def frequency(self, lanes: np.ndarray, more: int | np.ndarray = 0) -> np.ndarray:
        """Angular frequency of some lanes, rad/s."""
        return self.grid[self.column(lanes, more)] * self.unit[lanes]

    def ahead(self, lanes: np.ndarray, count: int) -> np.ndarray:
        """Angular frequencies after the next one, (count, lanes); NaN beyond the grid."""
        more = np.arange(1, count + 1)[:, None]
        there = self.visited[lanes] + more < len(self.grid)
        return np.where(there, self.frequency(lanes, more), np.nan)

    def onwards(self, arrived: Settled) -> Onwards:
        """Store the steady states of some lanes and send them to the next point of the grid."""
        k = arrived.lanes
        at = self.column(k, place_in_lane(k))
        for name, values in variables_of(arrived, self.reference[k]).items():
            if name not in self.curves:
                self.curves[name] = np.empty((len(self.visited), len(self.grid)), values.dtype)
            self.curves[name][k, at] = values
        self.states[k, at] = arrived.state
        np.add.at(self.visited, k, 1)
        going = np.ones(len(k), bool)
        return Onwards(self.visited[k] < len(self.grid), self.frequency(k), arrived.state, going)


def compile_ahead(plan: SweepPlan, prepared: Prepared) -> None:
    """Compile in the background what a sweep of such rigs will run: of arrays the shapes count."""
    lanes = prepared.first_frequency.shape[0] * len(plan.directions)
    follow = plan.settle == "follow"
    pool_programs.compile_ahead(prepared.march, lanes, plan.max_period, follow)
    if follow and plan.refine_jumps is not None and len(plan.grid) > 1:
        compile_fold_ahead(prepared.march, lanes)
        compile_touch_ahead(prepared.march, lanes)


def sweep_rigs(
    plan: SweepPlan,
    prepared: Prepared,
    report: Callable[[int], object] = lambda count: None,
    warn: Callable[[str], object] = lambda sentence: None,
) -> Swept:
    """Sweep all rigs; `report` takes numbers of points reached, `warn` what cannot be."""
    first = np.asarray(prepared.first_frequency)
    unit = first if plan.axis == "frequency_ratio" else np.full(len(first), 2 * np.pi)
    count, ways = len(first), len(plan.directions)
    resonances = np.asarray(prepared.resonances)[..., None]
    grows = np.any(is_unbounded(resonances, unit[:, None] * plan.grid, np), axis=0)
    if grows.any():
        where = ", ".join(f"{value:.6g}" for value in plan.grid[grows])
        warn(
            f"{plan.axis} = {where}: {Status.unbounded.sentence} These points are not marched and "
            "have the status 'unbounded'. Give the rig some damping, or leave them out."
        )
    rig = np.repeat(np.arange(count), ways)
    states = prepared.march.energy_weight().shape[0]
    feed = _Grid(plan, len(rig), states, unit[rig], np.asarray(prepared.reference)[rig])
    every = np.arange(len(rig))
    pool = pool_of(plan, prepared, rig)
    pool.run(np.zeros((len(rig), states)), feed.frequency(every), feed.onwards, report, feed.ahead)
    shape = (count, ways, len(plan.grid))
    curves = {name: values.reshape(shape) for name, values in feed.curves.items()}
    settled = curves["status"] == Status.settled.value
    # What was followed has not jumped; two directions show it by each other.
    allowed = np.ones(shape, bool) if ways == 2 else curves["periods_marched"] > 0
    given = curves["amplitude_ratio"], settled, allowed, plan.directions
    found = find_jumps(*given)
    swept = Swept(curves, feed.states.reshape(*shape, states), found, first / (2 * np.pi))
    at_grid = plan.grid, swept.states, curves["contact_force"]
    found.begin(*at_grid)
    if plan.refine_jumps is None:
        found.drop(found.doubtful)
        return swept
    refine(plan, plan.refine_jumps, prepared, swept, unit)
    for _ in range(FURTHER):
        if not found.dropped.any():
            break
        lanes = np.nonzero(found.dropped)
        allowed[(*lanes, found.after[lanes])] = False
        others = find_jumps(*given)
        others.begin(*at_grid)
        others.drop(~found.dropped)
        refine(plan, plan.refine_jumps, prepared, swept._replace(jumps=others), unit)
        found.take(others)
    return swept


def numbers_of_jumps(swept: Swept) -> dict[str, Any]:
    """Return the brackets of the jumps (rigs, 2), low end first, and their middles (rigs,)."""
    up, down = swept.jumps.up_and_down()
    return {
        "jump_up": up.mean(axis=-1),
        "jump_down": down.mean(axis=-1),
        "jump_up_bracket": up,
        "jump_down_bracket": down,
    }
