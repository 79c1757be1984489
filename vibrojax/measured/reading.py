"""Reading measured frequency responses from tables."""

import dataclasses
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vibrojax._checks import check_choice, nearest
from vibrojax.measured.curve import (
    FRAMES,
    QUANTITIES,
    SIGNALS,
    MeasuredCurve,
    MeasuredCurves,
    check_parameters,
)
from vibrojax.measured.directions import ALLOWED, direction_named, guess_directions
from vibrojax.measured.tables import (
    OWN,
    Table,
    column_unit,
    find_column,
    match_columns,
    numbers,
    read_table,
    unusable,
)
from vibrojax.measured.units import UNITS, split_header, unit_named

_AMPLITUDE = (
    "(?:tip|beam|half|peaktopeak|pkpk|p2p|pp|peak|max|rms|firstharmonic|h1|amplitude|amp"
    "|displacement|disp|velocity|vel|acceleration|accel|acc)+"
)
_FORCE = "(?:max|maximum|peak|largest)?(?:contact|impact)?force"
_DEVIATION = "(?:standarddeviation|stddeviation|stddev|deviation|sd|sigma|std|uncertainty|error)"
_PATTERNS = {
    "frequency": "(?:drive|driving|excitation)?(?:frequency|freq|f|hz|omega|rpm|ratio|r)",
    "amplitude": _AMPLITUDE,
    "deviation": f"(?:{_AMPLITUDE})?{_DEVIATION}|{_DEVIATION}{_AMPLITUDE}",
    "contact_force": _FORCE,
    "contact_force_deviation": f"{_FORCE}{_DEVIATION}|{_DEVIATION}{_FORCE}",
    "direction": "(?:sweep)?(?:direction|dir)|sweep",
    "weight": "weights?",
}
_IMPLIED = {"hz": "Hz", "omega": "rad/s", "rpm": "rpm", "ratio": "ratio", "r": "ratio"}
_QUANTITY_WORDS = {
    "half(?:peaktopeak|pkpk|p2p|pp)": "amplitude",
    "peaktopeak|pkpk|p2p|pp": "peak_to_peak",
    "rms": "rms",
    "firstharmonic|h1": "first_harmonic",
    "peak|max": "peak",
}
_SIGNAL_WORDS = {"disp": "displacement", "vel": "velocity", "acc": "acceleration"}


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
) -> MeasuredCurve | MeasuredCurves:
    """Read measured frequency responses.

        curve = read_measured_curve("sweep.csv", units=dict(frequency="Hz", amplitude="mm"))

    `source` is the path of a text file (commas, semicolons, tabs or spaces; a header; `#` begins a
    comment) or of a NetCDF file, an xarray dataset (also that of a `frequency_sweep`), a pandas
    data frame, or a dict of arrays; a list of them gives several curves. `columns` names the
    columns `frequency`, `amplitude`, `deviation`, `contact_force`, `contact_force_deviation`,
    `direction` and `weight` (of the amplitude's points, 1/variance up to a factor), or gives their
    positions from 0; usual names are recognised, and None leaves one out. `units` gives the units
    by the same names, where headers do not: Hz, kHz, rad/s, rpm, ratio; ratio, m, mm, um, m/s,
    mm/s, m/s2, g; N, mN, kN; deviations also `relative` or `%`. `quantity`, `signal` and `frame`
    are those of `MeasuredCurve`. `direction` (forward, backward) holds for all points; without it
    and without a column it is guessed from the order of the rows. `parameters` are arguments of the
    rig function that hold for every curve. `split` names columns by whose values the rows are
    divided into curves; the values become parameters. Rows that cannot be used are left out and
    named in `notes`, or refused with `skip_unusable=False`.

    Raises `ValueError` when a source cannot be read, a column or unit is missing, ambiguous or
    unknown, or no row can be used.
    """
    if isinstance(source, list | tuple):
        settings = {k: v for k, v in locals().items() if k != "source"}
        found = [read_measured_curve(one, **settings) for one in source]
        return MeasuredCurves(
            tuple(c for one in found for c in ([one] if isinstance(one, MeasuredCurve) else one))
        )
    label = os.fspath(source) if isinstance(source, str | os.PathLike) else type(source).__name__
    try:
        split_by = [split] if isinstance(split, str) else list(split or ())
        table = read_table(source, [*(columns or {}).values(), *split_by])
        reader = _Reader(table, columns, dict(units or {}), quantity, signal, frame, split_by)
        known = table.attached | check_parameters(parameters or {})
        found = reader.curves(direction, known, skip_unusable)
    except ValueError as error:
        raise ValueError(f"Measured curve from {label!r}: {error}") from None
    return MeasuredCurves(tuple(found)) if split_by else found[0]


