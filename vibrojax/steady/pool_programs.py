"""The programs that a pool of lanes runs, in widths that compile once."""

import jax
import numpy as np

from vibrojax._tools.compiled import compiled
from vibrojax.steady.following import advance, no_tracks
from vibrojax.steady.lane_table import table_of
from vibrojax.steady.settling import begin_search, found_period, march_until, polish
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

WIDTHS = {"cpu": (2, 16, 128), "gpu": (64, 1024, 8192)}
"""How many lanes run side by side in one loop: on a CPU their tables have to stay in the cache."""


@compiled
def march_some(march, search, frequency, limit, max_periods, still):
    """March lanes until all but `still` of them have settled; also the periods found."""
    march, search = march.lanes_last(), search.lanes_last()
    weight = march.energy_weight()
    search = march_until(march, weight, search, frequency, limit, max_periods, still)
    return table_of((search, found_period(search, limit)))


@compiled
def polish_some(march, state, frequency, period):
    """Put states on their orbits; also where that was good."""
    march = march.lanes_last()
    state, good = polish(march, march.energy_weight(), state.T, frequency, period)
    return state.T, good


@compiled
def measure_some(march, state, frequency, window):
    """March over a window, with measures; also the steps taken."""
    return table_of(march.lanes_last()(state.T, frequency, window, True))


def widths_for(lanes: int) -> tuple[int, ...]:
    """Return the widths in which so many lanes are run, the narrowest first."""
    widths = WIDTHS.get(jax.default_backend(), WIDTHS["gpu"])
    enough = next((i for i, w in enumerate(widths) if w >= lanes), len(widths) - 1)
    # Few lanes have one width, many a narrow one for the stragglers too: each compiles.
    return widths[max(1, enough - 1) : enough + 1] if enough else widths[:1]


def filled(own: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    """Return some lanes, the last again and again up to the next width."""
    width = next(w for w in widths if w >= len(own))
    return own[np.minimum(np.arange(width), len(own) - 1)]


def compile_ahead(march: AbstractMarch, lanes: int, max_period: int, follow: bool) -> None:
    """Compile in the background what a pool of so many lanes will run.

    Of `march`, whose rigs are its trailing axis, only the shapes are looked at.
    """
    states = jax.eval_shape(lambda march: march.energy_weight(), march).shape[0]
    for width in reversed(widths_for(lanes)):
        own, state, ones = table_of(march, lanes=width), np.zeros((width, states)), np.ones(width)
        search = table_of(begin_search(state.T, max_period, np), xp=np)
        whole = np.ones(width, np.int32)
        march_some.ahead(own, search, ones, ones, np.asarray(0), np.int32(0))
        measure_some.ahead(own, state, ones, whole)
        if follow and isinstance(march, ExactMarch):
            advance.ahead(own, no_tracks(width, states), ones)
        else:
            polish_some.ahead(own, state, ones, whole)
