"""Arrays in nested groups, as MAT, HDF5 and TDMS files hold them: which of them make a table."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax.measured.clocks import Clock, side_by_side
from vibrojax.measured.table import NoTable, Table, listed, table_of
from vibrojax.measured.units import AXES, UNITS, find_unit, split_header

_VALUES = ("values", "value", "data")
_UNIT = ("unit", "units")
_STEPS = ("dt", "deltat", "timestep", "samplinginterval", "sampletime")
_RATES = ("fs", "samplingrate", "samplerate", "samplingfrequency", "samplefrequency")


class Array(NamedTuple):
    """An array of a file, before it is read."""

    shape: tuple[int, ...]
    read: Callable[[], Any]
    unit: str | None = None
    names: tuple[str, ...] = ()
    """Of the columns of a matrix."""
    clock: Clock | None = None
    """Where its values are along the axis, if the file says so."""


UNREADABLE = Array((0,), list)
"""In place of what is empty, or of a kind that cannot be read."""
Group = Mapping[str, Any]
"""Arrays and further groups by name."""


def table_in(
    group: Group, at: str | int | None, wanted: Iterable[Any], axis: str, separator: str
) -> Table:
    """Return the table that a file holds: the arrays of equal length of one group.

    `at` is the path of a group or an array, None: the only group that has a table. `wanted` are
    the columns asked for, which decide between lengths. `axis` is `time` or `frequency`. Raises
    `NoTable` where there is no table or it is not clear which.
    """
    path, found = _place(group, at, separator)
    if isinstance(found, Array):
        columns = _columns_of(path.rpartition(separator)[2], found)
        if len(columns) < 2:
            raise NoTable(
                f"holds no table at {path!r} but {_described(found)}: give the path of a group"
            )
    else:
        tables = {p: own for p, own in _groups(found, path, separator) if _is_table(own)}
        if at is not None and path in tables:
            tables = {path: tables[path]}
        if len(tables) > 1:
            choices = "; ".join(f"{p or separator!r} ({listed(t)})" for p, t in tables.items())
            first = next(iter(tables)) or separator
            raise NoTable(f"holds {len(tables)} tables: {choices}. Say which: at={first!r}")
        path, columns = next(iter(tables.items()), (path, _scattered(found, separator)))
        if not columns:
            raise NoTable("holds no array" + _unread(found))
    table = _table(columns, list(wanted), axis)
    notes = [f"Read from {path!r} in the file."] if path else []
    return table._replace(notes=(*notes, *table.notes))


def _place(group: Group, at: str | int | None, separator: str) -> tuple[str, Array | Group]:
    """Return the full path of what is at a path, and that."""
    path, found = "", group
    rest = "" if at is None else str(at).strip("/.")
    while rest:
        names = [] if isinstance(found, Array) else list(found)
        fits = [n for n in names if rest == n or rest.startswith((f"{n}.", f"{n}/"))]
        if not fits or isinstance(found, Array):
            raise NoTable(
                f"holds nothing at {at!r}: there is no {rest!r} in {path or 'the file'!r}. "
                + nearest(rest, names).rstrip(".")
            )
        name = max(fits, key=len)
        path, found = _joined(path, name, separator), found[name]
        rest = rest[len(name) + 1 :]
        if not isinstance(found, Array):
            found = _valued(found) or found
    return path, found


def _joined(path: str, name: str, separator: str) -> str:
    return f"{path}{separator}{name}" if path else name


def _valued(group: Group) -> Array | None:
    """Return the array of a group that is one array with its unit; None for any other."""
    long = [n for n, item in group.items() if isinstance(item, Array) and _length(item) > 1]
    if len(long) != 1 or long[0].lower() not in _VALUES:
        return None
    if any(not isinstance(item, Array) for item in group.values()):
        return None
    array = group[long[0]]
    assert isinstance(array, Array)
    texts = [item for n, item in group.items() if n.lower() in _UNIT and isinstance(item, Array)]
    unit = texts[0].read() if texts else array.unit
    return array._replace(unit=unit if isinstance(unit, str) else None, clock=_clock(group))


def _length(array: Array) -> int:
    """Number of rows of an array; 0 where it is no column and no matrix."""
    long = [n for n in array.shape if n != 1]
    return max(long) if 0 < len(long) < 3 and 0 not in long else 0


def _described(array: Array) -> str:
    if array.shape == (0,):
        return "an empty array, or of a kind that cannot be read"
    shape = " x ".join(map(str, array.shape))
    return f"an array of {shape}" if shape else "a single value"


def _columns_of(name: str, array: Array) -> dict[str, Array]:
    """Return the columns of an array: one of a vector, several of a matrix."""
    rows = _length(array)
    if rows < 2:
        return {}
    if int(np.prod(array.shape)) == rows:
        return {name: array._replace(shape=(rows,), read=lambda: np.ravel(array.read()))}
    wide = int(np.prod(array.shape)) // rows
    names = array.names if len(array.names) == wide else [f"{name} {k}" for k in range(wide)]
    kept: list[np.ndarray] = []

    def column(k: int) -> np.ndarray:
        if not kept:
            matrix = np.squeeze(np.asarray(array.read()))
            kept.append(matrix if len(matrix) == rows else matrix.T)
        return kept[0][:, k]

    one = array._replace(shape=(rows,), unit=None)
    return {n: one._replace(read=lambda k=k: column(k)) for k, n in enumerate(names)}


def _clock(group: Group) -> Clock | None:
    """Return the clock that a group says by a single value, such as `fs` or `dt`."""
    for name, item in group.items():
        words, unit = split_header(name)
        if not isinstance(item, Array) or int(np.prod(item.shape)) != 1:
            continue
        if words in _STEPS or words in _RATES:
            value = np.ravel(item.read())[0]
            if isinstance(value, str) or not np.isrealobj(value):
                raise NoTable(f"holds no number in {name!r} but {str(value)!r}")
            unit = find_unit(unit or item.unit or "s")
            if words in _STEPS:
                return Clock(0.0, float(value), unit or "s")
            hertz = UNITS[unit].factor if unit and UNITS[unit].kind == "frequency" else 1.0
            with np.errstate(divide="ignore"):
                return Clock(0.0, float(np.divide(1.0, hertz * value)))
    return None


def _own(group: Group) -> dict[str, Array]:
    """Return the columns of the arrays of a group itself."""
    clock, found = _clock(group), {}
    for name, item in group.items():
        array = item if isinstance(item, Array) else _valued(item)
        if array is None:
            continue
        for column, part in _columns_of(name, array).items():
            if column in found:
                raise NoTable(f"has several columns named {column!r}")
            found[column] = part if part.clock else part._replace(clock=clock)
    return found


def _groups(group: Group, path: str, separator: str) -> Iterator[tuple[str, dict[str, Array]]]:
    """Yield path and columns of a group and of all those in it."""
    yield path, _own(group)
    for name, item in group.items():
        if not isinstance(item, Array) and _valued(item) is None:
            yield from _groups(item, _joined(path, name, separator), separator)


def _is_table(columns: Mapping[str, Array]) -> bool:
    """Whether there are two columns of one length, or a clock."""
    counts = Counter(column.shape[0] for column in columns.values())
    return max(counts.values(), default=0) > 1 or any(c.clock for c in columns.values())


def _unread(group: Group) -> str:
    """Say which arrays of a group are empty, or cannot be read."""
    names = [n for n, item in group.items() if isinstance(item, Array) and 0 in item.shape]
    if not names:
        return ""
    return (
        f" but {listed(names)}, empty or of a kind that cannot be read, such as MATLAB's tables "
        "and timeseries: save their columns as arrays"
    )


def _scattered(group: Group, separator: str) -> dict[str, Array]:
    """Return the columns of all groups in one, by the last part of their paths if that is clear."""
    found = {
        _joined(path, name, separator): column
        for path, own in _groups(group, "", separator)
        for name, column in own.items()
    }
    short = {path: path.rpartition(separator)[2] for path in found}
    counts = Counter(short.values())
    return {n if counts[n] == 1 else path: found[path] for path, n in short.items()}


def _table(columns: Mapping[str, Array], wanted: list[Any], axis: str) -> Table:
    """Return the table of the columns that are equally long, or that have clocks."""
    named = any(re.fullmatch(AXES[axis], split_header(name).words) for name in columns)
    clocked = {n: c for n, c in columns.items() if c.clock and c.clock.axis == axis}
    if clocked and not named:
        return _clocked(columns, clocked, axis)
    names = _equally_long(columns, wanted)
    units = {n: columns[n].unit for n in names}
    left = [n for n in columns if n not in names]
    rows = columns[names[0]].shape[0]
    notes = [f"Left out, as their length is not {rows}: {listed(left)}."] if left else []
    return table_of({n: np.asarray(columns[n].read()) for n in names}, units, notes)


def _clocked(columns: Mapping[str, Array], clocked: Mapping[str, Array], axis: str) -> Table:
    parts, unit = {}, next(iter(clocked.values())).clock
    assert unit is not None
    for name, column in clocked.items():
        assert column.clock is not None
        if column.clock.unit != unit.unit:
            raise NoTable(f"has columns in steps of {unit.unit} and of {column.clock.unit}")
        values = np.asarray(column.read())
        if values.dtype.kind in "fiuc":
            parts[name] = (column.clock.places(name, len(values)), values)
    if not parts:
        raise NoTable(f"holds no numbers in {listed(clocked)}")
    places, found, said = side_by_side(parts)
    steps = {c.clock.step for c in clocked.values() if c.clock is not None}
    notes = [f"The {axis} was made of steps of {', '.join(f'{s:g}' for s in sorted(steps))} "
             f"{unit.unit} that the file says."]  # fmt: skip
    left = [n for n in columns if n not in parts]
    notes += [said] if said else []
    notes += [f"Left out, as nothing says their {axis}: {listed(left)}."] if left else []
    units = {n: c.unit for n, c in clocked.items()}
    return table_of({axis: places, **found}, {**units, axis: unit.unit}, notes)


def _equally_long(columns: Mapping[str, Array], wanted: list[Any]) -> list[str]:
    """Return the names of the columns of the length that has two at least."""
    of_length: dict[int, list[str]] = {}
    for name, column in columns.items():
        of_length.setdefault(column.shape[0], []).append(name)
    there = "; ".join(f"{length}: {listed(names)}" for length, names in of_length.items())
    several = {length: names for length, names in of_length.items() if len(names) > 1}
    if not several:
        raise NoTable(f"holds no two columns of equal length, but, by length, {there}")
    asked = [w for w in wanted if w in columns]
    lengths = {columns[name].shape[0] for name in asked} or set(several)
    if len(lengths) > 1 or not lengths <= set(several):
        example = next(iter(several.values()))[0]
        raise NoTable(
            f"holds columns of different lengths. By length, {there}. Those of a table must be "
            f"equally long: name them, as in columns=dict(time={example!r})"
        )
    return of_length[lengths.pop()]
