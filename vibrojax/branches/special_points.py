"""Folds, period doublings, Neimark-Sacker points and first touches of a traced branch.

They are found between points of the branch and refined on exact motions: a handful of motions
between the neighbours are solved at once, the place is narrowed to between two of them, and the
same again.
"""

from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from vibrojax.branches.tracing import make_exact
from vibrojax.steady.batches import in_batches, take
from vibrojax.steady.condensed import receptance
from vibrojax.steady.exact_point import ExactPoint
from vibrojax.steady.paths import AbstractPath, FrequencyPath, localise

SAMPLES = 16
"""Motions looked at in each round of refinement."""
ROUNDS = 2


class Found(NamedTuple):
    """Special points of all lanes, refined."""

    kind: list[str]
    lane: np.ndarray
    after: np.ndarray
    """Index of the branch point before which it lies."""
    parameter: np.ndarray
    point: ExactPoint
    """The motions themselves."""


def doubling_test(multipliers: np.ndarray) -> np.ndarray:
    """Zero where a multiplier is -1."""
    return np.prod(1 + multipliers, axis=-1).real


def torus_test(multipliers: np.ndarray) -> np.ndarray:
    """Zero where two multipliers have the product 1, as a pair on the unit circle has."""
    i, j = np.triu_indices(multipliers.shape[-1], 1)
    return np.prod(1 - multipliers[..., i] * multipliers[..., j], axis=-1).real


def on_circle(multipliers: np.ndarray) -> np.ndarray:
    """Whether a complex pair is on the unit circle, near enough to be no real pair."""
    near = np.abs(np.abs(multipliers) - 1) < 1e-3
    turned = np.abs(np.imag(multipliers)) > 1e-4
    return np.any(near & turned, axis=-1)


class Bracket(NamedTuple):
    """Where between the points of a branch a special one lies."""

    kind: str
    lane: int
    at: int
    """Index of the middle point (fold) or of the first of the two."""


def brackets_of(
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


def _between(depth, parameter, s):
    """Quadratic through three neighbours at -1, 0 and 1."""
    weight = np.array([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2])
    return np.einsum("k...,k->...", depth, weight), parameter @ weight


def refine(
    paths: AbstractPath,
    branches: list[tuple[np.ndarray, np.ndarray]],
    brackets: list[Bracket],
    period: int,
) -> Found | None:
    """Refine special points of branches given as (parameter, depth) of each lane."""
    usable = []
    for b in brackets:
        parameter, depth = branches[b.lane]
        middle = min(max(b.at, 1), len(parameter) - 2)
        if middle < 1:
            continue
        near = slice(middle - 1, middle + 2)
        low = -1.0 if b.kind == "fold" else float(b.at - middle)
        high = 1.0 if b.kind == "fold" else low + 1.0
        usable.append((b, parameter[near], depth[near], low, high))
    if not usable:
        return None
    lanes = np.array([u[0].lane for u in usable])
    low, high = np.array([u[3] for u in usable]), np.array([u[4] for u in usable])
    keep, best = np.ones(len(usable), bool), np.zeros(len(usable))

    def solve(places):  # (special points, places)
        count = places.shape[1]
        made = [_between(u[2], u[1], s) for u, row in zip(usable, places, strict=True) for s in row]
        depth, parameter = np.stack([m[0] for m in made]), np.array([m[1] for m in made])
        return make_exact(paths, np.repeat(lanes, count), depth, parameter, period=period)

    def look_and_narrow():
        places = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, SAMPLES)
        samples = solve(places)
        p = np.where(samples.valid, samples.parameter, np.nan).reshape(places.shape)
        m = samples.multipliers.reshape(*places.shape, -1)
        for k, (b, *_) in enumerate(usable):
            low[k], high[k], best[k], ok = _narrow(b.kind, places[k], p[k], m[k])
            keep[k] &= ok
        return places, samples, p

    for _ in range(ROUNDS - 1):
        look_and_narrow()
    places, samples, p = look_and_narrow()
    for k, (b, *_) in enumerate(usable):
        if b.kind == "fold":
            best[k] = _vertex(places[k], p[k], best[k])
    points = _or_best_sample(solve(best[:, None]), samples, SAMPLES, usable)
    keep &= points.valid
    torus = np.array([u[0].kind == "neimark_sacker" for u in usable])
    keep &= ~torus | on_circle(np.asarray(points.multipliers))
    chosen = np.flatnonzero(keep)
    # Twins: one fold seen from two brackets.
    order = sorted(chosen, key=lambda k: (lanes[k], usable[k][0].at, points.parameter[k]))
    final, seen = [], set()
    for k in order:
        key = (usable[k][0].kind, int(lanes[k]), round(float(points.parameter[k]), 9))
        if key not in seen:
            seen.add(key)
            final.append(k)
    if not final:
        return None
    index = np.array(final)
    return Found(
        kind=[usable[k][0].kind for k in final],
        lane=lanes[index],
        after=np.array([usable[k][0].at for k in final]),
        parameter=np.asarray(points.parameter)[index],
        point=take(points, index),
    )


def _or_best_sample(points, samples, count, usable) -> ExactPoint:
    """Where the last motion failed (a corner, at a touch) take the best of the samples before."""
    chosen = []
    for k, (b, *_rest) in enumerate(usable):
        rows = np.arange(k * count, (k + 1) * count)
        rows = rows[samples.valid[rows]]
        if points.valid[k] or b.kind != "fold" or len(rows) < 3:
            chosen.append(-1)
            continue
        p = samples.parameter[rows]
        up = np.max(p) - max(p[0], p[-1]) >= min(p[0], p[-1]) - np.min(p)
        chosen.append(int(rows[np.argmax(p) if up else np.argmin(p)]))
    chosen = np.array(chosen)
    take_from = np.maximum(chosen, 0)

    def pick(a, b):
        use = (chosen >= 0).reshape((-1,) + (1,) * (np.ndim(a) - 1))
        return np.where(use, b[take_from], a)

    return jax.tree.map(pick, points, samples)


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


_touch = eqx.filter_jit(jax.vmap(touch_near))


def first_touches(
    paths: AbstractPath, lane: int, parameter: np.ndarray, touching: np.ndarray
) -> list[tuple[int, float, float]]:
    """Where flight and contact meet: the point before, the parameter, the amplitude ratio."""
    change = np.flatnonzero(touching[:-1] != touching[1:])
    if not len(change):
        return []
    free = np.where(touching[change], change + 1, change)
    paths, found = jax.device_get(paths), parameter[free]
    amplitude, good = np.zeros(len(free)), np.zeros(len(free), bool)
    # A path other than that of the frequency is only known to first order near a value.
    for _ in range(1 if isinstance(paths, FrequencyPath) else 4):
        now = found

        def touch(i, now=now):
            near = localise(paths, np.full(len(i), lane), now[i], False)
            return _touch(near, jnp.asarray(now[i]))

        found, amplitude, good = in_batches(touch, len(change))
    rows = zip(change.tolist(), found.tolist(), amplitude.tolist(), good, strict=True)
    return [(i, p, a) for i, p, a, ok in rows if ok]
