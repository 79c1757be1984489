"""Fronts of two objectives: none of the designs is better in one without loss in the other."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from vibrojax._tools.checks import check_count, check_index, nearest
from vibrojax._tools.signatures import validated
from vibrojax._tools.warn import warn
from vibrojax.design.constraints import Constraint, Goal, named_functions, words_for
from vibrojax.design.evaluation import AbstractEvaluator
from vibrojax.design.optimise import screened_goal, worse_side
from vibrojax.design.outputs import output_dataset
from vibrojax.design.rig_functions import range_of, rig_functions
from vibrojax.design.robust import Robust
from vibrojax.design.settings import OptimiseSettings
from vibrojax.design.side_by_side import End, search_side_by_side
from vibrojax.design.trials import Trial, Trials, starts_for
from vibrojax.design.variables import Variables, variables_of
from vibrojax.ensemble.ranges import Range
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.saving import AbstractSaved

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

SLACK = 1e-4
"""By which share of the front the best of one objective may be missed at its end."""
ALIKE = 1e-3
"""Share of the front within which points count as one."""


class ParetoFront(AbstractSaved):
    """Designs of which none is better in one objective without being worse in the other."""

    objectives: tuple[str, str]
    """Names of both objectives."""
    maximise: tuple[str, ...]
    """Objectives of which the largest values are sought."""
    values: Float[np.ndarray, "points 2"]
    """Both objectives of every point, along the front."""
    designs: Float[np.ndarray, "points numbers"]
    """Numbers of every point, in the order of `names`."""
    names: tuple[str, ...]
    """Names of the numbers of the designs."""
    constraints: dict[str, Float[np.ndarray, " points"]]
    """Values of the constrained functions."""
    status: tuple[str, ...]
    """How the search for each point ended, as of `Optimum`."""
    bounds: Float[np.ndarray, "numbers 2"]
    """Between which each number was varied."""
    logarithmic: Bool[np.ndarray, " numbers"]
    """Whether it was varied by its logarithm."""
    tried: Float[np.ndarray, "evaluations 2"]
    """Both objectives of every design that was tried."""
    feasible: Bool[np.ndarray, " evaluations"]
    """Which of those meet the constraints."""
    sentence: str
    """What was found, in words."""

    @property
    def evaluations(self) -> int:
        """How many designs were tried."""
        return len(self.tried)

    @validated
    def design(self, point: int) -> dict[str, float]:
        """Return the numbers of a point, counted from 0 along the front.

        Raises `ValueError` where there is no such point.
        """
        check_index("point", point, len(self.values))
        return dict(zip(self.names, self.designs[point].tolist(), strict=True))

    def to_xarray(self) -> "xarray.Dataset":
        """Return the front over `point`, with its designs, and all that was tried."""
        values = {
            "front": self.values,
            "front_design": self.designs,
            "front_constraint": np.array(list(self.constraints.values())).T,
            "front_status": list(self.status),
            "low": self.bounds[:, 0],
            "high": self.bounds[:, 1],
            "logarithmic": self.logarithmic,
            "tried_objectives": self.tried,
            "feasible": self.feasible,
        }
        axes = {
            "point": range(1, len(self.values) + 1),
            "objective": self.objectives,
            "variable": self.names,
            "constraint": list(self.constraints),
            "evaluation": range(1, len(self.tried) + 1),
        }
        attributes = {"maximise": ", ".join(self.maximise), "sentence": self.sentence}
        return output_dataset(values, axes, attributes)

    def plot(self) -> "Figure":
        """Draw both objectives against each other, and the designs along the front.

        Raises `ValueError` for a front without points.
        """
        if not len(self.values):
            raise ValueError(f"There is nothing to draw. {self.sentence}")
        from vibrojax.plot.optimum import plot_front

        return plot_front(self.to_xarray())

    def __repr__(self) -> str:
        first, second = map(words_for, self.objectives)
        lines = [
            f"ParetoFront({len(self.values)} points of {first} and {second}; {self.evaluations} "
            "designs tried)"
        ]
        head = [*map(words_for, (*self.objectives, *self.names))]
        rows = [
            [f"{value:.5g}" for value in (*values, *design)]
            for values, design in zip(self.values, self.designs, strict=True)
        ]
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        for row, status in zip([head, *rows], ["", *self.status], strict=True):
            cells = (text.rjust(width) for text, width in zip(row, widths, strict=True))
            lines.append("  " + "  ".join([*cells, status]).rstrip())
        return "\n".join([*lines, f"  {self.sentence}"])


@validated
def pareto(
    make_system: Callable[..., AbstractSystem],
    objectives: Mapping[str, Callable[[Any], Any]],
    *,
    variables: Mapping[str, Any],
    constraints: Sequence[Constraint] = (),
    frequency_ratio: Range | None = None,
    frequency: Range | None = None,
    maximise: Sequence[str] = (),
    points: int = 9,
    logarithmic: Sequence[str] | None = None,
    robust: Robust | None = None,
    settings: OptimiseSettings | None = None,
    **numbers: Any,
) -> ParetoFront:
    """Find the designs that trade one objective for another.

        vj.design.pareto(
            vj.default_rig,
            {"peak": lambda r: r.peak(), "force": lambda r: r.peak("contact_force")},
            variables={"gap": (1e-4, 1e-3), "stiffness": (1e3, 1e5)},
            frequency_ratio=vj.Range(0.85, 1.31),
        )

    The ends are the best designs of each objective alone, of several equal ones the best in the
    other objective. Between them the first objective is made best with the second held at values
    evenly apart (the epsilon constraint of Haimes et al. 1971), all points side by side. Ctrl-C
    returns what was found so far.

    Parameters:
        make_system: a function from named numbers to a system.
        objectives: two functions from a `Response` to a number, by name.
        variables, constraints, frequency_ratio, frequency, logarithmic, robust, settings, numbers:
            as of `vj.optimise`.
        maximise: names of objectives whose largest values are sought.
        points: points along the front, both ends among them.

    Returns a `ParetoFront`: points that others dominate are left out, which its sentence says.
    Warns where no design meets the constraints. Raises `ValueError` as `vj.optimise` does, for
    other than two objectives, or an unknown one to maximise.
    """
    if len(objectives) != 2:
        raise ValueError(f"objectives must be two functions by name, got {len(objectives)}.")
    for name in maximise:
        if name not in objectives:
            raise ValueError(f"Unknown objective {name!r} in maximise. {nearest(name, objectives)}")
    check_count("points", points, least=3, most=1000)
    held = variables_of(variables, logarithmic)
    along = range_of(frequency_ratio, frequency)
    functions = named_functions(dict(objectives), constraints)
    settings = settings or OptimiseSettings()
    worse = [-1 if name in maximise else 1 for name in objectives]
    worse += [worse_side(c) for c in constraints] if robust is not None else []
    evaluator, _ = rig_functions(
        make_system, functions, held, along, settings, numbers, robust, worse
    )
    return search_front(
        evaluator, held, constraints, maximise=maximise, points=points, settings=settings
    )


def search_front(
    evaluator: AbstractEvaluator,
    variables: Variables,
    constraints: Sequence[Constraint] = (),
    *,
    maximise: Sequence[str] = (),
    points: int = 9,
    settings: OptimiseSettings | None = None,
) -> ParetoFront:
    """Find the front of the first two functions of an evaluator; the others are constrained.

    Warns and raises as `pareto` does.
    """
    settings = settings or OptimiseSettings()
    trials = Trials(evaluator, variables)
    screened = screened_goal(trials, constraints, settings, objectives=2)
    signs = [-1.0 if name in maximise else 1.0 for name in evaluator.functions[:2]]
    alone = [screened._replace(objective=k, sign=signs[k]) for k in range(2)]
    ends: list[End] = []

    def search(jobs: list[tuple[Goal, Any]]) -> None:
        if any(end.status == "interrupted" for end in ends):
            return
        own, places = [goal for goal, _ in jobs], [place for _, place in jobs]
        ends.extend(search_side_by_side(trials, own, places, settings, first=len(ends) + 1))

    between: list[Goal] = []
    if len(trials.all) >= settings.screened:
        search([(g, s) for g in alone for s in starts_for(trials, g, settings.starts)])
        if alone[0].meets(trials.best(alone[0]).values):
            between = _between(trials, alone, points)
        search([(g, s) for g in between for s in _starts(trials, g, alone)])
    found = [trials.best(goal) for goal in between or alone]
    return _front(trials, alone, found, ends, maximise)


def _between(trials: Trials, alone: list[Goal], points: int) -> list[Goal]:
    """Return the goals along the front: the first objective, at bounds on the second.

    At the first end it is the other way round, so that neither end can be dominated.
    """
    ends = np.array([trials.best(goal).values[:2] for goal in alone])
    slack = SLACK * np.abs(ends[1] - ends[0])
    first, second = alone

    def bounded(goal: Goal, by: Goal, bound: float) -> Goal:
        least, most = goal.least.copy(), goal.most.copy()
        (most if by.sign > 0 else least)[by.objective] = bound
        return goal._replace(least=least, most=most)

    bounds = np.linspace(ends[0, 1], ends[1, 1], points)[1:]
    bounds[-1] += second.sign * slack[1]
    start = bounded(second, first, float(ends[0, 0] + first.sign * slack[0]))
    return [start, *(bounded(first, second, float(bound)) for bound in bounds)]


def _starts(trials: Trials, goal: Goal, alone: list[Goal]) -> list[np.ndarray]:
    """Return where a search between the ends begins: the best known, and on the way between."""
    known = trials.best(goal)
    one, other = (trials.best(end) for end in alone)
    k = 1 - goal.objective
    bound = goal.most[k] if np.isfinite(goal.most[k]) else goal.least[k]
    width = other.values[k] - one.values[k]
    share = np.clip((bound - one.values[k]) / width if width else 0.5, 0.0, 1.0)
    return [known.place, one.place + share * (other.place - one.place)]


def _front(
    trials: Trials,
    alone: list[Goal],
    found: list[Trial],
    ends: list[End],
    maximise: Sequence[str],
) -> ParetoFront:
    goal, names = alone[0], trials.evaluator.functions
    every = np.array([trial.values for trial in trials.all])
    feasible = np.array([goal.meets(values) for values in every])
    signs = np.array([alone[0].sign, alone[1].sign])
    met = [t for t in found if goal.meets(t.values)]
    kept = _not_dominated(met, signs)
    missed, dominated = len(found) - len(met), len(met) - len(kept)
    interrupted = any(end.status == "interrupted" for end in ends) or not ends
    said = [f"{len(kept)} points." if len(kept) != 1 else "One point: no trade between the two."]
    if interrupted:
        said.insert(0, "Interrupted: the front so far.")
    if dominated:
        said.append(f"{dominated} more are left out: others are as good or better in both.")
    if missed and met:
        said.append(f"{missed} more were not found: no design there meets the constraints.")
    if not met:
        said = [f"None of the {len(every)} designs tried meets all constraints: there is no front."]
        warn(said[0])
    status = {id(end.trial): end.status for end in ends if end.trial is not None}
    for end, goal_alone in zip((found[0], found[-1]), alone, strict=True):
        if status.get(id(end)) == "stalled":  # in the little room that its bound leaves
            status[id(end)] = status.get(id(trials.best(goal_alone)), "stalled")
    how = [status.get(id(t), "interrupted" if interrupted else "stalled") for t in kept]
    bad = len(how) - how.count("converged")
    if bad and not interrupted:
        said.append(f"The searches for {bad} of them did not converge: see status.")
    variables = trials.variables
    places = np.array([t.place for t in kept]).reshape(len(kept), len(variables.names))
    values = np.array([t.values for t in kept]).reshape(len(kept), len(names))
    return ParetoFront(
        objectives=(names[0], names[1]),
        maximise=tuple(maximise),
        values=values[:, :2],
        designs=variables.numbers(places),
        names=variables.names,
        constraints={name: values[:, 2 + k] for k, name in enumerate(names[2:])},
        status=tuple(how),
        bounds=np.stack([variables.low, variables.high], axis=-1),
        logarithmic=variables.logarithmic,
        tried=every[:, :2],
        feasible=feasible,
        sentence=" ".join(said),
    )


def _not_dominated(found: list[Trial], signs: np.ndarray) -> list[Trial]:
    """Return the designs that no other one is as good as in both objectives, along the front."""
    costs = np.array([signs * t.values[:2] for t in found]).reshape(len(found), 2)
    width = np.ptp(costs, axis=0) if len(found) else np.zeros(2)
    kept: list[int] = []
    for k in np.lexsort(costs.T[::-1]):  # by the first, then by the second
        if not kept or costs[k, 1] < costs[kept[-1], 1] - ALIKE * width[1]:
            kept.append(int(k))
    return [found[k] for k in kept]
