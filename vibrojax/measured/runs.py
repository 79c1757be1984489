"""Runs that stand side by side in one table, as `Run 1: Time (s)`, `Run 2: Time (s)` name them."""

import re

import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax.measured.cells import is_empty
from vibrojax.measured.table import Table
from vibrojax.measured.units import AXES, split_header

_WORD = r"(?:run|test|trial|sweep|measurement|series|data ?set|latest)\b"
_BEFORE = re.compile(r"(?P<run>[^:]*[^:\s])\s*:\s*(?P<name>[^:]*[^:\s])\s*")
_BEHIND = re.compile(rf"(?P<name>.*\S)\s+[(\[]?(?P<run>{_WORD}\s*#?\s*\w+)[)\]]?\s*", re.I)


def runs_of(table: Table, run: str | None) -> dict[str, Table]:
    """Return the tables of all runs by name, or of the one asked for; one table under "" if none.

    Columns that are of no run are of all of them. Rows without a cell of a run are left out of it.
    Raises `ValueError` where the run asked for is not there.
    """
    found = _named(table, _BEFORE) or _named(table, _BEHIND)
    asked = [name for name in found if run is None or name.lower() == run.strip().lower()]
    if run is not None and not asked:
        there = nearest(run, found) if found else "Its columns name no runs."
        raise ValueError(f"There is no run={run!r}. {there}")
    if not found:
        return {"": table}
    common = [name for name in table.columns if not any(name in own for own in found.values())]
    return {name: _part(table, name, found[name], common) for name in asked}


def _named(table: Table, pattern: re.Pattern[str]) -> dict[str, dict[str, str]]:
    """Return, by run, the columns with their names in it; nothing where those are no runs."""
    found: dict[str, dict[str, str]] = {}
    for column in table.columns:
        match = pattern.fullmatch(column)
        if match:
            found.setdefault(match["run"], {})[column] = match["name"]
    if not all(re.match(_WORD, r, re.I) or _has_axis([*own.values()]) for r, own in found.items()):
        return {}
    return found


def _has_axis(names: list[str]) -> bool:
    words = [split_header(name).words for name in names]
    return any(re.fullmatch(pattern, word) for pattern in AXES.values() for word in words)


def _part(table: Table, run: str, own: dict[str, str], common: list[str]) -> Table:
    filled = np.zeros(len(table.lines), dtype=bool)
    for column in own:
        filled |= ~is_empty(table.columns[column])
    names = {name: name for name in common} | own
    double = {n for n in names.values() if list(names.values()).count(n) > 1}
    if double:
        raise ValueError(f"There are several columns {', '.join(sorted(double))} in {run}.")
    return table._replace(
        columns={name: table.columns[column][filled] for column, name in names.items()},
        units={names[c]: unit for c, unit in table.units.items() if c in names},
        signs={names[c]: sign for c, sign in table.signs.items() if c in names},
        lines=table.lines[filled],
        label=", ".join(filter(None, [table.label, run])),
    )
