"""Evaluators in closed form."""

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.design.evaluation import AbstractEvaluator, Evaluation


class Analytic(AbstractEvaluator):
    """Functions of an array of numbers, with slopes by JAX; none where `lost` says why."""

    def __init__(self, names, functions, lost=lambda place: ""):
        self.names, self.functions = tuple(names), tuple(functions)
        self.lost, self.batches = lost, []
        every = lambda place: jnp.stack([f(place) for f in functions.values()])  # noqa: E731
        self.values, self.slopes = jax.jit(jax.vmap(every)), jax.jit(jax.vmap(jax.jacfwd(every)))

    def evaluate(self, places, *, slopes=True):
        self.batches.append(len(places))
        values = np.array(self.values(places))
        shape = (*values.shape, places.shape[1])
        each = np.array(self.slopes(places)) if slopes else np.full(shape, np.nan)
        notes = [self.lost(place) for place in places]
        for k, note in enumerate(notes):
            if note:
                values[k], each[k] = np.nan, np.nan
        return [Evaluation(*one) for one in zip(values, each, notes, strict=True)]
