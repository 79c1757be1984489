"""What the keywords of a map mean: crossed axes, axes that go together, fixed arguments."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from vibrojax._checks import check_needed_arguments, nearest

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


def zipped(**values: Any) -> Zipped:
    """Return arguments that are varied together along one axis of a map, not crossed.

        vj.parameter_map(rig, vj.zipped(taper=[0, 0.5], gap=[4e-4, 3e-4]), frequency_ratio=...)

    As a positional argument of `parameter_map` the axis is called `taper_gap`; given as a keyword,
    `design=vj.zipped(...)`, it has the name of the keyword. Raises `ValueError` for fewer than two
    names or lists of unequal lengths.

    `values` are lists of equal length by name.
    """
    if len(values) < 2:
        raise ValueError(f"zipped needs at least two arguments to go together, got {len(values)}.")
    for name, given in values.items():
        if np.ndim(given) != 1:
            raise ValueError(f"zipped: {name} must be a list, got {given!r}.")
    lengths = {name: len(given) for name, given in values.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} has {count}" for name, count in lengths.items())
        raise ValueError(f"zipped needs lists of equal lengths: {told}.")
    return Zipped(values)


class Dimension(NamedTuple):
    """One axis of a map: its name and the arguments that vary along it."""

    name: str
    values: dict[str, np.ndarray]

    @property
    def size(self) -> int:
        """Length of the axis."""
        return len(next(iter(self.values.values())))

    @property
    def is_text(self) -> bool:
        """Whether something along the axis is no number (text or true/false)."""
        return any(v.dtype.kind not in "fiu" for v in self.values.values())

    @property
    def is_whole(self) -> bool:
        """Whether something along the axis was given in whole numbers."""
        return any(v.dtype.kind in "iu" for v in self.values.values())


class Arguments(NamedTuple):
    """What the function of the rig is called with: some fixed, some along dimensions."""

    dimensions: tuple[Dimension, ...]
    fixed: dict[str, Any]

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the dimensions."""
        return tuple(d.size for d in self.dimensions)

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
    array = np.asarray(values)
    if array.dtype.kind not in "fiuUb":
        raise ValueError(f"{name} must be a list of numbers or of texts, got {values!r}.")
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
    make_system: Callable[..., Any], groups: tuple[Any, ...], keywords: Mapping[str, Any]
) -> Arguments:
    """Sort what a map was called with.

    Raises `ValueError` for an argument that the function does not take, one that is given twice,
    an empty axis, or a name that the result needs itself.
    """
    if not callable(make_system):
        raise ValueError(
            "make_system must be a function that makes a system from named numbers, got "
            f"{make_system!r}."
        )
    dimensions: list[Dimension] = []
    for group in groups:
        if not isinstance(group, Zipped):
            raise ValueError(
                f"Positional arguments after the function must be vj.zipped(...), got {group!r}. "
                "Name the others: gap=[...]."
            )
        dimensions.append(_dimension("_".join(group.values), group))
    fixed: dict[str, Any] = {}
    for name, given in keywords.items():
        if isinstance(given, Zipped) or np.ndim(given) == 1:
            dimensions.append(_dimension(name, given))
        elif np.ndim(given) == 0:
            fixed[name] = given.item() if isinstance(given, np.generic) else given
        else:
            raise ValueError(f"{name} must be one value or a list, got {np.ndim(given)} axes.")
    varied = [n for d in dimensions for n in d.values]
    known = _known(make_system)
    for name in (*varied, *fixed):
        if known is not None and name not in known:
            raise ValueError(f"Unknown argument {name!r} of the rig. {nearest(name, known)}")
        if [*varied, *fixed].count(name) > 1:
            raise ValueError(f"{name} is given twice: once is an axis, twice is a contradiction.")
    check_needed_arguments(make_system, (*varied, *fixed))
    names = [d.name for d in dimensions]
    for name in names:
        if names.count(name) > 1 or name in RESERVED:
            raise ValueError(f"The axis name {name!r} is taken: give the group another keyword.")
    return Arguments(tuple(dimensions), fixed)


def _known(make_system: Callable[..., Any]) -> list[str] | None:
    """Names that a function takes; None where it takes any."""
    parameters = inspect.signature(make_system).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return None
    return [p.name for p in parameters]


def default_of(make_system: Callable[..., Any], name: str) -> Any:
    """Return the default of an argument; None where there is none."""
    parameter = inspect.signature(make_system).parameters.get(name)
    if parameter is None or parameter.default is inspect.Parameter.empty:
        return None
    return parameter.default
