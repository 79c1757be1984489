"""What a branch says of its motions."""

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.compiled import compiled
from vibrojax.steady.balanced_motion import read_all
from vibrojax.steady.batches import in_batches
from vibrojax.steady.paths import AbstractPath, FrequencyPath, localise

Columns = dict[str, np.ndarray]


@compiled
def _references(paths: AbstractPath, parameter):
    def one(path, p):
        place = path.at(p)
        reference, _ = place.drive.reference
        return jnp.asarray(reference, float), place.equations.angular_frequency[0]

    return jax.vmap(one)(paths, parameter)


def references(
    paths: AbstractPath, lane: np.ndarray, values: np.ndarray, exact: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes of the drive and first natural frequencies (Hz) of lanes at some values.

    `exact` as the motions there are looked at, whose programs then serve here too.
    """
    paths, back = jax.device_get(paths), slice(None)
    if isinstance(paths, FrequencyPath):  # the same at every frequency
        lane, first, back = np.unique(lane, return_index=True, return_inverse=True)
        values = values[first]
    reference, natural = in_batches(
        lambda i: _references(localise(paths, lane[i], values[i], exact), values[i]), len(lane)
    )
    return reference[back], natural[back] / 2 / np.pi


def columns_of(
    paths: AbstractPath, lane: np.ndarray, depth: np.ndarray, values: np.ndarray, period: int
) -> Columns:
    """Return the columns of a branch at balanced motions of some lanes; displacements as ratios.

    `depth` are the spectra of their averaged depths.
    """
    read = read_all(paths, lane, depth, values, period=period)
    reference, natural = references(paths, lane, values, False)
    columns = {
        "values": values,
        "amplitude_ratio": (read.highest - read.lowest) / 2 / reference,
        "peak_ratio": np.maximum(read.highest, -read.lowest) / reference,
        "rms_ratio": np.sqrt(read.mean_square) / reference,
        "first_harmonic_ratio": read.first_harmonic / reference,
        "contact_force": read.contact_force,
        "contact_fraction": read.contact_fraction,
        "contacts_per_period": read.contacts / period,
        "floquet_multipliers": read.multipliers,
        "residual": read.residual,
        "initial_state": read.initial_state,
        "exact_points": np.zeros(len(lane), bool),
        "natural_frequency": natural,
    }
    return {name: np.asarray(column) for name, column in columns.items()}
