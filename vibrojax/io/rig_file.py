"""Rig files: a beam, its stops, its drive, how to sweep it and a map over its numbers, in TOML."""

import datetime
import os
import reprlib
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from vibrojax._tools.checks import (
    check_choice,
    check_count,
    check_frequencies,
    check_positive,
    nearest,
)
from vibrojax._tools.files import read_bytes
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import DIRECTIONS
from vibrojax.io.rig_file_keys import (
    AXES,
    GROUPS,
    KEYS,
    KINDS_OF_DRIVE,
    KINDS_OF_RESPONSE,
    LAWS,
    MAP_KEYS,
    MASSES,
    NUMBER,
    NUMBER_OR_FALSE,
    RANGE,
    RANGE_OR_NUMBER,
    SPACED_KEYS,
    SPACINGS,
    SWITCH,
    TEXT,
    TEXTS,
    WHOLE,
)
from vibrojax.model.beam import Cantilever, PointMass
from vibrojax.model.drives import AbstractDrive, BaseMotion, NoDrive, PointForce
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.model.stops import Stop
from vibrojax.sweep.settings import SweepSettings

_MOST_BYTES = 10_000_000
MOST_POINTS = 1_000_000
"""Of a frequency axis, or one axis of a map."""


@validated
def read_rig(path: str | os.PathLike[str]) -> tuple[ImpactingBeam, dict[str, Any]]:
    """Read a rig file and return the rig and the keywords of `frequency_sweep` it asks for.

        system, settings = vj.io.read_rig("examples/uniform_beam.toml")
        curve = vj.frequency_sweep(system, **settings)

    Tables, all in SI units (`examples/uniform_beam.toml` explains every key):
        [beam]    length, width, thickness, youngs_modulus, density; taper, mass_ratio (0)
        [[beam.point_masses]]  mass; position (1); once for each mass
        [[stop]]  position, gap, stiffness; side (1), smoothing; law ("kelvin_voigt") with its
                  numbers: damping (0), tension (true); "hertz": exponent (1.5); "hunt_crossley":
                  dissipation (0), exponent (1.5); "standard_linear_solid": maxwell_stiffness,
                  relaxation_time; once for each stop, or not at all
        [drive]   kind ("base_motion" or "point_force"), amplitude; position of a force (1);
                  may be left out where only the modes are wanted
        [model]   damping_ratio; num_modes (5), formulation ("consistent")
        [sweep]   frequency_ratio or frequency (Hz) = [start, end, points]; direction, tolerance,
                  steps_per_period, max_period, max_periods, settle ("follow" or "march"),
                  refine_jumps (false: do not)
        [map]     a map over numbers of the rig, for `vibrojax map` (`examples/map.toml`)

    Raises `ValueError`, naming the file and the key, when the file cannot be read or is not TOML,
    a table or key is unknown or missing, or a value is of the wrong kind or not possible.

    `path` is that of the TOML file.
    """
    with _named(path):
        tables = _load(path)
        system = _system(tables)
        _map_settings(tables)
        return system, _sweep_settings(tables)


