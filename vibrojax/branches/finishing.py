"""From traced points to branches: exact motions, special points, ratios, and the result."""

from importlib.metadata import version

import jax.numpy as jnp
import numpy as np

from vibrojax.branches.plan import Plan
from vibrojax.branches.points import CURVES, BranchPoints, SpecialPoint
from vibrojax.branches.readings import Columns, columns_of
from vibrojax.branches.special_points import special_points
from vibrojax.branches.tracing import Traced, held_from, make_exact, put
from vibrojax.steady.balanced_motion import read_all
from vibrojax.steady.batches import take
from vibrojax.steady.paths import AbstractPath


def finish(
    plan: Plan, paths: AbstractPath, traced: list[Traced], notes: list[str]
) -> list[BranchPoints]:
    """Make the points exact, find the special ones and put the result together, lane by lane."""
    lane = np.repeat(np.arange(len(traced)), [len(t.parameter) for t in traced])
    columns = _columns(plan, paths, traced, lane)
    good = np.isfinite(columns["amplitude_ratio"])
    own = [{n: c[(lane == k) & good] for n, c in columns.items()} for k in range(len(traced))]
    depth = [t.depth[good[lane == k]] for k, t in enumerate(traced)]
    special = special_points(paths, own, depth, plan.period, plan.exact)
    return [
        _branch(plan, k, take(paths, np.array([k])), traced[k], notes[k], own[k], depth[k], points)
        for k, points in enumerate(special)
    ]


def _branch(
    plan: Plan,
    lane: int,
    path: AbstractPath,
    traced: Traced,
    note: str,
    columns: Columns,
    depth: np.ndarray,
    points: tuple[SpecialPoint, ...],
) -> BranchPoints:
    natural = columns.pop("natural_frequency")
    begun = len(natural) > 0
    sentence = traced.ending.sentence if begun else "No periodic motion was found to start from."
    inexact = int(np.sum(~columns["exact_points"])) if plan.exact else 0
    if inexact:
        which = "1 point is" if inexact == 1 else f"{inexact} points are"
        note += f" {which} harmonic balance only: no exact motion was found there."
    return BranchPoints(
        axis=plan.axis,
        special_points=points,
        period=plan.period,
        status=traced.ending.name,
        sentence=sentence + note,
        ticks=traced.ticks,
        exact=plan.exact,
        ratio_units=plan.ratio_units,
        natural_frequency=float(natural[0]) if begun else np.nan,
        labels=plan.labels[lane],
        range=(plan.low, plan.high),
        attributes={
            "title": "vibrojax continuation",
            "rig": plan.description,
            "samples": str(plan.samples),
            "vibrojax_version": version("vibrojax"),
            "jax_version": version("jax"),
        },
        path=path,
        depth=depth,
        **columns,
    )


def _columns(plan: Plan, paths: AbstractPath, traced: list[Traced], lane: np.ndarray) -> Columns:
    """Read all points of all lanes; those whose spectra have the same length together."""
    size = np.array([t.depth.shape[-1] for t in traced])[lane]
    parameter = np.concatenate([t.parameter for t in traced])
    groups = [np.flatnonzero(size == each) for each in np.unique(size)]
    parts = []
    for at in groups:
        alike = [t.depth for t in traced if t.depth.shape[-1] == size[at[0]]]
        parts.append(_read(plan, paths, lane[at], np.concatenate(alike), parameter[at]))
    if not parts:
        return _nothing(2 * int(take(paths, 0).at(jnp.asarray(plan.low)).equations.size))
    order = np.argsort(np.concatenate(groups))
    columns = {name: np.concatenate([p[name] for p in parts])[order] for name in parts[0]}
    return columns | {"arclength": np.concatenate([_arclength(t) for t in traced])}


def _nothing(states: int) -> Columns:
    """Columns of no points."""
    names = ("values", "arclength", "natural_frequency", *CURVES)
    return {name: np.zeros(0) for name in names if name != "leading_multiplier"} | {
        "initial_state": np.zeros((0, states)),
        "floquet_multipliers": np.zeros((0, states), complex),
        "exact_points": np.zeros(0, bool),
    }


def _read(
    plan: Plan, paths: AbstractPath, lane: np.ndarray, depth: np.ndarray, parameter: np.ndarray
) -> Columns:
    """Read points exactly, and off the balance where that is all there is."""

    def balanced(at: np.ndarray) -> Columns:
        motion = read_all(paths, lane[at], depth[at], parameter[at], period=plan.period)
        return columns_of(paths, lane[at], parameter[at], motion, plan.period)

    def held(at: np.ndarray, near: np.ndarray):
        """Find points at their own parameters from motions of themselves or of others."""
        usable = points.valid[near] & (lane[near] == lane[at])
        at, others = at[usable], take(points, near[usable])
        return held_from(paths, lane, points, at, others, parameter, plan.period)

    if not plan.exact:
        return balanced(np.arange(len(lane)))
    ends = np.isin(parameter, (plan.low, plan.high))
    points = make_exact(paths, lane, depth, parameter, period=plan.period, hold=ends)
    # What moves across the branch can leave the range.
    left = np.flatnonzero((points.parameter < plan.low) | (points.parameter > plan.high))
    points = held(left, left)
    for way in (-1, 1):
        # Next to a touch the sampled motion can have a contact too many or too few.
        failed = np.flatnonzero(~points.valid)
        points = held(failed, np.clip(failed + way, 0, len(lane) - 1))
    failed = np.flatnonzero(~points.valid)
    values = np.where(points.valid, points.parameter, parameter)
    columns = columns_of(paths, lane, values, points, plan.period)
    return put(columns, balanced(failed), failed) if len(failed) else columns


def _arclength(traced: Traced) -> np.ndarray:
    if len(traced.parameter) < 2:
        return np.zeros(len(traced.parameter))
    size = np.sqrt(np.sum(np.abs(traced.depth[:-1]) ** 2, axis=(1, 2)))
    moved = np.sqrt(np.sum(np.abs(np.diff(traced.depth, axis=0)) ** 2, axis=(1, 2)))
    step = np.hypot(moved / size, np.diff(traced.parameter))
    return np.concatenate([[0.0], np.cumsum(step)])
