"""Reading measured time histories from tables."""

import os
from collections.abc import Mapping
from typing import Any

from vibrojax._tools.checks import nearest
from vibrojax._tools.signatures import validated
from vibrojax.measured.columns import (
    CONTACT_FORCE,
    Unusable,
    column_unit,
    match_columns,
    real_numbers,
    usable,
)
from vibrojax.measured.curve import check_parameters
from vibrojax.measured.history import CHANNELS, MeasuredHistory
from vibrojax.measured.tables import read_table
from vibrojax.measured.units import UNITS
from vibrojax.model.signals import Sampled

_PATTERNS = {
    "time": "time|t",
    "displacement": "(?:tip|beam)?(?:displacement|disp)|tip|y",
    "velocity": "(?:tip|beam)?(?:velocity|vel)",
    "acceleration": "(?:tip|beam)?(?:acceleration|accel|acc)",
    "contact_force": CONTACT_FORCE,
}

_REAL = "Complex responses over frequency are read by read_measured_curve."


@validated
def read_measured_history(
    source: Any,
    *,
    columns: Mapping[str, str | int | None] | None = None,
    units: Mapping[str, str] | None = None,
    deviation: Mapping[str, float] | None = None,
    frequency: float | None = None,
    frequency_ratio: float | None = None,
    release: float | None = None,
    waveform: Sampled | None = None,
    position: float | None = None,
    frame: str | None = None,
    window: tuple[float, float] | None = None,
    align_phase: bool = True,
    settled: bool = True,
    parameters: Mapping[str, float] | None = None,
    skip_unusable: bool = True,
    decimal: str | None = None,
) -> MeasuredHistory:
    """Read a measured time history.

        history = read_measured_history("tip.csv", units=dict(displacement="mm"), frequency=12.5)

    `source`, `columns`, `units`, `skip_unusable` and `decimal` are as for `read_measured_curve`,
    for the columns `time`, `displacement`, `velocity`, `acceleration` and `contact_force`; time is
    in s where nothing says otherwise.

    Parameters:
        deviation: standard deviations by channel, in SI units; the others are estimated.
        frequency: drive frequency, Hz.
        frequency_ratio: instead, drive frequency over the first natural one.
        release: displacement of the tip (m) from which the beam is let go at rest.
        waveform: the drive as measured, on the same clock, such as `vj.io.read_drive` returns.
        position: place x/L of the sensor; None: the tip.
        frame: `relative` to the moving base, or `absolute`; None: relative.
        window: start and end (s) of the samples that count; None: all.
        align_phase: whether an unknown constant may shift the time axis.
        settled: whether the motion is steady.
        parameters: arguments of the rig function that hold for this history.

    Raises `ValueError` when the source cannot be read, a column or unit is missing, ambiguous or
    unknown, or what is read is not a measured history.
    """
    named = isinstance(source, str | os.PathLike)
    label = os.fspath(source) if named else type(source).__name__
    try:
        table = read_table(source, (columns or {}).values(), along="time", decimal=decimal)
        found = match_columns(table, _PATTERNS, columns)
        notes = list(table.notes)
        there = f"Columns there are: {', '.join(map(repr, table.columns))}."
        if "time" not in found or len(found) < 2:
            lacking = "time" if "time" not in found else "displacement"
            raise ValueError(
                f"No column for the {lacking}{' or another signal' * (lacking != 'time')}. "
                f"{there} Name it: columns=dict({lacking}={next(iter(table.columns))!r})."
            )
        units = dict(units or {})
        for name in units:
            if name not in _PATTERNS:
                raise ValueError(f"units: unknown key {name!r}. {nearest(str(name), _PATTERNS)}")
        trouble = Unusable(len(table.lines))
        values = {}
        for key, column in found.items():
            kind = {"contact_force": "force"}.get(key, key)
            unit = column_unit(table, key, column, units, [kind])
            if unit is None and key == "time":
                unit = "s"
                notes.append("Time was taken to be in s.")
            if unit is None:
                raise ValueError(
                    f"Column {column!r} says no unit of the {key}. "
                    f"Give it: units=dict({key}={CHANNELS[key]!r})."
                )
            found_numbers = real_numbers(table, column, key, trouble, _REAL)
            values[key] = found_numbers * UNITS[unit].factor
        keep, left_out = usable(table, trouble, skip_unusable)
        if left_out:
            notes.append(left_out)
        if frame is None and "acceleration" in values:
            notes.append(
                "The acceleration was taken to be relative to the base: give frame='absolute' for "
                "an accelerometer on the beam."
            )
        return MeasuredHistory(
            **{key: column[keep] for key, column in values.items()},
            deviation=dict(deviation or {}),
            frequency=frequency,
            frequency_ratio=frequency_ratio,
            release=release,
            waveform=waveform,
            position=position,
            frame=frame or "relative",
            window=window,
            align_phase=align_phase,
            settled=settled,
            parameters=check_parameters(parameters or {}),
            label=table.label,
            notes=tuple(notes),
        )
    except ValueError as error:
        raise ValueError(f"Measured history from {label!r}: {error}") from None
