"""What of a map goes on which axis of a picture: names, places, labels, selections."""

from typing import Any, NamedTuple

import numpy as np
import xarray

from vibrojax._tools.checks import nearest
from vibrojax.plot.style import WORDS, edges_of
from vibrojax.results.axes import nearest_place
from vibrojax.results.variables import axis_description

FREQUENCIES = ("frequency_ratio", "frequency")
RESPONSES = ("direction", "crossing")
"""Dimensions of several responses of one system at one frequency."""
LOGARITHMIC = 1.5  # decades
SHORT_WORDS = {"forward": f"{WORDS['forward']} \u2192", "backward": f"\u2190 {WORDS['backward']}"}


class MapAxis(NamedTuple):
    """One axis of a picture, in ascending order."""

    dimension: str
    words: str
    units: str
    partners: str
    """What changes along with it."""
    order: np.ndarray
    """How the values of the dataset are sorted."""
    places: np.ndarray
    """Where they lie in the picture, ascending."""
    names: list[str] | None
    """Of values that are not numbers."""
    logarithmic: bool

    @property
    def label(self) -> str:
        """Name and unit, and what changes along with it."""
        return self.scaled_label("")

    def scaled_label(self, factor: str) -> str:
        """Return the label for values that are in multiples of a factor."""
        units = " ".join(part for part in (factor, self.units) if part)
        return f"{self.words}{f' ({units})' if units else ''}{self.partners}"

    @property
    def edges(self) -> np.ndarray:
        """Ends of the cells, half way between neighbours."""
        places = np.log(self.places) if self.logarithmic else self.places
        edges = edges_of(places)
        return np.exp(edges) if self.logarithmic else edges


def check_map(dataset: Any) -> xarray.Dataset:
    """Return the dataset with a coordinate along every dimension.

    Raises `ValueError` when it is no dataset, or holds no numbers over axes.
    """
    if not isinstance(dataset, xarray.Dataset):
        raise ValueError(
            f"dataset must be an xarray.Dataset, such as that of vj.parameter_map or of "
            f"vj.frequency_sweep(...).to_xarray(), got {type(dataset).__name__}."
        )
    if not variables_of(dataset):
        raise ValueError(
            "dataset is not a map: none of its variables holds numbers over an axis. Draw the "
            "result of vj.parameter_map or of vj.frequency_sweep(...).to_xarray()."
        )
    bare = [d for d in dataset.dims if not coordinates_along(dataset, str(d))]
    return dataset.assign_coords({d: (d, np.arange(dataset.sizes[d])) for d in bare})


def variables_of(dataset: xarray.Dataset) -> list[str]:
    """Return the names of the variables that hold numbers over axes."""
    return [str(n) for n, v in dataset.data_vars.items() if v.dims and v.dtype.kind in "fiub"]


def coordinates_along(dataset: xarray.Dataset, dimension: str) -> list[str]:
    """Return the names of the coordinates that lie along one dimension alone, its own first."""
    names = [str(n) for n, c in dataset.coords.items() if c.dims == (dimension,)]
    return sorted(names, key=lambda name: name != dimension)


def parameters_of(dataset: xarray.Dataset, variable: str) -> list[str]:
    """Return the dimensions of the variable that are parameters, where they have two values."""
    others = (*FREQUENCIES, *RESPONSES)
    dims = [str(d) for d in dataset[variable].dims if dataset.sizes[d] > 1]
    return [d for d in dims if d not in others]


def dimension_of(dataset: xarray.Dataset, variable: str, name: str) -> str:
    """Return the dimension that a name, its own or that of a coordinate along it, stands for.

    Raises `ValueError` when the variable has no such axis.
    """
    dims = [str(d) for d in dataset[variable].dims]
    known = {n: d for d in dims for n in (d, *coordinates_along(dataset, d))}
    if name in known:
        return known[name]
    if name in dataset.dims:
        raise ValueError(f"{variable} does not depend on {name}: leave {name} out.")
    raise ValueError(f"Unknown axis {name!r} of {variable}. {nearest(name, known)}")


