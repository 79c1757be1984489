"""Universal files (UFF, UNV), by pyuff: functions of data set 58 and 58b, with their units."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from vibrojax.measured.clocks import side_by_side
from vibrojax.measured.table import NoTable, Table, listed, table_of
from vibrojax.measured.units import UNITS, find_unit

_KINDS = {
    0: "general function",
    1: "time response",
    2: "auto spectrum",
    3: "cross spectrum",
    4: "frequency response",
    5: "transmissibility",
    6: "coherence",
    9: "power spectral density",
    10: "energy spectral density",
    12: "spectrum",
}
_FITTING = {"time": (0, 1), "frequency": (0, 4, 5, 12)}
_GENERAL = (0, 1)
"""Specific data types that say nothing."""
_QUANTITIES = {
    8: "displacement",
    9: "force",  # of a reaction: whether it is the contact force is asked
    11: "velocity",
    12: "acceleration",
    13: "excitation force",
    17: "time",
    18: "frequency",
}
_SI = {
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s2",
    "force": "N",
    "excitation force": "N",
}
_OWN_UNIT = {"time": "s", "frequency": "Hz"}
_ORDER = {"displacement": 0, "velocity": 1, "acceleration": 2}
_AXES = ("", "+X", "+Y", "+Z", "+RX", "+RY", "+RZ", "-X", "-Y", "-Z", "-RX", "-RY", "-RZ")


def read_uff(file: Any, at: str | int | None, axis: str) -> Table:
    """Return the table of one frequency response, or of the time responses, of a `pyuff.UFF`.

    `at` is the number of the record, counted from 1 among data sets 58, None: the one that fits;
    over time all of them. `axis` is `time` or `frequency`. Raises `NoTable` where no record fits
    or several do.
    """
    # A data set without an end is passed over by pyuff.
    ends = re.findall(rb"    -1(?= {74}|[\r\n]|$)", Path(file.get_file_name()).read_bytes())
    if len(ends) % 2:
        raise NoTable("is cut short: its last data set has no end, a line of -1")
    types = [int(kind) for kind in file.get_set_types()]
    numbers = [k for k, kind in enumerate(types) if kind == 58]
    records = [_Record(number, file, k) for number, k in enumerate(numbers, 1)]
    if not records:
        kinds = ", ".join(map(str, types)) or "none at all"
        raise NoTable(f"holds no function (data set 58), but data sets {kinds}")
    said = "; ".join(f"{r.number}: {r}" for r in records[:12]) + "; ..." * (len(records) > 12)
    fitting = [r for r in records if r.fits(axis)]
    if at is not None:
        fitting = [r for r in records if str(r.number) == str(at)]
        if not fitting:
            raise NoTable(f"has no record at={at!r}. Its records are {said}")
        if not fitting[0].fits(axis):
            raise NoTable(f"has in record {at} a {fitting[0]}, which is no function of {axis}")
    if not fitting:
        raise NoTable(f"holds no function of {axis} that can be read. Its records are {said}")
    if axis == "frequency" and len(fitting) > 1:
        raise NoTable(
            f"holds {len(fitting)} functions of frequency. Its records are {said}. Say which: "
            f"at={fitting[0].number}"
        )
    for record in fitting:
        record.load()
    factors = file.read_sets(types.index(164)) if 164 in types else None
    if axis == "time":
        return _over_time(fitting, factors)
    return _over_frequency(fitting[0], factors)


class _Record:
    """A function of a universal file, of which the values are read later."""

    def __init__(self, number: int, file: Any, place: int):
        self.number, self._file, self._place = number, file, place
        self.fields = self._read(header_only=True)
        self.kind = int(self.fields["func_type"])
        along = self.fields["abscissa_spec_data_type"]
        usual = {1: "time"}.get(self.kind, "frequency" if self.kind else None)
        self.along = _QUANTITIES.get(along) if along not in _GENERAL else usual
        self.quantity = _QUANTITIES.get(self.fields["ordinate_spec_data_type"])
        self.over = _QUANTITIES.get(self.fields["orddenom_spec_data_type"])

    def _read(self, header_only: bool) -> dict[str, Any]:
        try:
            return self._file.read_sets(self._place, header_only=header_only)
        except Exception:  # of which pyuff says no reason
            part = "header" if header_only else "values"
            raise NoTable(f"has in record {self.number} {part} that cannot be read") from None

    def load(self) -> None:
        """Read the values. Raises `NoTable` where some are missing."""
        self.fields = self._read(header_only=False)
        said, there = self.fields["num_pts"], len(self.fields["data"])
        if there != said or len(self.fields["x"]) != said:
            raise NoTable(f"says {said} values of record {self.number}, and has {there}")
        if there < 1:
            raise NoTable(f"has no values in record {self.number}")

    def __str__(self) -> str:
        name = _KINDS.get(self.kind, f"function of type {self.kind}")
        below = f" over {self.over}" if self.over and self.kind in (4, 5) else ""
        return f"{name} ({self.quantity or 'unknown quantity'}{below}) at {self.place}"

    @property
    def place(self) -> str:
        """Node and direction of the response."""
        towards = int(self.fields["rsp_dir"])
        known = -7 < towards < 7
        name = _AXES[towards if towards >= 0 else 6 - towards] if known else str(towards)
        return f"{self.fields['rsp_node']}{name}"

    def fits(self, axis: str) -> bool:
        """Whether this is a function of `time` or `frequency` that can be read."""
        return self.kind in _FITTING[axis] and self.along == axis

    def unit(
        self, part: str, quantity: str | None, factors: dict[str, Any] | None = None
    ) -> tuple[str | None, float]:
        """Return the unit of a part, and by what its numbers are in it.

        It is as the label says, else in SI by the `factors` of data set 164.
        """
        text = str(self.fields.get(f"{part}_axis_units_lab", "")).strip()
        if text and text.upper() != "NONE":
            return text, 1.0
        if factors is None or quantity not in _SI:
            return (_OWN_UNIT.get(quantity or "") if factors is None else None), 1.0
        return _SI[quantity], 1 / factors["force" if "force" in quantity else "length"]


def _over_time(records: list[_Record], factors: dict[str, Any] | None) -> Table:
    names = [record.quantity or f"record {record.number}" for record in records]
    names = [
        f"{name} {record.place}" if names.count(name) > 1 else name
        for name, record in zip(names, records, strict=True)
    ]
    double = [name for name in names if names.count(name) > 1]
    if double:
        raise NoTable(f"has several records of {double[0]}: say which by at=, counted from 1")
    columns, units = {}, {}
    for name, record in zip(names, records, strict=True):
        units[name], factor = record.unit("ordinate", record.quantity, factors)
        columns[name] = (record.fields["x"], record.fields["data"] * factor)
    axes = dict.fromkeys(str(record.unit("abscissa", "time")[0]) for record in records)
    if len(axes) > 1:
        raise NoTable(f"has times in {listed(axes)}: say which record by at=, counted from 1")
    time, found, said = side_by_side(columns)
    units["time"] = next(iter(axes))
    numbers = ", ".join(str(record.number) for record in records)
    notes = (f"Read from records {numbers} (data set 58).", *([said] if said else []))
    return table_of({"time": time, **found}, units, notes)


def _over_frequency(record: _Record, factors: dict[str, Any] | None) -> Table:
    """Return frequency and amplitude of a record: a response is one of displacement."""
    frequency, values = record.fields["x"], record.fields["data"]
    unit, factor = record.unit("ordinate", record.quantity, factors)
    values = values * factor
    notes = [f"Read from record {record.number}, a {record}."]
    axis_unit, _ = record.unit("abscissa", "frequency")
    if record.kind in (4, 5):
        below, factor = record.unit("orddenom", record.over, factors)
        values = values / factor
        if unit and not below:  # some programs write both in one label, as m/s^2/N
            unit, _, below = (part.strip(" ()") for part in unit.rpartition("/"))
        if unit or below or record.quantity not in (None, "displacement"):
            values, unit = _per_input(record, frequency, axis_unit, values, unit, below)
            notes.append(f"It is in {unit} as a response of displacement.")
            if unit == "ratio":
                notes.append("A ratio of motions is of absolute ones: then frame='absolute'.")
    else:
        notes.append("Its values were taken for amplitudes of the first harmonic, not for rms.")
    name = "first harmonic amplitude"
    return table_of(
        {"frequency": frequency, name: values},
        {"frequency": axis_unit, name: unit},
        tuple(notes),
    )


def _per_input(
    record: _Record,
    frequency: np.ndarray,
    axis_unit: str | None,
    values: np.ndarray,
    unit: str | None,
    below: str | None,
) -> tuple[np.ndarray, str]:
    """Return a frequency response as displacement over force (m/N), or over displacement."""
    above, under = (find_unit(u) if u else None for u in (unit, below))
    kinds = [UNITS[u].kind if u else None for u in (above, under)]
    hertz = find_unit(axis_unit or "")
    if above is None or under is None or kinds[0] not in _ORDER:
        raise NoTable(
            f"has a {record} in record {record.number} in {unit!r} over {below!r}: units of a "
            "motion over a force or a motion are needed, such as 'm/s2' over 'N'"
        )
    if kinds[1] != "force" and kinds[1] not in _ORDER:
        raise NoTable(
            f"has in record {record.number} a response over {below!r}: a force or a motion is "
            "needed"
        )
    if hertz is None or UNITS[hertz].kind != "frequency":
        raise NoTable(f"has in record {record.number} frequencies in {axis_unit!r}")
    values = values * (UNITS[above].factor / UNITS[under].factor)
    turns = _ORDER[kinds[0]] - _ORDER.get(kinds[1] or "", 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = (2j * np.pi * UNITS[hertz].factor * frequency) ** float(-turns) * values
    if np.isrealobj(values):  # a magnitude has no phase to turn
        turned = np.abs(turned)
    return turned, "m/N" if kinds[1] == "force" else "ratio"


def looks_universal(start: bytes) -> bool:
    """Whether a file begins as universal files do: with -1 and the number of a data set."""
    return re.match(rb"\s*-1\s*[\r\n]+\s{0,5}\d{1,6}[b\s]", start) is not None
