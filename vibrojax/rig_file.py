"""Rig files: a beam, its stops, its drive, how to sweep it and a map over its numbers, in TOML."""

import os
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vibrojax._checks import (
    check_choice,
    check_count,
    check_frequencies,
    check_positive,
    nearest,
)
from vibrojax.beam import Cantilever
from vibrojax.contact import Stop
from vibrojax.contact_laws import KelvinVoigt
from vibrojax.drive import AbstractDrive, BaseMotion, NoDrive, PointForce
from vibrojax.stepping.method import check_settings
from vibrojax.studies.frequency_sweep import DIRECTIONS
from vibrojax.systems.impacting_beam import ImpactingBeam


class _Key(NamedTuple):
    kind: str
    required: bool = False


_NUMBER = "a number"
_WHOLE = "a whole number"
_TEXT = "a text in quotes"
_SWITCH = "true or false"
_RANGE = "[start, end, points]"
_NUMBER_OR_FALSE = "a number or false"
_RANGE_OR_NUMBER = "[start, end, points] or one number"
_TEXTS = "a list of texts in quotes"
_AXES = "a table [map.axes]"
_GROUPS = "one or more tables [[map.zipped]]"

_KEYS = {
    "beam": {
        "length": _Key(_NUMBER, True),
        "width": _Key(_NUMBER, True),
        "thickness": _Key(_NUMBER, True),
        "youngs_modulus": _Key(_NUMBER, True),
        "density": _Key(_NUMBER, True),
        "taper": _Key(_NUMBER),
        "mass_ratio": _Key(_NUMBER),
    },
    "stop": {
        "position": _Key(_NUMBER, True),
        "gap": _Key(_NUMBER, True),
        "stiffness": _Key(_NUMBER, True),
        "damping": _Key(_NUMBER),
        "side": _Key(_WHOLE),
        "tension": _Key(_SWITCH),
        "smoothing": _Key(_NUMBER),
    },
    "drive": {
        "kind": _Key(_TEXT, True),
        "amplitude": _Key(_NUMBER, True),
        "position": _Key(_NUMBER),
    },
    "model": {
        "damping_ratio": _Key(_NUMBER, True),
        "num_modes": _Key(_WHOLE),
        "formulation": _Key(_TEXT),
    },
    "sweep": {
        "frequency_ratio": _Key(_RANGE),
        "frequency": _Key(_RANGE),
        "direction": _Key(_TEXT),
        "tolerance": _Key(_NUMBER),
        "steps_per_period": _Key(_WHOLE),
        "max_period": _Key(_WHOLE),
        "max_periods": _Key(_WHOLE),
        "refine_jumps": _Key(_NUMBER_OR_FALSE),
    },
}
_MAP_KEYS = {
    "response": _Key(_TEXT),
    "frequency_ratio": _Key(_RANGE_OR_NUMBER),
    "frequency": _Key(_RANGE_OR_NUMBER),
    "direction": _Key(_TEXT),
    "tolerance": _Key(_NUMBER),
    "measures": _Key(_TEXTS),
    "keep_curves": _Key(_SWITCH),
    "gradients": _Key(_TEXTS),
    "axes": _Key(_AXES),
    "zipped": _Key(_GROUPS),
}
"""Keys of [map], which `examples/map.toml` explains."""
_SPACED_KEYS = ("start", "end", "points", "spacing")
_SPACINGS = ("linear", "log")
_KINDS_OF_RESPONSE = ("sweep", "periodic", "continuation")
_KINDS_OF_DRIVE = ("base_motion", "point_force")


def read_rig(path: str | os.PathLike[str]) -> tuple[ImpactingBeam, dict[str, Any]]:
    """Read a rig file and return the rig and the keywords of `frequency_sweep` it asks for.

        system, settings = vj.read_rig("examples/uniform_beam.toml")
        curve = vj.frequency_sweep(system, **settings)

    Tables, all in SI units (`examples/uniform_beam.toml` explains every key):
        [beam]    length, width, thickness, youngs_modulus, density; taper, mass_ratio (0)
        [[stop]]  position, gap, stiffness; damping (0), side (1), tension (true), smoothing;
                  once for each stop, or not at all
        [drive]   kind ("base_motion" or "point_force"), amplitude; position of a force (1);
                  may be left out where only the modes are wanted
        [model]   damping_ratio; num_modes (5), formulation ("consistent")
        [sweep]   frequency_ratio or frequency (Hz) = [start, end, points]; direction, tolerance,
                  steps_per_period, max_period, max_periods, refine_jumps (false: do not)
        [map]     a map over numbers of the rig, for `vibrojax map` (`examples/map.toml`)

    Raises `ValueError`, naming the file and the key, when the file cannot be read or is not TOML,
    a table or key is unknown or missing, or a value is of the wrong kind or not possible.
    (`frequency_sweep` itself checks max_period, max_periods and refine_jumps.)
    """
    tables = _load(path)
    try:
        system = _system(tables)
        _map_settings(tables)
        return system, _sweep_settings(tables)
    except ValueError as error:
        raise ValueError(f"Rig file {os.fspath(path)!r}: {error}") from None


