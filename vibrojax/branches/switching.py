"""From a period doubling to the branch of twice the period."""

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.compiled import compiled
from vibrojax.branches.continuation import Ending
from vibrojax.branches.finishing import finish
from vibrojax.branches.plan import Plan
from vibrojax.branches.points import BranchPoints
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.branches.tracing import Traced
from vibrojax.steady.batches import take
from vibrojax.steady.paths import AbstractPath
from vibrojax.steady.starting import sampled_depth, stepper


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
        samples=int(branch.attributes["samples"]),
        harmonics=None,
        max_points=settings.max_points,
        longest_step=settings.longest_step,
        ratio_units=branch.ratio_units,
        description=branch.attributes["rig"],
    )
    value, state = np.array([point.parameter]), jnp.asarray(point.initial_state)
    samples, period = plan.samples * plan.period, plan.period
    base, moved = (
        np.asarray(sampled_depth(branch.path, value, s[None], samples, period, True))
        for s in (state, _moved(branch.path, value, state, branch.period))
    )
    # The doubled motion leaves along the mode that changes sign from period to period.
    odd = np.arange(base.shape[-1]) % 2 == 1
    tangent = (moved - base) * odd
    (traced,) = plan.trace(branch.path, value, base * ~odd, tangent=tangent)
    return finish(plan, branch.path, [_until_joined(traced, tangent[0])], [""])[0]


@compiled
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
    values, depth, change = (part[: back[0]] for part in traced[:3])
    return Traced(values, depth, change, Ending.joined, traced.ticks)
