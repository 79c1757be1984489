"""Reading a measured drive: the acceleration of the base or the force on the body, over time."""

import os
import re
from collections.abc import Mapping
from typing import Any

from vibrojax._tools.checks import check_choice
from vibrojax._tools.signatures import validated
from vibrojax.measured.columns import (
    ANY_FORCE,
    Unusable,
    check_keys,
    column_unit,
    match_columns,
    real_numbers,
    usable,
)
from vibrojax.measured.runs import runs_of
from vibrojax.measured.table import Table, listed
from vibrojax.measured.tables import read_table
from vibrojax.measured.units import AXES, UNITS, find_unit, split_header
from vibrojax.model.signals import Sampled

_PATTERNS = {
    "time": AXES["time"],
    "acceleration": "(?:base|drive|table|shaker|input)?(?:acceleration|accel|acc)",
}
_QUANTITIES = {"acceleration": "m/s2", "force": "N"}
_REAL = "A drive is a real signal over time."


@validated
def read_drive(
    source: Any,
    *,
    quantity: str = "acceleration",
    columns: Mapping[str, str | int | None] | None = None,
    units: Mapping[str, str] | None = None,
    skip_unusable: bool = False,
    decimal: str | None = None,
    at: str | int | None = None,
    run: str | None = None,
) -> Sampled:
    """Read a measured drive, as `simulate(waveform=...)` takes it.

        drive = vj.io.read_drive("record.csv", units=dict(acceleration="g"))

    `source`, `decimal` and `at` are as for `read_measured_curve`; time is in s where nothing says
    otherwise.

    Parameters:
        source: what is read, with a column of times and one of the drive.
        quantity: `acceleration` of the base, or the `force`.
        columns: names the columns `time` and that of the quantity, or gives their positions from 0.
        units: units by the same names, where headers have none: s, ms, us; m/s2, g; N, mN, kN.
        skip_unusable: whether rows that hold no numbers are left out, and bridged by a straight
            line; else they are refused.
        decimal: decimal sign of numbers in text, `.` or `,`; None: read off the cells.
        at: the place in a file of several tables.
        run: the run of a table of several, by name.

    Raises `ValueError` when the source cannot be read, a column, unit or run is missing, ambiguous
    or unknown, or what is read is no `Sampled`; `ImportError` where a library for it is missing.
    """
    check_choice("quantity", quantity, tuple(_QUANTITIES))
    named = isinstance(source, str | os.PathLike)
    label = os.fspath(source) if named else type(source).__name__
    try:
        columns, units = dict(columns or {}), dict(units or {})
        table = read_table(source, columns.values(), along="time", decimal=decimal, at=at)
        runs = runs_of(table, run)
        if len(runs) > 1:
            raise ValueError(
                f"There are several runs: {listed(runs)}. Say which: run={next(iter(runs))!r}."
            )
        table = next(iter(runs.values()))
        found = _columns(table, quantity, columns)
        check_keys("units", units, found)
        trouble, values = Unusable(len(table.lines)), {}
        for key, column in found.items():
            unit = column_unit(table, key, column, units, [key])
            if unit is None and key != "time":
                raise ValueError(
                    f"Column {column!r} says no unit of the {key}. "
                    f"Give it: units=dict({key}={_QUANTITIES[key]!r})."
                )
            numbers = real_numbers(table, column, key, trouble, _REAL)
            values[key] = numbers * UNITS[unit or "s"].factor
        keep, _ = usable(table, trouble, skip_unusable)
        return Sampled(values["time"][keep], values[quantity][keep])
    except ValueError as error:
        raise ValueError(f"Drive from {label!r}: {error}") from None


def _columns(table: Table, quantity: str, given: dict[str, Any]) -> dict[str, str]:
    """Return the columns of time and quantity, by key."""
    headers = {name: split_header(name) for name in table.columns}
    forces = [
        n
        for n, h in headers.items()
        if re.fullmatch(ANY_FORCE, h.words) or _in_newtons(table.units.get(n) or h.unit)
    ]
    patterns = dict(_PATTERNS)
    if quantity == "force":
        patterns = {"time": patterns["time"], "force": ANY_FORCE}
        if "force" not in given:
            if len(forces) > 1:
                listed = ", ".join(map(repr, forces))
                raise ValueError(
                    f"Columns {listed} may all be the force. Say which: "
                    f"columns=dict(force={forces[0]!r})."
                )
            if forces:
                given["force"] = forces[0]
    found = match_columns(table, patterns, given, taken=forces)
    for key in ("time", quantity):
        if key not in found:
            there = ", ".join(map(repr, table.columns))
            raise ValueError(
                f"No column for the {key}. Columns there are: {there}. "
                f"Name it: columns=dict({key}={next(iter(table.columns))!r})."
            )
    return found


def _in_newtons(text: str | None) -> bool:
    unit = None if text is None else find_unit(text)
    return unit is not None and UNITS[unit].kind == "force"
