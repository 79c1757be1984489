"""What the numbers in a continuation's call mean: the range to follow, axes, fixed ones."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from vibrojax._tools.checks import check_positive
from vibrojax._tools.described import in_short, recipe
from vibrojax.ensemble.arguments import Arguments, arguments_of
from vibrojax.ensemble.frequencies import check_drive
from vibrojax.ensemble.lanes import check_lists, check_no_numbers, made_by
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.systems import AbstractSystem, as_arrays, equations_of
from vibrojax.steady.methods import check_balance


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
    def systems(self) -> list[AbstractSystem]:
        """The systems of all lanes, where the frequency is followed."""
        return [_make(self.make, self.static | self.fixed | row) for row in self.labels]


def _range(name: str, value: tuple) -> tuple[float, float]:
    if len(value) != 2:
        raise ValueError(f"{name} must be a range (low, high), got {in_short(value)}.")
    try:
        low, high = float(value[0]), float(value[1])
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a range of two numbers, got {in_short(value)}.") from None
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ValueError(f"{name} must be a range of finite numbers, got {in_short(value)}.")
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
    groups: tuple[Any, ...] = (),
) -> Along:
    """Sort the numbers of a call. Raises `ValueError` as `continue_response` says."""
    name, value = _frequency(frequency_ratio, frequency)
    ranges = {n: _range(n, v) for n, v in numbers.items() if isinstance(v, tuple)}
    others = {n: v for n, v in numbers.items() if not isinstance(v, tuple)}
    follows_frequency = isinstance(value, tuple)
    if follows_frequency == bool(ranges) or len(ranges) > 1:
        raise ValueError(
            f"Give exactly one range (low, high) to follow: {name} or one argument of the "
            f"function. Got {1 if follows_frequency else 0} for {name} and {len(ranges)} among "
            f"the numbers of the function ({', '.join(numbers) or 'there are none'})."
        )
    if isinstance(system, AbstractSystem):
        check_no_numbers(numbers, groups)
        named = Arguments((), {})
    else:
        check_lists(others)
        named = arguments_of(system, groups, others, given=ranges)
    for dimension in named.dimensions:
        if dimension.is_text:
            raise ValueError(
                f"{dimension.name} must be numbers, got texts among them: a branch per text is a "
                "call of its own."
            )
    fixed = {n: float(v) for n, v in named.fixed.items() if _is_real(v)}
    static = {n: v for n, v in named.fixed.items() if n not in fixed}
    varied = [n for d in named.dimensions for n in d.values]
    labels = [{n: float(named.at(k)[n]) for n in varied} for k in np.ndindex(*named.shape)]
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
        axes=named.axes,
        fixed=fixed,
        static=static,
        labels=labels,
        frequency=frequency_value,
        is_ratio=name == "frequency_ratio",
        sample=sample,
        description=recipe(sample),
    )


def _is_real(value: Any) -> bool:
    return isinstance(value, float | np.floating) or (
        hasattr(value, "dtype") and np.ndim(value) == 0
    )


def _make(system: Any, numbers: dict[str, Any]) -> AbstractSystem:
    return system if isinstance(system, AbstractSystem) else made_by(system, numbers)


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
    if equations.linear_between_contacts is None:
        raise ValueError(
            f"{type(system).__name__} is not linear but for its stops, which harmonic balance "
            "needs. Use periodic_response(..., method=Shooting()) at single points."
        )
    if not equations.stops:
        raise ValueError(
            "The system has no stops, so its response is linear: one curve without branches. "
            "Use frequency_sweep."
        )
