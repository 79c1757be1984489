"""Walking along a curve of exact periodic motions, from one set of contacts to the next.

The walk of one lane is a generator: it yields what is to be solved or looked at, the answers of
many lanes being computed side by side (`side_by_side`). Motions are solved for a few steps ahead as
if contacts stayed as they are, then marched: where the march meets others, the touch in between is
solved for, and the walk goes on from there.
"""

from bisect import bisect_left
from dataclasses import dataclass, field, replace

import numpy as np

from vibrojax.branches.continuation import LOOP_POINTS, Ending
from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.on_curve import OnCurve, Seen, Steps, Touch
from vibrojax.branches.shallow import shallow_contact
from vibrojax.branches.stretch import Stretch
from vibrojax.branches.touches import (
    SHARP,
    Passed,
    by_duration,
    closing,
    touch_between,
    vanish,
    within,
)
from vibrojax.steady.curve_programs import STRIDE

BEGIN, FIRST, SHORTEST = 1e-3, 0.02, 1e-9
"""Steps, in arclength: change of the state over its size, and of the parameter over its scale."""
MOST_TRIES = 40
"""Tries to pass a touch before the next point has to be found."""
MOST_LEAPS = 30
"""Times that changes of contact are leapt over which cannot be passed one by one."""
NEARER = 0.999
"""Share of the way to a touch within which another one comes before it."""
SAME = 1e-8
"""Most that the same touch may differ from itself, in arclength, when it is passed again."""


