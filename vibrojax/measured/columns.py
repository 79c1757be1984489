"""Columns of a table of measurements: which is what, in which unit, and the numbers in it."""

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax.measured.cells import (
    DECIMALS,
    doubtful,
    is_empty,
    joined,
    number_in,
    numbers_in,
    with_points,
)
from vibrojax.measured.table import Table, listed
from vibrojax.measured.units import UNITS, find_unit, split_header, unit_named

CONTACT_FORCE = "(?:max|maximum|peak|largest)?(?:contact|impact)force"
ANY_FORCE = (
    "(?:max|maximum|peak|largest|rms|tip|beam)?(?:contact|impact)?(?:force|load)"
    "(?:max|peak|rms|amplitude|amp|sensor|cell|transducer)?"
)
_FORCE_SYMBOL = "f(?:[xyzc0-9]|max|peak)?"
"""May be a force where it is in newtons."""


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


def check_keys(argument: str, given: Iterable[Any], known: Collection[str]) -> None:
    """Raise `ValueError` for a key of an argument that is none of those known."""
    for key in given:
        if key not in known:
            raise ValueError(f"{argument}: unknown key {key!r}. {nearest(str(key), known)}")


def match_columns(
    table: Table,
    patterns: Mapping[str, str],
    given: Mapping[str, Any] | None,
    taken: Iterable[str] = (),
    optional: Iterable[str] = (),
) -> dict[str, str]:
    """Return the column of every key: the one given, or the one whose name fits the pattern.

    None given leaves a key out. Raises `ValueError` for an unknown key or column, where several
    columns fit a key that is not optional, and for a force of which nothing says whose it is.
    """
    given = dict(given or {})
    check_keys("columns", given, patterns)
    found = {k: find_column(table, k, name) for k, name in given.items() if name is not None}
    used = {*found.values(), *taken}
    left = {name: split_header(name) for name in table.columns if name not in used}
    forces = [name for name, header in left.items() if _is_some_force(*header)]
    left = {name: header for name, header in left.items() if name not in forces}
    for key, pattern in patterns.items():
        if key in given:
            continue
        fits = [name for name, header in left.items() if re.fullmatch(pattern, header.words)]
        if len(fits) > 1 and key not in optional:
            raise ValueError(
                f"Columns {', '.join(map(repr, fits))} may all be the {key}. "
                f"Say which: columns=dict({key}={fits[0]!r}), or None for none of them."
            )
        if len(fits) == 1:
            found[key] = fits[0]
    if forces and "contact_force" not in {*given, *found}:
        drive = f"columns=dict(drive={forces[0]!r}) for that of the drive, " * ("drive" in patterns)
        raise ValueError(
            f"Column {forces[0]!r} may be the contact force or the force of the drive. Say which: "
            f"columns=dict(contact_force={forces[0]!r}) takes it for the contact force, {drive}"
            "columns=dict(contact_force=None) leaves it out."
        )
    return found


def _is_some_force(words: str, unit: str | None) -> bool:
    """Whether a header names a force, or a load, and not whose it is."""
    if re.fullmatch(_FORCE_SYMBOL, words):
        named = find_unit(unit) if unit is not None else None
        return named is not None and UNITS[named].kind == "force"
    return bool(re.fullmatch(ANY_FORCE, words)) and not re.fullmatch(CONTACT_FORCE, words)


def column_unit(
    table: Table, key: str, column: str, units: Mapping[str, Any], kinds: Iterable[str]
) -> str | None:
    """Return the unit of a column: as given, as its name says, or as came with it; else None.

    Raises `ValueError` for a unit that is not known or is of another kind, or where the name and
    what came with it say different ones.
    """
    written, came = split_header(column).unit, table.units.get(column)
    if column == "amplitude_ratio":  # of our own results, whose name is one for all units
        written = None if came else written
    known = {find_unit(text) for text in (written, came) if text is not None} - {None}
    if key not in units and len(known) > 1:
        raise ValueError(
            f"Column {column!r} has the unit {written!r} in its name and {came!r} beside it. "
            f"Say which: units=dict({key}={written!r})."
        )
    for text in (units.get(key), came, written):
        if text is not None:
            return unit_named(key, text, kinds)
    return None


