"""Motions between two neighbours of a curve, and where a number of them passes zero."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from vibrojax.branches.contacts import duration_row
from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.neighbours import collapses
from vibrojax.branches.on_curve import OnCurve, Steps, Touch

ROUNDS = 60
ROUND_OFF = 1e-6
"""Most that a number is where round-off keeps it from zero, over its size at both ends; where it is
more it jumps."""
AT_TOUCH = 1e-7
"""Duration of a contact, over that where a fold was looked for from, that is as good as a touch."""
HALVINGS = 12
"""Of the way to motions that are known, where there is none at a place."""
NEXT_TO_TOUCH = 1 / 2, 1 / 4, 1 / 8
"""Shares of how long a new contact lasts at which motions next to a touch are looked at."""
TURNING = 4
"""Times that it is looked, the later ones where the curve may turn round twice in between."""

SEVERAL = 1.5
"""Ratio of a contact's durations at both ends from which on the place is its duration."""

Number = Callable[[OnCurve], float]


class Stretch:
    """Motions between two neighbours of a curve by their place: where a number of them passes zero.

    The place is the way from the first point, or how long a contact lasts that is new, or changes
    much; what has been solved for is where the next search starts from.
    """

    def __init__(self, search: CurveSearch, first: OnCurve, last: OnCurve, touch: Touch | None):
        self.search, self.touch, self.first, self.last = search, touch, first, last
        self.by_times = None
        if touch is not None:
            lasting = last if touch.entering else first
            self.family = lasting.family
            self.by_times = duration_row(touch.places, len(lasting.times))
            whole = float(self.by_times @ lasting.times)
            self.ends = (0.0, whole) if touch.entering else (whole, 0.0)
            self.known = [(whole, lasting)]
            return
        is_cut_alike = last.contacts.section == first.contacts.section
        # Not the way that it came: points may have been put in between since.
        self.ends = 0.0, search.way(first, last) if is_cut_alike else last.way
        if last.contacts == first.contacts:
            places = _changing_most(first, last)
            if places is not None:
                row = self.by_times = duration_row(places, len(first.times))
                self.ends = float(row @ first.times), float(row @ last.times)
        self.known = [(self.ends[0], first)]
        if is_cut_alike:
            self.known.append((self.ends[1], last))

    def place(self, share: float) -> float:
        """The place at a share of the way."""
        low, high = self.ends
        if self.by_times is None:
            return low + share * (high - low)
        return float(np.sqrt(low**2 + share * (high**2 - low**2)))  # durations change with its root

    def at(self, place: float) -> Steps:
        """Solve for the motion at a place; None where there is none."""
        near_place, near = min(self.known, key=lambda each: abs(each[0] - place))
        if self.by_times is None:
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
        if found is None or not self.search.is_sound(found) or collapses(near, found):
            return None
        if self.by_times is None:
            found = self.search.oriented(found, self.first)
        elif (found.times_along @ self.by_times > 0) != (self.ends[1] > self.ends[0]):
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

    def next_to_touch(self) -> Generator[Any, Any, list[OnCurve]]:
        """Motions inside, next to a touch at one end, in order along the curve.

        There are more where the curve may turn round twice between two of them.
        """
        nodes = dict(zip(self.ends, (self.first, self.last), strict=True))
        places = [share * max(self.ends) for share in NEXT_TO_TOUCH]
        for _ in range(TURNING):
            for place in places:
                found = yield from self.at(place)
                if found is not None:
                    nodes[place] = found
            nodes = dict(sorted(nodes.items(), reverse=self.ends[0] > 0))
            # At a corner a touch has the direction of the side without contact.
            places = _where_turning({p: m for p, m in nodes.items() if p or self.search.smooth})
        last, inside = self.first, []
        for motion in list(nodes.values())[1:-1]:
            last = replace(motion, way=abs(self.search.way(last, motion)), family=self.family)
            inside.append(last)
        return inside

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
                at_touch = self.is_at_touch(middle, whole)
                is_zero = at_touch or abs(value) <= ROUND_OFF * scale
                return Root(motion, place, at_touch, solved=is_zero)
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


def _changing_most(a: OnCurve, b: OnCurve) -> tuple[int, int] | None:
    """Places of the contact whose duration differs most between two motions; None if by little."""
    ratios = {}
    for one, other in zip(a.pairs, b.pairs, strict=True):
        short, long = sorted((one.length, other.length))
        ratios[one.places] = long / short if short > 0 else 0.0
    most = max(ratios, key=lambda places: ratios[places], default=None)
    return most if most is not None and ratios[most] > SEVERAL else None


def _where_turning(nodes: dict[float, OnCurve]) -> list[float]:
    """Places between nodes of a curve that may turn round twice there: rates are off a line."""
    places, rates = list(nodes), [motion.parameter_along for motion in nodes.values()]
    found = []
    for k in range(len(rates) - 2):
        near = rates[k : k + 3]
        off = abs(near[1] - (near[0] + near[2]) / 2)
        if min(near) * max(near) > 0 and off > min(abs(rate) for rate in near):
            found += [(a + b) / 2 for a, b in pairwise(places[k : k + 3])]
    return found


def turning_share(ways: Sequence[float], values: Sequence[float]) -> float | None:
    """Share of the way from the second of four points to the third at which a number turns round.

    By the cubic through all; `ways` are those between them. None where it turns elsewhere.
    """
    before, width, _ = ways
    if not min(ways) > 0:
        return None
    shares = (np.cumsum([0.0, *ways]) - before) / width
    _, slope, bend, change = np.linalg.solve(np.vander(shares, increasing=True), values)
    inner = bend**2 - 3 * slope * change
    if inner < 0:
        return None
    both = -(bend + np.copysign(np.sqrt(inner), bend))
    with np.errstate(divide="ignore", invalid="ignore"):  # it may be a parabola or a line
        turns = np.array([slope / both, both / (3 * change)])
    inside = turns[(turns > 0) & (turns < 1)]
    return float(inside[0]) if len(inside) == 1 else None


class Root(NamedTuple):
    """Where a number of motions passes zero."""

    motion: OnCurve | None
    """The nearest that was found."""
    place: float
    """Of that."""
    at_touch: bool
    """Whether it is the touch at an end of the stretch."""
    solved: bool
