"""Sobol indices, by SALib: which number makes the scatter, alone and together with others."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

CONFIDENCE = 0.95
FEWEST = 4
"""Base samples that indices are computed from."""


class SobolIndices(eqx.Module):
    """Sobol indices of every measure in every number, with half widths of 95 % intervals.

    Source: Saltelli et al. 2010, Computer Physics Communications 181, table 2; intervals by
    bootstrap, as SALib has them.
    """

    first: Float[np.ndarray, "measures numbers"]
    """Share of the variance that a number makes alone; 0 where a measure does not scatter."""
    first_confidence: Float[np.ndarray, "measures numbers"]
    """Half width of the 95 % interval of `first`."""
    total: Float[np.ndarray, "measures numbers"]
    """Share of the variance that a number has a part in."""
    total_confidence: Float[np.ndarray, "measures numbers"]
    """Half width of the 95 % interval of `total`."""
    base: Int[np.ndarray, " measures"]
    """Base samples with a value at every one of their rigs, which the indices are from."""
    asked: int = eqx.field(static=True)
    """Base samples that there are."""


def salib() -> tuple[Any, Any]:
    """Return SALib's modules for samples and for indices.

    Raises `ImportError` without SALib, which is optional.
    """
    try:
        from SALib.analyze import sobol as analyse  # pyright: ignore[reportMissingImports]
        from SALib.sample import sobol as sample  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError(
            'Sobol indices need SALib, which is optional: pip install "vibrojax[design]". '
            "Without them leave sobol out of the settings."
        ) from None
    return sample, analyse


def _problem(numbers: int) -> dict[str, Any]:
    names = [str(k) for k in range(numbers)]
    return {"num_vars": numbers, "names": names, "bounds": [[0.0, 1.0]] * numbers}


def sobol_probabilities(numbers: int, base: int, seed: int) -> Float[np.ndarray, "rigs numbers"]:
    """Return the base (numbers + 2) cumulative probabilities at which measures are needed."""
    sample, _ = salib()
    return sample.sample(_problem(numbers), base, calc_second_order=False, seed=seed)


def sobol_indices(
    values: Float[np.ndarray, "rigs measures"], numbers: int, seed: int
) -> SobolIndices:
    """Return the indices from the measures at `sobol_probabilities`.

    Base samples with a rig that has no value are left out, measure by measure; where fewer than
    four are left, the indices are NaN.
    """
    _, analyse = salib()
    rows = values.reshape(-1, numbers + 2, values.shape[1])
    found = np.full((4, values.shape[1], numbers), np.nan)
    good = np.asarray(np.isfinite(rows).all(axis=1))
    for k in range(values.shape[1]):
        kept = rows[good[:, k], :, k].ravel()
        if good[:, k].sum() < FEWEST:
            continue
        if np.ptp(kept) == 0:
            found[:, k] = 0.0
            continue
        indices = analyse.analyze(
            _problem(numbers),
            kept,
            calc_second_order=False,
            conf_level=CONFIDENCE,
            seed=seed + 1,  # 0 would be no seed to SALib
        )
        found[:, k] = [indices[name] for name in ("S1", "S1_conf", "ST", "ST_conf")]
    return SobolIndices(*found, base=good.sum(axis=0), asked=len(rows))
