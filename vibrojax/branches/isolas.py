"""Branches that a followed one is not connected to: looked for from motions that coexist with it.

Two ways lead to such motions at some values of the parameter. Marches from random states settle on
stable ones; walks in the opening of all gaps, from a motion of the branch, come by those of the
same sheet of solutions, stable or not, where they pass the gaps that the rig has. Where such walks
turn round before, they do so on a curve of folds, by the parameter and the opening: it is followed
to where it comes nearest to these gaps, as an isola may lie between two values.
"""

from collections.abc import Generator
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from vibrojax.branches.beginning import reach
from vibrojax.branches.comparing import COMPARED, SAME, relative_difference
from vibrojax.branches.exact_branches import walk_from
from vibrojax.branches.exact_results import between, columns_of_motions, motions_at
from vibrojax.branches.on_curve import Look, OnCurve, Seen, Steps
from vibrojax.branches.plan import Plan
from vibrojax.branches.points import BranchPoints
from vibrojax.branches.refining import SOLVED
from vibrojax.branches.resampling import passages_of, resample
from vibrojax.branches.side_by_side import CurveRigs, Job, run_together
from vibrojax.branches.walking import Walk
from vibrojax.steady.paths import AbstractPath, OpenedPath, localise
from vibrojax.steady.starting import settled_states

PLACES, STARTS = 12, 8
"""Values of the parameter at which it is looked for others, and random starts at each."""
INSIDE = 1e-3
"""How far the outermost are inside of the range, over it: branches may leave it close by."""
LARGEST = 4.0
"""Largest displacement of a start at a stop, over its gap and what the branch reaches."""
WIDEST = 1.5
"""Widest opening of the gaps, over twice what the branch reaches; they close by that, or until
none is left."""
MOST_POINTS = 400
"""Points of a walk in the opening."""
MOST_ROUNDS = 8
"""Times that a curve of folds is looked at anew where it seems nearest to the gaps of the rig."""
PASSED = 1e-9
"""How near to zero the opening is to come, over what it is at a point of the walk."""
NEAREST = 1e-3
"""Share of what is left to the gaps that the next look has to bring, for another one."""

Candidate = tuple[float, Float[np.ndarray, " states"]]
"""Value, and state (q, q') at drive phase 0, of a motion."""


def isolas_of(plan: Plan, branch: BranchPoints) -> list[BranchPoints]:
    """Look for branches beside one; those that are found, without special order."""
    if not len(branch.values):
        return []
    inside = INSIDE * (plan.high - plan.low)
    values = np.linspace(plan.low + inside, plan.high - inside, PLACES)
    values = values[(branch.values.min() < values) & (values < branch.values.max())]
    if not len(values):
        return []
    plan = plan._replace(labels=[branch.labels])
    rigs = CurveRigs(branch.path, plan.period)
    at = _motions_of(branch, values)
    candidates = _settled(branch.path, plan, at) + _on_sheet(branch, plan, at)
    motions = _solved(plan, rigs, candidates)
    if not motions:
        return []
    values = np.unique([value for value, *_ in motions])
    found: list[BranchPoints] = []
    known = [resample(branch, values)]
    for value, state, numbers in motions:
        at_value = {branch.axis: value}
        if any((relative_difference(each.sel(at_value), numbers) <= SAME).any() for each in known):
            continue
        other = walk_from(plan, branch.path, state, value)
        if other is not None and len(other.values) > 1:
            found.append(replace(other, labels=branch.labels))
            known.append(resample(other, values))
    return found


def _motions_of(
    branch: BranchPoints, values: Float[np.ndarray, " values"]
) -> dict[float, tuple[OnCurve, Seen]]:
    """A motion of the branch at each of the values where there is one."""
    at, which, first, _ = passages_of(branch, values)
    chosen = np.flatnonzero(which == 0)
    places = [(int(first[k]), float(values[at[k]])) for k in chosen]
    return {
        value: (motion, seen)
        for (_, value), (motion, seen) in zip(places, motions_at(branch, places), strict=True)
        if motion is not None and seen is not None
    }


