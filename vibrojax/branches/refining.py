"""Special points between the points of a walk: folds, period doublings, Neimark-Sacker points.

Between two motions of one family, or of a touch and the first motion behind it, the curve is
smooth: a special point is where one number passes zero.
"""

from collections.abc import Callable, Generator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from vibrojax.branches.contacts import duration_row
from vibrojax.branches.on_curve import Look, OnCurve, Seen, Steps, Touch
from vibrojax.branches.special_points import doubling_test, on_circle
from vibrojax.branches.walking import Walk

ROUNDS = 60
SOLVED = {"fold": 1e-8, "period_doubling": 1e-11, "neimark_sacker": 1e-11}
"""How near to zero a number is to come, over its size next to it; a fold is flat."""
AT_TOUCH = 1e-7
"""Duration of a contact, over that where a fold was looked for from, that is as good as a touch."""
NEAR_CIRCLE = 1e-3
SHARES, MOVED = (1 / 8, 1 / 4, 1 / 2), 0.3
"""Where it is looked next to a touch, over the duration of the contact at the next point, if sizes
of multipliers change by so much until then."""
HALVINGS = 12
"""Of the way to motions that are known, where there is none at a place."""


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
Number = Callable[[OnCurve], float]


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
    behind = {touch.cell: touch for touch in walk.touches}
    found: list[Special] = []
    solved: list[Unseen] = []
    for k in range(len(walk.points) - 1):
        if walk.is_leap(k):
            found += _leapt_over(walk, k)
            continue
        stretch = Stretch(walk, k, behind.get(k))
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


def _doubtful(walk: Walk, k: int, stretch: "Stretch") -> list[float]:
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
            places.add(meet)
    return sorted(places)


def _refined(
    walk: Walk, k: int, kind: str, stretch: "Stretch", root: Steps
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


class Stretch:
    """Motions between two points of a walk by their place: where a number of them passes zero.

    The place is the way from the first point, or how long a new contact lasts; what has been solved
    for is where the next search starts from.
    """

    def __init__(self, walk: Walk, k: int, touch: Touch | None):
        self.search, self.touch = walk.search, touch
        self.first, self.last = walk.points[k], walk.points[k + 1]
        if touch is None:
            self.ends = 0.0, self.last.way
            self.known = [(0.0, self.first)]
            if self.last.contacts.section == self.first.contacts.section:
                self.known.append((self.last.way, self.last))
            return
        lasting = self.last if touch.entering else self.first
        self.by_times = duration_row(touch.places, len(lasting.times))
        whole = float(self.by_times @ lasting.times)
        self.ends = (0.0, whole) if touch.entering else (whole, 0.0)
        self.known = [(whole, lasting)]

    def at(self, place: float) -> Steps:
        """Solve for the motion at a place; None where there is none."""
        near_place, near = min(self.known, key=lambda each: abs(each[0] - place))
        if self.touch is None:
            guess = self.search.ahead(near, place - near_place)
            ask = self.search.ahead(self.first, place)
            ask = ask._replace(times=guess.times, state=guess.state, parameter=guess.parameter)
        else:
            rate = float(self.by_times @ near.times_along)
            guess = self.search.ahead(near, (place - near_place) / rate if rate else 0.0)
            ask = guess._replace(
                by_state=0.0, by_times=self.by_times, by_parameter=0.0, value=place
            )
        found = yield from self.search.solve(ask)
        if found is None or not self.search.is_sound(found) or self.search.collapses(near, found):
            return None
        if self.touch is None:
            found = self.search.oriented(found, self.first)
        elif (found.times_along @ self.by_times > 0) != self.touch.entering:
            found = found.reversed()
        self.known.append((place, found))
        return found

    def nearer(self, place: float) -> Steps:
        """Solve for the motion at a place, or for one nearer to those that are known."""
        near, _ = min(self.known, key=lambda each: abs(each[0] - place))
        for _ in range(HALVINGS):
            found = yield from self.at(place)
            if found is not None:
                return place, found
            place = (place + near) / 2
        return place, None

    def each(self, places: Sequence[float]) -> Generator[Any, Any, list[OnCurve | None]]:
        """Solve for the motions at places; None where there is none."""
        found = []
        for place in places:
            found.append((yield from self.at(place)))
        return found

    def root(
        self, number: Number, solved: float, first: tuple[float, float], last: tuple[float, float]
    ) -> Generator[Any, Any, "Root"]:
        """Find where a number passes zero between two places, which come with what it is there.

        It is found to `solved` of the larger of these.
        """
        (low, below), (high, above) = first, last
        scale, whole, best, place = max(abs(below), abs(above)), abs(high - low), None, low
        side = 0
        for _ in range(ROUNDS):
            share = min(max(below / (below - above), 0.02), 0.98)
            middle, motion = yield from self.nearer(low + share * (high - low))
            if motion is None:
                break
            best, place, value = motion, middle, number(motion)
            if abs(value) <= solved * scale or abs(high - low) <= 1e-13 * whole:
                return Root(motion, place, self.is_at_touch(middle, whole), solved=True)
            # The end that stays twice counts half: else it would stay for long.
            if (value > 0) == (below > 0):
                low, below, above = middle, value, above / 2 if side == 1 else above
                side = 1
            else:
                high, above, below = middle, value, below / 2 if side == -1 else below
                side = -1
        return Root(best, place, self.is_at_touch(max(low, high), whole), solved=False)

    def is_at_touch(self, place: float, whole: float) -> bool:
        """Whether a contact is so short that there is none."""
        return self.touch is not None and place < AT_TOUCH * whole


class Root(NamedTuple):
    """Where a number of motions passes zero."""

    motion: OnCurve | None
    """The nearest that was found."""
    place: float
    """Of that."""
    at_touch: bool
    """Whether it is the touch at an end of the stretch."""
    solved: bool
