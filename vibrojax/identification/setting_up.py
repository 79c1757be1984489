"""From a call of `identify` to a problem: what is fitted, what is fixed, and whether it can be."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vibrojax._tools.checks import check_choice, check_names, check_needed_arguments
from vibrojax._tools.described import in_short
from vibrojax.ensemble.frequencies import check_drive
from vibrojax.identification.coordinates import Coordinate, coordinate_of
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.fold_misfit import FoldMisfit
from vibrojax.identification.history_misfit import HistoryMisfit
from vibrojax.identification.problem import Misfit, Part, Problem
from vibrojax.measured.curve import MeasuredCurve, MeasuredCurves
from vibrojax.measured.history import MeasuredHistory
from vibrojax.measured.reading import read_measured_curve
from vibrojax.model.systems import AbstractSystem, check_made

OBJECTIVES = ("distance", "pointwise", "folds")
Measurement = MeasuredCurve | MeasuredHistory
Make = Callable[..., AbstractSystem]


class Given(NamedTuple):
    """What `identify` was asked, put in order."""

    make: Make
    guess: dict[str, float]
    """By unknown: the argument, or argument[label] where it is private to a measurement."""
    arguments: dict[str, str]
    """Argument of the function, by unknown."""
    numbers: dict[str, Any]
    """Arguments held fixed."""
    private: tuple[str, ...]
    bounds: dict[str, tuple[float, float]]
    transforms: dict[str, str]
    objective: str


def measurements_of(measured: Any, name: str = "measured") -> tuple[Measurement, ...]:
    """Return what was measured as a tuple. Raises `ValueError` for anything else."""
    if isinstance(measured, str | Path):
        measured = read_measured_curve(measured)
    if isinstance(measured, MeasuredCurve | MeasuredHistory):
        return (measured,)
    if isinstance(measured, MeasuredCurves | Sequence):
        parts = [part for one in measured for part in measurements_of(one, name)]
        if parts:
            return tuple(parts)
    raise ValueError(
        f"{name} must be a MeasuredCurve, a MeasuredHistory, several of them or the path of a "
        f"curve, got {in_short(measured)}."
    )


def label_of(measurement: Measurement, index: int) -> str:
    """Name of a measurement among others."""
    return measurement.label or str(index + 1)


def given(
    make: Make,
    measured: tuple[Measurement, ...],
    guess: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None,
    private: Sequence[str],
    transforms: Mapping[str, str] | None,
    objective: str,
    numbers: dict[str, Any],
) -> Given:
    """Check the names of a call. Raises `ValueError` as `identify` says."""
    check_choice("objective", objective, OBJECTIVES)
    if not guess:
        raise ValueError(
            f"guess must name at least one number to fit, as dict(stiffness=3000.0), got {guess!r}."
        )
    of_curves = {n for m in measured for n in m.parameters}
    for what, names in (
        ("guess", guess),
        ("private", private),
        ("parameters of measured", of_curves),
        ("call", numbers),
    ):
        check_names(make, names, what)
    check_needed_arguments(make, [*guess, *numbers, *of_curves])
    for what, names in (("bounds", bounds), ("transforms", transforms), ("private", private)):
        for name in names or ():
            if name not in guess:
                raise ValueError(f"{what} of {name!r}: it is not in guess, so it is not fitted.")
    for name in guess:
        if name in numbers:
            raise ValueError(f"{name} is both fitted (in guess) and held fixed at {numbers[name]}.")
        if name in of_curves:
            raise ValueError(
                f"{name} is fitted (in guess), but the measurement says what it is. Leave it out "
                "of one of the two."
            )
    numeric = {n: float(v) for n, v in guess.items()}
    start, arguments = {}, {}
    for name, value in numeric.items():
        if name not in private:
            start[name], arguments[name] = value, name
            continue
        for k, m in enumerate(measured):
            own = f"{name}[{label_of(m, k)}]"
            if own in start:
                raise ValueError(f"Two measurements have the label {label_of(m, k)!r}.")
            start[own], arguments[own] = value, name
    return Given(
        make=make,
        guess=start,
        arguments=arguments,
        numbers=numbers,
        private=tuple(private),
        bounds=dict(bounds or {}),
        transforms=dict(transforms or {}),
        objective=objective,
    )


def coordinates_of(given: Given) -> tuple[Coordinate, ...]:
    """Coordinates of the unknowns."""
    return tuple(
        coordinate_of(
            name,
            argument,
            given.guess[name],
            given.bounds.get(argument),
            given.transforms.get(argument),
        )
        for name, argument in given.arguments.items()
    )


def own_name(given: Given, argument: str, measurement: Measurement, index: int) -> str:
    """Unknown that an argument is for one measurement."""
    return f"{argument}[{label_of(measurement, index)}]" if argument in given.private else argument


def problem_of(given: Given, repetitions: Sequence[tuple[Measurement, ...]]) -> Problem:
    """Set the problem up. Raises `ValueError` for data that cannot be fitted."""
    coordinates = coordinates_of(given)
    index = {c.name: k for k, c in enumerate(coordinates)}
    names = tuple(dict.fromkeys(given.arguments.values()))
    parts = []
    for k, first in enumerate(repetitions[0]):
        same = [r[k] for r in repetitions]
        held = given.numbers | first.parameters
        fixed = {n: float(v) for n, v in held.items() if _is_real(v)}
        static = {n: v for n, v in held.items() if n not in fixed}
        unknowns = tuple(index[own_name(given, n, first, k)] for n in names)
        start = {n: coordinates[u] for n, u in zip(names, unknowns, strict=True)}
        values = {n: given.guess[c.name] for n, c in start.items()}
        sample = given.make(**static, **fixed, **values)
        check_made(given.make, sample)
        histories = [m for m in same if isinstance(m, MeasuredHistory)]
        curves = [m for m in same if isinstance(m, MeasuredCurve)]
        if histories and curves:
            raise ValueError("Repetitions must hold curves and histories in the same order.")
        misfit: Misfit
        if histories:
            misfit = HistoryMisfit(given.make, names, fixed, static, histories)
        else:
            start_values = list(values.values())
            misfit = _curve_misfit(given, names, fixed, static, curves, sample, start_values)
        parts.append(Part(misfit, unknowns))
    problem = Problem(parts, coordinates)
    count = sum(m.size for m in repetitions[0])
    if count < len(coordinates):
        raise ValueError(
            f"There are fewer measured points ({count}) than numbers to fit ({len(coordinates)}): "
            "measure more, or fit less."
        )
    return problem


def _is_real(value: Any) -> bool:
    return isinstance(value, float | np.floating) or (
        hasattr(value, "dtype") and np.ndim(value) == 0
    )


def _curve_misfit(
    given: Given,
    names: tuple[str, ...],
    fixed: dict[str, float],
    static: dict[str, Any],
    same: Sequence[MeasuredCurve],
    sample: AbstractSystem,
    values: list[float],
) -> CurveMisfit:
    check_drive(sample)
    kind = FoldMisfit if given.objective == "folds" else CurveMisfit
    objective = "distance" if given.objective == "distance" else "pointwise"
    misfit = kind(given.make, names, fixed, static, same, objective=objective)
    paths = misfit.lanes(np.array([values])).paths
    first = np.asarray(paths.equations.angular_frequency)[0] / float(paths.unit[0])
    if same[0].frequency_name != "frequency_ratio":
        misfit.unit = float(first[0])
    _check_overlap(misfit, first)
    return misfit


def _check_overlap(misfit: CurveMisfit, natural: np.ndarray) -> None:
    """Refuse frequencies that are not those of the model (`natural`, in their unit)."""
    low, high = float(misfit.frequency.min()), float(misfit.frequency.max())
    if high < 0.05 * natural[0] or low > 1.5 * natural[-1]:
        hertz = "" if misfit.is_ratio else " Hz"
        raise ValueError(
            f"The measured frequencies, {low:.4g} to {high:.4g}{hertz}, do not overlap those of "
            f"the model, whose natural frequencies are {', '.join(f'{f:.4g}' for f in natural)}"
            f"{hertz}. Check the unit of the frequency (Hz or ratio) and the rig."
        )


def check_contact(problem: Problem, point: np.ndarray, repetitions: int) -> None:
    """Raise `ValueError` where a fit of nothing but the stops meets data without contact."""
    parts = [(p.misfit, list(p.unknowns)) for p in problem.parts]
    curves = [(m, u) for m, u in parts if isinstance(m, CurveMisfit)]
    if len(curves) < len(parts):
        return
    # Numbers a little off: those of the stops change nothing without contact.
    points = point + np.vstack([np.zeros(len(point)), 1e-2 * np.eye(len(point))])
    numbers = problem.numbers(points)
    for which in range(repetitions):
        residual = np.concatenate(
            [misfit.without_contact(numbers[:, unknowns], which) for misfit, unknowns in curves],
            axis=1,
        )
        squares, count = float(residual[0] @ residual[0]), residual.shape[1]
        if squares < 1.5 * count and np.abs(residual[1:] - residual[0]).max() < 1e-9:
            raise ValueError(
                "The measured curve never touches the stop: the beam without contact explains it "
                f"(reduced chi-square {squares / count:.3g}), so contact cannot be identified from "
                "it. Drive harder, close the gap, or measure nearer to resonance."
            )
