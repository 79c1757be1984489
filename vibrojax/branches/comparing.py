"""A sweep beside the branch of the same system, and isolas of it: which of its points are on it."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from vibrojax.branches.points import BranchPoints
from vibrojax.branches.resampling import resample
from vibrojax.results.variables import described_as
from vibrojax.sweep.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    import xarray

SAME = 1e-6
"""Relative difference up to which two motions are one."""
COMPARED = ("amplitude_ratio", "rms_ratio", "contact_force")


def relative_difference(
    passages: "xarray.Dataset", motions: Mapping[str, Any]
) -> Float[np.ndarray, "..."]:
    """Largest relative difference of motions from passages of a branch, those along the last axis.

    NaN where there is no passage.
    """
    differences = []
    for name in COMPARED:
        own = motions[name]
        size = np.maximum(np.abs(own), np.nanmax(np.abs(own), initial=0.0) * 1e-3)
        differences.append(np.abs(passages[name].values - own) / np.where(size, size, 1.0))
    return np.asarray(np.maximum.reduce(differences))


def compare(branch: BranchPoints, sweep: FrequencyResponse) -> "xarray.Dataset":
    """Compare a sweep with a branch; see `Branch.compare`."""
    import xarray

    swept = sweep.to_xarray()
    if any(len(values) > 1 for values in sweep.axes.values()):
        raise ValueError("sweep must be of one system: pick one value of every axis.")
    swept = swept.squeeze(drop=True) if sweep.axes else swept
    if branch.axis not in swept["amplitude_ratio"].dims:
        raise ValueError(
            f"The branch runs along {branch.axis}, the sweep along "
            f"{swept['amplitude_ratio'].dims[-1]}: compare them along the same axis."
        )
    dims = ("direction", branch.axis)
    values = swept[branch.axis].values
    low, high = branch.range
    inside = (values >= low) & (values <= high)
    differences = np.full((swept.sizes["direction"], len(values)), np.nan)
    if inside.any():
        own = {n: swept[n].transpose(*dims).values[:, inside, None] for n in COMPARED}
        pieces = [resample(piece, values[inside]) for piece in (branch, *branch.isolas)]
        far = np.concatenate([relative_difference(piece, own) for piece in pieces], axis=-1)
        least = np.where(np.isnan(far), np.inf, far).min(axis=-1, initial=np.inf)
        same = swept["period"].transpose(*dims).values[:, inside] == branch.period
        differences[:, inside] = np.where(same, least, np.nan)
    on_branch = np.where(np.isnan(differences), -1, differences <= SAME).astype(np.int8)
    data = {
        "relative_difference": (dims, differences, described_as("relative_difference")),
        "on_branch": (dims, on_branch, described_as("on_branch")),
    }
    return xarray.Dataset(data, {n: swept[n] for n in dims}, attrs=dict(branch.attributes))
