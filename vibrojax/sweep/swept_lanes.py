"""The engine of sweeps: rigs through a grid of frequencies in each direction, then their jumps."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.results.status import LOST, Status
from vibrojax.steady import pool_programs
from vibrojax.steady.fold_ahead import FIRST_STEP, compile_fold_ahead, folds_ahead
from vibrojax.steady.lane_pool import LanePool
from vibrojax.steady.settled import Onwards, Settled, place_in_lane
from vibrojax.steady.touch_ahead import compile_touch_ahead, touches_ahead
from vibrojax.stepping.measures import ratios_of
from vibrojax.stepping.prepared_rigs import Prepared
from vibrojax.stepping.resonance import is_unbounded
from vibrojax.stepping.stepper import AbstractStepper
from vibrojax.sweep.jumps import DISTINCT, Jumps, find_jumps

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


HALVE, FIRST, RETRY, EXPAND = range(4)


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

    def __init__(
        self, leaving: "_Leaving", end: np.ndarray, settled_before: np.ndarray, width: np.ndarray
    ):
        self.low, self.high = leaving.bracket[:, 0].copy(), leaving.bracket[:, 1].copy()
        self.start, self.end, self.settled_before = leaving.amplitude.copy(), end, settled_before
        self.across = end.copy()  # at the high end
        self.state, self.unit, self.reference = leaving.state, leaving.unit, leaving.reference
        self.width, self.last = width, self.low + EXTENSIONS * (self.high - self.low)
        self.step, self.first, self.fold = width.copy(), leaving.first, leaving.fold
        self.stage = np.where(np.isnan(self.first), HALVE, FIRST)

    def jumps(self) -> np.ndarray:
        """Which lanes jump across what is left of their bracket, and do not pass it smoothly."""
        larger = np.maximum(self.start, self.across)
        return ~(np.abs(self.across - self.start) <= DISTINCT * larger)

    def trial(self, lanes: np.ndarray) -> np.ndarray:
        """Where lanes are tried next, in the unit of the bracket."""
        low, high, step = self.low[lanes], self.high[lanes], self.step[lanes]
        return np.choose(self.stage[lanes], [(low + high) / 2, self.first[lanes], high, low + step])

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
        self.high[k] = np.where(same & (stage < RETRY), self.high[k], tried)
        self.start[k] = np.where(same, value, self.start[k])
        self.across[k] = np.where(same, self.across[k], value)
        self.state[k] = np.where(same[:, None], arrived.state, self.state[k])
        self.step[k] = np.where(same & (stage == EXPAND), 2 * self.step[k], self.width[k])
        narrow = np.abs(self.high[k] - self.low[k]) <= 1.000001 * np.abs(self.width[k])
        over = np.abs(self.last[k] - self.low[k]) <= np.abs(self.step[k])
        onwards = np.where(same & (stage >= RETRY), EXPAND, np.where(narrow, RETRY, HALVE))
        done = np.where(onwards == EXPAND, over, (stage >= RETRY) & ~same & narrow)
        solved = (stage == FIRST) & ~same & np.isfinite(self.fold[k])
        for end in (self.low, self.high):
            end[k] = np.where(solved, self.fold[k], end[k])
        done |= solved
        self.stage[k] = onwards
        return Onwards(~done, self.frequency(k), self.state[k], same)


def compile_ahead(plan: SweepPlan, prepared: Prepared) -> None:
    """Compile in the background what a sweep of such rigs will run: of arrays the shapes count."""
    lanes = prepared.first_frequency.shape[0] * len(plan.directions)
    follow = plan.settle == "follow"
    pool_programs.compile_ahead(prepared.march, lanes, plan.max_period, follow)
    if follow and plan.refine_jumps is not None:
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
    pool = _pool(plan, prepared, rig)
    pool.run(np.zeros((len(rig), states)), feed.frequency(every), feed.onwards, report, feed.ahead)
    shape = (count, ways, len(plan.grid))
    curves = {name: values.reshape(shape) for name, values in feed.curves.items()}
    settled = curves["status"] == Status.settled.value
    found = find_jumps(curves["amplitude_ratio"], settled, plan.directions)
    swept = Swept(curves, feed.states.reshape(*shape, states), found, first / (2 * np.pi))
    found.begin(plan.grid, swept.states)
    if plan.refine_jumps is None:
        found.drop(found.doubtful)
    elif found.any():
        _refine(plan, plan.refine_jumps, prepared, swept, unit)
    return swept


def _pool(plan: SweepPlan, prepared: Prepared, rig: np.ndarray) -> LanePool:
    tolerance = 1e-2 * plan.tolerance
    resonances = np.asarray(prepared.resonances)[:, rig]
    follow = plan.settle == "follow"
    return LanePool(
        prepared.march, rig, resonances, tolerance, plan.max_period, plan.max_periods, follow
    )


class _Leaving(NamedTuple):
    """Motions that leave their branches, one per jump; arrays are filled in as more is known."""

    rig: Int[np.ndarray, " jumps"]
    way: Int[np.ndarray, " jumps"]
    unit: Float[np.ndarray, " jumps"]
    """Angular frequency, rad/s, of 1 on the axis."""
    reference: Float[np.ndarray, " jumps"]
    bracket: Float[np.ndarray, "jumps 2"]
    """The motion is on its branch at the first end, not at the second."""
    state: Float[np.ndarray, "jumps states"]
    """Of the motion before it leaves."""
    amplitude: Float[np.ndarray, " jumps"]
    """Ratio of that motion."""
    first: Float[np.ndarray, " jumps"]
    """Where to try first, just beyond a touch or fold; NaN for no such place."""
    fold: Float[np.ndarray, " jumps"]
    """The fold; NaN where none is known."""


def _refine(
    plan: SweepPlan, width: float, prepared: Prepared, swept: Swept, unit: np.ndarray
) -> None:
    """Narrow the brackets of all jumps.

    Those at folds are solved for, and their brackets have no width then; the others are bisected
    from the state before the jump until their brackets are as narrow as `width`. A doubtful jump is
    none where it has no fold in its bracket and passes it smoothly.
    """
    jumps, curves = swept.jumps, swept.curves
    rig, way = np.nonzero(jumps.exists)
    at = rig, way, jumps.before[rig, way]
    leaving = _Leaving(
        rig=rig,
        way=way,
        unit=unit[rig],
        reference=np.asarray(prepared.reference)[rig],
        bracket=jumps.bracket[rig, way],
        state=jumps.state[rig, way],
        amplitude=curves["amplitude_ratio"][at],
        first=np.full(len(rig), np.nan),
        fold=np.full(len(rig), np.nan),
    )
    doubtful, span = jumps.doubtful[rig, way], np.diff(leaving.bracket)[:, 0]
    scale = 1.0 if plan.axis == "frequency_ratio" else swept.natural_frequency[rig]
    parts = np.abs(span) / scale / width
    halvings = np.ceil(np.log2(np.maximum(parts, 1.0))).astype(int)
    narrow, left = span / 2.0**halvings, halvings > 0
    smooth, settled = doubtful & ~left, curves["period"][at] > 0
    if plan.settle == "follow":
        follows = np.flatnonzero(left & (curves["period"][at] == 1))
        free = curves["contact_force"][at] == 0
        ahead = np.where(doubtful, 1, EXTENSIONS) * span * leaving.unit
        left[_solve(prepared, leaving, follows, free, ahead, narrow)] = False
    k = np.flatnonzero(left)
    if len(k):
        end = curves["amplitude_ratio"][rig, way, jumps.after[rig, way]]
        own = jax.tree.map(lambda a: a[k], leaving)
        feed = _Bisection(own, end[k], settled[k], narrow[k])
        pool = _pool(plan, prepared, own.rig)
        pool.run(feed.state, feed.frequency(np.arange(len(k))), feed.onwards)
        leaving.bracket[k], leaving.state[k] = np.stack([feed.low, feed.high], axis=-1), feed.state
        smooth[k] = doubtful[k] & ~feed.jumps()
        if plan.settle == "follow":
            _solve_near(prepared, leaving, k[settled[k] & ~smooth[k] & (feed.low != feed.high)])
    jumps.bracket[rig, way], jumps.state[rig, way] = leaving.bracket, leaving.state
    none = np.zeros_like(jumps.exists)
    none[rig, way] = smooth
    jumps.drop(none)


def _solve(
    prepared: Prepared,
    leaving: _Leaving,
    follows: Int[np.ndarray, " some"],
    free: Bool[np.ndarray, " jumps"],
    ahead: Float[np.ndarray, " jumps"],
    narrow: Float[np.ndarray, " jumps"],
) -> Int[np.ndarray, " solved"]:
    """Solve for the folds at which some motions leave their branches; return who leaves there.

    A motion without contact (`free`) leaves where it touches, or at a fold close behind: from there
    it may well go to a motion next to it, which jumps later, so that it has to be tried.
    """
    march, begin, state = prepared.march, leaving.bracket[:, 0] * leaving.unit, leaving.state.copy()
    k = follows[free[follows]]
    touch = touches_ahead(march, leaving.rig[k], begin[k], ahead[k])
    there = np.isfinite(touch.angular_frequency)
    k, touch = k[there], jax.tree.map(lambda a: a[there], touch)
    begin[k], state[k] = touch.beyond, touch.state
    leaving.state[k], leaving.amplitude[k] = touch.state, touch.amplitude / leaving.reference[k]
    leaving.bracket[k, 0] = touch.angular_frequency / leaving.unit[k]
    leaving.first[k] = touch.beyond / leaving.unit[k]
    k = follows[~free[follows] | np.isfinite(leaving.first[follows])]
    fold, state = folds_ahead(march, leaving.rig[k], state[k], begin[k], ahead[k], free[k])
    solved = np.isfinite(fold)
    k, fold = k[solved], fold[solved]
    place = fold / leaving.unit[k]
    leaving.fold[k], leaving.state[k] = place, state[solved]
    leaving.first[k] = place + narrow[k]
    sure = ~free[k]
    leaving.bracket[k[sure]] = place[sure, None]
    return k[sure]


def _solve_near(prepared: Prepared, leaving: _Leaving, near: Int[np.ndarray, " some"]) -> None:
    """Solve for the folds in brackets that have been halved, where there are any."""
    low, high = leaving.bracket[near].T
    unit, state = leaving.unit[near], leaving.state[near]
    given = low * unit, (high - low) / FIRST_STEP * unit, np.zeros(len(near), bool)
    fold, state = folds_ahead(prepared.march, leaving.rig[near], state, *given)
    share = (fold / unit - low) / (high - low)
    inside = (share >= 0) & (share <= 1)
    leaving.bracket[near[inside]] = (fold / unit)[inside, None]
    leaving.state[near[inside]] = state[inside]


def before_jumps(swept: Swept) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the states from which the response jumps up and down, and whether they touch nothing.

    States have the shape (rigs, states), NaN where there is no jump.
    """
    found, jumps = {}, swept.jumps
    for name, wanted in (("jump_up", jumps.rises), ("jump_down", ~jumps.rises)):
        states = np.full((len(swept.states), swept.states.shape[-1]), np.nan)
        free = np.zeros(len(states), bool)
        rig, way = np.nonzero(jumps.exists & wanted)
        at_fold = np.diff(jumps.bracket[rig, way])[:, 0] == 0
        force = swept.curves["contact_force"][rig, way, jumps.before[rig, way]]
        states[rig], free[rig] = jumps.state[rig, way], (force == 0) & ~at_fold
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
