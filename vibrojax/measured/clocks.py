"""Columns that were sampled on clocks of their own, side by side over all times of them."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vibrojax.measured.table import NoTable
from vibrojax.measured.units import UNITS, find_unit

_SAME = 1e-3
"""Times are the same that differ by less than this part of the shortest step."""


class Clock(NamedTuple):
    """Values at even steps."""

    start: float
    step: float
    unit: str = "s"

    @property
    def axis(self) -> str:
        """What the steps are in: `time`, `frequency`, or another kind of unit."""
        found = find_unit(self.unit)
        return self.unit if found is None else UNITS[found].kind

    @property
    def size(self) -> float:
        """Its unit in SI units."""
        found = find_unit(self.unit)
        return 1.0 if found is None else UNITS[found].factor

    def places(self, name: str, count: int) -> np.ndarray:
        """Return where `count` values are. Raises `NoTable` for a step that is none."""
        if not (np.isfinite([self.start, self.step]).all() and self.step > 0):
            raise NoTable(
                f"says of {name!r} that it starts at {self.start:g} {self.unit} and goes on in "
                f"steps of {self.step:g} {self.unit}: the step must be above 0"
            )
        return self.start + self.step * np.arange(count)


def side_by_side(
    columns: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, dict[str, np.ndarray], str | None]:
    """Return all times at which one of the columns has a value, the columns, and a sentence.

    `columns` are the times and the values of each; a column is NaN where it was not sampled. The
    sentence is None where all have the same times. Raises `NoTable` for times that do not rise.
    """
    for name, (places, _) in columns.items():
        if not (np.diff(places) > 0).all():
            raise NoTable(f"has times of {name!r} that do not rise")
    (first, _), *others = columns.values()
    if all(np.array_equal(first, places) for places, _ in others):
        return first, {name: values for name, (_, values) in columns.items()}, None
    start = min(places[0] for places, _ in columns.values())
    steps = [np.diff(places).min() for places, _ in columns.values() if len(places) > 1]
    step = min(steps, default=1.0)
    ticks = {
        name: np.round((places - start) / (_SAME * step)) for name, (places, _) in columns.items()
    }
    every = np.unique(np.concatenate(list(ticks.values())))
    time, found = np.empty(len(every)), {}
    for name, (places, values) in columns.items():
        here = np.searchsorted(every, ticks[name])
        time[here] = places
        found[name] = np.full(len(every), np.nan, np.result_type(values.dtype, float))
        found[name][here] = values
    counts = ", ".join(f"{name!r} {len(places)}" for name, (places, _) in columns.items())
    return time, found, f"Columns have clocks of their own ({counts} samples of {len(every)})."