def _settled(
    path: AbstractPath, plan: Plan, at: dict[float, tuple[OnCurve, Seen]]
) -> list[Candidate]:
    """March from random states: where those settle on motions of the period."""
    if not at:
        return []
    values = np.repeat(list(at), STARTS)
    lanes = np.zeros(len(values), int)
    phases = jax.device_get(localise(path, lanes, values, True)).phases
    assert phases is not None  # of linear stops
    random = np.random.default_rng(0)
    weight = np.asarray(phases.weight)
    starts = random.normal(size=weight.shape) / weight
    states = np.repeat([seen.initial_state for _, seen in at.values()], STARTS, axis=0)
    towards = "...sx,...x->...s", phases.towards_stop
    reached = [np.abs(np.einsum(*towards, s)) for s in (states, starts)]
    wanted = (np.abs(phases.gap) + reached[0]).max(axis=1) * random.uniform(
        0.3, LARGEST, len(values)
    )
    starts = starts * (wanted / reached[1].max(axis=1))[:, None]
    paths = jax.tree.map(lambda a: np.asarray(a)[lanes], path)
    settled, good = settled_states(paths, values, plan.period, True, starts)
    return [(float(v), s) for v, s in zip(values[good], settled[good], strict=True)]


class Turn(NamedTuple):
    """Where a walk in the opening turns round before it reaches the gaps of the rig."""

    value: float
    opening: float
    """m."""
    kind: tuple[Any, ...]
    """The same of all turns that are of one curve of folds."""


def _on_sheet(
    branch: BranchPoints, plan: Plan, at: dict[float, tuple[OnCurve, Seen]]
) -> list[Candidate]:
    """Motions that walks in the opening come by at some values, and between them."""
    looked_at, turns = set(at), []
    candidates: list[Candidate] = []
    for _ in range(MOST_ROUNDS):
        found, turned = _by_opening(branch, plan, at)
        candidates += found
        turns += turned
        nearest = _nearest(sorted(looked_at), turns) - looked_at
        at = _motions_of(branch, np.array(sorted(nearest)))
        if not at:
            break
        looked_at |= set(at)
    return candidates


def _nearest(looked_at: list[float], turns: list[Turn]) -> set[float]:
    """Values at which curves of folds may come nearest to the gaps of the rig."""
    curves: dict[tuple[Any, ...], dict[float, float]] = {}
    for turn in turns:
        curves.setdefault(turn.kind, {})[turn.value] = turn.opening
    values = set()
    for curve in curves.values():
        for three in zip(looked_at, looked_at[1:], looked_at[2:], strict=False):
            if not all(value in curve for value in three):
                continue
            away = [abs(curve[value]) for value in three]
            if not away[1] < min(away[0], away[2]):
                continue
            curvature, slope, least = np.polyfit(np.array(three) - three[1], away, 2)
            if slope**2 / (4 * curvature) > NEAREST * least:
                values.add(three[1] - slope / (2 * curvature))
    return values


def _by_opening(
    branch: BranchPoints, plan: Plan, at: dict[float, tuple[OnCurve, Seen]]
) -> tuple[list[Candidate], list[Turn]]:
    """Walk in the opening of all gaps from motions: what is passed where it is zero again.

    Also where the walks turn round before.
    """
    if not at:
        return [], []
    assert branch.curve is not None
    values, followed = np.array(list(at)), branch.curve.search
    local = jax.device_get(localise(branch.path, np.zeros(len(values), int), values, True))
    phases, rigs, jobs = local.phases, CurveRigs(OpenedPath(local.place), plan.period), []
    assert phases is not None  # of linear stops
    widest = np.max(np.abs(phases.gap), axis=1)
    for k, (motion, _) in enumerate(at.values()):
        state, w = motion.state / followed.unit, local.place.angular_frequency[k]
        scale = 2 * float(reach(phases, k, state, w).max()) + 1e-12
        search = replace(followed, scale=scale, asked=0)
        start = replace(motion, parameter=0.0, parameter_along=0.0)
        for way in (1.0, -1.0):
            walk = Walk(
                search, -max(scale, widest[k]), WIDEST * scale, plan.longest_step, MOST_POINTS
            )
            jobs.append(Job(_passed(walk, start, way), rigs, k, search.unit, scale))
    candidates: list[Candidate] = []
    turns: list[Turn] = []
    for job, (states, turned) in zip(jobs, run_together(jobs), strict=True):
        value = float(values[job.lane])
        candidates += [(value, state) for state in states]
        turns += [Turn(value, opening, kind) for opening, kind in turned]
    return candidates, turns


