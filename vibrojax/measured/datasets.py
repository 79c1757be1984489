"""Tables of datasets with named dimensions, such as those of NetCDF files."""

from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax.measured.table import Table

if TYPE_CHECKING:
    import xarray

OWN = ("amplitude_ratio", "peak_ratio", "rms_ratio", "first_harmonic_ratio")
"""Variables by which a frequency response of our own is known."""


def of_dataset(dataset: "xarray.Dataset", wanted: list[Any], along: str | None) -> Table:
    """Return the table of a dataset, as `read_table` does."""
    import xarray

    if along is not None and along in dataset.dims:
        if "stop" in dataset.dims and "contact_force" in dataset:
            force = dataset["contact_force"]
            dataset = dataset.assign(contact_force=force.sum("stop", keep_attrs=True))
        dataset = dataset[[n for n in dataset.data_vars if dataset[n].dims == (along,)]]

    asked = [name for name in wanted if isinstance(name, str) and name in dataset.data_vars]
    names = [n for n in asked if dataset[n].ndim] or [n for n in dataset.data_vars]
    own = set(OWN) <= set(dataset.data_vars)
    names = [OWN[0]] if own else names
    if not names:
        raise ValueError("The dataset has no variables.")
    dims = max((dataset[name].dims for name in names), key=len)
    needed = set(dims) - {"direction"}
    kept = {}
    for name, variable in dataset.variables.items():
        is_axis = name in dataset.coords and variable.ndim > 0
        if set(variable.dims) <= set(dims) and (is_axis or needed <= set(variable.dims)):
            kept[str(name)] = dataset[name]
    spread = xarray.broadcast(*(array.reset_coords(drop=True) for array in kept.values()))
    columns = {n: a.transpose(*dims).values.ravel() for n, a in zip(kept, spread, strict=True)}
    units = {n: str(a.attrs["units"]) for n, a in kept.items() if "units" in a.attrs}
    inner = tuple(str(d) for d in dims[:-1] if d != "direction" and dataset.sizes[d] > 1)
    attached = {}
    if own:
        for name, value in dataset.coords.items():
            single = value.size == 1 and name not in ("direction", *dims[-1:])
            if single and value.dtype.kind in "fiu":
                attached[str(name)] = float(value.values.ravel()[0])
    rows = int(np.prod([dataset.sizes[d] for d in dims]))
    return Table(columns, units, np.arange(1, rows + 1), "row", "", attached, inner)
