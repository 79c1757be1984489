"""Eigenvalues of matrices without symmetry; NaN where a matrix is not finite.

Handed such a matrix, the solver of a GPU gives up every lane of its batch.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float


@jax.custom_jvp
def eigen(matrix: Float[Array, "n n"]) -> tuple[Complex[Array, " n"], Complex[Array, "n n"]]:
    """Eigenvalues and right eigenvectors; pairs with positive imaginary part first, then reals."""
    finite = jnp.all(jnp.isfinite(matrix))
    values, vectors = jnp.linalg.eig(jnp.where(finite, matrix, 0.0))
    group = jnp.where(values.imag > 0, 0, jnp.where(values.imag == 0, 1, 2))
    order = jnp.lexsort((values.imag, group))
    return jnp.where(finite, values[order], jnp.nan), jnp.where(finite, vectors[:, order], jnp.nan)


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