def taken(table: Table, columns: Mapping[str, str], units: Mapping[str, str]) -> str:
    """Return a sentence that says which column was taken for what, in which unit."""
    assignments = [
        f"{column!r} as {key.replace('_', ' ')}" + (f" in {units[key]}" if key in units else "")
        for key, column in columns.items()
    ]
    left = [name for name in table.columns if name not in columns.values()]
    unused = f"; not used: {listed(left)}" if left else ""
    return f"Columns were taken so: {', '.join(assignments)}{unused}."


class Unusable:
    """Rows that cannot be used, each with the first reason that was found."""

    def __init__(self, rows: int):
        self.rows = np.zeros(rows, dtype=bool)
        self._found: list[tuple[np.ndarray, Callable[[int], str]]] = []

    def add(self, rows: np.ndarray, reason: Callable[[int], str]) -> None:
        """Add rows, as a mask, with a function from a row to the reason."""
        self.rows |= rows
        self._found.append((rows, reason))

    def reason(self, row: int) -> str:
        """Return why a row cannot be used."""
        return next(reason(row) for rows, reason in self._found if rows[row])


def raw_numbers(table: Table, column: str, key: str) -> np.ndarray:
    """Return a column as numbers, complex where they are; NaN where there is none.

    Raises `ValueError` where cells may be read with a decimal point or a decimal comma, and for
    dates.
    """
    cells = table.columns[column]
    sign = table.signs.get(column)
    if sign is not None:
        doubt = doubtful(joined(cells), sign)
        if doubt is not None:
            point, comma = (
                number_in(with_points(np.array([doubt], dtype=object), one)[0]) for one in DECIMALS
            )
            raise ValueError(
                f"Column {column!r} holds {doubt!r}, which is {point:.15g} with a decimal point "
                f"and {comma:.15g} with a decimal comma, and nothing says which. Give decimal='.' "
                "or decimal=','."
            )
        cells = with_points(cells, sign)
    try:
        return numbers_in(cells)
    except ValueError as error:
        raise ValueError(f"Column {column!r} for the {key} {error}.") from None


def numbers(
    table: Table, column: str, key: str, trouble: Unusable, gaps: bool = False
) -> np.ndarray:
    """Return a column as numbers, complex where they are; rows that hold none go to `trouble`.

    With `gaps` cells may be empty, and are NaN. Raises `ValueError` as `raw_numbers` does.
    """
    found = raw_numbers(table, column, key)
    cells = table.columns[column]

    def reason(row: int) -> str:
        cell = cells[row]
        if cell is None:
            return "too few cells"
        if number_in(cell) is None:
            return f"{key} is no number: {str(cell).strip()!r}"
        return f"{key} is {found[row]:g}"

    bad = ~np.isfinite(found)
    trouble.add(bad & ~is_empty(cells) if gaps and bad.any() else bad, reason)
    return found


def real_numbers(
    table: Table, column: str, key: str, trouble: Unusable, advice: str = "", gaps: bool = False
) -> np.ndarray:
    """Return a column as real numbers, as `numbers` does. With `gaps` cells may be empty.

    Raises `ValueError` for complex ones too, with the advice.
    """
    found = numbers(table, column, key, trouble, gaps)
    if not np.iscomplexobj(found):
        return found
    bad = np.flatnonzero(np.nan_to_num(np.imag(found)) != 0)
    if bad.size:
        raise ValueError(
            f"Column {column!r} is complex ({found[bad[0]]:g} on {table.counted} "
            f"{table.lines[bad[0]]}): the {key} must be real. {advice}".strip()
        )
    return np.real(found)


def usable(table: Table, trouble: Unusable, skip: bool) -> tuple[np.ndarray, str | None]:
    """Return the rows to use, and a sentence that names the others.

    Raises `ValueError` where rows are unusable and must not be skipped, or none is left.
    """
    bad = np.flatnonzero(trouble.rows)
    keep = ~trouble.rows
    if not bad.size and keep.size:
        return keep, None
    named = [
        f"{table.counted} {table.lines[row]} ({trouble.reason(row)})" for row in bad[:6].tolist()
    ]
    more = f" and {len(bad) - 6} more" if len(bad) > 6 else ""
    listed = ", ".join(named) + more
    if not keep.any():
        raise ValueError(f"There is no usable row{': ' + listed if listed else ''}.")
    count = f"{len(bad)} unusable row{'s' if len(bad) > 1 else ''}"
    if not skip:
        raise ValueError(f"{count}: {listed}. Correct them, or leave them out: skip_unusable=True.")
    return keep, f"{count} left out: {listed}."
