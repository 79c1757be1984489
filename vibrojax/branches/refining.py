"""Special points between the points of a walk: folds, period doublings, Neimark-Sacker points.

Between two motions of one family, or of a touch and the first motion behind it, the curve is
smooth: a special point is where one number passes zero.
"""

from collections.abc import Generator
from itertools import pairwise
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.branches.on_curve import Look, OnCurve, Seen, Steps
from vibrojax.branches.special_points import doubling_test, on_circle
from vibrojax.branches.stretch import NEXT_TO_TOUCH, Number, Root, Stretch, turning_share
from vibrojax.branches.walking import Walk

SOLVED = {"fold": 1e-8, "period_doubling": 1e-11, "neimark_sacker": 1e-11}
"""How near to zero a number is to come, over its size next to it; a fold is flat."""
NEAR_CIRCLE = 1e-3
MOVED, NEAR = 0.3, 0.2
"""By how much sizes of multipliers change between a touch and the next point, or how near one is to
1, where it is looked in between."""


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


class _Node(NamedTuple):
    """A motion of a cell, by its place there."""

    place: float
    motion: OnCurve
    multiplier: float | None = None
    """On the unit circle, of a fold or a period doubling."""

    @property
    def outside(self) -> tuple[int, int]:
        """How many multipliers are outside of the unit circle, next to it on either side."""
        count = int(np.sum(self._others > 1))
        return count, count if self.multiplier is None else count + 1

    @property
    def is_near_circle(self) -> bool:
        """Whether another multiplier is near the unit circle."""
        return bool((np.abs(self._others - 1) < NEAR).any())

    @property
    def _others(self) -> Float[np.ndarray, " others"]:
        """Moduli of the multipliers but that on the unit circle."""
        every = self.motion.multipliers
        if self.multiplier is None:
            return np.abs(every)
        return np.abs(np.delete(every, np.argmin(np.abs(every - self.multiplier))))


REAL: dict[str, tuple[float, Number]] = {
    "fold": (1.0, attrgetter("parameter_along")),
    "period_doubling": (-1.0, _doubling),
}
"""Special points at which one multiplier passes the unit circle: where, and what is zero there."""


def _pair_crossing(a: _Node, b: _Node) -> Number | None:
    """What passes zero where two multipliers pass the unit circle at once, if between two motions.

    That no single one passes it there is known.
    """
    fewer, more = sorted((a.outside, b.outside))
    apart = more[0] - fewer[1]
    if apart < (2 if a.multiplier is b.multiplier is None else 1):
        return None
    number = _crossing(fewer[1])
    return number if number(a.motion) * number(b.motion) < 0 else None


def _is_passed(walk: Walk, k: int) -> bool:
    """Whether a special point lies behind the point k, as that and the next one say."""
    a, b = walk.points[k : k + 2]
    real = any(number(a) * number(b) < 0 for _, number in REAL.values())
    return real or _pair_crossing(_Node(0.0, a), _Node(1.0, b)) is not None


def special_points_of(walk: Walk) -> Generator[Any, Any, list[Special]]:
    """Find all special points of a walk, in order along it."""
    found: list[Special] = []
    solved: list[Unseen] = []
    for k in range(len(walk.points) - 1):
        if walk.is_leap(k):
            found += _leapt_over(walk, k)
            continue
        doubtful = _doubtful(walk, k)
        if doubtful or _is_passed(walk, k):
            solved += yield from _in_cell(walk, k, doubtful)
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


def _in_cell(walk: Walk, k: int, doubtful: list[float]) -> Generator[Any, Any, list[Unseen]]:
    """Solve for the special points behind the point k, looking at some shares of the way too."""
    stretch, found = walk.stretch(k), list[tuple[float, Unseen]]()

    def solve(kind: str, number: Number, a: _Node, b: _Node) -> Steps:
        """Find one of a kind; returns its place and motion if it is solved for."""
        ends = [(each.place, number(each.motion)) for each in (a, b)]
        root = yield from stretch.root(number, SOLVED[kind], *ends)
        unseen = _refined(walk, k, kind, stretch, root)
        if unseen is not None:
            found.append((abs(root.place - places[0]), unseen))
        if unseen is None or root.motion is None or root.at_touch or not root.solved:
            return None
        return root.place, root.motion

    first, last = walk.points[k : k + 2]
    places = [stretch.place(share) for share in (0.0, *doubtful, 1.0)]
    motions = yield from stretch.each(places[1:-1])
    both = zip(places, [first, *motions, last], strict=True)
    known = [_Node(place, motion) for place, motion in both if motion is not None]
    for a, b in pairwise(known):
        nodes = [a, b]
        for kind, (multiplier, number) in REAL.items():
            if number(a.motion) * number(b.motion) < 0:
                there = yield from solve(kind, number, a, b)
                if there is not None:
                    place, motion = there
                    nodes.append(_Node(place, motion, multiplier))
        # A pair may pass the circle in the same step, before or behind, and return.
        places_between = _next_to_special(nodes)
        between = yield from stretch.each(places_between)
        both = zip(places_between, between, strict=True)
        nodes += [_Node(place, motion) for place, motion in both if motion is not None]
        nodes.sort(key=lambda node: abs(node.place - a.place))
        for ends in pairwise(nodes):
            number = _pair_crossing(*ends)
            if number is not None:
                yield from solve("neimark_sacker", number, *ends)
    return [unseen for _, unseen in sorted(found, key=itemgetter(0))]


