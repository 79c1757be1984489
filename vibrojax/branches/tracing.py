"""What is traced of a balanced branch."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.compiled import compiled
from vibrojax.branches.continuation import Ending
from vibrojax.steady.condensed import condensed_problem
from vibrojax.steady.paths import AbstractPath
from vibrojax.stepping.resonance import is_unbounded, undamped_at


class Traced(NamedTuple):
    """The points of one lane, along its branch."""

    parameter: np.ndarray
    depth: np.ndarray
    direction: np.ndarray
    """Change of the parameter along the branch."""
    ending: Ending
    ticks: int


@compiled
def free_motion(paths: AbstractPath, parameter, samples: int, period: int):
    """Averaged depths without contact, of every lane: the first guess. NaN where it is endless."""

    def one(path, p):
        place = path.at(p)
        problem = condensed_problem(place, samples=samples, period=period)
        resonances = undamped_at(place.equations, place.drive)
        endless = is_unbounded(resonances, place.angular_frequency)
        return jnp.where(endless, jnp.nan, problem.drive)

    return jax.vmap(one)(paths, parameter)


def put(whole: Any, part: Any, at: np.ndarray) -> Any:
    """Return a stacked tree with some lanes replaced."""

    def one(a, b):
        a = np.array(a)
        a[at] = b
        return a

    return jax.tree.map(one, whole, part)
