"""Which columns of a table make a measured frequency response, and what is in them."""

import re
from collections.abc import Mapping
from typing import Any

from vibrojax._tools.checks import check_choice
from vibrojax.measured.columns import (
    ANY_FORCE,
    CONTACT_FORCE,
    check_keys,
    column_unit,
    find_column,
    match_columns,
)
from vibrojax.measured.datasets import OWN
from vibrojax.measured.kinds import DRIVES, FRAMES, QUANTITIES, SIGNALS
from vibrojax.measured.table import Table
from vibrojax.measured.units import AXES, UNITS, split_header

_AMPLITUDE = (
    "(?:tip|beam|half|peaktopeak|pkpk|p2p|pp|peak|max|rms|firstharmonic|h1|amplitude|amp"
    "|displacement|disp|velocity|vel|acceleration|accel|acc|magnitude|mag)+"
)
_ELECTRIC = (
    "(?:load|output|mean|average|avg|rms|half|peaktopeak|pkpk|p2p|pp|peak|max|amplitude|amp"
    "|voltage|volts?|power)*(?:voltage|volts?|power)(?:mean|average|avg|rms|peak|max|amplitude|amp)*"
)
"""Of a harvester; read where no column has an amplitude of a motion."""
_RESPONSE = f"(?:{_AMPLITUDE}|h|frf|x|y|response|receptance|compliance|mobility|accelerance|of)*"
_DEVIATION = "(?:standarddeviation|stddeviation|stddev|deviation|sd|sigma|std|uncertainty|error)"
_DRIVE = (
    "(?:drive|driving|excitation|exciter|shaker|base|input)+"
    "(?:force|load|displacement|disp|velocity|vel|acceleration|accel|acc|motion|amplitude|amp|level"
    "|rms|half|peaktopeak|pkpk|p2p|pp|peak|max)*"
)
PATTERNS = {
    "frequency": AXES["frequency"],
    "amplitude": _AMPLITUDE,
    "deviation": f"(?:{_AMPLITUDE}|{_ELECTRIC})?{_DEVIATION}"
    f"|{_DEVIATION}(?:{_AMPLITUDE}|{_ELECTRIC})",
    "real": f"{_RESPONSE}(?:real|re)(?:part)?{_RESPONSE}",
    "imaginary": f"{_RESPONSE}(?:imaginary|imag|im)(?:part)?{_RESPONSE}",
    "phase": f"{_RESPONSE}(?:phase|phaseangle|arg){_RESPONSE}",
    "phase_deviation": f"(?:phase|phaseangle|arg){_DEVIATION}|{_DEVIATION}(?:phase|phaseangle|arg)",
    "drive": _DRIVE,
    "contact_force": CONTACT_FORCE,
    "contact_force_deviation": f"{ANY_FORCE}{_DEVIATION}|{_DEVIATION}{ANY_FORCE}",
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
    "mean|average|avg": "mean",
}
_OF_AMPLITUDE = {"rms": 2**0.5, "peak_to_peak": 0.5}
"""Amplitude of a harmonic by its other measures."""
_SIGNAL_WORDS = {
    "disp": "displacement",
    "vel": "velocity",
    "acc": "acceleration",
    "volt": "voltage",
    "power": "power",
}