class _Reader:
    """What was found out about the columns of a table, and the curves made of them."""

    def __init__(
        self,
        table: Table,
        columns: Mapping[str, str | int | None] | None,
        units: dict[str, str],
        quantity: str | None,
        signal: str | None,
        frame: str | None,
        split: list[str],
    ):
        self.table, self.units, self.notes = table, units, list(table.notes)
        for name, value, allowed in (
            ("quantity", quantity, tuple(QUANTITIES)),
            ("signal", signal, tuple(SIGNALS)),
            ("frame", frame, FRAMES),
        ):
            if value is not None:
                check_choice(name, value, allowed)
        self.split = {name: find_column(table, "split", name) for name in split}
        left = [name for name in table.inner if name not in self.split.values()]
        if left:
            raise ValueError(
                f"The dataset has an axis {left[0]} besides the frequency: give "
                f"split={left[0]!r} to make a curve of every value, or select one of them."
            )
        columns = dict(columns or {})
        if "amplitude_deviation" in columns:
            columns["deviation"] = columns.pop("amplitude_deviation")
        self.own = set(OWN) <= set(table.columns)
        if self.own and "amplitude" not in columns:
            columns["amplitude"] = f"{quantity or 'amplitude'}_ratio"
        self.columns = match_columns(table, _PATTERNS, columns, self.split.values())
        allowed = (*_PATTERNS, *split)
        for name in units:
            if name not in allowed:
                raise ValueError(f"units: unknown key {name!r}. {nearest(str(name), allowed)}")
        self._check_found()
        self._find_units()
        self._find_quantity(quantity, signal, frame)

    def _check_found(self) -> None:
        there = f"Columns there are: {', '.join(map(repr, self.table.columns))}."
        first = next(iter(self.table.columns), "name")
        if "frequency" not in self.columns:
            raise ValueError(
                f"No column for the frequency. {there} Name it: columns=dict(frequency={first!r})."
            )
        if "amplitude" not in self.columns and "contact_force" not in self.columns:
            raise ValueError(
                "No column for the amplitude or the contact force. "
                f"{there} Name it: columns=dict(amplitude={first!r})."
            )
        for part, whole in (
            ("deviation", "amplitude"),
            ("weight", "amplitude"),
            ("contact_force_deviation", "contact_force"),
        ):
            if part in self.columns and whole not in self.columns:
                raise ValueError(f"There is a column for {part}, but none for {whole}. {there}")
        if "weight" in self.columns and "deviation" in self.columns:
            raise ValueError(
                "There are a weight and a deviation: leave one out, columns=dict(weight=None)."
            )

    def _find_units(self) -> None:
        self.unit: dict[str, str] = {}
        kinds = {
            "frequency": ("frequency", "ratio"),
            "amplitude": ("ratio", *SIGNALS),
            "contact_force": ("force",),
        }
        for key, allowed in kinds.items():
            if key not in self.columns:
                continue
            column = self.columns[key]
            unit = column_unit(self.table, key, column, self.units, allowed)
            if unit is None and key == "frequency":
                unit = _IMPLIED.get(split_header(column).words)
            if unit is None and key == "contact_force":
                unit = "N"
                self.notes.append("The contact force was taken to be in N.")
            if unit is None:
                example = "Hz" if key == "frequency" else "mm"
                raise ValueError(
                    f"Column {column!r} says no unit of the {key}. "
                    f"Give it: units=dict({key}={example!r}), or 'ratio'."
                )
            self.unit[key] = unit
        for key, whole in (
            ("deviation", "amplitude"),
            ("contact_force_deviation", "contact_force"),
        ):
            if key in self.columns:
                same = self.unit[whole]
                allowed = (UNITS[same].kind, "relative")
                column = self.columns[key]
                self.unit[key] = column_unit(self.table, key, column, self.units, allowed) or same

    def _find_quantity(self, quantity: str | None, signal: str | None, frame: str | None) -> None:
        self.quantity, self.frame = quantity or "amplitude", frame or "relative"
        self.signal, self.is_ratio = signal or "displacement", True
        if "amplitude" not in self.columns:
            return
        column = self.columns["amplitude"]
        words = split_header(column).words
        self.is_ratio = self.unit["amplitude"] == "ratio"
        by_unit = "displacement" if self.is_ratio else UNITS[self.unit["amplitude"]].kind
        by_name = next((s for w, s in _SIGNAL_WORDS.items() if w in words), by_unit)
        for told, where in ((signal, "signal"), (by_name, f"column {column!r}")):
            if told is not None and told != by_unit:
                raise ValueError(
                    f"Unit {self.unit['amplitude']!r} is that of a {by_unit}, but {where} says "
                    f"{told}. Correct units=dict(amplitude=...) or signal=...; a {told} needs "
                    f"{SIGNALS[told]}."
                )
        self.signal = by_unit
        fits = re.fullmatch(_AMPLITUDE, words)
        named = [q for w, q in _QUANTITY_WORDS.items() if fits and re.search(w, words)]
        self.quantity = quantity or (named[0] if named else "amplitude")
        if not quantity and not named and "amp" not in words:
            self.notes.append(
                f"Column {column!r} was taken to be amplitudes, (max - min)/2: give quantity= if "
                "it is another quantity."
            )
        if frame is None and self.signal == "acceleration":
            self.notes.append(
                "The acceleration was taken to be relative to the base: give frame='absolute' for "
                "an accelerometer on the beam."
            )

    def curves(
        self, direction: str | int | None, known: dict[str, float], skip: bool
    ) -> list[MeasuredCurve]:
        """Return one curve for every combination of the values to split by."""
        reasons: dict[int, str] = {}
        values = self._values(reasons)
        directions = self._directions(direction, reasons)
        keys = self._split_keys(reasons)
        keep, left_out = unusable(self.table, reasons, skip)
        if left_out:
            self.notes.append(left_out)
        found = []
        for key in dict.fromkeys(k for k, kept in zip(keys, keep, strict=True) if kept):
            rows = np.array([kept and k == key for k, kept in zip(keys, keep, strict=True)])
            parameters = {n: v for n, v in zip(self.split, key, strict=True) if type(v) is float}
            named = [f"{n} = {v}" for n, v in zip(self.split, key, strict=True)]
            label = ", ".join(filter(None, [self.table.label, *named]))
            found.append(self._curve(values, rows, directions, known | parameters, label))
        return found

    def _values(self, reasons: dict[int, str]) -> dict[str, np.ndarray]:
        """Return the numbers of every column in SI units, and why rows are unusable."""
        values = {}
        for key, column in self.columns.items():
            if key == "direction":
                continue
            found = numbers(self.table.columns[column], key, reasons)
            if key in self.unit and UNITS[self.unit[key]].kind != "relative":
                found = found * UNITS[self.unit[key]].factor
            values[key] = found
            at_least = key in ("amplitude", "contact_force")
            with np.errstate(invalid="ignore"):
                bad = found < 0 if at_least else found <= 0
            if key == "amplitude" and np.sum(bad) > np.sum(np.isfinite(found)) / 2:
                raise ValueError(
                    f"Column {column!r} is negative in {np.sum(bad)} of {len(found)} rows: this "
                    "looks like a signal or decibels, not an amplitude."
                )
            for row in np.flatnonzero(bad):
                what = "negative" if at_least else "not above 0"
                reasons.setdefault(int(row), f"{key} is {what}: {found[row]:g}")
        if self.own and "status" in self.table.columns:
            for row in np.flatnonzero(np.asarray(self.table.columns["status"]).astype(float) != 0):
                reasons.setdefault(int(row), "not settled")
        for key, whole in (
            ("deviation", "amplitude"),
            ("contact_force_deviation", "contact_force"),
        ):
            if key in values and UNITS[self.unit[key]].kind == "relative":
                # A deviation of 0 at a value of 0 would claim to know it exactly.
                least = 0.01 * np.nanmax(values[whole], initial=0.0)
                part = UNITS[self.unit[key]].factor * values[key]
                values[key] = part * np.maximum(values[whole], least)
        return values

    def _directions(
        self, direction: str | int | None, reasons: dict[int, str]
    ) -> np.ndarray | None:
        """Return the direction of every row; None where it is to be guessed."""
        rows = len(self.table.lines)
        if direction is not None:
            one = direction_named(direction)
            if one is None:
                raise ValueError(f"direction must be {ALLOWED}, got {direction!r}.")
            return np.full(rows, one)
        if "direction" not in self.columns:
            return None
        found = np.zeros(rows, int)
        for row, value in enumerate(self.table.columns[self.columns["direction"]]):
            one = direction_named(value)
            if one is None:
                reasons.setdefault(row, f"direction is not {ALLOWED}: {value!r}")
            else:
                found[row] = one
        return found

    def _split_keys(self, reasons: dict[int, str]) -> list[tuple[float | str, ...]]:
        """Return the values to split by, row by row: SI where the column names another unit."""
        parts: list[list[float | str]] = []
        for name, column in self.split.items():
            raw = self.table.columns[column]
            trouble: dict[int, str] = {}
            found = numbers(raw, name, trouble)
            if len(trouble) == len(raw):  # names, not numbers: they go to the label only
                parts.append([str(value) for value in raw])
                continue
            for row, reason in trouble.items():
                reasons.setdefault(row, reason)
            text = self.units.get(name)
            if text is None and name != column:
                text = split_header(column).unit
            if text is not None:
                kinds = {unit.kind for unit in UNITS.values()}
                # Rounded, so that 0.4 mm is 0.0004 m.
                factor = UNITS[unit_named(name, text, kinds)].factor
                found = np.array([float(f"{v * factor:.12g}") for v in found])
            parts.append([float(v) for v in found])
        return list(zip(*parts, strict=True)) if parts else [()] * len(self.table.lines)

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
        ratio = self.unit["frequency"] == "ratio"
        curve = MeasuredCurve(
            part["frequency"],
            "frequency_ratio" if ratio else "frequency",
            part.get("amplitude"),
            part.get("deviation"),
            part.get("contact_force"),
            part.get("contact_force_deviation"),
            found,
            self.quantity,
            self.signal,
            self.is_ratio,
            self.frame,
            parameters,
            label,
            tuple(notes),
            self.table.lines[rows],
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
