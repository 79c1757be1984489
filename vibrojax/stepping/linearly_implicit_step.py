"""One linearly implicit step of any system: mass at the middle, stiffness and damping implicit.

The constant linear part is taken by the trapezoidal rule and everything else at the middle of the
step, so that neither the stiffest link nor its damping limits the step, and every step is one
linear solve with M(q) + h/2 C + h^2/4 K. A stop acts from the moment it is touched: its impulse is
that of a backward Euler step over the rest of the step, in closed form for a linear law, which
stays well behaved where a contact is a hundred times faster than the step.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax.contact_laws import linear_coefficients
from vibrojax.systems.base import AbstractEquations

lax = jax.lax

CONTACT_PASSES = 4
"""Newton steps for a contact force that is not linear, or several stops that may let go."""


class StepMatrix(eqx.Module):
    """The matrix of the solve at the position of rest, and its inverse, for one step length."""

    mass: Float[Array, "coordinates coordinates"]
    inverse: Float[Array, "coordinates coordinates"]
    """Of M(0) + h/2 C + h^2/4 K."""


def linear_matrices(
    equations: AbstractEquations,
) -> tuple[Float[Array, "coordinates coordinates"], ...]:
    """Return M at rest, C and K."""
    rest = jnp.zeros(equations.size)
    damping = jax.jacfwd(lambda rate: equations.linear_force(rest, rate))(rest)
    stiffness = jax.jacfwd(lambda q: equations.linear_force(q, rest))(rest)
    return equations.mass(rest), damping, stiffness


def step_matrix(
    matrices: tuple[Float[Array, "coordinates coordinates"], ...], step: Float[Array, ""]
) -> StepMatrix:
    """Invert the matrix of the solve at rest."""
    mass, damping, stiffness = matrices
    return StepMatrix(mass, jnp.linalg.inv(mass + step / 2 * damping + step**2 / 4 * stiffness))


def _refined(equations, table, q, first, found, refinements):
    """Refine `found` towards the solution at q, of which `first` is that at rest.

    Returns it and the last correction.
    """
    change = jnp.zeros_like(found)
    if equations.has_constant_mass:
        return first, change
    for _ in range(refinements):
        lag = equations.mass_times(q, found) - table.mass @ found
        refined = first - table.inverse @ lag
        found, change = refined, refined - found
    return found, change


def take_step(
    equations: AbstractEquations,
    table: StepMatrix,
    state: Float[Array, " states"],
    step: Float[Array, ""],
    drive_input: Float[Array, ""],
    refinements: int,
) -> Float[Array, " states"]:
    """Advance one lane by a step; `drive_input` is that of its middle.

    The state is NaN where the refinements of the solve do not converge.
    """
    n = equations.size
    q, rate = state[:n], state[n : 2 * n]
    halfway = q + step / 2 * rate
    linear = equations.linear_force(halfway, rate)

    def at_rest(middle, turning):
        pull = equations.smooth_force(middle, turning) + equations.input(middle) * drive_input
        return table.inverse @ (step * (pull - linear))

    # First without refinement, for the velocity in the middle; then the solve proper.
    guess = at_rest(halfway, rate)
    guess, _ = _refined(equations, table, halfway, guess, guess, refinements - 1)
    middle = halfway + step / 4 * guess
    first = at_rest(middle, rate + guess / 2)
    gain, left = _refined(equations, table, middle, first, guess, refinements)
    lost = jnp.sum(left**2) > 1e-4 * jnp.sum(gain**2)
    free_rate = rate + gain
    free = q + step / 2 * (rate + free_rate)
    if equations.stops:
        flight = _Flight(q, rate, middle, free, free_rate)
        change, rate_change = _contact(equations, table, flight, step, refinements)
        free, free_rate = free + change, free_rate + rate_change
    return jnp.where(lost, jnp.nan, jnp.concatenate([free, free_rate]))


class _Flight(NamedTuple):
    """A step without contact forces: its start, its middle and its end."""

    q: Array
    rate: Array
    middle: Array
    free: Array
    free_rate: Array


def _contact(equations, table, flight, step, refinements):
    """What the stops change of displacements and rates over a step."""
    before = equations.penetration(flight.q)
    after, pull_back = jax.vjp(equations.penetration, flight.free)
    count = len(equations.stops)
    towards = [pull_back(jnp.zeros(count).at[s].set(1.0))[0] for s in range(count)]
    at_rest = [table.inverse @ own for own in towards]
    mobility = [
        _refined(equations, table, flight.middle, m, m, refinements - 1)[0] for m in at_rest
    ]
    # From the touch on, the share of the step that is left, and the speed of the touch.
    held = jnp.maximum(before, 0.0)
    gone = jnp.where(before >= 0, 1.0, after - before)
    share = jnp.where(before >= 0, 1.0, jnp.where(after > 0, after / gone, 0.0))
    time = step * share
    slowed = [flight.free_rate + s * (flight.rate - flight.free_rate) for s in share]
    speed = jnp.stack([jnp.sum(a * b) for a, b in zip(towards, slowed, strict=True)])
    give = [[jnp.sum(towards[s] * mobility[t]) for t in range(count)] for s in range(count)]
    # The impact first, which stops the approach at once; then what presses on over the rest.
    reach = [[time[t] * give[s][t] for t in range(count)] for s in range(count)]
    sudden = contact_impulses(equations.stops, held, held + time * speed, time, reach)
    half = [[own / 2 for own in row] for row in reach]
    taken = [sum(r * p for r, p in zip(row, sudden, strict=True)) for row in half]
    stopped = after - jnp.stack(taken)
    impulse = contact_impulses(equations.stops, held, stopped, time, half)
    rate_change = -sum(p * m for p, m in zip(impulse, mobility, strict=True))
    change = -sum(time[s] * (sudden[s] + impulse[s]) / 2 * mobility[s] for s in range(count))
    return change, rate_change


def contact_impulses(
    stops: tuple,
    before: Float[Array, " stops"],
    after: Float[Array, " stops"],
    time: Float[Array, " stops"],
    reach: Sequence[Sequence[Float[Array, ""]]],
) -> list[Float[Array, ""]]:
    """Return the impulse of each stop, N s.

    `before` is the depth at touch or at the start of the step (0 or more), `after` the one without
    contact forces, `time` how long the stop may act, `reach[s][t]` what a unit impulse of stop t
    takes off the depth of stop s. One Newton step is exact for one linear stop.
    """
    count = len(stops)
    linear = all(linear_coefficients(stop.law) is not None for stop in stops)
    passes = 1 if count == 1 and linear and stops[0].is_linear else CONTACT_PASSES
    impulse = [jnp.zeros_like(after[s]) for s in range(count)]
    touching = [(after[s] > 0) | (before[s] > 0) for s in range(count)]
    tiny = jnp.finfo(after.dtype).tiny

    def law(s, depth):
        """Impulse of stop s that ends at a depth, and its slope."""
        safe = jnp.where(time[s] > tiny, time[s], 1.0)

        def of(depth):
            reached = jnp.maximum(depth, 0.0)
            # The dashpot's share hangs on the way only: no division by a vanishing time.
            return time[s] * stops[s].force(reached, (reached - before[s]) / safe)

        value, slope = jax.jvp(of, (depth,), (jnp.ones_like(depth),))
        live = touching[s] & (time[s] > tiny)
        return jnp.where(live, value, 0.0), jnp.where(live, slope, 0.0)

    for _ in range(passes):
        rows, right = [], []
        for s in range(count):
            depth = after[s] - sum(reach[s][t] * impulse[t] for t in range(count))
            value, slope = law(s, depth)
            rows.append([(s == t) + slope * reach[s][t] for t in range(count)])
            right.append(value - impulse[s])
        change = _eliminate(rows, right)
        impulse = [p + c for p, c in zip(impulse, change, strict=True)]
    return [jnp.where(t, p, 0.0) for t, p in zip(touching, impulse, strict=True)]


def _eliminate(rows, right):
    """Solve a small dense system, unrolled: a library call per lane would cost more than a step."""
    rows, right, count = [list(row) for row in rows], list(right), len(right)
    for i in range(count):
        for j in range(i + 1, count):
            factor = rows[j][i] / rows[i][i]
            rows[j] = [b - factor * a for a, b in zip(rows[i], rows[j], strict=True)]
            right[j] = right[j] - factor * right[i]
    for i in reversed(range(count)):
        known = sum(rows[i][j] * right[j] for j in range(i + 1, count))
        right[i] = (right[i] - known) / rows[i][i]
    return right
