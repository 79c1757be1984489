"""Identification: the numbers of a rig that explain measured curves and histories."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, overload

import jax.numpy as jnp
import numpy as np

from vibrojax._tools.checks import check_count, check_range
from vibrojax._tools.signatures import validated
from vibrojax.branches.tracing import free_motion
from vibrojax.ensemble.ranges import Range
from vibrojax.identification.coordinates import estimate_at
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.findings import early_jumps, misfit, modes_left_out, used
from vibrojax.identification.fit import Alternative
from vibrojax.identification.fitted_data import fitted_data
from vibrojax.identification.identification import Identification
from vibrojax.identification.least_squares import LevenbergMarquardt, Optax, Search
from vibrojax.identification.problem import (
    Measurement,
    Problem,
    fitted_and_held,
    measurements_of,
    repetitions_of,
)
from vibrojax.identification.searching import Searches
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
            settings, and return a list. All must have as many points. Those that the end of the
            first explains begin there, which costs less than one call after the other.
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
        self.problem, self.data, self.last = problem, data, frequency_scales[1]
        self.notes: list[list[str]] = []
        for parts in data:
            assumed = [sentence for m in parts if (sentence := m.noise().sentence) is not None]
            taken = [one for m in parts if isinstance(m, MeasuredCurve) for one in used(m)]
            self.notes.append([note for m in parts for note in m.notes] + assumed + taken)
        values = sum(m.values if isinstance(m, CurveMisfit) else m.size for m in problem.misfits)
        self.degrees_of_freedom = max(values - len(problem.coordinates), 1)
        self.searches = Searches(
            problem, search, frequency_scales, self.degrees_of_freedom, len(data)
        )

    def run(self, searches: int) -> None:
        """Search from the guess; where that ends badly, from elsewhere."""
        self.problem.check_contact(len(self.data))
        trail = self.searches.measure_damping()
        begin = np.array([self._begin(k) for k in range(len(self.data))])
        self.searches.run(begin, searches, trail)

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

    def result(self, k: int, call: dict[str, Any]) -> Identification:
        """Judge the best minimum of a repetition; `call` is what `identify` was asked for."""
        confidence: float = call["confidence"]
        problem, freedom, names = self.problem, self.degrees_of_freedom, self.problem.names
        point, residual, jacobian, curves = self.searches.best(k)
        known = uncertainty(residual, jacobian, point, problem.coordinates, freedom, confidence)
        chi_square = float(residual @ residual)
        ends = np.cumsum([m.size for m in problem.misfits])[:-1]
        own = zip(np.split(residual, ends), np.split(jacobian, ends), strict=True)
        predictions, warnings = [], []
        for i, (part, slopes) in enumerate(own):
            m, model, curve, width = self.data[k][i], problem.misfits[i], None, 1
            fitted = None
            if isinstance(model, CurveMisfit) and isinstance(m, MeasuredCurve):
                curve = curves.get(i)
                if curve is None:
                    lanes = model.lanes(problem.of_measurement(i, point[None]))
                    curve = model.curves(lanes.made)[0]
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
        estimate = estimate_at(problem.coordinates, point)
        stiff = [i for i, c in enumerate(problem.coordinates) if "stiffness" in c.argument]
        if stiff:
            rig = problem.system([*estimate.values()], 0, self.data[k][0])
            warnings += modes_left_out(rig, float(known.deviation[stiff[0]]))

        def named(values: Any) -> dict[str, Any]:
            return dict(zip(names, values, strict=True))

        return Identification(
            estimate=estimate,
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
            evaluations=int(self.searches.evaluations[k]),
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
        for end in sorted(self.searches.ended[k], key=lambda end: end.cost):
            if all(np.max(np.abs(end.point - other) / deviation) > APART for other, _ in kept):
                kept.append((end.point, end.cost))
        return tuple(
            Alternative(
                estimate_at(self.problem.coordinates, point), cost / self.degrees_of_freedom
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
