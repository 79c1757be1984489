"""What matrices of a structure have to be, as they are given."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from vibrojax._tools.checks import concrete
from vibrojax._tools.kinds import ARRAY
from vibrojax._tools.signatures import refuse_kind

MOST = 3000
"""Rows of a sparse matrix, up to which it is made dense: its eigenvalues take 10 s then."""

NEXT = 1e-3
"""Eigenvalue of a free body, by the lowest of its vibrations, above which it is none."""


def dense(name: str, given: Any) -> Array:
    """Return a matrix as an array. Raises `ValueError` for a large sparse one, or none."""
    if hasattr(given, "toarray"):
        if max(given.shape) > MOST:
            raise ValueError(
                f"{name} must have at most {MOST} coordinates if it is sparse, got "
                f"{max(given.shape)}. Reduce the model first, by vibrojax.model.reduce."
            )
        given = given.toarray()
    if not ARRAY.accepts(given):
        refuse_kind(name, given, ARRAY)
    return jnp.asarray(given, float)


def check_array(name: str, array: Array, shape: tuple[int, ...], meaning: str) -> None:
    """Raise `ValueError` unless an array has this shape and its numbers are finite."""
    if array.shape != shape or 0 in shape[-1:]:
        raise ValueError(
            f"{name} must be {meaning}, shape {shape}, got an array of shape {array.shape}."
        )
    values = concrete(array)
    if values is not None and not np.isfinite(values).all():
        at = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
        raise ValueError(f"{name} must be finite, got {values[at]} at index {at}.")


def check_symmetric(name: str, matrix: Array) -> None:
    """Raise `ValueError` for a concrete matrix that is not symmetric."""
    values = concrete(matrix)
    if values is None:
        return
    away = np.abs(values - values.T)
    if away.max() > float(jnp.finfo(matrix.dtype).eps) ** 0.5 * np.abs(values).max():
        i, j = sorted(int(k) for k in np.unravel_index(away.argmax(), away.shape))
        raise ValueError(
            f"{name} must be symmetric, got {values[i, j]:.6g} at index ({i}, {j}) and "
            f"{values[j, i]:.6g} at ({j}, {i})."
        )


def check_definite(name: str, matrix: Array, advice: str) -> None:
    """Raise `ValueError`, with `advice`, for a concrete matrix that is not positive definite."""
    values = concrete(matrix)
    if values is None:
        return
    diagonal = np.diagonal(values)
    if (diagonal <= 0).any():
        i = int(np.argmin(diagonal))
        found = f"{diagonal[i]:.6g} at index ({i}, {i})"
    else:
        # Scaled to a unit diagonal, so that the units of the coordinates do not matter.
        root = np.sqrt(diagonal)
        scaled = values / root[:, None] / root
        lowest = np.linalg.eigvalsh((scaled + scaled.T) / 2)[0]
        if lowest > len(root) * float(jnp.finfo(matrix.dtype).eps):
            return
        found = f"{lowest:.2g} as lowest eigenvalue (of the matrix with its diagonal scaled to 1)"
    raise ValueError(f"{name} must be positive definite, got {found}. {advice}")


def check_free_modes(mass: Array, held: Array, added: Array, free_modes: int) -> None:
    """Raise `ValueError` unless a concrete stiffness has so many eigenvalues 0.

    It is given as `held`, that is with `added` (1/s2) times the mass.
    """
    inertia, stiffness, shift = concrete(mass), concrete(held), concrete(added)
    if not free_modes or inertia is None or stiffness is None or shift is None:
        return
    from scipy.linalg import eigvalsh

    # Of the inverse, lest round-off of the highest be larger than the lowest.
    square = 1 / eigvalsh(inertia, stiffness)[::-1] - shift
    largest = abs(square[free_modes - 1])
    next_one = square[free_modes] if free_modes < len(square) else shift
    if largest >= NEXT * next_one:
        shown = ", ".join(f"{value:.3g}" for value in square[: free_modes + 1])
        raise ValueError(
            f"free_modes must be the number of motions without force, got {free_modes}, while the "
            f"lowest eigenvalues of stiffness over mass are {shown} 1/s2."
        )
