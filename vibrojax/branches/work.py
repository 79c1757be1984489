"""Tracing the branches of a continuation: where they start, and what is tried when one fails."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.warn import warn
from vibrojax.branches.continuation import Ending
from vibrojax.branches.exact_branches import walk_branches, walk_from
from vibrojax.branches.finishing import finish
from vibrojax.branches.plan import Plan
from vibrojax.branches.points import BranchPoints
from vibrojax.branches.tracing import Traced
from vibrojax.model.states import ABOUT_STATES, as_state
from vibrojax.steady.batches import take
from vibrojax.steady.paths import AbstractPath
from vibrojax.steady.periodic_result import ELSEWHERE
from vibrojax.steady.starting import settled_guess


def follow_branches(plan: Plan, paths: AbstractPath) -> list[BranchPoints]:
    """Follow every lane from the low end of the range."""
    if plan.exact:
        return walk_branches(plan, paths)
    start = np.full(len(plan.labels), plan.low)
    host = jax.device_get(paths)  # from which any number of lanes is taken without compiling
    traced, notes = plan.trace(paths, start), [""] * len(start)
    lost = np.flatnonzero([not len(t.parameter) for t in traced])
    if len(lost):
        # Where no first point was found, start from where a march settles.
        guess, found = _settled(plan, take(host, lost), start[lost])
        lost = lost[found]
        again = plan.trace(take(host, lost), start[lost], guess[found]) if len(lost) else []
        for k, t in zip(lost, again, strict=True):
            traced[k], notes[k] = t, " It starts from a settled march."
    half = plan.samples // 2
    # Where the end was not reached, try other resolutions of the balance.
    for samples, kept in ((2 * plan.samples, plan.harmonics), (half, plan.harmonics), (half, 12)):
        left = [k for k, t in enumerate(traced) if t.ending is not Ending.completed]
        if not left:
            break
        again = plan.trace(take(host, np.array(left)), start[left], samples=samples, harmonics=kept)
        for k, t in zip(left, again, strict=True):
            if t.ending is Ending.completed:
                words = f"{samples} samples" + (f" and {kept} harmonics" if kept else "")
                traced[k], notes[k] = t, f" It was traced with {words}, as a fallback."
    return finish(plan, paths, traced, notes)


def follow_from(plan: Plan, paths: AbstractPath, start: Any) -> BranchPoints:
    """Follow a branch both ways from a motion inside the range."""
    if len(plan.labels) != 1:
        raise ValueError("start is for one branch: give no lists besides it.")
    try:
        if hasattr(start, "initial_state"):
            start = start, getattr(start, plan.axis)
        given, value = start
        value = float(value)
    except (TypeError, ValueError):
        raise ValueError(
            f"start must be a PeriodicResponse or (state, {plan.axis}), got {start!r}."
        ) from None
    place = eqx.filter_eval_shape(lambda p: take(p, 0).at(jnp.asarray(value)), paths)
    state = np.asarray(as_state("start", given, place.equations))
    if not plan.low <= value <= plan.high:
        raise ValueError(
            f"start has {plan.axis} = {value:g}, outside the range {plan.low:g} to {plan.high:g}."
        )
    branch = (walk_from if plan.exact else _trace_from)(plan, paths, state, value)
    if branch is None:
        raise ValueError(
            f"start is no periodic motion of period {plan.period} at {plan.axis} = "
            f"{value:g}: Newton's method did not converge from it."
        )
    weight = take(paths, 0).at(jnp.asarray(value)).equations.energy_weight
    return _with_distance(branch, state, np.asarray(weight))


def _trace_from(
    plan: Plan, paths: AbstractPath, state: np.ndarray, value: float
) -> BranchPoints | None:
    """Trace a balanced branch both ways from a motion near a state; None where there is none."""
    guess, found = _settled(plan, paths, np.array([value]), state)
    if not found[0]:
        return None
    both, ways = take(paths, np.zeros(2, int)), np.array([1.0, -1.0])
    joined, note = _joined(
        *plan.trace(both, np.full(2, value), np.repeat(guess, 2, axis=0), way=ways)
    )
    return finish(plan, paths, [joined], [note])[0]


def _settled(
    plan: Plan, paths: AbstractPath, start: np.ndarray, state: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    return settled_guess(paths, start, plan.samples * plan.period, plan.period, plan.exact, state)


def _with_distance(branch: BranchPoints, start: np.ndarray, weight: np.ndarray) -> BranchPoints:
    """Say it where a branch passes far from the state that it was to start from."""
    states = branch.initial_state * weight
    size = np.linalg.norm(states, axis=1)
    away = np.linalg.norm(states - start * weight, axis=1) / np.where(size > 0, size, 1.0)
    nearest = np.min(away, where=np.isfinite(away), initial=np.inf)
    if not len(states) or nearest <= ELSEWHERE:
        return branch
    doubt = (
        f"It passes {nearest:.2g} of its size away from the start: it may be another branch than "
        "the one meant."
    )
    warn(f"From this start: {doubt} {ABOUT_STATES}")
    return replace(branch, sentence=f"{branch.sentence} {doubt}")


def _joined(up: Traced, down: Traced) -> tuple[Traced, str]:
    """Join the two ways from a start into one branch; with a note on the way down."""
    if up.ending is Ending.closed or not len(down.parameter):
        return up, ""
    completed = up.ending is down.ending is Ending.completed
    joined = Traced(
        parameter=np.concatenate([down.parameter[::-1], up.parameter[1:]]),
        depth=np.concatenate([down.depth[::-1], up.depth[1:]]),
        direction=np.concatenate([-down.direction[::-1], up.direction[1:]]),
        ending=Ending.completed if completed else up.ending,
        ticks=up.ticks + down.ticks,
    )
    return joined, "" if completed else f" Downwards: {down.ending.sentence}"
