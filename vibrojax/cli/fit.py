"""What `vibrojax fit` does: numbers of a rig, their guesses and bounds, the curve, the fit."""

import dataclasses
import inspect
import re
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax._tools.interrupts import stoppable
from vibrojax._tools.kinds import LARGEST
from vibrojax.cli.files import read, target, title, watch_compilation
from vibrojax.cli.options import Fit
from vibrojax.ensemble.ranges import Range
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.reading import read_measured_curve
from vibrojax.model.drives import NoDrive
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.model.laws import AbstractContactLaw, KelvinVoigt

_OF_BEAM = (
    "length",
    "width",
    "thickness",
    "youngs_modulus",
    "density",
    "taper",
    "mass_ratio",
)
_OF_STOP = ("position", "gap")
_BOUNDS = {
    "taper": Range(0.0, 0.99),
    "mass_ratio": Range(0.0, LARGEST),
    "gap": Range(0.0, LARGEST),
    "position": Range(0.01, 1.0),
    "damping_ratio": Range(0.0, LARGEST),
}
"""Bounds of the numbers that make no rig beyond them."""


def run_fit(options: Fit) -> int:
    """Fit numbers of a rig, write files of what was found. Raises `ValueError` for wrong input."""
    started = time.perf_counter()
    output, fit = options.output, options.fit
    if output.suffix.lower() not in ("", ".json", ".png"):
        raise ValueError(f"--output must be a name without ending, or .json, got {str(output)!r}.")
    if not output.name:
        raise ValueError(f"--output must be the name of a file, got {str(output)!r}.")
    data, drawing = output.with_suffix(".json"), output.with_suffix(".png")
    target("--output", data, (".json",))
    target("--output", drawing, (".png",))
    page = target("--report", options.report, (".html", ".htm"))
    from vibrojax.identification.identify import identify
    from vibrojax.identification.report import write_report

    if not fit or len(set(fit)) < len(fit):
        raise ValueError("--fit must name at least one number, and each of them once.")
    system, _ = read(options.rig, "fit")
    check_names(system, {name: f"--fit {name}" for name in fit})
    make = rig_function(system, fit)
    numbers = guesses(system, fit, options.guess), bounds(fit, options.bounds)
    measured = read_curve(options)
    compiling = watch_compilation()
    how: dict[str, Any] = {"objective": options.objective, "searches": options.searches}
    found = stoppable(identify, make, measured, *numbers, **how)
    fitted = time.perf_counter()
    found.save(data)
    if page is not None:
        write_report(found, page, *source_of_rig(options.rig, fit))
    print(f"{title('Fit', options.rig)} to {options.curve}")
    print("\n".join(f"  {line}" for line in repr(found).splitlines()))
    print(f"  time     {fitted - started:.1f} s (compiling {compiling():.1f} s)")
    written = [data, drawing] if page is None else [data, drawing, page]
    print(f"  written  {', '.join(map(str, written))}")
    return 0


def source_of_rig(rig: Path | None, names: Sequence[str]) -> tuple[str, dict[str, str]]:
    """Return Python text that makes the function of a rig file again, and the files it reads."""
    system, files = "vibrojax.default_rig()", {}
    if rig is not None:
        system, files = (
            "vibrojax.io.read_rig(HERE / 'rig.toml')[0]",
            {"rig.toml": rig.read_text("utf-8")},
        )
    text = f"from {__name__} import rig_function\n\nrig = rig_function({system}, {[*names]})"
    return text, files


def rig_numbers(system: ImpactingBeam) -> dict[str, float]:
    """Return the numbers of a rig that can be fitted, by name; of stops, those of the first."""
    found = {name: getattr(system.beam, name) for name in _OF_BEAM}
    if system.stops:
        stop = system.stops[0]
        found |= {name: getattr(stop, name) for name in _OF_STOP}
        found |= {name: getattr(stop.law, name) for name in _of_law(stop.law)}
    found["damping_ratio"] = system.damping_ratio
    if not isinstance(system.drive, NoDrive):
        found["amplitude"] = getattr(system.drive, "amplitude")  # noqa: B009
    return {name: float(np.asarray(value)) for name, value in found.items()}


def rig_function(system: ImpactingBeam, names: Sequence[str]) -> Callable[..., ImpactingBeam]:
    """Return a function of some numbers of a rig, whose defaults are those the rig has."""
    known = rig_numbers(system)

    def make(**numbers: Any) -> ImpactingBeam:
        """Return the rig with some numbers changed."""
        changed: dict[str, Any] = {
            "beam": dataclasses.replace(system.beam, **_of(numbers, _OF_BEAM)),
            **_of(numbers, ("damping_ratio",)),
        }
        if system.stops:
            first, *others = system.stops
            law: Any = first.law
            law = dataclasses.replace(law, **_of(numbers, _of_law(law)))
            first = dataclasses.replace(first, law=law, **_of(numbers, _OF_STOP))
            changed["stops"] = (first, *others)
        if "amplitude" in numbers:
            drive: Any = system.drive
            changed["drive"] = dataclasses.replace(drive, amplitude=numbers["amplitude"])
        return dataclasses.replace(system, **changed)

    keyword = inspect.Parameter.KEYWORD_ONLY
    parameters = [inspect.Parameter(name, keyword, default=known[name]) for name in names]
    setattr(make, "__signature__", inspect.Signature(parameters))  # noqa: B010
    return make