class CurveColumns:
    """What was found out about the columns of a table: which they are, their units, the quantity.

    Raises `ValueError` for what is missing, ambiguous or unknown.
    """

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
        self.table, self.units = table, units
        self.notes: list[str] = []
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
        self.with_phase = columns.get("phase", "") is not None
        self.own = set(OWN) <= set(table.columns)
        if self.own and "amplitude" not in columns:
            power = "mean_power" in table.columns
            columns["amplitude"] = (
                f"{quantity or 'mean'}_power" if power else f"{quantity or 'amplitude'}_ratio"
            )
        words = [split_header(name).words for name in table.columns]
        moves = any(re.fullmatch(_AMPLITUDE, one) for one in words)
        patterns = PATTERNS if moves else PATTERNS | {"amplitude": _ELECTRIC}
        self.columns = match_columns(
            table, patterns, columns, self.split.values(), ("real", "imaginary", "phase")
        )
        self._find_response(columns)
        check_keys("units", units, (*PATTERNS, *split))
        self._check_found(columns)
        self._find_units(columns)
        self._find_quantity(quantity, signal, frame)

    def _find_response(self, given: Mapping[str, Any]) -> None:
        """Settle how the response is given: as an amplitude, or in two parts."""
        self.imaginary: str | None = None
        parts = {k: self.columns.pop(k) for k in ("real", "imaginary") if k in self.columns}
        if "amplitude" in self.columns:
            column = self.columns["amplitude"]
            words = split_header(column).words
            if any(re.fullmatch(PATTERNS[key], words) for key in ("real", "imaginary")):
                raise ValueError(
                    f"Column {column!r} is one part of a complex response by its name, not an "
                    "amplitude. Name both parts: columns=dict(real=..., imaginary=...)."
                )
            asked = [key for key in parts if given.get(key) is not None]
            if asked:
                raise ValueError(
                    f"There are an amplitude, {column!r}, and the part {parts[asked[0]]!r}: leave "
                    "one out, columns=dict(amplitude=None)."
                )
        elif len(parts) == 1:
            ((key, column),) = parts.items()
            raise ValueError(
                f"Column {column!r} is the {key} part of a response, and there is no other part. "
                "Name both: columns=dict(real=..., imaginary=...)."
            )
        elif parts:
            self.columns["amplitude"], self.imaginary = parts["real"], parts["imaginary"]
        if "amplitude" not in self.columns and given.get("phase") is None:
            self.columns.pop("phase", None)

    def _check_found(self, given: Mapping[str, Any]) -> None:
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
            ("phase", "amplitude"),
            ("phase_deviation", "amplitude"),
            ("contact_force_deviation", "contact_force"),
        ):
            if part in self.columns and whole not in self.columns:
                if part not in given and whole in given:  # left out with what it is of
                    del self.columns[part]
                    continue
                raise ValueError(f"There is a column for {part}, but none for {whole}. {there}")
        if "weight" in self.columns and "deviation" in self.columns:
            raise ValueError(
                "There are a weight and a deviation: leave one out, columns=dict(weight=None)."
            )

    def _find_units(self, given: Mapping[str, Any]) -> None:
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
        if self.imaginary is not None:
            other = column_unit(
                self.table, "amplitude", self.imaginary, self.units, kinds["amplitude"]
            )
            if other not in (None, self.unit["amplitude"]):
                raise ValueError(
                    f"Columns {self.columns['amplitude']!r} and {self.imaginary!r} must be in one "
                    f"unit, got {self.unit['amplitude']!r} and {other!r}."
                )
        self._find_optional_unit("phase", ("angle",), "deg", given)
        self._find_optional_unit("drive", tuple(DRIVES), "N", given)
        self._find_optional_unit("phase_deviation", ("angle",), "deg", given)
        for key, whole in (
            ("deviation", "amplitude"),
            ("contact_force_deviation", "contact_force"),
        ):
            if key in self.columns:
                same = self.unit[whole]
                allowed = (UNITS[same].kind, "relative")
                column = self.columns[key]
                self.unit[key] = column_unit(self.table, key, column, self.units, allowed) or same
        self._find_drive()

    def _find_optional_unit(
        self, key: str, kinds: tuple[str, ...], example: str, given: Mapping[str, Any]
    ) -> None:
        """Find the unit of a column; leave out one that nobody asked for and that has none."""
        if key not in self.columns:
            return
        column = self.columns[key]
        asked = given.get(key) is not None or key in self.units
        try:
            unit = column_unit(self.table, key, column, self.units, kinds)
        except ValueError:
            if asked:
                raise
            unit = None
        advice = f"units=dict({key}={example!r})"
        if unit is not None:
            self.unit[key] = unit
        elif asked:
            what = key.replace("_", " ")
            raise ValueError(f"Column {column!r} says no unit of the {what}. Give it: {advice}.")
        else:
            del self.columns[key]
            self.notes.append(f"Column {column!r} was left out, as it says no unit: {advice}.")

    def _find_drive(self) -> None:
        """Find out what the drive was measured as, and by what its numbers make an amplitude."""
        self.drive_signal, self.drive_factor = "", 1.0
        if "drive" not in self.columns:
            return
        column = self.columns["drive"]
        self.drive_signal = UNITS[self.unit["drive"]].kind
        words = split_header(column).words
        kind_of_drive = next(
            (q for w, q in _QUANTITY_WORDS.items() if re.search(w, words)), "amplitude"
        )
        self.drive_factor = _OF_AMPLITUDE.get(kind_of_drive, 1.0)
        kind = "force" if self.drive_signal == "force" else f"{self.drive_signal} of the base"
        self.notes.append(
            f"Column {column!r} was taken for the drive at each point: the {kind}, "
            f"{kind_of_drive.replace('_', ' ')}. columns=dict(drive=None) leaves it out."
        )

    def _find_quantity(self, quantity: str | None, signal: str | None, frame: str | None) -> None:
        self.quantity, self.frame = quantity or "", frame or "relative"
        self.signal, self.is_ratio = signal or "displacement", True
        if "amplitude" not in self.columns:
            return
        column = self.columns["amplitude"]
        words = split_header(column).words
        self.is_ratio = self.unit["amplitude"] == "ratio"
        by_unit = "displacement" if self.is_ratio else UNITS[self.unit["amplitude"]].kind
        by_name = next((s for w, s in _SIGNAL_WORDS.items() if w in words), by_unit)
        for stated, where in ((signal, "signal"), (by_name, f"column {column!r}")):
            if stated is not None and stated != by_unit:
                raise ValueError(
                    f"Unit {self.unit['amplitude']!r} is that of a {by_unit}, but {where} says "
                    f"{stated}. Correct units=dict(amplitude=...) or signal=...; a {stated} needs "
                    f"{SIGNALS[stated]}."
                )
        self.signal = by_unit
        fits = re.fullmatch(f"{_AMPLITUDE}|{_ELECTRIC}", words)
        named = [q for w, q in _QUANTITY_WORDS.items() if fits and re.search(w, words)]
        self.quantity = quantity or (named[0] if named else "")
        if frame is None and self.signal == "acceleration":
            self.notes.append(
                "The acceleration was taken to be relative to the base: give frame='absolute' for "
                "an accelerometer on the beam."
            )
