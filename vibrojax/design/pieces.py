"""Stable parts of a branch: from end to end, and what they pass in between.

A part runs from one place where the branch turns round, loses its stability or ends to the next.
Its frequency only rises or only falls, so that it has one motion at most at a frequency.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.branches.on_curve import OnCurve, Steps, Touch
from vibrojax.branches.points import TURNS
from vibrojax.design.known_branch import KnownBranch, Node

Number = Callable[[OnCurve], tuple[float, float]]
"""A number of a motion, and its derivative along the curve, 0 where it is not known."""
ROUNDS = 60
AT_END = 1e-12
"""Relative distance from an end of the range that is as good as none."""


class Knot(NamedTuple):
    """A motion of a branch that is known."""

    motion: OnCurve
    cell: int
    """Index of the branch point that it is or follows."""
    kind: str
    """`point`, `touch`, `range` (an end of the range), `unknown`, or that of a special point."""
    touch: Touch | None = None


@dataclass
class Piece:
    """A stable part of a branch."""

    known: KnownBranch
    knots: list[Knot]
    values: dict[str, np.ndarray] = field(default_factory=dict)
    """What was read at the knots already, by name."""
    nodes: tuple[Node, Node] | None = None
    """What was measured at the ends."""

    @cached_property
    def frequency(self) -> Float[np.ndarray, " knots"]:
        """Drive frequencies of the knots."""
        return np.array([knot.motion.parameter for knot in self.knots])

    @property
    def low(self) -> float:
        """Least frequency."""
        return float(self.frequency.min())

    @property
    def high(self) -> float:
        """Largest frequency."""
        return float(self.frequency.max())

    @property
    def ends(self) -> tuple[Node, Node]:
        """What is measured at both ends, the one at the lower frequency first."""
        # No cached_property: before Python 3.12 it holds a lock, while others are asked.
        if self.nodes is None:
            self.nodes = self._ends()
        return self.nodes

    def _ends(self) -> tuple[Node, Node]:
        first, last = node_of(self.known, self.knots[0]), node_of(self.known, self.knots[-1])
        return (first, last) if self.frequency[0] <= self.frequency[-1] else (last, first)

    def interval(self, value: float) -> int | None:
        """Index of the knot before a frequency; None where the part does not pass it."""
        x = self.frequency if self.frequency[0] <= self.frequency[-1] else -self.frequency
        value = value if self.frequency[0] <= self.frequency[-1] else -value
        if not x[0] <= value <= x[-1]:
            return None
        return int(np.clip(np.searchsorted(x, value, side="right") - 1, 0, len(x) - 2))

    def motion_at(self, value: float) -> Steps:
        """Search for the motion at a frequency; None where there is none."""
        index = self.interval(value)
        if index is None:
            return None
        a, b = self.knots[index], self.knots[index + 1]
        for knot in (a, b):
            if knot.motion.parameter == value:
                return knot.motion
        between = Between(self.known, a, b)
        sections = {knot.motion.contacts.section for knot in (a, b)}
        if a.kind in ("point", "range") and b.kind in ("point", "range") and len(sections) == 1:
            nearer = min((a, b), key=lambda k: abs(k.motion.parameter - value)).motion
            found = yield from self.known.walk.search.solve(
                self.known.walk.search.pinned(nearer, value)
            )
            if found is not None and between.holds(found):
                return found
        return (yield from between.motion_at(value))


class Between:
    """Motions between two knots that follow one another."""

    def __init__(self, known: KnownBranch, a: Knot, b: Knot):
        self.a, self.b = a.motion, b.motion
        self.stretch = known.walk.stretch(a.cell)
        self.places = self._place(self.a, 0), self._place(self.b, 1)

    def _place(self, motion: OnCurve, side: int) -> float:
        """Where the motion of a knot lies on the stretch."""
        is_end = motion is (self.stretch.first, self.stretch.last)[side]
        return self.stretch.ends[side] if is_end else self.place_of(motion)

    def place_of(self, motion: OnCurve) -> float:
        """Where a motion in between lies on the stretch."""
        if self.stretch.by_times is not None:
            return float(self.stretch.by_times @ motion.times)
        return self.stretch.search.way(self.stretch.first, motion)

    def compares(self, motion: OnCurve) -> bool:
        """Whether the state of a motion is at the drive phase of those of the stretch."""
        touch, first = self.stretch.touch, self.stretch.first
        return touch is not None or motion.contacts.section == first.contacts.section

    def stretch_at(self, motion: OnCurve) -> float:
        """How much of the curve there is per unit of the place at a motion; none at a touch."""
        by_times = self.stretch.by_times
        if by_times is not None:
            if len(motion.times) != len(by_times):
                return 0.0
            return 1.0 / float(by_times @ motion.times_along)
        along = motion.state_along, motion.parameter_along
        return 1.0 / self.stretch.search.along(self.stretch.first, *along)

    def at_each(self, places: Sequence[float] | np.ndarray) -> Steps:
        """Search for the motions at some places, those first whose contacts last longest."""
        order = np.argsort(places)[::-1] if self.stretch.touch is not None else range(len(places))
        found: list[OnCurve | None] = [None] * len(places)
        for k in order:
            found[k] = yield from self.stretch.at(float(places[k]))
        return found

    def holds(self, motion: OnCurve) -> bool:
        """Whether a motion is one of those between, as far as its contacts say."""
        same = motion.contacts.stops == self.a.contacts.stops
        return same and self.stretch.search.is_sound(motion)

    def motion_at(self, value: float) -> Steps:
        """Search for the motion at a value of the parameter; an end where that is one."""
        below, above = self.a.parameter - value, self.b.parameter - value
        if below * above >= 0:
            return self.a if abs(below) < abs(above) else self.b
        ends = (self.places[0], below), (self.places[1], above)
        found = yield from self.stretch.root(lambda m: m.parameter - value, 1e-9, *ends)
        return found.motion if found.motion is not None and found.solved else None

    def root(self, known: KnownBranch, number: Number, solved: float) -> OnCurve | None:
        """Find where a number passes zero that is measured; None where it is not found.

        By the number and its derivative along the curve, as long as these lead on, else by a line
        between places on both sides; to `solved` of what it is at the ends.
        """
        (low, high), (a, b) = self.places, (self.a, self.b)
        (below, _), (above, _) = number(a), number(b)
        scale, whole, side = max(abs(below), abs(above)), abs(high - low), 0
        place = low + below / (below - above) * (high - low)
        for _ in range(ROUNDS):
            share = (place - low) / (high - low)
            place = low + min(max(share, 0.02), 0.98) * (high - low)
            ((place, motion),) = known.run([self.stretch.nearer(place)])
            if motion is None or self.stretch.is_at_touch(place, whole):
                return None
            value, rate = number(motion)
            if abs(value) <= solved * scale:
                return motion
            if abs(high - low) <= 1e-12 * whole:
                return None
            # The end that stays twice counts half: else it would stay for long.
            if (value > 0) == (below > 0):
                low, below, above = place, value, above / 2 if side == 1 else above
                side = 1
            else:
                high, above, below = place, value, below / 2 if side == -1 else below
                side = -1
            along = rate * self.stretch_at(motion)
            place = place - value / along if along else np.inf
            if not min(low, high) < place < max(low, high):
                place = low + below / (below - above) * (high - low)
        return None


def node_of(known: KnownBranch, knot: Knot) -> Node:
    """Return what is measured at a knot, with derivatives by the condition that it fulfils."""
    motion = knot.motion
    if knot.kind == "fold":
        return known.at_fold(motion)
    if knot.kind in ("period_doubling", "neimark_sacker"):
        return known.at_multiplier(motion)
    if knot.kind == "range":
        return known.at(motion, motion.parameter)
    if knot.touch is not None:
        points = known.walk.points
        near = points[knot.touch.at + (1 if knot.touch.entering else -1)]
        angle = float(np.mean(near.times[list(knot.touch.places)]))
        return known.at_touch(motion, knot.touch.stop, angle)
    return known.as_it_is(motion)


def knots_of(known: KnownBranch) -> list[Knot]:
    """Return all motions of a branch in order: its points, and special points between them."""
    points, touches = known.walk.points, {t.at: t for t in known.walk.touches}
    between: dict[int, list[Knot]] = {}
    turns = set()
    for special, motion in zip(known.branch.special_points, known.curve.specials, strict=True):
        if special.kind == "touch_fold":
            turns.update(i for i in touches if points[i] is motion)
        elif special.kind not in ("grazing", "contact_change"):
            kind = special.kind if special.refined else "unknown"
            between.setdefault(special.after, []).append(Knot(motion, special.after, kind))
    found = []
    for k, point in enumerate(points):
        kind, touch = "point", touches.get(k)
        if k in (0, len(points) - 1):
            gap = np.min(np.abs(np.array(known.branch.range) - point.parameter))
            kind = "range" if gap <= AT_END * abs(point.parameter) else "unknown"
        elif touch is not None:
            kind = "touch_fold" if k in turns else "touch"
        found.append(Knot(point, k, kind, touch))
        inside = between.get(k, [])
        if len(inside) > 1:
            order = [known.walk.search.way(point, knot.motion) for knot in inside]
            inside = [inside[i] for i in np.argsort(order)]
        found += inside
    return found


def _is_stable(known: KnownBranch, a: Knot, b: Knot) -> bool:
    """Whether the motions between two knots are stable.

    By their points of known stability; without one, between a fold and a touch, by the motion
    half way.
    """
    points, stable = known.walk.points, known.branch.stable
    touch = known.walk.touch_in(a.cell)
    stabilities = []
    for knot, own in ((a, a.cell), (b, a.cell + 1)):
        # At a touch itself multipliers are those of the side without the contact.
        if knot.motion is points[own] and not (touch is not None and own == touch.at):
            stabilities.append(bool(stable[own]))
    if stabilities:
        return all(stabilities)
    between = Between(known, a, b)
    (motion,) = known.run([between.stretch.at(float(np.mean(between.places)))])
    return motion is not None and bool(motion.moduli[0] < 1.0)


def pieces_of(known: KnownBranch, *, stable: bool = True) -> list[Piece]:
    """Return the stable parts of a branch in order along it, or all parts."""
    knots = knots_of(known)
    if len(knots) < 2:
        return []
    good: Bool[np.ndarray, " intervals"] = np.array(
        [not stable or _is_stable(known, a, b) for a, b in pairwise(knots)]
    )
    pieces: list[Piece] = []
    start: int | None = None
    for k, holds in enumerate([*good.tolist(), False]):
        if start is not None and (not holds or knots[k].kind in TURNS):
            pieces.append(Piece(known, knots[start : k + 1]))
            start = None
        if holds and start is None:
            start = k
    return [_with_ends(piece) for piece in pieces if piece.low < piece.high]


def _with_ends(piece: Piece) -> Piece:
    """Say of ends that are ordinary points that why the part ends there is not known."""
    ends = piece.knots[0], piece.knots[-1]
    first, last = (k._replace(kind="unknown") if k.kind == "point" else k for k in ends)
    return Piece(piece.known, [first, *piece.knots[1:-1], last])
