"""From a period doubling to the branch of twice the period."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.branches.continuation import LONGEST_STEP, Ending
from vibrojax.branches.plan import Plan, Resolution
from vibrojax.branches.points import BranchPoints
from vibrojax.branches.tracing import Traced
from vibrojax.branches.work import BranchWork
from vibrojax.steady.batches import take
from vibrojax.steady.paths import AbstractPath
from vibrojax.steady.starting import sampled_depth, stepper


def switch_branch(
    branch: BranchPoints,
    number: int,
    *,
    max_points: int = 2000,
    longest_step: float = LONGEST_STEP,
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
        resolution=Resolution(int(branch.attributes["samples"])),
        max_points=max_points,
        longest_step=longest_step,
        ratio_units=branch.ratio_units,
        description=branch.attributes["rig"],
    )
    value, state = np.array([point.parameter]), jnp.asarray(point.initial_state)
    both = state, _moved(branch.path, value, state, branch.period)
    samples = plan.resolution.samples * plan.period
    base, moved = (
        np.asarray(
            sampled_depth(branch.path, jnp.asarray(value), s[None], samples, plan.period, True)
        )
        for s in both
    )
    # The doubled motion leaves along the mode that changes sign from period to period.
    odd = np.arange(base.shape[-1]) % 2 == 1
    tangent = (moved - base) * odd
    work = BranchWork(plan, branch.path)
    (traced,) = work.trace(branch.path, base * ~odd, value, tangent=tangent)
    return work.finished([_until_joined(traced, tangent[0])], [""])[0]


@eqx.filter_jit
def _moved(paths: AbstractPath, value, state, period):
    """Return a state moved a little along the multiplier of -1 of its motion."""
    place = take(paths, 0).at(value[0])
    march = stepper(True).prepare(place.equations, place.drive)
    weight = march.energy_weight()
    periods = jnp.asarray(period, jnp.int32)

    def image(x):
        return march(x / weight, place.angular_frequency, periods, False)[0] * weight

    matrix = jax.jacfwd(image)(state * weight)
    # The multiplier is real: its vector spans the null space of the matrix plus one.
    _, _, right = jnp.linalg.svd(matrix + jnp.eye(state.size))
    size = 1e-4 * jnp.linalg.norm(state * weight)
    return state + size * right[-1] / weight


def _until_joined(traced: Traced, tangent: np.ndarray) -> Traced:
    """Cut a doubled branch where it joins the single one again: its odd part changes sign."""
    along = np.sum(np.real(traced.depth * np.conj(tangent)), axis=(1, 2))
    back = np.flatnonzero(along <= 0)
    if not len(back):
        return traced
    end = int(back[0])
    return traced._replace(
        parameter=traced.parameter[:end],
        depth=traced.depth[:end],
        direction=traced.direction[:end],
        ending=Ending.joined,
    )
