"""The variables of a map before they are computed: names, dimensions, kinds, units."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from vibrojax.ensemble.arguments import Dimension
from vibrojax.maps.measures import PLACED, PLACES, STEPWISE, Measure
from vibrojax.maps.responses import WHOLE, AbstractMapResponse, Grid
from vibrojax.results.variables import (
    DIFFERENTIATED,
    axis_description,
    axis_unit,
    described_as,
    described_statistic,
)
from vibrojax.steady.kinds import Regime

FAILED, MISSING = 3, 4
"""Values of `lane_status` beyond those of the response."""


class Described(NamedTuple):
    """One variable of the dataset."""

    inner: dict[str, int]
    """Lengths of its dimensions behind those of the lanes, by name."""
    dtype: np.dtype
    attributes: dict[str, Any]

    @property
    def nothing(self) -> float | int:
        """What stands where nothing was computed."""
        return np.nan if self.dtype.kind == "f" else -1


class Template(NamedTuple):
    """Everything of the dataset but its values."""

    coordinates: dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]
    variables: dict[str, Described]
    outer: tuple[str, ...]
    """The dimensions of the lanes."""


def template_of(
    dimensions: tuple[Dimension, ...],
    response: AbstractMapResponse,
    grid: Grid,
    measures: tuple[Measure, ...],
    keep_curves: bool,
    gradients: tuple[str, ...],
    ratio_units: str,
) -> Template:
    """Lay out the dataset of a map."""
    layout = response.layout
    way, ways = layout.way, layout.ways
    inner = ({way: len(ways)} if ways else {}) | (
        {} if grid.single else {grid.axis: len(grid.values)}
    )
    axis = axis_unit(grid.axis)
    ratio_axis = " ".join(unit for unit in (ratio_units, axis) if unit != "1") or "1"
    units = {"ratio": ratio_units, "axis": axis, "ratio axis": ratio_axis}
    coordinates: dict[str, Any] = {}
    for d in dimensions:
        for name, values in d.values.items():
            about = axis_description(name) if values.dtype.kind in "fiu" else {}
            coordinates[name] = ((d.name,), values, about)
    if ways:
        coordinates[way] = ((way,), np.array(ways), described_as(way))
    frequencies = ((), grid.values[0]) if grid.single else ((grid.axis,), grid.values)
    coordinates[grid.axis] = (*frequencies, axis_description(grid.axis))

    def described(name: str) -> dict[str, Any]:
        known = described_statistic(name)
        return {"units": units.get(known.units, known.units), "long_name": known.long_name}

    variables: dict[str, Described] = {}

    def add(name: str, behind: dict[str, int], attributes: dict[str, Any], dtype: Any) -> None:
        variables[name] = Described(behind, np.dtype(dtype), attributes)

    def add_slopes(name: str, behind: dict[str, int]) -> None:
        own = described(name)
        for number in gradients:
            attributes = {
                "units": _per(own["units"], axis_unit(number)),
                "long_name": f"Derivative of {own['long_name'].lower()} by {number}",
            }
            add(f"d_{name}_d_{number}", behind, attributes, float)

    if keep_curves:
        flags = {"status": layout.point_words, "regime": [kind.name for kind in Regime]}
        for name in layout.variables:
            attributes = described(name) | (_flags(flags[name]) if name in flags else {})
            behind = dict([layout.behind[name]] if name in layout.behind else [])
            for dimension, length in behind.items():
                about = described(dimension)
                coordinates[dimension] = ((dimension,), np.arange(length), about)
            add(name, inner | behind, attributes, np.int32 if name in WHOLE else float)
        for name in DIFFERENTIATED:
            if name in layout.variables:
                add_slopes(name, inner)
    for measure in measures:
        several = measure.own and measure.name in PLACED
        behind = {f"{measure.name}_number": PLACES} if several else {}
        add(measure.name, behind, described(measure.name), float)
        if not (measure.own and measure.name in STEPWISE):
            add_slopes(measure.name, behind)
    add("lane_steps", {}, described("lane_steps"), np.int64)
    ends = _flags((*layout.lane_words, "failed", "missing"))
    add("lane_status", {}, described("lane_status") | ends, np.int8)
    return Template(coordinates, variables, tuple(d.name for d in dimensions))


def _flags(words: Sequence[str]) -> dict[str, Any]:
    return {"flag_values": list(range(len(words))), "flag_meanings": " ".join(words)}


def _per(unit: str, other: str) -> str:
    if other == "1":
        return unit
    return f"{unit}/({other})" if set(" /") & set(other) else f"{unit}/{other}"
