"""What the scatter of a rig's numbers makes of its measures."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from vibrojax.design.sobol_indices import SobolIndices
from vibrojax.results.saving import AbstractSaved
from vibrojax.results.variables import PLAIN, axis_description, described_statistic

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

QUANTILES = np.array([0.05, 0.5, 0.95])
ALIKE = 0.05
"""Largest share of the variance that first order may miss where it says the same as samples."""
APART = 0.25
"""Share of the range of what first order leaves over that a jump leaves empty, at least."""
FEW = 16
"""Samples that show whether the measure jumps or bends."""
ROUNDING = 1e-12
UNSAID = "nothing is said why."


class Propagation(AbstractSaved):
    """Measures of rigs whose numbers scatter; made by `propagate`.

    Arrays are in the order of `measures` and of `numbers`; `to_xarray()` has them by name.
    Statistics of the samples leave out the rigs that have no value, which `lost` counts.
    """

    measures: tuple[str, ...] = eqx.field(static=True)
    numbers: tuple[str, ...] = eqx.field(static=True)
    """Names of the numbers that scatter."""
    means: Float[np.ndarray, " numbers"]
    """Of the distributions, in the units of the numbers."""
    deviations: Float[np.ndarray, " numbers"]
    """Standard deviations of the distributions."""
    value: Float[np.ndarray, " measures"]
    """Measures of the rig at the means; NaN where it has none (`note` says why)."""
    gradient: Float[np.ndarray, "measures numbers"]
    """Derivatives there, in units of the measure per unit of the number."""
    note: str = eqx.field(static=True)
    """What the evaluation says about the rig at the means."""
    samples: Float[np.ndarray, "samples numbers"]
    """Numbers of the rigs of the quasi-Monte Carlo sample."""
    values: Float[np.ndarray, "samples measures"]
    """Their measures, NaN where a rig has none."""
    notes: tuple[str, ...] = eqx.field(static=True)
    """What the evaluation says about each of them; empty where nothing is missing."""
    sobol: SobolIndices | None
    """Sobol indices, where they were asked for."""
    evaluations: int = eqx.field(static=True)
    """Rigs that were evaluated, all in all."""
    ratio_units: str = eqx.field(static=True, default="1")
    """Unit of displacements per drive: `1` for base motion, `m/N` for a force."""

    @property
    def first_order_deviation(self) -> Float[np.ndarray, " measures"]:
        """Standard deviation of every measure of first order, by the gradient at the means."""
        return np.sqrt(np.sum((self.gradient * self.deviations) ** 2, axis=1))

    @property
    def share(self) -> Float[np.ndarray, "measures numbers"]:
        """Share of every number in the variance of first order; 0 where there is none."""
        parts = (self.gradient * self.deviations) ** 2
        whole = parts.sum(axis=1, keepdims=True)
        return np.divide(parts, whole, out=np.zeros_like(parts), where=whole != 0)

    @property
    def mean(self) -> Float[np.ndarray, " measures"]:
        """Mean over the samples."""
        return self._statistic(np.mean)

    @property
    def deviation(self) -> Float[np.ndarray, " measures"]:
        """Standard deviation over the samples."""
        return self._statistic(np.std)

    @property
    def quantiles(self) -> Float[np.ndarray, "measures quantiles"]:
        """Values that 5, 50 and 95 % of the samples do not exceed."""
        return self._statistic(lambda v: np.quantile(v, QUANTILES), np.full(3, np.nan))

    @property
    def least(self) -> Float[np.ndarray, " measures"]:
        """Least value of the samples."""
        return self._statistic(np.min)

    @property
    def largest(self) -> Float[np.ndarray, " measures"]:
        """Largest value of the samples."""
        return self._statistic(np.max)

    @property
    def lost(self) -> Int[np.ndarray, " measures"]:
        """How many rigs of the sample have no value."""
        return np.sum(~np.isfinite(self.values), axis=0)

    def _statistic(self, function: Any, nothing: Any = np.nan) -> np.ndarray:
        kept = (column[np.isfinite(column)] for column in self.values.T)
        return np.array([function(one) if one.size else nothing for one in kept], float)

    @property
    def findings(self) -> dict[str, str]:
        """For every measure a sentence on how far first order holds."""
        return {name: self._finding(k) for k, name in enumerate(self.measures)}

    def _finding(self, k: int) -> str:
        kept = np.isfinite(self.values[:, k])
        values = self.values[kept, k]
        line = (self.samples[kept] - self.means) @ self.gradient[k]
        scatter = self.deviation[k]
        if not values.size:
            return "None of the rigs has a value."
        if not np.isfinite(self.value[k] + self.gradient[k]).all():
            missing = "value" if np.isnan(self.value[k]) else "gradient"
            why = f": {self.note}" if self.note else "."
            return f"First order is not known, as the rig at the means has no {missing}{why}"
        if scatter <= ROUNDING * np.max(np.abs(values)):
            return "It does not scatter with these numbers."
        # Both of the same rigs, so that few of them do.
        explained = f"First order gives {100 * np.std(line) / scatter:.3g} % of the scatter:"
        off = values - self.value[k] - line
        if np.mean(off**2) <= ALIKE * scatter**2:
            return f"{explained} within these distributions it is nearly linear."
        return f"{explained} within these distributions it {_how_it_bends(off)}. Go by the samples."

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know: rigs that have no value, and the first note on why."""
        found: dict[str, list[str]] = {}
        for k, name in enumerate(self.measures):
            at = np.flatnonzero(~np.isfinite(self.values[:, k]))
            if at.size:
                text = (
                    f"{at.size} of {len(self.values)} rigs have no value and are left out; the "
                    f"first, at {self._place(int(at[0]))}: {self.notes[at[0]] or UNSAID}"
                )
                found.setdefault(text, []).append(name)
            if self.sobol is not None and self.sobol.base[k] < self.sobol.asked:
                text = (
                    f"Sobol indices are from {self.sobol.base[k]} of {self.sobol.asked} base "
                    "samples, as some rigs of the others have no value."
                )
                found.setdefault(text, []).append(name)
        return tuple(f"{', '.join(names)}: {text}" for text, names in found.items())

    def _place(self, sample: int) -> str:
        pairs = zip(self.numbers, self.samples[sample], strict=True)
        return ", ".join(f"{name} = {value:.6g}" for name, value in pairs)

    def _about(self, measure: str) -> tuple[str, str]:
        units, long_name = described_statistic(measure)
        return (self.ratio_units if units == "ratio" else units), long_name

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over `measure`, `number`, `sample` and `quantile`.

        Units that differ from measure to measure, or from number to number, are in `measure_units`
        and `number_units`.
        """
        import xarray

        measure_units, long_names = zip(*map(self._about, self.measures), strict=True)
        number_units = [axis_description(name)["units"] for name in self.numbers]
        alike = len(set(measure_units)) == 1
        own = measure_units[0] if alike else "that of the measure, as in measure_units"
        data: dict[str, Any] = {}

        def add(name: str, dimensions: tuple[str, ...], values: Any, said: str, units: str) -> None:
            data[name] = dimensions, np.asarray(values), {"long_name": said, "units": units}

        by, pair, samples = ("measure",), ("measure", "number"), ("sample",)
        per = "units of the measure over those of the number"
        given = "that of the number, as in number_units"
        add("value", by, self.value, "At the means of the numbers", own)
        add("gradient", pair, self.gradient, "Derivative at the means", per)
        first = self.first_order_deviation
        add("first_order_deviation", by, first, "Standard deviation of first order", own)
        add("share", pair, self.share, "Share of the variance of first order", "1")
        add("mean", by, self.mean, "Mean over the samples", own)
        add("deviation", by, self.deviation, "Standard deviation over the samples", own)
        add("quantiles", (*by, "quantile"), self.quantiles, "Quantile of the samples", own)
        add("least", by, self.least, "Least value of the samples", own)
        add("largest", by, self.largest, "Largest value of the samples", own)
        add("lost", by, self.lost, "Rigs of the sample without a value", "1")
        add("values", (*samples, *by), self.values, "Measures of the sampled rigs", own)
        add("samples", (*samples, "number"), self.samples, "Numbers of the sampled rigs", given)
        add("number_mean", ("number",), self.means, "Mean of the distribution", given)
        spread = "Standard deviation of the distribution"
        add("number_deviation", ("number",), self.deviations, spread, given)
        if self.sobol is not None:
            for name, word in (("first", "First-order"), ("total", "Total")):
                half = f"Half width of the 95 % interval of the {word.lower()} Sobol index"
                add(f"sobol_{name}", pair, getattr(self.sobol, name), f"{word} Sobol index", "1")
                confidence = getattr(self.sobol, f"{name}_confidence")
                add(f"sobol_{name}_confidence", pair, confidence, half, "1")
        notes: Any = np.array(self.notes, dtype=object)
        coordinates = {
            "measure": ("measure", list(self.measures), {"long_name": "Measure"}),
            "number": ("number", list(self.numbers), {"long_name": "Number of the rig"}),
            "quantile": ("quantile", QUANTILES, {"long_name": "Probability", "units": "1"}),
            "measure_units": ("measure", list(measure_units), {"long_name": "Unit"}),
            "measure_name": ("measure", list(long_names), {"long_name": "Measure in words"}),
            "number_units": ("number", number_units, {"long_name": "Unit"}),
            "note": ("sample", notes, {"long_name": "What is missing, and why"}),
        }
        attributes = {"title": "vibrojax propagation", "evaluations": self.evaluations}
        attributes |= {"warnings": "\n".join(self.warnings)}
        attributes["findings"] = "\n".join(f"{n}: {text}" for n, text in self.findings.items())
        return xarray.Dataset(data, coordinates, attributes)

    def plot(self) -> "Figure":
        """Draw the samples of every measure with first order over them, and whose scatter it is."""
        from vibrojax.plot.propagation import plot_propagation

        return plot_propagation(self.to_xarray())

    def __repr__(self) -> str:
        head = ("value", "1st order", "mean", "deviation", "5 %", "50 %", "95 %", "lost")
        pairs = [(name, self._about(name)[0]) for name in self.measures]
        names = [name if units in PLAIN else f"{name} ({units})" for name, units in pairs]
        wide = max(map(len, (*names, "measure")))
        measures, numbers = (
            f"{len(one)} {word}{'s' * (len(one) != 1)}"
            for one, word in ((names, "measure"), (self.numbers, "number"))
        )
        lines = [
            f"Propagation({measures} over {numbers}, {self.evaluations} rigs)",
            f"  {'measure':<{wide}}" + "".join(f"{word:>11}" for word in head),
        ]
        columns = (self.value, self.first_order_deviation, self.mean, self.deviation)
        rows = np.column_stack([*columns, self.quantiles])
        for name, row, lost in zip(names, rows, self.lost, strict=True):
            cells = "".join(f"{one:>11.4g}" for one in row)
            lines.append(f"  {name:<{wide}}{cells}{lost:>11}")
        for k, name in enumerate(self.measures):
            lines.append(f"  {name}: {self.findings[name]}")
            lines.append(f"    variance of first order: {self._parts(self.share[k])}")
            if self.sobol is not None:
                own = self.sobol
                alone = self._parts(own.first[k], own.first_confidence[k])
                together = self._parts(own.total[k], own.total_confidence[k])
                lines += [f"    Sobol, alone: {alone}", f"    Sobol, with others: {together}"]
        return "\n".join([*lines, *(f"  warning: {text}" for text in self.warnings)])

    def _parts(self, shares: np.ndarray, half: np.ndarray | None = None) -> str:
        """Return the shares of the numbers in words, with half widths of their intervals."""
        widths = [""] * len(shares) if half is None else [f" ± {100 * one:.2g}" for one in half]
        every = zip(self.numbers, shares, widths, strict=True)
        return ", ".join(f"{name} {100 * share:.3g}{width} %" for name, share, width in every)


def _how_it_bends(off: Float[np.ndarray, " rigs"]) -> str:
    """Return whether a measure jumps or bends, from what first order leaves over."""
    off = np.sort(off)
    tail = off.size // 10
    steps = np.diff(off[tail : off.size - tail])
    if off.size < FEW or steps.max() <= APART * np.ptp(off):
        return "is not linear"
    at = tail + int(np.argmax(steps)) + 1
    size = off[at:].mean() - off[:at].mean()
    part, side = min((at, "below"), (off.size - at, "above"))
    return (
        f"jumps: {part} of {off.size} rigs lie {size:.3g} {side} the line of the others, none "
        "between"
    )
