"""Branches of periodic responses along the drive frequency or any other number."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, overload

from jaxtyping import ArrayLike

from vibrojax._tools.described import recipe
from vibrojax._tools.signatures import validated
from vibrojax.branches.along import along_of
from vibrojax.branches.branch import Branch, Branches
from vibrojax.branches.isolas import isolas_of
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.branches.what_follows import with_what_follows
from vibrojax.branches.work import follow_branches, follow_from
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.ranges import Range
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.periodic_result import PeriodicResponse


@overload
def continue_response(
    system: AbstractSystem,
    *,
    frequency_ratio: Range | ArrayLike | Sequence[float] | None = None,
    frequency: Range | ArrayLike | Sequence[float] | None = None,
    start: PeriodicResponse | tuple[ArrayLike | Sequence[float], float] | None = None,
    isolas: bool = False,
    settings: ContinuationSettings | None = None,
) -> Branch: ...


@overload
def continue_response(
    system: Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: Range | ArrayLike | Sequence[float] | None = None,
    frequency: Range | ArrayLike | Sequence[float] | None = None,
    start: PeriodicResponse | tuple[ArrayLike | Sequence[float], float] | None = None,
    isolas: bool = False,
    settings: ContinuationSettings | None = None,
    **numbers: Any,
) -> Branch | Branches: ...


@validated
def continue_response(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: Range | ArrayLike | Sequence[float] | None = None,
    frequency: Range | ArrayLike | Sequence[float] | None = None,
    start: PeriodicResponse | tuple[ArrayLike | Sequence[float], float] | None = None,
    isolas: bool = False,
    settings: ContinuationSettings | None = None,
    **numbers: Any,
) -> Branch | Branches:
    """Follow the periodic response along one number, through folds, stable and unstable.

    With linear stops the branch is walked along by pseudo-arclength from one set of contacts to the
    next: every point is an exact solution between its contact times, with exact Floquet
    multipliers, and so are its special points. Else the condensed harmonic balance is followed.

    Parameters:
        system: a system with stops, or a function from named numbers to one.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency_ratio, frequency: the drive frequency (ratio to the first natural frequency of
            the unstopped system, or Hz): `vj.Range(low, high)` to follow, or one number.
        start: where to start inside the range: a `PeriodicResponse`, or a state at drive phase 0
            with its parameter, as `(state, value)`; the branch is then followed both ways. The
            state is as of `simulate`: what `system.state(displacement=...)` makes, or (q, q') in
            the coordinates of the system; where the branch passes far from it, a warning and the
            branch's sentence say so. By default it starts at the low end of the range. Where
            nothing does, or what does comes back or ends, exact branches start at the high end, or
            inside where there is nothing at either; that is said too.
        isolas: whether branches beside this one are looked for, of linear stops: what is found is
            in `branch.isolas`. A sweep misses them by nature. They are looked for from random
            states that settle and by opening and closing all gaps, at 12 values of the range, and
            between them where curves of folds come nearest to these gaps: what is found is there,
            but there may be others.
        settings: `vj.ContinuationSettings(period=..., tolerance=..., ...)`.
        numbers: arguments of the function: a `vj.Range` is followed (exactly one in the call), a
            list is an axis with one branch per value, anything else is fixed.

    Returns a `Branch`, or `Branches` where there are axes; each has a status, and says which
    fallback it needed. Raises `ValueError` for no range or several, a tolerance out of reach, a
    system without stops or drive, or one that is not linear but for its stops; where isolas are
    looked for, of one whose stops are not linear.
    """
    along = along_of(system, frequency_ratio, frequency, numbers, zipped)
    plan = (settings or ContinuationSettings()).plan(
        along.sample,
        axis=along.name,
        low=along.range.low,
        high=along.range.high,
        labels=along.labels,
        description=recipe(along.sample),
    )
    if isolas and not plan.exact:
        raise ValueError("isolas must be False for stops that are not linear: leave it out.")
    paths = along.paths(plan.exact)
    from_start = start is not None
    every = [follow_from(plan, paths, start)] if from_start else follow_branches(plan, paths)
    every = with_what_follows(every)
    if isolas:
        every = [replace(b, isolas=tuple(with_what_follows(isolas_of(plan, b)))) for b in every]
    branches = tuple(Branch.of(points) for points in every)
    return Branches(along.axes, branches) if along.axes else branches[0]
