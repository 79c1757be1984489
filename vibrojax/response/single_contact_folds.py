"""Folds of the response with one contact per drive period, to round-off."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from vibrojax.drive import AbstractDrive
from vibrojax.response.single_contact import (
    check_single_stop,
    gap_ratio_and_slope,
    unit_phases,
    unit_tables,
)
from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.systems.base import LinearEquations

lax = jax.lax


class Fold(NamedTuple):
    """A fold of the response."""

    contact_fraction: Float[Array, ""]
    angular_frequency: Float[Array, ""]
    """rad/s."""
    residual: Float[Array, ""]
    """Of the gap ratio, relative, or the last step, the larger."""


def fold_of_single_contact(
    equations: LinearEquations,
    drive: AbstractDrive,
    guess: tuple[Float[Array, ""], Float[Array, ""]],
    gap_ratio: Float[Array, ""] | None = None,
    iterations: int = 10,
) -> Fold:
    """Newton's method on gap ratio and slope in contact fraction and frequency; differentiable.

    Parameters:
        equations: of one lane, with one linear stop.
        drive: of an amplitude above 0.
        guess: contact fraction and angular frequency (rad/s).
        gap_ratio: gap over drive amplitude; by default that of the system.
        iterations: steps of the method, of which the last carries the derivatives (first order).
    """
    equations = check_single_stop(equations)
    if gap_ratio is None:
        gap_ratio = jnp.asarray(equations.stops[0].gap) / jnp.asarray(drive.reference[0])
    return fold_from_phases(unit_phases(equations), drive, guess, gap_ratio, iterations)


def fold_from_phases(
    phases: ContactPhases,
    drive: AbstractDrive,
    guess: tuple[Float[Array, ""], Float[Array, ""]],
    gap_ratio: Float[Array, ""],
    iterations: int = 10,
) -> Fold:
    """Do the same with phases as of `unit_phases`."""
    place = jnp.stack([jnp.asarray(g, float) for g in guess])

    def conditions(phases, drive, gap, place):
        tables = unit_tables(phases, drive, place[1])
        value, slope, _ = gap_ratio_and_slope(tables, place[0])
        return jnp.stack([value - gap, slope])

    lanes = (phases, drive, gap_ratio)
    fixed = lax.stop_gradient(lanes)
    place = lax.stop_gradient(place)

    def jacobian(place):
        # By differences of fourth order: a further derivative takes three times as long to compile.
        width = place * jnp.array([1e-3, 3e-5])
        near = jax.vmap(lambda k: place + k * jnp.diag(width))(jnp.array([-2.0, -1.0, 1.0, 2.0]))
        values = jax.vmap(jax.vmap(lambda p: conditions(*fixed, p)))(near)
        change = jnp.einsum("k,kpc->cp", jnp.array([1.0, -8.0, 8.0, -1.0]) / 12, values)
        return change / width

    def newton(place, _):
        residual, matrix = conditions(*fixed, place), jacobian(place)
        step = jnp.linalg.solve(matrix, -residual)
        most = jnp.array([0.3, 0.03]) * place
        length = jnp.max(jnp.abs(step) / most)
        step = step / jnp.maximum(length, 1.0)
        return place + step, (matrix, jnp.max(jnp.abs(step / place)), residual[0])

    place, (matrices, steps, misses) = lax.scan(newton, place, length=iterations - 1)
    # From here on derivatives are taken: those of the solution of the conditions.
    place = place - jnp.linalg.solve(matrices[-1], conditions(*lanes, place))
    size = jnp.maximum(jnp.abs(fixed[2]), jnp.finfo(place.dtype).tiny)
    return Fold(place[0], place[1], jnp.maximum(steps[-1], jnp.abs(misses[-1]) / size))