@dataclass
class Walk:
    """The way of one lane."""

    search: CurveSearch
    low: float
    high: float
    longest: float
    max_points: int
    points: list[OnCurve] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    touches: list[Touch] = field(default_factory=list)
    refused: Seen | None = None
    """What was seen of the motion that broke its contacts last."""
    leaps: int = 0
    """How often changes of contact were leapt over."""
    landing: int | None = None
    """Point behind the last leap, if it may lead back to where the walk came from."""

    def anew(self, search: CurveSearch, low: float, high: float) -> "Walk":
        """A walk with the same settings elsewhere."""
        return Walk(search, low, high, self.longest, self.max_points)

    def go(self, start: OnCurve, way: float | None) -> Steps:
        """Walk from a motion in a direction of the parameter; returns how it ended.

        Without a `way` in the direction of the motion.
        """
        turns = way is not None and start.parameter_along * way < 0
        here = yield from self.search.cut_well(start.reversed() if turns else start)
        (seen,) = yield self.search.look([here])
        self.add(here, seen)
        begun, step, tries, reached = start.parameter, BEGIN, 0, 0
        while True:
            found = yield from self.look_ahead(step)
            if found is None:
                return Ending.running
            ahead, step, goal = found
            if len(self.points) > reached:
                tries, reached = 0, len(self.points)
            is_whole = goal is None and len(ahead) == STRIDE
            refused = yield from self.verify(ahead, step if is_whole else None)
            if isinstance(refused, Ending):
                return refused
            if refused:
                misfit = refused[0]
                step += sum(motion.way for motion in refused)
            elif goal is not None:
                return Ending.turned_back if goal == begun else Ending.completed
            elif ahead and (is_whole or not closing(self.points[-1], step)):
                continue
            else:
                misfit = None
            step = yield from self.pass_change(misfit, step)
            if isinstance(step, Ending):
                return step
            tries += 1
            is_stuck = step < SHORTEST or tries > MOST_TRIES
            if self.retraces() or (is_stuck and self.comes_back()):
                self.turn_about()
            elif not is_stuck:
                continue
            elif not (yield from self.leap()):
                return Ending.stuck
            step, tries, reached = FIRST / 2, 0, len(self.points)

    def pass_change(self, misfit: OnCurve | None, step: float) -> Steps:
        """Pass the change of contact ahead; returns the step to go on with, or how the walk ended.

        It lies before the motion `misfit`, whose contacts do not fit, or, without one, where no
        motion was found at that step. With one that is how far motions were solved for.
        """
        if misfit is None:
            last, shorter, bounds = self.points[-1], step / 2.5, (self.low, self.high)
            passed = yield from vanish(self.search, last, step, bounds)
        else:
            apart = max(misfit.way, 2 * SHORTEST)
            shorter = apart / 4
            passed = yield from self.touch_before(misfit, apart, step)
        return shorter if passed is None else (yield from self.take(passed))

    def touch_before(self, misfit: OnCurve, apart: float, reach: float) -> Steps:
        """Solve for the touch before a motion that was refused just now.

        Where it met no more contacts than it has, one may end up to `reach` ahead.
        """
        assert self.refused is not None
        last, bounds = self.points[-1], (self.low, self.high)
        steps = touch_between(self.search, last, misfit, self.refused, apart, reach, bounds)
        return (yield from steps)

    def look_ahead(self, step: float) -> Steps:
        """Solve for some motions: those, the step behind them, the end of the range met.

        There are fewer where no step is short enough: a contact begins or ends there. None where
        there are as many points as allowed.
        """
        ahead: list[OnCurve] = []
        rest: list[OnCurve | None] = []
        failed, longest, bounds = 0, self.longest, (self.low, self.high)
        while len(self.points) + len(ahead) < self.max_points:
            last = ahead[-1] if ahead else self.points[-1]
            room = min(STRIDE, self.max_points - len(self.points)) - len(ahead)
            found, goal, rest = yield from self.search.further(
                last, step, longest, rest, room, bounds
            )
            if found is not None:
                ahead.append(found)
                step = found.step
                if goal is not None or room == 1:
                    return ahead, step, goal
                continue
            if not closing(last, step):
                step = longest = 0.4 * step
                failed += 1
                if ahead and (failed > 1 or step < SHORTEST):  # other contacts may have come
                    return ahead, step, None
                if step >= SHORTEST:
                    continue
                came = yield from by_duration(self.search, last, bounds)
                if came is not None:
                    self.add(*came)
                    step = max(2 * came[0].way, 10 * SHORTEST)
                    continue
                step = SHARP  # a contact may end within that
            return ahead, step, None
        return None

    def leap(self) -> Steps:
        """Go on a little farther, whatever the contacts are there; says whether that is possible.

        Where a motion chatters, more touches lie on the way than can be distinguished.
        """
        self.leaps += 1
        if self.leaps > MOST_LEAPS:
            return False
        landed = yield from self.search.leapt(self.points[-1], (self.low, self.high))
        if landed is None:
            return False
        self.landing = len(self.points)
        self.add(*landed)
        return True

    def retraces(self) -> bool:
        """Whether, behind a leap, the last touch was passed before, the other way."""
        if self.landing is None or not self.touches or self.touches[-1].at < len(self.points) - 2:
            return False
        *before, last = self.touches
        return any(
            (touch.stop, touch.entering) == (last.stop, not last.entering)
            and np.linalg.norm(self._apart(touch.at, last.at)) <= SAME
            for touch in before
        )

    def comes_back(self) -> bool:
        """Whether the walk has come nearer to where it leapt than it landed."""
        if self.landing is None:
            return False
        before = self.landing - 1
        gone, leapt = self._apart(before, -1), self._apart(before, self.landing)
        return bool(np.linalg.norm(gone) < np.linalg.norm(leapt))

    def turn_about(self) -> None:
        """Go the other way from behind the last leap: there may be a fold in between."""
        landing = self.landing
        assert landing is not None
        del self.points[landing + 1 :], self.seen[landing + 1 :]
        self.points[landing] = self.points[landing].reversed()
        self.touches = [touch for touch in self.touches if touch.at < landing]
        self.landing = None

    def _apart(self, i: int, j: int) -> np.ndarray:
        """Difference of two points as seen at drive phase 0, in arclength."""
        unit, seen = self.search.unit, self.seen
        size = max(float(np.linalg.norm(unit * seen[-1].initial_state)), 1e-300)
        state = unit * (seen[j].initial_state - seen[i].initial_state) / size
        parameter = self.points[j].parameter - self.points[i].parameter
        return np.append(state, parameter / self.search.scale)

    def touch_in(self, cell: int) -> Touch | None:
        """Return the touch that the cell behind a point begins or ends with."""
        place = bisect_left(self.touches, cell, key=lambda touch: touch.cell)
        near = self.touches[place : place + 1]
        return near[0] if near and near[0].cell == cell else None

    def stretch(self, cell: int) -> Stretch:
        """Motions of the cell behind a point."""
        first, last = self.points[cell : cell + 2]
        return Stretch(self.search, first, last, self.touch_in(cell))

    def is_leap(self, cell: int) -> bool:
        """Whether changes of contact were leapt over in the cell behind a point."""
        changes = self.points[cell].family != self.points[cell + 1].family
        return changes and self.touch_in(cell) is None

    def add(self, motion: OnCurve, seen: Seen) -> None:
        """Take a motion as a point of the curve."""
        self.points.append(motion)
        self.seen.append(seen)

    def joins(self, motion: OnCurve, seen: Seen) -> Steps:
        """Whether a motion of a doubled period is behind the single one, the last point before."""
        last = self.points[-1], self.seen[-1]
        return (yield from self.search.joins(*last, self.behind_last(motion), seen))

    def take(self, passed: Passed) -> Steps:
        """Take a touch, and what is next to it, as points; returns as `pass_change`.

        Where contacts change before, the way goes on from there; the next may be as near behind.
        """
        place, touch = passed.place, passed.touch
        while len(self.points) > 1 and self.search.is_behind(place, self.points[-1]):
            self.points.pop()
            self.seen.pop()
        if self.landing is not None and self.landing >= len(self.points):
            self.landing = None
        room = self.max_points - len(passed.seen)
        for to_touch in (False, True):
            first = self.behind_last(passed.motions[0])
            closer = yield from self.closer(first, passed.seen[0], room, to_touch=to_touch)
            if closer and (refused := (yield from self.keep(closer))):
                if isinstance(refused, Ending):
                    return refused
                way = sum(motion.way for motion in refused)
                nearer = yield from self.touch_before(refused[0], refused[0].way, way)
                if nearer is not None:
                    return (yield from self.take(nearer))
                if not to_touch:
                    self.add(replace(refused[-1], way=way), closer[-1][1])
        *ahead, end = zip(passed.motions, passed.seen, strict=True)
        for k, (motion, seen) in enumerate(ahead):
            if motion is place:
                self.touches.append(touch._replace(at=len(self.points)))
            else:
                kept = yield from self.kept(motion, seen)
                if kept is None:
                    if touch.entering and k == 1:  # the touch before it is this one
                        break
                    stopped = yield from self.take_sooner(motion, end[0])
                    if stopped is not None:
                        return stopped
                    break
                motion, seen = kept
            if (yield from self.joins(motion, seen)):
                return Ending.joined
            self.add(self.behind_last(motion), seen)
        if (yield from self.joins(*end)):
            return Ending.joined
        if not touch.entering:
            self.touches.append(touch._replace(at=len(self.points)))
        self.add(self.behind_last(end[0]), end[1])
        since = self.points[self.touches[-2].at + 1 :] if len(self.touches) > 1 else []
        return min(max(sum(motion.way for motion in since), BEGIN), FIRST / 2)

    def take_sooner(self, misfit: OnCurve, end: OnCurve) -> Steps:
        """Take the touch before a motion that was refused just now, if it lies before the end.

        Returns None where that is reached, else as `pass_change`.
        """
        apart, left = misfit.way, self.behind_last(end).way
        nearer = yield from self.touch_before(misfit, apart, left)
        if nearer is not None and nearer.place.way < NEARER * left:
            return (yield from self.take(nearer))
        return apart / 4 if apart > within(self.search) else None

    def behind_last(self, motion: OnCurve) -> OnCurve:
        """A motion with its way from the last point, where both are cut at the same phase."""
        last = self.points[-1]
        if motion.contacts.section != last.contacts.section:
            return motion
        return replace(motion, way=abs(self.search.way(last, motion)))

    def verify(self, ahead: list[OnCurve], step: float | None) -> Steps:
        """Take motions up to one that breaks its contacts; returns the rest, or how the walk ended.

        Where a stop seems to change contact for a little while, motions in between are added. With
        a `step` the walk goes on by that behind them if none does.
        """
        if not ahead:
            return []
        following = None
        if step is not None:
            bounds = self.low, self.high
            following = self.search.onwards(ahead[-1], step, self.longest, STRIDE, bounds)
        every = yield self.search.look(ahead, following)
        return (yield from self.keep(list(zip(ahead, every, strict=True))))

    def keep(self, rest: list[tuple[OnCurve, Seen]]) -> Steps:
        """Take motions that were looked at, as `verify` does."""
        while rest:
            kept = yield from self.kept(*rest[0])
            if kept is None:
                return [motion for motion, _ in rest]
            rest[0] = motion, seen = kept
            closer = yield from self.closer(motion, seen, self.max_points - len(rest))
            if closer:
                rest = closer + rest
                continue
            del rest[0]
            if (yield from self.joins(motion, seen)):
                return Ending.joined
            self.add(motion, seen)
            if self.is_closed():
                self.close()
                return Ending.closed
        return []

    def closer(self, motion: OnCurve, seen: Seen, most: int, *, to_touch: bool = False) -> Steps:
        """Look between the last two points if a stop may change contact there, as one behind says.

        Or between the last one and a touch. Returns it and the last point, taken back, unless that
        is the touch; nothing with as many points as are allowed.
        """
        if len(self.points) >= most:
            return []
        before = 2 if to_touch else 3
        near = [*self.points[-before:], motion], [*self.seen[-before:], seen]
        found = yield from shallow_contact(self.search, *near, to_touch=to_touch)
        if found is None:
            return []
        (seen,) = yield self.search.look([found])
        if to_touch:
            return [(found, seen)]
        last = self.points.pop()
        return [(found, seen), (replace(last, way=last.way - found.way), self.seen.pop())]

    def kept(self, motion: OnCurve, seen: Seen) -> Steps:
        """A motion that keeps to its contacts, and what was seen of it; None if it breaks them."""
        if self.search.fits(motion, seen) and not self.search.uncounted(motion, seen):
            return motion, seen
        again = yield from self.search.recut(motion, seen)
        if again is None:
            self.refused = seen
        return again

    def close(self) -> None:
        """Take the first point as the last one too, in the place of one behind it."""
        first, last = self.points[0], self.points[-1]
        is_touch = any(touch.at == len(self.points) - 1 for touch in self.touches[-1:])
        if first.contacts == last.contacts and self.search.way(last, first) <= 0 and not is_touch:
            del self.points[-1], self.seen[-1]
        last = self.points[-1]
        if first.contacts == last.contacts and self.search.way(last, first) > 0:
            self.add(self.behind_last(replace(first, family=last.family)), self.seen[0])

    def is_closed(self) -> bool:
        """Whether the last point is where the walk began."""
        far = (self.points[0].parameter - self.points[-1].parameter) / self.search.scale
        if len(self.points) <= LOOP_POINTS or abs(far) > 0.75 * self.longest:  # as most are
            return False
        gone, home = self._apart(-2, -1), np.linalg.norm(self._apart(0, -1))
        near = home < 0.75 * min(np.linalg.norm(gone), self.longest)
        return bool(near and gone @ self._apart(0, 1) > 0)  # else it has turned round
