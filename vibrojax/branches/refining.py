"""Special points between the points of a walk: folds, period doublings, Neimark-Sacker points.

Between two motions of one family, or of a touch and the first motion behind it, the curve is
smooth: a special point is where one number passes zero.
"""

from collections.abc import Callable, Generator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from vibrojax.branches.special_points import doubling_test, on_circle, torus_test
from vibrojax.branches.walking import Ask, Look, OnCurve, Seen, Touch, Walk

ROUNDS = 60
SOLVED = {"fold": 1e-8, "period_doubling": 1e-11, "neimark_sacker": 1e-11}
"""How near to zero a number is to come, over its size next to it; a fold is flat."""
AT_TOUCH = 1e-7
"""Duration of a contact, over that where a fold was looked for from, that is as good as a touch."""
NEAR_CIRCLE = 1e-3


class Special(NamedTuple):
    """A special point of a walk."""

    kind: str
    motion: OnCurve
    seen: Seen
    after: int
    """Index of the point of the walk before it."""


Tests = dict[str, float]


def tests_of(motion: OnCurve) -> Tests:
    """Numbers that pass zero at special points, by kind."""
    multipliers = np.linalg.eigvals(motion.matrix)[None] + 0j
    return {
        "fold": motion.parameter_along,
        "period_doubling": float(doubling_test(multipliers)[0]),
        "neimark_sacker": float(torus_test(multipliers)[0]),
    }


def _on_circle(motion: OnCurve) -> bool:
    return bool(on_circle(np.linalg.eigvals(motion.matrix)[None] + 0j, NEAR_CIRCLE)[0])


def special_points_of(walk: Walk) -> Generator[Any, Any, list[Special]]:
    """Find all special points of a walk, in order along it."""
    tests = [tests_of(point) for point in walk.points]
    behind = {(t.at if t.entering else t.at - 1): t for t in walk.touches}
    found: list[Special] = []
    for k, (a, b) in enumerate(pairwise(tests)):
        for kind in a:
            if a[kind] * b[kind] < 0:
                special = yield from _between(walk, k, kind, a[kind], b[kind], behind.get(k))
                if special is not None:
                    found.append(special)
    for touch in walk.touches:
        point, seen = walk.points[touch.at], walk.seen[touch.at]
        kind = "contact_change" if touch.stop in point.contacts.stops else "grazing"
        found.append(Special(kind, point, seen, max(touch.at - 1, 0)))
    return sorted(found, key=lambda special: special.after)


def _between(
    walk: Walk, k: int, kind: str, first: float, last: float, touch: Touch | None
) -> Generator[Any, Any, Special | None]:
    """Refine the special point between the points k and k + 1."""
    solved, number = SOLVED[kind], lambda motion: tests_of(motion)[kind]
    if touch is None:
        a, b = walk.points[k], walk.points[k + 1]
        found = yield from root(on_the_way(walk, a), number, solved, 0.0, b.way, first, last)
    else:
        # Counted by how long the new contact lasts, from the touch.
        at, other, ends = (k, k + 1, (first, last)) if touch.entering else (k + 1, k, (last, first))
        lasting = walk.points[other]
        i, j = touch.places
        whole = float(lasting.times[j] - lasting.times[i])
        place = by_duration(walk, walk.points[at], lasting, touch)
        found = yield from root(place, number, solved, 0.0, whole, *ends)
    motion, at_touch = found
    if at_touch:
        if kind != "fold":
            return None
        kind, motion = "touch_fold", walk.points[k if touch is None or touch.entering else k + 1]
    if kind == "neimark_sacker" and not _on_circle(motion):
        return None
    (seen,) = yield Look([motion])
    return Special(kind, motion, seen, k)


def on_the_way(walk: Walk, a: OnCurve) -> Callable[[float], Generator[Any, Any, Any]]:
    """Solve for motions of one family by their way from another."""

    def at(way: float) -> Generator[Any, Any, OnCurve | None]:
        found = yield from walk.solve(walk.ahead(a, way))
        return walk.oriented(found, a) if found is not None and walk.is_sound(found) else None

    return at


def by_duration(
    walk: Walk, touch: OnCurve, lasting: OnCurve, of: Touch
) -> Callable[[float], Generator[Any, Any, Any]]:
    """Solve for motions between a touch and one with the new contact by how long it lasts."""
    i, j = of.places
    whole = float(lasting.times[j] - lasting.times[i])
    by_times = np.zeros(len(lasting.times))
    by_times[[i, j]] = -1.0, 1.0
    same_cut = touch.contacts.section == lasting.contacts.section
    middle = float(lasting.times[i] + lasting.times[j]) / 2

    def at(duration: float) -> Generator[Any, Any, OnCurve | None]:
        share = (duration / whole) ** 2
        state = lasting.state
        parameter = touch.parameter + share * (lasting.parameter - touch.parameter)
        times = lasting.times.copy()
        if same_cut:
            state = touch.state + share * (lasting.state - touch.state)
            others = np.delete(np.arange(len(times)), [i, j])
            times[others] = touch.times + share * (times[others] - touch.times)
        times[[i, j]] = middle - duration / 2, middle + duration / 2
        found = yield from walk.solve(
            Ask(lasting.contacts, times, state, parameter, by_times=by_times, value=duration)
        )
        if found is None or not walk.is_sound(found):
            return None
        grows = found.times_along @ by_times > 0
        return found if grows == of.entering else found.reversed()

    return at


def root(
    at: Callable[[float], Generator[Any, Any, Any]],
    number: Callable[[OnCurve], float],
    solved: float,
    low: float,
    high: float,
    below: float,
    above: float,
) -> Generator[Any, Any, tuple[OnCurve | None, bool]]:
    """Find where a number of motions passes zero; also whether that is at the touch itself.

    `at` solves for a motion by its place between `low` and `high`; there the number is `below` and
    `above`. It is found to `solved` of the larger of these.
    """
    scale, whole, best = max(abs(below), abs(above)), high, None
    side = 0
    for _ in range(ROUNDS):
        share = below / (below - above)
        middle = low + min(max(share, 0.02), 0.98) * (high - low)
        motion = yield from at(middle)
        if motion is None:
            # Where there is no motion, as next to a touch, look nearer to where there is one.
            middle = (low + high) / 2
            motion = yield from at(middle)
        if motion is None:
            if high < AT_TOUCH * whole or high - low < 1e-6 * whole:
                break
            low += (high - low) / 2
            continue
        best = motion
        value = number(motion)
        if abs(value) <= solved * scale or high - low <= 1e-13 * whole:
            return motion, False
        if (value > 0) == (below > 0):
            low, below = middle, value
            above = above / 2 if side == 1 else above
            side = 1
        else:
            high, above = middle, value
            below = below / 2 if side == -1 else below
            side = -1
    if best is None or high < 10 * AT_TOUCH * whole:
        return None, True
    return best, False
