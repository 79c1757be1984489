"""Linear equations as a system of first order: what exact contact and balances are made from.

x' = flow x + load + input a(t) - sum over touching stops of push_s F_s,
F_s = stiffness_s (depth_s x - gap_s) + damping_s rate_s x,

where x = (q, q', internal states). A stop that relaxes is linear too: its surface, where it is left
to itself, is a sum of its memories, and depths count from there (`laws.LinearContact`).
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import block_diag
from jaxtyping import Array, ArrayLike, Float

from vibrojax.model.equations import LinearEquations
from vibrojax.model.laws import KelvinVoigt, LinearContact, linear_contact
from vibrojax.model.stops import Stop


class FirstOrder(NamedTuple):
    """One lane with linear stops."""

    flow: Float[Array, "states states"]
    """Rate of every state by every state, in flight."""
    input: Float[Array, " states"]
    """Rate by a unit input of the drive."""
    push: Float[Array, "states stops"]
    """Rate by a unit contact force, which acts against it."""
    depth: Float[Array, "stops states"]
    """Rows that read how far beyond the surface of a stop the body is, but for the gap, m."""
    rate: Float[Array, "stops states"]
    """Rows that read the velocity of the contact points towards the stops, m/s."""
    response: Float[Array, " states"]
    """Row that reads the response that is reported."""
    scale: Float[Array, " states"]
    """Sizes of the states in a motion of the first mode, relative to its coordinate."""
    stiffness: Float[Array, " stops"]
    damping: Float[Array, " stops"]
    gap: Float[Array, " stops"]
    load: Float[Array, " states"]
    """Rate by forces that stay the same."""


def without_memory(stops: tuple[Stop, ...]) -> tuple[Stop, ...]:
    """Return stops whose depth counts from their surface: springs, where they relax."""
    found = []
    for stop in stops:
        law = linear_contact(stop.law) if stop.memory_size else None
        found.append(
            stop if law is None else replace(stop, law=KelvinVoigt(jnp.asarray(law.stiffness)))
        )
    return tuple(found)


def first_order(equations: LinearEquations) -> FirstOrder:
    """Write the equations of one lane as a system of first order.

    Of stops that are not linear in contact only the depth is right.
    """
    laws = [linear_contact(stop.law) or LinearContact(0.0, 0.0) for stop in equations.stops]
    flow, input_, push, depth, response = _structure(equations)
    dtype, n = flow.dtype, equations.size

    def column(values: list[ArrayLike]) -> Float[Array, " stops"]:
        return jnp.stack([jnp.asarray(v, dtype) for v in values]) if values else jnp.zeros((0,))

    at = 2 * n + equations.internal_size
    for s, law in enumerate(laws):
        own = slice(at, at + len(law.times))
        at = own.stop
        if not law.times:
            continue
        shares, per_second = column(list(law.shares)), 1 / column(list(law.times))
        # Left alone the surface is where no force holds it, and every memory follows it.
        alone = per_second[:, None] * (shares[None] - jnp.eye(len(shares)))
        whole = jnp.asarray(law.stiffness, dtype)
        yields = jnp.where(whole > 0, 1 / jnp.where(whole > 0, whole, 1.0), 0.0)
        flow = flow.at[own, own].set(alone)
        push = push.at[own, s].set(-per_second * yields)
        depth = depth.at[s, own].set(-shares)
    weight = lax.stop_gradient(equations.energy_weight)
    size = jnp.where(weight > 0, weight[0] / jnp.where(weight > 0, weight, 1.0), 1.0)
    unit = equations.angular_frequency[0]
    scale = jnp.concatenate([jnp.ones(n), jnp.full(n, unit), size[2 * n :]])
    still = jnp.zeros((len(laws), len(scale) - 2 * n))
    steady = jnp.zeros(n) if equations.load is None else equations.load
    return FirstOrder(
        flow=flow,
        input=input_,
        push=push,
        depth=depth,
        rate=jnp.concatenate([0 * equations.stop_map, equations.stop_map, still], axis=1),
        response=response,
        scale=scale,
        stiffness=column([law.stiffness for law in laws]),
        damping=column([law.damping for law in laws]),
        gap=column([stop.gap for stop in equations.stops]),
        load=jnp.concatenate([jnp.zeros(n), steady, jnp.zeros(len(scale) - 2 * n)]),
    )


def _structure(equations: LinearEquations) -> tuple[Array, Array, Array, Array, Array]:
    """Return flow, input, push, depth and response of one lane, its stops left alone.

    Memories of stops are at rest; one state idles where the number of states would be odd.
    """
    n, own = equations.size, equations.internal
    damping = jnp.diag(2 * equations.damping_ratio * equations.angular_frequency)
    stiffness = jnp.diag(equations.modal_stiffness)
    if equations.damping_coupling is not None:
        damping = damping + equations.damping_coupling
    if equations.stiffness_coupling is not None:
        stiffness = stiffness + equations.stiffness_coupling
    eye, none = jnp.eye(n), jnp.zeros(n)
    flow = jnp.block([[0 * eye, eye], [-stiffness, -damping]])
    input_ = jnp.concatenate([none, equations.input_map])
    push = jnp.concatenate([0 * equations.force_map, equations.force_map])
    depth = jnp.concatenate([equations.stop_map, 0 * equations.stop_map], axis=1)
    response = jnp.concatenate([equations.response_map, none])
    if own is not None:
        onto = jnp.concatenate([0 * own.acceleration, own.acceleration])
        below = jnp.concatenate([own.from_displacement, own.from_velocity, own.flow], axis=1)
        flow = jnp.concatenate([jnp.concatenate([flow, onto], axis=1), below])
        input_ = jnp.concatenate([input_, own.from_input])
        push = jnp.concatenate([push, own.from_force])
        theirs = float(own.reports)
        response = jnp.concatenate([(1 - theirs) * response, theirs * own.response])
        depth = jnp.pad(depth, ((0, 0), (0, own.size)))
    if more := 2 * n + equations.memory_size - len(input_):
        # Memories are filled in by who knows the laws; what idles decays, at any rate.
        idle = jnp.diag(jnp.full(more, -equations.angular_frequency[0]))
        flow, behind = block_diag(flow, idle), (0, more)
        push, depth = jnp.pad(push, (behind, (0, 0))), jnp.pad(depth, ((0, 0), behind))
        input_, response = jnp.pad(input_, behind), jnp.pad(response, behind)
    return flow, input_, push, depth, response
