"""From a period doubling to the branch of twice the period."""

from vibrojax.branches.exact_branches import walk_doubled
from vibrojax.branches.plan import Plan
from vibrojax.branches.points import BranchPoints
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.branches.what_follows import with_what_follows


def switch_branch(
    branch: BranchPoints, number: int, settings: ContinuationSettings
) -> BranchPoints:
    """Follow the doubled period from a period doubling; see `Branch.switch`."""
    points = [p for p in branch.special_points if p.kind == "period_doubling"]
    if not 0 <= number < len(points):
        raise ValueError(
            f"number must be one of the {len(points)} period doublings of the branch, counted from "
            f"0, got {number}."
        )
    if not branch.exact:
        raise ValueError("Only branches of linear stops without smoothing can be switched.")
    point = points[number]
    assert point.initial_state is not None
    low, high = branch.range
    plan = Plan(
        axis=branch.axis,
        low=low,
        high=high,
        labels=[branch.labels],
        period=2 * branch.period,
        exact=True,
        samples=0,
        harmonics=None,
        max_points=settings.max_points,
        longest_step=settings.longest_step,
        ratio_units=branch.ratio_units,
        description=branch.attributes["rig"],
    )
    doubled = walk_doubled(plan, branch.path, point.initial_state, point.parameter)
    if doubled is None:
        raise ValueError(
            f"No motion of {plan.period} drive periods was found next to the period doubling at "
            f"{point.parameter:.8g}: they may have more than 64 contacts, or break theirs at once."
        )
    return with_what_follows([doubled])[0]
