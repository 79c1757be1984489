"""Tracing the branches of a continuation: where they start, and what is tried when one fails."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.warn import warn
from vibrojax.branches.continuation import Ending, Settings, begin
from vibrojax.branches.finishing import finish
from vibrojax.branches.plan import Plan, Resolution
from vibrojax.branches.points import BranchPoints
from vibrojax.branches.tracing import Traced, free_motion, trace_branches
from vibrojax.model.states import ABOUT_STATES, as_state
from vibrojax.steady.batches import take
from vibrojax.steady.paths import AbstractPath
from vibrojax.steady.periodic_result import ELSEWHERE
from vibrojax.steady.starting import settled_guess

CONVERGED = 1e-4
"""Newton correction at which a point to be made exact counts as found; others go on to 1e-8."""


class BranchWork:
    """One continuation: its lanes and how they are traced."""

    def __init__(self, plan: Plan, paths: AbstractPath):
        self.plan, self.paths = plan, paths

    def settings(self, start: np.ndarray, direction: np.ndarray) -> Settings:
        """Return the numbers of the continuation of some lanes."""
        plan = self.plan
        # Change of the parameter that counts as much as the motion changing by its size.
        scale = (plan.high - plan.low) / 0.5
        if plan.axis == "frequency_ratio":
            scale = min(1.0, scale)
        ones = np.ones(len(start))
        return Settings(
            start=np.asarray(start, float),
            low=plan.low * ones,
            high=plan.high * ones,
            direction=direction * ones,
            scale=scale * ones,
            tolerance=np.asarray(CONVERGED if plan.exact else 1e-8),
            longest=np.asarray(float(plan.longest_step)),
        )

    def trace(
        self,
        paths: AbstractPath,
        guess: Any,
        start: np.ndarray,
        *,
        direction: np.ndarray | None = None,
        tangent: np.ndarray | None = None,
        resolution: Resolution | None = None,
    ) -> list[Traced]:
        """Trace some lanes from a guess of their motions; upwards, or as `direction` says.

        With a `tangent` the guess is on the branch already and the first step goes along it.
        """
        samples, harmonics = resolution or self.plan.resolution
        period = self.plan.period
        direction = np.ones(len(start)) if direction is None else direction
        along = None if tangent is None else np.zeros(len(start))
        return trace_branches(
            paths,
            self.settings(start, direction),
            begin(guess, start, tangent, along),
            samples=samples * period,
            period=period,
            harmonics=None if harmonics is None else harmonics * period,
            max_points=self.plan.max_points,
        )

    def finished(self, traced: list[Traced], notes: list[str]) -> list[BranchPoints]:
        """Make branches of the traces of all lanes."""
        return finish(self.plan, self.paths, traced, notes)

    def run(self) -> list[BranchPoints]:
        """Follow every lane from the low end of the range."""
        lanes = len(self.plan.labels)
        start = np.full(lanes, self.plan.low)
        traced = self._from_flight(self.paths, start, self.plan.resolution)
        notes = [""] * lanes
        self._start_from_march(traced, notes, start)
        self._fall_back(traced, notes, start)
        return self.finished(traced, notes)

    def _from_flight(
        self, paths: AbstractPath, start: np.ndarray, resolution: Resolution
    ) -> list[Traced]:
        period = self.plan.period
        guess = free_motion(paths, start, resolution.samples * period, period)
        return self.trace(paths, guess, start, resolution=resolution)

    def _settled(self, paths: AbstractPath, start: np.ndarray, state: np.ndarray | None = None):
        period = self.plan.period
        samples = self.plan.resolution.samples * period
        return settled_guess(paths, start, samples, period, self.plan.exact, state)

    def _start_from_march(self, traced: list[Traced], notes: list[str], start: np.ndarray) -> None:
        """Where no first point was found, start from where a march settles."""
        lost = np.array([k for k, t in enumerate(traced) if not len(t.parameter)], int)
        if not len(lost):
            return
        guess, found = self._settled(take(self.paths, lost), start[lost])
        lost = lost[found]
        if not len(lost):
            return
        again = self.trace(take(self.paths, lost), guess[found], start[lost])
        for k, t in zip(lost, again, strict=True):
            traced[k] = t
            notes[k] = " It starts from a settled march."

    def _fall_back(self, traced: list[Traced], notes: list[str], start: np.ndarray) -> None:
        """Where the end was not reached, try other resolutions of the balance."""
        for resolution in self.plan.fallbacks:
            left = [k for k, t in enumerate(traced) if t.ending is not Ending.completed]
            if not left:
                return
            paths = take(self.paths, np.array(left))
            again = self._from_flight(paths, start[left], resolution)
            for k, t in zip(left, again, strict=True):
                if t.ending is Ending.completed:
                    traced[k] = t
                    samples, harmonics = resolution
                    kept = f" and {harmonics} harmonics" if harmonics else ""
                    notes[k] = f" It was traced with {samples} samples{kept}, as a fallback."

    def from_start(self, start: Any) -> BranchPoints:
        """Follow a branch both ways from a motion inside the range."""
        plan = self.plan
        if len(plan.labels) != 1:
            raise ValueError("start is for one branch: give no lists besides it.")
        given, value = start_of(start, plan.axis)
        place = eqx.filter_eval_shape(lambda p: take(p, 0).at(jnp.asarray(value)), self.paths)
        state = np.asarray(as_state("start", given, place.equations))
        if not plan.low <= value <= plan.high:
            raise ValueError(
                f"start has {plan.axis} = {value:g}, outside the range {plan.low:g} to "
                f"{plan.high:g}."
            )
        guess, found = self._settled(self.paths, np.array([value]), state)
        if not found[0]:
            raise ValueError(
                f"start is no periodic motion of period {plan.period} at {plan.axis} = "
                f"{value:g}: Newton's method did not converge from it."
            )
        both = take(self.paths, np.zeros(2, int))
        ways = self.trace(
            both, np.repeat(guess, 2, axis=0), np.full(2, value), direction=np.array([1.0, -1.0])
        )
        joined, note = _joined(*ways)
        branch = self.finished([joined], [note])[0]
        weight = take(self.paths, 0).at(jnp.asarray(value)).equations.energy_weight
        return _with_distance(branch, state, np.asarray(weight))


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


def start_of(start: Any, name: str) -> tuple[Any, float]:
    """Read a start: a `PeriodicResponse`, or (state, value)."""
    if hasattr(start, "initial_state"):
        return start, float(getattr(start, name))
    try:
        state, value = start
        return state, float(value)
    except (TypeError, ValueError):
        raise ValueError(
            f"start must be a PeriodicResponse or (state, {name}), got {start!r}."
        ) from None