def read_map(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what the table [map] of a rig file asks for, by key; nothing where there is none.

    Axes are lists of numbers by name, those of [map.axes] under `axes`, each [[map.zipped]] in the
    list `zipped`. Raises `ValueError` as `read_rig` does.
    """
    try:
        return _map_settings(_load(path))
    except ValueError as error:
        if str(error).startswith("Rig file"):
            raise
        raise ValueError(f"Rig file {os.fspath(path)!r}: {error}") from None


def _load(path: str | os.PathLike[str]) -> dict[str, Any]:
    name = f"Rig file {os.fspath(path)!r}"
    try:
        return tomllib.loads(Path(path).read_bytes().decode())
    except FileNotFoundError:
        raise ValueError(f"{name} does not exist.") from None
    except OSError as error:
        raise ValueError(f"{name} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise ValueError(f"{name} is not TOML: it is not text in UTF-8.") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{name} is not TOML: {error}.") from None


def _shown(table: str) -> str:
    return "[[stop]]" if table == "stop" else f"[{table}]"


def _check_keys(table: str, values: Any, label: str) -> dict[str, Any]:
    """Return the keys of one table, each of its kind; numbers become floats."""
    keys = _MAP_KEYS if table == "map" else _KEYS[table]
    if not isinstance(values, dict):
        raise ValueError(f"{table} must be a table that begins with {_shown(table)}.")
    for name in values:
        if name not in keys:
            raise ValueError(f"unknown key {name!r} in {label}. {nearest(name, keys)}")
    for name, key in keys.items():
        if key.required and name not in values:
            raise ValueError(f"{label} lacks the key {name!r}.")
    return {name: _of_kind(keys[name].kind, f"{label} {name}", v) for name, v in values.items()}


def _of_kind(kind: str, label: str, value: Any) -> Any:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind == _NUMBER_OR_FALSE and value is False:
        return None
    if kind in (_NUMBER, _NUMBER_OR_FALSE) and number:
        return float(value)
    if kind == _WHOLE and number and isinstance(value, int):
        return value
    if kind == _TEXT and isinstance(value, str):
        return value
    if kind == _SWITCH and isinstance(value, bool):
        return value
    if kind in (_RANGE, _RANGE_OR_NUMBER) and isinstance(value, list):
        return frequency_range(label, value)
    if kind == _RANGE_OR_NUMBER and number:
        return one_frequency(label, float(value))
    if kind == _TEXTS and isinstance(value, list) and all(isinstance(v, str) for v in value):
        return value
    if kind == _AXES and isinstance(value, dict):
        return _axes("[map.axes]", value)
    if kind == _GROUPS and isinstance(value, list):
        return [_axes("[[map.zipped]]", group) for group in value]
    raise ValueError(f"{label} must be {kind}, got {_in_toml(value)}.")


def _in_toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def frequency_range(label: str, values: Any) -> np.ndarray:
    """Return the evenly spaced frequencies of [start, end, points].

    Raises `ValueError`, in the name of `label`, when they are not three numbers, the points not a
    whole number of at least 2, or the frequencies not finite, above 0 and increasing.
    """
    is_number = [isinstance(v, int | float) and not isinstance(v, bool) for v in values]
    if len(values) != 3 or not all(is_number):
        raise ValueError(f"{label} must be three numbers, {_RANGE}, got {list(values)!r}.")
    start, end, points = values
    check_count(f"Points of {label}", points, least=2)
    if end <= start:
        raise ValueError(
            f"{label} must start below its end, got start {start!r} and end {end!r}. "
            "The backward sweep is made for you."
        )
    if not np.isfinite([start, end]).all():
        raise ValueError(f"{label} must be finite, got start {start!r} and end {end!r}.")
    check_positive(f"Start of {label}", start, "Hz" if label.endswith("frequency") else "(ratio)")
    axis = np.linspace(start, end, points)
    check_frequencies(label, axis, "Hz")
    return axis


def one_frequency(label: str, value: float) -> float:
    """Return a single drive frequency. Raises `ValueError` unless it is finite and above 0."""
    check_positive(label, value, "Hz" if label.endswith("frequency") else "(ratio)")
    return value


def spaced(
    label: str, start: float, end: float, points: Any, spacing: Any = "linear"
) -> list[float]:
    """Return the values of an axis of a map, `spacing` "linear" or "log" (even ratios).

    Raises `ValueError`, in the name of `label`, for ends that do not increase or are not finite,
    fewer than 2 points, an unknown spacing, or a start of 0 or less with even ratios.
    """
    check_choice(f"Spacing of {label}", spacing, _SPACINGS)
    check_count(f"Points of {label}", points, least=2)
    if not np.isfinite([start, end]).all():
        raise ValueError(f"{label} must be finite, got start {start!r} and end {end!r}.")
    if end <= start:
        raise ValueError(
            f"{label} must start below its end, got start {start!r} and end {end!r}. "
            "A single value is given as a list of one."
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
        return [_of_kind(_NUMBER, f"Every value of {label}", value) for value in given]
    if not isinstance(given, dict):
        raise ValueError(
            f"{label} must be a list of numbers, or {{start = ..., end = ..., points = ...}}, got "
            f"{_in_toml(given)}."
        )
    for name in given:
        if name not in _SPACED_KEYS:
            raise ValueError(f"unknown key {name!r} in {label}. {nearest(name, _SPACED_KEYS)}")
    for name in _SPACED_KEYS[:3]:
        if name not in given:
            raise ValueError(f"{label} lacks the key {name!r}.")
    start, end = (_of_kind(_NUMBER, f"{label} {name}", given[name]) for name in ("start", "end"))
    return spaced(label, start, end, given["points"], given.get("spacing", "linear"))


def _within(label: str, build: Any, *args: Any, **numbers: Any) -> Any:
    """Build a part of the rig; what it refuses is told with the name of its table."""
    try:
        return build(*args, **numbers)
    except ValueError as error:
        raise ValueError(f"{label} {error}") from None


def _stop(values: Any, label: str) -> Stop:
    keys = _check_keys("stop", values, label)
    law = {name: keys.pop(name) for name in ("stiffness", "damping", "tension") if name in keys}
    return _within(label, Stop, law=_within(label, KelvinVoigt, **law), **keys)


def _stops(found: Any) -> tuple[Stop, ...]:
    if not isinstance(found, list):
        return (_stop(found, "[stop]"),)
    labels = [f"[[stop]] {i}:" if len(found) > 1 else "[[stop]]" for i in range(1, len(found) + 1)]
    return tuple(_stop(values, label) for values, label in zip(found, labels, strict=True))


def _drive(values: Any) -> AbstractDrive:
    keys = _check_keys("drive", values, "[drive]")
    kind = keys.pop("kind")
    _within("[drive]", check_choice, "kind", kind, _KINDS_OF_DRIVE)
    if kind == "point_force":
        return _within("[drive]", PointForce, **keys)
    if "position" in keys:
        raise ValueError("[drive] position is for kind = 'point_force': the base moves as a whole.")
    return _within("[drive]", BaseMotion, **keys)


def _system(tables: dict[str, Any]) -> ImpactingBeam:
    known = (*_KEYS, "map")
    for name, value in tables.items():
        if name not in known:
            what = "table" if isinstance(value, dict | list) else "key outside the tables,"
            raise ValueError(f"unknown {what} {name!r}. {nearest(name, known)}")
    for name in ("beam", "model"):
        if name not in tables:
            raise ValueError(f"the table {_shown(name)} is missing.")
    beam = _within("[beam]", Cantilever, **_check_keys("beam", tables["beam"], "[beam]"))
    stops = _stops(tables.get("stop", []))
    drive = _drive(tables["drive"]) if "drive" in tables else NoDrive()
    model = _check_keys("model", tables["model"], "[model]")
    return _within("[model]", ImpactingBeam, beam=beam, stops=stops, drive=drive, **model)


def _sweep_settings(tables: dict[str, Any]) -> dict[str, Any]:
    settings = _check_keys("sweep", tables.get("sweep", {}), "[sweep]")
    if "frequency" in settings and "frequency_ratio" in settings:
        raise ValueError("[sweep] has frequency and frequency_ratio: give one of the two.")
    if "direction" in settings:
        _within("[sweep]", check_choice, "direction", settings["direction"], tuple(DIRECTIONS))
    tolerance = settings.get("tolerance", 1e-4)
    _within("[sweep]", check_settings, tolerance, settings.get("steps_per_period"))
    return settings


def _map_settings(tables: dict[str, Any]) -> dict[str, Any]:
    settings = _check_keys("map", tables.get("map", {}), "[map]")
    if "frequency" in settings and "frequency_ratio" in settings:
        raise ValueError("[map] has frequency and frequency_ratio: give one of the two.")
    response = settings.get("response", "sweep")
    _within("[map]", check_choice, "response", response, _KINDS_OF_RESPONSE)
    if "direction" in settings:
        _within("[map]", check_choice, "direction", settings["direction"], tuple(DIRECTIONS))
        if response != "sweep":
            raise ValueError(f"[map] direction is for response = 'sweep', not {response!r}.")
    return settings
