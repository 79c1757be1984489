"""Special points between the points of a walk: folds, period doublings, Neimark-Sacker points.

Between two motions of one family, or of a touch and the first motion behind it, the curve is
smooth: a special point is where one number passes zero.
"""

from collections.abc import Generator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from vibrojax.branches.on_curve import Look, OnCurve, Seen, Steps
from vibrojax.branches.special_points import doubling_test, on_circle
from vibrojax.branches.stretch import Number, Stretch
from vibrojax.branches.walking import Walk

SOLVED = {"fold": 1e-8, "period_doubling": 1e-11, "neimark_sacker": 1e-11}
"""How near to zero a number is to come, over its size next to it; a fold is flat."""
NEAR_CIRCLE = 1e-3
SHARES, MOVED = (1 / 8, 1 / 4, 1 / 2), 0.3
"""Where it is looked next to a touch, over the duration of the contact at the next point, if sizes
of multipliers change by so much until then."""


class Special(NamedTuple):
    """A special point of a walk."""

    kind: str
    motion: OnCurve
    seen: Seen
    after: int
    """Index of the point of the walk before it."""
    refined: bool


Unseen = tuple[str, OnCurve, int, bool]
"""The same before its motion was marched: kind, motion, point before, whether it is refined."""


def _crossing(place: int) -> Number:
    """How far the multiplier of this place among the largest is outside of the circle."""
    return lambda motion: float(motion.moduli[place]) - 1.0


def _numbers(a: OnCurve, b: OnCurve) -> dict[str, Number]:
    """Numbers that pass zero between two motions where there is a special point, by kind."""
    numbers: dict[str, Number] = {
        "fold": lambda motion: motion.parameter_along,
        "period_doubling": lambda motion: float(doubling_test(motion.multipliers)),
    }
    outside = sorted(int(np.sum(motion.moduli > 1)) for motion in (a, b))
    if outside[1] - outside[0] >= 2:
        numbers["neimark_sacker"] = _crossing(outside[0])
    return numbers


def special_points_of(walk: Walk) -> Generator[Any, Any, list[Special]]:
    """Find all special points of a walk, in order along it."""
    found: list[Special] = []
    solved: list[Unseen] = []
    for k in range(len(walk.points) - 1):
        if walk.is_leap(k):
            found += _leapt_over(walk, k)
            continue
        stretch = walk.stretch(k)
        places = [stretch.ends[0], *_doubtful(walk, k, stretch), stretch.ends[1]]
        motions = yield from stretch.each(places[1:-1])
        nodes = list(zip(places, [walk.points[k], *motions, walk.points[k + 1]], strict=True))
        known = [(place, motion) for place, motion in nodes if motion is not None]
        for (low, a), (high, b) in pairwise(known):
            for kind, number in _numbers(a, b).items():
                if number(a) * number(b) < 0:
                    part = stretch.root(number, SOLVED[kind], (low, number(a)), (high, number(b)))
                    unseen = yield from _refined(walk, k, kind, stretch, part)
                    if unseen is not None:
                        solved.append(unseen)
    if solved:  # one march of all
        every = yield Look([motion for _, motion, *_ in solved])
        for (kind, motion, k, refined), seen in zip(solved, every, strict=True):
            found.append(Special(kind, motion, seen, k, refined))
    for touch in walk.touches:
        point, seen = walk.points[touch.at], walk.seen[touch.at]
        kind = "contact_change" if touch.stop in point.contacts.stops else "grazing"
        found.append(Special(kind, point, seen, max(touch.at - 1, 0), True))
    return sorted(found, key=lambda special: special.after)


def _leapt_over(walk: Walk, k: int) -> list[Special]:
    """Special points behind the point k, of which it is only known that there are some."""
    a, b = walk.points[k], walk.points[k + 1]
    kinds = ["contact_change", "fold"][: 1 + (a.parameter_along * b.parameter_along < 0)]
    return [Special(kind, a, walk.seen[k], k, refined=False) for kind in kinds]


def _doubtful(walk: Walk, k: int, stretch: Stretch) -> list[float]:
    """Places between the points k and k + 1 where multipliers may be on the other side."""
    a, b = walk.points[k], walk.points[k + 1]
    first, last = a.moduli, b.moduli
    if stretch.touch is not None:
        # Next to a touch they change with the root of the way: they may have come and gone.
        moved = np.abs(first - last)[np.maximum(first, last) > 0.5]
        low, high = stretch.ends
        shares = SHARES if stretch.touch.entering else SHARES[::-1]
        return [share * max(low, high) for share in shares] if (moved > MOVED).any() else []
    before, after = walk.points[max(k - 1, 0)], walk.points[min(k + 2, len(walk.points) - 1)]
    outside = int(np.sum(first > 1))
    if before.family != a.family or after.family != b.family or outside != np.sum(last > 1):
        return []
    places = set()
    for place in {max(outside - 1, 0), min(outside, len(first) - 1)}:
        # Lines through the neighbours on either side meet where the way may have its turn.
        number, whole = _crossing(place), b.way
        start, end = number(a), number(b)
        if not a.way or not after.way or not start * end > 0:
            continue
        rises = (start - number(before)) / a.way, (number(after) - end) / after.way
        if rises[0] == rises[1]:
            continue
        meet = (end - start - rises[1] * whole) / (rises[0] - rises[1])
        if 0 < meet < whole and (start + rises[0] * meet) * start < 0:
            places.add(stretch.place(meet / whole))
    return sorted(places)


def _refined(
    walk: Walk, k: int, kind: str, stretch: Stretch, root: Steps
) -> Generator[Any, Any, Unseen | None]:
    """Solve for the special point of a kind behind the point k."""
    found = yield from root
    motion, refined = found.motion, found.solved
    if found.at_touch and stretch.touch is not None:
        if kind != "fold":
            return None  # multipliers jump there
        kind, motion, refined = "touch_fold", walk.points[stretch.touch.at], True
    motion = motion or walk.points[k]
    if kind == "neimark_sacker" and not on_circle(motion.multipliers, NEAR_CIRCLE):
        return None
    return kind, motion, k, refined
