"""Branches of exact motions as results: their columns, and values between their points."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vibrojax.branches.continuation import LONGEST_STEP
from vibrojax.branches.on_curve import Look, OnCurve, Seen, Steps
from vibrojax.branches.points import BranchPoints, ExactCurve, SpecialPoint
from vibrojax.branches.readings import Columns, references
from vibrojax.branches.refining import Special
from vibrojax.branches.side_by_side import CurveRigs, Job, run_together
from vibrojax.branches.walking import Walk
from vibrojax.steady.paths import AbstractPath
from vibrojax.stepping.measures import Measures, ratios_of


def columns_of_motions(
    paths: AbstractPath, lane: int, motions: Sequence[OnCurve], seen: Sequence[Seen], period: int
) -> Columns:
    """Return the columns of a branch at motions that were looked at; displacements as ratios."""
    values = np.array([m.parameter for m in motions])
    reference, natural = references(paths, np.full(len(values), lane), values, True)
    measures = Measures(*np.array([s.measures.sums for s in seen]).T)
    return {
        "values": values,
        "floquet_multipliers": np.array([m.multipliers for m in motions]),
        "residual": np.array([m.error for m in motions]),
        "initial_state": np.array([s.initial_state for s in seen]),
        "exact_points": np.ones(len(values), bool),
        "natural_frequency": natural,
    } | ratios_of(measures, period, reference)


def special_results(
    paths: AbstractPath, lane: int, found: list[Special], period: int
) -> tuple[SpecialPoint, ...]:
    """Return special points as results."""
    if not found:
        return ()
    motions, seen = [s.motion for s in found], [s.seen for s in found]
    own = columns_of_motions(paths, lane, motions, seen, period)
    return tuple(
        SpecialPoint(
            kind=special.kind,
            parameter=float(own["values"][k]),
            amplitude_ratio=float(own["amplitude_ratio"][k]),
            contact_force=float(own["contact_force"][k]),
            initial_state=own["initial_state"][k] if special.motion.contacts.stops else None,
            after=special.after,
            refined=special.refined,
        )
        for k, special in enumerate(found)
    )


def curve_of(walk: Walk, found: list[Special]) -> ExactCurve:
    """What of a walk and its special points is kept with its branch."""
    specials = tuple(special.motion for special in found)
    return ExactCurve(walk.search, tuple(walk.points), tuple(walk.touches), specials)


def walk_of(curve: ExactCurve, bounds: tuple[float, float]) -> Walk:
    """Take a walk up again."""
    return Walk(
        search=replace(curve.search, asked=0),
        low=bounds[0],
        high=bounds[1],
        longest=LONGEST_STEP,
        max_points=len(curve.motions),
        points=list(curve.motions),
        touches=list(curve.touches),
    )


def motions_at(
    branch: BranchPoints, places: Sequence[tuple[int, float]]
) -> list[tuple[OnCurve | None, Seen | None]]:
    """Solve for motions at values, each behind a point of the branch; None where there is none."""
    assert branch.curve is not None
    walk, rigs = walk_of(branch.curve, branch.range), CurveRigs(branch.path, branch.period)
    unit, scale = walk.search.unit, walk.search.scale
    return run_together([Job(between(walk, *at), rigs, 0, unit, scale) for at in places])


def between(walk: Walk, first: int, value: float) -> Steps:
    """Solve for the motion at a value between the points `first` and `first` + 1."""
    a, b = walk.points[first], walk.points[first + 1]
    touch = walk.touch_in(first)
    ends = (a, b) if abs(value - a.parameter) < abs(value - b.parameter) else (b, a)
    if walk.is_leap(first):
        ask = walk.search.pinned(ends[0], value)
        motion = yield from walk.search.near(ask.state, value, ask.contacts.section)
    elif touch is None:
        # Where two stops change the order in which they are left, one end alone may lead there.
        for end in ends if a.contacts != b.contacts else ends[:1]:
            motion = yield from walk.search.solve(walk.search.pinned(end, value))
            if motion is not None and _is_within(walk, a, b, motion):
                break
        else:
            motion = yield from _by_halving(walk, first, value)
    else:
        motion = yield from _by_halving(walk, first, value)
    if motion is None:
        return None, None
    (seen,) = yield Look([motion])
    return motion, seen


def _is_within(walk: Walk, a: OnCurve, b: OnCurve, motion: OnCurve) -> bool:
    """Whether a motion lies between two of its family."""
    if not walk.search.is_sound(motion):
        return False
    near = a if motion.contacts.section == a.contacts.section else b
    way = walk.search.way(near, motion)
    slack = 1e-6 + 0.05 * b.way
    return -slack <= (way if near is a else -way) <= b.way + slack


def _by_halving(walk: Walk, first: int, value: float) -> Steps:
    """Close in on a value along the branch, then hold it."""
    ends = [walk.points[k].parameter - value for k in (first, first + 1)]
    if ends[0] * ends[1] > 0:
        return None
    stretch = walk.stretch(first)
    nodes = zip(stretch.ends, ends, strict=True)
    found = yield from stretch.root(lambda motion: motion.parameter - value, 1e-9, *nodes)
    if found.at_touch and stretch.touch is not None:
        return walk.points[stretch.touch.at]
    if found.motion is None:
        return None
    held = yield from walk.search.solve(walk.search.pinned(found.motion, value))
    if held is not None and walk.search.is_sound(held):
        return held
    return found.motion if found.solved else None
