"""The engine of sweeps: rigs through a grid of frequencies in each direction, then their jumps."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.results.status import LOST, Status
from vibrojax.steady import pool_programs
from vibrojax.steady.fold_ahead import compile_fold_ahead, folds_ahead
from vibrojax.steady.lane_pool import LanePool
from vibrojax.steady.settled import Onwards, Settled, place_in_lane
from vibrojax.stepping.measures import ratios_of
from vibrojax.stepping.prepared_rigs import Prepared
from vibrojax.stepping.resonance import is_unbounded
from vibrojax.stepping.stepper import AbstractStepper
from vibrojax.sweep.jumps import Jumps, find_jumps

EXTENSIONS = 4
"""Grid steps that a jump is followed beyond the one in which the sweep left its branch."""


class SweepPlan(NamedTuple):
    """What a sweep is to do, apart from the rigs it is done with."""

    axis: str
    """`frequency_ratio` or `frequency` (Hz)."""
    grid: Float[np.ndarray, " frequencies"]
    directions: tuple[str, ...]
    stepper: AbstractStepper
    tolerance: float
    max_period: int
    max_periods: int
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


def _variables(arrived: Settled, reference: Float[np.ndarray, " lanes"]) -> dict[str, np.ndarray]:
    """Return the variables of some lanes."""
    values = ratios_of(arrived.measures, arrived.window, reference)
    lost = np.isin(arrived.status, LOST)
    return {name: np.where(lost, np.nan, v) for name, v in values.items()} | {
        "period": arrived.period,
        "status": arrived.status,
        "periods_marched": arrived.periods_marched,
        "steps": arrived.steps,
    }


HALVE, RETRY, EXPAND = range(3)


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
        for name, values in _variables(arrived, self.reference[k]).items():
            if name not in self.curves:
                self.curves[name] = np.empty((len(self.visited), len(self.grid)), values.dtype)
            self.curves[name][k, at] = values
        self.states[k, at] = arrived.state
        np.add.at(self.visited, k, 1)
        going = np.ones(len(k), bool)
        return Onwards(self.visited[k] < len(self.grid), self.frequency(k), arrived.state, going)


class _Bisection:
    """Feed of lanes that jump: halve the bracket, each try starting before the jump.

    A step in frequency can make a lane jump ahead of the end of its branch. So the end behind the
    jump is tried again from next to it; where the lane stays then, it goes on in steps that grow,
    until it jumps, and the bracket is halved anew.
    """

    def __init__(self, bracket, start, end, settled_before, state, halvings, unit, reference):
        self.low, self.high = bracket[:, 0].copy(), bracket[:, 1].copy()  # before, after
        self.start, self.end, self.settled_before = start.copy(), end, settled_before
        self.state, self.unit, self.reference = state, unit, reference
        span = self.high - self.low
        self.width, self.last = span / 2.0**halvings, self.low + EXTENSIONS * span
        self.step = self.width.copy()
        self.stage = np.full(len(start), HALVE)

    def trial(self, lanes: np.ndarray) -> np.ndarray:
        """Where lanes are tried next, in the unit of the bracket."""
        low, high, step = self.low[lanes], self.high[lanes], self.step[lanes]
        return np.choose(self.stage[lanes], [(low + high) / 2, high, low + step])

    def frequency(self, lanes: np.ndarray) -> np.ndarray:
        """Angular frequency of the next try, rad/s."""
        return self.trial(lanes) * self.unit[lanes]

    def onwards(self, arrived: Settled) -> Onwards:
        """Keep the part that holds the jump."""
        k = arrived.lanes
        found, tried, stage = _variables(arrived, self.reference[k]), self.trial(k), self.stage[k]
        value = found["amplitude_ratio"]
        same = np.abs(value - self.start[k]) < np.abs(value - self.end[k])
        # Just past a fold a lane lingers near the lost branch without settling on it.
        same &= (found["period"] > 0) | ~self.settled_before[k]
        self.low[k] = np.where(same, tried, self.low[k])
        self.high[k] = np.where(same & (stage == HALVE), self.high[k], tried)
        self.start[k] = np.where(same, value, self.start[k])
        self.state[k] = np.where(same[:, None], arrived.state, self.state[k])
        self.step[k] = np.where(same & (stage == EXPAND), 2 * self.step[k], self.width[k])
        narrow = np.abs(self.high[k] - self.low[k]) <= 1.000001 * np.abs(self.width[k])
        over = np.abs(self.last[k] - self.low[k]) <= np.abs(self.step[k])
        onwards = np.where(same & (stage != HALVE), EXPAND, np.where(narrow, RETRY, HALVE))
        done = np.where(onwards == EXPAND, over, (stage != HALVE) & ~same & narrow)
        self.stage[k] = onwards
        return Onwards(~done, self.frequency(k), self.state[k], same)


def compile_ahead(plan: SweepPlan, prepared: Prepared) -> None:
    """Compile in the background what a sweep of such rigs will run: of arrays the shapes count."""
    lanes = prepared.first_frequency.shape[0] * len(plan.directions)
    follow = plan.settle == "follow"
    pool_programs.compile_ahead(prepared.march, lanes, plan.max_period, follow)
    if follow and plan.refine_jumps is not None:
        compile_fold_ahead(prepared.march, lanes)


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
    pool = _pool(plan, prepared, rig)
    pool.run(np.zeros((len(rig), states)), feed.frequency(every), feed.onwards, report, feed.ahead)
    shape = (count, ways, len(plan.grid))
    curves = {name: values.reshape(shape) for name, values in feed.curves.items()}
    settled = curves["status"] == Status.settled.value
    found = find_jumps(curves["amplitude_ratio"], settled, plan.directions)
    found.fill_brackets(plan.grid)
    swept = Swept(curves, feed.states.reshape(*shape, states), found, first / (2 * np.pi))
    if plan.refine_jumps is not None and found.any():
        _refine(plan, plan.refine_jumps, prepared, swept, unit)
    return swept


def _pool(plan: SweepPlan, prepared: Prepared, rig: np.ndarray) -> LanePool:
    tolerance = 1e-2 * plan.tolerance
    resonances = np.asarray(prepared.resonances)[:, rig]
    follow = plan.settle == "follow"
    return LanePool(
        prepared.march, rig, resonances, tolerance, plan.max_period, plan.max_periods, follow
    )


def _refine(
    plan: SweepPlan, width: float, prepared: Prepared, swept: Swept, unit: np.ndarray
) -> None:
    """Narrow the brackets of all jumps.

    Those at folds are solved for, and their brackets have no width then; the others are bisected
    from the state before the jump until their brackets are as narrow as `width`.
    """
    rig, way = np.nonzero(swept.jumps.exists)
    bracket, at = swept.jumps.bracket[rig, way], (rig, way, swept.jumps.before[rig, way])
    scale = 1.0 if plan.axis == "frequency_ratio" else swept.natural_frequency[rig]
    parts = np.abs(bracket[:, 1] - bracket[:, 0]) / scale / width
    halvings = np.ceil(np.log2(np.maximum(parts, 1.0))).astype(int)
    if plan.settle == "follow":
        touches = swept.curves["contact_force"][at] > 0
        k = np.flatnonzero((halvings > 0) & touches & (swept.curves["period"][at] == 1))
        start = bracket[k, 0] * unit[rig[k]]
        ahead = EXTENSIONS * (bracket[k, 1] * unit[rig[k]] - start)
        fold = folds_ahead(prepared.march, rig[k], swept.states[at][k], start, ahead)
        solved = np.isfinite(fold)
        bracket[k[solved]] = (fold / unit[rig[k]])[solved, None]
        halvings[k[solved]] = 0
    k = np.flatnonzero(halvings > 0)
    if len(k):
        bracket[k] = _bisected(plan, prepared, swept, unit, rig[k], way[k], halvings[k])
    brackets = np.array(swept.jumps.bracket)
    brackets[rig, way] = bracket
    swept.jumps.set_brackets(brackets[..., 0], brackets[..., 1])


def _bisected(
    plan: SweepPlan,
    prepared: Prepared,
    swept: Swept,
    unit: Float[np.ndarray, " rigs"],
    rig: Int[np.ndarray, " jumps"],
    way: Int[np.ndarray, " jumps"],
    halvings: Int[np.ndarray, " jumps"],
) -> Float[np.ndarray, "jumps 2"]:
    """Halve brackets of jumps so many times; (before, after) of each."""
    at = rig, way, swept.jumps.before[rig, way]
    amplitude = swept.curves["amplitude_ratio"]
    feed = _Bisection(
        swept.jumps.bracket[rig, way],
        amplitude[at],
        amplitude[rig, way, swept.jumps.after[rig, way]],
        swept.curves["period"][at] > 0,
        swept.states[at].copy(),
        halvings,
        unit[rig],
        np.asarray(prepared.reference)[rig],
    )
    _pool(plan, prepared, rig).run(feed.state, feed.frequency(np.arange(len(rig))), feed.onwards)
    return np.stack([feed.low, feed.high], axis=-1)


def before_jumps(swept: Swept) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the states from which the response jumps up and down, and whether they touch nothing.

    States have the shape (rigs, states), NaN where there is no jump.
    """
    found = {}
    for name, wanted in (("jump_up", swept.jumps.rises), ("jump_down", ~swept.jumps.rises)):
        states = np.full((len(swept.states), swept.states.shape[-1]), np.nan)
        free = np.zeros(len(states), bool)
        rig, way = np.nonzero(swept.jumps.exists & wanted)
        at = rig, way, swept.jumps.before[rig, way]
        states[rig], free[rig] = swept.states[at], swept.curves["contact_force"][at] == 0
        found[name] = states, free
    return found


def numbers_of_jumps(swept: Swept) -> dict[str, Any]:
    """Return the brackets of the jumps (rigs, 2), low end first, and their middles (rigs,)."""
    up, down = swept.jumps.up_and_down()
    return {
        "jump_up": up.mean(axis=-1),
        "jump_down": down.mean(axis=-1),
        "jump_up_bracket": up,
        "jump_down_bracket": down,
    }
