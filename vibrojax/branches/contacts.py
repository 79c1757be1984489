"""Sequences of contacts of periodic motions: what two of them differ by, and how they change.

At a touch two changes of contact of one stop come into being or vanish together: a *pair*.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

TURN = 2 * np.pi


class Contacts(NamedTuple):
    """Which stops change contact, in order of time."""

    stops: tuple[int, ...]
    first_phase: int
    """Set of touching stops at the section."""
    section: float
    """Drive phase, rad, at which the motion is cut."""


class Pair(NamedTuple):
    """Two changes of contact of one stop, one after the other."""

    stop: int
    places: tuple[int, int]
    """Where they are, or would be, in the sequence."""
    times: tuple[float, float]
    """Drive phases, rad."""

    @property
    def middle(self) -> float:
        """Drive phase between the two."""
        return (self.times[0] + self.times[1]) / 2

    @property
    def length(self) -> float:
        """Drive angle, rad, from the one to the other."""
        return self.times[1] - self.times[0]


Times = Float[np.ndarray, " events"]
MetTimes = Float[np.ndarray, " met_events"]


def is_ordered(contacts: Contacts, times: Times, whole: float) -> bool:
    """Whether events follow one another within the period `whole` (rad)."""
    ends = [contacts.section, *times.tolist(), contacts.section + whole]
    return all(a <= b for a, b in pairwise(ends))


def in_order(contacts: Contacts, times: Times) -> tuple[Contacts, Times]:
    """Put events into the order of their times."""
    order = np.argsort(times, kind="stable")
    return contacts._replace(stops=tuple(contacts.stops[i] for i in order)), times[order]


def at_section(
    contacts: Contacts, times: Times, section: float, whole: float
) -> tuple[Contacts, Times, Int[np.ndarray, " events"]]:
    """Cut a motion at another drive phase; also the order in which its events come then.

    `section` lies within a period behind that of the contacts; it is counted from 0 again.
    """
    early = times < section
    phase = contacts.first_phase
    for stop in np.asarray(contacts.stops, int)[early]:
        phase ^= 1 << int(stop)
    turns = whole * np.floor(section / whole)
    later = np.where(early, times + whole, times)
    order = np.argsort(later, kind="stable")
    stops = tuple(contacts.stops[i] for i in order)
    return Contacts(stops, phase, float(section - turns)), later[order] - turns, order


def best_section(contacts: Contacts, times: Times, whole: float) -> float:
    """Drive phase in the middle of the longest phase."""
    if not len(times):
        return contacts.section
    after = np.append(times[1:], times[0] + whole) - times
    longest = int(np.argmax(after))
    section = times[longest] + after[longest] / 2
    return section - whole if section >= contacts.section + whole else section


def is_close(contacts: Contacts, times: Times, whole: float) -> bool:
    """Whether an event comes close to the section."""
    if not len(times):
        return False
    after = np.append(times[1:], times[0] + whole) - times
    nearest = min(times[0] - contacts.section, contacts.section + whole - times[-1])
    return bool(nearest < after.max() / 8)


def pairs(contacts: Contacts, times: Times) -> list[Pair]:
    """Return neighbouring events of one stop: what could vanish at a touch."""
    stops = contacts.stops
    return [
        Pair(stops[i], (i, i + 1), (float(times[i]), float(times[i + 1])))
        for i in range(len(stops) - 1)
        if stops[i] == stops[i + 1]
    ]


def duration_row(places: tuple[int, int], events: int) -> Times:
    """Return the factors of the times of all events whose sum is how long a pair lasts."""
    row = np.zeros(events)
    row[list(places)] = -1.0, 1.0
    return row


def without(contacts: Contacts, times: Times, gone: list[Pair]) -> tuple[Contacts, MetTimes]:
    """Take pairs out of a sequence."""
    left = [i for i in range(len(times)) if not any(i in pair.places for pair in gone)]
    return contacts._replace(stops=tuple(contacts.stops[i] for i in left)), times[left]


def with_pairs(contacts: Contacts, times: Times, new: list[Pair]) -> tuple[Contacts, MetTimes]:
    """Put pairs into a sequence."""
    stops = [*contacts.stops, *(pair.stop for pair in new for _ in range(2))]
    every = np.concatenate([times, *(pair.times for pair in new)])
    return in_order(contacts._replace(stops=tuple(stops)), every)


def with_peak(
    contacts: Contacts, times: Times, stop: int, angle: float
) -> tuple[Contacts, MetTimes, int]:
    """Put an event into a sequence that changes nothing; also its place."""
    place = int(np.searchsorted(times, angle))
    stops = (*contacts.stops[:place], stop, *contacts.stops[place:])
    return contacts._replace(stops=stops), np.insert(times, place, angle), place


def new_pairs(
    contacts: Contacts, times: Times, met: Contacts, met_times: MetTimes
) -> list[Pair] | None:
    """Return the pairs that a march met beyond a sequence; None where that is not all.

    Both have the same section.
    """
    if met.first_phase != contacts.first_phase:
        return None
    found = []
    for stop in sorted({*contacts.stops, *met.stops}):
        own = times[[i for i, s in enumerate(contacts.stops) if s == stop]]
        at = [i for i, s in enumerate(met.stops) if s == stop]
        more = len(at) - len(own)
        if more == 0:
            continue
        if more != 2:
            return None
        # Of all neighbours the pair is the one without which the others fit best.
        misfit = []
        for k in range(len(at) - 1):
            rest = met_times[at[:k] + at[k + 2 :]]
            misfit.append(float(np.sum(np.abs(rest - own))))
        k = int(np.argmin(misfit))
        both = at[k], at[k + 1]
        found.append(Pair(stop, both, (float(met_times[both[0]]), float(met_times[both[1]]))))
    return found


def same(
    contacts: Contacts, times: Times, met: Contacts, met_times: MetTimes, within: float
) -> bool:
    """Whether a march met just the contacts of a sequence, and when it should (rad).

    Stops that change contact together may do so in either order.
    """
    if sorted(contacts.stops) != sorted(met.stops) or contacts.first_phase != met.first_phase:
        return False
    own, theirs = (
        at[np.argsort(of.stops, kind="stable")] for of, at in ((contacts, times), (met, met_times))
    )
    return bool(np.max(np.abs(own - theirs), initial=0.0) < within)
