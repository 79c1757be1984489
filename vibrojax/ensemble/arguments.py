"""What the keywords of a study mean: crossed axes, axes that go together, fixed arguments."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from vibrojax._tools.checks import check_names, check_needed_arguments
from vibrojax._tools.described import in_short
from vibrojax._tools.kinds import is_list
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.ranges import Range
from vibrojax.results.axes import together

RESERVED = ("direction", "crossing", "frequency", "frequency_ratio", "fold", "grazing")
"""Names that the result itself uses for dimensions."""


class Zipped:
    """Numbers that go along one axis together; made by `zipped`."""

    values: dict[str, Any]

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = dict(values)

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={values!r}" for name, values in self.values.items())
        return f"zipped({inside})"


@validated
def zipped(**values: Any) -> Zipped:
    """Return arguments that are varied together along one axis of a study, not crossed.

        vj.parameter_map(rig, vj.zipped(taper=[0, 0.5], gap=[4e-4, 3e-4]), frequency_ratio=...)

    As a positional argument the axis is called `taper_gap`; given as a keyword,
    `design=vj.zipped(...)`, it has the name of the keyword. Maps and all studies over lists
    (`frequency_sweep`, `regimes`, `simulate`, ...) take it. Raises `ValueError` for fewer than
    two names or lists of unequal lengths.

    `values` are lists of equal length by name.
    """
    if len(values) < 2:
        raise ValueError(f"zipped needs at least two arguments to go together, got {len(values)}.")
    for name, given in values.items():
        if not is_list(given):
            raise ValueError(f"zipped: {name} must be a list, got {in_short(given)}.")
        _axis(name, given)
    lengths = {name: len(given) for name, given in values.items()}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} has {count}" for name, count in lengths.items())
        raise ValueError(f"zipped needs lists of equal lengths: {counts}.")
    return Zipped(values)


class Dimension(NamedTuple):
    """One axis of a study: its name and the arguments that vary along it."""

    name: str
    values: dict[str, np.ndarray]

    @property
    def size(self) -> int:
        """Length of the axis."""
        return len(next(iter(self.values.values())))

    @property
    def axis(self) -> np.ndarray:
        """Values as a result keeps them: numbers as floats, a group as one structured array."""
        found = {n: v.astype(float) if v.dtype.kind in "iu" else v for n, v in self.values.items()}
        return found[self.name] if list(found) == [self.name] else together(found)

    @property
    def is_text(self) -> bool:
        """Whether something along the axis is no number (text or true/false)."""
        return any(v.dtype.kind not in "fiu" for v in self.values.values())

    @property
    def is_whole(self) -> bool:
        """Whether something along the axis was given in whole numbers."""
        return any(v.dtype.kind in "iu" for v in self.values.values())


class Arguments(NamedTuple):
    """What the function of the rig is called with: fixed, along dimensions, or over ranges."""

    dimensions: tuple[Dimension, ...]
    fixed: dict[str, Any]
    ranges: dict[str, Range]

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the dimensions."""
        return tuple(d.size for d in self.dimensions)

    @property
    def axes(self) -> dict[str, np.ndarray]:
        """Values of the dimensions by name, as a result keeps them."""
        return {d.name: d.axis for d in self.dimensions}

    @property
    def lanes(self) -> int:
        """How many combinations there are."""
        return int(np.prod(self.shape, dtype=object))

    def at(self, index: tuple[int, ...]) -> dict[str, Any]:
        """Return all arguments of one combination, as Python values."""
        found = dict(self.fixed)
        for dimension, i in zip(self.dimensions, index, strict=True):
            found |= {name: values[i].item() for name, values in dimension.values.items()}
        return found


def _axis(name: str, values: Any) -> np.ndarray:
    try:
        array = np.asarray(values)
    except ValueError:  # lists of unequal lengths
        array = np.empty(0, object)
    mixed = array.dtype.kind == "U" and not all(isinstance(v, str) for v in values)
    if array.dtype.kind not in "fiuUb" or array.ndim != 1 or mixed:
        raise ValueError(
            f"{name} must be one value, or a list of numbers or of texts, got {in_short(values)}."
        )
    if array.size == 0:
        raise ValueError(f"{name} is an empty axis: give at least one value.")
    if array.dtype.kind == "f":
        array = array.astype(float)
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite, got {array[~np.isfinite(array)][0]}.")
    return array


def _dimension(name: str, given: Any) -> Dimension:
    if isinstance(given, Zipped):
        return Dimension(name, {n: _axis(n, v) for n, v in given.values.items()})
    values = _axis(name, given)
    distinct, counts = np.unique(values, return_counts=True)
    if (counts > 1).any():
        raise ValueError(
            f"{name} has the value {distinct[counts > 1][0].item()!r} twice: an axis lists each "
            "value once. (Values that repeat along an axis go into vj.zipped.)"
        )
    return Dimension(name, {name: values})


def arguments_of(
    make_system: Callable[..., Any],
    groups: tuple[Any, ...],
    keywords: Mapping[str, Any],
    *,
    with_ranges: bool = False,
) -> Arguments:
    """Sort what a study was called with.

    Raises `ValueError` for an argument that the function does not take, one that is given twice,
    an empty axis, a name that the result needs itself, or a range where the study takes none.
    """
    dimensions: list[Dimension] = []
    for group in groups:
        if not isinstance(group, Zipped):
            raise ValueError(
                f"Positional arguments after the function must be vj.zipped(...), got {group!r}. "
                "Name the others: gap=[...]."
            )
        dimensions.append(_dimension("_".join(group.values), group))
    fixed: dict[str, Any] = {}
    ranges: dict[str, Range] = {}
    for name, value in keywords.items():
        if isinstance(value, Range):
            if not with_ranges:
                raise ValueError(
                    f"{name} is a range, {value!r}: give one number, or a list as an axis, such as "
                    f"{name}=np.linspace({value.low:g}, {value.high:g}, 11)."
                )
            ranges[name] = value
        elif isinstance(value, Zipped) or is_list(value):
            dimensions.append(_dimension(name, value))
        else:
            fixed[name] = value.item() if isinstance(value, np.generic) else value
    named = [*(n for d in dimensions for n in d.values), *fixed, *ranges]
    check_names(make_system, named)
    for name in named:
        if named.count(name) > 1:
            raise ValueError(f"{name} is given twice: once is an axis, twice is a contradiction.")
    check_needed_arguments(make_system, named)
    names = [d.name for d in dimensions]
    for name in names:
        if names.count(name) > 1 or name in RESERVED:
            raise ValueError(f"The axis name {name!r} is taken: give the group another keyword.")
    return Arguments(tuple(dimensions), fixed, ranges)


def default_of(make_system: Callable[..., Any], name: str) -> Any:
    """Return the default of an argument; None where there is none."""
    parameter = inspect.signature(make_system).parameters.get(name)
    if parameter is None or parameter.default is parameter.empty:
        return None
    return parameter.default


def numbers_apart(arguments: Mapping[str, Any]) -> tuple[dict[str, float], dict[str, Any]]:
    """Part fixed arguments into real numbers, which JAX may trace, and all else (counts, names)."""
    real = {n: float(v) for n, v in arguments.items() if _is_real(v)}
    return real, {n: v for n, v in arguments.items() if n not in real}


def _is_real(value: Any) -> bool:
    return isinstance(value, float | np.floating) or (
        hasattr(value, "dtype") and np.ndim(value) == 0
    )
