"""Axes of a result: plain ones, and numbers that go along one axis together.

A result keeps them by name: the values of a plain axis as an array, those of numbers that go
together (`vj.zipped`) as one structured array, whose fields are the numbers by name.
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax.results.variables import axis_description, named_value, with_unit

if TYPE_CHECKING:
    import xarray

Array = np.ndarray


def together(values: Mapping[str, Array]) -> Array:
    """Return the values of numbers that go along one axis as one structured array."""
    length = len(next(iter(values.values())))
    found = np.empty(length, [(name, given.dtype) for name, given in values.items()])
    for name, given in values.items():
        found[name] = given
    return found


def numbers_along(name: str, values: Array) -> dict[str, Array]:
    """Return what goes along an axis, by name: the axis itself, or the numbers of a group."""
    fields = values.dtype.names
    return {name: values} if fields is None else {field: values[field] for field in fields}


def coordinates_of(axes: Mapping[str, Array]) -> dict[str, Any]:
    """Return the coordinates of axes for a dataset, with units and long names."""
    return {
        number: ((name,), own, axis_description(number) if own.dtype.kind in "fiu" else {})
        for name, values in axes.items()
        for number, own in numbers_along(name, np.asarray(values)).items()
    }


def coordinates_along(dataset: "xarray.Dataset", dimension: str) -> list[str]:
    """Return the names of the coordinates that lie along one dimension alone, its own first."""
    names = [str(n) for n, c in dataset.coords.items() if c.dims == (dimension,)]
    return sorted(names, key=lambda name: name != dimension)


def axes_of(dataset: "xarray.Dataset", dims: Iterable[Any]) -> dict[str, Array]:
    """Return the axes of a dataset along some dimensions, as a result keeps them."""
    found = {}
    for name in map(str, dims):
        own = {n: dataset[n].values for n in coordinates_along(dataset, name)}
        found[name] = own[name] if list(own) == [name] else together(own)
    return found


def example(axes: Mapping[str, Array], name: str) -> str:
    """Return the first value of an axis as a selection, `gap=0.0004`."""
    number, values = next(iter(numbers_along(name, np.asarray(axes[name])).items()))
    first = values[0].item()
    return f"{number}={first:g}" if isinstance(first, int | float) else f"{number}={first!r}"


def pick(
    axes: Mapping[str, Array], selection: Mapping[str, Any], *, others: tuple[str, ...] = ()
) -> tuple[tuple[Any, ...], list[str]]:
    """Return the index of a selection (nearest values), and the axes left.

    Numbers that go together are picked by one of them, or by the name of their axis, which stands
    for the first. `others` are names that may be selected too, elsewhere. Raises `ValueError` for
    an unknown axis, a value that is none of it, or two numbers of one axis.
    """
    within = {name: numbers_along(name, np.asarray(values)) for name, values in axes.items()}
    axis_of = {name: name for name in within}
    axis_of |= {number: name for name, along in within.items() for number in along}
    wanted: dict[str, str] = {}
    for number in selection:
        if number not in axis_of:
            raise ValueError(f"Unknown axis {number!r}. {nearest(number, [*axis_of, *others])}")
        name = axis_of[number]
        if name in wanted:
            raise ValueError(
                f"{wanted[name]} and {number} go together along {name}: select by one of them."
            )
        wanted[name] = number
    index: list[Any] = []
    for name, along in within.items():
        if name not in wanted:
            index.append(slice(None))
            continue
        number = wanted[name]
        values = along.get(number, next(iter(along.values())))
        index.append(nearest_place(number, values, selection[number]))
    return tuple(index), [name for name in within if name not in wanted]


def view_of(
    dataset: "xarray.Dataset",
    axes: Mapping[str, Array],
    selection: Mapping[str, Any],
    call: str,
    *,
    others: tuple[str, ...] = (),
) -> "xarray.Dataset":
    """Return a dataset at a selection; one of the axes may be left.

    Raises `ValueError` as `pick` does, or where more are left; its advice is the `call`.
    """
    index, left = pick(axes, selection, others=others)
    if len(left) > 1:
        raise ValueError(
            f"{len(left)} axes are left, {' and '.join(left)}: give a value of all but one, such "
            f"as {call}({example(axes, left[0])})."
        )
    return dataset.isel(dict(zip(axes, index, strict=True)))


def lane_of(
    dataset: "xarray.Dataset", axes: Mapping[str, Array], selection: Mapping[str, Any]
) -> "xarray.Dataset":
    """Return a dataset at one value of every axis. Raises `ValueError` as `place_of` does."""
    return dataset.isel(dict(zip(axes, place_of(axes, selection), strict=True)))


def place_of(axes: Mapping[str, Array], selection: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the index of one value of every axis; of an axis with one value, it is that.

    Raises `ValueError` as `pick` does, or for an axis without a value.
    """
    index, left = pick(axes, selection)
    if left := [name for name in left if len(axes[name]) > 1]:
        given = example(axes, left[0])
        raise ValueError(f"Give a value of {' and '.join(left)} too, such as {given}.")
    return tuple(0 if isinstance(at, slice) else at for at in index)


def nearest_place(name: str, values: Array, wanted: Any) -> int:
    """Return where the value nearest to a number lies, or a word.

    Raises `ValueError` for what is no finite number, or a word that is none of the values.
    """
    if values.dtype.kind not in "fiu":
        known = values.tolist()
        if wanted not in known:
            listed = ", ".join(map(repr, known))
            raise ValueError(f"{name} must be one of {listed}, got {wanted!r}.")
        return known.index(wanted)
    if np.ndim(wanted) or not isinstance(wanted, int | float | np.generic | np.ndarray):
        raise ValueError(f"{name} must be one number, got {wanted!r}.")
    if not np.isfinite(wanted):
        raise ValueError(f"{name} must be finite, got {wanted!r}.")
    return int(np.argmin(np.abs(values - wanted)))


class AxisScale(NamedTuple):
    """How an axis is drawn: to scale by its numbers, or one value after the other."""

    places: Array
    """Where the values lie."""
    labels: list[str]
    """What each is called, with everything that goes along with it."""
    number: str
    """Name of the number that makes the scale, or of the axis where none does."""
    partners: str
    """What changes along with it, for a label of the axis."""
    is_scale: bool
    """Whether the places are values of the number, not merely counted."""

    @property
    def label(self) -> str:
        """Long name and unit of the number, and what changes along with it."""
        attributes = axis_description(self.number)
        return with_unit(attributes["long_name"], attributes["units"]) + self.partners


def axis_scale(axes: Mapping[str, Array], name: str) -> AxisScale:
    """Return how an axis is drawn: by its first number whose values all differ."""
    values = np.asarray(axes[name])
    along = numbers_along(name, values)
    labels = [
        ", ".join(named_value(n, own[k].item()) for n, own in along.items())
        for k in range(len(values))
    ]
    numeric = {n: v for n, v in along.items() if v.dtype.kind in "fiu"}
    number = next((n for n, v in numeric.items() if len(np.unique(v)) == len(v)), None)
    if len(along) == 1 and numeric:  # a plain axis is its own scale
        number = name
    others = [n.replace("_", " ") for n in along if n not in (number, name)]
    partners = f", with {' and '.join(others)}" if others and number else ""
    if number is None:
        return AxisScale(np.arange(len(values), dtype=float), labels, name, partners, False)
    return AxisScale(np.asarray(along[number], float), labels, number, partners, True)