def read_map(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what the table [map] of a rig file asks for, by key; nothing where there is none.

    Axes are lists of numbers by name, those of [map.axes] under `axes`, each [[map.zipped]] in the
    list `zipped`. Raises `ValueError` as `read_rig` does.
    """
    with _named(path):
        return _map_settings(_load(path))


@contextmanager
def _named(path: Any) -> Iterator[None]:
    """Begin the sentence of a `ValueError` with the file."""
    try:
        yield
    except ValueError as error:
        if str(error).startswith("Rig file"):
            raise
        raise ValueError(f"Rig file {os.fspath(path)!r}: {error}") from None


def _load(path: Any) -> dict[str, Any]:
    raw = read_bytes("Rig file", path, _MOST_BYTES)
    name = f"Rig file {os.fspath(path)!r}"
    try:
        return tomllib.loads(raw.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise ValueError(f"{name} is not TOML: it is not text in UTF-8.") from None
    except RecursionError:
        raise ValueError(f"{name} is nested too deeply.") from None
    except ValueError as error:  # TOMLDecodeError, or a number of thousands of digits
        raise ValueError(f"{name} is not TOML: {error}.") from None


def _shown(table: str) -> str:
    return "[[stop]]" if table == "stop" else f"[{table}]"


def _check_keys(table: str, values: Any, label: str) -> dict[str, Any]:
    """Return the keys of one table, each of its kind; numbers become floats."""
    keys = MAP_KEYS if table == "map" else KEYS[table]
    if table == "stop" and isinstance(values, dict):
        law = values.get("law", "kelvin_voigt")
        _within(label, check_choice, "law", law, tuple(LAWS))
        keys = keys | LAWS[law][1]
    if not isinstance(values, dict):
        raise ValueError(f"{table} must be a table that begins with {_shown(table)}.")
    _check_names(label, values, keys, [name for name, key in keys.items() if key.required])
    found = {name: _of_kind(keys[name].kind, f"{label} {name}", v) for name, v in values.items()}
    for name, value in found.items():
        if keys[name].kind == WHOLE:
            check_most(f"{label} {name}", value, keys[name].most)
    return found


def _check_names(label: str, given: Any, known: Any, required: Any) -> None:
    for name in given:
        if name not in known:
            raise ValueError(f"unknown key {name!r} in {label}. {nearest(name, known)}")
    for name in required:
        if name not in given:
            raise ValueError(f"{label} lacks the key {name!r}.")


def _of_kind(kind: str, label: str, value: Any) -> Any:
    number, listed = _is_number(value), isinstance(value, list)
    if kind == NUMBER_OR_FALSE and value is False:
        return None
    if kind in (NUMBER, NUMBER_OR_FALSE) and number:
        return float(value)
    if kind in (RANGE, RANGE_OR_NUMBER) and listed:
        return frequency_range(label, value)
    if kind == RANGE_OR_NUMBER and number:
        return one_frequency(label, float(value))
    if kind == AXES and isinstance(value, dict):
        return _axes("[map.axes]", value)
    if kind == GROUPS and listed:
        return [_axes("[[map.zipped]]", group) for group in value]
    as_it_is = {
        WHOLE: number and isinstance(value, int),
        TEXT: isinstance(value, str),
        SWITCH: isinstance(value, bool),
        TEXTS: isinstance(value, list) and all(isinstance(text, str) for text in value),
        MASSES: listed,
    }
    if as_it_is.get(kind):
        return value
    raise ValueError(f"{label} must be {kind}, got {_in_toml(value)}.")


def _is_number(value: Any) -> bool:
    """Whether a value is a number that a float can hold, or infinite or no number by name."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, float) or (whole and abs(value) <= sys.float_info.max)


def _in_toml(value: Any) -> str:
    """Return a value as a sentence shows it, cut short where it is long."""
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return str(value).lower() if isinstance(value, bool) else reprlib.repr(value)


def check_most(label: str, value: int, most: int) -> None:
    """Raise `ValueError` for a count of more than `most`."""
    if value > most:
        raise ValueError(f"{label} must be at most {most:,}, got {reprlib.repr(value)}.")


def frequency_range(label: str, values: Any) -> np.ndarray:
    """Return the evenly spaced frequencies of [start, end, points].

    Raises `ValueError`, in the name of `label`, when they are not three numbers, the points not a
    whole number from 2 to 1,000,000, or the frequencies not finite, above 0 and increasing.
    """
    if len(values) != 3 or not all(_is_number(value) for value in values):
        raise ValueError(f"{label} must be three numbers, {RANGE}, got {_in_toml(list(values))}.")
    start, end, points = float(values[0]), float(values[1]), values[2]
    axis = spaced(label, start, end, points, advice="The backward sweep is made for you.")
    one_frequency(f"Start of {label}", start)
    return check_frequencies(label, axis, "Hz")


def one_frequency(label: str, value: float) -> float:
    """Return a single drive frequency. Raises `ValueError` unless it is finite and above 0."""
    check_positive(label, value, "Hz" if label.endswith("frequency") else "(ratio)")
    return value


def spaced(
    label: str,
    start: float,
    end: float,
    points: Any,
    spacing: Any = "linear",
    advice: str = "A single value is given as a list of one.",
) -> list[float]:
    """Return the values of an axis of a map, `spacing` "linear" or "log" (even ratios).

    Raises `ValueError`, in the name of `label`, for ends that do not increase (with the advice) or
    are not finite, fewer than 2 or more than 1,000,000 points, an unknown spacing, or a start of 0
    or less with even ratios.
    """
    check_choice(f"Spacing of {label}", spacing, SPACINGS)
    check_count(f"Points of {label}", points, least=2, most=MOST_POINTS)
    if not np.isfinite([start, end]).all():
        raise ValueError(f"{label} must be finite, got start {start!r} and end {end!r}.")
    if end <= start:
        raise ValueError(
            f"{label} must start below its end, got start {start!r} and end {end!r}. {advice}"
        )
    if spacing == "log" and start <= 0:
        raise ValueError(f"Start of {label} must be above 0 with log spacing, got {start!r}.")
    between = np.geomspace if spacing == "log" else np.linspace
    return between(start, end, points).tolist()


def _axes(label: str, table: Any) -> dict[str, list[float]]:
    """Return the values of axes by name: lists of numbers, or {start, end, points, spacing}."""
    if not isinstance(table, dict):
        raise ValueError(f"{label} must be a table of axes, got {_in_toml(table)}.")
    return {name: _values(f"{label} {name}", given) for name, given in table.items()}


def _values(label: str, given: Any) -> list[float]:
    if isinstance(given, list) and given:
        check_most(f"Points of {label}", len(given), MOST_POINTS)
        return [_of_kind(NUMBER, f"Every value of {label}", value) for value in given]
    if not isinstance(given, dict):
        raise ValueError(
            f"{label} must be a list of numbers, or {{start = ..., end = ..., points = ...}}, got "
            f"{_in_toml(given)}."
        )
    _check_names(label, given, SPACED_KEYS, SPACED_KEYS[:3])
    start, end = (_of_kind(NUMBER, f"{label} {name}", given[name]) for name in ("start", "end"))
    return spaced(label, start, end, given["points"], given.get("spacing", "linear"))


def _within(label: str, build: Any, *args: Any, **numbers: Any) -> Any:
    """Build a part of the rig; what it refuses is named with its table."""
    try:
        return build(*args, **numbers)
    except ValueError as error:
        raise ValueError(f"{label} {error}") from None


def _stop(values: Any, label: str) -> Stop:
    keys = _check_keys("stop", values, label)
    build, own = LAWS[keys.pop("law", "kelvin_voigt")]
    numbers = {name: keys.pop(name) for name in own if name in keys}
    return _within(label, Stop, law=_within(label, build, **numbers), **keys)


def _beam(values: Any) -> Cantilever:
    keys = _check_keys("beam", values, "[beam]")
    label = "[[beam.point_masses]]"
    masses = tuple(
        _within(label, PointMass, **_check_keys("beam.point_masses", one, label))
        for one in keys.pop("point_masses", ())
    )
    return _within("[beam]", Cantilever, **keys, point_masses=masses)


def _stops(found: Any) -> tuple[Stop, ...]:
    if not isinstance(found, list):
        return (_stop(found, "[stop]"),)
    labels = [f"[[stop]] {i}:" if len(found) > 1 else "[[stop]]" for i in range(1, len(found) + 1)]
    return tuple(_stop(values, label) for values, label in zip(found, labels, strict=True))


def _drive(values: Any) -> AbstractDrive:
    keys = _check_keys("drive", values, "[drive]")
    kind = keys.pop("kind")
    _within("[drive]", check_choice, "kind", kind, KINDS_OF_DRIVE)
    if kind == "point_force":
        return _within("[drive]", PointForce, **keys)
    if "position" in keys:
        raise ValueError("[drive] position is for kind = 'point_force': the base moves as a whole.")
    return _within("[drive]", BaseMotion, **keys)


def _system(tables: dict[str, Any]) -> ImpactingBeam:
    known = (*(name for name in KEYS if "." not in name), "map")
    for name, value in tables.items():
        if name not in known:
            what = "table" if isinstance(value, dict | list) else "key outside the tables,"
            raise ValueError(f"unknown {what} {name!r}. {nearest(name, known)}")
    for name in ("beam", "model"):
        if name not in tables:
            raise ValueError(f"the table {_shown(name)} is missing.")
    beam = _beam(tables["beam"])
    stops = _stops(tables.get("stop", []))
    drive = _drive(tables["drive"]) if "drive" in tables else NoDrive()
    model = _check_keys("model", tables["model"], "[model]")
    return _within("[model]", ImpactingBeam, beam=beam, stops=stops, drive=drive, **model)


def _settings(tables: dict[str, Any], table: str) -> dict[str, Any]:
    settings = _check_keys(table, tables.get(table, {}), f"[{table}]")
    if "frequency" in settings and "frequency_ratio" in settings:
        raise ValueError(f"[{table}] has frequency and frequency_ratio: give one of the two.")
    return settings


def _sweep_settings(tables: dict[str, Any]) -> dict[str, Any]:
    settings = _settings(tables, "sweep")
    keywords = {n: settings.pop(n) for n in ("frequency", "frequency_ratio") if n in settings}
    return keywords | {"settings": _within("[sweep]", SweepSettings, **settings)}


def _map_settings(tables: dict[str, Any]) -> dict[str, Any]:
    settings = _settings(tables, "map")
    response = settings.get("response", "sweep")
    _within("[map]", check_choice, "response", response, KINDS_OF_RESPONSE)
    if "direction" in settings:
        _within("[map]", check_choice, "direction", settings["direction"], tuple(DIRECTIONS))
        if response != "sweep":
            raise ValueError(f"[map] direction is for response = 'sweep', not {response!r}.")
    return settings
