"""What the results of regimes and diagrams share: datasets, files, picking a lane."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax._checks import nearest
from vibrojax.results.branch import axis_description
from vibrojax.results.regime_kinds import Regime
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
    told: dict[str, Any] = {
        "units": ratio_units if known.units == "ratio" else known.units,
        "long_name": known.long_name,
    }
    if name in FLAGS:
        told |= {
            "flag_values": list(range(len(FLAGS[name]))),
            "flag_meanings": " ".join(FLAGS[name]),
        }
    return told


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
    own: dict[str, Any] = {}
    for name, values in coordinates.items():
        numbers = np.asarray(values)
        told = axis_description(name) if numbers.dtype.kind in "fiu" else {}
        own[name] = ((name,), numbers, told)
    if "displacement" in variables:
        count = variables["displacement"].shape[-1]
        told = {"units": "1", "long_name": VARIABLES["strobe"].long_name}
        own["strobe"] = (("strobe",), np.arange(count), told)
    if orders is not None and "spectrum" in variables:
        told = {"units": "1", "long_name": VARIABLES["order"].long_name}
        own["order"] = (("order",), orders, told)
    return xarray.Dataset(data, own, attrs=dict(attributes))


def pick(
    coordinates: Mapping[str, Array], selection: Mapping[str, Any]
) -> tuple[tuple[Any, ...], dict[str, Any], list[str]]:
    """Return the index of a selection (nearest values), what was chosen, and the axes left.

    Raises `ValueError` for an unknown axis or a value that is none of it.
    """
    for name in selection:
        if name not in coordinates:
            raise ValueError(f"Unknown axis {name!r}. {nearest(name, coordinates)}")
    index: list[Any] = []
    chosen: dict[str, Any] = {}
    for name, values in coordinates.items():
        if name not in selection:
            index.append(slice(None))
            continue
        values, wanted = np.asarray(values), selection[name]
        if values.dtype.kind not in "fiu":
            if wanted not in values.tolist():
                known = ", ".join(map(repr, values.tolist()))
                raise ValueError(f"{name} must be one of {known}, got {wanted!r}.")
            at = values.tolist().index(wanted)
        elif np.ndim(wanted) or isinstance(wanted, str) or not np.isfinite(wanted):
            raise ValueError(f"{name} must be one finite number, got {wanted!r}.")
        else:
            at = int(np.argmin(np.abs(values - wanted)))
        index.append(at)
        chosen[name] = values[at].item()
    return tuple(index), chosen, [name for name in coordinates if name not in selection]


def tally(kind: Array) -> str:
    """Say how many lanes there are of each kind of motion."""
    count = np.bincount(np.asarray(kind).ravel(), minlength=len(Regime))
    return ", ".join(f"{count[r.value]} {r.word}" for r in Regime if count[r.value])
