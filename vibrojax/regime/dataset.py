"""What the results of regimes and diagrams share: datasets and words."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax.regime.kinds import Regime
from vibrojax.results.axes import coordinates_of
from vibrojax.results.status import Status
from vibrojax.results.variables import VARIABLES, described_statistic

if TYPE_CHECKING:
    import xarray

Array = np.ndarray
INNER = {"displacement": "strobe", "velocity": "strobe", "spectrum": "order"}
"""Variables with a dimension of their own behind those of the lanes."""
FLAGS = {
    "regime": [kind.name for kind in Regime],
    "status": [status.name for status in Status],
}


def description(name: str, ratio_units: str) -> dict[str, Any]:
    """Return unit and long name of a variable, and the words of one that counts kinds."""
    known = described_statistic(name)
    about: dict[str, Any] = {
        "units": ratio_units if known.units == "ratio" else known.units,
        "long_name": known.long_name,
    }
    if name in FLAGS:
        about |= {
            "flag_values": list(range(len(FLAGS[name]))),
            "flag_meanings": " ".join(FLAGS[name]),
        }
    return about


def dataset_of(
    coordinates: Mapping[str, Array],
    variables: Mapping[str, Array],
    orders: Array | None,
    ratio_units: str,
    attributes: Mapping[str, str],
) -> "xarray.Dataset":
    """Return a dataset with the coordinates as dimensions, in their order, and units."""
    import xarray

    dims = tuple(coordinates)
    data: dict[str, Any] = {}
    for name, values in variables.items():
        inner = (INNER[name],) if name in INNER else ()
        data[name] = ((*dims, *inner), values, description(name, ratio_units))
    own: dict[str, Any] = coordinates_of(coordinates)
    if "displacement" in variables:
        count = variables["displacement"].shape[-1]
        about = {"units": "1", "long_name": VARIABLES["strobe"].long_name}
        own["strobe"] = (("strobe",), np.arange(count), about)
    if orders is not None and "spectrum" in variables:
        about = {"units": "1", "long_name": VARIABLES["order"].long_name}
        own["order"] = (("order",), orders, about)
    return xarray.Dataset(data, own, attrs=dict(attributes))


def tally(kind: Array) -> str:
    """Say how many lanes there are of each kind of motion."""
    count = np.bincount(np.asarray(kind).ravel(), minlength=len(Regime))
    return ", ".join(f"{count[r.value]} {r.word}" for r in Regime if count[r.value])
