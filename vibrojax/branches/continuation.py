"""Pseudo-arclength continuation of the condensed balance, many lanes at once.

Every tick factors the linearised balance of every lane once; from that one factorisation come the
Newton correction and the tangent, and each lane accepts its point, corrects on or goes back with a
shorter step by itself.
"""

import enum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.steady.condensed import balance, condensed_problem, solve_lanes
from vibrojax.steady.paths import AbstractPath

lax = jax.lax

FIRST_STEP, LONGEST_STEP, SHORTEST_STEP = 0.02, 0.08, 1e-6
"""Of the arclength: change of the motion over its size, and of the parameter over its scale."""
STRAIGHT = 0.85
"""Least cosine between tangents of neighbouring points."""
LEFT = 0.03
"""Most that a Newton correction may be at a point that counts as converged, over the step."""
MOST_CORRECTIONS = 8
TICKS = 64
"""Run in one call of the compiled loop."""
LOOP_POINTS = 12
"""Points before a branch can close on itself."""


class Ending(enum.Enum):
    """What became of a lane of a continuation."""

    running = 0
    completed = 1
    stuck = 2
    turned_back = 3
    closed = 4
    joined = 5

    @property
    def sentence(self) -> str:
        """The ending in words."""
        return _SENTENCES[self]


_SENTENCES = {
    Ending.running: "The branch goes on: the points allowed did not suffice.",
    Ending.completed: "The branch reaches the end of the range.",
    Ending.stuck: "No next point was found however short the step.",
    Ending.turned_back: "The branch comes back to where the range starts.",
    Ending.joined: "The branch joins the one of half its period again.",
    Ending.closed: "The branch closes on itself.",
}


class Settings(NamedTuple):
    """Numbers of the continuation; arrays, so that new ones do not compile again."""

    start: Float[AnyArray, " lanes"]
    low: Float[AnyArray, " lanes"]
    high: Float[AnyArray, " lanes"]
    direction: Float[AnyArray, " lanes"]
    """1 to set out upwards in the parameter, -1 downwards."""
    scale: Float[AnyArray, " lanes"]
    """Change of the parameter that counts as much as a change of the motion by its size."""
    tolerance: Float[AnyArray, ""]
    """Relative Newton correction at which a point counts as converged."""
    longest: Float[AnyArray, ""]
    """Longest step of the arclength."""


class Trace(NamedTuple):
    """Where a lane is: the carry of the loop."""

    depth: Complex[Array, "lanes stops harmonics"]
    parameter: Float[Array, " lanes"]
    last_depth: Complex[Array, "lanes stops harmonics"]
    """The point accepted last."""
    last_parameter: Float[Array, " lanes"]
    tangent: Complex[Array, "lanes stops harmonics"]
    tangent_parameter: Float[Array, " lanes"]
    step: Float[Array, " lanes"]
    corrections: Int[Array, " lanes"]
    last_size: Float[Array, " lanes"]
    pinned: Bool[Array, " lanes"]
    """Whether the parameter is held: at the start, and for the last point of the range."""
    goal: Float[Array, " lanes"]
    """Where it is held."""
    started: Bool[Array, " lanes"]
    status: Int[Array, " lanes"]
    ticks: Int[Array, " lanes"]
    points: Int[Array, " lanes"]
    first_depth: Complex[Array, "lanes stops harmonics"]
    first_parameter: Float[Array, " lanes"]


class Point(NamedTuple):
    """What a tick reports of a lane; a point of the branch where `accepted`."""

    accepted: Bool[Array, " lanes"]
    depth: Complex[Array, "lanes stops harmonics"]
    parameter: Float[Array, " lanes"]
    direction: Float[Array, " lanes"]
    """Change of the parameter along the branch."""


def begin(
    depth: Complex[AnyArray, "lanes stops harmonics"], parameter: Float[AnyArray, " lanes"]
) -> Trace:
    """Start every lane from a first guess of its motion at the start of the range.

    On the host: single operations compile anew for every number of lanes.
    """
    lanes = depth.shape[0]
    zero: Any = np.zeros(lanes)
    off: Any = np.zeros(lanes, bool)
    count: Any = np.zeros(lanes, np.int32)
    first: Any = np.array(depth, complex)
    at: Any = np.asarray(parameter, float) + zero
    return Trace(
        depth=first,
        parameter=at,
        last_depth=first,
        last_parameter=at,
        tangent=np.zeros_like(first),
        tangent_parameter=zero,
        step=zero + FIRST_STEP,
        corrections=count,
        last_size=zero + np.inf,
        pinned=~off,
        goal=at,
        started=off,
        status=count,
        ticks=count,
        points=count,
        first_depth=first,
        first_parameter=at,
    )


