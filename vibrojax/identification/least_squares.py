"""Least squares for many starts at once, with the model evaluated outside of the solver.

A model that follows a curve runs on the host, lanes filling each other's places, so it cannot be
called from inside a compiled loop. optimistix steps its solvers singly; each step sees the
residual as what it is to first order at the point it asks for.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx

from vibrojax._tools.checks import check_count
from vibrojax._tools.signatures import validated

Evaluate = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From points (lanes by unknowns) and the index of their starts to residuals and Jacobians."""
PATIENCE = 4
"""Evaluations without a gain after which a start has ended."""
JACOBIAN = {"jac": "bwd"}
"""Of an affine function, so either way costs nothing; this one can be stacked along lanes."""


class Found(NamedTuple):
    """Where the starts of a search ended."""

    point: np.ndarray
    cost: np.ndarray
    """Sum of squares."""
    converged: np.ndarray
    evaluations: np.ndarray


@runtime_checkable
class Search(Protocol):
    """A way to minimise."""

    def __call__(
        self,
        evaluate: Evaluate,
        start: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        tolerance: float,
    ) -> Found:
        """Search from every start, within the bounds."""
        ...


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


@eqx.filter_jit
def _begin(solver, start, args):
    def one(point, args):
        shape = jax.eval_shape(lambda: _affine(point, args)[0])
        return solver.init(_affine, point, args, JACOBIAN, shape, None, frozenset())

    return jax.vmap(one)(start, args)


@eqx.filter_jit
def _step(solver, point, state, args):
    def one(point, state, args):
        point, state, _ = solver.step(_affine, point, args, JACOBIAN, state, frozenset())
        done, _ = solver.terminate(_affine, point, args, JACOBIAN, state, frozenset())
        return point, state, done

    return jax.vmap(one)(point, state, args)


def _decrement(residual: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """By how much the sum of squares would still fall, to first order."""
    falls = []
    for r, j in zip(residual, jacobian, strict=True):
        step = np.linalg.lstsq(j, r, rcond=1e-12)[0]
        falls.append(r @ j @ step)
    return np.array(falls)


def _held(point, jacobian, residual, low, high):
    """Leave out of the Jacobian what is at a bound and would leave it."""
    slope = np.einsum("lrp,lr->lp", jacobian, residual)
    out = ((point <= low) & (slope > 0)) | ((point >= high) & (slope < 0))
    return np.where(out[:, None, :], 0.0, jacobian)


@validated
class LevenbergMarquardt:
    """optimistix.LevenbergMarquardt, within bounds, for many starts.

    Parameters:
        most_steps: steps from a start before it is given up.
        solver: a class of optimistix to make the solver from, called with rtol and atol.

    Raises `ValueError` for fewer than one step.
    """

    most_steps: int
    solver: Callable[..., Any]

    def __init__(
        self, most_steps: int = 60, solver: Callable[..., Any] = optx.LevenbergMarquardt
    ) -> None:
        check_count("most_steps", most_steps)
        self.most_steps, self.solver = most_steps, solver

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
        cost = np.full(lanes, np.inf)
        count = np.zeros(lanes, int)
        idle = np.zeros(lanes, int)
        done = np.zeros(lanes, bool)
        args = (
            np.zeros((lanes, unknowns + 1)),
            np.zeros((lanes, unknowns + 1, unknowns)),
            best,
        )
        state = _begin(solver, jnp.asarray(best), jax.tree.map(jnp.asarray, args))
        point = jnp.asarray(best)
        for _ in range(self.most_steps):
            asked = np.clip(np.asarray(state.y_eval), low, high)
            state = eqx.tree_at(lambda s: s.y_eval, state, jnp.asarray(asked))
            active = np.flatnonzero(~done)
            residual, jacobian = evaluate(asked[active], active)
            size = np.sum(residual**2, axis=1)
            better = size < cost[active]
            gained = cost[active] - size > tolerance
            idle[active] = np.where(gained, 0, idle[active] + 1)
            best[active[better]] = asked[active[better]]
            cost[active] = np.minimum(cost[active], size)
            count[active] += 1
            jacobian = _held(asked[active], jacobian, residual, low, high)
            reduced = _reduced(residual, jacobian)
            for a, b in zip(args, (*reduced, asked[active]), strict=True):
                a[active] = b
            point, state, stopped = _step(solver, point, state, jax.tree.map(jnp.asarray, args))
            # Next to the minimum a step can be refused for rounding; there is nothing to gain.
            done[active] |= better & (_decrement(residual, jacobian) < tolerance)
            done |= np.asarray(stopped) | (idle >= PATIENCE)
            if done.all():
                break
        return Found(best, cost, done, count)

    def __repr__(self) -> str:
        solver = getattr(self.solver, "__qualname__", repr(self.solver))
        return f"LevenbergMarquardt(most_steps={self.most_steps}, solver={solver})"


@validated
class Optax:
    """Any optax optimiser on half the sum of squares, for many starts.

    Parameters:
        optimiser: an optax transformation, such as `optax.adam(0.05)`; the numbers it moves are
            scaled as the `transforms` of `identify` say.
        steps: steps from a start before it is given up.

    Raises `ValueError` for fewer than one step.
    """

    optimiser: optax.GradientTransformation
    steps: int

    def __init__(self, optimiser: optax.GradientTransformation, steps: int = 200) -> None:
        check_count("steps", steps)
        self.optimiser, self.steps = optimiser, steps

    def __call__(
        self,
        evaluate: Evaluate,
        start: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        tolerance: float,
    ) -> Found:
        """Take steps until none of them moves a point by more than the tolerance."""
        point = jnp.clip(jnp.asarray(start), low, high)
        best, cost = np.array(point), np.full(len(start), np.inf)
        update = jax.jit(jax.vmap(self.optimiser.update))
        state = jax.vmap(self.optimiser.init)(point)
        moved = np.full(len(start), np.inf)
        taken = 0
        while taken < self.steps and (moved > tolerance).any():
            residual, jacobian = evaluate(np.asarray(point), np.arange(len(start)))
            size = np.sum(residual**2, axis=1)
            better = size < cost
            best[better], cost[better] = np.asarray(point)[better], size[better]
            gradient = jnp.asarray(np.einsum("lrp,lr->lp", jacobian, residual))
            change, state = update(gradient, state, point)
            after = jnp.clip(point + change, low, high)
            moved = np.max(np.abs(np.asarray(after - point)), axis=1)
            point, taken = after, taken + 1
        return Found(best, cost, moved <= tolerance, np.full(len(start), taken))

    def __repr__(self) -> str:
        # An optax transformation is a pair of nameless functions.
        return f"Optax(optimiser={type(self.optimiser).__name__}, steps={self.steps})"
