"""From points to branches: ratios, special points, and the result."""

import jax.numpy as jnp
import numpy as np

from vibrojax._tools.described import provenance
from vibrojax.branches.continuation import Ending
from vibrojax.branches.plan import Plan
from vibrojax.branches.points import CURVES, BranchPoints, ExactCurve, SpecialPoint
from vibrojax.branches.readings import Columns, columns_of
from vibrojax.branches.special_points import special_points
from vibrojax.branches.tracing import Traced
from vibrojax.steady.batches import take
from vibrojax.steady.paths import AbstractPath


def finish(
    plan: Plan, paths: AbstractPath, traced: list[Traced], notes: list[str]
) -> list[BranchPoints]:
    """Read the points of balanced branches, find the special ones, make the results."""
    lane = np.repeat(np.arange(len(traced)), [len(t.parameter) for t in traced])
    columns = _columns(plan, paths, traced, lane)
    good = np.isfinite(columns["amplitude_ratio"])
    own = [{n: c[(lane == k) & good] for n, c in columns.items()} for k in range(len(traced))]
    special = special_points(paths, own, plan.period)
    return [
        branch_of(
            plan,
            k,
            take(paths, np.array([k])),
            traced[k].ending,
            notes[k],
            own[k],
            points,
            ticks=traced[k].ticks,
            depth=traced[k].depth[good[lane == k]],
        )
        for k, points in enumerate(special)
    ]


def branch_of(
    plan: Plan,
    lane: int,
    path: AbstractPath,
    ending: Ending,
    note: str,
    columns: Columns,
    points: tuple[SpecialPoint, ...],
    *,
    ticks: int,
    depth: np.ndarray | None = None,
    curve: ExactCurve | None = None,
) -> BranchPoints:
    """Put the result of a lane together."""
    natural = columns.pop("natural_frequency")
    begun = len(natural) > 0
    sentence = ending.sentence if begun else "No periodic motion was found to start from."
    return BranchPoints(
        axis=plan.axis,
        special_points=points,
        period=plan.period,
        status=ending.name,
        sentence=sentence + note,
        ticks=ticks,
        exact=plan.exact,
        ratio_units=plan.ratio_units,
        natural_frequency=float(natural[0]) if begun else np.nan,
        labels=plan.labels[lane],
        range=(plan.low, plan.high),
        attributes=provenance("continuation", plan.description)
        | ({} if plan.exact else {"samples": str(plan.samples)}),
        path=path,
        depth=depth,
        curve=curve,
        isolas=(),
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
        depth = np.concatenate(alike)
        parts.append(columns_of(paths, lane[at], depth, parameter[at], plan.period))
    if not parts:
        return nothing(2 * int(take(paths, 0).at(jnp.asarray(plan.low)).equations.size))
    order = np.argsort(np.concatenate(groups))
    columns = {name: np.concatenate([p[name] for p in parts])[order] for name in parts[0]}
    return columns | {"arclength": np.concatenate([_arclength(t) for t in traced])}


def nothing(states: int) -> Columns:
    """Columns of no points."""
    names = ("values", "arclength", "natural_frequency", *CURVES)
    return {name: np.zeros(0) for name in names if name != "leading_multiplier"} | {
        "initial_state": np.zeros((0, states)),
        "floquet_multipliers": np.zeros((0, states), complex),
        "exact_points": np.zeros(0, bool),
    }


def _arclength(traced: Traced) -> np.ndarray:
    if len(traced.parameter) < 2:
        return np.zeros(len(traced.parameter))
    size = np.sqrt(np.sum(np.abs(traced.depth[:-1]) ** 2, axis=(1, 2)))
    moved = np.sqrt(np.sum(np.abs(np.diff(traced.depth, axis=0)) ** 2, axis=(1, 2)))
    step = np.hypot(moved / size, np.diff(traced.parameter))
    return np.concatenate([[0.0], np.cumsum(step)])
