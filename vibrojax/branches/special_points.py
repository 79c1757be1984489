"""Folds, period doublings, Neimark-Sacker points and first touches of a traced branch.

They are found between points of the branch and refined on exact motions: a handful of motions
between the neighbours are solved at once, the place is narrowed to between two of them, and the
same again.
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from vibrojax._tools.compiled import compiled
from vibrojax.branches.points import SpecialPoint
from vibrojax.branches.readings import Columns, columns_of
from vibrojax.branches.tracing import make_exact, put
from vibrojax.steady.batches import in_batches, take
from vibrojax.steady.condensed import receptance
from vibrojax.steady.exact_point import ExactPoint
from vibrojax.steady.paths import AbstractPath, FrequencyPath, localise

SAMPLES = 16
"""Motions looked at in each round of refinement."""
SNAP = 2e-3
"""Largest relative distance of a fold from the touch that it is put on."""
REACH = 3
"""Farthest that the touch may lie along the branch, in points."""


def special_points(
    paths: AbstractPath, columns: list[Columns], depth: list[np.ndarray], period: int, exact: bool
) -> list[tuple[SpecialPoint, ...]]:
    """Find the special points of every branch, refined where its motions are exact."""
    points: list[list[SpecialPoint]] = [[] for _ in columns]
    brackets: list[Bracket] = []
    for k, own in enumerate(columns):
        sound = own["exact_points"] if exact else np.ones(len(own["values"]), bool)
        brackets += _brackets(k, own["values"], own["floquet_multipliers"], sound)
    if exact:
        # Lanes that fell back on another resolution have spectra of another length.
        for size in sorted({depth[b.lane].shape[-1] for b in brackets}):
            alike = [b for b in brackets if depth[b.lane].shape[-1] == size]
            for lane, point in _refined(paths, columns, depth, alike, period):
                points[lane].append(point)
    else:
        for b in brackets:
            own = columns[b.lane]
            both = own["floquet_multipliers"][b.at : b.at + 2]
            if b.kind != "neimark_sacker" or on_circle(both, 0.1, 1e-3).any():
                points[b.lane].append(_unrefined(b, own))
    for k, own in enumerate(columns):
        if period == 1 and len(own["values"]):
            points[k] += _first_touches(paths, k, own["values"], own["contact_fraction"] > 0)
        if exact:
            folds = [b.at for b in brackets if b.kind == "fold" and b.lane == k]
            points[k] = _cornered(points[k], folds, own["values"])
    return [tuple(sorted(found, key=lambda p: p.after)) for found in points]


def _special_point(kind: str, parameter: float, columns: Columns, row: int, after: int):
    return SpecialPoint(
        kind,
        float(parameter),
        float(columns["amplitude_ratio"][row]),
        float(columns["contact_force"][row]),
        columns["initial_state"][row],
        after,
    )


def doubling_test(
    multipliers: Complex[np.ndarray, "... states"],
) -> Float[np.ndarray, "..."]:
    """Zero where a multiplier is -1."""
    return np.prod(1 + multipliers, axis=-1).real


def torus_test(multipliers: Complex[np.ndarray, "... states"]) -> Float[np.ndarray, "..."]:
    """Zero where two multipliers have the product 1, as a pair on the unit circle has."""
    i, j = np.triu_indices(multipliers.shape[-1], 1)
    return np.prod(1 - multipliers[..., i] * multipliers[..., j], axis=-1).real


def on_circle(
    multipliers: Complex[np.ndarray, "... states"], near: float = 1e-3, turned: float = 1e-4
) -> Bool[np.ndarray, "..."]:
    """Whether a complex pair is on the unit circle, near enough to be no real pair."""
    close = np.abs(np.abs(multipliers) - 1) < near
    return np.any(close & (np.abs(np.imag(multipliers)) > turned), axis=-1)


class Bracket(NamedTuple):
    """Where between the points of a branch a special one lies."""

    kind: str
    lane: int
    at: int
    """Index of the middle point (fold) or of the first of the two."""


def _brackets(
    lane: int, parameter: np.ndarray, multipliers: np.ndarray, sound: np.ndarray
) -> list[Bracket]:
    """Find between which points of a branch special ones lie.

    Only `sound` points count; a gap of more than two others between them is not bridged.
    """
    found = []
    at = np.flatnonzero(sound)
    if len(at) < 3:
        return found
    step, near = np.diff(parameter[at]), np.diff(at) <= 3
    # A fold turns the parameter round; steps of round-off turn nothing.
    size = 1e-11 * np.max(np.abs(parameter), initial=0.0)
    moving = np.flatnonzero(np.abs(step) > size)
    for before, after in pairwise(moving):
        if step[before] * step[after] < 0 and near[before : after + 1].all():
            found.append(Bracket("fold", lane, int(at[after])))
    for kind, test in (("period_doubling", doubling_test), ("neimark_sacker", torus_test)):
        value = test(multipliers[at])
        for i in np.flatnonzero((value[:-1] * value[1:] < 0) & near):
            found.append(Bracket(kind, lane, int(at[i])))
    return found


def _refined(
    paths: AbstractPath,
    columns: list[Columns],
    depth: list[np.ndarray],
    brackets: list[Bracket],
    period: int,
) -> list[tuple[int, SpecialPoint]]:
    """Refine special points, each with its lane; those that are none are left out."""
    kinds, lanes = [b.kind for b in brackets], np.array([b.lane for b in brackets])
    fold = np.array(kinds) == "fold"
    at = np.array([b.at for b in brackets])
    # Places along the branch are counted in points, from the middle one of three neighbours.
    middle = np.clip(at, 1, np.array([len(columns[k]["values"]) for k in lanes]) - 2)
    near = [slice(m - 1, m + 2) for m in middle]
    three_depths = np.stack([depth[k][n] for k, n in zip(lanes, near, strict=True)])
    three_values = np.stack([columns[k]["values"][n] for k, n in zip(lanes, near, strict=True)])
    low = np.where(fold, -1.0, at - middle)
    high = np.where(fold, 1.0, low + 1.0)
    keep, best = np.ones(len(brackets), bool), np.zeros(len(brackets))

    def solve(s: Float[np.ndarray, "brackets places"]) -> ExactPoint:
        """Solve for motions from the quadratic through the neighbours at -1, 0 and 1."""
        weight = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2], axis=-1)
        depth = np.einsum("bk...,bsk->bs...", three_depths, weight)
        values = np.einsum("bk,bsk->bs", three_values, weight).ravel()
        lane = np.repeat(lanes, s.shape[1])
        return make_exact(paths, lane, depth.reshape(-1, *depth.shape[2:]), values, period=period)

    def look() -> tuple[ExactPoint, np.ndarray, np.ndarray]:
        """Solve for motions at places between the ends, and narrow the ends around the point."""
        places = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, SAMPLES)
        samples = solve(places)
        p = np.where(samples.valid, samples.parameter, np.nan).reshape(places.shape)
        m = np.asarray(samples.multipliers).reshape(*places.shape, -1)
        for k, kind in enumerate(kinds):
            low[k], high[k], best[k], seen = _narrow(kind, places[k], p[k], m[k])
            keep[k] &= seen
        return samples, places, p

    look()
    samples, places, p = look()
    for k in np.flatnonzero(fold):
        best[k] = _vertex(places[k], p[k], best[k])
    points = _or_best_sample(solve(best[:, None]), samples, fold)
    turned = on_circle(np.asarray(points.multipliers))
    keep &= points.valid & (turned | (np.array(kinds) != "neimark_sacker"))
    # One fold can be seen from two brackets.
    found: dict[tuple[str, int, float], int] = {}
    rows = np.flatnonzero(keep)
    for k in sorted(rows.tolist(), key=lambda k: (lanes[k], at[k], points.parameter[k])):
        found.setdefault((kinds[k], int(lanes[k]), round(float(points.parameter[k]), 9)), k)
    if not found:
        return []
    rows = np.array(list(found.values()))
    points = take(points, rows)
    own = columns_of(paths, lanes[rows], points.parameter, points, period)
    return [
        (lane, _special_point(kind, own["values"][j], own, j, int(at[rows[j]])))
        for j, (kind, lane, _) in enumerate(found)
    ]


def _unrefined(bracket: Bracket, columns: Columns) -> SpecialPoint:
    """Point of a balanced branch: the vertex of a parabola, or the middle of a step."""
    values, at = columns["values"], bracket.at
    if bracket.kind == "fold":
        parameter = parabola_vertex(*values[at - 1 : at + 2].tolist())
    else:
        parameter = (values[at] + values[at + 1]) / 2
    return _special_point(bracket.kind, parameter, columns, at, at)


def _or_best_sample(points: ExactPoint, samples: ExactPoint, fold: np.ndarray) -> ExactPoint:
    """Where the last motion failed (a corner, at a touch) take the best of the samples before."""
    chosen = np.full(len(fold), -1)
    for k in np.flatnonzero(fold & ~points.valid):
        rows = np.arange(k * SAMPLES, (k + 1) * SAMPLES)
        rows = rows[samples.valid[rows]]
        if len(rows) >= 3:
            p = samples.parameter[rows]
            up = np.max(p) - max(p[0], p[-1]) >= min(p[0], p[-1]) - np.min(p)
            chosen[k] = rows[np.argmax(p) if up else np.argmin(p)]
    at = np.flatnonzero(chosen >= 0)
    return put(points, take(samples, chosen[at]), at)


def _narrow(kind, place, parameter, multipliers):
    """Narrow a bracket to around the place where the parameter turns or the test changes sign.

    Returns the new bracket, the place itself as far as it is known, and whether it was seen.
    """
    good = np.isfinite(parameter)
    lost = place[0], place[-1], (place[0] + place[-1]) / 2, False
    if good.sum() < 3:
        return lost
    if kind == "fold":
        ends = parameter[good][0], parameter[good][-1]
        up = np.nanmax(parameter) - max(ends)
        down = min(ends) - np.nanmin(parameter)
        if max(up, down) <= 0:
            return lost
        at = int(np.nanargmax(parameter) if up >= down else np.nanargmin(parameter))
        return place[max(at - 1, 0)], place[min(at + 1, len(place) - 1)], place[at], True
    test = doubling_test if kind == "period_doubling" else torus_test
    value = np.where(good, test(multipliers), np.nan)
    at = np.flatnonzero(good)
    for a, b in pairwise(at):
        if value[a] * value[b] <= 0:
            share = 0.5 if value[a] == value[b] else value[a] / (value[a] - value[b])
            return place[a], place[b], place[a] + share * (place[b] - place[a]), True
    return lost


def parabola_vertex(before: float, middle: float, after: float) -> float:
    """Return the extreme of the parabola through three values at equal distances."""
    bend = before - 2 * middle + after
    return middle - (after - before) ** 2 / (8 * bend) if bend else middle


def _vertex(place, parameter, fallback):
    """Place of the extreme of a parabola through the best sample and its neighbours."""
    good = np.isfinite(parameter)
    if not good.all():
        return fallback
    turned = parameter if np.argmax(parameter) not in (0, len(place) - 1) else -parameter
    at = int(np.argmax(turned))
    if at in (0, len(place) - 1):
        return place[at]
    y, h = turned[at - 1 : at + 2], place[at + 1] - place[at]
    bend = y[0] - 2 * y[1] + y[2]
    return place[at] if bend == 0 else place[at] + h * (y[0] - y[2]) / (2 * bend)


class Touch(NamedTuple):
    """Where the contact-free motion just reaches a stop."""

    parameter: Float[Array, ""]
    amplitude_ratio: Float[Array, ""]
    found: Bool[Array, ""]


def touch_near(path: AbstractPath, parameter: Float[Array, ""]) -> Touch:
    """Solve for the touch near a parameter by Newton's method; differentiable in the path."""

    def clearance(p):
        place = path.at(p)
        zero = jnp.zeros_like(place.angular_frequency)
        amplitude = place.drive.complex_amplitude(place.angular_frequency, zero)
        table = receptance(place.equations, place.angular_frequency[None])
        reach = jnp.abs(amplitude * table.stop_from_input[:, 0])
        gaps = jnp.stack([jnp.asarray(s.gap, float) for s in place.equations.stops])
        return jnp.min((gaps - reach) / gaps)

    def newton(_, p):
        value, slope = jax.jvp(clearance, (p,), (jnp.ones_like(p),))
        return p - jnp.clip(value / jnp.where(slope == 0, 1.0, slope), -0.02, 0.02)

    p = jax.lax.fori_loop(0, 12, newton, parameter)
    place = path.at(p)
    table = receptance(place.equations, place.angular_frequency[None])
    force = place.drive.complex_amplitude(place.angular_frequency, jnp.zeros_like(p))
    reference, _ = place.drive.reference
    amplitude = jnp.abs(force * table.response_from_input[0]) / reference
    return Touch(p, amplitude, jnp.abs(clearance(p)) < 1e-9)