def _passed(
    walk: Walk, start: OnCurve, way: float
) -> Generator[Any, Any, tuple[list[np.ndarray], list[tuple[float, tuple[Any, ...]]]]]:
    """Walk, and return the states of motions at which the parameter is zero again.

    Also the openings at which it turns round on the way to zero, each with what distinguishes it
    from the others: the way, the stops that are touched and left, and how many turns came before.
    """
    states, turned = [], []
    begin = yield from walk.search.solve(walk.search.pinned(start, 0.0))
    if begin is None:
        return states, turned
    yield from walk.go(begin, way)
    for k, (a, b) in enumerate(pairwise(walk.points)):
        if k and a.parameter * b.parameter < 0:
            motions = [(yield from between(walk, k, 0.0))]
        elif a.parameter_along * a.parameter < 0 < b.parameter_along * b.parameter:
            opening, motions = yield from _turn(walk, k)
            if opening is not None:
                turned.append((opening, (way, a.contacts.stops, len(turned))))
        else:
            continue
        states += [seen.initial_state for _, seen in motions if seen is not None]
    return states, turned


def _turn(walk: Walk, k: int) -> Steps:
    """Return the opening at which a walk turns round behind the point k; None where none is found.

    Where that lies beyond zero, which then is passed twice before the next point, also one of the
    two motions with what was seen of it.
    """
    if walk.is_leap(k):
        return None, []
    stretch = walk.stretch(k)
    ends = zip(stretch.ends, (m.parameter_along for m in walk.points[k : k + 2]), strict=True)
    root = yield from stretch.root(lambda m: m.parameter_along, SOLVED["fold"], *ends)
    begin, fold = walk.points[k], root.motion
    if fold is None:
        return None, []
    if begin.parameter * fold.parameter > 0:
        return fold.parameter, []
    ends = (stretch.ends[0], begin.parameter), (root.place, fold.parameter)
    root = yield from stretch.root(lambda m: m.parameter, PASSED, *ends)
    if root.motion is None:
        return fold.parameter, []
    (seen,) = yield Look([root.motion])
    return fold.parameter, [(root.motion, seen)]


def _solved(
    plan: Plan, rigs: CurveRigs, candidates: list[Candidate]
) -> list[tuple[float, np.ndarray, dict[str, Any]]]:
    """Solve for motions near candidates: their values, states, and what distinguishes them."""
    if not candidates:
        return []
    (search,) = rigs.searches(candidates[0][0], plan.scale)

    def steps(value: float, state: np.ndarray) -> Steps:
        motion = yield from search.near(search.unit * state, value)
        if motion is None:
            return None, None
        (seen,) = yield Look([motion])
        return motion, seen

    jobs = [Job(steps(*each), rigs, 0, search.unit, search.scale) for each in candidates]
    both = [(m, s) for m, s in run_together(jobs) if m is not None]
    if not both:
        return []
    motions, seen = [m for m, _ in both], [s for _, s in both]
    columns = columns_of_motions(rigs.paths, 0, motions, seen, plan.period)
    numbers = [{name: columns[name][k] for name in COMPARED} for k in range(len(motions))]
    return list(zip(columns["values"].tolist(), columns["initial_state"], numbers, strict=True))
