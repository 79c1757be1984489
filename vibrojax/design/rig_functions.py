"""From the call of a study of designs to what evaluates its functions."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from vibrojax._tools.checks import check_positive
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.design.evaluation import AbstractEvaluator
from vibrojax.design.rig_evaluator import RigEvaluator
from vibrojax.design.robust import Robust, RobustEvaluator
from vibrojax.design.settings import OptimiseSettings
from vibrojax.design.variables import Variables, check_bounds, check_numbers
from vibrojax.ensemble.ranges import Range, check_range_of


def range_of(frequency_ratio: Range | None, frequency: Range | None) -> tuple[str, Range]:
    """Return over which frequencies the response of a rig is followed, and what they are.

    Raises `ValueError` for none, both, or what is no range of positive numbers.
    """
    if (frequency_ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two: vj.Range(low, high).")
    name = "frequency" if frequency_ratio is None else "frequency_ratio"
    found = check_range_of(name, frequency if frequency_ratio is None else frequency_ratio)
    check_positive(name, found.low, "Hz" if name == "frequency" else "(ratio)")
    return name, found


def rig_functions(
    make_system: Callable[..., Any],
    functions: Mapping[str, Callable[[Any], Any]],
    variables: Variables,
    along: tuple[str, Range],
    settings: OptimiseSettings,
    numbers: Mapping[str, Any],
    robust: Robust | None,
    worse: Sequence[int],
) -> tuple[AbstractEvaluator, Callable[[Any], Any]]:
    """Return what evaluates functions of the response of rigs, and what gives the response.

    `worse` says for every function whether larger (1) or smaller (-1) values are worse, where
    tolerances count. Raises `ValueError` for numbers that the function does not take, or rigs that
    cannot be made at a bound of a variable.
    """
    axis, followed = along
    check_numbers(make_system, variables, numbers)
    how: dict[str, Any] = {"axis": axis, "range": followed}
    how["settings"] = settings.continuation or ContinuationSettings()
    rigs = RigEvaluator(make_system, functions, variables.names, numbers=dict(numbers), **how)
    check_bounds(rigs.check, variables)
    if robust is None:
        return rigs, rigs.response
    others = [name for name in robust.tolerances if name not in variables.names]
    held = {name: numbers[name] for name in others if name in numbers}
    left = {name: value for name, value in numbers.items() if name not in held}
    names = (*variables.names, *others)
    inner = RigEvaluator(make_system, functions, names, numbers=left, **how)
    return RobustEvaluator(inner, variables.names, robust, worse, held), rigs.response
