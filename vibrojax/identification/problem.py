"""From a call of `identify` to least squares: what is fitted, what is held, what is measured."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from vibrojax._tools.checks import check_choice, check_names
from vibrojax._tools.described import in_short
from vibrojax.ensemble.arguments import arguments_of, numbers_apart
from vibrojax.ensemble.frequencies import check_drive
from vibrojax.ensemble.lanes import made_by
from vibrojax.identification.coordinates import Coordinate, coordinate_of
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.fold_misfit import FoldMisfit
from vibrojax.identification.history_misfit import HistoryMisfit
from vibrojax.identification.record_numbers import (
    first_value,
    has_number,
    record_numbers_in,
    size_of,
)
from vibrojax.identification.trail import Trail, residuals_along
from vibrojax.identification.trial_rigs import Maker
from vibrojax.measured.curve import MeasuredCurve, MeasuredCurves
from vibrojax.measured.history import MeasuredHistory
from vibrojax.measured.kinds import ELECTRIC, SIGNALS
from vibrojax.measured.reading import read_measured_curve
from vibrojax.model.systems import AbstractSystem

REPORTED = {"V": "voltage", "W^0.5": "power"}
"""Signal of a response, by the unit of what is reported; of other units it is a motion."""
OBJECTIVES = ("distance", "pointwise", "folds")
Measurement = MeasuredCurve | MeasuredHistory


def measurements_of(measured: Any) -> tuple[Measurement, ...]:
    """Return what was measured as a tuple. Raises `ValueError` for anything else."""
    if isinstance(measured, str | Path):
        measured = read_measured_curve(measured)
    if isinstance(measured, Measurement):
        return (measured,)
    if isinstance(measured, MeasuredCurves | Sequence):
        parts = [part for one in measured for part in measurements_of(one)]
        if parts:
            return tuple(parts)
    raise ValueError(
        "measured must be a MeasuredCurve, a MeasuredHistory, several of them or the path of a "
        f"curve, got {in_short(measured)}."
    )


def repetitions_of(measured: Any) -> list[tuple[Measurement, ...]]:
    """Return what is fitted one by one. Raises `ValueError` unless all are of one size."""
    if isinstance(measured, str) or not isinstance(measured, MeasuredCurves | Sequence):
        raise ValueError(
            "measured must be a list, each of its elements to be fitted by itself (together=False),"
            f" got {in_short(measured)}."
        )
    data = [measurements_of(one) for one in measured]
    if not data:
        raise ValueError("measured is empty: give at least one measurement to fit by itself.")
    shapes = {tuple(m.size for m in parts) for parts in data}
    if len(shapes) > 1:
        raise ValueError(
            "measured: what is fitted one by one (together=False) must have the same numbers of "
            f"points, got {sorted(shapes)}. Fit those of one size in a call."
        )
    return data


def label_of(measurement: Measurement, index: int) -> str:
    """Name of a measurement among others."""
    return measurement.label or str(index + 1)


def fitted_and_held(
    make: Callable[..., AbstractSystem],
    measured: tuple[Measurement, ...],
    guess: Mapping[str, float | None],
    bounds: Mapping[str, Any],
    private: Sequence[str],
    transforms: Mapping[str, str],
    held: Mapping[str, Any],
) -> tuple[tuple[Coordinate, ...], dict[str, Any]]:
    """Coordinates of all that is fitted, and what is held. Raises `ValueError` as `identify`."""
    if not guess:
        raise ValueError(
            f"guess must name at least one number to fit, as dict(stiffness=3000.0), got {guess!r}."
        )
    of_curves = {n: v for m in measured for n, v in m.parameters.items()}
    of_records = record_numbers_in(make, guess)
    places = {"guess": guess, "private": private, "parameters of measured": of_curves}
    for where, names in places.items():
        check_names(make, [name for name in names if name not in of_records], where)
    for where, names in {"bounds": bounds, "transforms": transforms, "private": private}.items():
        for name in names:
            if name not in guess:
                raise ValueError(f"{where} of {name!r}: it is not in guess, so it is not fitted.")
    for name in guess:
        if name in held:
            raise ValueError(f"{name} is both fitted (in guess) and held fixed at {held[name]}.")
        if name in of_curves:
            raise ValueError(
                f"{name} is fitted (in guess), but the measurement says what it is. Leave it out "
                "of one of the two."
            )
    of_rig = {name: value for name, value in guess.items() if name not in of_records}
    named = arguments_of(make, (), {**of_curves, **of_rig, **held})
    if named.dimensions:
        name = named.dimensions[0].name
        raise ValueError(
            f"{name} must be one value that is held fixed, got {in_short(held[name])}. One rig is "
            f"fitted: call identify once for each value, or put {name} in guess."
        )
    labels = [label_of(m, k) for k, m in enumerate(measured)]
    twice = [label for label in labels if labels.count(label) > 1]
    if private and twice:
        raise ValueError(f"Two measurements have the label {twice[0]!r}.")
    found = []
    for name, value in guess.items():
        how = bounds.get(name), transforms.get(name)
        if name in of_records:
            histories = {
                n: m for n, m in zip(labels, measured, strict=True) if _has_number(m, name)
            }
            found += _of_records(name, value, how, histories, name in private)
            continue
        if value is None:
            raise ValueError(f"guess of {name} must be a number, got None.")
        one = coordinate_of(name, float(value), *how)
        found += [one._replace(label=m) for m in labels] if name in private else [one]
    return tuple(found), {n: v for n, v in named.fixed.items() if n in held}


def _has_number(measured: Measurement, name: str) -> bool:
    return isinstance(measured, MeasuredHistory) and has_number(measured, name)


def _of_records(
    name: str, value: float | None, how: tuple, histories: dict[str, Any], private: bool
) -> list[Coordinate]:
    """Coordinates of a number of records: one for all, or one for each. `value` as of `identify`.

    Raises `ValueError` where no history has this number.
    """
    if not histories:
        raise ValueError(
            f"{name} is a number of a record, and nothing measured has it: it takes a history "
            "that is not settled, or with that channel."
        )
    said = {
        label: first_value(h, name) if value is None else value for label, h in histories.items()
    }
    if not private:
        said = {"": float(np.mean(list(said.values())))}
    size = max(size_of(history, name) for history in histories.values())
    found = []
    for label, first in said.items():
        one = coordinate_of(name, float(first), *how)
        scale = size if one.kind == "linear" else one.scale
        found.append(one._replace(label=label, scale=scale))
    return found


class Problem:
    """Least squares in the coordinates of the unknowns, of several repetitions side by side.

    Raises `ValueError` for data that cannot be fitted.
    """

    def __init__(
        self,
        make: Callable[..., AbstractSystem],
        repetitions: Sequence[tuple[Measurement, ...]],
        coordinates: tuple[Coordinate, ...],
        objective: str,
        held: dict[str, Any],
    ):
        check_choice("objective", objective, OBJECTIVES)
        self.make, self.coordinates, self.objective = make, coordinates, objective
        self.held = held
        self.unknowns: list[dict[str, int]] = []
        """Index of every argument that is fitted, by measurement."""
        self.misfits: list[CurveMisfit | HistoryMisfit] = []
        for k, same in enumerate(zip(*repetitions, strict=True)):
            label = label_of(same[0], k)
            of_records = record_numbers_in(make, [c.argument for c in coordinates])
            self.unknowns.append(
                {
                    c.argument: i
                    for i, c in enumerate(coordinates)
                    if c.label in ("", label)
                    and (c.argument not in of_records or _has_number(same[0], c.argument))
                }
            )
            self.misfits.append(self._misfit(k, same))
        count = sum(m.size for m in repetitions[0])
        if count < len(coordinates):
            raise ValueError(
                f"There are fewer measured points ({count}) than numbers to fit "
                f"({len(coordinates)}): measure more, or fit less."
            )

    def _misfit(self, k: int, same: Sequence[Any]) -> CurveMisfit | HistoryMisfit:
        """Set up the misfit of one measurement, in all of its repetitions."""
        guess = [c.guess for c in self.coordinates]
        sample = self.system(guess, k, same[0])
        if len({type(m) for m in same}) > 1:
            raise ValueError(
                "measured: what is fitted one by one (together=False) must hold curves and "
                "histories in the same order."
            )
        fixed, static = numbers_apart(self.held | same[0].parameters)
        maker = Maker(self.make, tuple(self.unknowns[k]), fixed, static)
        if isinstance(same[0], MeasuredHistory):
            return HistoryMisfit(maker, same)
        _check_drive(sample, same[0], self.objective)
        _check_signal(sample, same[0])
        pointwise = self.objective != "distance"
        misfit = (FoldMisfit if self.objective == "folds" else CurveMisfit)(maker, same, pointwise)
        paths, slopes = misfit.lanes(np.array([[guess[i] for i in self.unknowns[k].values()]]))
        if misfit.drive is not None:
            _check_not_fitted(maker.names, slopes)
        natural = np.asarray(paths.equations.angular_frequency)[0] / float(paths.unit[0])
        if not misfit.is_ratio:
            misfit.unit = float(natural[0])
        _check_overlap(misfit, natural)
        return misfit

    def system(
        self, numbers: Sequence[float] | np.ndarray, k: int, measured: Measurement
    ) -> AbstractSystem:
        """Make the rig of the `k`-th measurement with these numbers (unknowns)."""
        return made_by(self.make, self.arguments(numbers, k, measured))

    def arguments(
        self, numbers: Sequence[float] | np.ndarray, k: int, measured: Measurement
    ) -> dict[str, Any]:
        """Return the arguments of the function of the rig, for the `k`-th measurement."""
        fitted = {name: float(numbers[i]) for name, i in self.unknowns[k].items()}
        for name in record_numbers_in(self.make, fitted):
            del fitted[name]
        return self.held | measured.parameters | fitted

    @property
    def names(self) -> tuple[str, ...]:
        """The unknowns."""
        return tuple(c.name for c in self.coordinates)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the coordinates."""
        low, high = zip(*(c.limits for c in self.coordinates), strict=True)
        return np.array(low), np.array(high)

    @property
    def guess(self) -> np.ndarray:
        """Coordinates of the guess."""
        return np.array([float(c.inside(c.guess)) for c in self.coordinates])

    def numbers(self, points: np.ndarray) -> np.ndarray:
        """Numbers at some points (lanes by unknowns)."""
        columns = [c.number(points[..., k]) for k, c in enumerate(self.coordinates)]
        return np.stack(columns, axis=-1)

    def of_measurement(self, k: int, points: np.ndarray) -> np.ndarray:
        """Numbers at some points (lanes by unknowns) that a measurement has to do with."""
        return self.numbers(points)[:, list(self.unknowns[k].values())]

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """Derivatives of the numbers in their coordinates (lanes by unknowns)."""
        columns = [c.slope(points[..., k]) for k, c in enumerate(self.coordinates)]
        return np.stack(columns, axis=-1)

    def evaluate(
        self,
        points: np.ndarray,
        which: np.ndarray,
        frequency_scale: float,
        *,
        precisely: bool = False,
        trail: Trail | None = None,
        starts: Sequence[int] | np.ndarray = (),
        shifts: dict[int, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their derivatives in the coordinates; `which`: repetition of each lane.

        With a `trail` the lanes of curves go on from what it keeps of their `starts`; `precisely`,
        all curves are followed anew. `shifts`: limits (lanes, 2) of those of some histories, by
        measurement.
        """
        slopes, residuals, jacobians = self.slopes(points), [], []
        for k, misfit in enumerate(self.misfits):
            numbers = self.of_measurement(k, points)
            if trail is not None and isinstance(misfit, CurveMisfit) and not misfit.pointwise:
                keys = [(k, int(start)) for start in starts]
                residual, derivative = residuals_along(
                    trail, keys, misfit, numbers, which, frequency_scale, precisely
                )
            else:
                limits = {"shifts": shifts[k]} if shifts and k in shifts else {}
                residual, derivative = misfit.residuals(
                    numbers, which, frequency_scale, precisely=precisely, **limits
                )
            jacobian = np.zeros((*residual.shape, len(self.coordinates)))
            own = list(self.unknowns[k].values())
            jacobian[:, :, own] = derivative * slopes[:, None, own]
            residuals.append(residual)
            jacobians.append(jacobian)
        return np.concatenate(residuals, axis=1), np.concatenate(jacobians, axis=1)

    def check_contact(self, repetitions: int) -> None:
        """Raise `ValueError` where only the stops are fitted and the data show no contact."""
        curves = [(k, m) for k, m in enumerate(self.misfits) if isinstance(m, CurveMisfit)]
        if len(curves) < len(self.misfits):
            return
        # Numbers a little off: those of the stops change nothing without contact.
        points = self.guess + np.eye(len(self.coordinates) + 1, len(self.coordinates), -1) * 1e-2

        def without(points: np.ndarray, which: int) -> np.ndarray:
            numbers = [(self.of_measurement(k, points), m) for k, m in curves]
            return np.concatenate([m.without_contact(n, which) for n, m in numbers], axis=1)

        for which in range(repetitions):
            (residual,) = without(points[:1], which)
            squares, count = float(residual @ residual), len(residual)
            if squares > 1.5 * count:
                continue
            if np.abs(without(points, which) - residual).max() < 1e-9:
                raise ValueError(
                    "The measured curve never touches the stop: the beam without contact explains "
                    f"it (reduced chi-square {squares / count:.3g}), so contact cannot be "
                    "identified from it. Drive harder, close the gap, or measure nearer to "
                    "resonance."
                )


def _check_drive(system: AbstractSystem, measured: MeasuredCurve, objective: str) -> None:
    """Refuse a system that nothing drives, or not what was measured."""
    name, drive, of_base = measured.drive_signal, system.drive, system.drive.signal_factor < 0
    if name and (name == "force") == of_base:
        kind = "the base moves" if of_base else "a force drives"
        raise ValueError(
            f"drive_signal = {name!r} was measured, but {kind} the system, {drive!r}. Give the "
            "system the drive that was measured, or leave drive_amplitude and drive_signal out "
            "(columns=dict(drive=None))."
        )
    if measured.drive_amplitude is None or not drive.signal_factor:
        check_drive(system)
    elif objective != "distance":
        raise ValueError(
            f"objective = {objective!r} takes the drive to be the same at all points, but the "
            "curve has drive_amplitude. Use objective='distance', or leave it out."
        )


def _check_not_fitted(names: tuple[str, ...], slopes: Any) -> None:
    """Refuse a number to fit that does nothing but drive, where the drive was measured."""
    leaves = jax.tree.leaves((slopes.equations, slopes.unit))
    for k, name in enumerate(names):
        if not any(np.any(leaf[:, k]) for leaf in leaves):
            raise ValueError(
                f"{name} changes nothing but the drive of the system, which was measured "
                "(drive_amplitude). Leave one of the two out."
            )


def _check_signal(system: AbstractSystem, measured: MeasuredCurve) -> None:
    """Refuse a signal that is not what the system reports."""
    if measured.amplitude is None:
        return
    reported = REPORTED.get(system.drive.reference[1])
    if reported is None and measured.signal in ELECTRIC:
        # What the response_map of other systems reads is known to their owner alone.
        reported = "displacement" if system.reported_place is not None else measured.signal
    if reported is not None and measured.signal != reported:
        raise ValueError(
            f"signal = {measured.signal!r} was measured, but the {type(system).__name__} reports "
            f"its {reported}. Give the curve in {SIGNALS[reported]}, or let the system report what "
            "was measured (report= of a Harvester)."
        )


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
