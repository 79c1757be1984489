"""Walking along a curve of exact periodic motions, from one set of contacts to the next.

The walk of one lane is a generator: it yields what is to be solved or looked at, the answers of
many lanes being computed side by side (`exact_branches`). Motions are solved for a few steps ahead
as if their contacts stayed as they are, then marched for a period: where the march meets other
contacts, the touch in between is solved for, and the walk goes on from there.
"""

from collections.abc import Generator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.branches.contacts import (
    Contacts,
    Pair,
    at_section,
    best_section,
    in_order,
    is_close,
    is_ordered,
    new_pairs,
    pairs,
    same,
    with_pairs,
    with_peak,
    without,
)
from vibrojax.branches.continuation import LOOP_POINTS, Ending

FIRST, SHORTEST = 0.02, 1e-9
"""Steps, in arclength: change of the state over its size, and of the parameter over its scale."""
ACCURATE = 1e-9
"""Largest last correction of a motion that counts as solved for."""
STRAIGHT = 0.85
"""Least cosine between tangents of neighbouring points."""
CLOSES = 0.3
"""Share of its duration that is left to a pair at the next step, where it may vanish."""
COLLAPSED = 0.1
"""Share of its duration below which a pair is taken to have vanished."""
MOST_AHEAD = 16
"""Points that are solved for before they are looked at."""
GROWTH = (3, 2.5), (4, 1.8), (5, 1.4), (7, 1.0), (np.inf, 0.7)
"""By what steps grow after so many rounds of Newton's method."""
LONGEST_TOUCH = 0.3
"""Duration, rad, of the first contact that is tried behind a touch."""
TOGETHER = 1e-7
"""Arclength within which touches happen at once."""


@dataclass(frozen=True)
class OnCurve:
    """A motion of a curve, and the direction in which the curve goes on."""

    contacts: Contacts
    times: Float[np.ndarray, " events"]
    state: Float[np.ndarray, " states"]
    """At the section, in units of energy."""
    parameter: float
    state_along: Float[np.ndarray, " states"]
    times_along: Float[np.ndarray, " events"]
    parameter_along: float
    matrix: Float[np.ndarray, "states states"]
    error: float = np.inf
    rounds: int = 0
    height_along: float = 0.0
    bend: float = 0.0
    way: float = 0.0
    """Arclength from the point before."""
    family: int = 0
    """Motions of one family have the same contacts, and no touch between them."""

    def reversed(self) -> "OnCurve":
        """The same motion, the curve followed the other way."""
        return replace(
            self,
            state_along=-self.state_along,
            times_along=-self.times_along,
            parameter_along=-self.parameter_along,
            height_along=-self.height_along,
        )

    @property
    def size(self) -> float:
        """Of the state, as a length."""
        return max(float(np.linalg.norm(self.state)), 1e-300)


class Ask(NamedTuple):
    """What is to be solved for: a guess and a condition (`orbit_curve.Condition`)."""

    contacts: Contacts
    times: Float[np.ndarray, " events"]
    state: Float[np.ndarray, " states"]
    parameter: float
    by_state: Float[np.ndarray, " states"] | float = 0.0
    by_times: Float[np.ndarray, " events"] | float = 0.0
    by_parameter: float = 0.0
    by_height: float = 0.0
    value: float = 0.0
    peak: int = -1


class Look(NamedTuple):
    """Motions that are to be marched and measured."""

    motions: list[OnCurve]
    sections: list[float] | None = None
    """Where their states are wanted too."""


class Seen(NamedTuple):
    """What a march of a motion showed."""

    contacts: Contacts
    times: Float[np.ndarray, " events"]
    fits: bool
    """Whether there was room for all events."""
    initial_state: Float[np.ndarray, " states"]
    at_section: Float[np.ndarray, " states"]
    measures: Any


class Touch(NamedTuple):
    """A touch between two points of a walk: the motion at it, and the pair that it is of."""

    at: int
    """Index of the point that is the touch."""
    entering: bool
    """Whether the pair is there behind the touch, or before it."""
    places: tuple[int, int]
    """Of the pair in the motions that have it."""
    stop: int


def fits(motion: OnCurve, seen: Seen) -> bool:
    """Whether a motion keeps to its contacts."""
    return seen.fits and same(motion.contacts, motion.times, seen.contacts, seen.times)


