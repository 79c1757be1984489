"""The answer of an identification: estimates, what is known of them, and how they fit."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_index
from vibrojax._tools.described import recipe
from vibrojax._tools.files import path_of
from vibrojax._tools.signatures import validated
from vibrojax.branches.branch import Branch
from vibrojax.branches.continue_response import continue_response
from vibrojax.ensemble.ranges import Range
from vibrojax.identification.fit import Fit
from vibrojax.identification.posterior import Posterior, sample
from vibrojax.identification.profile import Profile, profile
from vibrojax.identification.what_next import WhatNext, what_next
from vibrojax.results.saving import whole_files
from vibrojax.results.variables import named_value

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Identification(Fit):
    """What `identify` found. Dictionaries are by name of the number that was fitted."""

    @validated
    def branch(self, measurement: int = 0) -> Branch:
        """Follow the fitted curve by `continue_response`: exact, with its stability.

        It is that at the drive of the rig's function, also where another was measured.
        `measurement` counts from 0, in the order given. Raises `ValueError` when there is none, or
        it is a history, which has no curve.
        """
        check_index("measurement", measurement, len(self.measured))
        measured: Any = self.measured[measurement]
        if not hasattr(measured, "frequency_name"):
            raise ValueError(f"measurement must be that of a curve, got {measurement}: a history.")
        frequency = measured.frequency
        over = Range(0.98 * float(frequency.min()), 1.02 * float(frequency.max()))
        along: Any = {measured.frequency_name: over}
        branch: Any = continue_response(self.system(measurement), **along)
        return branch

    @validated
    def profile(self, name: str, *, points: int = 9, reach: float = 2.5) -> Profile:
        """Profile likelihood of one number: fixed at values around its estimate, others refitted.

        `points` values over `reach` standard deviations each way. Raises `ValueError` for a name
        that was not fitted, fewer than 5 points, or a reach not above 0.
        """
        return profile(self, name, points=points, reach=reach)

    @validated
    def sample(self, draws: int = 1000, *, seed: int = 0) -> Posterior:
        """Sample the posterior with blackjax: 256 evaluations, independent proposals.

        The prior is uniform in the logarithm of what moves in log, else in the number.

        Raises `ImportError` without blackjax, which is optional: `pip install "vibrojax[sample]"`.

        `draws` is the number of draws returned, `seed` that of the random numbers.
        """
        return sample(self, draws, seed=seed)

    @validated
    def what_next(self, name: str, **changes: ArrayLike | Sequence[float]) -> WhatNext:
        """Say which further points would sharpen one number most.

        `changes` are other rigs that could be measured: arguments of the function with lists of
        values, as gap=[0.3e-3, 0.5e-3]. Raises `ValueError` for a name that was not fitted.
        """
        return what_next(self, name, **changes)

    @validated
    def plot(self, measurement: int = 0) -> "Figure":
        """Draw the fitted curve over the measured points, the residuals and the estimates.

        `measurement` counts from 0, in the order given. Raises `ValueError` when there is none.
        """
        check_index("measurement", measurement, len(self.measured))
        measured, count = self.measured[measurement], len(self.measured)
        title = [f"measurement {measurement + 1} of {count}"] if count > 1 else []
        title += [measured.label] if measured.label else []
        title += [named_value(name, value) for name, value in measured.parameters.items()]
        from vibrojax.plot.identification import plot_identification

        return plot_identification(
            self.predictions[measurement], self._estimates(), ", ".join(title)
        )

    def to_xarray(self) -> "xarray.Dataset":
        """Return estimates over `parameter`, and points and curve of every curve measured."""
        dataset = self._estimates()
        for k, own in enumerate(self.predictions):
            end = "" if len(self.measured) == 1 else f"_{k}"
            names = {*own.data_vars, *own.dims} - {"parameter"}
            dataset = dataset.merge(own.rename({n: f"{n}{end}" for n in names}))
        return dataset.assign_attrs(self._attributes())

    def _estimates(self) -> "xarray.Dataset":
        """Return the estimates over `parameter`, and the misfit."""
        import xarray

        names = list(self.names)
        fitted = {"units": "SI, as the rig's argument", "long_name": "Fitted number"}
        data: dict[str, Any] = {
            name: ("parameter", [getattr(self, name)[n] for n in names], fitted)
            for name in ("estimate", "standard_deviation")
        }
        data["interval"] = ("parameter", "end"), [self.interval[n] for n in names], fitted
        for name in ("identifiable", "identifiability"):
            about = {"long_name": name.capitalize(), "units": "1"}
            data[name] = "parameter", [getattr(self, name)[n] for n in names], about
        about = {"long_name": "Correlation", "units": "1"}
        data["correlation"] = ("parameter", "other_parameter"), self.correlation, about
        coordinates = {"parameter": names, "other_parameter": names, "end": ["low", "high"]}
        return xarray.Dataset(data, coordinates, attrs=self._misfit())

    def _misfit(self) -> dict[str, Any]:
        return {
            "title": "vibrojax identification",
            "reduced_chi_square": self.reduced_chi_square,
            "degrees_of_freedom": self.degrees_of_freedom,
            "confidence": self.confidence,
            "values_measured": sum(m.size for m in self.measured),
            "number_of_measurements": len(self.measured),
            "warnings": "\n".join(self.warnings),
            "notes": "\n".join(self.notes),
        }

    def _attributes(self) -> dict[str, Any]:
        return self._misfit() | {
            "objective": self.problem.objective,
            "rig": recipe(self.system()),
            "vibrojax_version": version("vibrojax"),
            "jax_version": version("jax"),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return everything that was found, in plain types."""
        return {
            "parameters": {
                n: {
                    "estimate": self.estimate[n],
                    "interval": [_plain(end) for end in self.interval[n]],
                    "standard_deviation": _plain(self.standard_deviation[n]),
                    "identifiability": self.identifiability[n],
                    "coordinate": self.coordinates[n],
                }
                for n in self.names
            },
            "correlation": self.correlation.tolist(),
            "chi_square": self.chi_square,
            "alternatives": [
                {"estimate": a.estimate, "reduced_chi_square": a.reduced_chi_square}
                for a in self.alternatives
            ],
            "measurements": [
                {"label": m.label, "points": m.size, "parameters": m.parameters}
                for m in self.measured
            ],
            "evaluations": self.evaluations,
            **self._attributes(),
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }

    @validated
    def report(self, path: str | Path, *, source: str | None = None) -> None:
        """Write one page of HTML that says all of the fit: to read, to print, and to run again.

        It holds the data, the pictures, and as a zip archive a Python script with its data that
        repeats the fit; nothing is fetched. The script has the text of the function of the rig and
        of what it uses, as far as Python has it, and is tried; the page says what is missing.

        Parameters:
            path: of the page, such as `report.html`; what is there is replaced.
            source: Python text that defines `rig`, the function of the rig, with its imports, where
                it cannot be read off the function (a lambda, or a session that keeps no text).

        Raises `ValueError` for a path that is not of a page, or cannot be a file's, and a `source`
        that does not make the rig that was fitted; `OSError` where writing fails.
        """
        from vibrojax.identification.report import write_report

        write_report(self, path, source)

    @validated
    def save(self, path: str | Path) -> tuple[Path, Path]:
        """Write what was found as JSON and the picture as PNG beside it; returns both paths.

        `path` is that of either file; its ending is exchanged. Both take their places, or none.
        Raises `ValueError` for a path that cannot be a file's, `OSError` where writing fails.
        """
        path = path_of("path", path)
        data, picture = path.with_suffix(".json"), path.with_suffix(".png")
        with whole_files(data, picture) as (numbers, drawing):
            assert numbers is not None
            assert drawing is not None
            numbers.write_text(json.dumps(self.to_dict(), indent=2) + "\n")
            self.plot().savefig(drawing, format="png")
        return data, picture

    def __repr__(self) -> str:
        width = max(len(n) for n in self.names)
        points = sum(m.size for m in self.measured)
        lines = [
            f"Identification({len(self.names)} numbers from {points} points in "
            f"{len(self.measured)} measurement{'s' * (len(self.measured) > 1)})"
        ]
        for n in self.names:
            low, high = self.interval[n]
            lines.append(
                f"  {n:<{width}}  {self.estimate[n]:.5g}   {100 * self.confidence:g} % interval "
                f"{low:.5g} to {high:.5g}   {self.identifiability[n]}"
            )
        lines.append(
            f"  reduced chi-square {self.reduced_chi_square:.3f} "
            f"({self.degrees_of_freedom} degrees of freedom), {self.evaluations} evaluations"
        )
        for a in self.alternatives[:3]:
            numbers = ", ".join(f"{n} {v:.4g}" for n, v in a.estimate.items())
            lines.append(f"  another minimum: {numbers} (chi-square {a.reduced_chi_square:.3g})")
        lines += [f"  Warning: {w}" for w in self.warnings]
        lines += [f"  Note: {n}" for n in self.notes]
        return "\n".join(lines)


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
