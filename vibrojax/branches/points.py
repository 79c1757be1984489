"""The points of a branch of periodic responses, as a continuation finds them."""

from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Complex, Float

from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.on_curve import OnCurve, Touch
from vibrojax.results.derived import AbstractRatios
from vibrojax.results.variables import RESPONSE, axis_description, axis_unit, described_as
from vibrojax.steady.paths import AbstractPath

if TYPE_CHECKING:
    import xarray

CURVES = (*RESPONSE, "leading_multiplier", "residual")
SPECIAL = ("folds", "period_doublings", "neimark_sackers", "grazings", "contact_changes")
TURNS = ("fold", "touch_fold")
"""Kinds of special points at which a branch turns round."""


class ExactCurve(NamedTuple):
    """Exact motions along a branch: where a search between them starts from."""

    search: CurveSearch
    motions: tuple[OnCurve, ...]
    touches: tuple[Touch, ...]
    specials: tuple[OnCurve, ...]
    """Motions of the special points, in their order."""


class SpecialPoint(eqx.Module):
    """A fold, period doubling, Neimark-Sacker point or touch, refined."""

    kind: str = eqx.field(static=True)
    """`fold`, `touch_fold` (the branch turns round in a corner, where a contact begins or ends),
    `period_doubling`, `neimark_sacker`, `grazing` (a stop is touched that was not touched before)
    or `contact_change` (another contact of a stop begins or ends)."""
    parameter: float
    """In the unit that was asked for."""
    amplitude_ratio: float
    """Half peak-to-peak displacement over drive amplitude."""
    contact_force: float
    """N."""
    initial_state: Float[np.ndarray, " states"] | None
    """(q, q') at drive phase 0; None where the motion is contact-free."""
    after: int
    """Index of the branch point before it."""
    refined: bool = True
    """Whether it was solved for; else it is the nearest motion that was found."""
    follows: str = eqx.field(static=True, default="")
    """What the system does where stability is lost, from next to the branch: `period 2`,
    `quasi-periodic`, `chaotic`, `another motion of period 1`, or `undecided`; of the first 32 such
    points of a branch, empty of others."""
    follows_at: float = np.nan
    """Where on the unstable side that was seen."""

    def __float__(self) -> float:
        return float(self.parameter)

    def __repr__(self) -> str:
        return (
            f"{self.kind.replace('_', ' ')} at {self.parameter:.8g} "
            f"(amplitude ratio {self.amplitude_ratio:.6g}{'' if self.refined else ', not refined'})"
            + (f", then {self.follows} at {self.follows_at:.6g}" if self.follows else "")
        )


