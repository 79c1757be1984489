"""Eigenvalues of matrices without symmetry, one of which may be none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax._tools.eigenvalues import eigen, eigenvalues

MATRICES = np.stack([[[0.0, 1.0], [-4.0, -0.2]], [[-3.0, 1.0], [0.0, -1.0]]])


def test_pairs_come_first_then_reals():
    matrix = np.zeros((4, 4))
    matrix[:2, :2], matrix[2:, 2:] = MATRICES[1], MATRICES[0]
    values, vectors = eigen(jnp.asarray(matrix))
    turn = np.sqrt(4 - 0.01)
    order = [-0.1 + 1j * turn, -3, -1, -0.1 - 1j * turn]
    np.testing.assert_allclose(values, order, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(matrix @ vectors, values * vectors, atol=1e-13)
    np.testing.assert_allclose(sorted(eigenvalues(jnp.asarray(matrix)).real), [-3, -1, -0.1, -0.1])


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_who_has_none_spares_the_others(lost, monkeypatch):
    """Where a solver takes no such matrix, as that of a GPU, which gives up the whole batch."""

    def refusing(solver):
        def refuse(matrix):
            assert np.isfinite(matrix).all()

        def solve(matrix):
            jax.debug.callback(refuse, matrix)
            return solver(matrix)

        return solve

    for name in ("eig", "eigvals"):
        monkeypatch.setattr(jnp.linalg, name, refusing(getattr(jnp.linalg, name)))
    three = np.stack([MATRICES[0], np.full((2, 2), lost), MATRICES[1]])
    values, vectors = jax.vmap(eigen)(three)
    for found in (values, vectors, jax.vmap(eigenvalues)(three)):
        jax.effects_barrier()
        finite = np.isfinite(found).reshape(3, -1).all(axis=1)
        assert finite.tolist() == [True, False, True]
    np.testing.assert_allclose(values[2], [-3, -1])


@pytest.mark.parametrize(
    "matrix",
    [
        [[0.0, 1.0], [-1.0, -2.0]],  # critical damping
        [[-3.0, 0.0], [1.0, -3.0]],  # two equal filters in a row
        [[0.0, 1.0, 0.0], [-4.0, -4.0, 1.0], [0.0, 0.0, -2.0]],
        [[0.0, 1.0], [-1e8, -2e4]],
    ],
)
def test_eigenvalues_with_one_eigenvector_are_moved_apart(matrix):
    time = 1 / np.abs(matrix).max() ** 0.5
    matrix = jnp.asarray(matrix)
    expected = jax.scipy.linalg.expm(matrix * time)
    size = float(jnp.abs(expected).max())
    in_batch = [a[0] for a in jax.vmap(eigen)(matrix[None])]
    for values, vectors in (eigen(matrix), in_batch):
        found = vectors * jnp.exp(values * time) @ jnp.linalg.inv(vectors)
        np.testing.assert_allclose(found, expected, atol=1e-7 * size)
