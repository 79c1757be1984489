"""The cycles of a history, one by one: how long each is, in seconds and in drive periods."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.checks import check_count, check_not_negative, check_positive, concrete
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.history.crossings import crossings, curve_through
from vibrojax.history.quantities import (
    check_quantity,
    dataset,
    observables_of,
    quantity_of,
    table,
    unit_and_label,
)
from vibrojax.history.samples import SampledMotion, times_of
from vibrojax.results.status import Status
from vibrojax.results.variables import VARIABLES

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


HYSTERESIS = 0.3
"""Default threshold over the rms of the quantity about the level."""
LARGEST = ("chord_reduction", "strain_energy")
"""Observables whose largest value in each cycle is kept, where the system has them."""
WITHIN = 0.25
"""Default distance, in drive periods, up to which a cycle counts as one of so many periods."""


@dataclass(frozen=True, eq=False, repr=False)
class Cycles:
    """Cycles of one or several histories, in order of time within each.

    A cycle runs from an up-crossing of the level to the next one; an up-crossing counts only if the
    quantity has been lower than the level less the threshold since the one before.
    """

    history: Int[np.ndarray, " cycles"]
    """Number of the history that the cycle is of, from 1."""
    start: Float[np.ndarray, " cycles"]
    """When it begins, s."""
    length: Float[np.ndarray, " cycles"]
    """How long it takes, s."""
    drive_periods: Float[np.ndarray, " cycles"]
    """Drive periods that pass meanwhile: phase of the drive gained over 2 pi."""
    drive_frequency: Float[np.ndarray, " cycles"]
    """Drive frequency at the middle of the cycle, Hz."""
    peak_to_peak: Float[np.ndarray, " cycles"]
    """Highest less lowest sample of the quantity."""
    largest: dict[str, Float[np.ndarray, " cycles"]]
    """Largest sample of `chord_reduction` (m) and `strain_energy` (J), where there are such."""
    quantity: str
    level: float
    """In the unit of the quantity."""
    threshold: Float[np.ndarray, " histories"]
    """Hysteresis below the level used for each history, in the unit of the quantity."""
    left_out: int = 0
    """Histories that diverged, of which no cycles were read."""

    def __len__(self) -> int:
        return self.start.size

    @classmethod
    def pooled(cls, parts: "Sequence[Cycles]") -> "Cycles":
        """Put the cycles of several results together, histories numbered on.

        Raises `ValueError` for none, or for cycles of different quantities, levels or observables.

        `parts` is a list of them.
        """
        parts = list(parts)
        if not parts or not all(isinstance(part, cls) for part in parts):
            raise ValueError(f"pooled needs a list of at least one Cycles, got {parts!r}.")
        first = parts[0]
        for part in parts:
            for name in ("quantity", "level"):
                if getattr(part, name) != getattr(first, name):
                    raise ValueError(
                        f"Cycles of different {name} cannot be pooled, got "
                        f"{getattr(first, name)!r} and {getattr(part, name)!r}."
                    )
            if part.largest.keys() != first.largest.keys():
                raise ValueError("Cycles of systems with different observables cannot be pooled.")
        before = np.cumsum([0, *(len(part.threshold) + part.left_out for part in parts)])
        moved = [part.history + n for part, n in zip(parts, before[:-1], strict=True)]
        columns = ("start", "length", "drive_periods", "drive_frequency", "peak_to_peak")
        return cls(
            history=np.concatenate(moved),
            **{
                name: np.concatenate([getattr(part, name) for part in parts])
                for name in (*columns, "threshold")
            },
            largest={
                name: np.concatenate([part.largest[name] for part in parts])
                for name in first.largest
            },
            quantity=first.quantity,
            level=first.level,
            left_out=sum(part.left_out for part in parts),
        )

    @validated
    def statistics(
        self,
        edges: Sequence[float] | Float[np.ndarray, " edges"],
        share_of: Mapping[int, float] | Sequence[int] = (3, 5),
    ) -> "xarray.Dataset":
        """Return statistics of the cycles by bins of drive frequency.

            cycles.statistics(np.arange(2.0, 9.5, 0.5), share_of={3: 0.25, 5: 0.25})

        Parameters:
            edges: ends of the bins, Hz, increasing, shape (bins + 1,); a bin has its lower end.
            share_of: numbers of drive periods whose share of the cycles is wanted, with how far a
                cycle may be off, in drive periods; without, 0.25.

        Returns a dataset over `frequency` (middles of the bins, with `lower_edge`, `upper_edge`):
        `count`, `median`, `mean` and `standard_deviation` of the length in drive periods (NaN in a
        bin without cycles), `share_of_3`, ..., and the largest of each observable. Source of the
        picture: Litak et al., fig. 4. Raises `ValueError` for edges that do not increase.
        """
        bounds = np.asarray(edges, float)
        if bounds.ndim != 1 or len(bounds) < 2 or not (np.diff(bounds) > 0).all():
            raise ValueError(
                f"edges must be at least two increasing frequencies (Hz), got {in_short(edges)}."
            )
        if not isinstance(share_of, Mapping):
            share_of = dict.fromkeys(share_of, WITHIN)
        for order, within in share_of.items():
            check_positive(f"share_of[{order!r}]", within, "(drive periods)")
        bins = np.searchsorted(bounds, self.drive_frequency, side="right") - 1
        groups = [np.flatnonzero(bins == k) for k in range(len(bounds) - 1)]
        data: dict[str, Any] = {}

        def add(name: str, values: Any, read: Any, label: str, units: str = "1") -> None:
            found = [read(values[group]) if group.size else np.nan for group in groups]
            data[name] = "frequency", np.array(found, float), units, label

        length = self.drive_periods
        data["count"] = "frequency", [len(group) for group in groups], "1", "Cycles"
        for name, read in (
            ("median", np.median),
            ("mean", np.mean),
            ("standard_deviation", np.std),
        ):
            words = f"{name.replace('_', ' ').capitalize()} of the cycle length in drive periods"
            add(name, length, read, words)
        for order, within in share_of.items():
            words = f"Share of cycles within {within:g} of {order} drive periods"
            add(f"share_of_{order}", np.abs(length - order) <= within, np.mean, words)
        for name, values in self.largest.items():
            units, label = unit_and_label(name)
            add(f"largest_{name}", values, np.max, f"Largest {label.lower()}", units)
        hertz = {
            "frequency": ((bounds[1:] + bounds[:-1]) / 2, "Drive frequency"),
            "lower_edge": (bounds[:-1], "Lower edge of the bin"),
            "upper_edge": (bounds[1:], "Upper edge of the bin"),
        }
        data |= {
            name: ("frequency", values, "Hz", label) for name, (values, label) in hertz.items()
        }
        return dataset(data, {}, self._settings()).set_coords(list(hertz))

    def _settings(self) -> dict[str, Any]:
        return {
            "quantity": self.quantity,
            "level": self.level,
            "threshold": self.threshold,
            "histories": len(self.threshold),
            "histories_left_out": self.left_out,
        }

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over cycle, with units and long names."""
        units, label = unit_and_label(self.quantity)
        columns = {
            "start": (self.start, "s", "Start of the cycle"),
            "length": (self.length, "s", "Length of the cycle"),
            "drive_periods": (self.drive_periods, *VARIABLES["drive_periods"]),
            "drive_frequency": (
                self.drive_frequency,
                "Hz",
                "Drive frequency at the middle of the cycle",
            ),
            "peak_to_peak": (self.peak_to_peak, units, f"{label}, peak to peak"),
            "history": (self.history, "1", "History, from 1"),
        }
        for name, values in self.largest.items():
            units, label = unit_and_label(name)
            columns[f"largest_{name}"] = values, units, f"Largest {label.lower()} of the cycle"
        return table("cycle", columns, self._settings())

    @validated
    def plot(self, orders: Sequence[int] = (1, 3, 5)) -> "Figure":
        """Draw the length of every cycle in drive periods against the drive frequency.

        Lines mark `orders` drive periods, whole numbers; another raises `ValueError`. Source of the
        picture: Litak et al., fig. 4.
        """
        for order in orders:
            check_count("orders", order)
        from vibrojax.plot.history import plot_cycles

        quantity = unit_and_label(self.quantity)[1].lower()
        return plot_cycles(self.to_xarray(), tuple(orders), quantity)

    def __repr__(self) -> str:
        count = len(self.threshold)
        plural = "y" if count == 1 else "ies"
        parts = [f"{len(self)} of {self.quantity}, {count} histor{plural}"]
        if self.left_out:
            parts.append(f"{self.left_out} more diverged")
        if len(self):
            low, high = self.drive_frequency.min(), self.drive_frequency.max()
            parts.append(f"{low:.4g} to {high:.4g} Hz")
            parts.append(f"median {np.median(self.drive_periods):.4g} drive periods")
            parts.append(f"standard deviation {np.std(self.drive_periods):.3g}")
        return f"Cycles({', '.join(parts)})"


