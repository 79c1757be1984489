"""The lanes of a continuation as stacked paths, and what their ratios refer to."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.branches.along import Along
from vibrojax.ensemble.lanes import stacked
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.batches import in_batches
from vibrojax.steady.paths import AbstractPath, ParameterPath, frequency_path, localise


@eqx.filter_jit
def frequency_paths(systems: AbstractSystem, is_ratio: bool, exact: bool) -> AbstractPath:
    """Make the paths along the frequency of stacked systems."""
    return jax.vmap(lambda s: frequency_path(s, is_ratio, exact))(systems)


def paths_of(along: Along, exact: bool) -> AbstractPath:
    """Make the stacked paths of all lanes."""
    if along.name in ("frequency_ratio", "frequency"):
        return frequency_paths(stacked(along.systems), along.name == "frequency_ratio", exact)
    count = len(along.labels)
    rows = {n: jnp.asarray([labels[n] for labels in along.labels]) for n in along.labels[0]}
    fixed = {n: jnp.full(count, v, float) for n, v in along.fixed.items()}
    return ParameterPath(
        make=along.make,
        name=along.name,
        fixed=rows | fixed,
        static=along.static,
        frequency=jnp.full(count, along.frequency),
        is_ratio=along.is_ratio,
    )


@eqx.filter_jit
def _references(paths: AbstractPath, parameter):
    def one(path, p):
        place = path.at(p)
        reference, _ = place.drive.reference
        return jnp.asarray(reference, float), place.equations.angular_frequency[0]

    return jax.vmap(one)(paths, parameter)


def references(
    paths: AbstractPath, lane: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return drive amplitude (the reference of ratios) and first natural angular frequency."""
    paths = jax.device_get(paths)
    return in_batches(
        lambda i: _references(localise(paths, lane[i], values[i], False), values[i]), len(lane)
    )