def dot(a: Complex[AnyArray, "*sides"], b: Complex[AnyArray, "*sides"]) -> Float[AnyArray, "..."]:
    """Mean over time of the product of two motions given by spectra (up to a constant)."""
    product: Any = a * b.conj()
    product = product.real
    return 2 * product.sum(axis=(-2, -1)) - product[..., 0].sum(axis=-1)


def capacities(unknowns: int) -> tuple[int, ...]:
    """Sizes of the linear systems that are compiled; the smallest that holds all lanes is used."""
    sizes = [unknowns // 8, unknowns // 4, 3 * unknowns // 8, unknowns // 2, unknowns]
    return tuple(sorted({max(4, size) for size in sizes}))


@compiled
def follow(
    paths: AbstractPath,
    settings: Settings,
    trace: Trace,
    *,
    samples: int,
    period: int,
    harmonics: int | None,
) -> tuple[Trace, Point]:
    """Run some ticks (Newton steps) of all lanes; points are stacked along a leading axis."""
    sizes = capacities(trace.depth.shape[1] * samples)

    def linearise(path, depth, parameter):
        def residual(p):
            problem = condensed_problem(
                path.at(p), samples=samples, period=period, harmonics=harmonics
            )
            at = balance(problem, depth)
            return at.residual, (at, problem)

        value, slope, (at, problem) = jax.jvp(
            residual, (parameter,), (jnp.ones_like(parameter),), has_aux=True
        )
        return problem, at, -jnp.stack([value, slope])

    def tick(trace: Trace, _):
        problem, at, right = jax.vmap(linearise)(paths, trace.depth, trace.parameter)
        running = trace.status == Ending.running.value
        both = solve_lanes(problem, at, right, sizes, running)
        return _advance(trace, both[:, 0], both[:, 1], settings, running)

    return lax.scan(tick, trace, None, length=TICKS)


def _advance(trace: Trace, correction, direction, settings: Settings, running):
    """Take the Newton step of every lane, and accept, correct on or go back."""
    size = jnp.sqrt(dot(trace.last_depth, trace.last_depth))
    scale = settings.scale
    # Offset from the plane through the predicted point, across the tangent.
    moved = dot(trace.tangent, trace.depth - trace.last_depth) / size**2
    moved_parameter = trace.tangent_parameter * (trace.parameter - trace.last_parameter)
    offset = moved + moved_parameter / scale**2 - trace.step
    slope = dot(trace.tangent, direction) / size**2 + trace.tangent_parameter / scale**2
    shift = -(offset + dot(trace.tangent, correction) / size**2) / jnp.where(slope == 0, 1.0, slope)
    shift = jnp.where(trace.pinned, trace.goal - trace.parameter, shift)
    change = correction + direction * shift[:, None, None]
    depth, parameter = trace.depth + change, trace.parameter + shift
    newton = jnp.sqrt(dot(change, change) / size**2 + (shift / scale) ** 2)
    corrections = trace.corrections + 1
    good = jnp.isfinite(newton)
    # What is left has to be small beside a short step too, or the way on from there is not known.
    converged = good & (newton < jnp.minimum(settings.tolerance, LEFT * trace.step))

    length = jnp.sqrt(dot(direction, direction) / size**2 + 1 / scale**2)
    unit, unit_parameter = direction / length[:, None, None], 1 / length
    cosine = (
        dot(trace.tangent, unit) / size**2 + trace.tangent_parameter * unit_parameter / scale**2
    )
    sign = jnp.where(trace.started, jnp.where(cosine < 0, -1.0, 1.0), settings.direction)
    straight = ~trace.started | (jnp.abs(cosine) > STRAIGHT)
    gone = jnp.sqrt(
        dot(depth - trace.last_depth, depth - trace.last_depth) / size**2
        + ((parameter - trace.last_parameter) / scale) ** 2
    )
    near = ~trace.started | (gone < 2.5 * trace.step + 1e-9)
    inside = (parameter <= settings.high) & (parameter >= settings.low)
    found = running & converged & straight & near
    accepted = found & (inside | trace.pinned)
    # A point beyond the range shows where between the last one and itself the range ends.
    overshot = found & ~accepted
    # A correction that grows, or too many of them: go back and take a shorter step.
    hopeless = (corrections >= MOST_CORRECTIONS) | (
        (newton > 2 * trace.last_size) & (corrections > 2)
    )
    # The first point has no shorter step to go back to.
    patient = ~trace.started & (corrections < 5 * MOST_CORRECTIONS)
    failed = running & ~found & (converged | ~good | (hopeless & ~patient))
    retry = failed & trace.started
    growth = jnp.select(
        [corrections <= 2, corrections == 3, corrections <= 5], [1.5, 1.2, 1.0], 0.6
    )
    growth = jnp.where(cosine * sign > 0.97, growth, jnp.minimum(growth, 1.0))
    base = jnp.where(trace.pinned & trace.started, trace.step, trace.step * growth)
    step = jnp.where(accepted & trace.started, jnp.minimum(base, settings.longest), trace.step)
    step = jnp.where(retry, 0.35 * step, step)

    last_depth = jnp.where(accepted[:, None, None], depth, trace.last_depth)
    last_parameter = jnp.where(accepted, parameter, trace.last_parameter)
    tangent = jnp.where(accepted[:, None, None], sign[:, None, None] * unit, trace.tangent)
    tangent_parameter = jnp.where(accepted, sign * unit_parameter, trace.tangent_parameter)
    last = jnp.where(trace.goal == settings.start, Ending.turned_back.value, Ending.completed.value)
    status = jnp.where(accepted & trace.pinned & trace.started, last, trace.status)
    status = jnp.where(retry & (step < SHORTEST_STEP), Ending.stuck.value, status)
    status = jnp.where(failed & ~trace.started, Ending.stuck.value, status)
    points = trace.points + accepted
    is_first = accepted & (trace.points == 0)
    first_depth = jnp.where(is_first[:, None, None], depth, trace.first_depth)
    first_parameter = jnp.where(is_first, parameter, trace.first_parameter)
    home = depth - first_depth
    distance = jnp.sqrt(dot(home, home) / size**2 + ((parameter - first_parameter) / scale) ** 2)
    closed = accepted & (points > LOOP_POINTS) & (distance < 0.75 * gone)
    status = jnp.where(closed, Ending.closed.value, status)
    started = trace.started | accepted
    # The next try: predict along the tangent, and stop at the ends of the range.
    fresh = accepted | retry
    ahead = last_parameter + step * tangent_parameter
    above, below = ahead >= settings.high, ahead <= settings.low
    beyond = above | below
    goal = jnp.where(above, settings.high, settings.low)
    safe = jnp.where(tangent_parameter == 0, 1.0, tangent_parameter)
    reach = (goal - last_parameter) / safe
    stride = jnp.where(beyond, reach, step)
    predicted = last_depth + stride[:, None, None] * tangent
    pinned = jnp.where(fresh, beyond, trace.pinned & ~accepted) | overshot
    predicted_parameter = jnp.where(beyond, goal, ahead)
    goal = jnp.where(
        overshot, jnp.where(parameter > settings.high, settings.high, settings.low), goal
    )
    passed = parameter - trace.last_parameter
    share = (goal - trace.last_parameter) / jnp.where(overshot, passed, 1.0)
    inner = trace.last_depth + share[:, None, None] * (depth - trace.last_depth)
    predicted = jnp.where(overshot[:, None, None], inner, predicted)
    predicted_parameter = jnp.where(overshot, goal, predicted_parameter)
    fresh = fresh | overshot
    return Trace(
        depth=jnp.where(
            fresh[:, None, None], predicted, jnp.where(running[:, None, None], depth, trace.depth)
        ),
        parameter=jnp.where(
            fresh, predicted_parameter, jnp.where(running, parameter, trace.parameter)
        ),
        last_depth=last_depth,
        last_parameter=last_parameter,
        tangent=tangent,
        tangent_parameter=tangent_parameter,
        step=step,
        corrections=jnp.where(fresh, 0, corrections),
        last_size=jnp.where(fresh, jnp.inf, newton),
        pinned=pinned,
        goal=jnp.where(fresh, goal, trace.goal),
        started=started,
        status=status,
        ticks=trace.ticks + running,
        points=points,
        first_depth=first_depth,
        first_parameter=first_parameter,
    ), Point(accepted, depth, parameter, sign * unit_parameter)