def cycles_of(
    history: SampledMotion, quantity: str, level: float | int, threshold: float | int | None
) -> Cycles:
    """Read the cycles of one history; see `History.cycles`."""
    check_quantity(history.motion.equations, quantity)
    time = times_of(history, "cycles")
    if threshold is not None:
        check_not_negative("threshold", threshold, unit_and_label(quantity)[0])
    if concrete(level) is None or not np.isfinite(level):
        raise ValueError(f"level must be a finite number, got {level!r}.")
    values, rates = quantity_of(history, quantity)
    values = np.asarray(values)
    if threshold is None:
        threshold = HYSTERESIS * float(np.sqrt(np.mean((values - level) ** 2)))
    ups = crossings(curve_through(time, values, rates), float(level), "upwards")
    armed = np.searchsorted(time[values < level - threshold], ups)
    # The first up-crossing after every stretch below; before any there is nothing to end.
    _, counted = np.unique(armed, return_index=True)
    ends = ups[counted[armed[counted] > 0]]
    phase, _, _ = history.motion.waveform.phase(jnp.asarray(ends))
    middle = (ends[1:] + ends[:-1]) / 2
    _, rate, _ = history.motion.waveform.phase(jnp.asarray(middle))
    watched = [name for name in LARGEST if name in observables_of(history.motion.equations)]
    first, last = np.searchsorted(time, ends[:-1]), np.searchsorted(time, ends[1:])

    def each(read: Any, signal: np.ndarray) -> Float[np.ndarray, " cycles"]:
        pairs = zip(first, last, strict=True)
        return np.array([read(signal[a:b]) if b > a else 0.0 for a, b in pairs], float)

    return Cycles(
        history=np.ones(len(middle), int),
        start=ends[:-1],
        length=np.diff(ends),
        drive_periods=np.diff(np.asarray(phase)) / (2 * np.pi),
        drive_frequency=np.asarray(rate) * np.ones(len(middle)) / (2 * np.pi),
        peak_to_peak=each(np.ptp, values),
        largest={name: each(np.max, np.asarray(quantity_of(history, name)[0])) for name in watched},
        quantity=quantity,
        level=float(level),
        threshold=np.array([threshold], float),
    )


def cycles_of_each(
    histories: Iterable[SampledMotion],
    quantity: str,
    level: float | int,
    threshold: float | int | None,
) -> Cycles:
    """Read and pool the cycles of all histories; see `Histories.cycles`."""
    each = list(histories)
    kept = [k for k, one in enumerate(each) if int(one.status) == Status.completed.value]
    if not kept:
        raise ValueError("There are no cycles: all of these histories diverged.")
    pooled = Cycles.pooled([cycles_of(each[k], quantity, level, threshold) for k in kept])
    numbers = np.array(kept)[pooled.history - 1] + 1
    return replace(pooled, history=numbers, left_out=len(each) - len(kept))
