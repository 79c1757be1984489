"""A guess made exact: from a sampled motion to contact times and stability."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from vibrojax._tools.types import AnyArray
from vibrojax.steady.contact_times import Events, Orbit, PiecewiseMotion, Tables, solve_orbit
from vibrojax.steady.orbit_reading import Reading, keeps_to_events, read_motion

ACCURATE = 1e-9
"""Largest relative residual of an exact motion."""
NEAR = 0.3
"""Farthest that a motion may lie from its guess, over its size: beyond, it is another one."""


class ExactPoint(NamedTuple):
    """An exact periodic motion, with its stability."""

    orbit: Orbit
    residual: Float[Array, ""]
    monodromy: Float[Array, "states states"]
    """Jacobian of the period map at the section, in units of energy."""
    multipliers: Complex[Array, " states"]
    reading: Reading
    valid: Bool[Array, ""]


class Guess(NamedTuple):
    """A sequence of events and a motion near the one wanted."""

    events: Events
    orbit: Orbit
    fits: Bool[AnyArray, ""]
    """Whether there was room for all events."""


def exact_point(tables: Tables, guess: Guess, period: int) -> tuple[ExactPoint, PiecewiseMotion]:
    """Turn a guess into an exact motion."""
    events = guess.events
    solved = solve_orbit(tables, events, guess.orbit, period)
    motion = solved.motion
    reading = read_motion(tables, events, motion, period)
    moved = (solved.orbit.state - guess.orbit.state) * tables.phases.weight
    extent = jnp.linalg.norm(guess.orbit.state * tables.phases.weight)
    whole = jnp.all(jnp.isfinite(solved.jacobian)) & jnp.isfinite(solved.residual)
    valid = (
        whole
        & (solved.residual < ACCURATE)
        & (jnp.linalg.norm(moved) <= NEAR * extent)
        & keeps_to_events(tables, reading)
        & guess.fits
    )
    matrix = jnp.where(jnp.isfinite(solved.jacobian), solved.jacobian, 0.0)
    return ExactPoint(
        orbit=solved.orbit,
        residual=solved.residual,
        monodromy=matrix,
        multipliers=jnp.linalg.eigvals(matrix),
        reading=reading,
        valid=valid,
    ), motion
