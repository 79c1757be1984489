"""Tables of measurements: read from files, datasets, data frames or dictionaries of arrays."""

import csv
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vibrojax._checks import nearest
from vibrojax.measured.units import split_header, unit_named

if TYPE_CHECKING:
    import xarray


class Table(NamedTuple):
    """Columns of equal length, as read: numbers, or text that may hold them."""

    columns: dict[str, np.ndarray]
    units: dict[str, str]
    """Units that came with the columns other than in their names."""
    lines: np.ndarray
    """Line of the file, or row counted from 1."""
    counted: str
    """What `lines` counts: `line` or `row`."""
    label: str
    attached: dict[str, float]
    """Numbers that hold for the whole table."""
    inner: tuple[str, ...] = ()
    """Columns that were axes of a dataset besides direction and frequency, with several values."""
    notes: tuple[str, ...] = ()

    def take(self, rows: np.ndarray) -> "Table":
        """Return the table of some rows."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return self._replace(columns=columns, lines=self.lines[rows])


def read_table(source: Any, wanted: Iterable[Any] = (), along: str | None = None) -> Table:
    """Read a table from a path, a dataset, a data frame or a dictionary of arrays.

    `wanted` are the columns asked for: whole numbers among them are positions in a file, counted
    from 0. With `along`, only variables along that dimension are taken from a dataset, and forces
    are summed over stops. Raises `ValueError` when the source cannot be read or is no table.
    """
    import xarray

    wanted = list(wanted)
    if isinstance(source, str | os.PathLike):
        path = Path(source)
        if not path.is_file():
            raise ValueError(f"File {os.fspath(path)!r} does not exist.")
        if path.suffix.lower() in (".nc", ".nc4", ".h5", ".hdf5"):
            try:
                with xarray.open_dataset(path, engine="h5netcdf") as dataset:
                    return _of_dataset(dataset.load(), wanted, along)._replace(label=path.stem)
            except OSError as error:
                raise ValueError(f"{path.name!r} cannot be read as NetCDF: {error}.") from None
        return _of_text(path, any(isinstance(w, int) for w in wanted))
    if isinstance(source, xarray.Dataset):
        return _of_dataset(source, wanted, along)
    if hasattr(source, "columns") and hasattr(source, "to_numpy"):
        return _of_arrays({str(name): source[name].to_numpy() for name in source.columns})
    if isinstance(source, Mapping):
        return _of_arrays({str(name): values for name, values in source.items()})
    if hasattr(source, "to_xarray"):
        return _of_dataset(source.to_xarray(), wanted, along)
    raise ValueError(
        f"source must be a path, a dataset, a data frame or a dict of arrays, got {type(source)}."
    )


def _of_arrays(values: Mapping[str, Any]) -> Table:
    columns = {name: np.asarray(column) for name, column in values.items()}
    sizes = {name: column.shape for name, column in columns.items()}
    if len(set(sizes.values())) != 1 or any(len(shape) != 1 for shape in sizes.values()):
        raise ValueError(f"Columns must be one-dimensional and equally long, got shapes {sizes}.")
    rows = next(iter(sizes.values()))[0]
    return Table(columns, {}, np.arange(1, rows + 1), "row", "", {})


OWN = ("amplitude_ratio", "peak_ratio", "rms_ratio", "first_harmonic_ratio")
"""Variables by which a frequency response of our own is known."""


def _of_dataset(dataset: "xarray.Dataset", wanted: list[Any], along: str | None) -> Table:
    import xarray

    if along is not None and along in dataset.dims:
        if "stop" in dataset.dims and "contact_force" in dataset:
            force = dataset["contact_force"]
            dataset = dataset.assign(contact_force=force.sum("stop", keep_attrs=True))
        dataset = dataset[[n for n in dataset.data_vars if dataset[n].dims == (along,)]]

    asked = [name for name in wanted if isinstance(name, str) and name in dataset.data_vars]
    names = [n for n in asked if dataset[n].ndim] or [n for n in dataset.data_vars]
    own = set(OWN) <= set(dataset.data_vars)
    names = [OWN[0]] if own else names
    if not names:
        raise ValueError("The dataset has no variables.")
    dims = max((dataset[name].dims for name in names), key=len)
    needed = set(dims) - {"direction"}
    kept = {}
    for name, variable in dataset.variables.items():
        is_axis = name in dataset.coords and variable.ndim > 0
        if set(variable.dims) <= set(dims) and (is_axis or needed <= set(variable.dims)):
            kept[str(name)] = dataset[name]
    spread = xarray.broadcast(*(array.reset_coords(drop=True) for array in kept.values()))
    columns = {n: a.transpose(*dims).values.ravel() for n, a in zip(kept, spread, strict=True)}
    units = {n: str(a.attrs["units"]) for n, a in kept.items() if "units" in a.attrs}
    inner = tuple(str(d) for d in dims[:-1] if d != "direction" and dataset.sizes[d] > 1)
    attached = {}
    if own:
        for name, value in dataset.coords.items():
            single = value.size == 1 and name not in ("direction", *dims[-1:])
            if single and np.issubdtype(value.dtype, np.number):
                attached[str(name)] = float(value.values.ravel()[0])
    rows = int(np.prod([dataset.sizes[d] for d in dims]))
    return Table(columns, units, np.arange(1, rows + 1), "row", "", attached, inner)


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is not None:
        reader = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
        return [cell.strip() for cell in next(reader, [])]
    # A unit in brackets belongs to the word before it.
    return re.sub(r"\s+(?=[\[(])", "", line).split()


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", ".") if cell.count(",") == 1 and "." not in cell else cell)
    except ValueError:
        return False
    return True


def _of_text(path: Path, by_position: bool) -> Table:
    """Read a file of delimited text, with a header unless columns are asked for by position."""
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    if "\0" in text:
        raise ValueError(f"{path.name!r} is not text.")
    comment, rows = "", []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith("#"):
            comment = comment if rows else line.lstrip().lstrip("#").strip()
        elif line.strip():
            rows.append((number, line))
    if not rows:
        raise ValueError(f"{path.name!r} has no rows.")
    delimiter = next((d for d in (";", "\t", ",") if d in rows[0][1]), None)
    cells = [(number, _cells(line, delimiter)) for number, line in rows]
    first = cells[0][1]
    if not all(_is_number(cell) for cell in first):
        header, cells = first, cells[1:]
    elif len(header := _cells(comment, delimiter)) != len(first):
        if not by_position:
            raise ValueError(
                f"{path.name!r} has no header: its first row is numbers. Give the columns by "
                "position, counted from 0: columns=dict(frequency=0, amplitude=1)."
            )
        header = [f"column {k}" for k in range(len(first))]
    header = [name or f"column {k}" for k, name in enumerate(header)]
    double = {name for name in header if header.count(name) > 1}
    if double:
        raise ValueError(f"{path.name!r} has several columns named {', '.join(sorted(double))}.")
    width = len(header)
    decimal_comma = delimiter != "," and any(
        re.fullmatch(r"[+-]?\d+,\d+([eE][+-]?\d+)?", cell) for _, row in cells for cell in row
    )
    columns = {}
    for k, name in enumerate(header):
        column = [row[k] if k < len(row) else None for _, row in cells]
        if decimal_comma:
            column = [cell.replace(",", ".") if cell else cell for cell in column]
        columns[name] = np.array(column, dtype=object)
    notes = ("Commas were read as decimal points.",) if decimal_comma else ()
    wide = [number for number, row in cells if len(row) > width and any(row[width:])]
    if wide:
        raise ValueError(
            f"{path.name!r} has more cells than its header's {width} on line {wide[0]}"
            + (f" and {len(wide) - 1} more lines." if len(wide) > 1 else ".")
        )
    lines = np.array([number for number, _ in cells], dtype=int)
    return Table(columns, {}, lines, "line", path.stem, {}, (), notes)


def numbers(values: np.ndarray, name: str, reasons: dict[int, str]) -> np.ndarray:
    """Return a column as floats; rows that hold none get a reason, and NaN."""
    found = np.full(len(values), np.nan)
    for row, value in enumerate(values):
        try:
            found[row] = float(value)
        except (TypeError, ValueError):
            missing = value is None
            reason = "too few cells" if missing else f"{name} is no number: {str(value)!r}"
            reasons.setdefault(row, reason)
            continue
        if not np.isfinite(found[row]):
            reasons.setdefault(row, f"{name} is {found[row]:g}")
    return found


def find_column(table: Table, key: str, given: Any) -> str:
    """Return the name of a column asked for by name or by position.

    Raises `ValueError` when there is none.
    """
    names = list(table.columns)
    if isinstance(given, int) and not isinstance(given, bool):
        if 0 <= given < len(names):
            return names[given]
        raise ValueError(
            f"columns: {key} must be a position from 0 to {len(names) - 1}, got {given}."
        )
    if given in names:
        return str(given)
    alike = [n for n in names if n.strip().lower() == str(given).strip().lower()]
    alike = alike or [n for n in names if split_header(n) == split_header(str(given))]
    alike = alike or [n for n in names if split_header(n).words == split_header(str(given)).words]
    if len(alike) == 1:
        return alike[0]
    raise ValueError(
        f"columns: there is no column {given!r} for {key}. {nearest(str(given), names)}"
    )


def match_columns(
    table: Table,
    patterns: Mapping[str, str],
    given: Mapping[str, Any] | None,
    taken: Iterable[str] = (),
) -> dict[str, str]:
    """Return the column of every key: the one given, or the one whose name fits the pattern.

    None given leaves a key out. Raises `ValueError` for an unknown key or column, and where several
    columns fit.
    """
    given = dict(given or {})
    for key in given:
        if key not in patterns:
            raise ValueError(f"columns: unknown key {key!r}. {nearest(str(key), patterns)}")
    found = {k: find_column(table, k, name) for k, name in given.items() if name is not None}
    used = {*found.values(), *taken}
    for key, pattern in patterns.items():
        if key in given:
            continue
        fits = [
            name
            for name in table.columns
            if name not in used and re.fullmatch(pattern, split_header(name).words)
        ]
        if len(fits) > 1:
            raise ValueError(
                f"Columns {', '.join(map(repr, fits))} may all be the {key}. "
                f"Say which: columns=dict({key}={fits[0]!r}), or None for none of them."
            )
        if fits:
            found[key] = fits[0]
    return found


def column_unit(
    table: Table, key: str, column: str, units: Mapping[str, Any], kinds: Iterable[str]
) -> str | None:
    """Return the unit of a column: as given, as its name says, or as came with it; else None.

    Raises `ValueError` for a unit that is not known or is of another kind.
    """
    written = split_header(column).unit
    for text in (units.get(key), table.units.get(column), written):
        if text is not None:
            return unit_named(key, text, kinds)
    return None


def unusable(table: Table, reasons: Mapping[int, str], skip: bool) -> tuple[np.ndarray, str | None]:
    """Return the rows to use, and a sentence that names the others.

    Raises `ValueError` where rows are unusable and must not be skipped, or none is left.
    """
    rows = len(table.lines)
    keep = np.array([row not in reasons for row in range(rows)], dtype=bool)
    if keep.all() and rows:
        return keep, None
    bad = np.flatnonzero(~keep)
    named = [f"{table.counted} {table.lines[row]} ({reasons[row]})" for row in bad[:6]]
    more = f" and {len(bad) - 6} more" if len(bad) > 6 else ""
    listed = ", ".join(named) + more
    if not keep.any():
        raise ValueError(f"There is no usable row{': ' + listed if listed else ''}.")
    count = f"{len(bad)} unusable row{'s' if len(bad) > 1 else ''}"
    if not skip:
        raise ValueError(f"{count}: {listed}. Correct them, or leave them out: skip_unusable=True.")
    return keep, f"{count} left out: {listed}."
