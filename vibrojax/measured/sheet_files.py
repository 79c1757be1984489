"""Workbooks of Excel and LibreOffice, by python-calamine: the table of a sheet."""

import datetime
from typing import Any

import numpy as np

from vibrojax.measured.cells import is_empty, number_in
from vibrojax.measured.table import NoTable, Table, listed

_DATES = (datetime.date, datetime.time, datetime.timedelta)


def read_sheet(workbook: Any, at: str | int | None, by_position: bool) -> Table:
    """Return the table of a sheet of an open `python_calamine.CalamineWorkbook`.

    `at` is the name of the sheet, None: the only one that has a table. Its header is the first
    row of two cells or more. A row with fewer cells before one with all names holds the names of
    runs. Raises `NoTable` where there is no table, or nothing says which is meant.
    """
    sheets = [sheet.name for sheet in workbook.sheets_metadata if "WorkSheet" in str(sheet.typ)]
    if at is not None and str(at) not in sheets:
        raise NoTable(f"has no sheet at={at!r}. Its sheets are {listed(sheets)}")
    rows = {
        name: workbook.get_sheet_by_name(name).to_python(skip_empty_area=False)
        for name in ([str(at)] if at is not None else sheets)
    }
    tables = [name for name, own in rows.items() if sum(_count(row) > 1 for row in own) > 1]
    if len(tables) > 1:
        raise NoTable(f"has {len(tables)} sheets: {listed(tables)}. Say which: at={tables[0]!r}")
    if not tables:
        raise NoTable(f"has no table of two columns in {listed(rows) or 'any sheet'}")
    table = _of_rows(rows[tables[0]], by_position)
    notes = (f"Read from sheet {tables[0]!r}.",) if len(sheets) > 1 else ()
    return table._replace(notes=notes)


def _count(row: list[Any]) -> int:
    """Number of cells of a row that are not empty."""
    return len(row) - row.count("")


def _of_rows(rows: list[list[Any]], by_position: bool) -> Table:
    first = next(k for k, row in enumerate(rows) if _count(row) > 1)
    header = [str(cell).strip() for cell in rows[first]]
    if all(number_in(cell) is not None for cell in rows[first] if cell != ""):
        if not by_position:
            raise NoTable(
                f"has no header: row {first + 1} is numbers. Give the columns by position, counted "
                "from 0: columns=dict(frequency=0, amplitude=1)"
            )
        header, first = [""] * len(header), first - 1
    elif "" in header and first + 1 < len(rows):
        below = rows[first + 1]
        is_text = all(isinstance(c, str) and number_in(c) is None for c in below)
        if is_text and _count(below) > _count(header):
            run = ""
            for k, name in enumerate(below):
                run = header[k] or run
                header[k] = f"{run}: {name.strip()}" if run else name.strip()
            first += 1
    given, header = header, [name or f"column {k}" for k, name in enumerate(header)]
    double = sorted({name for name in header if header.count(name) > 1})
    if double:
        raise NoTable(
            f"has several columns named {', '.join(double)}. Where they are runs side by side, "
            "name them so: 'Run 1: Time (s)'"
        )
    kept = [k for k in range(first + 1, len(rows)) if _count(rows[k])]
    columns = zip(*(rows[k] for k in kept), strict=True) if kept else [()] * len(header)
    found = {name: _column(list(cells)) for name, cells in zip(header, columns, strict=True)}
    nameless = {f"column {k}" for k, name in enumerate(given) if not name}
    found = {n: c for n, c in found.items() if n not in nameless or not is_empty(c).all()}
    return Table(found, {}, np.array(kept, int) + 1, "row", "", {})


def _column(cells: list[Any]) -> np.ndarray:
    """Return the cells of a column: numbers, with NaN for empty ones, where there is no text."""
    if {*map(type, cells)} <= {float, int}:
        return np.array(cells, float)
    filled = [cell for cell in cells if cell != ""]
    if {*map(type, filled)} <= {float, int}:
        return np.array([np.nan if cell == "" else cell for cell in cells], float)
    if any(isinstance(cell, _DATES) for cell in filled):
        return np.zeros(len(cells), "datetime64[s]")  # refused where the column is used
    return np.array(cells, dtype=object)
