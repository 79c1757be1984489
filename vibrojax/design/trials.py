"""Designs that were tried: evaluated side by side, in coordinates from 0 to 1, none forgotten."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax._tools.interrupts import stoppable
from vibrojax.design.constraints import Goal
from vibrojax.design.evaluation import AbstractEvaluator
from vibrojax.design.quasi_random import sobol_sequence
from vibrojax.design.variables import Variables

SCREENED, NEIGHBOURS = 0, -1
"""In place of the number of a search: designs before all searches, and next to the best one."""
TOGETHER = 32
"""Designs screened side by side; what is interrupted leaves those before."""
APART = 0.15
"""Least distance of starts, over the diagonal of all coordinates, as long as there are enough."""


class Trial(NamedTuple):
    """One design that was tried."""

    search: int
    """Which search tried it, from 1."""
    number: int
    """Which of its designs it is, from 1."""
    place: Float[np.ndarray, " numbers"]
    """Its coordinates."""
    values: Float[np.ndarray, " functions"]
    slopes: Float[np.ndarray, "functions numbers"]
    """Derivatives in the coordinates."""
    note: str


class Trials:
    """All designs tried in a study, in order."""

    def __init__(self, evaluator: AbstractEvaluator, variables: Variables) -> None:
        self.evaluator, self.variables = evaluator, variables
        self.all: list[Trial] = []
        self._counts: Counter[int] = Counter()

    def evaluate(
        self,
        places: Float[np.ndarray, "rigs numbers"],
        searches: Sequence[int],
        *,
        slopes: bool = True,
    ) -> list[Trial]:
        """Try some designs side by side, each for a search; Ctrl-C stops it within seconds."""
        numbers = self.variables.numbers(places)
        found = stoppable(self.evaluator.evaluate, numbers, slopes=slopes)
        stretch = self.variables.stretch(numbers)
        made = []
        for own, place, along, search in zip(found, places, stretch, searches, strict=True):
            self._counts[search] += 1
            count = self._counts[search]
            made.append(Trial(search, count, place, own.values, own.slopes * along, own.note))
        self.all += made
        return made

    def best(self, goal: Goal, among: Iterable[Trial] | None = None) -> Trial:
        """Return the best of all trials, or of some of them; those with slopes before others."""
        trials = self.all if among is None else list(among)
        return min(trials, key=lambda t: (*goal.rank(t.values), bool(np.isnan(t.slopes).any())))


def screen(trials: Trials, count: int, seed: int) -> None:
    """Try the design to begin with, and others spread evenly between the bounds."""
    first = trials.variables.places(trials.variables.start)
    drawn = sobol_sequence(count, len(trials.variables.names), seed)
    places = np.vstack([first, drawn])[:count]
    for k in range(0, count, TOGETHER):
        some = places[k : k + TOGETHER]
        trials.evaluate(some, [SCREENED] * len(some), slopes=False)


def starts_for(trials: Trials, goal: Goal, count: int) -> Float[np.ndarray, "starts numbers"]:
    """Return the places of the best designs that are apart from each other.

    A design that the user begins with is the first of them.
    """
    known = sorted(
        (t for t in trials.all if goal.knows(t.values)), key=lambda t: goal.rank(t.values)
    )
    places = np.array([t.place for t in known]).reshape(len(known), -1)
    chosen: list[int] = []
    if trials.variables.given:
        chosen = [k for k, trial in enumerate(known) if trial is trials.all[0]]
    distance = APART * np.sqrt(places.shape[1])
    while len(chosen) < min(count, len(known)):
        for k, place in enumerate(places):
            near = np.linalg.norm(places[chosen] - place, axis=1) if chosen else np.inf
            if k not in chosen and np.min(near) >= distance and len(chosen) < count:
                chosen.append(k)
        distance /= 2
    return places[chosen]
