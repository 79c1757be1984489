"""Branches of periodic responses along the drive frequency or any other number."""

from collections.abc import Callable, Sequence
from typing import Any, overload

from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_count, check_range
from vibrojax._tools.signatures import validated
from vibrojax.branches.along import along_of
from vibrojax.branches.branch import Branch, Branches
from vibrojax.branches.continuation import LONGEST_STEP
from vibrojax.branches.lane_paths import paths_of
from vibrojax.branches.plan import Plan, Resolution
from vibrojax.branches.work import BranchWork
from vibrojax.ensemble.arguments import Zipped
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.methods import HarmonicBalance
from vibrojax.steady.periodic_result import PeriodicResponse
from vibrojax.stepping.choice import is_exact


@overload
def continue_response(
    system: AbstractSystem,
    *,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    period: int = 1,
    tolerance: float = 1e-4,
    method: HarmonicBalance | None = None,
    start: PeriodicResponse | tuple[ArrayLike | Sequence[float], float] | None = None,
    max_points: int = 2000,
    longest_step: float = LONGEST_STEP,
) -> Branch: ...


@overload
def continue_response(
    system: Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    period: int = 1,
    tolerance: float = 1e-4,
    method: HarmonicBalance | None = None,
    start: PeriodicResponse | tuple[ArrayLike | Sequence[float], float] | None = None,
    max_points: int = 2000,
    longest_step: float = LONGEST_STEP,
    **numbers: Any,
) -> Branch | Branches: ...


@validated
def continue_response(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    period: int = 1,
    tolerance: float = 1e-4,
    method: HarmonicBalance | None = None,
    start: PeriodicResponse | tuple[ArrayLike | Sequence[float], float] | None = None,
    max_points: int = 2000,
    longest_step: float = LONGEST_STEP,
    **numbers: Any,
) -> Branch | Branches:
    """Follow the periodic response along one number, through folds, stable and unstable.

    The branch is traced by pseudo-arclength continuation of the condensed harmonic balance; with
    linear stops every point is then made an exact solution between its contact times, with exact
    Floquet multipliers, and so are its special points.

    Parameters:
        system: a system with stops, or a function from named numbers to one.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency_ratio, frequency: the drive frequency (ratio to the first natural frequency of
            the unstopped system, or Hz): a range (low, high) to follow, or one number.
        period: drive periods after which the motion repeats.
        tolerance: relative error to aim at, where motions are not exact.
        method: `HarmonicBalance(samples=..., harmonics=...)` to choose the resolution.
        start: where to start inside the range: a `PeriodicResponse`, or a state at drive phase 0
            with its parameter, as `(state, value)`; the branch is then followed both ways. The
            state is as of `simulate`: what `system.state(displacement=...)` makes, or (q, q') in
            the coordinates of the system; where the branch passes far from it, a warning and the
            branch's sentence say so. By default it starts at the low end of the range.
        max_points: most points of a branch.
        longest_step: longest step of the arclength.
        numbers: arguments of the function: a tuple (low, high) is the range to follow (exactly one
            in the call), a list an axis with one branch per value, anything else is fixed.

    Returns a `Branch`, or `Branches` where there are axes; each has a status, and says which
    fallback it needed. Raises `ValueError` for no range or several, a range without width, period
    below 1, a tolerance out of reach, a system without stops or drive, or one that is not linear
    but for its stops.
    """
    check_count("period", period)
    check_count("max_points", max_points, least=10)
    check_range("tolerance", tolerance, 0.0, 0.1, include_low=False, allowed="above 0, up to 0.1")
    check_range("longest_step", longest_step, 1e-4, 1.0, allowed="from 1e-4 to 1")
    method = HarmonicBalance() if method is None else method
    along = along_of(system, frequency_ratio, frequency, numbers, zipped)
    exact = is_exact(along.sample)
    plan = Plan(
        axis=along.name,
        low=along.low,
        high=along.high,
        labels=along.labels,
        period=period,
        exact=exact,
        resolution=Resolution(samples_of(method, tolerance, exact), method.harmonics),
        max_points=max_points,
        longest_step=longest_step,
        ratio_units=along.sample.drive.reference[1],
        description=along.description,
    )
    work = BranchWork(plan, paths_of(along, exact))
    if start is not None:
        return Branch.of(work.from_start(start))
    branches = tuple(Branch.of(points) for points in work.run())
    return Branches(along.axes, branches) if along.axes else branches[0]


def samples_of(method: HarmonicBalance, tolerance: float, exact: bool) -> int:
    """Return the samples of the balance. Raises `ValueError` for a tolerance out of reach."""
    if exact:  # the balance is only where the exact solution starts from
        return method.samples or 128
    method.check_reach(tolerance)
    return method.samples_for(tolerance)
