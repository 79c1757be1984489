"""A table of measurements: named columns of equal length."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from vibrojax.measured.cells import decimal_signs, joined, number_in, sign_of
from vibrojax.measured.units import find_unit

_MOST_LISTED = 12


class NoTable(ValueError):
    """A file that holds no table, or several; the message goes on from the name of the file."""


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
    signs: Mapping[str, str] = {}
    """Decimal signs of columns of text, as `sign_of` has them; columns left out have points."""


def table_of(
    columns: dict[str, np.ndarray], units: Mapping[str, str | None], notes: Iterable[str]
) -> Table:
    """Return a table of columns and units, of which the rows are counted."""
    known = {name: unit for name, unit in units.items() if unit}
    rows = np.arange(1, len(next(iter(columns.values()))) + 1)
    return Table(columns, known, rows, "row", "", {}, notes=tuple(notes))


def listed(names: Iterable[str]) -> str:
    """Return names in quotes, the first of many."""
    names = list(names)
    more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
    return ", ".join(map(repr, names[:_MOST_LISTED])) + more


def signs_in(table: Table) -> str | None:
    """Return the decimal signs that the cells of text show, as `decimal_signs` does."""
    texts = [joined(cells) for cells in table.columns.values() if cells.dtype.kind in "OUT"]
    return decimal_signs("\n".join(texts))


def with_signs(table: Table, of_file: str | None, decimal: str | None) -> Table:
    """Add the decimal signs of columns of text, and a note where the cells showed them."""
    if of_file is None:
        return table
    texts = {n: joined(c) for n, c in table.columns.items() if c.dtype.kind in "OUT"}
    signs = {name: decimal or sign_of(text, of_file) for name, text in texts.items()}
    notes = []
    if decimal is None and any("," in sign for sign in (of_file, *signs.values())):
        notes.append("Commas were read as decimal points.")
    if decimal is None:
        thousands = [n for n, sign in signs.items() if sign == "." and "," in texts[n]]
        notes += [f"Commas of column {n!r} were read as marks of thousands." for n in thousands]
    return table._replace(signs=signs, notes=(*table.notes, *notes))


def with_units_row(table: Table) -> Table:
    """Take a first row that holds units for the units of the columns."""
    first = {name: cells[0] for name, cells in table.columns.items() if len(cells) > 1}
    texts = {n: cell.strip() for n, cell in first.items() if isinstance(cell, str)}
    said = {name: text.strip("[]()") for name, text in texts.items() if text not in ("", "-")}
    words = all(find_unit(unit) and number_in(unit) is None for unit in said.values())
    if not said or not words or len(texts) < len(table.columns):
        return table
    columns = {name: cells[1:] for name, cells in table.columns.items()}
    note = f"Units are those of {table.counted} {table.lines[0]}."
    return table._replace(
        columns=columns, units=said, lines=table.lines[1:], notes=(*table.notes, note)
    )
