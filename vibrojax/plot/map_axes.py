"""What of a map goes on which axis of a picture: names, places, labels, selections."""

from typing import Any, NamedTuple

import numpy as np
import xarray

from vibrojax._tools.checks import nearest
from vibrojax.plot.style import ARROWS, edges_of
from vibrojax.results.axes import axes_of, coordinates_along, pick
from vibrojax.results.variables import PLAIN, axis_description

FREQUENCIES = ("frequency_ratio", "frequency")
RESPONSES = ("direction", "crossing")
"""Dimensions of several responses of one system at one frequency."""
LOGARITHMIC = 1.5  # decades


class MapAxis(NamedTuple):
    """One axis of a picture."""

    name: str
    dimension: str
    words: str
    units: str
    partners: str
    """What changes along with it."""
    places: np.ndarray
    """Where the values lie in the picture, ascending."""
    names: list[str] | None
    """Of values that are not numbers."""
    logarithmic: bool

    def label(self, factor: str = "") -> str:
        """Return name and unit, of values that are in multiples of a factor."""
        units = " ".join(part for part in (factor, self.units) if part)
        return f"{self.words}{f' ({units})' if units else ''}{self.partners}"

    @property
    def edges(self) -> np.ndarray:
        """Ends of the cells, half way between neighbours."""
        if self.logarithmic:
            return np.exp(edges_of(np.log(self.places)))
        return edges_of(self.places)


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


def measures_of(dataset: xarray.Dataset) -> list[str]:
    """Return the names of the numbers of whole curves."""
    own = {n: dataset[n] for n in variables_of(dataset) if dataset[n].dtype.kind == "f"}
    return [n for n, v in own.items() if not {*FREQUENCIES, *RESPONSES} & set(v.dims)]


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


def select(dataset: xarray.Dataset, variable: str, selection: dict[str, Any]) -> xarray.Dataset:
    """Return the dataset at the values wanted, the nearest of numbers.

    Raises `ValueError` for an axis that the variable has not, a value that is no finite number, or
    a name that is not on the axis.
    """
    for name in selection:
        dimension_of(dataset, variable, name)
    axes = axes_of(dataset, dataset[variable].dims)
    index, _ = pick(axes, selection)
    return dataset.isel(dict(zip(axes, index, strict=True)))


def read_axes(
    dataset: xarray.Dataset, variable: str, *names: str
) -> tuple[xarray.Dataset, list[MapAxis]]:
    """Return axes, and the dataset sorted along those that are drawn to scale."""
    axes = [_read_axis(dataset, variable, name) for name in names]
    return dataset.sortby([axis.name for axis in axes if axis.names is None]), axes


def _read_axis(dataset: xarray.Dataset, variable: str, name: str) -> MapAxis:
    """Read an axis: to scale, logarithmic where its values are, or one value after the other."""
    dimension = dimension_of(dataset, variable, name)
    along = coordinates_along(dataset, dimension)
    numeric = [n for n in along if _is_scale(dataset[n].values)]
    if name not in along:  # the dimension of a zipped group
        name = next(iter(numeric), along[0])
    others = [n.replace("_", " ") for n in along if n not in (name, dimension)]
    partners = f", with {' and '.join(others)}" if others else ""
    attributes = axis_description(name) | dataset[name].attrs
    described = name, dimension, attributes["long_name"], units_of(dataset, name), partners
    values = dataset[name].values
    if name in numeric:
        places = np.sort(values).astype(float)
        return MapAxis(*described, places, None, _is_logarithmic(places))
    return MapAxis(*described, np.arange(len(values)), [word(v) for v in values], False)


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
    units = str((axis_description(name) | dataset[name].attrs)["units"])
    return "" if units in PLAIN else units


def word(value: Any) -> str:
    """Return one value of a coordinate as it is written on an axis."""
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    return ARROWS.get(str(value), str(value))
