"""Modes of a beam as a dataset."""

from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray

    from vibrojax.model.modes import Modes


def modes_dataset(modes: "Modes", points: int) -> "xarray.Dataset":
    """Return the numbers of the modes, and their shapes at so many places.

    Raises `ValueError` for a batch of modes: pick one beam.
    """
    import xarray

    if modes.beta.ndim != 1:
        raise ValueError(
            f"Modes of a batch of beams, {modes.beta.shape[:-1]}, are no dataset: pick one, such "
            "as jax.tree.map(lambda a: a[0], modes)."
        )
    names = ("frequency", "beta", "modal_mass", "participation")
    data: dict[str, Any] = {
        name: ("mode", np.asarray(getattr(modes, name)), described_as(name)) for name in names
    }
    data["frequency"][2]["long_name"] = "Natural frequency"
    place = np.linspace(0.0, 1.0, points)
    data["shape"] = (("place", "mode"), np.asarray(modes.shape(place)), described_as("shape"))
    coordinates = {
        "mode": ("mode", np.arange(1, modes.num_modes + 1), described_as("mode")),
        "place": ("place", place, described_as("place")),
    }
    attributes = {"title": "vibrojax modes", "formulation": modes.formulation}
    return xarray.Dataset(data, coordinates, attrs=attributes)
