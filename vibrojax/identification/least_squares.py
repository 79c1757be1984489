"""Least squares for many starts at once, with the model evaluated outside of the solver.

A model that follows a curve runs on the host, lanes filling each other's places, so it cannot be
called from inside a compiled loop. optimistix steps its solvers singly; each step sees the
residual as what it is to first order at the point it asks for.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx

from vibrojax._tools.checks import check_count
from vibrojax._tools.compiled import compiled
from vibrojax._tools.signatures import validated
from vibrojax.steady.batches import filled_up

Evaluate = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From points (lanes by unknowns) and the index of their starts to residuals and Jacobians."""
WIDTH = 8
"""Starts in one step; more are filled up to full widths."""
PATIENCE = 4
"""Evaluations without a gain after which a start has ended."""
JACOBIAN = {"jac": "bwd"}
"""Of an affine function, so either way costs nothing; this one can be stacked along lanes."""


class Found(NamedTuple):
    """Where the starts of a search ended."""

    point: np.ndarray
    """Starts by unknowns."""
    cost: np.ndarray
    """Sum of squares."""
    converged: np.ndarray
    evaluations: np.ndarray


Search = Callable[[Evaluate, np.ndarray, np.ndarray, np.ndarray, float], Found]
"""A way to minimise: from a model, starts, low and high bounds and a tolerance to where it ends."""


def _affine(point, args):
    residual, jacobian, origin = args
    return residual + jacobian @ (point - origin), None


def _reduced(residual: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the same least squares in as many rows as there are unknowns, and one."""
    both = np.concatenate([jacobian, residual[..., None]], axis=2)
    missing = max(both.shape[2] - both.shape[1], 0)
    both = np.pad(both, ((0, 0), (0, missing), (0, 0)))
    rows = np.asarray(np.linalg.qr(both, mode="r"))
    return rows[:, :, -1], rows[:, :, :-1]


@compiled
def _begin(solver, start, args):
    def one(point, args):
        return solver.init(_affine, point, args, JACOBIAN, args[0], None, frozenset())

    return jax.vmap(one)(start, args)


@compiled
def _step(solver, point, state, args):
    def one(point, state, args):
        point, state, _ = solver.step(_affine, point, args, JACOBIAN, state, frozenset())
        done, _ = solver.terminate(_affine, point, args, JACOBIAN, state, frozenset())
        return point, state, done

    return jax.vmap(one)(point, state, args)


@compiled
def _update(optimiser, gradient, state, point):
    return jax.vmap(optimiser.update)(gradient, state, point)


def _decrement(residual: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """By how much the sum of squares would still fall, to first order."""
    pairs = zip(residual, jacobian, strict=True)
    return np.array([r @ j @ np.linalg.lstsq(j, r, rcond=1e-12)[0] for r, j in pairs])


def _held(point, jacobian, residual, low, high):
    """Leave out of the Jacobian what is at a bound and would leave it."""
    slope = np.einsum("lrp,lr->lp", jacobian, residual)
    out = ((point <= low) & (slope > 0)) | ((point >= high) & (slope < 0))
    return np.where(out[:, None, :], 0.0, jacobian)


@validated
@dataclass(frozen=True)
class LevenbergMarquardt:
    """optimistix.LevenbergMarquardt, within bounds, for many starts.

    Raises `ValueError` for fewer than one step.
    """

    most_steps: int = 60
    """Steps from a start before it is given up."""
    solver: Callable[..., Any] = optx.LevenbergMarquardt
    """A class of optimistix to make the solver from, called with rtol and atol."""

    def __post_init__(self) -> None:
        """Check the number of steps."""
        check_count("most_steps", self.most_steps)

    def __call__(
        self,
        evaluate: Evaluate,
        start: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        tolerance: float,
    ) -> Found:
        """Search from every start; starts that are done are not evaluated again.

        `tolerance` is what the sum of squares may still fall by.
        """
        solver = self.solver(rtol=1e-8, atol=1e-8)
        lanes, unknowns = start.shape
        best = np.clip(start, low, high)
        cost, done = np.full(lanes, np.inf), np.zeros(lanes, bool)
        count, idle, failed = np.zeros((3, lanes), int)
        # Filled up with the last lane, so that the number of starts compiles nothing anew.
        filled = filled_up(lanes, WIDTH)
        full = best[filled]
        size = len(full), unknowns + 1
        args = np.zeros(size), np.zeros((*size, unknowns)), full.copy()
        point = jnp.asarray(full)
        state = _begin(solver, point, jax.tree.map(jnp.asarray, args))
        for _ in range(self.most_steps):
            asked = np.clip(np.asarray(state.y_eval), low, high)
            # On a ridge with a kink the damped step turns, but hardly becomes shorter.
            asked = best[filled] + (asked - best[filled]) / 2.0 ** failed[filled, None]
            state = eqx.tree_at(lambda s: s.y_eval, state, jnp.asarray(asked))
            active = np.flatnonzero(~done)
            residual, jacobian = evaluate(asked[active], active)
            size = np.sum(residual**2, axis=1)
            better = size < cost[active]
            failed[active] = np.where(better, 0, failed[active] + 1)
            gained = cost[active] - size > tolerance
            idle[active] = np.where(gained, 0, idle[active] + 1)
            best[active[better]] = asked[active[better]]
            cost[active] = np.minimum(cost[active], size)
            count[active] += 1
            jacobian = _held(asked[active], jacobian, residual, low, high)
            reduced = _reduced(residual, jacobian)
            for a, b in zip(args, (*reduced, asked[active]), strict=True):
                a[active] = b
                a[lanes:] = a[lanes - 1]
            point, state, stopped = _step(solver, point, state, jax.tree.map(jnp.asarray, args))
            # Next to the minimum a step can be refused for rounding; there is nothing to gain.
            done[active] |= better & (_decrement(residual, jacobian) < tolerance)
            done |= np.asarray(stopped)[:lanes] | (idle >= PATIENCE)
            if done.all():
                break
        return Found(best, cost, done, count)


@validated
@dataclass(frozen=True)
class Optax:
    """Any optax optimiser on half the sum of squares, for many starts.

    Raises `ValueError` for fewer than one step.
    """

    optimiser: optax.GradientTransformation = field(repr=False)
    """An optax transformation, such as `optax.adam(0.05)`; the numbers it moves are scaled as the
    `transforms` of `identify` say."""
    steps: int = 200
    """Steps from a start before it is given up."""

    def __post_init__(self) -> None:
        """Check the number of steps."""
        check_count("steps", self.steps)

    def __call__(
        self,
        evaluate: Evaluate,
        start: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        tolerance: float,
    ) -> Found:
        """Take steps until none of them moves a point by more than the tolerance."""
        lanes = np.arange(len(start))
        fill = filled_up(len(start), WIDTH)
        best, cost = np.clip(start, low, high), np.full(len(start), np.inf)
        point = best[fill]
        state = jax.vmap(self.optimiser.init)(jnp.asarray(point))
        moved = np.full(len(start), np.inf)
        taken = 0
        while taken < self.steps and (moved > tolerance).any():
            residual, jacobian = evaluate(point[lanes], lanes)
            size = np.sum(residual**2, axis=1)
            better = size < cost
            best[better], cost[better] = point[lanes][better], size[better]
            gradient = np.einsum("lrp,lr->lp", jacobian, residual)[fill]
            change, state = _update(self.optimiser, gradient, state, point)
            after = np.clip(point + np.asarray(change), low, high)
            moved = np.max(np.abs(after - point), axis=1)[lanes]
            point, taken = after, taken + 1
        return Found(best, cost, moved <= tolerance, np.full(len(start), taken))
