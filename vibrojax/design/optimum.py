"""The best design: what holds it, its neighbours, and every design that was tried."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.design.constraints import Goal, words_for
from vibrojax.design.outputs import output_dataset
from vibrojax.design.side_by_side import End
from vibrojax.design.trials import Trial, Trials
from vibrojax.results.saving import AbstractSaved
from vibrojax.results.variables import named_value

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

NEAR = 1e-4
"""How near to a bound the best design is at it; over the range, or the spread of a function."""


class Neighbour(NamedTuple):
    """A design next to the best one: one number is another."""

    name: str
    """The number that is changed."""
    number: float
    """What it is there."""
    value: float
    """The objective there."""
    constraints: dict[str, float]
    note: str


class SearchEnd(NamedTuple):
    """Where a search ended."""

    search: int
    numbers: dict[str, float]
    value: float
    constraints: dict[str, float]
    status: str
    """converged, limit, stalled, no slope, no value, infeasible or interrupted."""
    reason: str


class History(NamedTuple):
    """Every design that was tried, in order."""

    search: Int[np.ndarray, " evaluations"]
    """Which search tried it, from 1; 0: screened before, -1: a neighbour of the best."""
    number: Int[np.ndarray, " evaluations"]
    """Which of the designs of that search it is, from 1."""
    design: Float[np.ndarray, "evaluations numbers"]
    value: Float[np.ndarray, " evaluations"]
    """The objective; NaN where it has no value."""
    constraints: Float[np.ndarray, "evaluations constraints"]
    feasible: Bool[np.ndarray, " evaluations"]
    """Whether all constraints are met."""
    note: tuple[str, ...]
    """Why something is missing; empty where nothing is."""


class Optimum(AbstractSaved):
    """The best design that was found; made by `optimise`."""

    numbers: dict[str, float]
    """The best design, by the names of its numbers."""
    objective: str
    """Name of the objective."""
    value: float
    """The objective of the best design."""
    maximise: bool
    """Whether the largest value was sought."""
    constraints: dict[str, float]
    """Values of the constrained functions there."""
    limits: dict[str, tuple[float, float]]
    """Least and largest values that are allowed there; infinite where there is no bound."""
    bounds: dict[str, tuple[float, float]]
    """Between which each number was varied."""
    logarithmic: tuple[str, ...]
    """Numbers whose steps were made in their logarithms."""
    active: tuple[str, ...]
    """Bounds and constraints that hold the best design."""
    gradient: dict[str, float]
    """Derivatives of the objective in the numbers; NaN where they are not known."""
    curvature: Float[np.ndarray, "numbers numbers"]
    """Second derivatives of the objective in the numbers, by differences of the gradients of the
    neighbours. Along a constraint that holds the design those of the constraint count too."""
    neighbours: tuple[Neighbour, ...]
    """Designs next to the best one: what is lost by each."""
    first: dict[str, float]
    """The design that the search began with."""
    first_value: float
    """The objective there."""
    history: History
    """Every design that was tried, in order."""
    ends: tuple[SearchEnd, ...]
    """Where each search ended."""
    status: str
    """converged: no step makes it better; kink: all neighbours are worse, without a flat slope;
    stalled: no better step was found, though a neighbour is better; limit: the designs that may be
    tried are used up; no slope: a derivative is missing; infeasible: it misses constraints;
    interrupted: by Ctrl-C."""
    sentence: str
    """What was found, in words."""
    response: Any = None
    """What the best rig does (a `Response`), where it is known."""
    first_response: Any = None
    """What the rig did that the search began with."""

    @property
    def evaluations(self) -> int:
        """How many designs were tried."""
        return len(self.history.value)

    def to_xarray(self) -> "xarray.Dataset":
        """Return the best design over `variable`, its neighbours, and what each search tried."""
        h, ends, near = self.history, self.ends, self.neighbours
        bounds, limits = np.array(list(self.bounds.values())), list(self.limits.values())
        values = {
            "best": list(self.numbers.values()),
            "first": list(self.first.values()),
            "low": bounds[:, 0],
            "high": bounds[:, 1],
            "logarithmic": [name in self.logarithmic for name in self.numbers],
            "gradient": list(self.gradient.values()),
            "curvature": self.curvature,
            "value": self.value,
            "first_value": self.first_value,
            "constraint_value": list(self.constraints.values()),
            "least": [low for low, _ in limits],
            "most": [high for _, high in limits],
            "design": h.design,
            "tried": h.value,
            "tried_constraint": h.constraints,
            "feasible": h.feasible,
            "search": h.search,
            "number_in_search": h.number,
            "note": list(h.note),
            "end_design": [list(end.numbers.values()) for end in ends],
            "end_value": [end.value for end in ends],
            "end_status": [end.status for end in ends],
            "end_reason": [end.reason for end in ends],
            "neighbour": [one.number for one in near],
            "neighbour_value": [one.value for one in near],
            "neighbour_constraint": [list(one.constraints.values()) for one in near],
        }
        axes = {
            "variable": list(self.numbers),
            "variable_2": list(self.numbers),
            "constraint": list(self.constraints),
            "evaluation": range(1, len(h.value) + 1),
            "end": [end.search for end in ends],
            "side": (1, 2) if near else (),
        }
        attributes = {
            "objective": self.objective,
            "maximise": int(self.maximise),
            "active": ", ".join(self.active),
            "status": self.status,
            "sentence": self.sentence,
        }
        return output_dataset(values, axes, attributes)

    def plot(self) -> "Figure":
        """Draw the values that were tried, the ways of the searches, and the neighbours.

        The branches of the first and of the best rig are drawn below, where they are known.
        """
        from vibrojax.plot.optimum import plot_optimum

        branches = {}
        for name, response in (("first", self.first_response), ("best", self.response)):
            if getattr(response, "branch", None) is not None:
                branches[name] = response.branch.to_xarray()
        return plot_optimum(self.to_xarray(), branches)

    def __repr__(self) -> str:
        sought = "largest" if self.maximise else "least"
        lines = [
            f"Optimum({self.status}: {sought} {words_for(self.objective)} {self.value:.6g}, "
            f"{self.first_value:.4g} to begin with; {self.evaluations} designs tried)"
        ]
        for name, number in self.numbers.items():
            low, high = self.bounds[name]
            lines.append(f"  {named_value(name, float(f'{number:.6g}'))}, from {low:g} to {high:g}")
        for name, value in self.constraints.items():
            lines.append(f"  {words_for(name)}: {value:.6g}, {allowed(*self.limits[name])}")
        lines += [f"  held by: {', '.join(self.active)}"] if self.active else []
        for name in self.numbers if self.neighbours else ():
            near = [n for n in self.neighbours if n.name == name]
            neighbours = ", ".join(f"{n.value:.5g} at {n.number:.4g}" for n in near)
            lines.append(f"  next to it in {words_for(name)}: {neighbours}")
        return "\n".join([*lines, f"  {self.sentence}"])


def allowed(least: float, most: float) -> str:
    """Return bounds in words."""
    if np.isinf(least):
        return f"at most {most:g}"
    return f"at least {least:g}" if np.isinf(most) else f"from {least:g} to {most:g}"


def held_by(trials: Trials, best: Trial, goal: Goal) -> tuple[str, ...]:
    """Return the bounds and constraints that a design is at, in words."""
    found, names = [], trials.evaluator.functions
    for name, place in zip(trials.variables.names, best.place, strict=True):
        if place <= NEAR or place >= 1 - NEAR:
            found.append(f"{words_for(name)} at its {'lower' if place <= NEAR else 'upper'} bound")
    for k in goal.bounded:
        value, reach = best.values[k], NEAR * goal.spread[k]
        for bound, words in ((goal.least[k], "at least"), (goal.most[k], "at most")):
            if abs(value - bound) <= reach:
                found.append(f"{words_for(names[k])} {words} {bound:g}")
    return tuple(found)


def history_of(trials: Trials, goal: Goal) -> History:
    """Return all trials, as arrays in the user's numbers."""
    values = np.array([trial.values for trial in trials.all])
    return History(
        search=np.array([trial.search for trial in trials.all]),
        number=np.array([trial.number for trial in trials.all]),
        design=trials.variables.numbers(np.array([trial.place for trial in trials.all])),
        value=values[:, 0],
        constraints=values[:, 1:],
        feasible=np.array([goal.meets(own) for own in values]),
        note=tuple(trial.note for trial in trials.all),
    )


def ends_of(trials: Trials, ends: list[End]) -> tuple[SearchEnd, ...]:
    """Return where searches ended, in the user's numbers."""
    found = []
    for end in ends:
        if end.trial is None:
            continue
        value, *others = end.trial.values.tolist()
        found.append(
            SearchEnd(
                search=end.search,
                numbers=trials.variables.by_name(trials.variables.numbers(end.trial.place)),
                value=value,
                constraints=dict(zip(trials.evaluator.functions[1:], others, strict=True)),
                status=end.status,
                reason=end.reason,
            )
        )
    return tuple(found)
