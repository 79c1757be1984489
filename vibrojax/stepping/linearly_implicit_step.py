"""One linearly implicit step of any system: mass at the middle, stiffness and damping implicit.

The constant linear part is taken by the trapezoidal rule and everything else at the middle of the
step, so that neither the stiffest link nor its damping limits the step, and every step is one
linear solve with M(q) + h/2 C + h^2/4 K. A stop acts from the moment it is touched: its impulse is
that of a backward Euler step over the rest of the step, in closed form for a linear law, which
stays well behaved where a contact is a hundred times faster than the step.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax.model.equations import AbstractEquations
from vibrojax.model.laws import linear_coefficients
from vibrojax.model.stop_forces import forces_and_slopes, stop_forces
from vibrojax.model.stops import Stop
from vibrojax.stepping.elementary import solve_small
from vibrojax.stepping.splitting import drift

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
        flight = (q, rate), middle, (free, free_rate)
        change, rate_change = _contact(equations, table, *flight, step, refinements)
        free, free_rate = free + change, free_rate + rate_change
    return jnp.where(lost, jnp.nan, jnp.concatenate([free, free_rate]))


def _contact(equations, table, start, middle, end, step, refinements):
    """What the stops change of displacements and rates over a step, from (q, q') without them."""
    before = equations.penetration(start[0])
    after, pull_back = jax.vjp(equations.penetration, end[0])
    count = len(equations.stops)
    towards = [pull_back(jnp.zeros(count).at[s].set(1.0))[0] for s in range(count)]
    mobility = []
    for own in towards:
        first = table.inverse @ own
        moved, _ = _refined(equations, table, middle, first, first, refinements - 1)
        mobility.append(moved)
    towards, mobility = jnp.stack(towards), jnp.stack(mobility)
    # From the touch on, the share of the step that is left, and the speed of the touch.
    outside = before < 0
    gone = jnp.where(outside, after - before, 1.0)
    share = jnp.where(outside, jnp.where(after > 0, after / gone, 0.0), 1.0)
    time, held = step * share, jnp.maximum(before, 0.0)
    last, change = towards @ end[1], towards @ (start[1] - end[1])
    reach = towards @ mobility.T * time
    # The impact first, which stops the approach at once; then what presses on over the rest.
    speed = last + share * change
    sudden, shift = _impact(equations.stops, held, speed, time, reach)
    eased = after - shift + reach @ sudden / 2
    impulse = contact_impulses(equations.stops, held, eased, time, reach / 2)
    own = jnp.diagonal(reach)
    late = jnp.where(own > 0, time * shift / jnp.where(own > 0, own, 1.0), 0.0)
    return -(late + time * (impulse - sudden) / 2) @ mobility, -impulse @ mobility


def _impact(stops, held, speed, time, reach):
    """Impulses (N s) that meet the speed of touch, and what they take off the depths (m).

    A stop, linearised at the touch, is an oscillator on the mobility of its place, whose motion is
    known. Where it would let go, a backward Euler step is taken.
    """
    force, stiffness, damping = forces_and_slopes(stops, held, speed)
    if all(linear_coefficients(stop.law) is not None for stop in stops):
        # At the corner itself the slopes are those beyond it.
        laws = zip(*(linear_coefficients(stop.law) for stop in stops), strict=True)
        stiffness, damping = (jnp.stack([jnp.asarray(x, float) for x in c]) for c in laws)
        force = stiffness * held + damping * speed
    tiny = jnp.finfo(held.dtype).tiny
    lasting = time > tiny
    safe = jnp.where(lasting, time, 1.0)
    give = jnp.where(lasting, jnp.diagonal(reach) / safe, 1.0)
    rate = jnp.sqrt(jnp.maximum(give * stiffness, 1e-6 / safe**2))
    flow = drift(rate, give * damping / (2 * rate), safe)
    steady = -give * (force - damping * speed)
    gone = flow.qv * speed + steady * (1 - flow.qq) / rate**2
    left = flow.vv * speed + steady * flow.qv
    end = force + stiffness * gone + damping * (left - speed)
    pushes = lasting & (end >= 0) & (held + gone > 0)
    implicit = contact_impulses(stops, held, held + time * speed, time, reach)
    sudden = jnp.where(pushes, (speed - left) / give, implicit)
    taken = jnp.where(pushes, time * speed - gone, jnp.diagonal(reach) * implicit)
    return sudden, taken


def contact_impulses(
    stops: tuple[Stop, ...],
    before: Float[Array, " stops"],
    after: Float[Array, " stops"],
    time: Float[Array, " stops"],
    reach: Float[Array, "stops stops"],
) -> Float[Array, " stops"]:
    """Return the impulse of each stop, N s.

    `before` is the depth at touch or at the start of the step (0 or more), `after` the one without
    contact forces, `time` how long the stop may act, `reach[s, t]` what a unit impulse of stop t
    takes off the depth of stop s.
    """
    linear = all(linear_coefficients(stop.law) is not None for stop in stops)
    # A linear law is exact at once, but for its rounded corner and for one of several letting go.
    passes = 2 if linear else CONTACT_PASSES
    # No division by a vanishing time: the dashpot's share depends on the way only.
    tiny = jnp.finfo(after.dtype).tiny
    live = ((after > 0) | (before > 0)) & (time > tiny)
    safe = jnp.where(live, time, 1.0)

    def law(depth):
        reached = jnp.maximum(depth, 0.0)
        force = stop_forces(stops, (before + reached) / 2, (reached - before) / safe)
        return jnp.where(live, safe * force, 0.0)

    impulse = jnp.zeros_like(after)
    for _ in range(passes):
        depth = after - reach @ impulse
        value, slope = jax.jvp(law, (depth,), (jnp.ones_like(depth),))
        impulse = impulse + solve_small(slope[:, None] * reach, value - impulse)
    return impulse
