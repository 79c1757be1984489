"""Where the walk along a curve begins: free flight, or what opening all gaps leads to."""

import numpy as np
from jaxtyping import Float

from vibrojax.branches.contacts import Contacts
from vibrojax.branches.continuation import Ending
from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.on_curve import Ask, Look, OnCurve, Steps, at_value
from vibrojax.branches.walking import FIRST, Walk
from vibrojax.stepping.contact_phases import ContactPhases

FREE = Contacts((), 0, 0.0)
WIDER = 1.05
"""How far gaps are opened, over what it takes to touch none."""
MOST_OPENED = 500
"""Points on the way back from there: with more, where motions chatter, a march is shorter."""
TRIES = 17
"""Steps, each a third of the last, that are tried away from a period doubling: one may be next to a
touch."""


def free_flight(search: CurveSearch, value: float) -> Steps:
    """Solve for the motion without contact, and whether it has none."""
    rest = np.zeros(len(search.unit))
    found = yield from search.solve(at_value(FREE, np.zeros(0), rest, value))
    if found is None:
        return None, False
    (seen,) = yield Look([found])
    return found, not seen.contacts.stops and seen.contacts.first_phase == 0


def reach(
    phases: ContactPhases, lane: int, state: Float[np.ndarray, " states"], angular_frequency: float
) -> Float[np.ndarray, " stops"]:
    """How far towards the stops of a lane, m, a harmonic motion gets that has a state."""
    speed = np.asarray(phases.speed_towards_stop[lane]) @ state
    return np.hypot(np.asarray(phases.towards_stop[lane]) @ state, speed / angular_frequency)


def opened(walk: Walk, free: OnCurve, beyond: float) -> Steps:
    """Walk from gaps that are opened until nothing touches back to those of the rig.

    `walk` is along the opening, m; `beyond` is how far a free motion gets beyond a stop, m.
    """
    widest = WIDER * beyond + 1e-12
    walk.low, walk.high = 0.0, 1.2 * widest
    walk.max_points = min(walk.max_points, MOST_OPENED)
    start = yield from walk.search.solve(at_value(FREE, np.zeros(0), free.state, widest))
    if start is None:
        return None
    ending = yield from walk.go(start, -1.0)
    last = walk.points[-1]
    return last if ending is Ending.completed and last.parameter == 0.0 else None


def doubled(search: CurveSearch, single: OnCurve) -> Steps:
    """Solve for a motion of twice the period of one that has a multiplier of -1, next to it."""
    multipliers, vectors = np.linalg.eig(single.matrix)
    odd = np.real(vectors[:, np.argmin(np.abs(multipliers + 1))])
    odd = odd / np.linalg.norm(odd)
    contacts = single.contacts._replace(stops=single.contacts.stops * 2)
    times = np.concatenate([single.times, single.times + search.whole / 2])
    step = FIRST * single.size
    for _ in range(TRIES):
        # It leaves along the mode that changes sign from period to period.
        found = yield from search.solve(
            Ask(
                contacts,
                times,
                single.state + step * odd,
                single.parameter,
                by_state=odd,
                value=float(odd @ single.state) + step,
            )
        )
        if found is not None and search.is_sound(found):
            (seen,) = yield Look([found])
            if search.fits(found, seen):
                return found if odd @ found.state_along > 0 else found.reversed()
        step /= 3
    return None
