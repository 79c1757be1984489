"""Orbits of the map of some drive periods, and how they go on with the drive frequency.

Motions without contact times to solve for, under other laws or of several periods, are put on their
orbits by Newton's method on that map, with its Jacobian in forward mode through the stepper. It
also says whether the motion is stable, and where the orbit goes on at the next frequency.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax.steady.following import BENT, STRAIGHT, size_of
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.settling import CLOSED, NEAR, is_stable
from vibrojax.stepping.stepper import AbstractMarch

lax = jax.lax

JACOBIANS = 3
"""Computed at the most for an orbit."""

States = Float[Array, "states *lanes"]
Lanes = Float[Array, "*lanes"]


class Orbit(NamedTuple):
    """A periodic motion at drive phase 0, in units of energy."""

    period: Int[Array, "..."]
    """Drive periods; 0 where no orbit is known."""
    frequency: Float[Array, "..."]
    """rad/s."""
    contacts: Float[Array, "..."]
    """Per drive period."""
    state: Float[Array, "..."]
    slope: Float[Array, "..."]
    """Of the state by the drive frequency."""
    matrix: Float[Array, "..."]
    """Jacobian of the map."""


def no_orbits(lanes: int, states: int) -> LaneTable:
    """Return the orbits of lanes of which nothing is known."""

    def zeros(*shape: int) -> Any:
        return np.zeros((*shape, lanes))

    none: Any = np.zeros(lanes, np.int32)
    vector, matrix = (states,), (states, states)
    whole = Orbit(none, zeros(), zeros(), zeros(*vector), zeros(*vector), zeros(*matrix))
    return table_of(whole, xp=np)


class _Search(NamedTuple):
    state: States
    slope: States
    matrix: Float[Array, "states states *lanes"]
    residual: Lanes
    """Before the last step of Newton's method, relative."""
    going: Bool[Array, "*lanes"]


def to_orbit(
    march: AbstractMarch,
    last: Orbit,
    state: States,
    angular_frequency: Lanes,
    period: Int[Array, "*lanes"],
) -> tuple[Orbit, Bool[Array, "*lanes"]]:
    """Solve for the orbit of each lane's period next to a state; say which are to be taken.

    Those are stable and near the state or, where a `last` orbit is known, its continuation. Lanes
    of period 0 stay where they are. `state` is (q, q') at drive phase 0.
    """
    weight, n, w = march.energy_weight(), state.shape[0], angular_frequency
    begun, known = state * weight, last.period > 0
    size = size_of(begun)
    eye = jnp.eye(n)

    def image(x: States, w: Lanes) -> States:
        return march(x / weight, w, period, False)[0] * weight

    def to_return(matrix: Array, *gaps: States) -> list[States]:
        left = eye - jnp.moveaxis(matrix, (0, 1), (-2, -1))
        right = jnp.moveaxis(jnp.stack(gaps), (0, 1), (-1, -2))
        return list(jnp.moveaxis(jnp.linalg.solve(left, right), (-1, -2), (0, 1)))

    def newton(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        search, rounds = carry
        x = search.state
        y, push = jax.linearize(image, x, w)
        still, here = jnp.zeros_like(x), jnp.zeros_like(w)
        along = [still.at[k].set(1.0) for k in range(n)]
        columns = jax.vmap(push)(
            jnp.stack([*along, still]), jnp.stack([*n * [here], jnp.ones_like(w)])
        )
        matrix, by_frequency = jnp.moveaxis(columns[:n], 0, 1), columns[n]
        step, slope = to_return(matrix, y - x, by_frequency)
        residual = size_of(y - x) / jnp.where(size > 0, size, 1.0)
        new = _Search(x + step, slope, matrix, residual, residual > CLOSED)
        new = jax.tree.map(lambda a, b: jnp.where(search.going, a, b), new, search)
        going = new.going & jnp.isfinite(residual) & (period > 0)
        return new._replace(going=going), rounds + 1

    begin = _Search(begun, 0 * begun, last.matrix, size + jnp.inf, period > 0)
    found, _ = lax.while_loop(
        lambda carry: jnp.any(carry[0].going) & (carry[1] < JACOBIANS), newton, (begin, 0)
    )
    # Along one branch the slopes at both ends give the step between them.
    step = found.state - last.state
    straight = (w - last.frequency) / 2 * (found.slope + last.slope)
    bent = size_of(step - straight) <= BENT * size_of(step) + STRAIGHT * size
    near = size_of(found.state - begun) <= 5 * NEAR * size
    good = jnp.where(known, bent, near) & (found.residual <= CLOSED) & (period > 0)
    good &= jnp.all(jnp.isfinite(found.state), axis=0) & is_stable(found.matrix)
    return Orbit(period, w, last.contacts, found.state, found.slope, found.matrix), good


def least_periods(
    period: Int[np.ndarray, " lanes"],
    state: Float[np.ndarray, "lanes states"],
    first: Int[np.ndarray, " lanes"],
    after: Callable[[Int[np.ndarray, " some"], int], Float[np.ndarray, "some states"]],
) -> Int[np.ndarray, " lanes"]:
    """Return the least periods, from `first` on, of orbits found with a multiple of them.

    A motion that alternates about its orbit while it settles returns best after twice the period,
    and one that is followed may come to the end of its doubling. `after` says where some of the
    orbits are after so many drive periods.
    """
    period, size = period.copy(), np.linalg.norm(state, axis=1)
    for part in range(1, period.max(initial=1) // 2 + 1):
        own = np.flatnonzero((period % part == 0) & (period > part) & (part >= first))
        if len(own):
            gone = np.linalg.norm(after(own, part) - state[own], axis=1)
            period[own[gone <= CLOSED * size[own]]] = part
    return period
