"""Touches along a curve: where a contact begins or ends, and the way beyond."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.branches.contacts import (
    Contacts,
    Pair,
    Times,
    duration_row,
    is_ordered,
    new_pairs,
    same,
    with_pairs,
    with_peak,
    without,
)
from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.on_curve import Ask, OnCurve, Seen, Steps, Touch
from vibrojax.branches.stretch import NEXT_TO_TOUCH, Stretch

CLOSES = 0.3
"""Share of its duration that is left to a pair at the next step, where it may vanish."""
LONGEST_TOUCH = 0.3
"""Duration, rad, of the first contact that is tried behind a touch."""
BEHIND = 1e-2
"""How far a touch may lie behind the last point: contacts too shallow to count are not seen."""
BEYOND = 1.2
"""Share of the way to what was refused within which the touch before it may lie."""
TOGETHER = 1e-7
"""Arclength within which touches happen at once."""
SHARP = 1e-6
"""Arclength within which curves of stiff stops may turn round next to a touch."""
FASTEST, CHANGES = 3, (0.5, 0.2, 0.05, 0.01, 0.002)
"""Contacts whose duration is made to change, and by what share, in order of trying."""
LEAST_WAY = 0.02
"""Arclength behind a touch that is tried at the least."""
WITHIN = 1e-5
"""Arclength up to which it is not looked between a touch and its neighbour."""


class Passed(NamedTuple):
    """The way through a touch."""

    motions: list[OnCurve]
    """Where a contact ends, the motions ahead of the touch, and the touch; where one begins, the
    touch, the motions behind it and the first that was found with the contact."""
    seen: list[Seen]
    touch: Touch
    """Counted from the first of them."""

    @property
    def place(self) -> OnCurve:
        """The touch itself."""
        return self.motions[self.touch.at]


def closing(last: OnCurve, step: float) -> list[tuple[float, Pair]]:
    """Pairs that may vanish within a step, with the way until then."""
    found = []
    for pair in last.pairs:
        i, j = pair.places
        lasts = last.times[j] - last.times[i]
        rate = last.times_along[j] - last.times_along[i]
        if rate < 0 and lasts + step * rate < CLOSES * lasts:
            # Durations fall off as the square root of the way.
            found.append((lasts / (-2 * rate), pair))
    return sorted(found, key=lambda each: each[0])


def touch_at(
    search: CurveSearch,
    guess: tuple[Contacts, Times, Float[np.ndarray, " states"], float],
    stop: int,
    angle: float,
) -> Steps:
    """Solve for the motion that just touches a stop; with its peak as an event taken out."""
    contacts, times, state, parameter = guess
    peaked, every, place = with_peak(contacts, times, stop, angle)
    found = yield from search.solve(Ask(peaked, every, state, parameter, by_height=1.0, peak=place))
    if found is None or not search.is_sound(found) or not found.bend < 0:
        return None
    without_peak = replace(
        found,
        contacts=contacts,
        times=np.delete(found.times, place),
        times_along=np.delete(found.times_along, place),
    )
    return without_peak, float(found.times[place])


def vanish(search: CurveSearch, last: OnCurve, step: float, bounds: tuple[float, float]) -> Steps:
    """Go to the touch at which a contact ends to be, if that is within bounds of the parameter."""
    near = closing(last, step)
    if not near:
        return None
    together = [each for each in near if each[0] <= 2 * near[0][0]]
    for group in [near[:1], together][: len(together)]:
        way, pair = group[0]
        contacts, times = without(last.contacts, last.times, [p for _, p in group])
        rate = without(last.contacts, last.times_along, [p for _, p in group])[1]
        state = last.state + way * last.state_along
        guess = contacts, times + way * rate, state, last.parameter + way * last.parameter_along
        came = yield from touch_at(search, guess, pair.stop, pair.middle)
        if came is None:
            continue
        touch, _ = came
        gone = search.way(last, touch)
        if not -TOGETHER < gone < 4 * max(step, way) or not _is_within(touch, bounds):
            continue
        # Behind the touch the stop is left further and further.
        touch = touch if touch.height_along < 0 else touch.reversed()
        if search.smooth and gone > SHARP and not _goes_on(search, last, touch):
            continue
        touch = replace(touch, family=last.family + 1, way=abs(gone))
        passed = Touch(0, False, pair.places, pair.stop)
        motions = [*(yield from _between(search, last, touch, passed)), touch]
        seen = yield search.look(motions)
        if not _only_touches(search, touch, seen[-1]):
            continue
        return Passed(motions, seen, passed._replace(at=len(motions) - 1))
    return None


def within(search: CurveSearch) -> float:
    """Arclength up to which it is not looked between a touch and its neighbour.

    Next to the branch of the single period that of the doubled one is short.
    """
    return TOGETHER if search.doubled else WITHIN


def _between(search: CurveSearch, first: OnCurve, last: OnCurve, touch: Touch) -> Steps:
    """Solve for motions between a touch and its neighbour, unless that is very near."""
    if abs(search.way(first, last)) <= within(search):
        return []
    return (yield from Stretch(search, first, last, touch).next_to_touch())


def _only_touches(search: CurveSearch, touch: OnCurve, seen: Seen) -> bool:
    """Whether a motion keeps to its contacts, but for those that it just touches."""
    if not seen.fits:
        return False
    extra = new_pairs(touch.contacts, touch.times, seen.contacts, seen.times)
    if extra is None:
        return False
    kept = without(seen.contacts, seen.times, extra)
    shallow = all(pair.length < search.brief for pair in extra)
    return shallow and same(touch.contacts, touch.times, *kept, search.brief)


def touch_between(
    search: CurveSearch,
    last: OnCurve,
    bad: OnCurve,
    seen: Seen,
    apart: float,
    reach: float,
    bounds: tuple[float, float],
) -> Steps:
    """Go to the touch before a motion that breaks its contacts, and beyond it, within bounds.

    A march of an unstable motion misses contacts some way before they end: one that ends is looked
    for up to `reach` ahead, unless the march met others, as behind two changes of contact.
    """
    extra = _met_beyond(search, bad, seen)
    if not extra:
        if search.met_others(bad, seen):
            return None
        return (yield from vanish(search, last, reach, bounds))
    if bad.contacts.section != last.contacts.section:
        cut = yield from search.cut_at(last, bad.contacts.section)
        if cut is None:
            return None
        last = cut
    found = []
    for pair in extra:
        guess = bad.contacts, bad.times, bad.state, bad.parameter
        came = yield from touch_at(search, guess, pair.stop, pair.middle)
        if came is None:
            continue
        touch, angle = came
        gone = search.way(last, touch)
        # Before the touch the stop came nearer and nearer.
        touch = touch if touch.height_along > 0 else touch.reversed()
        if -BEHIND < gone < BEYOND * apart + TOGETHER and _goes_on(search, last, touch):
            found.append((gone, pair.stop, angle, touch))
    if not found:
        return None
    found.sort(key=lambda each: each[0])
    touch = found[0][3]
    at_once = [each for each in found if each[0] - found[0][0] < TOGETHER]
    return (yield from _enter(search, last, touch, at_once, apart, bounds))


def _touch_sooner(
    search: CurveSearch,
    last: OnCurve,
    touch: OnCurve,
    seen: Seen,
    gone: float,
    bounds: tuple[float, float],
) -> Steps:
    """Go to the touch before one where contacts have come already, as a stop that is near twice."""
    apart = (gone - 2 * TOGETHER) / BEYOND  # sooner: each of the two may show the other as ahead
    if apart <= 0:
        return None
    return (yield from touch_between(search, last, touch, seen, apart, 0.0, bounds))


def _met_beyond(search: CurveSearch, motion: OnCurve, seen: Seen) -> list[Pair] | None:
    """Pairs that a march of a motion met beyond its own."""
    if not seen.fits:
        return None
    for own in [(motion.contacts, motion.times), *search.without_shallow(motion, seen)]:
        extra = new_pairs(*own, seen.contacts, seen.times)
        if extra:
            return extra
    return search.uncounted(motion, seen)


def _goes_on(search: CurveSearch, last: OnCurve, touch: OnCurve) -> bool:
    """Whether the curve runs the same way at two motions."""
    return search.along(last, touch.state_along, touch.parameter_along) > 0


def _is_within(motion: OnCurve, bounds: tuple[float, float]) -> bool:
    return bounds[0] <= motion.parameter <= bounds[1]


def _enter(
    search: CurveSearch,
    last: OnCurve,
    touch: OnCurve,
    new: list[Any],
    apart: float,
    bounds: tuple[float, float],
) -> Steps:
    """Go beyond a touch, to a motion with the new contacts.

    If there is one, not so far that contacts change in between: they may be the same again there.
    """
    reached = new[0][0]
    touch = replace(touch, family=last.family, way=abs(reached))
    ends = np.concatenate(
        [[touch.contacts.section], touch.times, [touch.contacts.section + search.whole]]
    )
    room = min(float(np.min(np.abs(ends - angle))) for _, _, angle, _ in new)
    lasts = [np.sqrt(8 * abs(t.height_along / t.bend)) for *_, t in new]
    first = min(lasts[0] * np.sqrt(max(apart, LEAST_WAY)), 0.5 * room, LONGEST_TOUCH)
    farthest = None
    for _ in range(30):
        way = (first / lasts[0]) ** 2 if lasts[0] > 0 else 0.0
        way = min(way, max(apart, LEAST_WAY))
        both = [
            Pair(stop, (0, 0), (angle - d * first / 2, angle + d * first / 2))
            for (_, stop, angle, _), d in zip(new, np.array(lasts) / lasts[0], strict=True)
        ]
        moved = touch.times + way * touch.times_along
        contacts, times = with_pairs(touch.contacts, moved, both)
        at = np.flatnonzero(np.isin(times, both[0].times))
        if len(at) == 2 and is_ordered(contacts, times, search.whole):
            places = int(at[0]), int(at[1])
            by_times = duration_row(places, len(times))
            found = yield from search.solve(
                Ask(
                    contacts,
                    times,
                    touch.state + way * touch.state_along,
                    touch.parameter + way * touch.parameter_along,
                    by_times=by_times,
                    value=first,
                )
            )
            if found is not None and search.is_sound(found):
                grows = found.times_along @ by_times > 0
                found = found if grows else found.reversed()
                gone = search.way(touch, found)
                # Too far on the contact may get shorter again, or is one from before the touch.
                turned = search.way(found, touch) > 0 or (search.smooth and gone < -SHARP)
                if turned or not _is_within(found, bounds):
                    first *= 0.4
                    continue
                found = replace(found, family=last.family + 1, way=abs(gone))
                passed = Touch(0, True, places, new[0][1])
                between = yield from _between(search, touch, found, passed)
                motions = [touch, *between, found]
                seen = yield search.look(motions)
                if not _only_touches(search, touch, seen[0]):
                    sooner = yield from _touch_sooner(search, last, touch, seen[0], reached, bounds)
                    if sooner is not None or apart > WITHIN:
                        return sooner  # without one a shorter step shows it
                if search.fits(found, seen[-1]):
                    farthest = farthest or Passed(motions, seen, passed)
                    is_whole = abs(gone) <= WITHIN or len(between) >= len(NEXT_TO_TOUCH)
                    if is_whole and not any(map(search.met_others, between, seen[1:-1])):
                        return Passed(motions, seen, passed)
        first *= 0.4
    return farthest


def by_duration(search: CurveSearch, last: OnCurve, bounds: tuple[float, float]) -> Steps:
    """Go on to where the contact that changes fastest lasts longer, or shorter.

    Next to touches of stiff stops the curve bends within what no step along it resolves.
    """
    every = []
    for pair in last.pairs:
        by_times = duration_row(pair.places, len(last.times))
        every.append((float(by_times @ last.times_along) / max(pair.length, 1e-300), by_times))
    every.sort(key=lambda each: -abs(each[0]))
    for relative, by_times in every[:FASTEST]:
        lasts = float(by_times @ last.times)
        for change in CHANGES if relative else ():
            factor = 1 + change if relative > 0 else 1 - change
            # Durations change with the square root of the way.
            way = (factor**2 - 1) / (2 * relative)
            times = last.times + way * (last.times_along - relative * lasts * by_times / 2)
            guess = Ask(
                last.contacts,
                times + (factor - 1) * lasts * by_times / 2,
                last.state + way * last.state_along,
                last.parameter + way * last.parameter_along,
                by_times=by_times,
                value=factor * lasts,
            )
            found = yield from search.solve(guess)
            if found is None or not search.is_sound(found):
                continue
            found = found if found.times_along @ by_times * relative > 0 else found.reversed()
            way = search.way(last, found)
            ahead = way > 0 > search.way(found, last)
            if not ahead or not _is_within(found, bounds):
                continue
            (seen,) = yield search.look([found])
            if search.fits(found, seen):
                return replace(found, family=last.family, way=way), seen
    return None
