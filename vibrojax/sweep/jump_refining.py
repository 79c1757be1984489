"""Where exactly a response jumps: folds and touches solved for, all else bisected."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.steady.fold_ahead import folds_ahead, folds_within
from vibrojax.steady.settled import Onwards, Settled
from vibrojax.steady.touch_ahead import touches_ahead
from vibrojax.stepping.prepared_rigs import Prepared
from vibrojax.sweep.jumps import DISTINCT
from vibrojax.sweep.plan import SweepPlan, Swept, pool_of, variables_of

EXTENSIONS = 4
"""Grid steps that a jump is followed beyond the one in which the sweep left its branch."""
SHARE = 0.05
"""Of the change over a grid step, which a jump makes up at the least."""
CLOSER = 3
"""Halvings more where a jump is doubtful: what only is steep is less so over a smaller step."""

HALVE, FIRST, RETRY, EXPAND = range(4)
"""What is tried next; a lane that stays on its branch in the last two is beyond its bracket."""


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
    free: Bool[np.ndarray, " jumps"]
    """Whether the motion has no contact."""
    doubtful: Bool[np.ndarray, " jumps"]


class _Bisection:
    """Feed of lanes that jump: halve the bracket, each try starting before the jump.

    A step in frequency can make a lane jump ahead of the end of its branch. So the end behind the
    jump is tried again from next to it; where the lane stays then, it goes on in steps that grow,
    until it jumps, and the bracket is halved anew.
    """

    def __init__(
        self, leaving: _Leaving, end: np.ndarray, settled_before: np.ndarray, width: np.ndarray
    ):
        self.low, self.high = leaving.bracket[:, 0].copy(), leaving.bracket[:, 1].copy()
        self.start, self.end, self.settled_before = leaving.amplitude.copy(), end, settled_before
        self.across, self.whole = end.copy(), np.abs(end - self.start)  # at the high end; of all
        self.state, self.unit, self.reference = leaving.state, leaving.unit, leaving.reference
        self.free = leaving.free
        self.width, self.last = width, self.low + EXTENSIONS * (self.high - self.low)
        self.step, self.first, self.fold = width.copy(), leaving.first, leaving.fold
        self.stage = np.where(np.isnan(self.first), HALVE, FIRST)

    def jumps(self) -> np.ndarray:
        """Which lanes jump across what is left of their bracket, and do not pass it smoothly.

        Just behind a fold a lane may not have gone far yet.
        """
        least = np.maximum(DISTINCT * np.maximum(self.start, self.across), SHARE * self.whole)
        return (self.low == self.fold) | (np.abs(self.across - self.start) > least)

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
        found, tried, stage = variables_of(arrived, self.reference[k]), self.trial(k), self.stage[k]
        value = found["amplitude_ratio"]
        same = np.abs(value - self.start[k]) < np.abs(value - self.end[k])
        # Just past a fold a lane lingers near the lost branch without settling on it.
        same &= (found["period"] > 0) | ~self.settled_before[k]
        self.low[k] = np.where(same, tried, self.low[k])
        self.high[k] = np.where(same & (stage < RETRY), self.high[k], tried)
        self.start[k] = np.where(same, value, self.start[k])
        self.across[k] = np.where(same, self.across[k], value)
        self.state[k] = np.where(same[:, None], arrived.state, self.state[k])
        self.free[k] = np.where(same, found["contact_force"] == 0, self.free[k])
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


def refine(
    plan: SweepPlan, width: float, prepared: Prepared, swept: Swept, unit: np.ndarray
) -> None:
    """Narrow the brackets of all jumps.

    Those at folds are solved for, and their brackets have no width then; the others are bisected
    from the state before the jump until their brackets are as narrow as `width`. A doubtful jump is
    none where it has no fold in its bracket and passes it smoothly.
    """
    jumps, curves = swept.jumps, swept.curves
    rig, way = np.nonzero(jumps.exists)
    if not len(rig):
        return
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
        free=jumps.free[rig, way],
        doubtful=jumps.doubtful[rig, way],
    )
    doubtful, span = leaving.doubtful, np.diff(leaving.bracket)[:, 0]
    scale = 1.0 if plan.axis == "frequency_ratio" else swept.natural_frequency[rig]
    parts = np.abs(span) / scale / width
    halvings = np.ceil(np.log2(np.maximum(parts, 1.0))).astype(int)
    narrow, left = span / 2.0 ** (halvings + CLOSER * doubtful), halvings > 0
    smooth, settled = doubtful & ~left, curves["period"][at] > 0
    if plan.settle == "follow":
        follows = np.flatnonzero(left & (curves["period"][at] == 1))
        ahead = np.where(doubtful, 1, EXTENSIONS) * span * leaving.unit
        left[_solve(prepared, leaving, follows, ahead, narrow)] = False
        lingers = np.flatnonzero(left & (curves["period"][at] == 0))
        left[_solve_lingering(plan.grid, prepared, swept, leaving, lingers)] = False
    k = np.flatnonzero(left)
    if len(k):
        end = curves["amplitude_ratio"][rig, way, jumps.after[rig, way]]
        own = jax.tree.map(lambda a: a[k], leaving)
        feed = _Bisection(own, end[k], settled[k], narrow[k])
        pool = pool_of(plan, prepared, own.rig)
        pool.run(feed.state, feed.frequency(np.arange(len(k))), feed.onwards)
        leaving.bracket[k] = np.stack([feed.low, feed.high], axis=-1)
        leaving.state[k], leaving.free[k] = feed.state, feed.free
        smooth[k] = doubtful[k] & ~feed.jumps()
        if plan.settle == "follow":
            near = k[settled[k] & (feed.low != feed.high)]
            smooth[_solve_near(prepared, leaving, near)] = False
    jumps.bracket[rig, way], jumps.state[rig, way] = leaving.bracket, leaving.state
    jumps.free[rig, way] = leaving.free
    none = np.zeros_like(jumps.exists)
    none[rig, way] = smooth
    jumps.drop(none)


def _solve(
    prepared: Prepared,
    leaving: _Leaving,
    follows: Int[np.ndarray, " some"],
    ahead: Float[np.ndarray, " jumps"],
    narrow: Float[np.ndarray, " jumps"],
) -> Int[np.ndarray, " solved"]:
    """Solve for the folds at which some motions leave their branches; return who leaves there.

    A motion without contact leaves where it touches, or at a fold close behind: from there it may
    well go to a motion next to it, which jumps later, so that it has to be tried.
    """
    march, begin, state = prepared.march, leaving.bracket[:, 0] * leaving.unit, leaving.state.copy()
    free = leaving.free
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
    sure = ~(free | leaving.doubtful)[k]
    leaving.bracket[k[sure]] = place[sure, None]
    return k[sure]


def _solve_lingering(
    grid: Float[np.ndarray, " frequencies"],
    prepared: Prepared,
    swept: Swept,
    leaving: _Leaving,
    lingers: Int[np.ndarray, " some"],
) -> Int[np.ndarray, " solved"]:
    """Solve for the folds behind which motions had not settled yet; return who has one.

    Just behind a fold a motion stays long where its branch was: that ended a grid step before.
    """
    curves, jumps = swept.curves, swept.jumps
    lanes = leaving.rig[lingers], leaving.way[lingers]
    before = jumps.before[lanes]
    # At an end of the grid that is the same point, which has no period.
    earlier = np.clip(2 * before - jumps.after[lanes], 0, len(grid) - 1)
    at = (*lanes, earlier)
    k = np.flatnonzero((curves["period"][at] == 1) & (curves["contact_force"][at] > 0))
    leaves, start, end = lingers[k], grid[earlier[k]], grid[before[k]]
    rig, state, unit = leaving.rig[leaves], swept.states[at][k], leaving.unit[leaves]
    given = rig, state, start * unit, (end - start) * unit
    fold, state = folds_ahead(prepared.march, *given, np.zeros(len(k), bool))
    solved = np.isfinite(fold)
    leaves = leaves[solved]
    leaving.bracket[leaves] = (fold / unit)[solved, None]
    leaving.state[leaves], leaving.free[leaves] = state[solved], False
    return leaves


def _solve_near(
    prepared: Prepared, leaving: _Leaving, near: Int[np.ndarray, " some"]
) -> Int[np.ndarray, " solved"]:
    """Solve for the folds in brackets that have been halved; return who has one."""
    bracket, unit, state = leaving.bracket[near], leaving.unit[near], leaving.state[near]
    given = leaving.rig[near], state, bracket * unit[:, None]
    fold, state = folds_within(prepared.march, *given)
    share = (fold / unit - bracket[:, 0]) / np.diff(bracket)[:, 0]
    inside = (share >= 0) & (share <= 1)
    leaving.bracket[near[inside]] = (fold / unit)[inside, None]
    leaving.state[near[inside]] = state[inside]
    return near[inside]
