"""Design by gradient: the rig that does best what it is to do, within bounds and constraints."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax._tools.interrupts import stoppable
from vibrojax._tools.signatures import validated
from vibrojax._tools.warn import warn
from vibrojax.design.constraints import (
    Constraint,
    Goal,
    name_for,
    named_functions,
    spread_of,
    words_for,
)
from vibrojax.design.evaluation import AbstractEvaluator
from vibrojax.design.optimum import Neighbour, Optimum, allowed, ends_of, held_by, history_of
from vibrojax.design.rig_functions import range_of, rig_functions
from vibrojax.design.robust import Robust
from vibrojax.design.settings import OptimiseSettings
from vibrojax.design.side_by_side import End, search_side_by_side
from vibrojax.design.trials import NEIGHBOURS, Trial, Trials, screen, starts_for
from vibrojax.design.variables import Variables, variables_of
from vibrojax.ensemble.ranges import Range
from vibrojax.model.systems import AbstractSystem

STEP = 0.02
"""How far neighbours of the best design are, over the range of a variable."""
POLISHED = 2
"""How often a search goes on from a neighbour that is better."""
SAME = 1e-4
"""By how many spreads ends of searches may differ and count as the same."""


@validated
def optimise(
    make_system: Callable[..., AbstractSystem],
    objective: Callable[[Any], Any],
    *,
    variables: Mapping[str, Any],
    constraints: Sequence[Constraint] = (),
    frequency_ratio: Range | None = None,
    frequency: Range | None = None,
    maximise: bool = False,
    logarithmic: Sequence[str] | None = None,
    robust: Robust | None = None,
    settings: OptimiseSettings | None = None,
    **numbers: Any,
) -> Optimum:
    """Find the design whose response is best, by derivatives in its numbers.

        vj.optimise(
            vj.default_rig,
            lambda response: response.peak(),
            variables={"gap": (1e-4, 1e-3), "stiffness": (1e3, 1e5)},
            frequency_ratio=vj.Range(0.85, 1.31),
        )

    Designs spread evenly between the bounds are screened first; from the best of them that are
    apart from each other searches go on side by side, by scipy's SLSQP (or trust-constr). So an
    optimum is the best of several local ones. Ctrl-C ends the searches: the best design so far is
    returned, with the status `interrupted`.

    Parameters:
        make_system: a function from named numbers to a system.
        objective: a function from a `Response` to the number that is made least.
        variables: bounds by name, `(low, high)` or `vj.Range(low, high, start=...)`; `start` is
            the design to begin with.
        constraints: `vj.design.Constraint(function, least=..., most=...)`.
        frequency_ratio, frequency: the drive frequencies over which the response is followed
            (ratio to the first natural frequency of the unstopped system, or Hz).
        maximise: whether the largest value of the objective is sought.
        logarithmic: variables that are varied by their logarithms; None: those with bounds above 0
            and apart by ten times or more.
        robust: `vj.design.Robust(...)`: objective and constraints are statistics over tolerances.
        settings: `vj.design.OptimiseSettings(starts=..., screened=..., method=..., ...)`.
        numbers: other arguments of the function, which stay.

    Returns an `Optimum`, whose status says whether it can be relied on; one that misses its
    constraints warns too. Raises `ValueError` for bounds that are none, names that the function
    does not take, rigs that cannot be made at a bound, or an objective that returns an array, or
    has no value for any of the designs screened.
    """
    held = variables_of(variables, logarithmic)
    along = range_of(frequency_ratio, frequency)
    functions = named_functions({name_for(objective, "objective"): objective}, constraints)
    settings = settings or OptimiseSettings()
    worse = [-1 if maximise else 1]
    worse += [worse_side(c) for c in constraints] if robust is not None else []
    evaluator, response = rig_functions(
        make_system, functions, held, along, settings, numbers, robust, worse
    )
    return search_design(
        evaluator, held, constraints, maximise=maximise, settings=settings, response=response
    )


def worse_side(constraint: Constraint) -> int:
    """Return to which side a function gets worse. Raises `ValueError` where both bounds hold."""
    if constraint.least is not None and constraint.most is not None:
        raise ValueError(
            "A Constraint with both bounds has no worse side, which robust designs need: give two "
            "constraints, one with least=..., one with most=..."
        )
    return 1 if constraint.least is None else -1


def search_design(
    evaluator: AbstractEvaluator,
    variables: Variables,
    constraints: Sequence[Constraint] = (),
    *,
    maximise: bool = False,
    settings: OptimiseSettings | None = None,
    response: Callable[[Any], Any] | None = None,
) -> Optimum:
    """Find the best design of what an evaluator evaluates: the objective, then the constraints.

    `response` gives the response of a rig with some numbers, for the result. Warns and raises as
    `optimise` does.
    """
    settings = settings or OptimiseSettings()
    trials = Trials(evaluator, variables)
    goal = screened_goal(trials, constraints, settings, maximise=maximise)
    ends: list[End] = []
    near: list[Trial] = []
    best, end = trials.best(goal), None
    stopped = len(trials.all) < settings.screened
    if not stopped:
        starts = starts_for(trials, goal, settings.starts)
        ends = search_side_by_side(trials, [goal] * len(starts), list(starts), settings, first=1)
        for k in range(1 + POLISHED):
            best, end = min(
                ((e.trial, e) for e in ends if e.trial is not None),
                key=lambda pair: goal.rank(pair[0].values),
                default=(best, None),
            )
            stopped = end is None or any(one.status == "interrupted" for one in ends)
            if end is None or stopped:
                break
            try:
                near = try_neighbours(trials, best)
                better = trials.best(goal, near)
                if not _is_better(goal, better, best):
                    break
                if k == POLISHED or end.status == "limit":
                    best, near = better, []
                    near = try_neighbours(trials, best)
                    break
            except KeyboardInterrupt:
                stopped = True
                break
            near, first = [], len(ends) + 1
            ends += search_side_by_side(trials, [goal], [better.place], settings, first=first)
    last = trials.best(goal)
    if goal.rank(last.values) < goal.rank(best.values):
        best, near = last, []  # none that was tried is lost
    return _optimum(trials, goal, constraints, best, near, ends, end, stopped, settings, response)


def screened_goal(
    trials: Trials,
    constraints: Sequence[Constraint],
    settings: OptimiseSettings,
    *,
    maximise: bool = False,
    objectives: int = 1,
) -> Goal:
    """Screen designs, and return what is sought, by the spread of the functions among them.

    Ctrl-C ends it with those that were tried; where none was, it is raised. Raises `ValueError`
    where nothing has a value.
    """
    stopped = None
    try:
        screen(trials, settings.screened, settings.seed)
    except KeyboardInterrupt as interrupt:
        stopped = interrupt
        if not trials.all:
            raise
    bounds = np.array([(-np.inf, np.inf)] * objectives + [c.bounds for c in constraints])
    values = np.array([trial.values for trial in trials.all])
    goal = Goal(
        objective=0,
        sign=-1.0 if maximise else 1.0,
        least=bounds[:, 0],
        most=bounds[:, 1],
        spread=spread_of(values),
        tolerance=settings.tolerance,
        also=tuple(range(objectives)),
    )
    if not any(goal.knows(own) for own in values):
        if stopped is not None:
            raise stopped
        counts = np.isfinite(values).sum(axis=0)
        name = words_for(trials.evaluator.functions[int(np.argmin(counts))])
        why = next((trial.note for trial in trials.all if trial.note), "it is NaN.")
        raise ValueError(
            f"{name} has no value for any of the {len(values)} designs that were tried first "
            f"(with a value of all else). At the first of them: {why}"
        )
    return goal


def try_neighbours(trials: Trials, best: Trial) -> list[Trial]:
    """Try designs next to one, two for each variable: on both sides, within the bounds."""
    places = []
    for k, own in enumerate(best.place):
        offsets = (-STEP, STEP)
        if own < STEP or own > 1 - STEP:
            offsets = (STEP, 2 * STEP) if own < STEP else (-2 * STEP, -STEP)
        for offset in offsets:
            place = best.place.copy()
            place[k] += offset
            places.append(place)
    return trials.evaluate(np.array(places), [NEIGHBOURS] * len(places))


def curvature_of(
    variables: Variables, best: Trial, near: Sequence[Trial]
) -> Float[np.ndarray, "numbers numbers"]:
    """Return second derivatives of the objective, by differences of the gradients of neighbours."""
    size = len(best.place)
    found = np.full((size, size), np.nan)
    for k in range(size if near else 0):
        three = sorted([best, *near[2 * k : 2 * k + 2]], key=lambda t: t.place[k])
        numbers = variables.numbers(np.array([t.place for t in three]))
        slopes = np.array([t.slopes[0] for t in three]) / variables.stretch(numbers)
        middle = next(i for i, t in enumerate(three) if t is best)
        found[k] = np.gradient(slopes, numbers[:, k], axis=0, edge_order=2)[middle]
    return (found + found.T) / 2


def _is_better(goal: Goal, one: Trial, other: Trial) -> bool:
    own, rank = goal.rank(one.values), goal.rank(other.values)
    return own[0] < rank[0] or (own[0] == rank[0] and own[1] < rank[1] - goal.tolerance)


def _optimum(
    trials: Trials,
    goal: Goal,
    constraints: Sequence[Constraint],
    best: Trial,
    near: list[Trial],
    ends: list[End],
    end: End | None,
    stopped: bool,
    settings: OptimiseSettings,
    response: Callable[[Any], Any] | None,
) -> Optimum:
    variables, names = trials.variables, trials.evaluator.functions
    others = names[1:]
    first = trials.all[0]
    numbers = variables.numbers(best.place)
    status = "interrupted" if stopped or end is None else end.status
    if not goal.meets(best.values) and not stopped:
        status = "infeasible"
    elif status == "stalled" and near and end is not None and end.trial is best:
        status = "kink"
    sentence = _sentence(trials, goal, best, ends, status, end.reason if end else "", settings)
    responses: list[Any] = [None, None]
    if response is not None and not stopped:
        try:
            both = variables.numbers(np.stack([first.place, best.place]))
            responses = [stoppable(response, place) for place in both]
        except KeyboardInterrupt:
            sentence += " The response of the rigs was interrupted."
    neighbours = []
    for k, trial in enumerate(near):
        name = variables.names[k // 2]
        number = float(variables.numbers(trial.place)[k // 2])
        value, *bounded = trial.values.tolist()
        own = dict(zip(others, bounded, strict=True))
        neighbours.append(Neighbour(name, number, value, own, trial.note))
    found = Optimum(
        numbers=variables.by_name(numbers),
        objective=names[0],
        value=float(best.values[0]),
        maximise=goal.sign < 0,
        constraints=dict(zip(others, best.values[1:].tolist(), strict=True)),
        limits={name: c.bounds for name, c in zip(others, constraints, strict=True)},
        bounds={
            name: (low, high)
            for name, low, high in zip(
                variables.names, variables.low.tolist(), variables.high.tolist(), strict=True
            )
        },
        logarithmic=tuple(
            name for name, log in zip(variables.names, variables.logarithmic, strict=True) if log
        ),
        active=held_by(trials, best, goal),
        gradient=variables.by_name(best.slopes[0] / variables.stretch(numbers)),
        curvature=curvature_of(variables, best, near),
        neighbours=tuple(neighbours),
        first=variables.by_name(variables.numbers(first.place)),
        first_value=float(first.values[0]),
        history=history_of(trials, goal),
        ends=ends_of(trials, ends),
        status=status,
        sentence=sentence,
        response=responses[1],
        first_response=responses[0],
    )
    if status == "infeasible":
        warn(sentence)
    return found


def _sentence(
    trials: Trials,
    goal: Goal,
    best: Trial,
    ends: list[End],
    status: str,
    reason: str,
    settings: OptimiseSettings,
) -> str:
    names, count = trials.evaluator.functions, len(trials.all)
    missed = ""
    if not goal.meets(best.values):
        values, excess = best.values, goal.excess(best.values)
        closest = ", ".join(
            f"{words_for(names[k])} is {values[k]:.5g} and must be "
            f"{allowed(goal.least[k], goal.most[k])}"
            for k in goal.bounded
            if abs(excess[k]) > goal.tolerance
        )
        missed = (
            f"None of the {count} designs tried meets all constraints. Nearest to them, {closest}."
        )
    if status == "infeasible":
        return f"{missed} Widen the bounds of the variables, or the constraints."
    if status == "interrupted":
        return f"Interrupted: the best of the {count} designs tried so far. {missed}".strip()
    if status == "converged":
        costs = [goal.rank(e.trial.values) for e in ends if e.trial is not None]
        least = goal.rank(best.values)
        same = sum(c[0] == 0.0 and c[1] - least[1] <= SAME for c in costs)
        return f"No small step makes it better; {same} of {len(ends)} searches end at this value."
    if status == "limit":
        return (
            f"A search may try {settings.max_rounds} designs, and they are used up: a higher "
            "max_rounds may lead to a better one."
        )
    if status == "kink":
        lost = [t for t in trials.all if t.search == NEIGHBOURS and not goal.knows(t.values)]
        why = "what is sought has a kink there, as where two peaks are equally high."
        if lost:
            why = f"it is at the edge of where there are values. {lost[0].note}".strip()
        return f"All designs next to it are worse, though its slope is not flat: {why}"
    return f"The search could not go on. {reason}"
