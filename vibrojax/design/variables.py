"""What a design varies: numbers between bounds, in coordinates from 0 to 1."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from vibrojax._tools.checks import check_names, check_needed_arguments, nearest
from vibrojax._tools.described import in_short
from vibrojax._tools.kinds import is_list, is_number
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.ranges import Range

DECADE = 10.0
"""Ratio of the bounds from which on a coordinate is logarithmic."""
ROUNDING = 1e-12
"""Of coordinates at the bounds."""
ADVICE = "Give (low, high) or vj.Range(low, high, start=...)."


@dataclass(frozen=True)
class Variables:
    """Numbers between bounds; coordinates go from 0 at the low bound to 1 at the high one."""

    names: tuple[str, ...]
    low: Float[np.ndarray, " numbers"]
    high: Float[np.ndarray, " numbers"]
    logarithmic: Bool[np.ndarray, " numbers"]
    start: Float[np.ndarray, " numbers"]
    """The design to begin with: what the user says, else the middle of the coordinate."""
    given: bool = False
    """Whether the user says where to begin."""

    def numbers(self, places: Float[np.ndarray, "*rigs numbers"]) -> Float[np.ndarray, "..."]:
        """Return the numbers at some coordinates."""
        low, high = self._ends
        found = low + places * (high - low)
        found = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, found, 0.0)), found)
        # At the bounds without rounding.
        low_end, high_end = places <= ROUNDING, places >= 1 - ROUNDING
        return np.where(low_end, self.low, np.where(high_end, self.high, found))

    def places(self, numbers: Float[np.ndarray, "*rigs numbers"]) -> Float[np.ndarray, "..."]:
        """Return the coordinates of some numbers."""
        low, high = self._ends
        logs = np.log(np.where(self.logarithmic, numbers, 1.0))
        return (np.where(self.logarithmic, logs, numbers) - low) / (high - low)

    def stretch(self, numbers: Float[np.ndarray, "*rigs numbers"]) -> Float[np.ndarray, "..."]:
        """Return how much each number changes with its coordinate there."""
        low, high = self._ends
        return (high - low) * np.where(self.logarithmic, numbers, 1.0)

    def by_name(self, numbers: Float[np.ndarray, " numbers"]) -> dict[str, float]:
        """Return numbers as a function of the rig takes them."""
        return dict(zip(self.names, numbers.tolist(), strict=True))

    @property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = (np.log(np.where(self.logarithmic, b, 1.0)) for b in (self.low, self.high))
        return np.where(self.logarithmic, low, self.low), np.where(
            self.logarithmic, high, self.high
        )


def variables_of(
    variables: Mapping[str, Any], logarithmic: Sequence[str] | None = None
) -> Variables:
    """Read the bounds of a design.

    `variables` are pairs or ranges by name; `logarithmic` names those whose coordinates are (None:
    those with a low bound above 0 and a high one of ten times it or more). Raises `ValueError` for
    none, bounds that are no two finite numbers, the low one first, or a logarithm of such below 0.
    """
    if not variables:
        raise ValueError(f'variables is empty: name what varies, {{"gap": (1e-4, 1e-3)}}. {ADVICE}')
    for name in logarithmic or ():
        if name not in variables:
            raise ValueError(
                f"Unknown variable {name!r} in logarithmic. {nearest(name, variables)}"
            )
    low, high, start, logs = [], [], [], []
    for name, given in variables.items():
        own = _range_of(name, given)
        log = own.low > 0 and own.high >= DECADE * own.low * (1 - 1e-12)
        if logarithmic is not None:
            log = name in logarithmic
        if log and own.low <= 0:
            raise ValueError(
                f"variables[{name!r}] goes by its logarithm and must be above 0, got a low bound "
                f"of {own.low:g}. Raise it, or leave {name!r} out of logarithmic."
            )
        middle = math.sqrt(own.low) * math.sqrt(own.high) if log else (own.low + own.high) / 2
        low.append(own.low)
        high.append(own.high)
        start.append(middle if own.start is None else own.start)
        logs.append(log)
    given = any(isinstance(v, Range) and v.start is not None for v in variables.values())
    return Variables(
        names=tuple(variables),
        low=np.array(low, float),
        high=np.array(high, float),
        logarithmic=np.array(logs, bool),
        start=np.array(start, float),
        given=given,
    )


def _range_of(name: str, given: Any) -> Range:
    pair = (given.low, given.high) if isinstance(given, Range) else given
    where = f"variables[{name!r}]"
    if not is_list(pair) or len(pair) != 2 or not all(map(is_number, pair)):
        raise ValueError(f"{where} must be two finite numbers, got {in_short(given)}. {ADVICE}")
    low, high = map(float, pair)
    if not low < high:
        known = "the same twice" if low == high else "the high bound first"
        raise ValueError(f"{where} must be a low bound and a higher one, got {known}: {pair!r}.")
    return given if isinstance(given, Range) else Range(low, high)


def check_numbers(
    make_system: Callable[..., Any], variables: Variables, numbers: Mapping[str, Any]
) -> None:
    """Raise `ValueError` where variables and numbers that stay are not what a function takes.

    That is: an unknown name, one given twice, an argument that is missing, a list or a range among
    the numbers that stay.
    """
    for name, value in numbers.items():
        if name in variables.names:
            raise ValueError(
                f"{name} is given twice: in variables and as a number that stays. Leave one out."
            )
        if isinstance(value, Range | Zipped) or is_list(value):
            raise ValueError(
                f"{name} must be one value that stays, got {in_short(value)}. What varies goes "
                f'into variables={{"{name}": (low, high)}}.'
            )
    check_names(make_system, variables.names, "variables")
    check_names(make_system, numbers)
    check_needed_arguments(make_system, (*variables.names, *numbers))


def check_bounds(check: Callable[[Any], Any], variables: Variables) -> None:
    """Have the rigs built at both bounds of every variable, the others where the design begins.

    `check` raises `ValueError` for the numbers of a rig that cannot be; so does this.
    """
    check(variables.start)
    for k, ends in itertools.product(range(len(variables.names)), (variables.low, variables.high)):
        place = variables.start.copy()
        place[k] = ends[k]
        try:
            check(place)
        except ValueError as error:
            name = variables.names[k]
            raise ValueError(
                f"variables[{name!r}] has a bound at which there is no rig, {place[k]:g}: {error}"
            ) from error
