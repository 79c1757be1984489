"""Functions of designs in closed form, for tests of searches."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.design.evaluation import AbstractEvaluator, Evaluation


class ClosedForm(AbstractEvaluator):
    """Functions of a vector of numbers, with their derivatives by JAX."""

    def __init__(
        self,
        functions: dict[str, Callable],
        names: Sequence[str] = ("x", "y"),
        known: Callable = lambda place: True,
        smooth: Callable = lambda place: True,
    ):
        self.names, self.functions = tuple(names), tuple(functions)
        self.known, self.smooth = known, smooth
        self.batches: list[int] = []

        def all_of(place):
            return jnp.stack([jnp.asarray(one(place), float) for one in functions.values()])

        self._values = jax.jit(jax.vmap(all_of))
        self._slopes = jax.jit(jax.vmap(jax.jacfwd(all_of)))

    def evaluate(self, places, *, slopes=True):
        self.batches.append(len(places))
        whole = np.resize(places, (64, places.shape[1]))  # one program for all
        values = np.array(self._values(whole))
        derivatives = np.array(self._slopes(whole))
        found = []
        for k, place in enumerate(places):
            note = ""
            if not self.known(place):
                values[k], derivatives[k], note = np.nan, np.nan, "the branch was lost."
            elif not slopes or not self.smooth(place):
                derivatives[k], note = np.nan, "a fold vanishes." if slopes else ""
            found.append(Evaluation(values[k], derivatives[k], note))
        return found


def rosenbrock(place):
    x, y = place
    return (1 - x) ** 2 + 100 * (y - x**2) ** 2
