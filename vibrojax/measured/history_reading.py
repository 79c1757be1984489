"""Reading measured time histories from tables."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from vibrojax._tools.signatures import validated
from vibrojax.measured.columns import (
    CONTACT_FORCE,
    Unusable,
    check_keys,
    column_unit,
    match_columns,
    real_numbers,
    taken,
    usable,
)
from vibrojax.measured.history import CHANNELS, MeasuredHistory
from vibrojax.measured.runs import runs_of
from vibrojax.measured.table import Table, listed
from vibrojax.measured.tables import read_table
from vibrojax.measured.units import AXES, UNITS
from vibrojax.model.signals import Sampled

_PATTERNS = {
    "time": AXES["time"],
    "displacement": "(?:tip|beam)?(?:displacement|disp|deflection|position)|tip|y",
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
    initial_displacement: float | None = None,
    initial_velocity: float | None = None,
    waveform: Sampled | None = None,
    gain: Mapping[str, float] | None = None,
    offset: Mapping[str, float] | None = None,
    delay: Mapping[str, float] | None = None,
    position: float | None = None,
    frame: str | None = None,
    window: tuple[float, float] | None = None,
    align_phase: bool = True,
    settled: bool = True,
    parameters: Mapping[str, float] | None = None,
    skip_unusable: bool = True,
    decimal: str | None = None,
    at: str | int | None = None,
    run: str | None = None,
) -> MeasuredHistory | list[MeasuredHistory]:
    """Read a measured time history, or several that stand side by side.

        history = read_measured_history("tip.csv", units=dict(displacement="mm"), frequency=12.5)

    `source`, `columns`, `units`, `skip_unusable`, `decimal` and `at` are as for
    `read_measured_curve`, for the columns `time`, `displacement`, `velocity`, `acceleration` and
    `contact_force`; time is in s where nothing says otherwise. Where a channel was sampled less
    often than others its cells may be empty.

    Parameters:
        deviation: standard deviations by channel, in SI units; the others are estimated.
        frequency: drive frequency, Hz.
        frequency_ratio: instead, drive frequency over the first natural one.
        release: displacement of the tip (m) from which the beam is let go at rest.
        initial_displacement: of what the system reports when the motion begins, m.
        initial_velocity: the same of its velocity, m/s.
        waveform: the drive as measured, on the same clock, such as `vj.io.read_drive` returns.
        gain: of the sensors, by channel: measured = gain times what is there + offset.
        offset: of the sensors, by channel, in SI units.
        delay: by how much the clocks of channels are late, s.
        position: place x/L of the sensor; None: the tip.
        frame: `relative` to the moving base, or `absolute`; None: relative.
        window: start and end (s) of the samples that count; None: all.
        align_phase: whether an unknown constant may shift the time axis.
        settled: whether the motion is steady.
        parameters: arguments of the rig function that hold for this history.
        run: the run of a table that has several side by side (`Run 1: Time (s)`), by name; None:
            a list of all of them.

    Raises `ValueError` when the source cannot be read, a column, unit, table or run is missing,
    ambiguous or unknown, or what is read is not a measured history; `ImportError` where the library
    for a format is not installed.
    """
    named = isinstance(source, str | os.PathLike)
    label = os.fspath(source) if named else type(source).__name__
    where, found = label, []
    try:
        table = read_table(source, (columns or {}).values(), "time", decimal, at)
        runs = runs_of(table, run)
        for name, part in runs.items():
            where = f"{label}, {name}" if name else label
            values, notes = _channels(part, columns, dict(units or {}), skip_unusable)
            force = values.get("contact_force", np.zeros(1))
            if "contact_force" not in (gain or {}) and np.nanmin(force) < -np.nanmax(force):
                notes.append(
                    f"The contact force goes down to {np.nanmin(force):g} N: it is positive in "
                    "contact here, so that a sensor that turns it has gain=dict(contact_force=-1)."
                )
            if frame is None and "acceleration" in values:
                notes.append(
                    "The acceleration was taken to be relative to the base: give frame='absolute' "
                    "for an accelerometer on the beam."
                )
            found.append(
                MeasuredHistory(
                    **values,
                    deviation=dict(deviation or {}),
                    frequency=frequency,
                    frequency_ratio=frequency_ratio,
                    release=release,
                    initial_displacement=initial_displacement,
                    initial_velocity=initial_velocity,
                    waveform=waveform,
                    gain=dict(gain or {}),
                    offset=dict(offset or {}),
                    delay=dict(delay or {}),
                    position=position,
                    frame=frame or "relative",
                    window=window,
                    align_phase=align_phase,
                    settled=settled,
                    parameters=dict(parameters or {}),
                    label=part.label,
                    notes=tuple(notes),
                )
            )
    except ValueError as error:
        raise ValueError(f"Measured history from {where!r}: {error}") from None
    return found if len(found) > 1 else found[0]


def _channels(
    table: Table, columns: Mapping[str, str | int | None] | None, units: dict[str, str], skip: bool
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return time and channels in SI units, NaN where one was not sampled, and what to note."""
    found = match_columns(table, _PATTERNS, columns)
    there = f"Columns there are: {listed(table.columns)}."
    if "time" not in found or len(found) < 2:
        lacking = "time" if "time" not in found else "displacement"
        raise ValueError(
            f"No column for the {lacking}{' or another signal' * (lacking != 'time')}. "
            f"{there} Name it: columns=dict({lacking}={next(iter(table.columns))!r})."
        )
    check_keys("units", units, _PATTERNS)
    trouble, values, named = Unusable(len(table.lines)), {}, {}
    notes = list(table.notes)
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
        named[key] = unit
        cells = real_numbers(table, column, key, trouble, _REAL, gaps=key != "time")
        values[key] = cells * UNITS[unit].factor
    notes.append(taken(table, found, named))
    empty = np.all([np.isnan(v) for key, v in values.items() if key != "time"], axis=0)
    trouble.add(empty, lambda row: "no sample")
    keep, left_out = usable(table, trouble, skip)
    if left_out:
        notes.append(left_out)
    values = {key: column[keep] for key, column in values.items()}
    bare = [key for key, column in values.items() if np.isnan(column).all()]
    if bare:
        raise ValueError(
            f"Column {found[bare[0]]!r} holds no {bare[0]}. Leave it out: "
            f"columns=dict({bare[0]}=None)."
        )
    gaps = {key: int(np.isnan(column).sum()) for key, column in values.items()}
    rows = int(keep.sum())
    notes += [f"{key} was sampled in {rows - n} of {rows} rows." for key, n in gaps.items() if n]
    return values, notes
