"""Branches of exact motions: where they begin, their walks, and their special points."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from vibrojax.branches.beginning import doubled, free_flight, opened, reach
from vibrojax.branches.continuation import Ending
from vibrojax.branches.exact_results import columns_of_motions, curve_of, special_results
from vibrojax.branches.finishing import branch_of, nothing
from vibrojax.branches.on_curve import OnCurve, at_value
from vibrojax.branches.plan import Plan
from vibrojax.branches.points import BranchPoints
from vibrojax.branches.refining import Special, special_points_of
from vibrojax.branches.side_by_side import CurveRigs, Job, compile_ahead, run_together
from vibrojax.branches.walking import Walk
from vibrojax.steady.batches import take
from vibrojax.steady.orbit_curve import ROOM
from vibrojax.steady.paths import AbstractPath, OpenedPath, localise
from vibrojax.steady.starting import settled_states

FROM_HIGH = {
    Ending.turned_back: " Another one comes back to where the range starts.",
    Ending.stuck: " It was followed from the high end of the range.",
}
"""What is said of a branch from the high end, by how the one from the low end ended."""
INSIDE = 0.5, 0.25, 0.75
"""Shares of the range at which a branch may begin, where none does at its ends."""


def walk_branches(plan: Plan, paths: AbstractPath) -> list[BranchPoints]:
    """Walk along the branch of every lane from the low end of the range.

    Where that does not lead to the high end, the branch may be one from there; where there is none
    at either end, it is one from inside.
    """
    lanes = range(len(plan.labels))
    rigs = CurveRigs(paths, plan.period)
    compile_ahead(rigs, len(lanes))
    walks, endings, notes = _walk_through(plan, rigs, plan.low, lanes)
    left = [k for k in lanes if endings[k] in FROM_HIGH]
    if left:
        others, ended, begun = _walk_through(plan, rigs, plan.high, left)
        for k in left:
            is_first = others[k].points and not walks[k].points
            if ended[k] is Ending.completed or is_first:
                start = replace(others[k], points=others[k].points[:1], seen=others[k].seen[:1])
                walks[k] = _joined(others[k], replace(start, touches=[]))
                endings[k], notes[k] = ended[k], FROM_HIGH[endings[k]] + begun[k]
    for share in INSIDE:
        left = [k for k in lanes if not walks[k].points]
        if not left:
            break
        _, starts, begun = _starts(plan, rigs, plan.low + share * (plan.high - plan.low), left)
        for k, start in starts.items():
            walks[k], endings[k], note = _both_ways(plan, rigs, k, start)
            notes[k] = f" It was followed from the inside of the range.{begun[k]}{note}"
    return _results(plan, rigs, walks, endings, notes)


def _walk_through(
    plan: Plan, rigs: CurveRigs, value: float, lanes: Sequence[int]
) -> tuple[list[Walk], list[Ending], list[str]]:
    """Walk from one end of the range; also how that ended, and where it began."""
    walks, starts, notes = _starts(plan, rigs, value, lanes)
    way = 1.0 if value == plan.low else -1.0
    jobs = [_job(walks[k], rigs, k, walks[k].go(start, way)) for k, start in starts.items()]
    endings = [Ending.stuck] * len(walks)
    for k, ending in zip(starts, run_together(jobs), strict=True):
        endings[k] = ending
    return walks, endings, notes


def _starts(
    plan: Plan, rigs: CurveRigs, value: float, lanes: Sequence[int]
) -> tuple[list[Walk], dict[int, OnCurve], list[str]]:
    """Walks of all lanes, where those asked for begin at a value, and what is said of that."""
    walks = _walks(plan, rigs, value)
    first = [_job(walks[k], rigs, k, free_flight(walks[k].search, value)) for k in lanes]
    free = dict(zip(lanes, run_together(first), strict=True))
    starts = {k: motion for k, (motion, holds) in free.items() if holds}
    notes = [""] * len(walks)
    left = [k for k in lanes if k not in starts]
    for k, motion in _by_opening(value, rigs, walks, free, left).items():
        starts[k], notes[k] = motion, " It starts from gaps that were opened."
    left = [k for k in lanes if k not in starts]
    for k, motion in _by_settling(value, rigs, walks, left).items():
        starts[k], notes[k] = motion, " It starts from a settled march."
    return walks, starts, notes


def _both_ways(plan: Plan, rigs: CurveRigs, lane: int, start: OnCurve) -> tuple[Walk, Ending, str]:
    """Walk up and down from a motion: both as one walk, how they ended, what is said of that."""
    up, down = (_walks(plan, rigs, start.parameter)[lane] for _ in range(2))
    rises, falls = run_together(
        [_job(up, rigs, lane, up.go(start, 1.0)), _job(down, rigs, lane, down.go(start, -1.0))]
    )
    if rises is Ending.closed:
        return up, rises, ""
    completed = rises is falls is Ending.completed
    note = "" if completed else f" Downwards: {falls.sentence}"
    return _joined(down, up), Ending.completed if completed else rises, note


def walk_from(
    plan: Plan, paths: AbstractPath, state: Float[np.ndarray, " states"], value: float
) -> BranchPoints | None:
    """Walk both ways from a motion near a state; None where there is none."""
    rigs = CurveRigs(paths, plan.period)
    (walk,) = _walks(plan, rigs, value)
    (start,) = run_together(
        [_job(walk, rigs, 0, walk.search.near(walk.search.unit * state, value))]
    )
    if start is None:
        return None
    walk, ending, note = _both_ways(plan, rigs, 0, start)
    return _results(plan, rigs, [walk], [ending], [note])[0]


def walk_doubled(
    plan: Plan, paths: AbstractPath, state: Float[np.ndarray, " states"], value: float
) -> BranchPoints | None:
    """Walk along the branch of twice the period that leaves at a motion; None for none."""
    rigs, single = CurveRigs(paths, plan.period), CurveRigs(paths, plan.period // 2)
    (walk,) = _walks(plan, rigs, value)
    search = walk.search
    half = walk.anew(replace(search, whole=search.whole / 2), plan.low, plan.high)
    search.doubled = True
    steps = half.search.near(search.unit * state, value)
    (near,) = run_together([_job(half, single, 0, steps)])
    if near is None:
        return None
    (start,) = run_together([_job(walk, rigs, 0, doubled(search, near))])
    if start is None:
        return None
    (ending,) = run_together([_job(walk, rigs, 0, walk.go(start, None))])
    return _results(plan, rigs, [walk], [ending], [""])[0]


def _job(walk: Walk, rigs: CurveRigs, lane: int, steps: Any) -> Job:
    return Job(steps, rigs, lane, walk.search.unit, walk.search.scale)


def _found(jobs: dict[int, Job]) -> dict[int, Any]:
    """Run jobs of lanes to their ends; what those return that find something."""
    ends = zip(jobs, run_together(list(jobs.values())), strict=True)
    return {lane: end for lane, end in ends if end is not None}


def _walks(plan: Plan, rigs: CurveRigs, value: float) -> list[Walk]:
    return [
        Walk(search, plan.low, plan.high, plan.longest_step, plan.max_points)
        for search in rigs.searches(value, plan.scale)
    ]


def _joined(down: Walk, up: Walk) -> Walk:
    """One walk from the end of the way down to the end of the way up."""
    last = len(down.points) - 1
    ways = [0.0, *(point.way for point in down.points[:0:-1])]
    back = [
        replace(point.reversed(), way=way)
        for point, way in zip(down.points[::-1], ways, strict=True)
    ]
    touches = [t._replace(at=last - t.at, entering=not t.entering) for t in down.touches[::-1]]
    touches += [t._replace(at=last + t.at) for t in up.touches]
    search = replace(up.search, asked=up.search.asked + down.search.asked)
    return replace(
        up,
        search=search,
        points=[*back, *up.points[1:]],
        seen=[*down.seen[::-1], *up.seen[1:]],
        touches=touches,
    )


def _by_opening(
    value: float, rigs: CurveRigs, walks: list[Walk], free: dict[int, Any], left: list[int]
) -> dict[int, OnCurve]:
    """Begin where a walk from opened gaps leads to."""
    left = [k for k in left if free[k][0] is not None]
    if not left:
        return {}
    lanes = np.array(left)
    local = jax.device_get(localise(rigs.paths, lanes, np.full(len(left), value), True))
    wider = CurveRigs(OpenedPath(local.place), rigs.period)
    phases, jobs = local.phases, {}
    assert phases is not None  # of linear stops
    for i, k in enumerate(left):
        walk, motion = walks[k], free[k][0]
        state, w = motion.state / walk.search.unit, local.place.angular_frequency[i]
        beyond = float(np.max(reach(phases, i, state, w) - phases.gap[i]))
        scale = 2.0 * max(beyond, 1e-12)
        along = walk.anew(replace(walk.search, scale=scale, asked=0), 0.0, 0.0)
        jobs[k] = _job(along, wider, i, opened(along, motion, beyond))
    again = {}
    for k, end in _found(jobs).items():
        ask = at_value(end.contacts, end.times, end.state, value)
        again[k] = _job(walks[k], rigs, k, walks[k].search.solve(ask))
    return _found(again)


def _by_settling(
    value: float, rigs: CurveRigs, walks: list[Walk], left: list[int]
) -> dict[int, OnCurve]:
    """Begin where a march from rest settles."""
    if not left:
        return {}
    paths = take(rigs.paths, np.array(left))
    states, settled = settled_states(paths, np.full(len(left), value), rigs.period, True)
    jobs = {
        k: _job(walks[k], rigs, k, walks[k].search.near(walks[k].search.unit * state, value))
        for k, state, good in zip(left, states, settled, strict=True)
        if good
    }
    return _found(jobs)


def _leapt(found: list[Special]) -> str:
    """What a result says of changes of contact that were leapt over."""
    count = sum(special.kind == "contact_change" and not special.refined for special in found)
    return f" Changes of contact were leapt over {count} times." if count else ""


def crowded(walk: Walk, ending: Ending) -> str:
    """What a result says of a walk that ended at as many contacts as it has room for."""
    if ending is not Ending.stuck or not walk.points or len(walk.points[-1].times) < ROOM:
        return ""
    return f" Its last motion has {ROOM // 2} contacts in its period, as many as can be followed."


def _results(
    plan: Plan,
    rigs: CurveRigs,
    walks: list[Walk],
    endings: list[Ending],
    notes: list[str],
) -> list[BranchPoints]:
    """Find the special points of walks and make the results."""
    special = run_together(
        [_job(walk, rigs, k, special_points_of(walk)) for k, walk in enumerate(walks)]
    )
    results = []
    for k, walk in enumerate(walks):
        if walk.points:
            columns = columns_of_motions(rigs.paths, k, walk.points, walk.seen, plan.period)
            columns["arclength"] = np.cumsum([point.way for point in walk.points])
        else:
            columns = nothing(len(walk.search.unit))
        results.append(
            branch_of(
                plan,
                k,
                take(rigs.paths, np.array([k])),
                endings[k],
                notes[k] + crowded(walk, endings[k]) + _leapt(special[k]),
                columns,
                special_results(rigs.paths, k, special[k], plan.period),
                ticks=walk.search.asked,
                curve=curve_of(walk, special[k]),
            )
        )
    return results
