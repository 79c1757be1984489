"""Quasi-random places, even where there are few of them."""

from typing import Any

import numpy as np
import scipy
from jaxtyping import Float


def sobol_sequence(count: int, numbers: int, seed: int) -> Float[np.ndarray, "places numbers"]:
    """Return the first places of Sobol's sequence in the unit cube, scrambled by the seed.

    Source: Owen 1998, Journal of Complexity 14. `count` need not be a power of two, but only then
    is the sequence balanced.
    """
    seeded: Any = {"seed": seed}  # `rng` since scipy 1.15, which takes both
    sequence = scipy.stats.qmc.Sobol(numbers, **seeded)
    return sequence.random_base2(int(count - 1).bit_length())[:count]
