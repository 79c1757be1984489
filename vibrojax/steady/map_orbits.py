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

from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.period_maps import continues, is_stable, size_of, to_return
from vibrojax.steady.settling import CLOSED
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
    every = jnp.eye(n + 1).reshape(n + 1, n + 1, *w.ndim * (1,)) + jnp.zeros_like(w)

    def image(x: States, w: Lanes) -> States:
        return march(x / weight, w, period, False)[0] * weight

    def newton(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        search, rounds = carry
        along = lambda *way: jax.jvp(image, (search.state, w), way)  # noqa: E731
        # The motion is the same for all ways.
        y, columns = jax.vmap(along, out_axes=(None, 0))(every[:, :n], every[:, n])
        matrix, by_frequency = jnp.moveaxis(columns[:n], 0, 1), columns[n]
        step, slope = to_return(matrix, y - search.state, by_frequency)
        residual = size_of(y - search.state) / jnp.where(size > 0, size, 1.0)
        going = (residual > CLOSED) & jnp.isfinite(residual)
        new = _Search(search.state + step, slope, matrix, residual, going)
        return jax.tree.map(lambda a, b: jnp.where(search.going, a, b), new, search), rounds + 1

    begin = _Search(begun, 0 * begun, last.matrix, size + jnp.inf, period > 0)
    found, _ = lax.while_loop(
        lambda carry: jnp.any(carry[0].going) & (carry[1] < JACOBIANS), newton, (begin, 0)
    )
    step = found.state - jnp.where(known, last.state, begun)
    straight = (w - last.frequency) / 2 * (found.slope + last.slope)
    good = continues(known, step, straight, size) & (found.residual <= CLOSED)
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
    and one that is followed may reach the end of its doubling. `after` says where some of the
    orbits are after so many drive periods.
    """
    period, size = period.copy(), np.linalg.norm(state, axis=1)
    for part in range(1, period.max(initial=1) // 2 + 1):
        own = np.flatnonzero((period % part == 0) & (period > part) & (part >= first))
        if len(own):
            gone = np.linalg.norm(after(own, part) - state[own], axis=1)
            period[own[gone <= CLOSED * size[own]]] = part
    return period
