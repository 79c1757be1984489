"""Where motions without contact reach a stop: the touches ahead of them, in closed form."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.pool_programs import in_widths, widths_for
from vibrojax.steady.tracks import can_follow
from vibrojax.stepping.elementary import apply_matrix
from vibrojax.stepping.stepper import AbstractMarch, ExactMarch

lax = jax.lax

PARTS = 64
"""Parts of the way: a stop that is reached within one of them only is not seen."""
HALVINGS = 50
BEYOND = 3e-8
"""How far beyond a touch motions are looked at, over the frequency."""


class TouchAhead(NamedTuple):
    """The first touch on the way, and the motion as it would be without the stop just beyond it."""

    angular_frequency: Float[AnyArray, " lanes"]
    """rad/s; NaN where none is on the way."""
    beyond: Float[AnyArray, " lanes"]
    """rad/s."""
    state: Float[AnyArray, "states lanes"]
    """(q, q') at drive phase 0."""
    amplitude: Float[AnyArray, " lanes"]
    """Of the response, in its unit."""


@compiled(lightly=True)
def touch_ahead(
    march: LaneTable, start: Float[AnyArray, " lanes"], way: Float[AnyArray, " lanes"]
) -> LaneTable:
    """Look for touches from a frequency on, no further than `way` (rad/s, signed)."""
    own, start, way = march.lanes_last(), jnp.asarray(start), jnp.asarray(way)
    phases, stops = own.phases, own.phases.num_stops

    def reaches(w: Array) -> Array:
        wave = jnp.abs(own.force_at(w).readout[0, :stops])
        return jnp.any(wave + phases.readout_rest[0, :stops] > 0, axis=0)

    def closer(k: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        """Go from part to part until a stop is reached, then halve that part."""
        low, high = ends
        halves = k >= PARTS
        share = jnp.where(halves, (low + high) / 2, (k + 1) / PARTS)
        there, live = reaches(start + way * share), halves | jnp.isinf(high)
        return jnp.where(live & ~there, share, low), jnp.where(live & there, share, high)

    none = jnp.zeros(start.shape)
    _, share = lax.fori_loop(0, PARTS + HALVINGS, closer, (none, none + jnp.inf))
    found = start + way * share
    beyond = found * (1 + BEYOND * jnp.sign(way))
    force = own.force_at(beyond)
    state = apply_matrix(phases.to_state[0], phases.rest[0] + force.blocks[0].imag)
    amplitude = jnp.abs(force.readout[0, 3 * stops])
    found = jnp.where(jnp.isfinite(share), found, jnp.nan)
    return table_of(TouchAhead(found, beyond, state, amplitude))


def touches_ahead(
    march: AbstractMarch,
    rig: Int[np.ndarray, " lanes"],
    angular_frequency: Float[np.ndarray, " lanes"],
    way: Float[np.ndarray, " lanes"],
) -> TouchAhead:
    """Return the touches ahead of motions without contact, lanes leading, in numpy.

    None is looked for where motions cannot be followed. `rig` says which of the rigs of `march`,
    its trailing axis, each lane has.
    """
    rigs, states = table_of(march, xp=np), march.energy_weight().shape[0]
    none = np.full(len(rig), np.nan)
    found = TouchAhead(none, none + 0, np.full((len(rig), states), np.nan), none + 0)
    left = np.flatnonzero(can_follow(rigs.columns(), rigs.numbers.shape[0])[rig])
    widths = widths_for(len(left), rigs.numbers.shape[1])
    for own, at in in_widths(left, widths):
        table = touch_ahead(rigs.pick(rig[at]), angular_frequency[at], way[at])
        for here, there in zip(table.columns(), found, strict=True):
            there[own] = here[: len(own)]
    return found


def compile_touch_ahead(march: AbstractMarch, lanes: int) -> None:
    """Compile in the background what touches of so many lanes, or fewer, are looked for with.

    Of `march`, whose rigs are its trailing axis, only the shapes are looked at.
    """
    if isinstance(march, ExactMarch):
        width = widths_for(lanes, table_of(march, lanes=1).numbers.shape[1])[0]
        touch_ahead.ahead(table_of(march, lanes=width), np.ones(width), np.ones(width))
