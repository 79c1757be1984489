"""The programs that a pool of lanes runs, in widths that compile once."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.machine import second_level_cache
from vibrojax.steady.following import advance
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.map_orbits import no_orbits, to_orbit
from vibrojax.steady.settling import begin_search, found_period, march_until
from vibrojax.steady.tracks import no_tracks
from vibrojax.stepping.elementary import on_cpu
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

WIDTHS = {"cpu": (2, 16, 32, 64, 128), "gpu": (64, 1024, 8192)}
"""How many lanes run side by side in one loop: for two, for some, for many."""
CACHES = 2.0
"""Most that the numbers of the lanes of a loop may fill of the second-level cache of a CPU: with 20
modes more of them are slower by a quarter, with 12 not yet."""
POINTS = 64
"""Of all lanes together for which motions are solved in one call, one of each at the least: calls
cost more than few lanes take, but many lanes would wait for the one that gets furthest."""


@compiled
def march_some(march, search, frequency, limit, max_periods, still):
    """March lanes until all but `still` of them have settled; also the periods found."""
    march, search = march.lanes_last(), search.lanes_last()
    weight = march.energy_weight()
    search = march_until(march, weight, search, frequency, limit, max_periods, still)
    return table_of((search, found_period(search, limit)))


@compiled
def polish_some(march, orbits, state, frequency, period):
    """Put states on orbits; also where those are to be taken, as the last column."""
    march, last = march.lanes_last(), orbits.lanes_last()
    return table_of(to_orbit(march, last, state.T, frequency, period))


@compiled
def measure_some(march, state, frequency, window):
    """March over a window, with measures; also the steps taken."""
    return table_of(march.lanes_last()(state.T, frequency, window, True))


def all_widths() -> tuple[int, ...]:
    """Return the widths for the device that programs run on."""
    return WIDTHS.get(jax.default_backend(), WIDTHS["gpu"])


def widths_for(lanes: int, numbers: int) -> tuple[int, ...]:
    """Return the widths in which so many lanes run that have so many numbers each, narrowest first.

    Few lanes have one width, many a narrow one for the stragglers too: each compiles.
    """
    few, some, *more = all_widths()
    if lanes <= few:
        return (few,)
    if on_cpu():
        room = CACHES * second_level_cache() / (8 * numbers)
        more = [width for width in more if width <= room]
    wide = next((width for width in (some, *more) if width >= lanes), (some, *more)[-1])
    return tuple(sorted({some, wide}))


def widths_to_measure(lanes: int, numbers: int) -> tuple[int, ...]:
    """Return the widths in which points of so many lanes are measured: few lanes have several."""
    few = all_widths()[0]
    return widths_for(lanes, numbers) if lanes > few else (4 * few,)  # wider it compiles longer


def targets_for(width: int) -> int:
    """Return how many points ahead motions are solved for in one call."""
    return max(1, POINTS // width)


def filled(own: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    """Return some lanes, the last again and again up to the next width."""
    width = next(w for w in widths if w >= len(own))
    return own[np.minimum(np.arange(width), len(own) - 1)]


def in_widths(
    lanes: np.ndarray, widths: tuple[int, ...]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Lanes that run in one loop, and the same filled up to its width, loop by loop."""
    for own in np.split(lanes, np.arange(widths[-1], len(lanes), widths[-1])):
        if len(own):
            yield own, filled(own, widths)


def measured(
    rigs: LaneTable,
    rig: Int[np.ndarray, " points"],
    state: Float[np.ndarray, "points states"],
    frequency: Float[np.ndarray, " points"],
    window: Int[np.ndarray, " points"],
    widths: tuple[int, ...],
) -> Any:
    """March rigs over windows, with measures: where they end, steps and measures, in numpy."""
    parts = []
    for own, at in in_widths(np.arange(len(rig)), widths):
        table = measure_some(rigs.pick(rig[at]), state[at], frequency[at], window[at])
        parts.append(replace(table, numbers=np.asarray(table.numbers)[: len(own)]))
    return replace(parts[0], numbers=np.concatenate([part.numbers for part in parts])).columns()


def compile_ahead(march: AbstractMarch, lanes: int, max_period: int, follow: bool) -> None:
    """Compile in the background what a pool of so many lanes will run.

    Of `march`, whose rigs are its trailing axis, only the shapes are looked at.
    """
    states = jax.eval_shape(lambda march: march.energy_weight(), march).shape[0]

    def some(width: int) -> tuple[LaneTable, np.ndarray, np.ndarray]:
        return table_of(march, lanes=width), np.zeros((width, states)), np.ones(width)

    numbers = table_of(march, lanes=1).numbers.shape[1]
    widths = widths_for(lanes, numbers)
    for width in reversed(widths):
        own, state, ones = some(width)
        search = table_of(begin_search(state.T, max_period, np), xp=np)
        march_some.ahead(own, search, ones, ones, ones.astype(np.int32), np.int32(0))
    for width in reversed(widths_to_measure(lanes, numbers)):
        own, state, ones = some(width)
        measure_some.ahead(own, state, ones, ones.astype(np.int32))
    for width in reversed(widths):
        own, state, ones = some(width)
        if follow and isinstance(march, ExactMarch):
            tracks, targets = no_tracks(width, states), np.ones((targets_for(width), width))
            advance.ahead(own, tracks, targets, np.ones((2, width)), np.asarray(0))
        else:
            orbits = no_orbits(width, states)
            polish_some.ahead(own, orbits, state, ones, ones.astype(np.int32))
