"""What the system does behind points where a branch loses stability, seen by a short march."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from vibrojax.branches.points import TURNS, BranchPoints, SpecialPoint
from vibrojax.steady.batches import in_batches, take
from vibrojax.steady.growth import first_tangent
from vibrojax.steady.kinds import Regime, regime_of
from vibrojax.steady.observed import observe
from vibrojax.steady.starting import prepared

BIFURCATIONS = ("period_doubling", "neimark_sacker")
LEAVING = 1.03
"""Modulus of the leading multiplier with which a motion is left within the periods before."""
PUSH = 1e-3
"""Of the size of the motion, by which it is pushed off the branch."""
BEFORE, OBSERVED, LONGEST = 500, 160, 16
"""Drive periods marched before, and observed; longest period looked for, over the branch's."""
SIDE_BY_SIDE = 8
"""Marches in one call, where there are several: most branches have few."""
MOST = 32
"""Most points of a branch that are looked at: one between chattering motions may have hundreds."""
RETURN = 1e-5
"""Relative return that makes a period: next to a touch what branches off is very small."""


def with_what_follows(branches: list[BranchPoints]) -> list[BranchPoints]:
    """Say of the first special points where stability is lost what the system then does."""
    asked = []
    for k, branch in enumerate(branches):
        lost = [
            (k, n, *_start(branch, special, at))
            for n, special in enumerate(branch.special_points)
            if (at := _beyond(branch, special)) is not None
        ]
        asked += lost[:MOST]
    if not asked:
        return branches
    lane, number, values, states = zip(*asked, strict=True)
    own = [list(branch.special_points) for branch in branches]
    words = _marched(branches, np.array(lane), np.array(values), np.array(states))
    for k, n, value, word in zip(lane, number, values, words, strict=True):
        own[k][n] = replace(own[k][n], follows=word, follows_at=float(value))
    return [
        replace(branch, special_points=tuple(points))
        for branch, points in zip(branches, own, strict=True)
    ]


def _beyond(branch: BranchPoints, special: SpecialPoint) -> int | None:
    """Index of an unstable point behind a special point where stability is lost."""
    points, stable = branch.special_points, branch.stable
    if special.kind in TURNS:
        return None
    before, beyond = special.after, special.after + 1
    if special.kind not in BIFURCATIONS:
        # A touch is a point of the branch, and beside a fold or bifurcation not what counts.
        beyond += 1
        near = range(special.after, beyond)
        if any(p.kind in BIFURCATIONS + TURNS and p.after in near for p in points):
            return None
    if beyond >= len(stable) or stable[before] == stable[beyond]:
        return None
    way = 1 if stable[before] else -1
    at = beyond if stable[before] else before
    last = _end_of_stretch(points, special, way, len(stable))
    while at != last and not stable[at + way] and branch.leading_multiplier[at] < LEAVING:
        at += way
    return at


def _end_of_stretch(
    points: tuple[SpecialPoint, ...], special: SpecialPoint, way: int, count: int
) -> int:
    """Index of the last point on this way before the next special point."""
    if way > 0:
        return min((p.after for p in points if p.after > special.after + 1), default=count - 1)
    return max((p.after + 1 for p in points if p.after < special.after), default=0)


def _start(branch: BranchPoints, special: SpecialPoint, at: int) -> tuple[float, np.ndarray]:
    """Value and state to march from: of the point, or of a place nearer to a bifurcation."""
    value, state, modulus = branch.values[at], branch.initial_state[at], branch.leading_multiplier
    if special.kind not in BIFURCATIONS or modulus[at] <= LEAVING:
        return float(value), state
    share = (LEAVING - 1) / (modulus[at] - 1)
    value = special.parameter + share * (value - special.parameter)
    assert special.initial_state is not None  # what leaves the circle has contact
    return value, special.initial_state + share * (state - special.initial_state)


def _marched(
    branches: list[BranchPoints],
    lane: Int[np.ndarray, " marches"],
    values: Float[np.ndarray, " marches"],
    states: Float[np.ndarray, "marches states"],
) -> list[str]:
    """March from next to unstable motions of some branches, and say what they lead to."""
    exact, period = branches[0].exact, branches[0].period
    paths = jax.tree.map(lambda *a: np.concatenate(a), *(jax.device_get(b.path) for b in branches))

    def observed(index: np.ndarray) -> dict[str, jax.Array]:
        march, frequency = prepared(take(paths, lane[index]), jnp.asarray(values[index]), exact)
        weight = march.energy_weight()
        size = np.linalg.norm(states[index].T * weight, axis=0)
        start = states[index].T + PUSH * size * first_tangent(weight)
        before, limit = jnp.asarray(BEFORE * period, jnp.int32), jnp.asarray(RETURN)
        counts = OBSERVED * period, LONGEST * period
        found = observe(march, frequency, start.T, before, limit, *counts, True)
        return found | {"window": counts[0] * 2 * np.pi / frequency}

    found = in_batches(observed, len(lane), 1 if len(lane) == 1 else SIDE_BY_SIDE)
    growth = found["lyapunov_exponent"] * found["window"]
    error = found["lyapunov_standard_error"] * found["window"]
    kinds = regime_of(found["period"], growth, error, found["return_error"], RETURN, found["alive"])
    return [_word(Regime(k), int(n), period) for k, n in zip(kinds, found["period"], strict=True)]


def _word(kind: Regime, period: int, own: int) -> str:
    if kind is not Regime.periodic:
        return kind.word
    return f"another motion of period {period}" if period <= own else f"period {period}"
