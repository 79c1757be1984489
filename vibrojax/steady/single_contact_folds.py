"""Folds of the response with one contact per drive period, to round-off."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import LinearEquations
from vibrojax.steady.single_contact import (
    check_single_stop,
    gap_ratio_and_slope,
    unit_phases,
    unit_tables,
)

lax = jax.lax
AnyArray = np.ndarray | Array


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
    guess: tuple[Float[ArrayLike, ""], Float[ArrayLike, ""]],
    gap_ratio: Float[ArrayLike, ""] | None = None,
    iterations: int = 9,
) -> Fold:
    """Newton's method on gap ratio and slope in contact fraction and frequency; differentiable.

    Parameters:
        equations: of one lane, with one linear stop.
        drive: of an amplitude above 0.
        guess: contact fraction and angular frequency (rad/s).
        gap_ratio: gap over drive amplitude; by default that of the system.
        iterations: steps of the method; one more carries the derivatives (of first order).

    Raises `ValueError` for a system whose motions with one contact have no closed form.
    """
    equations = check_single_stop(equations)
    if gap_ratio is None:
        gap_ratio = jnp.asarray(equations.stops[0].gap) / jnp.asarray(drive.reference[0])
    lanes = (unit_phases(equations), drive, jnp.asarray(gap_ratio))
    fixed = lax.stop_gradient(lanes)
    start = lax.stop_gradient(jnp.stack([jnp.asarray(g, float) for g in guess]))

    def conditions(phases, drive, gap_ratio, place):
        tables = unit_tables(phases, drive, place[1])
        value, slope, _ = gap_ratio_and_slope(tables, place[0])
        return jnp.stack([value - gap_ratio, slope])

    def newton(place, _):
        near = places_around(place)
        flat = jax.vmap(lambda p: conditions(*fixed, p))(near.reshape(-1, 2))
        step, matrix = newton_step(place, flat.reshape(near.shape))
        return place + step, (matrix, jnp.max(jnp.abs(step / place)), flat[0, 0])

    place, (matrices, moves, misses) = lax.scan(newton, start, length=iterations)
    place = place - jnp.linalg.solve(matrices[-1], conditions(*lanes, place))
    size = jnp.maximum(jnp.abs(fixed[2]), jnp.finfo(place.dtype).tiny)
    return Fold(place[0], place[1], jnp.maximum(moves[-1], jnp.abs(misses[-1]) / size))


# Derivatives by differences of fourth order, in the same batch as the residual: a further
# derivative would take three times as long to compile.
STEPS = np.array([0.0, -2.0, -1.0, 1.0, 2.0])
WEIGHTS = np.array([0.0, 1.0, -8.0, 8.0, -1.0]) / 12
WIDTH = np.array([2e-4, 1e-5])
"""Relative steps in contact fraction and frequency."""


def places_around(place: Float[AnyArray, "*many 2"]) -> Float[AnyArray, "5 2 *many 2"]:
    """Places (contact fraction, frequency) at which `newton_step` wants the conditions."""
    steps = (STEPS[:, None, None] * np.diag(WIDTH)).reshape(5, 2, *[1] * (place.ndim - 1), 2)
    return place * (1 + steps)


def newton_step(
    place: Float[AnyArray, "*many 2"], values: Float[AnyArray, "5 2 *many 2"]
) -> tuple[Float[Array, "*many 2"], Float[Array, "*many 2 2"]]:
    """Return the step, and the Jacobian, from the conditions at `places_around`."""
    matrix = jnp.einsum("k,kp...c->...cp", WEIGHTS, values) / (place * WIDTH)[..., None, :]
    step = jnp.linalg.solve(matrix, -values[0, 0][..., None])[..., 0]
    # Where the surface bends the other way a step can lead far off.
    most = place * np.array([0.3, 0.03])
    length = jnp.max(jnp.abs(step) / most, axis=-1, keepdims=True)
    return step / jnp.maximum(length, 1.0), matrix
