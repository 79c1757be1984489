"""Searches of scipy, side by side: what all of them ask for is evaluated as one batch.

Each search is a thread that minimises by `scipy.optimize.minimize` and stops wherever it asks for a
design (`_tools/gathered.py`). An interrupt, or an error of the evaluation, is raised to the caller,
and each search returns the best design that it has found.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from vibrojax._tools.gathered import Stopped, gathered
from vibrojax.design.constraints import Goal
from vibrojax.design.settings import OptimiseSettings
from vibrojax.design.trials import Trial, Trials

FAILED = 1e3
"""What is answered for a design without a value, above the best one known: so that it is left."""
STRIDE = 0.1
"""Length of the first step of a search, over the range of a variable."""
AGAIN = 3
"""How often a search that is stuck begins afresh from its best design."""
SHORTER, SHORTENED, PATIENCE = 0.6, 5, 12
"""SLSQP is stuck, at a kink, where it shortens a step to this so many times without making anything
better, or where so many designs do not."""
GAIN = 1000.0
"""What counts as better then, over the tolerance."""
INSIDE = 1e-3
"""How far from the bounds a search of trust-constr begins, which stays between them."""
SCIPY = (".*outside bounds during a minimize step", "delta_grad == 0.0", "Singular Jacobian")
"""Beginnings of warnings of scipy that are of no use to a user here."""


class End(NamedTuple):
    """How a search ended."""

    search: int
    trial: Trial | None
    """The best design that it tried; None where it was stopped before the first."""
    status: str
    """converged, limit, stalled, no slope, no value, infeasible or interrupted."""
    reason: str


class _Over(Exception):
    """A search that cannot or need not go on."""

    def __init__(self, status: str, reason: str) -> None:
        self.status, self.reason = status, reason


class _Feasible(Exception):
    """Constraints are met."""


class _Stuck(Exception):
    """A search goes to and fro."""


class _Search:
    """One search, in coordinates from 0 to 1."""

    def __init__(
        self,
        number: int,
        goal: Goal,
        start: Float[np.ndarray, " numbers"],
        ask: Callable[[Float[np.ndarray, " numbers"]], Trial | None],
        settings: OptimiseSettings,
    ) -> None:
        self.number, self.goal, self.start, self.ask = number, goal, start, ask
        self.method, self.most = settings.method, settings.max_rounds
        self.tried: dict[bytes, Trial] = {}
        self.known: Trial | None = None
        """The best so far of which all that counts has a value."""
        self.seeks_feasible = False
        self.failed = FAILED
        self.mark, self.steps = (np.inf, np.inf), [0.0]
        """The rank when something last became better, and the steps tried since then."""

    def run(self) -> End:
        """Search until nothing can be made better; return how it ended."""
        try:
            reason = self._search()
            status = "converged"
        except _Over as over:
            status, reason = over.status, over.reason
        return End(self.number, self.known, status, reason)

    def _search(self) -> str:
        self._at(self.start)
        if not self._is_feasible:
            self._meet_constraints()
        for _ in range(AGAIN):
            before = self._rank()
            with suppress(_Stuck):
                found = self._minimise(
                    self._cost, self._cost_slope, self._constraints(), self.goal.tolerance
                )
                if found.success and self._is_feasible:
                    return _reason(found)
            if not self._is_feasible:
                self._meet_constraints()
            elif not self._is_better(before):
                break  # and not for a Hessian that has gone bad
        raise _Over("stalled", "Its steps become short without making it better.")

    def _meet_constraints(self) -> None:
        """Minimise how far bounds are missed. Ends the search where they cannot be met."""
        self.seeks_feasible = True
        with suppress(_Feasible):
            with suppress(_Stuck):
                tolerance = 1e-2 * self.goal.tolerance**2  # of squares
                self._minimise(self._missed, self._missed_slope, [], tolerance)
            raise _Over("infeasible", "No step brings it nearer to its constraints.")
        self.seeks_feasible = False

    def _minimise(self, cost: Any, slope: Any, constraints: list[Any], tolerance: float) -> Any:
        place = self._best.place
        self.mark, self.steps = self._rank(), [0.0]
        ends: Any = np.zeros(len(place)), np.ones(len(place))
        bounds = scipy.optimize.Bounds(*ends, keep_feasible=True)
        options: dict[str, float] = {"maxiter": 10 * self.most}
        factor = 1.0
        if self.method == "SLSQP":
            # A first step along the slope is as long as that, not to and fro between the bounds.
            size = float(np.linalg.norm(slope(place)))
            factor = STRIDE / max(size, STRIDE)
            options["ftol"] = factor * tolerance
        else:
            place = np.clip(place, INSIDE, 1.0 - INSIDE)
            options |= {"gtol": 1e-3 * tolerance, "xtol": tolerance, "barrier_tol": tolerance}
        self.failed = FAILED / factor
        return scipy.optimize.minimize(
            lambda place: factor * cost(place),
            place,
            jac=lambda place: factor * slope(place),
            bounds=bounds,
            constraints=constraints,
            method=self.method,
            options=options,
        )

    def _constraints(self) -> list[Any]:
        goal, found = self.goal, []
        for k in goal.bounded:
            bounds: Any = goal.least[k] / goal.spread[k], goal.most[k] / goal.spread[k]
            value, slope = partial(self._value, k), partial(self._slope, k)
            how: dict[str, Any] = {"jac": slope}
            found.append(scipy.optimize.NonlinearConstraint(value, *bounds, **how))
        return found

    @property
    def _best(self) -> Trial:
        if self.known is None:
            raise _Over("no value", "The design that it begins with has no value.")
        return self.known

    @property
    def _is_feasible(self) -> bool:
        return self.goal.meets(self._best.values)

    def _rank(self) -> tuple[float, float]:
        return (np.inf, np.inf) if self.known is None else self.goal.rank(self.known.values)

    def _is_better(self, than: tuple[float, float]) -> bool:
        own, least = self._rank(), GAIN * self.goal.tolerance
        return own[0] < than[0] - least * (own[0] > 0) or (
            own[0] <= than[0] and own[1] < than[1] - least
        )

    def _at(self, place: Float[np.ndarray, " numbers"]) -> Trial:
        place = np.clip(np.asarray(place, float), 0.0, 1.0)
        key = place.tobytes()
        if key not in self.tried:
            if len(self.tried) >= self.most:
                raise _Over("limit", f"It has tried {self.most} designs (max_rounds).")
            trial = self.ask(place)
            if trial is None:
                raise _Over("interrupted", "It was interrupted.")
            self.tried[key] = trial
            if self.goal.rank(trial.values) < self._rank():
                self.known = trial
            if self.seeks_feasible and self._is_feasible:
                raise _Feasible
            self._notice(float(np.linalg.norm(place - self._best.place)))
        return self.tried[key]

    def _notice(self, step: float) -> None:
        """Notice the length of a step from the best design. Raises `_Stuck` where it is in vain."""
        if self._is_better(self.mark):
            self.mark, self.steps = self._rank(), [step]
            return
        self.steps.append(step)
        last = np.array(self.steps[-SHORTENED - 1 :])
        shortened = len(last) > SHORTENED and bool((last[1:] < SHORTER * last[:-1]).all())
        if self.method == "SLSQP" and (shortened or len(self.steps) > PATIENCE):
            raise _Stuck

    def _cost(self, place: Float[np.ndarray, " numbers"]) -> float:
        trial = self._at(place)
        if self.goal.knows(trial.values):
            return self.goal.cost(trial.values)
        return self.goal.cost(self._best.values) + self.failed

    def _value(self, k: int, place: Float[np.ndarray, " numbers"]) -> float:
        trial = self._at(place)
        trial = trial if self.goal.knows(trial.values) else self._best
        return float(trial.values[k] / self.goal.spread[k])

    def _slope(self, k: int, place: Float[np.ndarray, " numbers"]) -> np.ndarray:
        trial = self._at(place)
        slope = trial.slopes[k] / self.goal.spread[k]
        if not np.isfinite(slope).all():
            why = f": {trial.note}" if trial.note else "."
            raise _Over("no slope", f"A function has no derivative at the best design{why}")
        return slope

    def _cost_slope(self, place: Float[np.ndarray, " numbers"]) -> np.ndarray:
        return self.goal.sign * self._slope(self.goal.objective, place)

    def _missed(self, place: Float[np.ndarray, " numbers"]) -> float:
        trial = self._at(place)
        if self.goal.knows(trial.values):
            return float(np.sum(self.goal.excess(trial.values) ** 2))
        return float(np.sum(self.goal.excess(self._best.values) ** 2)) + self.failed

    def _missed_slope(self, place: Float[np.ndarray, " numbers"]) -> np.ndarray:
        missed = self.goal.excess(self._at(place).values)
        parts = [2 * missed[k] * self._slope(k, place) for k in self.goal.bounded]
        return np.sum(parts, axis=0)


def _reason(found: Any) -> str:
    return str(found.message).strip().rstrip(".")


def search_side_by_side(
    trials: Trials,
    goals: Sequence[Goal],
    starts: Sequence[Float[np.ndarray, " numbers"]],
    settings: OptimiseSettings,
    *,
    first: int,
) -> list[End]:
    """Minimise from every start, each with its goal; the searches are numbered from `first`.

    After Ctrl-C, those that had not ended have the status `interrupted`. What the evaluator raises
    is raised, when all searches have ended.
    """
    ends: dict[int, End] = {}

    def run(k: int, ask: Callable[[np.ndarray], Trial]) -> None:
        def tried(place: np.ndarray) -> Trial | None:
            try:
                return ask(place)
            except Stopped:
                return None

        ends[k] = _Search(first + k, goals[k], starts[k], tried, settings).run()

    def answer(asked: dict[int, np.ndarray]) -> dict[int, Trial]:
        found = trials.evaluate(np.array(list(asked.values())), [first + k for k in asked])
        return dict(zip(asked, found, strict=True))

    with _without_advice_of_scipy(), suppress(KeyboardInterrupt):
        # After an interrupt the searches return their best designs.
        for search in gathered([partial(run, k) for k in range(len(starts))], answer):
            search.result()
    return [ends[k] for k in range(len(starts))]


@contextmanager
def _without_advice_of_scipy() -> Iterator[None]:
    with warnings.catch_warnings():
        for beginning in SCIPY:
            warnings.filterwarnings("ignore", beginning)
        yield
