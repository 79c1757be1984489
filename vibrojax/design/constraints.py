"""What a design may not do, and what a search is after: one function, the others in bounds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax._tools.signatures import validated


@validated
@dataclass(frozen=True)
class Constraint:
    """Bounds on a function of a response, both of which belong to what is allowed.

        vj.design.Constraint(lambda response: response.peak("contact_force"), most=20.0)

    Raises `ValueError` where there is no bound, or the least value is above the most.
    """

    function: Callable[[Any], Any]
    """From a response to a number, as the objective is."""
    least: float | None = None
    """Least value that is allowed; None: any."""
    most: float | None = None
    """Largest value that is allowed; None: any."""
    name: str | None = None
    """What results call it; None: the name of the function."""

    def __post_init__(self) -> None:
        """Refuse bounds that bound nothing, or leave nothing."""
        if self.least is None and self.most is None:
            raise ValueError("A Constraint needs a bound: give least=..., most=..., or both.")
        if self.least is not None and self.most is not None and self.least > self.most:
            raise ValueError(
                f"least must be at most {self.most:g}, the largest value that is allowed, got "
                f"{self.least:g}."
            )

    @property
    def bounds(self) -> tuple[float, float]:
        """Both bounds, infinite where there is none."""
        return (
            -np.inf if self.least is None else float(self.least),
            np.inf if self.most is None else float(self.most),
        )


def words_for(name: str) -> str:
    """Return a name as a sentence has it."""
    return name.replace("_", " ")


def name_for(function: Any, otherwise: str) -> str:
    """Return what a function of a response is called; `otherwise` where it has no name."""
    found = getattr(function, "name", None) or getattr(function, "__name__", None)
    return found if isinstance(found, str) and found != "<lambda>" else otherwise


def named_functions(
    objectives: dict[str, Any], constraints: Sequence[Constraint]
) -> dict[str, Callable[[Any], Any]]:
    """Return the functions of a design by name: objectives, then constraints.

    Names that come from functions are made different. Raises `ValueError` for one given twice.
    """
    found = dict(objectives)
    for constraint in constraints:
        name = constraint.name or name_for(constraint.function, "constraint")
        if constraint.name in found:
            raise ValueError(f"The name {name!r} is given to two functions: change one of them.")
        own, k = name, 2
        while own in found:
            own, k = f"{name}_{k}", k + 1
        found[own] = constraint.function
    return found


class Goal(NamedTuple):
    """What a search is after: one function least (or largest), all of them within bounds."""

    objective: int
    sign: float
    """1.0 where the least is sought, -1.0 where the largest is."""
    least: Float[np.ndarray, " functions"]
    most: Float[np.ndarray, " functions"]
    spread: Float[np.ndarray, " functions"]
    """What a difference of one is in a search, in the unit of the function."""
    tolerance: float
    """By how many spreads bounds may be missed."""
    also: tuple[int, ...] = ()
    """Functions that must have a value besides."""

    def cost(self, values: Float[np.ndarray, " functions"]) -> float:
        """Return what is minimised."""
        return float(self.sign * values[self.objective] / self.spread[self.objective])

    @property
    def bounded(self) -> list[int]:
        """Functions with bounds."""
        finite = np.isfinite(self.least) | np.isfinite(self.most)
        return np.flatnonzero(finite).tolist()

    def knows(self, values: Float[np.ndarray, " functions"]) -> bool:
        """Whether all that counts has a value."""
        return bool(np.isfinite(values[[self.objective, *self.bounded, *self.also]]).all())

    def excess(self, values: Float[np.ndarray, " functions"]) -> Float[np.ndarray, " functions"]:
        """Return by how much each bound is missed, signed as the values are, in spreads."""
        above, below = np.maximum(values - self.most, 0.0), np.maximum(self.least - values, 0.0)
        return np.nan_to_num(above - below) / self.spread

    def meets(self, values: Float[np.ndarray, " functions"]) -> bool:
        """Whether all is known, and within its bounds."""
        return self.rank(values)[0] == 0.0

    def rank(self, values: Float[np.ndarray, " functions"]) -> tuple[float, float]:
        """Return what designs are compared by: how far bounds are missed, then the cost."""
        if not self.knows(values):
            return np.inf, np.inf
        missed = self.excess(values)
        allowed = bool((np.abs(missed) <= self.tolerance).all())
        return 0.0 if allowed else float(np.linalg.norm(missed)), self.cost(values)


def spread_of(values: Float[np.ndarray, "rigs functions"]) -> Float[np.ndarray, " functions"]:
    """Return the spread of every function over some rigs: half of them lie within it."""
    found = []
    for column in values.T:
        known = column[np.isfinite(column)]
        own = np.subtract(*np.percentile(known, [75, 25])) if known.size else 0.0
        size = np.abs(known).max(initial=0.0)
        if own <= 1e-9 * size:
            own = np.ptp(known) if known.size else 0.0
        found.append(own if own > 1e-9 * size else size or 1.0)
    return np.array(found, float)
