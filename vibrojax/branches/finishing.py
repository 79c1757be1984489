"""From traced points to branches: exact motions, special points, ratios, and the result."""

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.branches.lane_paths import references
from vibrojax.branches.plan import Plan
from vibrojax.branches.points import BranchPoints, SpecialPoint
from vibrojax.branches.special_points import (
    Bracket,
    brackets_of,
    first_touches,
    parabola_vertex,
    refine,
)
from vibrojax.branches.tracing import Traced, exact_from, make_exact
from vibrojax.steady.balanced_motion import read_all
from vibrojax.steady.batches import take
from vibrojax.steady.exact_point import ExactPoint, Guess
from vibrojax.steady.paths import AbstractPath

Columns = dict[str, np.ndarray]

READ = (
    "highest",
    "lowest",
    "mean_square",
    "first_harmonic",
    "contact_force",
    "contact_fraction",
    "contacts",
    "initial_state",
    "multipliers",
    "residual",
    "parameter",
    "exact_points",
)
"""Columns read off the points."""
KEPT = (
    "arclength",
    "amplitude_ratio",
    "peak_ratio",
    "rms_ratio",
    "first_harmonic_ratio",
    "contact_force",
    "contact_fraction",
    "contacts_per_period",
    "residual",
    "initial_state",
    "exact_points",
)
"""Columns that a branch keeps under the same name."""
SNAP = 2e-3
"""Largest relative distance of a fold from the touch that it is put on."""
REACH = 3
"""Farthest that the touch may lie along the branch, in points."""


