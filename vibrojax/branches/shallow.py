"""Shallow contacts that come and go between two points of a curve."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.on_curve import OnCurve, Seen, Steps
from vibrojax.branches.stretch import Stretch, turning_share

SHORTEST = 1e-6
"""Arclength between two points within which it is not looked."""
MOVED, MOVES = 0.02, 2.0
"""Most, rad, that the drive phase at which a stop is nearest differs between neighbours, and more
for every unit of arclength between."""
APART = 0.25
"""Share of the way by which the end of a contact may seem to lie before its beginning."""
SOON = 0.25
"""Share of the way within which one that seems to begin or end is looked for in any case."""
MUCH = 0.1
"""Ratio of how near a stop comes in two neighbours, of which no others say how that changes."""
MARGIN = 0.1
"""Least share of the way from both ends at which it is looked."""


def shallow_contact(
    search: CurveSearch, points: list[OnCurve], seen: Sequence[Seen], *, to_touch: bool = False
) -> Steps:
    """Solve for a motion in the last cell but one of some points, if a stop may touch there.

    Or if it may leave for a little while. None where nothing says so, or no motion was found. Where
    the last point is a touch, `to_touch`, it is in the cell before that.
    """
    if len(points) < 3 or len({motion.family for motion in points[-3:]}) > 1:
        return None
    near = [_near(search, *each) for each in zip(points, seen, strict=True)]
    unknown = [place._replace(height=-math.inf) for place in near[0]]
    before, first, last = points[-3:]
    ways = before.way, first.way, last.way
    if to_touch:
        ways, near = (first.way, last.way, math.inf), [*near[-3:], unknown]
    else:
        first, last = before, first
        if len(points) == 3 or points[0].family != first.family:
            near = [unknown, *near[-3:]]  # other contacts say nothing of these
    share = _share(ways, zip(*near, strict=True), search.whole)
    if share is None:
        return None
    stretch = Stretch(search, first, last, None)
    _, found = yield from stretch.nearer(stretch.place(share))
    if found is None or found.contacts.section != first.contacts.section:
        return None
    found = replace(found, family=first.family, way=search.way(first, found))
    return found if 0 < found.way < last.way else None


class _Near(NamedTuple):
    """Where a stop comes nearest to a change of contact and turns back."""

    height: float
    """What would have to pass zero, m."""
    angle: float
    """Drive phase, rad."""
    changes: int
    """How often it has changed contact from the section on: odd where it is touched."""
    section: float
    """Drive phase, rad."""

    def changes_on_the_way(self, other: "_Near", way: float, whole: float) -> int | None:
        """Changes of contact from here to another one so far along the curve.

        None if that is at another drive phase within the period `whole` (rad); 0 or 1 of motions
        that are cut elsewhere.
        """
        if abs(math.remainder(self.angle - other.angle, whole)) > MOVED + MOVES * way:
            return None
        between = abs(self.changes - other.changes)
        return between if self.section == other.section else between % 2


def _near(search: CurveSearch, motion: OnCurve, seen: Seen) -> list[_Near]:
    """Where each stop comes nearest in a motion."""
    section = motion.contacts.section
    return [
        _Near(
            height,
            angle,
            motion.changes_before(stop, search.behind_section(motion, angle)),
            section,
        )
        for stop, (height, angle) in enumerate(zip(*seen.nearest, strict=True))
    ]


def _share(ways: Sequence[float], stops: Iterable[Sequence[_Near]], whole: float) -> float | None:
    """Share of the way from the second of four points at which a stop may change contact.

    How near it came rises before and falls behind: that says where it would pass zero. What is
    nearest at another drive phase is something else. Where it is in flight here and in contact
    there, contact changes between, or all but does. The third may be a touch, with nothing behind.
    """
    before, width, behind = ways
    to_touch = math.isinf(behind)
    if behind <= 0 or width < SHORTEST:
        return None
    for near in stops:
        a, b, c, d = (place.height for place in near)
        if not -math.inf < min(b, c) <= max(b, -math.inf if to_touch else c) < 0:
            continue
        changes = [
            one.changes_on_the_way(other, way, whole)
            for (one, other), way in zip(pairwise(near), ways, strict=True)
        ]
        comes, stays, goes = (between == 0 for between in changes)
        comes, goes = comes and a > -math.inf, goes and d > -math.inf
        begin = end = math.inf
        if comes and a < b:
            begin = b / (a - b) * before / width
        if goes and d < c:
            end = c / (d - c) * behind / width
        if begin + end < 1 + APART:
            turn = turning_share(ways, (a, b, c, d)) if stays else None
            share = (begin + 1 - end) / 2 if turn is None else turn
        elif min(begin, end) < SOON:
            share = 2 * begin if begin < end else 1 - 2 * end
        elif (changes[1] == 1 and not to_touch) or (
            min(begin, end) < 1 and not (stays and (b < c) == (begin < end))
        ):
            share = 0.5
        elif to_touch or stays:
            continue
        elif min(b / c, c / b) < MUCH and not (comes if b > c else goes):
            share = 0.0 if b > c else 1.0  # next to it, to see how it changes
        else:
            continue
        return min(max(share, MARGIN), 1 - MARGIN)
    return None
