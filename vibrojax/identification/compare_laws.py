"""Which contact law explains force records: each is fitted, and foretells records left out."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax._tools.signatures import validated
from vibrojax.identification.identification import Identification
from vibrojax.identification.identify import identify
from vibrojax.identification.law_candidates import Candidate, candidates_of, impact_of
from vibrojax.identification.law_comparison import Judged, LawComparison
from vibrojax.identification.problem import Problem, fitted_and_held
from vibrojax.identification.record_numbers import record_numbers_in, with_numbers
from vibrojax.measured.history import MeasuredHistory
from vibrojax.model.systems import AbstractSystem


class _WithLaw:
    """The function of the rig, with the numbers of a law in the place of the law."""

    def __init__(self, make_system: Callable[..., AbstractSystem], law: Candidate, name: str):
        own = inspect.signature(make_system)
        kept = [p for p in own.parameters.values() if p.name != "law"]
        clash = [p.name for p in kept if p.name in law.guess]
        if clash:
            raise ValueError(
                f"laws: {name} has a number {clash[0]!r}, and so has the function of the rig. "
                "Rename one of them."
            )
        numbers = [inspect.Parameter(n, inspect.Parameter.KEYWORD_ONLY) for n in law.guess]
        rest = [p for p in kept if p.kind is p.VAR_KEYWORD]
        kept = [p for p in kept if p not in rest]
        self.__signature__ = own.replace(
            parameters=[*(p.replace(kind=p.KEYWORD_ONLY) for p in kept), *numbers, *rest]
        )
        self.make_system, self.law = make_system, law

    def __call__(self, **numbers: Any) -> AbstractSystem:
        own = {name: numbers.pop(name) for name in self.law.guess}
        return self.make_system(law=self.law.make(**own), **numbers)


@validated
def compare_laws(
    make_system: Callable[..., AbstractSystem],
    measured: Any,
    guess: Mapping[str, float | None] | None = None,
    laws: Any = None,
    bounds: Mapping[str, Any] | None = None,
    *,
    private: Sequence[str] = (),
    confidence: float = 0.95,
    **numbers: Any,
) -> LawComparison:
    """Say which contact law explains records of a contact force, and how well.

        def cart(law, mass):
            return vj.model.Oscillator(mass, stops=(vj.Stop(None, 0.0, law),))

        vj.compare_laws(cart, runs, dict(initial_velocity=None), private=["initial_velocity"],
                        mass=0.58)

    Each law is fitted to all records together (`identify`). Two kinds of judgement follow:
    information criteria, which weigh the misfit against the number of numbers, and, of several
    records, how well a law fitted to the others foretells the one left out, of which only its
    private numbers are fitted. Where no law explains the records, that is the first warning.

    Criteria are of chi-square over the least reduced chi-square of all laws, where that is above 1
    (quasi-likelihood), so that misfits which all laws share do not count as evidence. Source:
    Burnham and Anderson, Model Selection and Multimodel Inference (2002), secs. 2.2, 2.4 and 2.5.

    Parameters:
        make_system: function from `law` and named numbers to a system.
        measured: `MeasuredHistory` with a contact force, or several.
        guess: first values of numbers that are not of the law, as of `identify`.
        laws: names of some of `kelvin_voigt`, `no_tension` (Kelvin-Voigt that cannot pull),
            `hunt_crossley`, `hertz` and `standard_linear_solid`, all of which are compared where
            nothing is given; or a dict from any name to a function that makes a law and first
            values of its arguments, `(function, dict(stiffness=100.0))`, or to None for one of
            those known.
        bounds: `vj.Range(low, high)` for some of the numbers in `guess` or of laws; those that
            have the number keep to it.
        private: numbers that differ from record to record, as of `identify`; of laws also.
        confidence: of the intervals.
        numbers: arguments of the function that are held fixed.

    Raises `ValueError` for a function that takes no law, measurements that are no histories with a
    contact force, laws that are none or fewer than two, and as `identify`.
    """
    histories = _histories(measured)
    if "law" not in inspect.signature(make_system).parameters:
        raise ValueError(
            "make_system must take an argument `law`, the contact law that is tried, as in def "
            "rig(law, mass): ..."
        )
    candidates = candidates_of(laws, impact_of(histories))
    rest = dict(guess or {})
    _check_fitted(candidates.values(), rest, bounds or {}, private)
    makers = {name: _WithLaw(make_system, law, name) for name, law in candidates.items()}
    judged = {}
    for name, make in makers.items():
        first = {**make.law.guess, **rest}
        settings: dict[str, Any] = {
            "bounds": {n: one for n, one in (bounds or {}).items() if n in first},
            "private": [n for n in private if n in first],
        }
        fit = identify(make, histories, first, confidence=confidence, **settings, **numbers)
        first |= {n: v for n, v in fit.estimate.items() if n in first}
        foretold = []
        for k, record in enumerate(histories if len(histories) > 1 else ()):
            others = [*histories[:k], *histories[k + 1 :]]
            part = identify(make, others, first, **settings, **numbers)
            foretold.append(_foretold(make, part, record, first, **settings, numbers=numbers))
        judged[name] = Judged(fit, tuple(foretold))
    return LawComparison(judged)


def _check_fitted(
    laws: Iterable[Candidate],
    guess: Mapping[str, Any],
    bounds: Mapping[str, Any],
    private: Sequence[str],
) -> None:
    """Refuse bounds of numbers, and private ones, that are fitted with none of the laws."""
    fitted = {*guess, *(name for law in laws for name in law.guess)}
    for where, names in (("bounds", bounds), ("private", private)):
        for name in names:
            if name not in fitted:
                raise ValueError(
                    f"{where} of {name!r}: it is neither in guess nor a number of one of the laws, "
                    f"so it is not fitted. {nearest(name, sorted(fitted))}"
                )


def _histories(measured: Any) -> list[MeasuredHistory]:
    several = [measured] if isinstance(measured, MeasuredHistory) else measured
    good = isinstance(several, Sequence) and len(several) > 0
    if not good or not all(isinstance(one, MeasuredHistory) for one in several):
        raise ValueError(
            f"measured must be a MeasuredHistory with a contact_force, or a list of them, got "
            f"{type(measured).__name__}."
        )
    return list(several)


def _foretold(
    make: Callable[..., AbstractSystem],
    fit: Identification,
    record: MeasuredHistory,
    guess: Mapping[str, float | None],
    bounds: Mapping[str, Any],
    private: Sequence[str],
    numbers: Mapping[str, Any],
) -> float:
    """Mean square of the residuals, in deviations, of a record that the fit has not seen."""
    known = inspect.signature(make).parameters
    shared: dict[str, Any] = {n: v for n, v in fit.estimate.items() if n in known}
    of_record = record_numbers_in(make, fit.estimate)
    record = with_numbers(record, {name: fit.estimate[name] for name in of_record})
    count = len(record.observations().value)
    if private:
        first = {name: guess[name] for name in private}
        own_bounds = {name: one for name, one in bounds.items() if name in first}
        return identify(make, record, first, own_bounds, **numbers, **shared).chi_square / count
    coordinates, held = fitted_and_held(make, (record,), shared, {}, (), {}, numbers)
    problem = Problem(make, [(record,)], coordinates, "distance", held)
    residual, _ = problem.evaluate(problem.guess[None], np.zeros(1, int), 1.0, precisely=True)
    return float(np.mean(residual**2))
