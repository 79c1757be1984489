"""Identification: the numbers of a rig that explain measured curves and histories."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from vibrojax._tools.checks import check_count, check_range
from vibrojax._tools.signatures import validated
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.findings import early_jumps, misfit, modes_left_out
from vibrojax.identification.fit import Alternative
from vibrojax.identification.fitted_data import Prediction
from vibrojax.identification.identification import Identification
from vibrojax.identification.least_squares import LevenbergMarquardt, Optax, Search
from vibrojax.identification.problem import Problem
from vibrojax.identification.setting_up import (
    Given,
    Measurement,
    check_contact,
    given,
    measurements_of,
    own_name,
    problem_of,
)
from vibrojax.identification.starts import (
    free_stop_amplitude,
    jump_up,
    restarts,
    spread_starts,
)
from vibrojax.identification.trial_rigs import Curve
from vibrojax.identification.uncertainty import influence, uncertainty
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.model.systems import AbstractSystem

FREQUENCY_SCALES = (0.005, 0.001)
"""First and last scale of frequency differences, over the first natural frequency."""
STAGES = ((0.0, 0.3), (0.5, 0.3), (1.0, 1e-3))
"""Stages of a search: how far between the two scales (in log), and when it ends (chi-square)."""
POOR = 2.0
"""Reduced chi-square above which other starts are tried."""
FARTHEST = 9.0
"""Farthest that a search goes from the guess in a coordinate: a factor of 8000 in log."""
APART = 3.0
"""Distance between alternatives, in standard deviations."""


@validated
def identify(
    make_system: Callable[..., AbstractSystem],
    measured: Any,
    guess: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    *,
    private: Sequence[str] = (),
    objective: str = "distance",
    search: LevenbergMarquardt | Optax | Search | None = None,
    transforms: Mapping[str, str] | None = None,
    starts: int = 1,
    frequency_scales: tuple[float, float] = FREQUENCY_SCALES,
    confidence: float = 0.95,
    **numbers: Any,
) -> Identification:
    """Find the numbers of a rig that explain what was measured, and how well they are known.

    Least squares on the distance of every measured point from the response curve of the rig, which
    is followed by continuation through its folds: frequency differences count over a scale,
    amplitudes over their standard deviations. So a point is compared with the branch it is on,
    whatever the sweep did, and a jump that came early biases nothing.

    Parameters:
        make_system: function from named numbers to a system.
        measured: `MeasuredCurve`, `MeasuredHistory`, several of either, or the path of a curve.
            Several are fitted at once; `parameters` of each are arguments that hold for it.
        guess: first values of the numbers to fit, by argument of the function.
        bounds: (low, high) for some of them.
        private: those that differ from measurement to measurement; the others are shared.
        objective: `distance` (above); for comparison `pointwise` (at equal frequencies, on the
            ends of the branch that a sweep follows) or `folds` (pointwise without the points next
            to the jumps, and the jumps on the folds). The last two are biased by an early jump.
        search: `LevenbergMarquardt()` (optimistix, the default) or `Optax(optimiser, steps)`.
        transforms: coordinate of some numbers: `log`, `asinh` or `linear`; by default asinh
            (bounded at 0) for names with "damping", log for what is positive, else linear.
        starts: how many starts to search from, the guess and others spread over the bounds or a
            decade each way; what they find is in `alternatives`.
        frequency_scales: first and last scale of frequency differences, as shares of the first
            natural frequency. The first is generous, so that a poor guess finds its way.
        confidence: of the intervals.
        numbers: arguments of the function that are held fixed.

    Raises `ValueError` for an argument the function does not take, a guess outside its bounds,
    fewer points than numbers, frequencies that do not overlap, or a curve that never touches the
    stop (where only the stop is to be fitted).
    """
    found = identify_each(
        make_system,
        [measurements_of(measured)],
        guess,
        bounds,
        private=private,
        objective=objective,
        search=search,
        transforms=transforms,
        starts=starts,
        frequency_scales=frequency_scales,
        confidence=confidence,
        **numbers,
    )
    return found[0]


@validated
def identify_each(
    make_system: Callable[..., AbstractSystem],
    repetitions: Sequence[Any],
    guess: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    *,
    private: Sequence[str] = (),
    objective: str = "distance",
    search: LevenbergMarquardt | Optax | Search | None = None,
    transforms: Mapping[str, str] | None = None,
    starts: int = 1,
    frequency_scales: tuple[float, float] = FREQUENCY_SCALES,
    confidence: float = 0.95,
    **numbers: Any,
) -> list[Identification]:
    """Fit many repetitions of one measurement at once, each by itself.

    As `identify`, with a list of what it takes as `measured`; all must have as many points. Their
    curves are followed together, which costs less than one after the other.

    Parameters:
        make_system, guess, bounds, private, numbers: as of `identify`, the same for all.
        objective, search, transforms, starts, frequency_scales, confidence: the same.
        repetitions: a list of what `identify` takes as `measured`.

    Raises `ValueError` as `identify` does, for no repetition, or for repetitions of different
    sizes.
    """
    check_count("starts", starts)
    check_range("confidence", confidence, 0.5, 0.9999, allowed="from 0.5 to 0.9999")
    first, last = frequency_scales
    check_range("frequency_scales", first, 1e-6, 0.1, allowed="from 1e-6 to 0.1")
    check_range("frequency_scales", last, 1e-6, 0.1, allowed="from 1e-6 to 0.1")
    data = [measurements_of(m, "repetitions") for m in repetitions]
    if not data:
        raise ValueError("repetitions must hold at least one measurement.")
    shapes = {tuple(m.size for m in parts) for parts in data}
    if len(shapes) > 1:
        raise ValueError(
            f"All repetitions must have the same numbers of points, got {sorted(shapes)}. Fit "
            "those of one size together."
        )
    asked = given(
        make_system, data[0], guess, bounds, private, transforms, objective, dict(numbers)
    )
    fits = _Fits(asked, data, search or LevenbergMarquardt(), frequency_scales)
    fits.run(starts)
    return [fits.result(k, confidence) for k in range(len(data))]


class _Fits:
    """Searches of several repetitions, side by side."""

    def __init__(
        self,
        asked: Given,
        data: list[tuple[Measurement, ...]],
        search: Search,
        frequency_scales: tuple[float, float],
    ):
        self.asked, self.data, self.search = asked, data, search
        self.first, self.last = frequency_scales
        self.problem = problem_of(asked, data)
        self.notes: list[list[str]] = [self._said(parts) for parts in data]
        self.ended: list[list[tuple[np.ndarray, float]]] = [[] for _ in data]
        self.evaluations = np.zeros(len(data), int)

    @staticmethod
    def _said(parts: tuple[Measurement, ...]) -> list[str]:
        said = [note for m in parts for note in m.notes]
        return said + [s for m in parts if (s := m.noise().sentence) is not None]

    @property
    def degrees_of_freedom(self) -> int:
        """Measured numbers less those fitted."""
        count = 0
        for part, m in zip(self.problem.parts, self.data[0], strict=True):
            channels = part.misfit.sensor.channels if isinstance(part.misfit, CurveMisfit) else 1
            count += m.size * channels if isinstance(m, MeasuredCurve) else part.misfit.size
        return max(count - len(self.problem.names), 1)

    def run(self, starts: int) -> None:
        """Search from the guess; where that ends badly, from elsewhere."""
        problem, count = self.problem, len(self.data)
        guess = problem.point(list(self.asked.guess.values()))
        check_contact(problem, guess, count)
        self._measure_damping(guess)
        guess = problem.point(list(self.asked.guess.values()))
        begin = np.array([self._begin(k, guess) for k in range(count)])
        points, which = [begin], [np.arange(count)]
        if starts > 1:
            others = spread_starts(guess, problem.coordinates, starts - 1)
            points.append(np.tile(others, (count, 1)))
            which.append(np.repeat(np.arange(count), len(others)))
        self._search(np.concatenate(points), np.concatenate(which))
        poor = [k for k in range(count) if self._reduced(k) > POOR]
        if poor:
            again = [restarts(begin[k], problem.coordinates) for k in poor]
            self._search(np.concatenate(again), np.repeat(poor, [len(a) for a in again]))

    def _reduced(self, k: int) -> float:
        return min(cost for _, cost in self.ended[k]) / self.degrees_of_freedom

    def _measure_damping(self, guess: np.ndarray) -> None:
        """Let what moves in asinh do so in units of what the data can see of it."""
        coordinates = list(self.problem.coordinates)
        if all(c.kind != "asinh" for c in coordinates):
            return
        _, jacobian = self.problem.evaluate(guess[None], np.array([0]), self.first)
        slope = np.array([c.slope(u) for c, u in zip(coordinates, guess, strict=True)])
        size = np.linalg.norm(jacobian[0], axis=0) / slope
        for k, c in enumerate(coordinates):
            if c.kind == "asinh" and size[k] > 0:
                coordinates[k] = c._replace(scale=float(1 / size[k]))
        self.problem.coordinates = tuple(coordinates)

    def _begin(self, k: int, guess: np.ndarray) -> np.ndarray:
        """Start of a repetition: the guess, with the gap from where the curve jumps up."""
        point = guess.copy()
        low, high = self.problem.limits
        for index, (part, m) in enumerate(zip(self.problem.parts, self.data[k], strict=True)):
            if not isinstance(m, MeasuredCurve) or not isinstance(part.misfit, CurveMisfit):
                continue
            jump = jump_up(m)
            gaps = [n for n in set(self.asked.arguments.values()) if n == "gap"]
            if not gaps or jump is None:
                continue
            at = self.problem.names.index(own_name(self.asked, gaps[0], m, index))
            numbers = self.problem.numbers(guess[None])[:, list(part.unknowns)]
            gap = free_stop_amplitude(part.misfit.lanes(numbers).paths, jump)
            point[at] = np.clip(self.problem.coordinates[at].inside(gap), low[at], high[at])
            self.notes[k].append(
                f"The search starts from a gap of {gap:.4g} m, the contact-free amplitude at the "
                f"stop where the curve jumps up ({jump:.5g})."
            )
        return point

    def _search(self, points: np.ndarray, which: np.ndarray) -> None:
        low, high = self.problem.limits
        middle = self.problem.point(list(self.asked.guess.values()))
        low, high = np.maximum(low, middle - FARTHEST), np.minimum(high, middle + FARTHEST)
        found = None
        for share, tolerance in STAGES:
            scale = self.first ** (1 - share) * self.last**share

            def evaluate(points, lanes, scale=scale):
                return self.problem.evaluate(points, which[lanes], scale)

            found = self.search(evaluate, points, low, high, tolerance)
            points = found.point
            np.add.at(self.evaluations, which, found.evaluations)
        assert found is not None
        for k, point, cost in zip(which, found.point, found.cost, strict=True):
            self.ended[k].append((point, float(cost)))

    def result(self, k: int, confidence: float) -> Identification:
        """Judge the best minimum of a repetition."""
        problem, freedom = self.problem, self.degrees_of_freedom
        ended = sorted(self.ended[k], key=lambda e: e[1])
        point = ended[0][0]
        residuals, jacobians = problem.evaluate(
            point[None], np.array([k]), self.last, precisely=True
        )
        residual, jacobian = residuals[0], jacobians[0]
        known = uncertainty(residual, jacobian, point, problem.coordinates, freedom, confidence)
        reduced = float(residual @ residual) / freedom
        names = problem.names
        predictions, warnings, weights = [], [], []
        numbers, start = problem.numbers(point[None]), 0
        for part, m in zip(problem.parts, self.data[k], strict=True):
            rows = slice(start, start + part.misfit.size)
            start = rows.stop
            own = residual[rows]
            if isinstance(part.misfit, CurveMisfit) and isinstance(m, MeasuredCurve):
                curve = part.misfit.curves(
                    part.misfit.lanes(numbers[:, list(part.unknowns)]).paths
                )[0]
                width = 1 + part.misfit.sensor.channels
                signed = _signed(own[: m.size * width].reshape(m.size, width))
                tolerance = max(4 * self.last, 1e-3)
                warnings += early_jumps(m, curve, part.misfit.unit, tolerance)
                predictions.append(_prediction(m, curve, signed))
                weights.append(
                    influence(own[: m.size * width], jacobian[rows][: m.size * width], width)
                )
                order = np.lexsort((m.frequency, m.direction))
                warnings += misfit(reduced, freedom, signed[order])
            else:
                predictions.append(Prediction(residual=own))
                weights.append(influence(own, jacobian[rows], 1))
                warnings += misfit(reduced, freedom, own)
        estimate = dict(zip(names, map(float, numbers[0]), strict=True))
        stiff = [n for n, a in self.asked.arguments.items() if "stiffness" in a]
        if stiff:
            first, m = names.index(stiff[0]), self.data[k][0]
            fitted = {
                a: estimate[own_name(self.asked, a, m, 0)] for a in self.asked.arguments.values()
            }
            rig = self.asked.make(**self.asked.numbers, **m.parameters, **fitted)
            warnings += modes_left_out(rig, float(known.deviation[first]))
        return Identification(
            estimate=estimate,
            interval={
                n: (float(a), float(b)) for n, (a, b) in zip(names, known.interval, strict=True)
            },
            identifiability=dict(zip(names, known.identifiability, strict=True)),
            identifiable=dict(zip(names, known.identifiable, strict=True)),
            standard_deviation=dict(zip(names, map(float, known.deviation), strict=True)),
            covariance=known.covariance,
            correlation=known.correlation,
            chi_square=float(residual @ residual),
            degrees_of_freedom=freedom,
            confidence=confidence,
            measured=self.data[k],
            predictions=tuple(predictions),
            influence=tuple(weights),
            alternatives=_alternatives(problem, ended, known.covariance, freedom),
            warnings=tuple(dict.fromkeys(warnings)),
            notes=tuple(dict.fromkeys(self.notes[k])),
            evaluations=int(self.evaluations[k]),
            asked=self.asked,
            problem=problem,
            repetition=k,
            frequency_scale=self.last,
            point=point,
        )


def _signed(residual: np.ndarray) -> np.ndarray:
    """Distances with the sign of the amplitude's part."""
    return np.sign(residual[:, 1]) * np.linalg.norm(residual, axis=1)


def _prediction(m: MeasuredCurve, curve: Curve, signed: np.ndarray) -> Prediction:
    return Prediction(
        residual=signed,
        frequency=curve.frequency,
        channels=curve.channels,
        unstable=curve.unstable,
        continues=curve.continues,
        folds={
            name: curve.frequency[curve.turning(way)]
            for name, way in (("forward", 1), ("backward", -1))
        },
    )


def _alternatives(
    problem: Problem, ended: list[tuple[np.ndarray, float]], covariance: np.ndarray, freedom: int
) -> tuple[Alternative, ...]:
    """Minima that other starts ended in, away from the best one and from each other."""
    deviation = np.sqrt(np.diag(np.where(np.isfinite(covariance), covariance, 1.0)))
    kept = [ended[0]]
    for point, cost in ended[1:]:
        if all(np.max(np.abs(point - other) / deviation) > APART for other, _ in kept):
            kept.append((point, cost))
    return tuple(
        Alternative(
            dict(zip(problem.names, map(float, problem.numbers(p[None])[0]), strict=True)),
            cost / freedom,
        )
        for p, cost in kept[1:]
    )