Steps = Generator[Ask | Look, Any, Any]


@dataclass
class Walk:
    """The way of one lane."""

    unit: Float[np.ndarray, " states"]
    """Weights of states (q, q') in the energy."""
    scale: float
    whole: float
    """Drive phase, rad, of a period of the motion."""
    low: float
    high: float
    longest: float
    max_points: int
    points: list[OnCurve] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    touches: list[Touch] = field(default_factory=list)
    asked: int = 0
    doubled: bool = False
    """Whether it is a walk along a period that was doubled, which may join the single one."""
    odd: Float[np.ndarray, " states"] | None = None
    """By how much the last point of such a walk differs from itself half a period later."""
    refused: Seen | None = None
    """What was seen of the motion that broke its contacts last."""

    # ------------------------------------------------------------------ conditions

    def along(self, a: OnCurve, state: np.ndarray, parameter: float) -> float:
        """Length of a change along the curve at a motion."""
        change = float(a.state_along @ state) / a.size**2
        return change + a.parameter_along * parameter / self.scale**2

    def ahead(self, a: OnCurve, step: float) -> Ask:
        """The motion a step further on."""
        by_state, by_parameter = a.state_along / a.size**2, a.parameter_along / self.scale**2
        return Ask(
            a.contacts,
            a.times + step * a.times_along,
            a.state + step * a.state_along,
            a.parameter + step * a.parameter_along,
            by_state=by_state,
            by_parameter=by_parameter,
            value=float(by_state @ a.state) + by_parameter * a.parameter + step,
        )

    def pinned(self, a: OnCurve, value: float) -> Ask:
        """The motion at a value of the parameter near a motion of the curve."""
        rate = a.parameter_along
        step = (value - a.parameter) / rate if rate else 0.0
        if abs(step) > 2 * self.longest:
            step = 0.0
        guess = self.ahead(a, step)
        return guess._replace(parameter=value, by_state=0.0, by_parameter=1.0, value=value)

    def solve(self, ask: Ask) -> Steps:
        """Solve for a motion; None where there is none."""
        self.asked += 1
        found = yield ask
        return found if found.error <= ACCURATE else None

    def is_sound(self, found: OnCurve | None) -> bool:
        """Whether a motion was found whose events follow one another."""
        return found is not None and is_ordered(found.contacts, found.times, self.whole)

    # ------------------------------------------------------------------ walking

    def go(self, start: OnCurve, way: float | None) -> Steps:
        """Walk from a motion in a direction of the parameter; returns how it ended.

        Without a `way` in the direction of the motion.
        """
        turns = way is not None and start.parameter_along * way < 0
        here = yield from self.cut_well(start.reversed() if turns else start)
        (seen,) = yield Look([here])
        self.add(here, seen)
        begun, step, room, ahead = start.parameter, FIRST, 4, []
        idle = 0
        while True:
            last = ahead[-1] if ahead else self.points[-1]
            if len(self.points) + len(ahead) > self.max_points:
                return Ending.running
            found, next_step, goal = yield from self.further(last, step)
            if found is None and not self.closing(last, step):
                step *= 0.4
                if step >= SHORTEST:
                    continue
            if found is not None:
                ahead.append(found)
            if found is not None and goal is None and len(ahead) < room:
                step = next_step
                continue
            count = yield from self.verify(ahead)
            if isinstance(count, Ending):
                return count
            if count < len(ahead):
                last, bad, seen = self.points[-1], ahead[count], self.refused
                apart = max(bad.way, 2 * SHORTEST)
                ahead, room = [], 4
                came = yield from self.touch_between(last, bad, seen, apart)
                idle += 1
                step = FIRST / 2 if came else apart / 4
                if step < SHORTEST or idle > 40:
                    return Ending.stuck
                continue
            room, ahead = min(2 * room, MOST_AHEAD), []
            if goal is not None:
                return Ending.turned_back if goal == begun else Ending.completed
            if found is not None:
                step, idle = next_step, 0
                continue
            came = yield from self.vanish(self.points[-1], step)
            idle += 1
            step = FIRST / 2 if came else step / 2.5
            if step < SHORTEST or idle > 40:
                return Ending.stuck

    def add(self, motion: OnCurve, seen: Seen) -> None:
        """Take a motion as a point of the curve."""
        self.points.append(motion)
        self.seen.append(seen)

    def verify(self, ahead: list[OnCurve]) -> Steps:
        """Take motions that keep to their contacts; returns how many, or that the curve closed."""
        if not ahead:
            return 0
        every = yield Look(ahead, self.halfway(ahead) if self.doubled else None)
        for k, (motion, seen) in enumerate(zip(ahead, every, strict=True)):
            if not fits(motion, seen):
                self.refused = seen
                return k
            if self.doubled:
                odd = self.unit * seen.initial_state - seen.at_section
                if float(odd @ (self.odd if self.odd is not None else odd)) < 0:
                    return Ending.joined
                self.odd = odd
            self.add(motion, seen)
            if self.is_closed():
                return Ending.closed
        return len(ahead)

    def halfway(self, motions: list[OnCurve]) -> list[float]:
        """Drive phases half a period after phase 0, behind the sections."""
        half = self.whole / 2
        return [half if half >= m.contacts.section else half + self.whole for m in motions]

    def is_closed(self) -> bool:
        """Whether the last point is where the walk began."""
        if len(self.points) <= LOOP_POINTS:
            return False
        first, before, last = (self.unit * self.seen[k].initial_state for k in (0, -2, -1))
        p, q, r = (self.points[k].parameter for k in (0, -2, -1))
        size = np.linalg.norm(last)
        gone = np.hypot(np.linalg.norm(last - before) / size, (r - q) / self.scale)
        home = np.hypot(np.linalg.norm(last - first) / size, (r - p) / self.scale)
        return bool(home < 0.75 * min(gone, self.longest))

    def further(self, last: OnCurve, step: float) -> Steps:
        """Solve for the next motion: that, the step behind it, and the end of the range met."""
        ask, goal = self.ahead(last, step), None
        if not self.low < ask.parameter < self.high:
            goal = self.high if ask.parameter >= self.high else self.low
            ask = self.pinned(last, goal)
        found = yield from self.solve(ask)
        if found is not None and not is_ordered(found.contacts, found.times, self.whole):
            found = yield from self.swapped(ask, found)
        if found is not None and goal is None and not self.low <= found.parameter <= self.high:
            goal = self.high if found.parameter > self.high else self.low
            found = yield from self.solve(self.pinned(last, goal))
        if found is None or not self.is_sound(found) or self.collapses(last, found):
            return None, step, None
        found, size = self.oriented(found, last), last.size
        cosine = self.along(last, found.state_along, found.parameter_along)
        cosine /= np.hypot(
            np.linalg.norm(found.state_along) / size, found.parameter_along / self.scale
        )
        gone = np.hypot(
            np.linalg.norm(found.state - last.state) / size,
            (found.parameter - last.parameter) / self.scale,
        )
        long = 2.5 * step + 1e-9
        if cosine < STRAIGHT or gone > long or self.turns_twice(last, found, step):
            return None, step, None
        growth = next(g for most, g in GROWTH if found.rounds <= most)
        growth = growth if cosine > 0.97 else min(growth, 1.0)
        found = yield from self.cut_well(found)
        return found, min(step * growth, self.longest), goal

    def swapped(self, ask: Ask, found: OnCurve) -> Steps:
        """Solve again where stops change contact in another order; None for one stop."""
        contacts, times = in_order(found.contacts, found.times)
        moved = [a != b for a, b in zip(contacts.stops, found.contacts.stops, strict=True)]
        if sum(moved) != 2:
            return None
        by_times = ask.by_times
        return (
            yield from self.solve(
                ask._replace(
                    contacts=contacts,
                    times=times,
                    state=found.state,
                    parameter=found.parameter,
                    by_times=by_times,
                )
            )
        )

    def collapses(self, last: OnCurve, found: OnCurve) -> bool:
        """Whether a pair has all but vanished: of no duration it fits everywhere."""
        if last.contacts.stops != found.contacts.stops:
            return False
        both = zip(
            pairs(last.contacts, last.times), pairs(found.contacts, found.times), strict=True
        )
        return any(np.ptp(b.times) < COLLAPSED * np.ptp(a.times) for a, b in both)

    def turns_twice(self, a: OnCurve, b: OnCurve, step: float) -> bool:
        """Whether the parameter may turn round and back between two motions."""
        if step < 1e-4 or a.parameter_along * b.parameter_along <= 0:
            return False
        # The cubic with these values and rates: whether its rate passes zero inside.
        left, right = a.parameter_along * step, b.parameter_along * step
        middle = 1.5 * (b.parameter - a.parameter) - (left + right) / 4
        return bool(middle * left < 0)

    def oriented(self, found: OnCurve, last: OnCurve) -> OnCurve:
        """The motion with the direction in which the curve was followed to it."""
        way = self.along(last, found.state - last.state, found.parameter - last.parameter)
        found = replace(found, family=last.family, way=way)
        forward = self.along(last, found.state_along, found.parameter_along)
        return found if forward >= 0 else found.reversed()

    def cut_well(self, motion: OnCurve) -> Steps:
        """Move the section away from where contact changes."""
        if not is_close(motion.contacts, motion.times, self.whole):
            return motion
        section = best_section(motion.contacts, motion.times, self.whole)
        cut = yield from self.cut_at(motion, section)
        return motion if cut is None else cut

    def cut_at(self, motion: OnCurve, section: float) -> Steps:
        """Cut a motion at another drive phase; None where that does not work."""
        if section < motion.contacts.section:
            section += self.whole
        (seen,) = yield Look([motion], [section])
        contacts, times, order = at_section(motion.contacts, motion.times, section, self.whole)
        by_times, by_parameter = motion.times_along[order], motion.parameter_along / self.scale**2
        length = max(float(np.max(np.abs(by_times), initial=0.0)), abs(by_parameter), 1e-300)
        by_times, by_parameter = by_times / length, by_parameter / length
        found = yield from self.solve(
            Ask(
                contacts,
                times,
                seen.at_section,
                motion.parameter,
                by_times=by_times,
                by_parameter=by_parameter,
                value=float(by_times @ times) + by_parameter * motion.parameter,
            )
        )
        if found is None or not self.is_sound(found):
            return None
        found = replace(found, family=motion.family, way=motion.way)
        forward = found.times_along @ by_times + found.parameter_along * by_parameter
        return found if forward >= 0 else found.reversed()

    # ------------------------------------------------------------------ touches

    def closing(self, last: OnCurve, step: float) -> list[tuple[float, Pair]]:
        """Pairs that may vanish within a step, with the way until then."""
        found = []
        for pair in pairs(last.contacts, last.times):
            i, j = pair.places
            lasts = last.times[j] - last.times[i]
            rate = last.times_along[j] - last.times_along[i]
            if rate < 0 and lasts + step * rate < CLOSES * lasts:
                # Durations fall off as the square root of the way.
                found.append((lasts / (-2 * rate), pair))
        return sorted(found, key=lambda each: each[0])

    def touch_at(self, contacts, times, state, parameter, stop: int, angle: float) -> Steps:
        """Solve for the motion that just touches a stop; with its peak as an event taken out."""
        peaked, every, place = with_peak(contacts, times, stop, angle)
        found = yield from self.solve(
            Ask(peaked, every, state, parameter, by_height=1.0, peak=place)
        )
        if found is None or not self.is_sound(found) or not found.bend < 0:
            return None
        without_peak = replace(
            found,
            contacts=contacts,
            times=np.delete(found.times, place),
            times_along=np.delete(found.times_along, place),
        )
        return without_peak, float(found.times[place])

    def vanish(self, last: OnCurve, step: float) -> Steps:
        """Go to the touch at which a contact ends to be; says whether there is one."""
        closing = self.closing(last, step)
        if not closing:
            return False
        groups = [closing[:1]]
        together = [each for each in closing if each[0] <= 2 * closing[0][0]]
        if len(together) > 1:
            groups = [together, closing[:1]]
        for group in groups:
            way, pair = group[0]
            contacts, times = without(last.contacts, last.times, [p for _, p in group])
            rate = without(last.contacts, last.times_along, [p for _, p in group])[1]
            guess = last.state + way * last.state_along
            came = yield from self.touch_at(
                contacts,
                times + way * rate,
                guess,
                last.parameter + way * last.parameter_along,
                pair.stop,
                pair.middle,
            )
            if came is None:
                continue
            touch, _ = came
            gone = self.along(last, touch.state - last.state, touch.parameter - last.parameter)
            if not -TOGETHER < gone < 4 * max(step, way):
                continue
            # Behind the touch the stop is left further and further.
            touch = touch if touch.height_along < 0 else touch.reversed()
            touch = replace(touch, family=last.family + 1, way=abs(gone))
            (seen,) = yield Look([touch])
            self.touches.append(Touch(len(self.points), False, pair.places, pair.stop))
            self.add(touch, seen)
            return True
        return False

    def touch_between(self, last: OnCurve, bad: OnCurve, seen: Seen, apart: float) -> Steps:
        """Go to the touch before a motion that breaks its contacts, and beyond it."""
        if bad.contacts.section != last.contacts.section:
            cut = yield from self.cut_at(last, bad.contacts.section)
            if cut is None:
                return False
            last = cut
        extra = new_pairs(bad.contacts, bad.times, seen.contacts, seen.times) if seen.fits else None
        if not extra:
            return (yield from self.vanish(last, apart))
        found = []
        for pair in extra:
            came = yield from self.touch_at(
                bad.contacts, bad.times, bad.state, bad.parameter, pair.stop, pair.middle
            )
            if came is None:
                continue
            touch, angle = came
            gone = self.along(last, touch.state - last.state, touch.parameter - last.parameter)
            if -TOGETHER < gone < 1.2 * apart + TOGETHER:
                found.append((gone, pair.stop, angle, touch))
        if not found:
            return False
        found.sort(key=lambda each: each[0])
        touch = found[0][3]
        # Before the touch the stop came nearer and nearer.
        touch = touch if touch.height_along > 0 else touch.reversed()
        at_once = [each for each in found if each[0] - found[0][0] < TOGETHER]
        return (yield from self.enter(last, touch, at_once, apart))

    def enter(self, last: OnCurve, touch: OnCurve, new: list[Any], apart: float) -> Steps:
        """Go beyond a touch, to a motion with the new contacts."""
        touch = replace(touch, family=last.family, way=abs(new[0][0]))
        ends = np.concatenate(
            [[touch.contacts.section], touch.times, [touch.contacts.section + self.whole]]
        )
        room = min(float(np.min(np.abs(ends - angle))) for _, _, angle, _ in new)
        lasts = [np.sqrt(8 * abs(t.height_along / t.bend)) for *_, t in new]
        first = min(lasts[0] * np.sqrt(max(apart, FIRST)), 0.5 * room, LONGEST_TOUCH)
        for _ in range(30):
            way = (first / lasts[0]) ** 2 if lasts[0] > 0 else 0.0
            way = min(way, max(apart, FIRST))
            both = [
                Pair(stop, (0, 0), (angle - d * first / 2, angle + d * first / 2))
                for (_, stop, angle, _), d in zip(new, np.array(lasts) / lasts[0], strict=True)
            ]
            moved = touch.times + way * touch.times_along
            contacts, times = with_pairs(touch.contacts, moved, both)
            at = np.flatnonzero(np.isin(times, both[0].times))
            if len(at) == 2 and is_ordered(contacts, times, self.whole):
                places = int(at[0]), int(at[1])
                by_times = np.zeros(len(times))
                by_times[list(places)] = -1.0, 1.0
                found = yield from self.solve(
                    Ask(
                        contacts,
                        times,
                        touch.state + way * touch.state_along,
                        touch.parameter + way * touch.parameter_along,
                        by_times=by_times,
                        value=first,
                    )
                )
                if found is not None and self.is_sound(found):
                    grows = found.times_along @ by_times > 0
                    found = found if grows else found.reversed()
                    gone = self.along(
                        touch, found.state - touch.state, found.parameter - touch.parameter
                    )
                    found = replace(found, family=last.family + 1, way=abs(gone))
                    both_seen = yield Look([touch, found])
                    if fits(found, both_seen[1]):
                        self.touches.append(Touch(len(self.points), True, places, new[0][1]))
                        self.add(touch, both_seen[0])
                        self.add(found, both_seen[1])
                        return True
            first *= 0.4
        return False
