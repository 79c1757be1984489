"""How much a result depends on rounding, sampling, the number of modes and the stops' softness."""

import dataclasses
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np

from vibrojax._tools.checks import check_count, check_positive
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.branches.branch import Branch
from vibrojax.model.rigidity import StopSoftness, softness_of_stops, with_shorter_contacts
from vibrojax.model.stop_forces import contact_slope
from vibrojax.model.stops import Stop
from vibrojax.model.systems import AbstractSystem, held_stops, with_changed_stops
from vibrojax.results.variables import described_as
from vibrojax.steady.methods import HarmonicBalance
from vibrojax.steady.periodic_result import PeriodicResponse
from vibrojax.stepping.choice import is_exact

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

Study = Callable[[AbstractSystem, HarmonicBalance], Any]

GROWING = ("contact_force", "largest_contact_force")
"""Numbers that grow without bound with the stiffness of a stop."""


class Rigidity(eqx.Module):
    """How far a result is from that of rigid stops, which take the same share at every impact.

    It is found from a second result, of contacts half as long: what a stop's softness changes is in
    proportion to how long contacts last, to first order, so that as much is left as has changed.
    """

    within: float
    """Relative error asked for."""
    errors: dict[str, float]
    """Relative error of every number that has a limit; NaN for one that came or went."""
    stops: tuple[StopSoftness, ...]
    """Every stop: how long it is touched, and which law would be stiff enough."""

    @property
    def worst(self) -> float:
        """Largest relative error of all; NaN when a number came or went."""
        return float(np.max(list(self.errors.values()), initial=0.0))

    def __repr__(self) -> str:
        kept = "stiff enough" if self.worst <= self.within else "not stiff enough"
        lines = [f"rigid stops (relative error, {kept} for {self.within:.1e})"]
        lines += [f"  {name:24s}{error:.2e}" for name, error in self.errors.items()]
        lines += ["  " + repr(stop).replace("\n", "\n  ") for stop in self.stops]
        return "\n".join(lines)