def read_axis(dataset: xarray.Dataset, variable: str, name: str) -> MapAxis:
    """Read an axis: sorted, to scale, logarithmic where its values are; others one by one."""
    dimension = dimension_of(dataset, variable, name)
    along = coordinates_along(dataset, dimension)
    numeric = [n for n in along if _is_scale(dataset[n].values)]
    if name not in along:  # the dimension of a zipped group
        name = next(iter(numeric), along[0])
    others = [n.replace("_", " ") for n in along if n not in (name, dimension)]
    partners = f", with {' and '.join(others)}" if others else ""
    described = dimension, long_name_of(dataset, name), units_of(dataset, name), partners
    values = dataset[name].values
    if name in numeric:
        order = np.argsort(values)
        places = values[order].astype(float)
        return MapAxis(*described, order, places, None, _is_logarithmic(places))
    rows = np.arange(len(values))
    return MapAxis(*described, rows, rows, [word(name, v) for v in values], False)


def _is_scale(values: np.ndarray) -> bool:
    """Whether the values are different numbers, so that they can be drawn to scale."""
    if not np.issubdtype(values.dtype, np.number) or not np.isfinite(values).all():
        return False
    return len(np.unique(values)) == len(values)


def _is_logarithmic(places: np.ndarray) -> bool:
    if len(places) < 3 or places[0] <= 0 or np.log10(places[-1] / places[0]) < LOGARITHMIC:
        return False
    steps, ratios = np.diff(places), np.diff(np.log(places))
    return bool(np.std(ratios) / np.mean(ratios) < np.std(steps) / np.mean(steps))


def units_of(dataset: xarray.Dataset, name: str) -> str:
    """Return the unit of a coordinate or variable, empty for a plain number."""
    units = str(dataset[name].attrs.get("units", axis_description(name)["units"]))
    return "" if units in ("1", "axis", "ratio") else units


def long_name_of(dataset: xarray.Dataset, name: str) -> str:
    """Return the long name of a coordinate or variable."""
    return str(dataset[name].attrs.get("long_name", axis_description(name)["long_name"]))


def word(name: str, value: Any) -> str:
    """Return one value of a coordinate as it is written on an axis."""
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    return SHORT_WORDS.get(str(value), str(value)) if name == "direction" else str(value)


def fixed_text(dataset: xarray.Dataset, variable: str, known: tuple[str, ...] = ()) -> str:
    """Return the coordinates that have one value, `gap = 0.0004 m`, without those known."""
    texts = []
    found = [n for n in fixed_names(dataset, variable) if n not in known]
    for name in sorted(found, key="direction".__eq__):  # the direction last
        coordinate = dataset[variable][name]
        text = word(name, coordinate.item())
        units = units_of(dataset, name)
        number = coordinate.dtype.kind in "fiu" and bool(units)
        texts.append(text if name == "direction" else f"{name} = {text}{f' {units}' * number}")
    return ", ".join(texts)


def fixed_names(dataset: xarray.Dataset, variable: str) -> tuple[str, ...]:
    """Return the names of the coordinates that have one value."""
    return tuple(str(n) for n, c in dataset[variable].coords.items() if not c.ndim)


def select(dataset: xarray.Dataset, variable: str, selection: dict[str, Any]) -> dict[str, int]:
    """Return where the values wanted lie, the nearest of numbers, by dimension.

    Raises `ValueError` for an axis that the variable has not, a value that is no finite number, or
    a name that is not on the axis.
    """
    taken: dict[str, str] = {}
    index: dict[str, int] = {}
    for name, value in selection.items():
        dimension = dimension_of(dataset, variable, name)
        if dimension in taken:
            raise ValueError(
                f"{taken[dimension]} and {name} lie along the same axis, {dimension}: select one."
            )
        taken[dimension] = name
        along = coordinates_along(dataset, dimension)
        values = dataset[name if name in along else along[0]].values
        index[dimension] = nearest_place(name, values, value)
    return index
