"""The variables of a map before they are computed: names, dimensions, kinds, units."""

from typing import Any, NamedTuple

import numpy as np

from vibrojax.ensemble.arguments import Dimension
from vibrojax.maps.measures import PLACED, PLACES, STEPWISE, Measure
from vibrojax.maps.responses import WHOLE, AbstractMapResponse, Grid
from vibrojax.regime.kinds import Regime
from vibrojax.results.variables import axis_description, axis_unit, described_statistic

FAILED, MISSING = 3, 4
"""Values of `lane_status` beyond those of the response."""


class Described(NamedTuple):
    """One variable of the dataset."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
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
    outer = tuple(d.name for d in dimensions)
    lanes = tuple(d.size for d in dimensions)
    way, ways = response.ways()
    unit = axis_unit(grid.axis)
    coordinates: dict[str, Any] = {}
    for d in dimensions:
        for name, values in d.values.items():
            about = axis_description(name) if values.dtype.kind in "fiu" else {}
            coordinates[name] = ((d.name,), values, about)
    if ways:
        about = {
            "long_name": "Direction of the sweep" if way == "direction" else "Along the branch"
        }
        coordinates[way] = ((way,), np.array(ways), about)
    frequencies = grid.values[0] if grid.single else grid.values
    inner_axis = () if grid.single else (grid.axis,)
    coordinates[grid.axis] = (inner_axis, frequencies, axis_description(grid.axis))
    inner = ((way,) if ways else ()) + inner_axis
    sizes = ((len(ways),) if ways else ()) + (() if grid.single else (len(grid.values),))
    units = {"ratio": ratio_units, "axis": unit, "ratio axis": _product(ratio_units, unit)}

    def described(name: str) -> dict[str, Any]:
        known = described_statistic(name)
        return {"units": units.get(known.units, known.units), "long_name": known.long_name}

    variables: dict[str, Described] = {}

    def add(name: str, dims: Any, shape: Any, dtype: Any, attributes: dict[str, Any]) -> None:
        variables[name] = Described(outer + dims, lanes + shape, np.dtype(dtype), attributes)

    def derivatives(name: str, dims: Any, shape: Any) -> None:
        own = described(name)
        for number in gradients:
            attributes = {
                "units": _per(own["units"], axis_unit(number)),
                "long_name": f"Derivative of {own['long_name'].lower()} by {number}",
            }
            add(f"d_{name}_d_{number}", dims, shape, float, attributes)

    if keep_curves:
        for name in response.variables:
            attributes = described(name)
            if name == "status":
                attributes |= _flags(response.point_words)
            if name == "regime":
                attributes |= _flags(tuple(kind.name for kind in Regime))
            more = [response.behind[name]] if name in response.behind else []
            for dimension, length in more:
                about = described(dimension)
                coordinates[dimension] = ((dimension,), np.arange(length), about)
            dims = (*inner, *(dimension for dimension, _ in more))
            shape = (*sizes, *(length for _, length in more))
            add(name, dims, shape, np.int32 if name in WHOLE else float, attributes)
        for name in DIFFERENTIATED:
            if name in response.variables:
                derivatives(name, inner, sizes)
    for measure in measures:
        several = measure.own and measure.name in PLACED
        dims, shape = ((f"{measure.name}_number",), (PLACES,)) if several else ((), ())
        add(measure.name, dims, shape, float, described(measure.name))
        if not (measure.own and measure.name in STEPWISE):
            derivatives(measure.name, dims, shape)
    add("lane_steps", (), (), np.int64, described("lane_steps"))
    words = (*response.lane_words, "failed", "missing")
    add("lane_status", (), (), np.int8, described("lane_status") | _flags(words))
    return Template(coordinates, variables, outer)


DIFFERENTIATED = (
    "amplitude_ratio",
    "peak_ratio",
    "rms_ratio",
    "first_harmonic_ratio",
    "contact_force",
    "contact_fraction",
)
"""Variables over the frequency that have derivatives."""


def _flags(words: tuple[str, ...]) -> dict[str, Any]:
    return {"flag_values": list(range(len(words))), "flag_meanings": " ".join(words)}


def _product(first: str, second: str) -> str:
    return " ".join(unit for unit in (first, second) if unit != "1") or "1"


def _per(unit: str, other: str) -> str:
    if other == "1":
        return unit
    return f"{unit}/({other})" if set(" /") & set(other) else f"{unit}/{other}"
