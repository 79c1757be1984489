"""Searches for motions of a curve, each from one that is known."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from vibrojax.branches.contacts import (
    TURN,
    Contacts,
    Pair,
    at_section,
    best_section,
    in_order,
    is_close,
    is_ordered,
    same,
    without,
)
from vibrojax.branches.neighbours import collapses, skips, turns_round, turns_twice
from vibrojax.branches.on_curve import Ask, Look, OnCurve, Seen, Steps, at_value
from vibrojax.steady.curve_programs import ACCURATE, STRAIGHT
from vibrojax.steady.orbit_curve import Stride

LEAPT = 0.3
"""Most that a motion may be off what the directions at it and the last one say, over the step."""
JOINED = 4.0
"""Most that what differs between the halves of a motion changes by on the way, over that."""
SINGLE, ALIKE = 1e-3, 1e-10
"""Most that is left of it where both halves are the same, over what there was; over the motion."""
UNCOUNTED = 1e-12
"""Depth over the amplitude that is no round-off, though a march does not count it."""
LOOSE = 1e-8
"""Drive angle, rad, by which a march is off that has gone astray."""
FARTHEST = 0.16
"""Farthest in arclength that a tangent is followed for a guess."""
LEAPS = (1e-5, 1e-4, 1e-3, 1e-2, 4e-2)
"""Arclengths by which changes of contact are leapt over that cannot be passed one by one."""
FARTHER = 4.0
"""Farthest that a motion behind a leap may be, over the length of the leap."""
TRIES = 6
"""Marches by which the contacts of a motion near a state are found."""


@dataclass
class CurveSearch:
    """Searches along the curve of one lane."""

    unit: Float[np.ndarray, " states"]
    """Weights of states (q, q') in the energy."""
    scale: float
    """Change of the parameter that counts as much as the state changing by its size."""
    whole: float
    """Drive phase, rad, of a period of the motion."""
    smooth: bool
    """Whether the curve has no corner at a touch: the force of no stop jumps there for good."""
    brief: float
    """Drive angle, rad, of a contact that may be too shallow for a march to count, and that a march
    may be off where a motion is unstable."""
    doubled: bool = False
    """Whether it is of a period that was doubled: the curve may join that of the single one."""
    asked: int = 0
    """Motions that were solved for."""

    def along(self, a: OnCurve, state: np.ndarray, parameter: float) -> float:
        """Length of a change along the curve at a motion."""
        change = float(a.state_along @ state) / a.size**2
        return change + a.parameter_along * parameter / self.scale**2

    def way(self, a: OnCurve, b: OnCurve) -> float:
        """Length along the curve at a motion to another that is cut at the same drive phase."""
        return self.along(a, b.state - a.state, b.parameter - a.parameter)

    def is_behind(self, touch: OnCurve, last: OnCurve) -> bool:
        """Whether a touch at which a contact begins lies behind a point, if only a little."""
        if touch.family != last.family or touch.contacts != last.contacts:
            return False
        return self.way(last, touch) < 0

    def apart(self, a: OnCurve, b: OnCurve) -> float:
        """Distance of two motions that are cut at the same drive phase, in arclength."""
        return self.size(a, b.state - a.state, b.parameter - a.parameter)

    def size(self, a: OnCurve, state: np.ndarray, parameter: float) -> float:
        """Size of a change at a motion, in arclength."""
        return float(np.hypot(np.linalg.norm(state) / a.size, parameter / self.scale))

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
        if abs(step) > FARTHEST:
            step = 0.0
        guess = self.ahead(a, step)
        return guess._replace(parameter=value, by_state=0.0, by_parameter=1.0, value=value)

    def solve(self, ask: Ask) -> Steps:
        """Solve for a motion; None where there is none."""
        return (yield from self.every(ask))[0]

    def every(self, ask: Ask) -> Steps:
        """Solve for a motion and those of its stride; None for the last where there is none."""
        found = yield ask
        self.asked += len(found)
        return [motion if motion.error <= ACCURATE else None for motion in found]

    def onwards(
        self, last: OnCurve, step: float, longest: float, room: int, bounds: tuple[float, float]
    ) -> Ask:
        """The motion a step further on, and behind that up to `room` in all."""
        ask = self.ahead(last, step)
        return ask._replace(stride=Stride(last.size, step, longest, *bounds, room))

    def further(
        self,
        last: OnCurve,
        step: float,
        longest: float,
        rest: list[OnCurve | None],
        room: int,
        bounds: tuple[float, float],
    ) -> Steps:
        """Solve for the next motion: that, the end of the range met, and the rest of a stride.

        `rest` are motions behind the last that are solved for already. Where there are none, up to
        `room` are solved for; what is left of them is worth something only behind the first.
        """
        goal, (low, high) = None, bounds
        ask = self.onwards(last, step, longest, room, bounds)
        if not low < ask.parameter < high:
            goal = high if ask.parameter >= high else low
            ask, rest = self.pinned(last, goal), []
        if not rest:
            rest = yield from self.every(ask)
        found, *rest = rest
        if found is not None and not is_ordered(found.contacts, found.times, self.whole):
            found, rest = (yield from self.swapped(ask, found)), []
        if found is not None and goal is None and not low <= found.parameter <= high:
            goal = high if found.parameter > high else low
            found, rest = (yield from self.solve(self.pinned(last, goal))), []
        found = None if found is None else self.oriented(found, last)
        if found is None or not self.comes_next(found, last, step):
            return None, None, []
        cut = yield from self.cut_well(found)
        return cut, goal, rest if cut is found else []

    def swapped(self, ask: Ask, found: OnCurve) -> Steps:
        """Solve again where stops change contact in another order; None for one stop."""
        contacts, times = in_order(found.contacts, found.times)
        moved = [a != b for a, b in zip(contacts.stops, found.contacts.stops, strict=True)]
        if sum(moved) != 2:
            return None
        near = ask._replace(contacts=contacts, times=times, state=found.state)
        one = ask.stride._replace(most=1)
        return (yield from self.solve(near._replace(parameter=found.parameter, stride=one)))

    def near(
        self, state: Float[np.ndarray, " states"], value: float, section: float = 0.0
    ) -> Steps:
        """Solve for the motion near a state at a drive phase, at a value; None where there is none.

        Nothing has to be known of its contacts: marches find them.
        """
        nothing = np.zeros(0)
        free = Contacts((), 0, section)
        guess = OnCurve(free, nothing, state, value, 0 * state, nothing, 0.0, np.eye(len(state)))
        for _ in range(TRIES):
            (seen,) = yield Look([guess])
            if not seen.fits:
                return None
            contacts, times = seen.contacts, seen.times
            met = replace(guess, contacts=contacts, times=times, times_along=0 * times)
            section = best_section(contacts, times, self.whole)
            contacts, times, state, _ = yield from self.from_phase(met, section)
            guess = replace(met, contacts=contacts, times=times, state=state)
            (found,) = yield at_value(contacts, times, state, value)
            if not np.isfinite(found.error):
                return None
            if self.is_sound(found) and found.error <= ACCURATE:
                (seen,) = yield Look([found])
                if self.fits(found, seen):
                    return found
            guess = found
        return None

    def leapt(self, last: OnCurve, bounds: tuple[float, float]) -> Steps:
        """Motion a little farther on, whatever its contacts, and what was seen; None for none."""
        for length in LEAPS:
            guess = self.ahead(last, length)
            if not bounds[0] < guess.parameter < bounds[1]:
                return None
            section = last.contacts.section
            found = yield from self.near(guess.state, guess.parameter, section)
            if found is not None and found.contacts.section != section:
                found = yield from self.cut_at(found, section)
            if found is None:
                continue
            found = self.oriented(found, last)
            if found.way <= 0 or self.apart(last, found) > FARTHER * length:
                continue
            (seen,) = yield self.look([found])
            if self.fits(found, seen):
                return replace(found, family=last.family + 1), seen
        return None

    def is_sound(self, found: OnCurve | None) -> bool:
        """Whether a motion was found whose events follow one another."""
        return found is not None and is_ordered(found.contacts, found.times, self.whole)

    def look(self, motions: list[OnCurve], following: Ask | None = None) -> Look:
        """Ask what a march of motions shows; of a doubled period also where half of it is over."""
        half = self.whole / 2
        sections = [m.contacts.section + half for m in motions] if self.doubled else None
        return Look(motions, sections, following)

    def halves(self, motion: OnCurve) -> float:
        """By how much times of contact differ between the halves of a motion, rad."""
        stops, times = motion.contacts.stops, motion.times
        first, second = np.split(times, 2) if len(times) % 2 == 0 else (times, times[:0])
        if stops[: len(first)] != stops[len(first) :]:
            return TURN
        return float(np.max(np.abs(second - first - self.whole / 2), initial=0.0))

    def joins(self, last: OnCurve, before: Seen, found: OnCurve, seen: Seen) -> Steps:
        """Whether between motions of a doubled period, or at the next, both halves are the same.

        There the curve meets that of the single period, and goes on along itself, the halves
        changed over: what they differ by passes zero. It may also turn by an impact.
        """
        if not self.doubled:
            return False
        odd, was = found.state - seen.at_section, last.state - before.at_section
        section, half = found.contacts.section, self.whole / 2
        if section != last.contacts.section:
            at = [self.behind_section(last, angle) for angle in (section, section + half)]
            one, other = yield Look([last, last], at)
            was = one.at_section - other.at_section
        if np.linalg.norm(odd) <= max(SINGLE * np.linalg.norm(was), ALIKE * found.size):
            return True
        near = float(np.linalg.norm(odd - was)) <= JOINED * found.way * found.size
        return near and float(odd @ was) < 0

    def fits(self, motion: OnCurve, seen: Seen) -> bool:
        """Whether a motion keeps to its contacts; a march may miss the shallowest."""
        if not seen.fits:
            return False
        met = seen.contacts, seen.times
        every = [(motion.contacts, motion.times), *self.without_shallow(motion, seen)]
        return any(same(*own, *met, self.brief) for own in every)

    def met_others(self, motion: OnCurve, seen: Seen) -> bool:
        """Whether a march met other contacts in the place of a motion's own, not just fewer."""
        return seen.fits and len(seen.times) >= len(motion.times) and not self.fits(motion, seen)

    def without_shallow(
        self, motion: OnCurve, seen: Seen
    ) -> list[tuple[Contacts, Float[np.ndarray, " others"]]]:
        """Contacts of a motion without one of those that a march may miss."""
        missed = [p for p in motion.pairs if p.length < self.brief or self.is_too_shallow(p, seen)]
        return [without(motion.contacts, motion.times, [pair]) for pair in missed]

    def is_too_shallow(self, pair: Pair, seen: Seen) -> bool:
        """Whether a march went through a contact, but by too little to count it."""
        heights, angles = seen.nearest
        if not (pair.stop < len(heights) and heights[pair.stop] > 0):
            return False
        off = math.remainder(angles[pair.stop] - pair.middle, self.whole)
        return abs(off) < pair.length / 2

    def behind_section(self, motion: OnCurve, angle: float) -> float:
        """A drive phase, rad, as the one within a period from the section of a motion on."""
        section = motion.contacts.section
        return section + (angle - section) % self.whole

    def uncounted(self, motion: OnCurve, seen: Seen) -> list[Pair]:
        """Changes of contact that a march went through without counting them, of no duration."""
        measures = seen.measures
        least = UNCOUNTED * max(abs(float(measures.highest)), abs(float(measures.lowest)))
        # A contact of its own that a march did not count it has all the same.
        missed = motion.pairs if len(seen.times) < len(motion.times) else []
        own = {pair.stop for pair in missed if self.is_too_shallow(pair, seen)}
        found = []
        for stop, (height, angle) in enumerate(zip(*seen.nearest, strict=True)):
            if height > least and stop not in own:
                at = self.behind_section(motion, angle)
                found.append(Pair(stop, (0, 0), (at, at)))
        return found

    def oriented(self, found: OnCurve, last: OnCurve) -> OnCurve:
        """The motion with the direction in which the curve was followed to it."""
        way = self.way(last, found)
        found = replace(found, family=last.family, way=way)
        forward = self.along(last, found.state_along, found.parameter_along)
        return found if forward >= 0 else found.reversed()

    def comes_next(self, found: OnCurve, last: OnCurve, step: float) -> bool:
        """Whether a motion is the one a step behind the last."""
        if not self.is_sound(found) or collapses(last, found, ahead=True):
            return False
        cosine = self.along(last, found.state_along, found.parameter_along)
        cosine /= self.size(last, found.state_along, found.parameter_along)
        near = self.apart(last, found) <= 2.5 * step + 1e-9
        turns = turns_round(last, found) or turns_twice(last, found, step)
        leaves = turns or self.leaps(last, found) or skips(last, found)
        leaves = leaves or (self.doubled and self.halves(found) <= SINGLE * self.halves(last))
        return bool(cosine >= STRAIGHT and near and not leaves)

    def leaps(self, last: OnCurve, found: OnCurve) -> bool:
        """Whether a motion is on another part of the curve, which comes near to the last one's."""
        half = found.way / 2
        one, other = self.ahead(last, half), self.ahead(found, -half)
        off = self.size(last, one.state - other.state, one.parameter - other.parameter)
        return off > LEAPT * self.apart(last, found) + ACCURATE

    def cut_well(self, motion: OnCurve) -> Steps:
        """Move the section away from where contact changes."""
        if not is_close(motion.contacts, motion.times, self.whole):
            return motion
        section = best_section(motion.contacts, motion.times, self.whole)
        cut = yield from self.cut_at(motion, section)
        return motion if cut is None else cut

    def recut(self, motion: OnCurve, seen: Seen) -> Steps:
        """Cut a motion where a march went astray, and look again; None if that fails.

        Where a motion is very unstable, what is ahead of a shallow contact grows beyond its depth,
        and an error at a stop that is left all but tangentially grows behind it.
        """
        place = self._astray(motion, seen) if seen.fits else None
        if place is None:
            return None
        before = motion.times[place - 1] if place else motion.times[-1] - self.whole
        section = (before + motion.times[place]) / 2
        section += self.whole if section < motion.contacts.section else 0.0
        cut = yield from self.cut_at(motion, section)
        if cut is None:
            return None
        (seen,) = yield self.look([cut])
        return (cut, seen) if self.fits(cut, seen) else None

    def _astray(self, motion: OnCurve, seen: Seen) -> int | None:
        """Place of the event ahead of which a march has to begin to meet the contacts; or None."""
        own, met = (motion.contacts, motion.times), (seen.contacts, seen.times)
        for pair in motion.pairs:
            if same(*without(*own, [pair]), *met, self.brief):
                return pair.places[0]
        if motion.contacts == seen.contacts:
            off = np.flatnonzero(np.abs(motion.times - seen.times) > LOOSE)
            if len(off) and off[0] + 1 < len(motion.times):
                return int(off[0]) + 1
        return None

    def from_phase(self, motion: OnCurve, section: float) -> Steps:
        """Contacts, times, state of a motion from another section on; old places of the times."""
        if section < motion.contacts.section:
            section += self.whole
        (seen,) = yield Look([motion], [section])
        contacts, times, order = at_section(motion.contacts, motion.times, section, self.whole)
        return contacts, times, seen.at_section, order

    def cut_at(self, motion: OnCurve, section: float) -> Steps:
        """Cut a motion at another drive phase; None where that does not work."""
        contacts, times, state, order = yield from self.from_phase(motion, section)
        by_times, by_parameter = motion.times_along[order], motion.parameter_along / self.scale**2
        length = max(float(np.max(np.abs(by_times), initial=0.0)), abs(by_parameter), 1e-300)
        by_times, by_parameter = by_times / length, by_parameter / length
        found = yield from self.solve(
            Ask(
                contacts,
                times,
                state,
                motion.parameter,
                by_times=by_times,
                by_parameter=by_parameter,
                value=float(by_times @ times) + by_parameter * motion.parameter,
            )
        )
        if found is None or not self.is_sound(found):
            return None
        found = replace(found, family=motion.family, way=motion.way, step=motion.step)
        forward = found.times_along @ by_times + found.parameter_along * by_parameter
        return found if forward >= 0 else found.reversed()