def _of_law(law: AbstractContactLaw) -> tuple[str, ...]:
    """Names of the numbers of a contact law."""
    fields: Any = dataclasses.fields(law)  # pyright: ignore[reportArgumentType]
    return tuple(field.name for field in fields if not field.metadata.get("static"))


def _of(numbers: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    return {name: numbers[name] for name in names if name in numbers}


def check_names(system: ImpactingBeam, labels: Mapping[str, str]) -> None:
    """Raise `ValueError` for a name that is no number of a rig; `labels` say where it was given."""
    known = rig_numbers(system)
    for name, where in labels.items():
        if name in known:
            continue
        if name in (*_OF_STOP, *_of_law(KelvinVoigt(0.0))) and not system.stops:
            raise ValueError(f"{where}: the rig has no stop. Give it a table [[stop]].")
        raise ValueError(f"{where}: no such number of the rig. {nearest(name, known)}")


def pairs(option: str, texts: Sequence[str], example: str) -> dict[str, str]:
    """Return what was given as name=value. Raises `ValueError`, naming the option, otherwise."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise ValueError(f"{option} must be name=value, such as {example}, got {text!r}.")
        if name in found:
            raise ValueError(f"{option} has {name} twice.")
        found[name] = value
    return found


def guesses(system: ImpactingBeam, names: Sequence[str], given: Sequence[str]) -> dict[str, float]:
    """Return the first value of every number to fit: as given, else as the rig has it."""
    known = rig_numbers(system)
    by_name = pairs("--guess", given, "stiffness=3000")
    _check_fitted("--guess", by_name, names)
    return {
        name: number(f"--guess of {name}", by_name[name]) if name in by_name else known[name]
        for name in names
    }


def bounds(names: Sequence[str], given: Sequence[str]) -> dict[str, Range]:
    """Return the bounds of the numbers to fit: as given, else where there is no rig beyond."""
    by_name = pairs("--bounds", given, "stiffness=100:1e5")
    _check_fitted("--bounds", by_name, names)
    found = {name: _BOUNDS[name] for name in names if name in _BOUNDS}
    for name, text in by_name.items():
        ends = text.split(":")
        if len(ends) != 2:
            raise ValueError(
                f"--bounds must be name=low:high, such as stiffness=100:1e5, got '{name}={text}'."
            )
        low, high = (number(f"--bounds of {name}", end) for end in ends)
        found[name] = Range(low, high)
    return found


def _check_fitted(option: str, by_name: Mapping[str, str], names: Sequence[str]) -> None:
    for name in by_name:
        if name not in names:
            raise ValueError(
                f"{option} of {name!r}, which is not fitted: {', '.join(names)} "
                f"{'is' if len(names) == 1 else 'are'}. Name it in --fit."
            )


def number(label: str, text: str) -> float:
    """Return the number that a text is. Raises `ValueError`, with the label, for what is none."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{label} must be a number, got {text!r}.") from None


def columns_of(texts: Sequence[str], example: str) -> dict[str, str | int | None]:
    """Return columns of a file by key, by name or position. Raises `ValueError` as `pairs`."""
    columns: dict[str, str | int | None] = {}
    for key, value in pairs("--columns", texts, example).items():
        columns[key] = int(value) if value.isdecimal() else None if value == "none" else value
    return columns


def read_curve(options: Fit) -> MeasuredCurve:
    """Read the curve to fit. Raises `ValueError` as `read_measured_curve` does."""
    columns = columns_of(options.columns, "frequency=f_Hz")
    how = {name: getattr(options, name) for name in ("quantity", "frame", "decimal", "at", "run")}
    units = pairs("--units", options.units, "amplitude=mm")
    try:
        found = read_measured_curve(options.curve, columns=columns, units=units, **how)
    except ValueError as error:
        raise ValueError(as_options(str(error))) from None
    if not isinstance(found, MeasuredCurve):
        names = ", ".join(repr(curve.label) for curve in found)
        raise ValueError(
            f"{str(options.curve)!r} holds {len(found)} curves, {names}: say which by --run."
        )
    return found


def as_options(advice: str) -> str:
    """Return advice to a caller as that to a user of the command: options for keywords."""
    advice = re.sub(
        r"(columns|units)=dict\((\w+)=('[^']*'|\w+)\)",
        lambda m: f"--{m[1]} {m[2]}={'none' if m[3] == 'None' else m[3]}",
        advice,
    )
    return re.sub(r"\b(decimal|quantity|frame|at|run)=", r"--\1 ", advice)