@compiled
def _touches_near(paths: AbstractPath, near: Float[Array, " touches"]) -> Touch:
    return jax.vmap(touch_near)(paths, near)


def _first_touches(
    paths: AbstractPath, lane: int, parameter: np.ndarray, touching: np.ndarray
) -> list[SpecialPoint]:
    """Find where flight and contact meet along a branch."""
    change = np.flatnonzero(touching[:-1] != touching[1:])
    if not len(change):
        return []
    paths, near = jax.device_get(paths), parameter[np.where(touching[change], change + 1, change)]

    def touch(i):
        here = localise(paths, np.full(len(i), lane), near[i], False)
        return _touches_near(here, jnp.asarray(near[i]))

    touches = in_batches(touch, len(change))
    # A path other than that of the frequency is only known to first order near a value.
    for _ in range(0 if isinstance(paths, FrequencyPath) else 3):
        near = touches.parameter
        touches = in_batches(touch, len(change))
    rows = zip(change.tolist(), *map(np.ndarray.tolist, touches), strict=True)
    return [SpecialPoint("grazing", p, a, 0.0, None, i) for i, p, a, good in rows if good]


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
        way = 1.0 if values[at] >= values[max(at - 1, 0) : at + 2].max() else -1.0
        extreme = values[at] if fold is None else fold.parameter
        for touch in touches:
            beyond, size = way * (touch.parameter - extreme), abs(touch.parameter)
            if abs(touch.after - at) <= REACH and -1e-9 * size < beyond < SNAP * size:
                fold = SpecialPoint("fold", touch.parameter, touch.amplitude_ratio, 0.0, None, at)
        known = [p.parameter for p in kept if p.kind == "fold"]
        if fold is not None and fold.parameter not in known:
            kept.append(fold)
    return kept
