"""Identification: the numbers of a rig that explain measured curves and histories."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, overload

import jax.numpy as jnp
import numpy as np

from vibrojax._tools.checks import check_count, check_range
from vibrojax._tools.signatures import validated
from vibrojax.branches.tracing import free_motion
from vibrojax.ensemble.ranges import Range
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.findings import early_jumps, misfit, modes_left_out, used
from vibrojax.identification.fit import Alternative
from vibrojax.identification.fitted_data import fitted_data
from vibrojax.identification.history_misfit import HistoryMisfit
from vibrojax.identification.identification import Identification
from vibrojax.identification.least_squares import LevenbergMarquardt, Optax, Search
from vibrojax.identification.problem import (
    Measurement,
    Problem,
    fitted_and_held,
    measurements_of,
    repetitions_of,
)
from vibrojax.identification.searching import restarts, spread_starts
from vibrojax.identification.trial_rigs import SAMPLES, driven
from vibrojax.identification.uncertainty import influence, uncertainty
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.jumps import Jump
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.batches import take
from vibrojax.steady.condensed import cell_average
from vibrojax.steady.paths import FrequencyPath

FREQUENCY_SCALES = (0.005, 0.001)
"""First and last scale of frequency differences, over the first natural frequency."""
STAGES = ((0.0, 0.3), (0.5, 0.3), (1.0, 1e-3))
"""Stages of a search: how far between the two scales (in log), and when it ends (chi-square)."""
POOR = 2.0
"""Reduced chi-square above which searches start elsewhere too."""
FARTHEST = 9.0
"""Farthest that a search goes from the guess in a coordinate: a factor of 8000 in log."""
MOST_HOPS, HOP = 4, 0.1
"""How often histories may begin another sample sooner or later, and what that has to gain."""
APART = 3.0
"""Distance between alternatives, in standard deviations."""


@overload
def identify(
    make_system: Callable[..., AbstractSystem],
    measured: Any,
    guess: Mapping[str, float | None],
    bounds: Mapping[str, Range] | None = None,
    *,
    together: Literal[True] = True,
    private: Sequence[str] = (),
    objective: str = "distance",
    search: LevenbergMarquardt | Optax | Search | None = None,
    transforms: Mapping[str, str] | None = None,
    searches: int = 1,
    frequency_scales: tuple[float, float] = FREQUENCY_SCALES,
    confidence: float = 0.95,
    **numbers: Any,
) -> Identification: ...


@overload
def identify(
    make_system: Callable[..., AbstractSystem],
    measured: Any,
    guess: Mapping[str, float | None],
    bounds: Mapping[str, Range] | None = None,
    *,
    together: Literal[False],
    private: Sequence[str] = (),
    objective: str = "distance",
    search: LevenbergMarquardt | Optax | Search | None = None,
    transforms: Mapping[str, str] | None = None,
    searches: int = 1,
    frequency_scales: tuple[float, float] = FREQUENCY_SCALES,
    confidence: float = 0.95,
    **numbers: Any,
) -> list[Identification]: ...


@validated
def identify(
    make_system: Callable[..., AbstractSystem],
    measured: Any,
    guess: Mapping[str, float | None],
    bounds: Mapping[str, Any] | None = None,
    *,
    together: bool = True,
    private: Sequence[str] = (),
    objective: str = "distance",
    search: LevenbergMarquardt | Optax | Search | None = None,
    transforms: Mapping[str, str] | None = None,
    searches: int = 1,
    frequency_scales: tuple[float, float] = FREQUENCY_SCALES,
    confidence: float = 0.95,
    **numbers: Any,
) -> Identification | list[Identification]:
    """Find the numbers of a rig that explain what was measured, and how well they are known.

    Least squares on the distance of every measured point from the response curve of the rig, which
    is followed by continuation through its folds: frequency differences count over a scale,
    amplitudes over their standard deviations. So a point is compared with the branch it is on,
    whatever the sweep did, and a jump that came early biases nothing. Unstable points, held by
    control or by their phase, are on theirs.

    Where a curve has a `drive_amplitude`, each of its points is compared at its own, in place of
    the rig's, and a `phase` is fitted too.

    Parameters:
        make_system: function from named numbers to a system.
        measured: `MeasuredCurve`, `MeasuredHistory`, several of either, or the path of a curve.
            Several are fitted at once; `parameters` of each are arguments that hold for it.
        guess: first values of the numbers to fit, by argument of the function. Of histories also
            numbers of the record itself: `initial_displacement`, `initial_velocity`, and of a
            channel its `gain`, `offset` and `delay`, as `contact_force_offset`; None: begin with
            what the history says, of a velocity else with its first one measured.
        bounds: `vj.Range(low, high)` for some of them.
        together: False to fit each element of the list `measured` by itself, all with the same
            settings, and return a list. All must have as many points; their curves are followed
            side by side, which costs less than one call after the other.
        private: those that differ from measurement to measurement; the others are shared.
        objective: `distance` (above); for comparison `pointwise` (at equal frequencies, on the
            ends of the branch that a sweep follows) or `folds` (pointwise without the points next
            to the jumps, and the jumps on the folds). The last two are biased by an early jump.
        search: `LevenbergMarquardt()` (optimistix, the default) or `Optax(optimiser, steps)`.
        transforms: coordinate of some numbers: `log`, `asinh` or `linear`; by default asinh
            (bounded at 0) for names with "damping", log for what is positive, else linear.
        searches: how many searches, from the guess and from places spread over the bounds or a
            decade each way; what they find is in `alternatives`.
        frequency_scales: first and last scale of frequency differences, as shares of the first
            natural frequency. The first is generous, so that a poor guess finds its way.
        confidence: of the intervals.
        numbers: arguments of the function that are held fixed.

    Raises `ValueError` for an argument the function does not take, a guess outside its bounds,
    fewer points than numbers, frequencies that do not overlap, a drive that is not the rig's kind
    or that a number to fit does nothing but set, or a curve that never touches the stop (where only
    the stop is to be fitted).
    """
    check_count("searches", searches)
    check_range("confidence", confidence, 0.5, 0.9999, allowed="from 0.5 to 0.9999")
    for scale in frequency_scales:
        check_range("frequency_scales", scale, 1e-6, 0.1, allowed="from 1e-6 to 0.1")
    data = [measurements_of(measured)] if together else repetitions_of(measured)
    coordinates, held = fitted_and_held(
        make_system, data[0], guess, bounds or {}, private, transforms or {}, numbers
    )
    problem = Problem(make_system, data, coordinates, objective, held)
    fits = _Fits(problem, data, search or LevenbergMarquardt(), frequency_scales)
    fits.run(searches)
    call = {"guess": dict(guess), "bounds": bounds, "private": tuple(private)}
    call |= {"objective": objective, "search": search, "transforms": transforms}
    call |= {"searches": searches, "frequency_scales": frequency_scales}
    call |= {"confidence": confidence, **numbers}
    found = [fits.result(k, call) for k in range(len(data))]
    return found[0] if together else found


class _Fits:
    """Searches of several repetitions, side by side."""

    def __init__(
        self,
        problem: Problem,
        data: list[tuple[Measurement, ...]],
        search: Search,
        frequency_scales: tuple[float, float],
    ):
        self.problem, self.data, self.search = problem, data, search
        self.first, self.last = frequency_scales
        self.notes: list[list[str]] = []
        for parts in data:
            assumed = [sentence for m in parts if (sentence := m.noise().sentence) is not None]
            taken = [one for m in parts if isinstance(m, MeasuredCurve) for one in used(m)]
            self.notes.append([note for m in parts for note in m.notes] + assumed + taken)
        self.ended: list[list[tuple[np.ndarray, float]]] = [[] for _ in data]
        self.evaluations = np.zeros(len(data), int)
        values = sum(m.values if isinstance(m, CurveMisfit) else m.size for m in problem.misfits)
        self.degrees_of_freedom = max(values - len(problem.coordinates), 1)

    def run(self, searches: int) -> None:
        """Search from the guess; where that ends badly, from elsewhere."""
        problem, count = self.problem, len(self.data)
        problem.check_contact(count)
        self._measure_damping()
        begin = np.array([self._begin(k) for k in range(count)])
        others = spread_starts(problem.guess, problem.coordinates, searches - 1)
        starts = np.concatenate([begin, np.tile(others, (count, 1))])
        which = np.concatenate([np.arange(count), np.repeat(np.arange(count), len(others))])
        self._search(starts, which)
        poor = [k for k in range(count) if self._best(k)[1] > POOR * self.degrees_of_freedom]
        if poor:
            again = [restarts(begin[k], problem.coordinates) for k in poor]
            self._search(np.concatenate(again), np.repeat(poor, [len(a) for a in again]))
        self._hop()

    def _hop(self) -> None:
        """Let motions of histories begin a sample sooner or later, as long as that is better."""
        models = [
            (k, model)
            for k, model in enumerate(self.problem.misfits)
            if isinstance(model, HistoryMisfit)
        ]
        for _ in range(MOST_HOPS if any(model.can_hop for _, model in models) else 0):
            points, which, held = [], [], []
            for k in range(len(self.data)):
                point, _ = self._best(k)
                self.problem.evaluate(point[None], np.array([k]), self.last)
                for m, model in models:
                    for limits in model.beside(k, model.shifts[0]):
                        points.append(point)
                        which.append(k)
                        held.append((m, limits))
            if not points:
                return
            before = [self._best(k)[1] for k in range(len(self.data))]
            self._search(np.array(points), np.array(which), STAGES[-1:], held)
            if all(self._best(k)[1] > b - HOP for k, b in enumerate(before)):
                return

    def _best(self, k: int) -> tuple[np.ndarray, float]:
        return min(self.ended[k], key=lambda end: end[1])

    def _measure_damping(self) -> None:
        """Let what moves in asinh do so in units of what the data can see of it."""
        problem = self.problem
        if all(c.kind != "asinh" for c in problem.coordinates):
            return
        guess = problem.guess[None]
        _, jacobian = problem.evaluate(guess, np.array([0]), self.first)
        size = np.linalg.norm(jacobian[0], axis=0) / problem.slopes(guess)[0]
        problem.coordinates = tuple(
            c._replace(scale=float(1 / s)) if c.kind == "asinh" and s > 0 else c
            for c, s in zip(problem.coordinates, size, strict=True)
        )

    def _begin(self, k: int) -> np.ndarray:
        """Start of a repetition: the guess, with the gap from where the curve jumps up."""
        problem, point = self.problem, self.problem.guess
        low, high = problem.limits
        for i, (part, m) in enumerate(zip(problem.misfits, self.data[k], strict=True)):
            at = problem.unknowns[i].get("gap")
            if at is None or not isinstance(m, MeasuredCurve) or not isinstance(part, CurveMisfit):
                continue
            jump = jump_up(m)
            if jump is None:
                continue
            paths = part.lanes(problem.of_measurement(i, problem.guess[None])).made
            if part.rig_drive is not None:
                paths = driven(paths, part.rig_drive[k, [jump.last]])
            place = (jump.before + jump.after) / 2
            gap = free_stop_amplitude(paths, place)
            point[at] = np.clip(problem.coordinates[at].inside(gap), low[at], high[at])
            self.notes[k].append(
                f"The search starts from a gap of {gap:.4g} m, the contact-free amplitude at the "
                f"stop where the curve jumps up ({place:.5g})."
            )
        return point

    def _search(
        self,
        points: np.ndarray,
        which: np.ndarray,
        stages: Sequence[tuple[float, float]] = STAGES,
        held: Sequence[tuple[int, tuple[float, float]]] = (),
    ) -> None:
        """Search from some points; `held`: a measurement and limits of its shift, by lane."""
        low, high = self.problem.limits
        middle, cost = self.problem.guess, np.zeros(0)
        low, high = np.maximum(low, middle - FARTHEST), np.minimum(high, middle + FARTHEST)
        shifts = {
            m: np.array([own if n == m else (-np.inf, np.inf) for n, own in held]) for m, _ in held
        }
        for share, tolerance in stages:
            scale = self.first ** (1 - share) * self.last**share

            def evaluate(points, lanes, scale=scale):
                own = {m: limits[lanes] for m, limits in shifts.items()}
                return self.problem.evaluate(points, which[lanes], scale, shifts=own)

            found = self.search(evaluate, points, low, high, tolerance)
            points, cost = found.point, found.cost
            np.add.at(self.evaluations, which, found.evaluations)
        for k, point, size in zip(which, points, cost, strict=True):
            self.ended[k].append((point, float(size)))

    def result(self, k: int, call: dict[str, Any]) -> Identification:
        """Judge the best minimum of a repetition; `call` is what `identify` was asked for."""
        confidence: float = call["confidence"]
        problem, freedom, names = self.problem, self.degrees_of_freedom, self.problem.names
        point, _ = self._best(k)
        (residual,), (jacobian,) = problem.evaluate(
            point[None], np.array([k]), self.last, precisely=True
        )
        known = uncertainty(residual, jacobian, point, problem.coordinates, freedom, confidence)
        chi_square = float(residual @ residual)
        ends = np.cumsum([m.size for m in problem.misfits])[:-1]
        own = zip(np.split(residual, ends), np.split(jacobian, ends), strict=True)
        predictions, warnings = [], []
        for i, (part, slopes) in enumerate(own):
            m, model, curve, width = self.data[k][i], problem.misfits[i], None, 1
            fitted = None
            if isinstance(model, CurveMisfit) and isinstance(m, MeasuredCurve):
                curve = model.curves(model.lanes(problem.of_measurement(i, point[None])).made)[0]
                width = 1 + model.sensor.channels
                part, slopes = part[: m.size * width], slopes[: m.size * width]
                fitted = model.fitted(part.reshape(-1, width), k, self.last)
                warnings += early_jumps(m, curve, model.unit, max(4 * self.last, 1e-3))
            moved = influence(part, slopes, width)
            if curve is not None:  # distances, with the sign of the amplitude's part
                part = part.reshape(-1, width)
                part = np.sign(part[:, 1]) * np.linalg.norm(part, axis=1)
            predictions.append(fitted_data(m, part, curve, moved, fitted))
            warnings += misfit(chi_square, freedom, part[_order(m)])
        numbers = problem.numbers(point)
        stiff = [i for i, c in enumerate(problem.coordinates) if "stiffness" in c.argument]
        if stiff:
            rig = problem.system(numbers, 0, self.data[k][0])
            warnings += modes_left_out(rig, float(known.deviation[stiff[0]]))

        def named(values: Any) -> dict[str, Any]:
            return dict(zip(names, values, strict=True))

        return Identification(
            estimate=named(map(float, numbers)),
            interval=named((float(a), float(b)) for a, b in known.interval),
            identifiability=named(known.identifiability),
            identifiable=named(known.identifiable),
            standard_deviation=named(map(float, known.deviation)),
            covariance=known.covariance,
            correlation=known.correlation,
            chi_square=chi_square,
            degrees_of_freedom=freedom,
            confidence=confidence,
            measured=self.data[k],
            predictions=tuple(predictions),
            alternatives=self._alternatives(k, known.covariance),
            warnings=tuple(dict.fromkeys(warnings)),
            notes=tuple(dict.fromkeys(self.notes[k])),
            evaluations=int(self.evaluations[k]),
            problem=problem,
            repetition=k,
            frequency_scale=self.last,
            point=point,
            call=call,
        )

    def _alternatives(self, k: int, covariance: np.ndarray) -> tuple[Alternative, ...]:
        """Minima that other searches ended in, away from the best one and from each other."""
        deviation = np.sqrt(np.diag(np.where(np.isfinite(covariance), covariance, 1.0)))
        kept: list[tuple[np.ndarray, float]] = []
        for point, cost in sorted(self.ended[k], key=lambda end: end[1]):
            if all(np.max(np.abs(point - other) / deviation) > APART for other, _ in kept):
                kept.append((point, cost))
        names = self.problem.names
        return tuple(
            Alternative(
                dict(zip(names, map(float, self.problem.numbers(point)), strict=True)),
                cost / self.degrees_of_freedom,
            )
            for point, cost in kept[1:]
        )


def _order(measured: Measurement) -> Any:
    """Order in which neighbours of a measurement follow each other."""
    if isinstance(measured, MeasuredCurve):
        return np.lexsort((measured.frequency, measured.direction))
    return slice(None)


def jump_up(measured: MeasuredCurve) -> Jump | None:
    """Where the amplitude jumps up, if it does."""
    ups = [j for j in measured.jumps() if j.change > 1]
    # Down from above resonance is where contact begins by a jump.
    ups.sort(key=lambda j: j.direction)
    return ups[0] if ups else None


def free_stop_amplitude(paths: FrequencyPath, frequency: float) -> float:
    """Largest amplitude (m) at a stop without contact: the gap, where the curve jumps up."""
    one = take(paths, np.array([0]))
    spectrum = np.asarray(free_motion(one, jnp.asarray([frequency]), SAMPLES, 1))
    average = cell_average(SAMPLES, spectrum.shape[-1])[1]
    return float(np.max(np.abs(spectrum[0, :, 1])) * 2 / SAMPLES / average)