class ResolutionCheck(eqx.Module):
    """How far every number of a result moved when it was repeated more finely."""

    values: dict[str, np.ndarray]
    """The result itself."""
    moved: dict[str, dict[str, np.ndarray]]
    """Largest absolute change of every number, by what was refined."""
    skipped: dict[str, str]
    """What was not varied, and why."""
    rigidity: Rigidity | None = None
    """How far the stops are from rigid ones, where that was asked for."""
    advice: str = ""
    """What is recommended, or nothing."""

    @property
    def relative(self) -> dict[str, dict[str, float]]:
        """Changes over the size of the numbers.

        0 for a number that is 0 in both, such as the force of a motion without contact; infinite
        for one that was 0 and is not any more; NaN for one that came or went, or is not finite.
        """
        return {
            what: {n: self._relative(n, float(change)) for n, change in numbers.items()}
            for what, numbers in self.moved.items()
        }

    def _relative(self, name: str, change: float) -> float:
        if change == 0.0 or np.isnan(change):
            return change
        size = float(np.max(np.abs(self.values[name])))
        return change / size if size > 0 else np.inf

    @property
    def worst(self) -> float:
        """Largest relative change of all; NaN when a number came or went, or is not finite."""
        changes = [c for numbers in self.relative.values() for c in numbers.values()]
        return float(np.max(changes)) if changes else 0.0

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset of the relative changes over `refinement` and `number`."""
        import xarray

        relative = self.relative
        names = list(dict.fromkeys(n for numbers in relative.values() for n in numbers))
        changes = [[numbers.get(n, np.nan) for n in names] for numbers in relative.values()]
        table = np.reshape(np.array(changes, float), (len(relative), len(names)))
        data: dict[str, Any] = {
            "relative_change": (("refinement", "number"), table, described_as("relative_change"))
        }
        if self.rigidity is not None:
            errors = [self.rigidity.errors.get(name, np.nan) for name in names]
            data["rigid_error"] = ("number", np.array(errors), described_as("rigid_error"))
        coordinates = {
            "refinement": ("refinement", list(relative), {"long_name": "What was refined"}),
            "number": ("number", names, {"long_name": "Number of the result"}),
        }
        return xarray.Dataset(data, coordinates, attrs={"title": "vibrojax resolution check"})

    def plot(self) -> "Figure":
        """Draw the relative change of every number, by what was refined.

        Raises `ValueError` when nothing was varied.
        """
        if not self.moved:
            raise ValueError("Nothing was varied: there is nothing to draw.")
        from vibrojax.plot.resolution import plot_resolution

        return plot_resolution(self.to_xarray())

    def __repr__(self) -> str:
        lines = ["ResolutionCheck (relative change)"]
        for what, numbers in self.relative.items():
            lines.append(f"  {what}")
            lines += [f"    {n:24s}{self._sentence(what, n, c)}" for n, c in numbers.items()]
        lines += [f"  {what}: not varied, {why}" for what, why in self.skipped.items()]
        if self.rigidity is not None:
            lines.append("  " + repr(self.rigidity).replace("\n", "\n  "))
        return "\n".join(lines + [f"  {self.advice}"] * bool(self.advice))

    def _sentence(self, what: str, name: str, change: float) -> str:
        if np.isinf(change):
            return f"from 0 to {float(self.moved[what][name]):.2e}"
        if np.isnan(change):
            return "nan (it came or went, or is not finite)"
        stays = change == 0.0 and not np.any(self.values[name])
        return "0 (it is 0 in both)" if stays else f"{change:.2e}"


@validated
def check_resolution(
    study: Study, system: AbstractSystem, *, samples: int = 256, rigid_within: float | None = None
) -> ResolutionCheck:
    """Repeat a result at half the rounding, twice the samples and one more mode.

    Stops that stand for rigid ones, by their coefficient of restitution, have to be stiff enough:
    with `rigid_within` the result is repeated with contacts half as long, too.

    Parameters:
        study: `study(system, method)` makes the result: a `PeriodicResponse`, a `Branch`, or a
            dictionary of numbers or arrays of equal shape in every repetition. `method` is a
            `HarmonicBalance` to pass on; a study by other means may leave it.
        system: the system of the result.
        samples: samples per drive period of the result that the others are compared with.
        rigid_within: relative error against rigid stops to aim at; None: stops are what they are.

    Returns how far every number moved, and in its `rigidity` how far the stops are from rigid ones
    and which laws would reach the error asked for. What a system does not have (rounding, a number
    of modes) is not varied, and said. Where the modes left out give way by more than a hundredth
    of what a stop does, `static_correction=True` is recommended. Raises `ValueError` when the study
    returns nothing comparable.

    For example `vj.check_resolution(lambda s, m: vj.periodic_response(s, frequency_ratio=1.1,
    method=m), rig)`.
    """
    check_count("samples", samples, least=16)
    if rigid_within is not None:
        check_positive("rigid_within", rigid_within, "(relative error)")
    try:
        inspect.signature(study).bind(system, None)
    except (TypeError, ValueError):
        raise ValueError(
            f"study must be a function of a system and a method, got {in_short(study)}."
        ) from None
    method, finer = HarmonicBalance(samples=samples), HarmonicBalance(samples=2 * samples)
    result = study(system, method)
    base = _numbers(result)
    varied = {
        "twice the samples": (system, finer, ""),
        "half the rounding": (
            _half_rounded(system),
            method,
            "the corner of the force is exact, there is none",
        ),
        "one more mode": (
            _with_one_mode_more(system),
            method,
            "the system keeps all its modes, or has no number of them",
        ),
    }
    moved, skipped = {}, {}
    for what, (other, how, why) in varied.items():
        if other is None:
            skipped[what] = why
        else:
            moved[what] = _moved(base, _numbers(study(other, how)))
    advice = _advice(system)
    check = ResolutionCheck(values=base, moved=moved, skipped=skipped, advice=advice)
    if rigid_within is None:
        return check
    shorter = with_shorter_contacts(system, 2.0)
    if shorter is None:
        why = "no stop, or a law that does not say how (with_shorter_contacts)"
        return dataclasses.replace(check, skipped=skipped | {"half the length of contacts": why})
    change = {"": _moved(base, _numbers(study(shorter, method)))}
    relative = dataclasses.replace(check, moved=change).relative[""]
    errors = {name: 2 * value for name, value in relative.items() if name not in GROWING}
    known = bool(np.isfinite(list(errors.values())).all())
    factor = max(1.0, max(errors.values(), default=0.0) / rigid_within) if known else None
    stops = softness_of_stops(system, factor, _drive_period(result))
    return dataclasses.replace(check, rigidity=Rigidity(rigid_within, errors, stops))


def _drive_period(result: Any) -> float | None:
    """Period of the drive, s, where the result is at one frequency."""
    return 1 / float(result.frequency) if isinstance(result, PeriodicResponse) else None


def _advice(system: AbstractSystem) -> str:
    """Recommend the static correction where the modes left out are soft beside a stop."""
    left_out = system.flexibility_left_out()
    if not left_out:
        return ""
    stops = system.equations().stops
    share = max(
        float(contact_slope(s)) * missing for s, missing in zip(stops, left_out, strict=True)
    )
    if share < 0.01:
        return ""
    return (
        f"The modes left out are a spring in series with a stop, with {share:.2g} of its own "
        "flexibility, that the system lacks: give it static_correction=True."
    )


def _half_rounded(system: AbstractSystem) -> AbstractSystem | None:
    if not held_stops(system) or is_exact(system):
        return None

    def halved(stop: Stop) -> Stop:
        return dataclasses.replace(stop, smoothing=stop.width / 2)

    return with_changed_stops(system, halved)


def _with_one_mode_more(system: AbstractSystem) -> AbstractSystem | None:
    count = getattr(system, "num_modes", None)
    try:
        return None if count is None else dataclasses.replace(system, num_modes=count + 1)  # pyright: ignore
    except ValueError:
        return None


NUMBERS = ("amplitude_ratio", "peak_ratio", "rms_ratio", "contact_force", "leading_multiplier")


def _numbers(result: Any) -> dict[str, np.ndarray]:
    """Take the numbers out of a result."""
    if isinstance(result, PeriodicResponse):
        return {n: np.asarray(getattr(result, n)) for n in NUMBERS}
    if isinstance(result, Branch):
        at = int(np.argmax(result.amplitude_ratio)) if len(result.values) else 0
        numbers = {"peak_amplitude_ratio": result.amplitude_ratio[at]}
        for kind in ("folds", "period_doublings", "grazings"):
            for k, value in enumerate(getattr(result, kind)):
                numbers[f"{kind[:-1]}_{k + 1}"] = np.asarray(value)
        return numbers
    if isinstance(result, dict) and result:
        return {n: np.asarray(jax.device_get(v), float) for n, v in result.items()}
    raise ValueError(
        "study must return a PeriodicResponse, a Branch or a dictionary of numbers, got "
        f"{result!r}."
    )


def _moved(base: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Largest change of every number; NaN where the two differ in shape or are not finite."""

    def change(name: str) -> np.ndarray:
        one, two = (np.asarray(of.get(name, np.nan)) for of in (base, other))
        if one.shape != two.shape or not (np.isfinite(one).all() and np.isfinite(two).all()):
            return np.asarray(np.nan)
        return np.asarray(np.max(np.abs(two - one), initial=0.0))

    return {name: change(name) for name in base | other}
