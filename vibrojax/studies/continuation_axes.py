"""What the numbers in a continuation's call mean: the range to follow, axes, fixed ones."""

import inspect
import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from vibrojax._checks import check_needed_arguments, check_positive, name_of, nearest
from vibrojax._described import recipe
from vibrojax.response.methods import check_balance
from vibrojax.studies.frequency_sweep import check_drive
from vibrojax.systems.base import (
    AbstractEquations,
    AbstractSystem,
    LinearEquations,
    as_arrays,
    equations_of,
)


class Along(NamedTuple):
    """The parameter that is followed and everything that stays."""

    make: Any
    """The function, or the system itself."""
    name: str
    low: float
    high: float
    axes: dict[str, np.ndarray]
    fixed: dict[str, float]
    static: dict[str, Any]
    labels: list[dict[str, float]]
    """Values of the axes, by lane."""
    frequency: float
    """Drive frequency where another number is followed."""
    is_ratio: bool
    sample: AbstractSystem
    description: str

    @property
    def numbers(self) -> dict[str, Any]:
        """Axes and fixed numbers, for `lanes_of`."""
        return {n: list(v) for n, v in self.axes.items()} | self.fixed | self.static


def _range(name: str, value: tuple) -> tuple[float, float]:
    if len(value) != 2:
        raise ValueError(f"{name} must be a range (low, high), got {value!r}.")
    try:
        low, high = float(value[0]), float(value[1])
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a range of two numbers, got {value!r}.") from None
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ValueError(f"{name} must be a range of finite numbers, got {value!r}.")
    if not low < high:
        raise ValueError(
            f"{name} = ({low:g}, {high:g}) is a range without width: give (low, high) with low "
            "below high. A branch is followed from low to high, through its folds both ways."
        )
    return low, high


def _frequency(ratio: Any, frequency: Any) -> tuple[str, Any]:
    if (ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    name, value = ("frequency_ratio", ratio) if ratio is not None else ("frequency", frequency)
    if np.ndim(value) > 0 and not isinstance(value, tuple) and len(value) != 2:
        raise ValueError(
            f"{name} must be a range (low, high) or one number, got {len(value)} values. "
            "Give the range, then branch.resample(values)."
        )
    if np.ndim(value) > 0:
        value = tuple(np.asarray(value, float).tolist()) if not isinstance(value, tuple) else value
        low, _ = _range(name, value)
        check_positive(name, low, "(ratio)" if name == "frequency_ratio" else "Hz")
    else:
        check_positive(name, value, "(ratio)" if name == "frequency_ratio" else "Hz")
    return name, value


def along_of(
    system: AbstractSystem | Callable[..., AbstractSystem],
    frequency_ratio: Any,
    frequency: Any,
    numbers: dict[str, Any],
) -> Along:
    """Sort the numbers of a call. Raises `ValueError` as `continue_response` says."""
    name, value = _frequency(frequency_ratio, frequency)
    ranges = {n: _range(n, v) for n, v in numbers.items() if isinstance(v, tuple)}
    others = {n: v for n, v in numbers.items() if not isinstance(v, tuple)}
    follows_frequency = isinstance(value, tuple)
    if follows_frequency == bool(ranges) or len(ranges) > 1:
        raise ValueError(
            f"Give exactly one range (low, high) to follow: {name} or one argument of the "
            f"function. Got {1 if follows_frequency else 0} for {name} and {len(ranges)} of the "
            "function."
        )
    if isinstance(system, AbstractSystem) and numbers:
        raise ValueError(
            f"Unknown argument {next(iter(numbers))!r}. To follow or vary a number of the rig, "
            "pass a function that makes the rig from named numbers, in place of the rig itself."
        )
    if not isinstance(system, AbstractSystem):
        _check_names(system, numbers)
    axes = {
        n: np.asarray(v, float) for n, v in others.items() if np.ndim(v) > 0 and not _is_text(v)
    }
    for n, values in axes.items():
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            raise ValueError(f"{n} must be a non-empty list of finite numbers, got {others[n]!r}.")
    plain = {n: v for n, v in others.items() if n not in axes}
    fixed = {n: float(v) for n, v in plain.items() if _is_real(v)}
    static = {n: v for n, v in plain.items() if n not in fixed}
    labels = [
        dict(zip(axes, map(float, row), strict=True)) for row in itertools.product(*axes.values())
    ]
    if follows_frequency:
        followed, (low, high) = name, _range(name, value)
        sample = _make(system, static | fixed | labels[0])
        frequency_value = np.nan
    else:
        (followed, (low, high)), *_ = ranges.items()
        frequency_value = float(value)
        # Both ends are built from concrete numbers, so checked.
        ends = [
            _make(system, static | fixed | row | {followed: end})
            for end in (high, low)
            for row in labels
        ]
        sample = ends[-1]
    check_continued(sample)
    return Along(
        make=system,
        name=followed,
        low=low,
        high=high,
        axes=axes,
        fixed=fixed,
        static=static,
        labels=labels,
        frequency=frequency_value,
        is_ratio=name == "frequency_ratio",
        sample=sample,
        description=recipe(sample),
    )


def _is_text(value: Any) -> bool:
    return isinstance(value, str | bytes)


def _is_real(value: Any) -> bool:
    return isinstance(value, float | np.floating) or (
        np.ndim(value) == 0 and hasattr(value, "dtype")
    )


def _check_names(system: Any, numbers: dict[str, Any]) -> None:
    if not callable(system):
        raise ValueError(f"system must be a system or a function that makes one, got {system!r}.")
    check_needed_arguments(system, numbers)
    parameters = inspect.signature(system).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return
    known = [p.name for p in parameters]
    for n in numbers:
        if n not in known:
            raise ValueError(f"Unknown argument {n!r}. {nearest(n, known)}")


def _make(system: Any, numbers: dict[str, Any]) -> AbstractSystem:
    if isinstance(system, AbstractSystem):
        return system
    made = system(**numbers)
    if not isinstance(made, AbstractSystem):
        raise ValueError(f"{name_of(system)} must return a system, got {made!r}.")
    return made


def check_system(system: AbstractSystem) -> None:
    """Refuse, with a `ValueError`, a system without drive, stops, or linear equations."""
    check_drive(system)
    check_equations(system, equations_of(as_arrays(system)))


def check_continued(system: AbstractSystem) -> None:
    """Refuse, with a `ValueError`, a system whose branches cannot be followed."""
    check_system(system)
    check_balance(equations_of(as_arrays(system)).stops)


def check_equations(system: AbstractSystem, equations: AbstractEquations) -> None:
    """Refuse, with a `ValueError`, equations that are not linear but for stops."""
    if not isinstance(equations, LinearEquations):
        raise ValueError(
            f"{type(system).__name__} is not linear but for its stops, which harmonic balance "
            "needs. Use periodic_response(..., method=Shooting()) at single points."
        )
    if not equations.stops:
        raise ValueError(
            "The system has no stops, so its response is linear: one curve without branches. "
            "Use frequency_sweep."
        )
