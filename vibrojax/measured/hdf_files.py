"""HDF5 files, and MATLAB's of version 7.3, which are such: groups, attributes, references."""

from typing import Any

import h5py
import numpy as np

from vibrojax.measured.groups import UNREADABLE, Array


def is_netcdf(file: h5py.File) -> bool:
    """Whether datasets of a file have named dimensions, as those of NetCDF have."""
    found = []

    def look(name: str, item: Any) -> bool | None:
        if isinstance(item, h5py.Dataset) and {"DIMENSION_LIST", "DIMENSION_SCALE"} & {
            *item.attrs,
            _text(item.attrs.get("CLASS", "")),
        }:
            found.append(name)
        return True if found else None

    file.visititems(look)
    return bool(found)


def read_hdf(group: h5py.Group, above: tuple[Any, ...] = ()) -> dict[str, Any]:
    """Return what a group of an open file holds; arrays are read later."""
    found: dict[str, Any] = {}
    above = (*above, group)
    for name in map(str, group):
        try:
            item = group[name]
        except (KeyError, OSError):  # a link to something that is not there
            found[name] = UNREADABLE
            continue
        if name in ("#refs#", "#subsystem#") or item in above:
            continue
        if isinstance(item, h5py.Group):
            found |= _structs(name, item, above)
        elif isinstance(item, h5py.Dataset):
            found |= _items(name, item, above)
    return found


def _structs(name: str, group: h5py.Group, above: tuple[Any, ...]) -> dict[str, Any]:
    """Return a group, or one for each of an array of structs, whose fields are references."""
    fields = {n: item for n, item in group.items() if _refers(item)}
    arrays = [n for n, item in fields.items() if _text(item.attrs.get("MATLAB_class", "")) == ""]
    if _text(group.attrs.get("MATLAB_class", "")) != "struct" or len(arrays) != len(group):
        return {name: read_hdf(group, above)}
    found: dict[str, Any] = {}
    for field, item in fields.items():
        for k, reference in enumerate(np.ravel(item[()]), 1):
            inside = found.setdefault(f"{name}({k})", {})
            inside |= _referred(field, item.file[reference], above) if reference else {}
    return found


def _refers(item: Any) -> bool:
    return isinstance(item, h5py.Dataset) and h5py.check_dtype(ref=item.dtype) is h5py.Reference


def _referred(name: str, item: Any, above: tuple[Any, ...]) -> dict[str, Any]:
    if item in above:
        return {}
    is_group = isinstance(item, h5py.Group)
    return _structs(name, item, (*above, item)) if is_group else _items(name, item, above)


def _items(name: str, item: h5py.Dataset, above: tuple[Any, ...]) -> dict[str, Any]:
    """Return what goes into a group for a dataset: its columns, or its cells, if it has any."""
    if item.shape is None or {"MATLAB_empty", "MATLAB_object_decode"} & {*item.attrs}:
        return {name: UNREADABLE}
    if _refers(item):
        cells = [item.file[reference] for reference in np.ravel(item[()]) if reference]
        texts = [c for c in cells if _is_char(c)]
        if cells and len(texts) == len(cells):
            return {name: Array((len(cells),), lambda: np.array([_chars(c) for c in cells], "O"))}
        found: dict[str, Any] = {}
        for k, cell in enumerate(cells, 1):
            found |= _referred(f"{name}{{{k}}}", cell, above)
        return found
    if _is_char(item):
        return {name: Array((), lambda: _chars(item))}
    fields = item.dtype.names
    if fields and not _is_complex(item.dtype):
        return {
            name: {
                field: Array(item.shape, lambda f=field: _values(item[f]), _unit(item, k))
                for k, field in enumerate(fields)
            }
        }
    names = next((_texts(item.attrs[n]) for n in ("columns", "names") if n in item.attrs), ())
    return {name: Array(item.shape, lambda: _values(item[()]), _unit(item), names)}


def _is_complex(dtype: np.dtype) -> bool:
    return dtype.names in (("r", "i"), ("real", "imag"))


def _is_char(item: Any) -> bool:
    return _text(item.attrs.get("MATLAB_class", "")) == "char"


def _chars(item: Any) -> str:
    return "".join(map(chr, np.ravel(np.asarray(item[()]).T)))


def _values(values: Any) -> Any:
    """Return values as read, complex numbers and text as such."""
    values = values.decode("latin-1") if isinstance(values, bytes) else values
    if isinstance(values, str):
        return values
    array = np.asarray(values)
    if _is_complex(array.dtype):
        real, imaginary = (array[n] for n in array.dtype.names or ())
        return real + 1j * imaginary
    if array.dtype.kind in "SO":
        return np.array([_text(v) for v in array.ravel().tolist()], "O").reshape(array.shape)
    return array


def _text(value: Any) -> Any:
    """Return text of bytes; anything else as it is."""
    value = value.item() if isinstance(value, np.generic) else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _texts(value: Any) -> tuple[str, ...]:
    return tuple(str(_text(part)) for part in np.ravel(value))


def _unit(item: h5py.Dataset, field: int = 0) -> str | None:
    """Return the unit that the attributes of a dataset say."""
    for name in ("units", "unit"):
        if name in item.attrs:
            texts = _texts(item.attrs[name])
            return texts[field] if field < len(texts) else None
    return None
