"""Datasets to files."""

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray


def save_dataset(dataset: "xarray.Dataset", path: str | os.PathLike[str]) -> None:
    """Write a dataset to a NetCDF file, whole or not at all."""
    target = os.fspath(path)
    part = f"{target}.part"
    try:
        dataset.to_netcdf(part, engine="h5netcdf")
        os.replace(part, target)
    finally:
        if os.path.exists(part):
            os.remove(part)
