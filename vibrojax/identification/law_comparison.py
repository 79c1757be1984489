"""What comparing contact laws found: criteria, records foretold, and which law is best."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from vibrojax._tools.signatures import validated
from vibrojax.identification.findings import UNLIKELY
from vibrojax.identification.identification import Identification
from vibrojax.results.saving import save_dataset

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

AS_GOOD = 2.0
"""Difference of Akaike's criterion within which data do not distinguish laws (Burnham and
Anderson 2002, sec. 2.6)."""


class Judged(NamedTuple):
    """A law fitted to all records, and what it foretells of each one left out."""

    fit: Identification
    foretold: tuple[float, ...]
    """Mean square of the residuals (in deviations) of every record that was left out."""


@dataclass(frozen=True, repr=False)
class LawComparison:
    """Contact laws beside each other; made by `compare_laws`."""

    judged: Mapping[str, Judged]
    """Every law by name, fitted to all records, and what it foretold of each one left out."""

    @property
    def fits(self) -> dict[str, Identification]:
        """Estimates, intervals, pictures and warnings of every law, fitted to all records."""
        return {name: one.fit for name, one in self.judged.items()}

    @property
    def _inflation(self) -> float:
        """Least reduced chi-square of all laws, at least 1."""
        return max(1.0, min(fit.reduced_chi_square for fit in self.fits.values()))

    def _criterion(self, weight: float | None) -> Float[np.ndarray, " laws"]:
        found = []
        for fit in self.fits.values():
            count, numbers = fit.degrees_of_freedom + len(fit.names), len(fit.names)
            each = np.log(count) if weight is None else weight
            found.append(fit.chi_square / self._inflation + each * numbers)
        return np.array(found) - np.min(found)

    @property
    def best(self) -> str:
        """The law that foretells records left out best; of one record, of the least criterion."""
        return self._order[0]

    @property
    def _order(self) -> list[str]:
        """The laws, the best first."""
        data = self.to_xarray()
        by = data["foretold"].mean("record") if "foretold" in data else data["akaike"]
        return [str(name) for name in data["law"].values[np.argsort(by.values, kind="stable")]]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know: no law explains the records, or several do equally well."""
        found, best = [], self.best
        fit = self.fits[best]
        if scipy.stats.chi2.sf(fit.chi_square, fit.degrees_of_freedom) < UNLIKELY:
            found.append(
                f"None of the laws explains the records: with the best, {best}, the reduced "
                f"chi-square is {fit.reduced_chi_square:.3g}. Its numbers describe the records no "
                "better than that, whatever their intervals; something else happens (a pad that "
                "bottoms out, a body that bends, a sensor that is not as it is said to be)."
            )
        akaike = dict(zip(self.fits, self._criterion(2.0), strict=True))
        alike = [n for n, v in akaike.items() if n != best and v < akaike[best] + AS_GOOD]
        if alike:
            found.append(
                f"By their criteria the records do not distinguish {best} from {', '.join(alike)}."
            )
        return tuple(found)

    def to_xarray(self) -> "xarray.Dataset":
        """Return the criteria over `law`, and over `record` what was foretold of it."""
        import xarray

        fits = self.fits
        count = [fit.degrees_of_freedom + len(fit.names) for fit in fits.values()]
        akaike = self._criterion(2.0)
        likely = np.exp(-akaike / 2)
        described_values = {
            "chi_square": ([f.chi_square for f in fits.values()], "Chi-square"),
            "numbers": ([len(f.names) for f in fits.values()], "How many numbers were fitted"),
            "observations": (count, "How many samples there are"),
            "akaike": (akaike, "Akaike's criterion above its least"),
            "bayes": (self._criterion(None), "Bayesian criterion above its least"),
            "weight": (likely / likely.sum(), "Akaike weight"),
        }
        data: dict[str, Any] = {
            name: ("law", np.asarray(values, float), {"long_name": long_name, "units": "1"})
            for name, (values, long_name) in described_values.items()
        }
        coordinates: dict[str, Any] = {"law": list(fits)}
        foretold = np.array([one.foretold for one in self.judged.values()])
        if foretold.size:
            about = {
                "long_name": "Mean square of the residuals of a record left out",
                "units": "1",
            }
            data["foretold"] = ("law", "record"), foretold, about
            first = next(iter(fits.values()))
            labels = [m.label or str(k + 1) for k, m in enumerate(first.measured)]
            coordinates["record"] = labels
        return xarray.Dataset(data, coordinates)

    def plot(self) -> "Figure":
        """Draw the force of every record with each law fitted to it, and how the laws compare."""
        from vibrojax.plot.laws import plot_laws

        return plot_laws(self.to_xarray(), {n: f.predictions for n, f in self.fits.items()})

    @validated
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the criteria to a NetCDF file, whole or not at all.

        `path` is that of the file, such as `laws.nc`; what is there is replaced. Raises
        `ValueError` for a path that cannot be a file's, `OSError` where writing fails.
        """
        save_dataset(self.to_xarray(), path)

    def __repr__(self) -> str:
        data = self.to_xarray()
        best, left_out = self.best, "foretold" in data
        lines = [f"LawComparison({len(self.fits)} laws; best: {best})"]
        head = f"  {'law':<24}{'reduced chi-square':>20}{'Akaike':>9}{'Bayes':>9}"
        lines.append(head + f"{'left out':>10}" * left_out)
        for name in self._order:
            row, fit = data.sel(law=name), self.fits[name]
            line = f"  {name:<24}{fit.reduced_chi_square:>20.3g}"
            line += f"{row['akaike'].item():>9.3g}{row['bayes'].item():>9.3g}"
            lines.append(line + (f"{row['foretold'].mean().item():>10.3g}" if left_out else ""))
        for name in self.fits[best].names:
            low, high = self.fits[best].interval[name]
            value = self.fits[best].estimate[name]
            lines.append(f"  {best}: {name} = {value:.4g}, from {low:.4g} to {high:.4g}")
        return "\n".join([*lines, *(f"  warning: {text}" for text in self.warnings)])