def _next_to_special(nodes: list[_Node]) -> list[float]:
    """Places next to special points of a cell, whose ends come first, where it is looked too.

    If another multiplier is near the circle there.
    """
    ends, special = nodes[:2], nodes[2:]
    return [
        node.place + share * (end.place - node.place)
        for node in special
        if node.is_near_circle
        for end in ends
        for share in NEXT_TO_TOUCH
    ]


def _leapt_over(walk: Walk, k: int) -> list[Special]:
    """Special points behind the point k, of which it is only known that there are some."""
    a, b = walk.points[k], walk.points[k + 1]
    kinds = ["contact_change", "fold"][: 1 + (a.parameter_along * b.parameter_along < 0)]
    return [Special(kind, a, walk.seen[k], k, refined=False) for kind in kinds]


def _doubtful(walk: Walk, k: int) -> list[float]:
    """Shares of the way between two points where what passes zero may be on the other side."""
    a, b = walk.points[k], walk.points[k + 1]
    first, last, touch = a.moduli, b.moduli, walk.touch_in(k)
    if touch is not None:
        # Next to a touch they change with the root of the way: they may have come and gone.
        moved = np.abs(first - last)[np.maximum(first, last) > 0.5]
        near = np.abs(np.concatenate([first, last]) - 1) < NEAR
        if not (near.any() or (moved > MOVED).any()):
            return []
        return sorted(share**2 if touch.entering else 1 - share**2 for share in NEXT_TO_TOUCH)
    before, after = walk.points[max(k - 1, 0)], walk.points[min(k + 2, len(walk.points) - 1)]
    shares, outside = set(_between_folds(a, b)), a.outside
    if before.family != a.family or after.family != b.family or outside != b.outside:
        return sorted(shares)
    for place in {max(outside - 1, 0), min(outside, len(first) - 1)}:
        number, ways = _crossing(place), (a.way, b.way, after.way)
        values = [number(motion) for motion in (before, a, b, after)]
        start, end = values[1:3]
        if not a.way or not after.way or not start * end > 0:
            continue
        # Lines through the neighbours on either side meet beyond its turn.
        rises = (start - values[0]) / a.way, (values[3] - end) / after.way
        if rises[0] == rises[1]:
            continue
        meet = (end - start - rises[1] * b.way) / (rises[0] - rises[1])
        if 0 < meet < b.way and (start + rises[0] * meet) * start < 0:
            turn = turning_share(ways, values)
            shares.add(meet / b.way if turn is None else turn)
    return sorted(shares)


def _between_folds(a: OnCurve, b: OnCurve) -> list[float]:
    """Share of the way to the next point where the parameter may go back, with a fold on each side.

    By the cubic that has its values and rates at both.
    """
    if not b.way > 0:
        return []
    start, end, mean = a.parameter_along, b.parameter_along, (b.parameter - a.parameter) / b.way
    bend = start + end - 2 * mean
    if not start * end > 0 or bend * start <= 0:
        return []
    share = (2 * start + end - 3 * mean) / (3 * bend)  # where its rate is least
    least = start - 3 * bend * share**2
    return [share] if 0 < share < 1 and least * start < 0 else []


def _refined(walk: Walk, k: int, kind: str, stretch: Stretch, root: Root) -> Unseen | None:
    """The special point of a kind behind the point k, from where a number passes zero."""
    motion, refined = root.motion, root.solved
    if root.at_touch and stretch.touch is not None:
        if kind != "fold":
            return None  # multipliers jump there
        kind, motion, refined = "touch_fold", walk.points[stretch.touch.at], True
    motion = motion or walk.points[k]
    if kind == "neimark_sacker" and not on_circle(motion.multipliers, NEAR_CIRCLE):
        return None
    return kind, motion, k, refined
