"""What the results of searches for designs hold: axes, units and long names, once."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax.results.variables import axis_unit

if TYPE_CHECKING:
    import xarray

SI, OWN = "SI, as the rig's argument", "as the function returns it"
ALONG = ("evaluation", "variable")
OUTPUTS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "best": (("variable",), SI, "Best design"),
    "first": (("variable",), SI, "Design to begin with"),
    "low": (("variable",), SI, "Low bound"),
    "high": (("variable",), SI, "High bound"),
    "logarithmic": (("variable",), "1", "Whether the coordinate is logarithmic"),
    "gradient": (("variable",), OWN, "Gradient of the objective"),
    "curvature": (("variable", "variable_2"), OWN, "Second derivatives of the objective"),
    "value": ((), OWN, "Objective of the best design"),
    "first_value": ((), OWN, "Objective of the design to begin with"),
    "constraint_value": (("constraint",), OWN, "Constrained function of the best design"),
    "least": (("constraint",), OWN, "Least value allowed"),
    "most": (("constraint",), OWN, "Largest value allowed"),
    "design": (ALONG, SI, "Design tried"),
    "tried": (("evaluation",), OWN, "Objective of the design tried"),
    "tried_constraint": (("evaluation", "constraint"), OWN, "Constrained function, design tried"),
    "feasible": (("evaluation",), "1", "Whether constraints are met"),
    "search": (("evaluation",), "1", "Search, 0: screened, -1: next to the best"),
    "number_in_search": (("evaluation",), "1", "Number in the search, from 1"),
    "note": (("evaluation",), "1", "Why something is missing"),
    "end_design": (("end", "variable"), SI, "Design where the search ended"),
    "end_value": (("end",), OWN, "Objective where the search ended"),
    "end_status": (("end",), "1", "How the search ended"),
    "end_reason": (("end",), "1", "Why the search ended"),
    "neighbour": (("variable", "side"), SI, "Number of the neighbouring design"),
    "neighbour_value": (("variable", "side"), OWN, "Objective of the neighbouring design"),
    "neighbour_constraint": (
        ("variable", "side", "constraint"),
        OWN,
        "Constrained function of the neighbouring design",
    ),
    "front": (("point", "objective"), OWN, "Objectives along the front"),
    "front_design": (("point", "variable"), SI, "Design along the front"),
    "front_constraint": (("point", "constraint"), OWN, "Constrained function along the front"),
    "front_status": (("point",), "1", "How the search for the point ended"),
    "tried_objectives": (("evaluation", "objective"), OWN, "Objectives of the design tried"),
}

AXES = {
    "variable": "Number of the rig",
    "variable_2": "Number of the rig",
    "constraint": "Constrained function",
    "objective": "Objective",
    "evaluation": "Design tried, from 1",
    "end": "Number of the search",
    "side": "Neighbour of the best design, 1 or 2",
    "point": "Point along the front, from 1",
}


def output_dataset(
    values: Mapping[str, Any], axes: Mapping[str, Sequence[Any]], attributes: Mapping[str, Any]
) -> "xarray.Dataset":
    """Return outputs by name as a dataset; those along an axis that has no places are left out.

    `axes` are the places of axes by name; true and false become 1 and 0.
    """
    import xarray

    axes = {name: list(places) for name, places in axes.items() if len(places)}
    data = {}
    for name, given in values.items():
        over, units, long_name = OUTPUTS[name]
        if all(axis in axes for axis in over):
            array = np.asarray(given).reshape([len(axes[axis]) for axis in over])
            array = array.astype(int) if array.dtype == bool else array
            data[name] = (over, array, {"units": units, "long_name": long_name})
    units = [axis_unit(name) for name in axes["variable"]]
    coordinates: dict[str, Any] = {
        "variable_units": ("variable", units, {"units": "1", "long_name": "Unit of the number"})
    }
    for name, places in axes.items():
        coordinates[name] = (name, places, {"units": "1", "long_name": AXES[name]})
    return xarray.Dataset(data, coordinates, attrs=dict(attributes))
