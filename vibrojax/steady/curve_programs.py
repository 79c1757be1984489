"""Programs for motions of curves: they solve for one, or some behind each other, and read them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from vibrojax._tools.compiled import compiled
from vibrojax.steady.contact_times import Events
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.orbit_curve import (
    ROOM,
    TURN,
    Condition,
    Motion,
    Rigs,
    States,
    Try,
    nothing_found,
    solved,
)
from vibrojax.stepping import exact_contact
from vibrojax.stepping.gauge import Ruler
from vibrojax.stepping.measures import Measures

lax = jax.lax

ACCURATE = 1e-9
"""Largest last correction of a motion that counts as solved for."""
STRIDE = 16
"""Motions that a program of one lane solves for, one behind the other; they are marched in one."""
STRAIGHT = 0.85
"""Least cosine between tangents of neighbouring motions."""
GROWTH = (3, 2.5), (4, 1.8), (5, 1.4), (7, 1.0), (np.inf, 0.7)
"""By what steps grow after so many rounds of Newton's method."""
BENDS = 0.97
"""Cosine up to which no step grows."""
LEFT, LEAST = 0.75, 1e-4
"""Least share of a contact's duration that is left, or was there, after a step of that length."""
AIM = 0.8
"""Share of its duration that steps are chosen for."""
MEASURED = 1e-10
"""Relative error of the integrals that are read."""


class Read(NamedTuple):
    """A motion from drive phase 0."""

    initial_state: States
    """(q, q') at drive phase 0."""
    at_section: States
    """State at another section, times `unit`."""
    measures: Measures


def _onwards(ask: Try, found: Motion) -> tuple[Try, Bool[Array, " lanes"]]:
    """Ask for the motions a step behind those that were found, and whether that is worth it."""
    stride, scale = ask.stride, ask.scale
    size = jnp.sqrt(jnp.sum(found.state**2, axis=0))
    size = jnp.where(size > 0, size, 1.0)
    # The condition is along the motion before.
    cosine = jnp.sum(ask.condition.state * found.state_along, axis=0)
    cosine = cosine + ask.condition.parameter * found.parameter_along
    long = jnp.sum((found.state_along / stride.size) ** 2, axis=0)
    cosine = cosine / jnp.sqrt(long + (found.parameter_along / scale) ** 2)
    most, growth = np.array(GROWTH).T
    grown = jnp.asarray(growth)[jnp.searchsorted(most, found.rounds)]
    grown = jnp.where(cosine > BENDS, grown, jnp.minimum(grown, 1.0))
    longest = jnp.minimum(stride.longest, _as_long_as_contacts_last(ask.events, found))
    step = jnp.minimum(grown * stride.step, longest)
    along = found.state_along / size**2, found.parameter_along / scale**2
    value = jnp.sum(along[0] * found.state, axis=0) + along[1] * found.parameter + step
    none = jnp.zeros_like(step)
    following = ask._replace(
        state=found.state + step * found.state_along,
        times=found.times + step * found.times_along,
        parameter=found.parameter + step * found.parameter_along,
        condition=Condition(along[0], 0 * found.times, along[1], none, value),
        stride=stride._replace(size=size, step=step),
    )
    parameter = following.parameter
    inside = (parameter > stride.low) & (parameter < stride.high)
    return following, inside & (found.error <= ACCURATE) & (cosine >= STRAIGHT)


def _as_long_as_contacts_last(events: Events, found: Motion) -> Float[Array, " lanes"]:
    """Arclength within which no contact changes much: squares of durations change evenly."""
    stops, lasts = events.stop, jnp.diff(found.times, axis=0)
    is_pair = (stops[1:] == stops[:-1]) & (stops[1:] >= 0) & (lasts > 0)
    relative = 2 * jnp.diff(found.times_along, axis=0) / jnp.where(is_pair, lasts, 1.0)
    change = jnp.where(relative < 0, 1 - AIM**2, AIM**-2 - 1)
    way = jnp.where(is_pair, change / jnp.maximum(jnp.abs(relative), 1e-300), jnp.inf)
    return jnp.maximum(jnp.min(way, axis=0), LEAST)


@compiled
def solve_on_curve(rigs: LaneTable, tries: LaneTable, period: int) -> LaneTable:
    """Solve for motions of curves, each under a condition of its own.

    Returns `Motion` of all lanes, and the arclength to go on with. Of one lane there are `STRIDE`
    rows, a motion and those that follow, the error infinite where there is none. `rigs` is of
    `LocalPath`, `tries` of `Try`; motions return after `period` drive periods.
    """
    path, first = rigs.lanes_last(), tries.lanes_last()
    points = STRIDE if first.parameter.shape == (1,) else 1
    nothing = nothing_found(first), first.stride.step
    room = jax.tree.map(lambda a: jnp.broadcast_to(a, (points, *a.shape)), nothing)

    def further(carry: tuple[Array, Try, Any, Any]) -> tuple[Array, Try, Any, Any]:
        k, ask, _, every = carry
        found = solved(path, ask, period)
        following, good = _onwards(ask, found)
        new = found, following.stride.step
        every = jax.tree.map(lambda all, one: all.at[k].set(one), every, new)
        return k + 1, following, good & (k + 1 < ask.stride.most), every

    carry = jnp.zeros((), jnp.int32), first, jnp.ones(first.parameter.shape, bool), room
    if points > 1:
        carry = lax.while_loop(lambda carry: (carry[0] < points) & carry[2][0], further, carry)
    else:
        carry = further(carry)
    return table_of(
        jax.tree.map(lambda a: jnp.moveaxis(a, 0, -2).reshape(*a.shape[1:-1], -1), carry[-1])
    )


@compiled
def read_on_curve(
    rigs: LaneTable, tries: LaneTable, section: Float[Array, " lanes"], period: int
) -> LaneTable:
    """March motions of curves over their period from the section; `Read` of all lanes.

    Also their states at another `section`, a drive phase (rad) after their own.
    """
    ask: Try = tries.lanes_last()
    own = Rigs(rigs.lanes_last(), ask, period)
    at = own.contacts(own.loop(ask.parameter))
    begin = own.begin(at, ask.state)

    def state_at(angle: Array) -> Array:
        return own.state(at, *at.go_to(begin, ask.times, angle), angle)

    origin = jnp.where(ask.events.section > 0, TURN * period, 0.0)
    initial = state_at(origin) / ask.unit
    far = jnp.full_like(ask.parameter, jnp.inf)
    ruler = Ruler(jnp.full_like(far, MEASURED), far, nearest=True)
    phases, force = own.tables(ask.parameter, ask.events.section)
    state = ask.state / ask.unit
    _, _, measures = exact_contact.march(phases, force, state, period, ruler=ruler, room=ROOM)
    assert measures is not None
    return table_of(Read(initial, state_at(section), measures))
