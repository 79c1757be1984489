"""Eigenvalues of matrices without symmetry; NaN where a matrix is not finite.

Handed such a matrix, the solver of a GPU gives up every lane of its batch.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

ONE_DIRECTION = 1e-7
"""Angle (rad) below which two eigenvectors are taken as one."""
APART = 1e-8
"""Relative size of what moves the eigenvalues of those apart, by its root. Less would be better for
values and worse for derivatives, which are wrong by some 1e-4 with it."""


@jax.custom_jvp
def eigen(matrix: Float[Array, "n n"]) -> tuple[Complex[Array, " n"], Complex[Array, "n n"]]:
    """Eigenvalues and right eigenvectors; pairs with positive imaginary part first, then reals.

    Where two eigenvalues have one eigenvector (critical damping, two equal filters in a row) they
    are those of a matrix that differs by 1e-8 of its entries.
    """
    finite = jnp.all(jnp.isfinite(matrix))
    matrix = jnp.where(finite, matrix, 0.0)
    both = jnp.linalg.eig(jnp.stack([matrix, _moved(matrix)]))  # one call compiles sooner than two
    overlap = jnp.abs(both[1][0].conj().T @ both[1][0]) ** 2
    alike = jnp.triu(1 - overlap < ONE_DIRECTION**2, 1)
    values, vectors = (jnp.where(jnp.any(alike), moved, own) for own, moved in both)
    group = jnp.where(values.imag > 0, 0, jnp.where(values.imag == 0, 1, 2))
    order = jnp.lexsort((values.imag, group))
    return jnp.where(finite, values[order], jnp.nan), jnp.where(finite, vectors[:, order], jnp.nan)


def _moved(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """A matrix moved a little in all that couples its states, every entry by another share."""
    size = jnp.abs(matrix)
    share = jnp.sin(jnp.arange(1.0, matrix.size + 1) ** 2).reshape(matrix.shape)
    return matrix + APART * share * jnp.where(size > 0, size, jnp.minimum(size.T, 1.0))


@eigen.defjvp
def _eigen_jvp(primals, tangents):
    # JAX has no derivative of non-symmetric eigenvectors. Their length is free, so its change is
    # left out; distinct eigenvalues are assumed, as everywhere in modal analysis.
    (matrix,), (change,) = primals, tangents
    values, vectors = eigen(matrix)
    rotated = jnp.linalg.solve(vectors, change.astype(vectors.dtype) @ vectors)
    gaps = values[None, :] - values[:, None]
    same = gaps == 0
    mixing = jnp.where(same, 0.0, rotated / jnp.where(same, 1.0, gaps))
    return (values, vectors), (jnp.diagonal(rotated), vectors @ mixing)


def eigenvalues(matrix: Float[Array, "n n"]) -> Complex[Array, " n"]:
    """Eigenvalues in no order."""
    finite = jnp.all(jnp.isfinite(matrix))
    return jnp.where(finite, jnp.linalg.eigvals(jnp.where(finite, matrix, 0.0)), jnp.nan)
