"""Branches over a range of the number that is followed: the one way in which all are traced.

Continuations, identification and the explorer differ in how exact a point has to be, and in what
they try when a branch does not reach its end.
"""

import jax
import numpy as np
from jaxtyping import Complex, Float

from vibrojax._tools.types import AnyArray
from vibrojax.branches.continuation import LONGEST_STEP, Ending, Settings, begin, follow
from vibrojax.branches.tracing import Traced, free_motion, put
from vibrojax.steady.batches import one_or_many, take
from vibrojax.steady.paths import AbstractPath

WIDTHS = (1, 32)
"""Lanes in one loop; the number compiled is the least of these that holds them all."""


def scale_of(low: float, high: float, largest: float) -> float:
    """Change of the number followed that counts as much as the motion changing by its size."""
    return min(largest, (high - low) / 0.5)


def trace_over(
    paths: AbstractPath,
    start: Float[AnyArray, " lanes"],
    low: float,
    high: float,
    *,
    scale: float,
    way: Float[AnyArray, " lanes"] | float = 1.0,
    guess: Complex[AnyArray, "lanes stops harmonics"] | None = None,
    tolerance: float = 1e-4,
    longest: float = LONGEST_STEP,
    samples: int,
    period: int = 1,
    harmonics: int | None = None,
    max_points: int = 2000,
    widths: tuple[int, ...] = WIDTHS,
) -> list[Traced]:
    """Follow the branch of every lane from its `start` within a range, upwards or (`way` -1) down.

    It starts from a motion without contact, or from a `guess`. `scale` is of `scale_of`; `samples`
    and `harmonics` are per drive period.
    """
    # Lanes are put in and taken out on the host: single operations on a device cost more, and
    # compile anew for every number of lanes.
    paths = jax.device_get(paths)
    ones = np.ones(len(start))
    settings = Settings(
        start=np.asarray(start, float),
        low=low * ones,
        high=high * ones,
        direction=way * ones,
        scale=scale * ones,
        tolerance=np.asarray(tolerance),
        longest=np.asarray(float(longest)),
    )
    lanes = len(settings.start)
    width = next((w for w in widths if w >= lanes), widths[-1])
    waiting = list(range(lanes))
    places: list[int | None] = [None] * width
    found: dict[int, list] = {lane: [] for lane in range(lanes)}
    done: dict[int, Traced] = {}
    if guess is None:
        index = one_or_many(lanes, widths[-1])
        at = settings.start[index]
        guess = np.asarray(free_motion(take(paths, index), at, samples * period, period))[:lanes]
    begun = begin(jax.device_get(guess), settings.start)
    kept_harmonics = None if harmonics is None else harmonics * period
    trace = take(begun, np.zeros(width, int))
    trace = trace._replace(status=np.full(width, Ending.completed.value, np.int32))
    index = np.zeros(width, int)
    here = None
    while len(done) < lanes:
        for place in range(width):
            if places[place] is None and waiting:
                lane = waiting.pop(0)
                places[place], index[place] = lane, lane
                trace, here = jax.device_get(trace), None
                trace = put(trace, take(begun, np.array([lane])), np.array([place]))
        if here is None:
            chosen = Settings(*(s if s.ndim == 0 else s[index] for s in settings))
            here = jax.device_put((take(paths, index), chosen))
        trace, points = follow(
            *here, trace, samples=samples * period, period=period, harmonics=kept_harmonics
        )
        accepted = np.asarray(points.accepted)
        columns = [np.asarray(a) for a in (points.parameter, points.depth, points.direction)]
        status, ticks = np.asarray(trace.status), np.asarray(trace.ticks)
        for place, lane in enumerate(places):
            if lane is None:
                continue
            kept = accepted[:, place]
            found[lane].append([c[kept, place] for c in columns])
            count = sum(len(part[0]) for part in found[lane])
            ending = Ending(int(status[place]))
            over = count > max_points or ticks[place] > 8 * max_points
            if ending is not Ending.running or over:
                values, depth, change = map(np.concatenate, zip(*found[lane], strict=True))
                done[lane] = Traced(values, depth, change, ending, int(ticks[place]))
                places[place] = None
                if over:
                    stuck = np.int32(Ending.stuck.value)
                    trace = trace._replace(status=put(trace.status, stuck, np.array(place)))
    return [done[lane] for lane in range(lanes)]
