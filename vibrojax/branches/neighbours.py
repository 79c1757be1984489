"""Whether of two motions of a curve one may be the next one behind the other, by what contacts do.

Where it may not, the curve turned, or other contacts came and went, in between.
"""

from vibrojax.branches.on_curve import OnCurve
from vibrojax.steady.curve_programs import ACCURATE, LEAST, LEFT

COLLAPSED = 0.1
"""Share of its duration below which a pair is taken to have vanished."""
BOUNCED = 1.5
"""By how much a pair may last longer where it was about to vanish."""
SWELLED = 0.05
"""Least relative change of a contact's duration that shows whether the curve turned."""
SKIPPED = 0.25
"""Most that the square of a contact's duration may be off what its rates say, over itself."""


def collapses(last: OnCurve, found: OnCurve, *, ahead: bool = False) -> bool:
    """Whether a pair has all but vanished: of no duration it fits everywhere.

    `ahead` of the last motion also whether it bounced back from where it would have.
    """
    if last.contacts.stops != found.contacts.stops:
        return False
    for (i, j), lasted, lasts in _durations(last, found):
        shrinks = last.times_along[j] < last.times_along[i]
        bounces = ahead and shrinks and lasts > BOUNCED * lasted
        if lasts < COLLAPSED * lasted or bounces:
            return True
    return False


def turns_round(last: OnCurve, found: OnCurve) -> bool:
    """Whether a contact lasts longer where its rates say shorter, or the reverse.

    Then the curve has turned round in between, within less than the step.
    """
    if last.contacts != found.contacts:
        return False
    rates = last.times_along + found.times_along
    for (i, j), lasted, lasts in _durations(last, found):
        change = lasts - lasted
        if abs(change) > SWELLED * lasted and change * (rates[j] - rates[i]) < 0:
            return True
    return False


def turns_twice(a: OnCurve, b: OnCurve, step: float) -> bool:
    """Whether the parameter may turn round and back between two motions."""
    if step < 1e-4 or a.parameter_along * b.parameter_along <= 0:
        return False
    # The cubic with these values and rates: whether its rate passes zero inside.
    left, right = a.parameter_along * step, b.parameter_along * step
    middle = 1.5 * (b.parameter - a.parameter) - (left + right) / 4
    return bool(middle * left < 0)


def skips(last: OnCurve, found: OnCurve) -> bool:
    """Whether a contact changes by else than its rates at both motions say, or by too much.

    Squares of durations change evenly, next to touches too. A contact that gets short may split
    into two for a little while.
    """
    if last.contacts != found.contacts:
        return False
    for (i, j), lasted, lasts in _durations(last, found):
        rates = (m.times_along[j] - m.times_along[i] for m in (last, found))
        before, after = (2 * d * rate for d, rate in zip((lasted, lasts), rates, strict=True))
        off = lasts**2 - lasted**2 - found.way * (before + after) / 2
        short, long = sorted((lasted, lasts))
        is_long = found.way > LEAST + ACCURATE  # not by round-off
        if abs(off) > SKIPPED * long**2 or (is_long and short < LEFT * long):
            return True
    return False


def _durations(a: OnCurve, b: OnCurve) -> list[tuple[tuple[int, int], float, float]]:
    """Places of the contacts of two motions with the same ones, and how long each lasts in both."""
    both = zip(a.pairs, b.pairs, strict=True)
    return [(one.places, one.length, other.length) for one, other in both]
