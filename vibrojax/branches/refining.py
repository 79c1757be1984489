"""Special points between the points of a walk: folds, period doublings, Neimark-Sacker points.

Between two motions of one family, or of a touch and the first motion behind it, the curve is
smooth: a special point is where one number passes zero.
"""

from collections.abc import Generator
from itertools import pairwise
from operator import attrgetter
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


def _doubling(motion: OnCurve) -> float:
    return float(doubling_test(motion.multipliers))


def _passing(a: OnCurve, b: OnCurve) -> dict[str, Number]:
    """Numbers that pass zero between two motions, as at special points, by the kind of these."""
    numbers: dict[str, Number] = {
        "fold": attrgetter("parameter_along"),
        "period_doubling": _doubling,
    }
    outside = sorted((a.outside, b.outside))
    if outside[1] - outside[0] >= 2:
        numbers["neimark_sacker"] = _crossing(outside[0])
    return {kind: number for kind, number in numbers.items() if number(a) * number(b) < 0}


def special_points_of(walk: Walk) -> Generator[Any, Any, list[Special]]:
    """Find all special points of a walk, in order along it."""
    found: list[Special] = []
    solved: list[Unseen] = []
    for k in range(len(walk.points) - 1):
        if walk.is_leap(k):
            found += _leapt_over(walk, k)
            continue
        first, last = walk.points[k : k + 2]
        doubtful = _doubtful(walk, k)
        if not doubtful and not _passing(first, last):
            continue
        stretch = walk.stretch(k)
        places = [stretch.place(share) for share in (0.0, *doubtful, 1.0)]
        motions = yield from stretch.each(places[1:-1])
        nodes = list(zip(places, [first, *motions, last], strict=True))
        known = [(place, motion) for place, motion in nodes if motion is not None]
        for (low, a), (high, b) in pairwise(known):
            for kind, number in _passing(a, b).items():
                part = stretch.root(number, SOLVED[kind], (low, number(a)), (high, number(b)))
                unseen = yield from _refined(walk, k, kind, stretch, part)
                if unseen is not None:
                    solved.append(unseen)
    if solved:  # one march of all
        every = yield Look([motion for _, motion, *_ in solved])
        for (kind, motion, k, refined), seen in zip(solved, every, strict=True):
            if kind != "touch_fold":  # the walk has looked at its touches
                kept = yield from walk.kept(motion, seen)
                # Else motions between two points do not keep to the contacts of these.
                refined = refined and kept is not None
                motion, seen = kept or (motion, seen)
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


def _doubtful(walk: Walk, k: int) -> list[float]:
    """Shares of the way between two points where multipliers may be on the other side."""
    a, b = walk.points[k], walk.points[k + 1]
    first, last, touch = a.moduli, b.moduli, walk.touch_in(k)
    if touch is not None:
        # Next to a touch they change with the root of the way: they may have come and gone.
        moved = np.abs(first - last)[np.maximum(first, last) > 0.5]
        if not (moved > MOVED).any():
            return []
        return sorted(share**2 if touch.entering else 1 - share**2 for share in SHARES)
    before, after = walk.points[max(k - 1, 0)], walk.points[min(k + 2, len(walk.points) - 1)]
    outside = a.outside
    if before.family != a.family or after.family != b.family or outside != b.outside:
        return []
    shares = set()
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
            shares.add(meet / whole)
    return sorted(shares)


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
