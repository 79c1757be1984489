"""Shallow contacts that come and go between two points of a curve."""

import math
from collections.abc import Sequence
from dataclasses import replace

from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.on_curve import Nearness, OnCurve, Seen, Steps
from vibrojax.branches.stretch import Stretch, turning_share
from vibrojax.steady.curve_programs import LEAST

SHORTEST = 0.9 * LEAST
"""Arclength between two points within which it is not looked: at `LEAST` round-off would decide."""
MOVED = 0.2
"""Most, rad, that the drive phase at which a stop is nearest differs between neighbours."""
APART = 0.25
"""Share of the way by which the end of a contact may seem to lie before its beginning."""
SOON = 0.25
"""Share of the way within which one that seems to begin or end is looked for in any case."""
MARGIN = 0.1
"""Least share of the way from both ends at which it is looked."""


def shallow_contact(search: CurveSearch, points: list[OnCurve], seen: Sequence[Seen]) -> Steps:
    """Solve for a motion in the last cell but one of some points, if a stop may touch there.

    Or if it may leave for a little while. None where nothing says so, or no motion was found.
    """
    if len(points) < 3 or len({motion.family for motion in points[-3:]}) > 1:
        return None
    first, last, behind = points[-3:]
    nearest = [s.nearest for s in seen]
    if len(points) == 3 or points[0].family != first.family:
        # Other contacts say nothing of these.
        unknown = [-math.inf] * len(nearest[0][0])
        nearest = [(unknown, unknown), *nearest[-3:]]
    share = _share((first.way, last.way, behind.way), nearest)
    if share is None:
        return None
    stretch = Stretch(search, first, last, None)
    _, found = yield from stretch.nearer(stretch.place(share))
    if found is None or found.contacts.section != first.contacts.section:
        return None
    found = replace(found, family=first.family, way=search.way(first, found))
    return found if 0 < found.way < last.way else None


def _share(ways: Sequence[float], nearest: Sequence[Nearness]) -> float | None:
    """Share of the way from the second of four points at which a stop may change contact.

    How near stops came rises before and falls behind: that says where it would pass zero. What is
    nearest at another drive phase is something else.
    """
    before, width, behind = ways
    if behind <= 0 or width < SHORTEST:
        return None
    for stop in range(len(nearest[0][0])):
        (a, b, c, d), turned = ([point[k][stop] for point in nearest] for k in (0, 1))
        if not -math.inf < min(b, c) <= max(b, c) < 0:
            continue
        begin = end = math.inf
        if -math.inf < a < b and _is_same(*turned[:2]):
            begin = b / (a - b) * before / width
        if -math.inf < d < c and _is_same(*turned[2:]):
            end = c / (d - c) * behind / width
        if begin + end < 1 + APART:
            turn = turning_share(ways, (a, b, c, d)) if _is_same(*turned[1:3]) else None
            share = (begin + 1 - end) / 2 if turn is None else turn
        elif min(begin, end) < SOON:
            share = 2 * begin if begin < end else 1 - 2 * end
        elif min(begin, end) < 1 and not (_is_same(*turned[1:3]) and (b < c) == (begin < end)):
            share = 0.5
        else:
            continue
        return min(max(share, MARGIN), 1 - MARGIN)
    return None


def _is_same(a: float, b: float) -> bool:
    return abs(math.remainder(a - b, 2 * math.pi)) < MOVED
