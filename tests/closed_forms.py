"""Functions of designs in closed form, for tests of searches."""

import _thread
import time
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
        size = -(-len(places) // 64) * 64  # one program for all
        whole = np.resize(places, (size, places.shape[1]))
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


class Interrupted(ClosedForm):
    """Ctrl-C comes with some batch, which then goes on for long."""

    def __init__(self, *args, batch):
        super().__init__(*args)
        self.batch = batch

    def evaluate(self, places, *, slopes=True):
        if len(self.batches) == self.batch:
            _thread.interrupt_main()
            for _ in range(100):
                time.sleep(0.1)
        return super().evaluate(places, slopes=slopes)


def rosenbrock(place):
    x, y = place
    return (1 - x) ** 2 + 100 * (y - x**2) ** 2