class BranchPoints(AbstractRatios):
    """What a `Branch` holds, and all of it that needs no further solving."""

    axis: str = eqx.field(static=True)
    """The parameter: `frequency_ratio`, `frequency` (Hz) or a name of the user's function."""
    values: Float[np.ndarray, " points"]
    """The parameter along the branch."""
    arclength: Float[np.ndarray, " points"]
    """Way along the branch: change of the motion over its size, and of the parameter."""
    amplitude_ratio: Float[np.ndarray, " points"]
    """Half peak-to-peak displacement over drive amplitude."""
    peak_ratio: Float[np.ndarray, " points"]
    """Largest displacement, either side, over drive amplitude."""
    rms_ratio: Float[np.ndarray, " points"]
    """RMS displacement, the mean included, over drive amplitude."""
    first_harmonic_ratio: Float[np.ndarray, " points"]
    """Amplitude at the drive frequency over drive amplitude."""
    contact_force: Float[np.ndarray, " points"]
    """Largest contact force, N."""
    contact_fraction: Float[np.ndarray, " points"]
    """Share of the time in contact, 0 to 1."""
    contacts_per_period: Float[np.ndarray, " points"]
    """Contacts per drive period."""
    floquet_multipliers: Complex[np.ndarray, "points states"]
    """Eigenvalues of the Jacobian of the map over `period` drive periods."""
    residual: Float[np.ndarray, " points"]
    """Relative residual of the motion: of its exact equations, or of the balance on a grid four
    times finer."""
    initial_state: Float[np.ndarray, "points states"]
    """(q, q') at drive phase 0, m and m/s."""
    special_points: tuple[SpecialPoint, ...]
    """All special points, in order along the branch."""
    period: int = eqx.field(static=True)
    """Drive periods after which the motion repeats."""
    status: str = eqx.field(static=True)
    """How the branch ended: completed, stuck, turned_back, closed, joined or running."""
    sentence: str = eqx.field(static=True)
    """The status in words, and any fallback that was needed."""
    ticks: int = eqx.field(static=True)
    """Cost: motions solved for; of balanced branches the linearised balances."""
    exact: bool = eqx.field(static=True)
    """Whether points are exact solutions between contact times, or balanced."""
    exact_points: Bool[np.ndarray, " points"]
    """Which points are exact; the others are harmonic balance."""
    ratio_units: str = eqx.field(static=True)
    """Unit of the ratios: `1` for base motion, `m/N` for a force."""
    natural_frequency: float
    """First natural frequency of the unstopped system, Hz, where the branch starts."""
    labels: dict[str, float]
    """Value of every axis of the call that this branch belongs to."""
    range: tuple[float, float] = eqx.field(static=True)
    """The range that was followed."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, settings, versions."""
    path: AbstractPath
    """The system along the parameter, as one lane of a stack."""
    depth: Complex[np.ndarray, "points stops harmonics"] | None
    """Of balanced branches the spectra of the averaged depth at the stops, from where a search
    nearby starts."""
    curve: ExactCurve | None
    """The same of exact branches."""
    isolas: tuple["BranchPoints", ...] = ()
    """Branches that were found beside this one, where they were looked for."""

    @property
    def frequency_ratio(self) -> Float[np.ndarray, " points"]:
        """The parameter, when it is the frequency ratio."""
        return self._values_of("frequency_ratio")

    @property
    def frequency(self) -> Float[np.ndarray, " points"]:
        """The parameter, when it is the frequency in Hz."""
        return self._values_of("frequency")

    def _values_of(self, name: str) -> np.ndarray:
        if self.axis != name:
            raise AttributeError(f"This branch runs along {self.axis}: use .values.")
        return self.values

    @property
    def leading_multiplier(self) -> Float[np.ndarray, " points"]:
        """Largest modulus of the Floquet multipliers."""
        return np.max(np.abs(self.floquet_multipliers), axis=1)

    @property
    def stable(self) -> Bool[np.ndarray, " points"]:
        """Whether all Floquet multipliers lie inside the unit circle."""
        return self.leading_multiplier < 1.0

    @property
    def completed(self) -> bool:
        """Whether the branch reached the end of the range."""
        return self.status == "completed"

    def _special(self, kind: str) -> Float[np.ndarray, " special"]:
        return np.array([s.parameter for s in self._points(kind)], float)

    def _points(self, kind: str) -> list[SpecialPoint]:
        kinds = TURNS if kind == "fold" else (kind,)
        return [point for point in self.special_points if point.kind in kinds]

    @property
    def folds(self) -> Float[np.ndarray, " folds"]:
        """Where the branch turns round, in the unit that was asked for, along the branch.

        In a corner too (`touch_fold`), where a contact begins or ends.
        """
        return self._special("fold")

    @property
    def period_doublings(self) -> Float[np.ndarray, " period_doublings"]:
        """Where a multiplier passes -1."""
        return self._special("period_doubling")

    @property
    def neimark_sackers(self) -> Float[np.ndarray, " neimark_sackers"]:
        """Where a complex pair of multipliers crosses the unit circle."""
        return self._special("neimark_sacker")

    @property
    def grazings(self) -> Float[np.ndarray, " grazings"]:
        """Where the motion first touches a stop."""
        return self._special("grazing")

    @property
    def contact_changes(self) -> Float[np.ndarray, " contact_changes"]:
        """Where another contact of a stop that is touched begins or ends."""
        return self._special("contact_change")

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset along `point`, with units, long names and the rig in its attributes."""
        import xarray

        axis_units = axis_unit(self.axis)

        def described(name: str, dims: tuple[str, ...], values: Any) -> tuple[Any, ...]:
            return dims, np.asarray(values), described_as(name, self.ratio_units, axis_units)

        curves = (*CURVES, *self.derived)
        data: dict[str, Any] = {n: described(n, ("point",), getattr(self, n)) for n in curves}
        for name in ("exact_points", "stable"):
            data[name] = described(name, ("point",), getattr(self, name).astype(np.int8))
        for part, values in (
            ("real", np.real(self.floquet_multipliers)),
            ("imaginary", np.imag(self.floquet_multipliers)),
        ):
            name = f"floquet_multiplier_{part}"
            data[name] = described(name, ("point", "multiplier"), values)
        data["initial_state"] = described("initial_state", ("point", "state"), self.initial_state)
        for kind in SPECIAL:
            label, dim = kind.replace("_", " ").capitalize(), kind[:-1]
            own = self._points(dim)
            where = {"units": axis_units, "long_name": f"{label} of {self.axis}"}
            after = {"units": "1", "long_name": "Index of the point before it"}
            refined = {"units": "1", "long_name": "Whether it was solved for (1) or not (0)"}
            data[kind] = (dim, getattr(self, kind), where)
            data[f"{dim}_after"] = (dim, np.array([p.after for p in own], int), after)
            data[f"{dim}_refined"] = (dim, np.array([p.refined for p in own], np.int8), refined)
            if dim not in ("fold", "touch_fold"):
                follows = {"units": "1", "long_name": "What comes where stability is lost"}
                seen = {"units": axis_units, "long_name": f"{self.axis} where that was seen"}
                data[f"{dim}_follows"] = (dim, np.array([p.follows for p in own], str), follows)
                data[f"{dim}_follows_at"] = (dim, np.array([p.follows_at for p in own]), seen)
            for name in ("amplitude_ratio", "contact_force"):
                values = np.array([getattr(p, name) for p in own], float)
                data[f"{dim}_{name}"] = described(name, (dim,), values)
        coordinates: dict[str, Any] = {
            self.axis: ("point", self.values, axis_description(self.axis)),
            "arclength": described("arclength", ("point",), self.arclength),
        }
        coordinates |= {n: ((), v, axis_description(n)) for n, v in self.labels.items()}
        about = ("axis", "status", "sentence", "period", "ticks")
        attributes = {name: getattr(self, name) for name in about} | {"exact": int(self.exact)}
        return xarray.Dataset(data, coordinates, attrs=self.attributes | attributes)

    def __repr__(self) -> str:
        name, count = type(self).__name__, len(self.values)
        lines = [f"{name}(no points along {self.axis})"]
        if count:
            lines[0] = (
                f"{name}({count} points along {self.axis} {self.values.min():.6g} to "
                f"{self.values.max():.6g}, period {self.period})"
            )
        if self.labels:
            lines.append("  " + ", ".join(f"{k} = {v:g}" for k, v in self.labels.items()))
        if count:
            peak = int(np.argmax(self.amplitude_ratio))
            lines += [
                f"  peak amplitude ratio  {self.amplitude_ratio[peak]:.4f} at "
                f"{self.values[peak]:.6f}",
                f"  stable                {self.stable.sum()} of {count} points",
            ]
        shown = [point for point in self.special_points if point.kind != "contact_change"]
        lines += [f"  {point!r}" for point in shown[:8]]
        if len(shown) > 8:
            lines.append(f"  and {len(shown) - 8} special points more")
        if changes := len(self.special_points) - len(shown):
            lines.append(f"  contacts change         {changes} times more")
        for isola in self.isolas:
            low, high = isola.values.min(), isola.values.max()
            lines.append(
                f"  beside it               {len(isola.values)} points along {self.axis} "
                f"{low:.6g} to {high:.6g}, {isola.status}"
            )
        lines.append(f"  {self.sentence}")
        return "\n".join(lines)
