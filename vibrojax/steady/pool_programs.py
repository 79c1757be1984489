"""The programs that a pool of lanes runs, in widths that compile once."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.compiled import compiled
from vibrojax.steady.batches import take_rigs
from vibrojax.steady.following import advance, no_tracks
from vibrojax.steady.settling import begin_search, found_period, march_until, polish
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

WIDTHS = {"cpu": (2, 16, 128), "gpu": (64, 1024, 8192)}
"""How many lanes run side by side in one loop: on a CPU their tables have to stay in the cache."""


# On the host the lanes lead; the loops want them last.
def _swapped(tree: Any, source: int, destination: int) -> Any:
    return jax.tree.map(lambda a: jnp.moveaxis(a, source, destination), tree)


@compiled
def march_some(march, rigs, search, frequency, limit, max_periods, still):
    """March lanes until all but `still` of them have settled; also the periods found."""
    own, search = take_rigs(march, rigs), _swapped(search, 0, -1)
    search = march_until(own, own.energy_weight(), search, frequency, limit, max_periods, still)
    return _swapped(search, -1, 0), found_period(search, limit)


@compiled
def polish_some(march, rigs, state, frequency, period):
    """Put states on their orbits; also where that was good."""
    own = take_rigs(march, rigs)
    state, good = polish(own, own.energy_weight(), state.T, frequency, period)
    return state.T, good


@compiled
def measure_some(march, rigs, state, frequency, window):
    """March over a window, with measures; also the steps taken."""
    end, steps, measures = take_rigs(march, rigs)(state.T, frequency, window, True)
    return end.T, steps, measures


def widths_for(lanes: int) -> tuple[int, ...]:
    """Return the widths in which so many lanes are run, the narrowest first."""
    widths = WIDTHS.get(jax.default_backend(), WIDTHS["gpu"])
    enough = next((i for i, w in enumerate(widths) if w >= lanes), len(widths) - 1)
    # Few lanes have one width, many a narrow one for the stragglers too: each compiles.
    return widths[max(1, enough - 1) : enough + 1] if enough else widths[:1]


def compile_ahead(march: AbstractMarch, lanes: int, max_period: int, follow: bool) -> None:
    """Compile in the background what a pool of so many lanes will run.

    Of `march` only the shapes are looked at.
    """
    states = jax.eval_shape(lambda march: march.energy_weight(), march).shape[0]
    for width in reversed(widths_for(lanes)):
        rig, state, ones = np.zeros(width, int), np.zeros((width, states)), np.ones(width)
        search = _swapped(begin_search(state.T, max_period, np), -1, 0)
        whole = np.ones(width, np.int32)
        march_some.ahead(march, rig, search, ones, ones, np.asarray(0), np.int32(0))
        measure_some.ahead(march, rig, state, ones, whole)
        if follow and isinstance(march, ExactMarch):
            advance.ahead(march, rig, no_tracks(width, states), ones)
        else:
            polish_some.ahead(march, rig, state, ones, whole)
