"""A guess made exact: from a sampled motion to contact times and stability."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from vibrojax._tools.types import AnyArray
from vibrojax.steady.contact_times import Events, Orbit, PiecewiseMotion, Tables, solve_orbit
from vibrojax.steady.orbit_reading import Reading, find_crossings, keeps_to_events, read_motion
from vibrojax.steady.paths import AbstractPath
from vibrojax.steady.starting import sampled_motion
from vibrojax.stepping.measures import MOST_EVENTS

ACCURATE = 1e-9
"""Largest relative residual of an exact motion."""
NEAR = 0.3
"""Farthest that a motion may lie from its guess, over its size: beyond, it is another one."""


class ExactPoint(NamedTuple):
    """An exact periodic motion, with its stability."""

    events: Events
    orbit: Orbit
    matrix: Float[Array, "states states"]
    """Jacobian of the period map at the section, in (q, q')."""
    multipliers: Complex[Array, " states"]
    residual: Float[Array, ""]
    valid: Bool[Array, ""]


class Guess(NamedTuple):
    """A sequence of events and a motion near the one wanted."""

    events: Events
    orbit: Orbit
    fits: Bool[AnyArray, ""]
    """Whether there was room for all events."""


def sampled_guess(
    path: AbstractPath, value: Float[Array, ""], state: Float[Array, " states"], period: int
) -> Guess:
    """Read a guess off the march over a period from a state at drive phase 0."""
    depth, change, states = sampled_motion(path, value, state, period, exact=True)
    found = find_crossings(depth, change, MOST_EVENTS, period)
    # The section is moved to the nearest sample, whose state is known.
    angle = 2 * np.pi * period * jnp.arange(states.shape[0]) / states.shape[0]
    nearest = jnp.argmin(jnp.abs(angle - found.events.section))
    events = found.events._replace(section=angle[nearest])
    return Guess(events, Orbit(states[nearest], found.times), found.number <= MOST_EVENTS)


def exact_point(
    tables: Tables, guess: Guess, period: int
) -> tuple[ExactPoint, Reading, PiecewiseMotion]:
    """Turn a guess into an exact motion."""
    events, weight = guess.events, tables.phases.weight
    solved = solve_orbit(tables, events, guess.orbit, period)
    motion = solved.motion
    reading = read_motion(tables, events, motion, period)
    moved = (solved.orbit.state - guess.orbit.state) * weight
    extent = jnp.linalg.norm(guess.orbit.state * weight)
    whole = jnp.all(jnp.isfinite(solved.jacobian)) & jnp.isfinite(solved.residual)
    valid = (
        whole
        & (solved.residual < ACCURATE)
        & (jnp.linalg.norm(moved) <= NEAR * extent)
        & keeps_to_events(tables, reading)
        & guess.fits
    )
    matrix = jnp.where(jnp.isfinite(solved.jacobian), solved.jacobian, 0.0)
    point = ExactPoint(
        events=events,
        orbit=solved.orbit,
        matrix=matrix * weight / weight[:, None],
        multipliers=jnp.linalg.eigvals(matrix),
        residual=solved.residual,
        valid=valid,
    )
    return point, reading, motion
