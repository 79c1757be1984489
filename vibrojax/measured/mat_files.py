"""MATLAB's files of version 4 to 7, by scipy: structs, arrays of structs, cells, text."""

import io
import math
import struct
import zlib
from typing import Any

import numpy as np

from vibrojax.measured.groups import UNREADABLE, Array, Group
from vibrojax.measured.table import NoTable

_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
"""Bytes of a value by the number of its type in a file of version 5."""
_MATRIX, _COMPRESSED = 14, 15
_INDICES, _NAMES = (5, 6), (1, 16)
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17


def read_mat(raw: bytes) -> Group:
    """Return what a MAT file holds.

    Raises `NoTable` for a file of version 5 that is damaged, and whatever scipy does for others.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(io.BytesIO(raw))[0] == 1:
        try:
            _check(memoryview(raw)[128:], "<" if raw[126:128] == b"IM" else ">")
        except (ValueError, LookupError, struct.error, zlib.error):
            raise NoTable("is a MAT file that is damaged or cut short") from None
    return _group(loadmat(io.BytesIO(raw), simplify_cells=True))


def _check(data: memoryview, order: str) -> None:
    """Raise `ValueError` for elements that scipy would follow out of the file, and crash.

    The layout is that of "MAT-File Format", MathWorks. What is compressed has a check sum.
    """
    for kind, body in _elements(data, order, top=True):
        if kind == _COMPRESSED:
            zlib.decompress(body)
        elif kind == _MATRIX:
            _check_matrix(body, order)
        else:
            raise ValueError(f"an element of type {kind} is where a variable should be")


def _elements(data: memoryview, order: str, top: bool = False) -> list[tuple[int, memoryview]]:
    """Return types and bodies of the elements of a part of a file."""
    found, at = [], 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # type and up to four bytes in one
            kind, size, start, end = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        else:
            start = at + 8
            end = start + size + (0 if top else -size % 8)
        body = data[start : start + size]
        if len(body) < size or start + size > end:
            raise ValueError("an element goes on beyond its end")
        found.append((kind, body))
        at = end
    return found


def _check_matrix(body: memoryview, order: str) -> None:
    if not body:
        return
    (_, flags), *parts = _elements(body, order)
    (marks,) = struct.unpack_from(f"{order}I", flags)
    kind = marks & 0xFF
    if kind == _OPAQUE:
        expected, inner = {part[0] for part in parts[:3]} <= {*_NAMES}, parts[3:]
    else:
        (_, dims), (name, _), *values = parts
        shape = struct.unpack(f"{order}{len(dims) // 4}i", dims)
        count, columns, is_complex = math.prod(shape), shape[1], bool(marks & 0x800)
        expected = parts[0][0] in _INDICES and name in _NAMES and min(shape) >= 0
        inner = values if kind in (_CELL, _FUNCTION) else []
        if kind in (_STRUCT, _OBJECT):
            (_, width), (text, names), *inner = values[kind - _STRUCT :]  # behind a class's name
            (width,) = struct.unpack(f"{order}i", width)
            expected &= text in _NAMES and width > 0 and len(names) % width == 0
            expected &= len(inner) == count * (len(names) // width)
        elif kind == _CELL:
            expected &= len(inner) == count
        elif kind == _CHAR:
            expected &= len(values) == 1 and values[0][0] in _SIZES
        elif kind == _SPARSE:
            (row, rows), (column, starts), *numbers = values
            most = struct.unpack_from(f"{order}i", starts, 4 * columns)[0]
            expected &= {row, column} <= {*_INDICES} and len(starts) == 4 * columns + 4
            expected &= len(numbers) == 1 + is_complex and len(rows) >= 4 * most
            expected &= all(len(part) >= most * _SIZES[of] for of, part in numbers)
        elif kind != _FUNCTION:
            expected &= 6 <= kind <= 15 and len(values) == 1 + is_complex
            expected &= all(len(part) == count * _SIZES[of] for of, part in values)
    if not expected or any(part[0] != _MATRIX for part in inner):
        raise ValueError(f"a variable of class {kind} is not what its header says")
    for _, part in inner:
        _check_matrix(part, order)


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
        return {name: UNREADABLE}
    return {name: Array(array.shape, lambda: array)}
