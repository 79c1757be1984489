"""MATLAB's files of version 4 to 7, by scipy: structs, arrays of structs, cells, text."""

from typing import Any, BinaryIO

import numpy as np

from vibrojax.measured.groups import Array, Group


def read_mat(file: BinaryIO) -> Group:
    """Return what a MAT file holds; raises whatever scipy does for a file that is damaged."""
    from scipy.io import loadmat

    return _group(loadmat(file, simplify_cells=True))


def _group(values: dict[str, Any]) -> dict[str, Any]:
    found = {}
    for name, value in values.items():
        if not str(name).startswith("__"):
            found |= _items(str(name), value)
    return found


def _items(name: str, value: Any) -> dict[str, Any]:
    """Return what goes into a group for a variable or field: several items of a list of structs."""
    if isinstance(value, dict):
        return {name: _group(value)}
    if isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        parts = list(value) if isinstance(value, list) else list(value.ravel())
        if any(isinstance(part, dict | np.ndarray | list) for part in parts):
            brackets = "()" if all(isinstance(part, dict) for part in parts) else "{}"
            found = {}
            for k, part in enumerate(parts, 1):
                found |= _items(f"{name}{brackets[0]}{k}{brackets[1]}", part)
            return found
        value = np.array(parts, dtype=object)
    if isinstance(value, str):
        return {name: Array((), lambda: value)}
    array = np.asarray(value)
    if array.dtype.kind not in "fiucbUO" or hasattr(value, "tocoo"):  # objects, sparse matrices
        return {name: Array((0,), lambda: array)}
    return {name: Array(array.shape, lambda: array)}
