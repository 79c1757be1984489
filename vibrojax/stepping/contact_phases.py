"""Flight and contact as linear systems: modes of the beam for every set of touching stops.

With linear stops the reduced model is linear in each *phase* (a set of stops in contact). Each
phase has its own exact propagator: its state matrix is brought to blocks of two, a rotation with
decay where the pair of eigenvalues is complex, two exponentials where it is real.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from vibrojax._tools.checks import concrete
from vibrojax._tools.compiled import compiled
from vibrojax._tools.eigenvalues import eigen
from vibrojax.model.equations import LinearEquations
from vibrojax.model.first_order import first_order
from vibrojax.model.laws import can_pull, is_linear
from vibrojax.stepping.resonance import NEAR, is_resonant

Lanes = Float[Array, "*lanes"]

HELD = 1e-8
"""Stiffness that holds a free body, over the square of its unit of frequency: two equal eigenvalues
would have one eigenvector. It bends a flight of ten units of time by 1e-6 of its length; histories
are marched without (`input_phases`), and only read between samples by these phases."""
MAX_STOPS = 4
"""More stops than this make too many phases (2 to their number) to tabulate."""


class ContactPhases(eqx.Module):
    """Propagators, read-outs and changes of phase for every set of touching stops.

    Axis `phases` runs over the sets, stop s touching where bit s of the index is set. State is
    (q, q', internal states); block coordinates are the two rows of every block. Arrays may carry
    lanes as trailing axes (all of them or none).
    """

    exponent: Float[Array, "phases 2 blocks *lanes"]
    """Real exponents of both rows, 1/s."""
    rate: Float[Array, "phases blocks *lanes"]
    """Angular frequency of a block, rad/s; 0 where its eigenvalues are real."""
    oscillates: Float[Array, "phases blocks *lanes"]
    """1 where the pair of eigenvalues is complex, else 0."""
    to_state: Float[Array, "phases states states *lanes"]
    """State of block coordinates."""
    from_state: Float[Array, "phases states states *lanes"]
    """Block coordinates of a state."""
    rest: Float[Array, "phases states *lanes"]
    """Block coordinates of the position of rest."""
    input: Float[Array, "phases states *lanes"]
    """Rate of the block coordinates under a unit input."""
    readout: Float[Array, "phases rows states *lanes"]
    """Rows that read block coordinates: depth of each stop, its rate, its acceleration, then the
    response and its rate."""
    readout_rest: Float[Array, "phases rows *lanes"]
    """What they read at rest, the gap taken off the depth."""
    change: Float[Array, "phases stops states states *lanes"]
    """Block coordinates after one stop has changed its contact, from those before."""
    change_rest: Float[Array, "phases stops states *lanes"]
    """What is to be added to them because the position of rest changes."""
    towards_stop: Float[Array, "stops states *lanes"]
    """Displacement towards each stop, from its surface where it relaxes, by state."""
    speed_towards_stop: Float[Array, "stops states *lanes"]
    """Velocity towards each stop, by state."""
    push_off: Float[Array, "states stops *lanes"]
    """Rate of the states away from each stop, by contact force."""
    gap: Float[Array, "stops *lanes"]
    stiffness: Float[Array, "stops *lanes"]
    damping: Float[Array, "stops *lanes"]
    weight: Float[Array, "states *lanes"]
    """Square roots of the weights of the states in the energy."""
    can_pull: tuple[bool, ...] = eqx.field(static=True)

    @property
    def num_stops(self) -> int:
        """How many stops there are."""
        return self.gap.shape[0]

    @property
    def num_blocks(self) -> int:
        """How many blocks of two a phase has: half the number of states."""
        return self.rate.shape[1]

    def changed_by_gaps(self) -> "ContactPhases":
        """Only what gaps change, which they do linearly; None in the place of all else."""
        changed = self.rest, self.readout_rest, self.change_rest, self.gap
        return jax.tree.map(lambda a: a if any(a is one for one in changed) else None, self)


def contact_phases(equations: LinearEquations) -> ContactPhases:
    """Compute the phases of one lane (the derivation is exact, damping of any kind included).

    Raises `ValueError` when a stop is not linear in contact or there are more than `MAX_STOPS`.
    """
    stops = equations.stops
    if not all(is_linear(stop.law) for stop in stops):
        raise ValueError(
            "ExactContact needs contact laws that are linear (KelvinVoigt, StandardLinearSolid). "
            "Use ExponentialSplitting for other laws."
        )
    if len(stops) > MAX_STOPS:
        raise ValueError(
            f"ExactContact takes at most {MAX_STOPS} stops, got {len(stops)}. "
            "Use ExponentialSplitting for more."
        )
    form = first_order(equations)
    # Time in units of the first mode, and states of like size, suit the eigenproblem.
    unit, scale, states = equations.angular_frequency[0], form.scale, len(form.scale)
    blocks, dtype = states // 2, form.flow.dtype
    flow = form.flow * scale / scale[:, None] / unit
    if equations.free:
        held = HELD * (equations.stiffness_sign == 0)
        flow = flow.at[equations.size : 2 * equations.size, : equations.size].add(-jnp.diag(held))
    pushes = form.push / scale[:, None] / unit
    held = form.stiffness[:, None] * form.depth + form.damping[:, None] * form.rate

    def one(touching: Float[Array, " stops"]) -> tuple[Array, ...]:
        push = pushes * touching
        values, vectors = eigen(flow - push @ (held * scale))
        complex_pairs = jnp.sum(values.imag > 0)
        index = jnp.arange(blocks)
        oscillates = index < complex_pairs
        first = jnp.where(oscillates, index, complex_pairs + 2 * (index - complex_pairs))
        second = jnp.where(oscillates, first, first + 1)
        left = jnp.where(oscillates, 2.0, 1.0) * vectors[:, first].real
        right = jnp.where(oscillates, -2 * vectors[:, first].imag, vectors[:, second].real)
        to_state = jnp.concatenate([left, right], axis=1)
        from_state = jnp.linalg.inv(to_state)
        # At rest every block holds the pull of stops and load: no second solution of the matrix.
        pulled = from_state @ (push @ (form.stiffness * form.gap) + form.load / scale / unit)
        decay = jnp.stack([values[first].real, values[second].real])
        turn = jnp.where(oscillates, values[first].imag, 0.0)
        rest = block_rest(decay, turn, pulled)
        return (
            decay * unit,
            turn * unit,
            oscillates.astype(dtype),
            scale[:, None] * to_state,
            from_state / scale,
            rest,
            from_state @ (form.input / scale),
        )

    sets = [[float(p >> s & 1) for s in range(len(stops))] for p in range(2 ** len(stops))]
    # As one batch: several of LAPACK's, side by side on few threads, may wait for each other.
    tables = jax.vmap(one)(jnp.asarray(sets, dtype).reshape(len(sets), len(stops)))
    exponent, rate, oscillates, to_state, from_state, rest, drive = tables
    count, lags = len(stops), [stop.memory_size > 0 for stop in stops]

    def slope(p: int, rows: Float[Array, "rows states"]) -> Float[Array, "rows states"]:
        left, right = rows[:, :blocks], rows[:, blocks:]
        decay, turn = exponent[p], rate[p]
        # d/dt of (z1, z2) is (a1 z1 - b z2, b z1 + a2 z2).
        along, across = left * decay[0] + right * turn, right * decay[1] - left * turn
        return jnp.concatenate([along, across], axis=1)

    def read(p: int) -> Float[Array, "rows states"]:
        depth, speed, response = (
            rows @ to_state[p] for rows in (form.depth, form.rate, form.response[None])
        )
        if any(lags):  # the surface of such a stop moves too
            speed = jnp.where(np.array(lags)[:, None], slope(p, depth), speed)
        return jnp.concatenate([depth, speed, slope(p, speed), response, slope(p, response)])

    readout = jnp.stack([read(p) for p in range(len(sets))])
    offset = jnp.concatenate([form.gap, jnp.zeros(2 * count + 2)])
    change = jnp.zeros((len(sets), count, states, states))
    change_rest = jnp.zeros((len(sets), count, states))
    for p, s in np.ndindex(len(sets), count):
        other = p ^ (1 << s)
        matrix = from_state[other] @ to_state[p]
        change = change.at[p, s].set(matrix)
        change_rest = change_rest.at[p, s].set(matrix @ rest[p] - rest[other])
    at_rest = jnp.einsum("prs,ps->pr", readout, rest) - offset
    # Block coordinates count from rest, where nothing moves.
    at_rest = at_rest.at[:, count : 3 * count].set(0.0).at[:, -1].set(0.0)
    return ContactPhases(
        exponent=exponent,
        rate=rate,
        oscillates=oscillates,
        to_state=to_state,
        from_state=from_state,
        rest=rest,
        input=drive,
        readout=readout,
        readout_rest=at_rest,
        change=change,
        change_rest=change_rest,
        towards_stop=form.depth,
        speed_towards_stop=form.rate,
        push_off=form.push,
        gap=form.gap,
        stiffness=form.stiffness,
        damping=form.damping,
        weight=equations.energy_weight,
        can_pull=tuple(can_pull(stop.law) for stop in stops),
    )


def block_rest(
    decay: Float[Array, "2 blocks *#lanes"],
    turn: Float[Array, "blocks *#lanes"],
    pulled: Float[Array, "states *lanes"],
) -> Float[Array, "states *lanes"]:
    """Block coordinates at which the blocks, [[a, -b], [b, a]] or diag(a1, a2), undo a pull."""
    top, bottom = jnp.split(pulled, 2)
    determinant = decay[0] * decay[1] + turn**2
    first, second = decay[1] * top + turn * bottom, decay[0] * bottom - turn * top
    return -jnp.concatenate([first / determinant, second / determinant])


_phases_of = compiled(contact_phases)


def phases_of(equations: LinearEquations) -> ContactPhases:
    """Compute the phases by a program of their own, which serves all numbers."""
    return _phases_of(jax.tree.map(jnp.asarray, equations))


def forced_blocks(
    phases: ContactPhases, amplitude: Complex[Array, "*lanes"], angular_frequency: Lanes
) -> Complex[Array, "phases states *lanes"]:
    """Block coordinates Z of the steady response to the input Im(amplitude exp(i phase)).

    The steady response in every phase is Im(Z exp(i phase)); each block is solved in closed form.
    Blocks in resonance have none: their input is that of `resonant_blocks`.
    """
    top, bottom, along, across, rate = _driven(phases, angular_frequency)
    determinant = along * across + rate**2
    resonant = is_resonant(determinant, angular_frequency)
    factor = jnp.where(resonant, 0.0, amplitude / jnp.where(resonant, 1.0, determinant))
    first, second = across * top - rate * bottom, rate * top + along * bottom
    return jnp.concatenate([factor * first, factor * second], axis=1)


def resonant_blocks(
    phases: ContactPhases, amplitude: Complex[Array, "*lanes"], angular_frequency: Lanes
) -> Complex[Array, "phases states *lanes"]:
    """Input of the block coordinates that is to be integrated (`resonance`); 0 for most blocks."""
    top, bottom, along, across, rate = _driven(phases, angular_frequency)
    resonant = is_resonant(along * across + rate**2, angular_frequency)
    push = jnp.where(resonant, amplitude, 0.0)
    return jnp.concatenate([push * top, push * bottom], axis=1)


def can_resonate(phases: ContactPhases | None) -> bool:
    """Whether a block of these phases has next to no damping, as far as is known while tracing."""
    if phases is None:
        return False
    if concrete(phases.exponent) is None or concrete(phases.rate) is None:
        return True
    return bool(np.any(may_resonate(phases)))


def may_resonate(phases: ContactPhases) -> Bool[np.ndarray, "*lanes"]:
    """Whether a block of a lane's phases has next to no damping; concrete, the lanes leading."""
    exponent, rate = np.asarray(phases.exponent), np.asarray(phases.rate)
    damped = np.abs(exponent[..., 0, :]) >= 2 * NEAR * rate
    return np.asarray(np.any((rate > 0) & ~damped, axis=(-2, -1)))


def _driven(
    phases: ContactPhases, angular_frequency: Lanes
) -> tuple[
    Float[Array, "phases blocks *#lanes"],
    Float[Array, "phases blocks *#lanes"],
    Complex[Array, "phases blocks *#lanes"],
    Complex[Array, "phases blocks *#lanes"],
    Float[Array, "phases blocks *#lanes"],
]:
    """Input of both rows of every block, and i W - block, where W is the drive frequency.

    The block is [[a, -b], [b, a]], or diag(a1, a2) with b = 0.
    """
    n, lanes = phases.num_blocks, angular_frequency.ndim
    top, bottom = (spread(phases.input[:, rows], 2, lanes) for rows in (slice(n), slice(n, None)))
    decay = spread(phases.exponent, 3, lanes)
    along = 1j * angular_frequency - decay[:, 0]
    across = 1j * angular_frequency - decay[:, 1]
    return top, bottom, along, across, spread(phases.rate, 2, lanes)


def spread(table: Array, rank: int, lanes: int) -> Array:
    """Give a table of this rank that all lanes share as many trailing axes as there are lanes."""
    if table.ndim > rank:
        return table
    return table.reshape(table.shape + (1,) * lanes)


def contact_rates(phases: ContactPhases) -> Lanes:
    """Lowest angular frequency with all stops in contact, rad/s: sets how finely to look."""
    rates = phases.rate[-1]
    lowest = jnp.min(jnp.where(rates > 0, rates, np.inf), axis=0)
    # Where every pair is real: their rate without damping.
    undamped = jnp.sqrt(jnp.maximum(jnp.prod(phases.exponent[-1], axis=0), 0.0))
    return jnp.where(jnp.isfinite(lowest), lowest, jnp.max(undamped, axis=0))
