"""Reading measured frequency responses from tables."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vibrojax._tools.signatures import validated
from vibrojax.measured.columns import Unusable, numbers, real_numbers, taken, usable
from vibrojax.measured.curve import MeasuredCurve, MeasuredCurves
from vibrojax.measured.curve_columns import CurveColumns
from vibrojax.measured.directions import (
    ALLOWED,
    NO_DIRECTION,
    direction_named,
    directions_in,
    guess_directions,
)
from vibrojax.measured.runs import runs_of
from vibrojax.measured.splitting import Splitting
from vibrojax.measured.table import Table
from vibrojax.measured.tables import read_table
from vibrojax.measured.units import UNITS, split_header

_REAL = {
    "contact_force": "Its largest value over a period is meant; columns=dict(contact_force=None) "
    "leaves it out.",
}
"""What to do where a column of these is complex."""
_FITTED = "which is fitted too: columns=dict(phase=None) leaves it out."


@validated
def read_measured_curve(
    source: Any,
    *,
    columns: Mapping[str, str | int | None] | None = None,
    units: Mapping[str, str] | None = None,
    quantity: str | None = None,
    signal: str | None = None,
    frame: str | None = None,
    direction: str | int | None = None,
    parameters: Mapping[str, float] | None = None,
    split: str | Sequence[str] | None = None,
    skip_unusable: bool = True,
    decimal: str | None = None,
    at: str | int | None = None,
    run: str | None = None,
) -> MeasuredCurve | MeasuredCurves:
    """Read measured frequency responses.

        curve = read_measured_curve("sweep.csv", units=dict(frequency="Hz", amplitude="mm"))

    `source` is the path of a text file (commas, semicolons, tabs or spaces; a header; `#` begins a
    comment), a workbook (Excel, LibreOffice), a MAT, HDF5, NetCDF, TDMS or universal file (UFF,
    data set 58), an xarray dataset (also that of a `frequency_sweep`), a pandas data frame, a
    series over frequency, or a dict of arrays; a list of them gives several curves.

    A complex amplitude is a response: its magnitude is taken, of the first harmonic, and its angle
    for the phase. It may also be two columns, `real` and `imaginary`. Where the drive is complex
    too, the phase is that of the response over the drive. Complex numbers anywhere else are
    refused.

    Parameters:
        source: what is read, as above.
        columns: names the columns `frequency`, `amplitude`, `deviation`, `contact_force`,
            `contact_force_deviation`, `direction`, `weight` (of the amplitude's points, 1/variance
            up to a factor), `real`, `imaginary`, `phase`, `phase_deviation` and `drive` (its
            amplitude at every point, also as rms or peak to peak where the name says so), or gives
            their positions from 0. Usual names are recognised, and None leaves one out. A plain
            force may be that of the drive: say whether it is `contact_force` or `drive`.
        units: units by the same names, where headers have none: Hz, kHz, rad/s, rpm, ratio; ratio,
            m, mm, um, m/s, mm/s, m/s2, g; N, mN, kN; rad, deg; deviations also `relative` or `%`.
            That of the drive says what it is: a force, or a motion of the base.
        quantity: as of `MeasuredCurve`; None: as the name of the column says.
        signal: as of `MeasuredCurve`; None: as the unit says.
        frame: as of `MeasuredCurve`; None: relative.
        direction: forward or backward, of all points; without it and without a column it is guessed
            from the order of the rows.
        parameters: arguments of the rig function that hold for every curve.
        split: columns by whose values the rows are divided into curves; the values become
            parameters.
        skip_unusable: True leaves rows out that cannot be used, and names them in `notes`; False
            refuses them.
        decimal: decimal sign of numbers in text, `.` or `,`; None: read off the cells. Where none
            of them decides (`5,400` may be 5.4 or 5400), it has to be given.
        at: where in a file of several tables: the name of a sheet, the path of a struct, group or
            matrix (`"bench.run1"`, `"bench/run1"`), the number of a record of a universal file.
        run: the run of a table that has several side by side (`Run 1: f (Hz)`); None: all of them.

    Raises `ValueError` when a source cannot be read, a column, unit, decimal sign, table or run is
    missing, ambiguous or unknown, or no row can be used; `ImportError` where the library for a
    format is not installed.
    """
    if isinstance(source, list | tuple):
        settings = {k: v for k, v in locals().items() if k != "source"}
        if not source:
            raise ValueError("Measured curve from []: give at least one source.")
        found = [read_measured_curve(one, **settings) for one in source]
        return MeasuredCurves(
            tuple(c for one in found for c in ([one] if isinstance(one, MeasuredCurve) else one))
        )
    label = os.fspath(source) if isinstance(source, str | os.PathLike) else type(source).__name__
    where = label
    try:
        split_by = [split] if isinstance(split, str) else list(split or ())
        table = read_table(source, [*(columns or {}).values(), *split_by], None, decimal, at)
        known = table.attached | dict(parameters or {})
        runs, found = runs_of(table, run), []
        units = dict(units or {})
        for name, part in runs.items():
            where = f"{label}, {name}" if name else label
            given = CurveColumns(part, columns, units, quantity, signal, frame, split_by)
            found += _Reader(part, given).curves(direction, known, skip_unusable)
    except ValueError as error:
        raise ValueError(f"Measured curve from {where!r}: {error}") from None
    return MeasuredCurves(tuple(found)) if split_by or len(runs) > 1 else found[0]


class _Reader:
    """The curves of a table of which the columns are known."""

    def __init__(self, table: Table, given: CurveColumns):
        self.table, self.own = table, given
        columns = given.columns | ({"imaginary": given.imaginary} if given.imaginary else {})
        said = taken(table, columns | given.split, given.unit)
        self.notes = [*table.notes, said, *given.notes]

    def curves(
        self, direction: str | int | None, known: dict[str, float], skip: bool
    ) -> list[MeasuredCurve]:
        """Return one curve for every combination of the values to split by."""
        trouble = Unusable(len(self.table.lines))
        values = self._values(trouble)
        directions = self._directions(direction, trouble)
        splitting = Splitting(self.table, self.own.split, self.own.units, trouble)
        keep, left_out = usable(self.table, trouble, skip)
        if left_out:
            self.notes.append(left_out)
        found = []
        for key, rows in splitting.parts(keep):
            parameters = {
                n: v for n, v in zip(self.own.split, key, strict=True) if type(v) is float
            }
            named = [f"{n} = {v}" for n, v in zip(self.own.split, key, strict=True)]
            label = ", ".join(filter(None, [self.table.label, *named]))
            found.append(self._curve(values, rows, directions, known | parameters, label))
        return found

    def _values(self, trouble: Unusable) -> dict[str, np.ndarray]:
        """Return the numbers of every column in SI units; `response` is the complex amplitude."""
        values = {}
        for key, column in self.own.columns.items():
            if key == "direction":
                continue
            if key == "phase":  # a row without it still has its amplitude
                apart = Unusable(len(self.table.lines))
                found = self._in_si(key, real_numbers(self.table, column, key, apart))
                values[key] = np.where(apart.rows, np.nan, found)
                self.notes.append(f"Column {column!r} was taken for the phase, {_FITTED}")
                continue
            if key == "amplitude":
                found = self._in_si(key, self._response(column, trouble))
                if np.iscomplexobj(found):
                    values["response"], found = found, np.abs(found)
            elif key == "drive":  # complex beside a complex response: a phase to refer to
                values["source"] = self._in_si(key, numbers(self.table, column, key, trouble))
                found = np.abs(values["source"])
            else:
                found = self._in_si(
                    key, real_numbers(self.table, column, key, trouble, _REAL.get(key, ""))
                )
            values[key] = found
            at_least = key in ("amplitude", "contact_force")
            with np.errstate(invalid="ignore"):
                bad = found < 0 if at_least else found <= 0
            if key == "amplitude" and np.sum(bad) > np.sum(np.isfinite(found)) / 2:
                raise ValueError(
                    f"Column {column!r} is negative in {np.sum(bad)} of {len(found)} rows: this "
                    "looks like a signal or decibels, not an amplitude."
                )
            what = "negative" if at_least else "not above 0"
            trouble.add(bad, lambda row, k=key, w=what, f=found: f"{k} is {w}: {f[row]:g}")
        if self.own.own and "status" in self.table.columns:
            unsettled = np.asarray(self.table.columns["status"]).astype(float) != 0
            trouble.add(unsettled, lambda row: "not settled")
        for key, whole in (
            ("deviation", "amplitude"),
            ("contact_force_deviation", "contact_force"),
        ):
            if key in values and UNITS[self.own.unit[key]].kind == "relative":
                # A deviation of 0 at a value of 0 would claim to know it exactly.
                least = 0.01 * np.nanmax(values[whole], initial=0.0)
                part = UNITS[self.own.unit[key]].factor * values[key]
                values[key] = part * np.maximum(values[whole], least)
        return values

    def _in_si(self, key: str, found: np.ndarray) -> np.ndarray:
        if key in self.own.unit and UNITS[self.own.unit[key]].kind != "relative":
            found = found * UNITS[self.own.unit[key]].factor
        return found * self.own.drive_factor if key == "drive" else found

    def _response(self, column: str, trouble: Unusable) -> np.ndarray:
        """Return the amplitude, complex where it is; say what was taken for it."""
        if self.own.imaginary is not None:
            real, imaginary = (
                real_numbers(self.table, name, "amplitude", trouble)
                for name in (column, self.own.imaginary)
            )
            return real + 1j * imaginary
        found = numbers(self.table, column, "amplitude", trouble)
        if not np.iscomplexobj(found):
            if not self.own.quantity and "amp" not in split_header(column).words:
                what = "means" if self.own.signal == "power" else "amplitudes, (max - min)/2"
                self.notes.append(
                    f"Column {column!r} was taken to be {what}: give quantity= if it is another "
                    "quantity."
                )
        elif "phase" in self.own.columns:
            raise ValueError(
                f"Column {column!r} is complex, and {self.own.columns['phase']!r} is a phase too: "
                "leave one out, columns=dict(phase=None)."
            )
        return found

    def _directions(self, direction: str | int | None, trouble: Unusable) -> np.ndarray | None:
        """Return the direction of every row; None where it is to be guessed."""
        if direction is not None:
            one = direction_named(direction)
            if one is None:
                raise ValueError(f"direction must be {ALLOWED}, got {direction!r}.")
            return np.full(len(self.table.lines), one)
        if "direction" not in self.own.columns:
            return None
        cells = self.table.columns[self.own.columns["direction"]]
        found = directions_in(cells)
        trouble.add(
            found == NO_DIRECTION, lambda row: f"direction is not {ALLOWED}: {cells[row]!r}"
        )
        return found

    def _curve(
        self,
        values: dict[str, np.ndarray],
        rows: np.ndarray,
        directions: np.ndarray | None,
        parameters: dict[str, float],
        label: str,
    ) -> MeasuredCurve:
        part = {key: found[rows] for key, found in values.items()}
        notes = list(self.notes)
        if directions is None:
            found, sentence = guess_directions(part["frequency"])
            notes.append(sentence)
        else:
            found = directions[rows]
        ratio = self.own.unit["frequency"] == "ratio"
        whole = "response" in part and self.own.with_phase
        quantity = self.own.quantity or ("first_harmonic" if "response" in part else "")
        if whole:
            notes.append(
                f"The response is complex: its magnitude was taken ({quantity}), and its angle for "
                f"the phase, {_FITTED}"
            )
        curve = MeasuredCurve(
            part["frequency"],
            "frequency_ratio" if ratio else "frequency",
            part["response"] if whole else part.get("amplitude"),
            part.get("deviation"),
            part.get("contact_force"),
            part.get("contact_force_deviation"),
            found,
            quantity,
            self.own.signal,
            self.own.is_ratio,
            self.own.frame,
            parameters,
            label,
            tuple(notes),
            self.table.lines[rows],
            part.get("phase"),
            part.get("phase_deviation") if whole or "phase" in part else None,
            part.get("source" if self.own.with_phase else "drive"),
            self.own.drive_signal,
        )
        return _weighted(curve, part["weight"]) if "weight" in part else curve


def _weighted(curve: MeasuredCurve, weight: np.ndarray) -> MeasuredCurve:
    """Give a curve deviations in proportion to 1/sqrt(weight), as large as its noise."""
    noise = curve.noise()
    assert noise.amplitude is not None
    shape = 1 / np.sqrt(weight)
    note = (
        "Deviations of the amplitude are in proportion to 1/sqrt(weight); their median is the "
        f"noise estimated. {noise.sentence}"
    )
    return dataclasses.replace(
        curve,
        amplitude_deviation=shape * np.median(noise.amplitude) / np.median(shape),
        notes=(*curve.notes, note),
    )