def finish(
    plan: Plan, paths: AbstractPath, traced: list[Traced], notes: list[str]
) -> list[BranchPoints]:
    """Make the points exact, find the special ones and put the result together, lane by lane."""
    lane = np.repeat(np.arange(len(traced)), [len(t.parameter) for t in traced])
    columns = _columns(plan, paths, traced, lane)
    good = np.isfinite(columns["highest"])
    rows = [np.flatnonzero((lane == k) & good) for k in range(len(traced))]
    own = [{name: c[at] for name, c in columns.items()} for at in rows]
    depth = [t.depth[good[lane == k]] for k, t in enumerate(traced)]
    specials = _special_points(plan, paths, own, depth)
    return [
        _branch(plan, k, take(paths, np.array([k])), traced[k], notes[k], own[k], depth[k], points)
        for k, points in enumerate(specials)
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
    natural = columns["natural"]
    begun = len(natural) > 0
    sentence = traced.ending.sentence if begun else "No periodic motion was found to start from."
    inexact = int(np.sum(~columns["exact_points"])) if plan.exact else 0
    if inexact:
        which = "1 point is" if inexact == 1 else f"{inexact} points are"
        note += f" {which} harmonic balance only: no exact motion was found there."
    return BranchPoints(
        axis=plan.axis,
        values=columns["parameter"],
        floquet_multipliers=columns["multipliers"],
        special_points=points,
        period=plan.period,
        status=traced.ending.name,
        sentence=sentence + note,
        ticks=traced.ticks,
        exact=plan.exact,
        ratio_units=plan.ratio_units,
        natural_frequency=float(natural[0] / 2 / np.pi) if begun else np.nan,
        labels=plan.labels[lane],
        range=(plan.low, plan.high),
        attributes={
            "title": "vibrojax continuation",
            "rig": plan.description,
            "samples": str(plan.resolution.samples),
            "vibrojax_version": version("vibrojax"),
            "jax_version": version("jax"),
        },
        path=path,
        depth=depth,
        **{name: columns[name] for name in KEPT},
    )


def _columns(plan: Plan, paths: AbstractPath, traced: list[Traced], lane: np.ndarray) -> Columns:
    """Read all points of all lanes, and put displacements into ratios."""
    if not len(lane):
        return _nothing(2 * int(take(paths, 0).at(jnp.asarray(plan.low)).equations.size))
    parameter = np.concatenate([t.parameter for t in traced])
    groups = _same_size([t.depth for t in traced])
    parts = [_read(plan, paths, lane[i], depth, parameter[i]) for i, depth in groups]
    order = np.argsort(np.concatenate([i for i, _ in groups]))
    columns = {name: np.concatenate([p[name] for p in parts])[order] for name in READ}
    reference, natural = references(paths, lane, columns["parameter"])
    arclength = np.concatenate([_arclength(t) for t in traced])
    return (
        columns
        | ratios_of(columns, reference)
        | {
            "contacts_per_period": columns["contacts"] / plan.period,
            "arclength": arclength,
            "natural": natural,
        }
    )


def _nothing(states: int) -> Columns:
    """Columns of no points."""
    columns = {name: np.zeros(0) for name in (*READ, *KEPT, "natural")}
    return columns | {
        "initial_state": np.zeros((0, states)),
        "multipliers": np.zeros((0, states), complex),
        "exact_points": np.zeros(0, bool),
    }


def ratios_of(reading: Mapping[str, Any], reference: Any) -> Columns:
    """Return the displacements of readings over the drive amplitude."""
    highest, lowest = reading["highest"], reading["lowest"]
    return {
        "amplitude_ratio": (highest - lowest) / 2 / reference,
        "peak_ratio": np.maximum(highest, -lowest) / reference,
        "rms_ratio": np.sqrt(reading["mean_square"]) / reference,
        "first_harmonic_ratio": reading["first_harmonic"] / reference,
    }


def _read(
    plan: Plan, paths: AbstractPath, lane: np.ndarray, depth: np.ndarray, parameter: np.ndarray
) -> Columns:
    """Read points exactly, and off the balance where that is all there is."""

    def balanced(at: np.ndarray) -> Columns:
        motion = read_all(paths, lane[at], depth[at], parameter[at], period=plan.period)
        columns = motion._asdict() | {
            "parameter": parameter[at],
            "exact_points": np.zeros(len(at), bool),
        }
        return {name: np.array(columns[name]) for name in READ}

    if not plan.exact:
        return balanced(np.arange(len(lane)))
    ends = np.isin(parameter, (plan.low, plan.high))
    point = make_exact(paths, lane, depth, parameter, period=plan.period, hold=ends)
    # What moves across the branch can leave the range.
    left = np.flatnonzero((point.parameter < plan.low) | (point.parameter > plan.high))
    point = _held(plan, paths, lane, parameter, point, left, left)
    for way in (-1, 1):
        # Next to a touch the sampled motion can have a contact too many or too few.
        failed = np.flatnonzero(~point.valid)
        near = np.clip(failed + way, 0, len(lane) - 1)
        point = _held(plan, paths, lane, parameter, point, failed, near)
    found = point.reading._asdict() | {
        "parameter": point.parameter,
        "multipliers": point.multipliers,
        "residual": point.residual,
        "exact_points": point.valid,
    }
    columns = {name: np.array(found[name]) for name in READ}
    columns["contacts"] = columns["contacts"].astype(float)
    failed = np.flatnonzero(~columns["exact_points"])
    if len(failed):
        for name, values in balanced(failed).items():
            columns[name][failed] = values
    return columns


def _held(
    plan: Plan,
    paths: AbstractPath,
    lane: np.ndarray,
    parameter: np.ndarray,
    point: ExactPoint,
    which: np.ndarray,
    near: np.ndarray,
) -> ExactPoint:
    """Find some points at their own parameters, each from the motion of itself or of another."""
    usable = point.valid[near] & (lane[near] == lane[which])
    which, near = which[usable], near[usable]
    if not len(which):
        return point
    events, orbit = take((point.events, point.orbit), near)
    guess = Guess(events, orbit, np.ones(len(near), bool))
    again = exact_from(paths, lane[which], guess, parameter[which], period=plan.period, hold=True)

    def put(a, b):
        a = np.array(a)
        a[which] = b
        return a

    return jax.tree.map(put, point, again)


def _same_size(depths: list[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Group points whose spectra have the same length: (index of the point, spectra)."""
    first = np.cumsum([0] + [len(d) for d in depths])
    sizes = sorted({d.shape[-1] for d in depths if len(d)})
    groups = []
    for size in sizes:
        with_size = [k for k, d in enumerate(depths) if len(d) and d.shape[-1] == size]
        index = np.concatenate([np.arange(first[k], first[k + 1]) for k in with_size])
        groups.append((index, np.concatenate([depths[k] for k in with_size])))
    return groups


def _arclength(traced: Traced) -> np.ndarray:
    if len(traced.parameter) < 2:
        return np.zeros(len(traced.parameter))
    size = np.sqrt(np.sum(np.abs(traced.depth[:-1]) ** 2, axis=(1, 2)))
    moved = np.sqrt(np.sum(np.abs(np.diff(traced.depth, axis=0)) ** 2, axis=(1, 2)))
    step = np.hypot(moved / size, np.diff(traced.parameter))
    return np.concatenate([[0.0], np.cumsum(step)])


def _special_points(
    plan: Plan, paths: AbstractPath, own: list[Columns], depth: list[np.ndarray]
) -> list[tuple[SpecialPoint, ...]]:
    """Find the special points of every branch, refined where its motions are exact."""
    brackets: list[Bracket] = []
    for k, c in enumerate(own):
        sound = c["exact_points"] if plan.exact else np.ones(len(c["parameter"]), bool)
        brackets += brackets_of(k, c["parameter"], c["multipliers"], sound)
    points: list[list[SpecialPoint]] = [[] for _ in own]
    if plan.exact:
        branches = [(c["parameter"], d) for c, d in zip(own, depth, strict=True)]
        # Lanes that fell back on another resolution have spectra of another length.
        for size in sorted({depth[b.lane].shape[-1] for b in brackets}):
            alike = [b for b in brackets if depth[b.lane].shape[-1] == size]
            found = refine(paths, branches, alike, plan.period)
            if found is None:
                continue
            for j, (kind, k) in enumerate(zip(found.kind, found.lane.tolist(), strict=True)):
                motion = take(found.point, j)
                points[k].append(_refined(paths, k, kind, int(found.after[j]), motion))
    else:
        for b in brackets:
            if b.kind != "neimark_sacker" or _turns(own[b.lane]["multipliers"][b.at : b.at + 2]):
                points[b.lane].append(_unrefined(b, own[b.lane]))
    finished = []
    for k, c in enumerate(own):
        if plan.period == 1 and len(c["parameter"]):
            touching = c["contact_fraction"] > 0
            for after, parameter, amplitude in first_touches(paths, k, c["parameter"], touching):
                points[k].append(SpecialPoint("grazing", parameter, amplitude, 0.0, None, after))
        mine = [b.at for b in brackets if b.kind == "fold" and b.lane == k]
        snapped = _cornered(points[k], mine, c["parameter"]) if plan.exact else points[k]
        finished.append(tuple(sorted(snapped, key=lambda p: p.after)))
    return finished


def _refined(
    paths: AbstractPath, lane: int, kind: str, after: int, motion: ExactPoint
) -> SpecialPoint:
    reading, parameter = motion.reading, float(motion.parameter)
    (reference,), _ = references(paths, np.array([lane]), np.array([parameter]))
    amplitude = float((reading.highest - reading.lowest) / 2 / reference)
    state = np.asarray(reading.initial_state)
    return SpecialPoint(kind, parameter, amplitude, float(reading.contact_force), state, after)


def _unrefined(bracket: Bracket, columns: Columns) -> SpecialPoint:
    """Point of a balanced branch: the vertex of a parabola, or the middle of a step."""
    values, at = columns["parameter"], bracket.at
    if bracket.kind == "fold":
        y = values[at - 1 : at + 2].tolist()
        parameter = parabola_vertex(*y)
    else:
        parameter = (values[at] + values[at + 1]) / 2
    return SpecialPoint(
        bracket.kind,
        float(parameter),
        float(columns["amplitude_ratio"][at]),
        float(columns["contact_force"][at]),
        columns["initial_state"][at],
        at,
    )


def _turns(multipliers: np.ndarray) -> bool:
    """Whether a complex pair is near the unit circle."""
    near = np.abs(np.abs(multipliers) - 1) < 0.1
    return bool(np.any(near & (np.abs(np.imag(multipliers)) > 1e-3)))


def _cornered(
    points: list[SpecialPoint], brackets: list[int], values: np.ndarray
) -> list[SpecialPoint]:
    """Put folds that are corners at a touch on the touch itself.

    Where contact begins, a branch can turn round at once: then its extreme is the touch, and no
    smooth fold beyond it was found.
    """
    touches = [p for p in points if p.kind == "grazing"]
    kept = [p for p in points if p.kind != "fold"]
    smooth = {p.after: p for p in points if p.kind == "fold"}
    for at in brackets:
        fold = smooth.get(at)
        middle, near = values[at], values[max(at - 1, 0) : at + 2]
        way = 1.0 if middle >= near.max() else -1.0
        extreme = middle if fold is None else fold.parameter
        corner = None
        for touch in touches:
            beyond = way * (touch.parameter - extreme)
            size = abs(touch.parameter)
            if abs(touch.after - at) <= REACH and -1e-9 * size < beyond < SNAP * size:
                corner = SpecialPoint("fold", touch.parameter, touch.amplitude_ratio, 0.0, None, at)
        chosen = corner or fold
        if chosen is not None and not any(
            p.kind == "fold" and p.parameter == chosen.parameter for p in kept
        ):
            kept.append(chosen)
    return kept
