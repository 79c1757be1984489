"""Pseudo-arclength continuation of the condensed balance, many lanes at once.

Every tick factors the linearised balance of every lane once; from that one factorisation come the
Newton correction and the tangent, and each lane accepts its point, corrects on or goes back with a
shorter step by itself.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from vibrojax.response.condensed import (
    Problem,
    balance,
    differentiate,
    solve_condensed,
)

lax = jax.lax

FIRST_STEP, LONGEST_STEP, SHORTEST_STEP = 0.02, 0.08, 1e-6
"""Of the arclength: change of the motion over its size, and of the parameter over its scale."""
STRAIGHT = 0.85
"""Least cosine between tangents of neighbouring points."""
MOST_CORRECTIONS = 8
RUNNING, COMPLETED, STUCK, TURNED_BACK = 0, 1, 2, 3


class Settings(NamedTuple):
    """Numbers of the continuation; arrays, so that new ones do not compile again."""

    start: Float[Array, ""]
    end: Float[Array, ""]
    scale: Float[Array, ""]
    """Change of the parameter that counts as much as a change of the motion by its size."""
    tolerance: Float[Array, ""]
    """Relative Newton correction at which a point counts as converged."""
    longest: Float[Array, ""]


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
    started: Bool[Array, " lanes"]
    status: Int[Array, " lanes"]
    ticks: Int[Array, " lanes"]


class Point(NamedTuple):
    """What a tick reports of a lane; a point of the branch where `accepted`."""

    accepted: Bool[Array, " lanes"]
    depth: Complex[Array, "lanes stops harmonics"]
    parameter: Float[Array, " lanes"]
    tangent_parameter: Float[Array, " lanes"]
    step: Float[Array, " lanes"]


Build = Callable[..., tuple[Problem, Float[Array, ""]]]
"""From a lane and its parameter to its problem and to samples per second."""


def begin(
    depth: Complex[Array, "lanes stops harmonics"],
    parameter: Float[Array, ""],
    status: Int[Array, " lanes"] | None = None,
) -> Trace:
    """Start every lane from a first guess of its motion at the start of the range."""
    lanes = depth.shape[0]
    zero, off = jnp.zeros(lanes), jnp.zeros(lanes, bool)
    count = jnp.zeros(lanes, jnp.int32)
    at = jnp.full(lanes, parameter)
    return Trace(
        depth=depth,
        parameter=at,
        last_depth=depth,
        last_parameter=at,
        tangent=jnp.zeros_like(depth),
        tangent_parameter=zero,
        step=jnp.full(lanes, FIRST_STEP),
        corrections=count,
        last_size=zero + jnp.inf,
        pinned=~off,
        started=off,
        status=count if status is None else status,
        ticks=count,
    )


def dot(a: Complex[Array, "*sides"], b: Complex[Array, "*sides"]) -> Float[Array, "..."]:
    """Mean over time of the product of two motions given by spectra (up to a constant)."""
    product = (a * jnp.conj(b)).real
    return 2 * jnp.sum(product, axis=(-2, -1)) - jnp.sum(product[..., 0], axis=-1)


def capacities(unknowns: int) -> tuple[int, ...]:
    """Sizes of the linear systems that are compiled; the smallest that holds all lanes is used."""
    sizes = [unknowns // 8, unknowns // 4, 3 * unknowns // 8, unknowns // 2, unknowns]
    return tuple(sorted({max(4, size) for size in sizes}))


def follow(
    build: Build,
    lanes: object,
    settings: Settings,
    trace: Trace,
    *,
    samples: int,
    ticks: int,
) -> tuple[Trace, Point]:
    """Run some ticks of all lanes; points are stacked along a leading axis of ticks."""
    sizes = capacities(trace.depth.shape[1] * samples)

    def linearise(lane, depth, parameter):
        def residual(p):
            problem, per_second = build(lane, p)
            at = balance(problem, depth, per_second, samples)
            return at.residual, (at, problem)

        value, slope, (at, problem) = jax.jvp(
            residual, (parameter,), (jnp.ones_like(parameter),), has_aux=True
        )
        return problem, at, -jnp.stack([value, slope])

    def tick(trace: Trace, _):
        problem, at, right = jax.vmap(linearise)(lanes, trace.depth, trace.parameter)
        running = trace.status == RUNNING
        touching = (at.stiffness != 0) | (at.damping != 0)
        needed = jnp.max(jnp.where(running, jnp.sum(touching, axis=(1, 2)), 0))
        solvers = [
            jax.vmap(lambda p, a, r, size=size: solve_condensed(p, a, r, samples, size))
            for size in sizes
        ]
        level = jnp.searchsorted(jnp.asarray(sizes), needed)
        both = lax.switch(jnp.minimum(level, len(sizes) - 1), solvers, problem, at, right)
        return _advance(trace, both[:, 0], both[:, 1], settings, running)

    return lax.scan(tick, trace, None, length=ticks)


def _advance(trace: Trace, correction, direction, settings: Settings, running):
    """Take the Newton step of every lane, and accept, correct on or go back."""
    size = jnp.sqrt(dot(trace.last_depth, trace.last_depth))
    along = (1 / size**2)[:, None, None]
    scale = settings.scale
    # Offset from the plane through the predicted point, across the tangent.
    moved = dot(trace.tangent, trace.depth - trace.last_depth) / size**2
    moved_parameter = trace.tangent_parameter * (trace.parameter - trace.last_parameter)
    offset = moved + moved_parameter / scale**2 - trace.step
    slope = dot(trace.tangent, direction) / size**2 + trace.tangent_parameter / scale**2
    shift = -(offset + dot(trace.tangent, correction) / size**2) / jnp.where(slope == 0, 1.0, slope)
    target = jnp.where(trace.started, settings.end, settings.start)
    shift = jnp.where(trace.pinned, target - trace.parameter, shift)
    change = correction + direction * shift[:, None, None]
    depth, parameter = trace.depth + change, trace.parameter + shift
    newton = jnp.sqrt(dot(change, change) / size**2 + (shift / scale) ** 2)
    corrections = trace.corrections + 1
    good = jnp.isfinite(newton)
    converged = good & (newton < settings.tolerance)

    length = jnp.sqrt(dot(direction, direction) / size**2 + 1 / scale**2)
    unit, unit_parameter = direction / length[:, None, None], 1 / length
    cosine = dot(trace.tangent, unit) / size**2 + trace.tangent_parameter * unit_parameter / scale**2
    forward = jnp.sign(settings.end - settings.start)
    sign = jnp.where(trace.started, jnp.where(cosine < 0, -1.0, 1.0), forward)
    straight = ~trace.started | (jnp.abs(cosine) > STRAIGHT)
    gone = jnp.sqrt(
        dot(depth - trace.last_depth, depth - trace.last_depth) / size**2
        + ((parameter - trace.last_parameter) / scale) ** 2
    )
    near = ~trace.started | (gone < 2.5 * trace.step + 1e-9)
    accepted = running & converged & straight & near
    # A correction that grows, or too many of them: go back and take a shorter step.
    hopeless = (corrections >= MOST_CORRECTIONS) | (
        (newton > 2 * trace.last_size) & (corrections > 2)
    )
    patience = jnp.where(trace.started, 1, 5)
    failed = running & ~accepted & (
        converged | ~good | (hopeless & (corrections >= patience * MOST_CORRECTIONS)) |
        (hopeless & trace.started)
    )
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
    status = jnp.where(accepted & trace.pinned & trace.started, COMPLETED, trace.status)
    status = jnp.where(retry & (step < SHORTEST_STEP), STUCK, status)
    status = jnp.where(failed & ~trace.started, STUCK, status)
    started = trace.started | accepted
    # The next try: predict along the tangent, and stop at the ends of the range.
    fresh = accepted | retry
    ahead = last_parameter + step * tangent_parameter
    beyond = (ahead - settings.end) * forward >= 0
    back = (ahead - settings.start) * forward < 0
    status = jnp.where(accepted & back & (tangent_parameter * forward < 0), TURNED_BACK, status)
    reach = (settings.end - last_parameter) / jnp.where(tangent_parameter == 0, 1.0, tangent_parameter)
    stride = jnp.where(beyond, reach, step)
    new_size = jnp.sqrt(dot(last_depth, last_depth))
    unit_now = tangent  # of unit length in the size of the point it was made at
    predicted = last_depth + stride[:, None, None] * unit_now
    pinned = jnp.where(fresh, beyond, trace.pinned & ~accepted)
    predicted_parameter = jnp.where(beyond, settings.end, ahead)
    del new_size, along
    trace_next = Trace(
        depth=jnp.where(
            fresh[:, None, None], predicted, jnp.where(running[:, None, None], depth, trace.depth)
        ),
        parameter=jnp.where(fresh, predicted_parameter, jnp.where(running, parameter, trace.parameter)),
        last_depth=last_depth,
        last_parameter=last_parameter,
        tangent=tangent,
        tangent_parameter=tangent_parameter,
        step=step,
        corrections=jnp.where(fresh, 0, corrections),
        last_size=jnp.where(fresh, jnp.inf, newton),
        pinned=pinned,
        started=started,
        status=status,
        ticks=trace.ticks + running,
    )
    return trace_next, Point(accepted, depth, parameter, sign * unit_parameter, gone)
