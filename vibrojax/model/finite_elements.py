"""Large sparse matrices of a finite-element model, with the labels of their coordinates."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from vibrojax._tools.checks import check_range
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated

if TYPE_CHECKING:
    from scipy.sparse import csc_array

Vector = Float[np.ndarray, " coordinates"]
SYMMETRIC = 1e-8
"""Difference over the largest entry, up to which a matrix is symmetric: files keep few digits."""


@final
@validated
class FiniteElements:
    """Mass, damping and stiffness matrix of a finite-element model: M x'' + C x' + K x = f.

    `vibrojax.io.read_matrices` reads one from files; `vibrojax.model.reduce` makes of it what a
    stop can be put on. Nothing here is swept or differentiated.

    Parameters:
        mass: M, shape (n, n), symmetric, sparse of scipy or an array, kg. Every node must have
            some; a rotation may have none.
        stiffness: K, shape (n, n), symmetric, with the supports held, N/m.
        damping: C, shape (n, n), symmetric, N s/m; None for none.
        degrees_of_freedom: node and degree of freedom of every coordinate, shape (n, 2), whole
            numbers as in the finite-element program: 1 to 3 are displacements along x, y, z, 4 to 6
            rotations. Where nothing is given coordinate k is node k + 1, degree of freedom 1.

    Raises `ValueError` for matrices that are not square, not of one shape, not finite, not
    symmetric, whose diagonal is negative (or 0, for the stiffness), a node without mass, or labels
    that are not n different pairs.
    """

    mass: "csc_array"
    stiffness: "csc_array"
    damping: "csc_array | None"
    degrees_of_freedom: Int[np.ndarray, "coordinates 2"]
    _base_loads: Float[np.ndarray, "coordinates 3"]

    def __init__(
        self,
        *,
        mass: Any,
        stiffness: Any,
        damping: Any = None,
        degrees_of_freedom: ArrayLike | Sequence[Any] | None = None,
    ) -> None:
        first = _sparse("stiffness", stiffness, None)
        n = first.shape[0]
        self.stiffness = first
        self.mass = _sparse("mass", mass, n)
        self.damping = None if damping is None else _sparse("damping", damping, n)
        if degrees_of_freedom is None:
            labels = np.stack([np.arange(1, n + 1), np.ones(n, int)], axis=1)
        else:
            labels = np.asarray(degrees_of_freedom).astype(int)
        if labels.shape != (n, 2) or len(np.unique(labels, axis=0)) < n:
            raise ValueError(
                f"degrees_of_freedom must be {n} different pairs (node, degree of freedom), shape "
                f"({n}, 2), got an array of shape {labels.shape}."
            )
        self.degrees_of_freedom = labels
        self._check_diagonals()
        self._base_loads = self.mass @ (labels[:, 1:] == [1, 2, 3]).astype(float)

    def _check_diagonals(self) -> None:
        mass, stiffness = self.mass.diagonal(), self.stiffness.diagonal()
        for name, diagonal, bad in (
            ("mass", mass, mass < 0),
            ("stiffness", stiffness, stiffness <= 0),
        ):
            if bad.any():
                k = int(np.argmax(bad))
                raise ValueError(
                    f"{name} must be positive on its diagonal, got {diagonal[k]:.6g} at "
                    f"{self._label(k)}. Hold, or leave out, what moves without force."
                )
        nodes, inverse = np.unique(self.degrees_of_freedom[:, 0], return_inverse=True)
        heavy = np.bincount(inverse, mass) > 0
        if not heavy.all():
            raise ValueError(
                f"mass must be above 0 at every node, got none at node {nodes[~heavy][0]}. "
                "Give the node a mass, or condense it."
            )

    def _label(self, k: int) -> str:
        node, dof = self.degrees_of_freedom[k]
        return f"node {node}, degree of freedom {dof}"

    def row(self, *, node: int, dof: int = 1) -> Vector:
        """Return the row that reads one displacement: for a `stop_map` or a `response_map`.

        It has a 1 at degree of freedom `dof` of node `node`, shape (n,); rows may be added and
        scaled, for the mean of two nodes, say. As an `input_map` it is a force of 1 N there. Raises
        `ValueError` where the model has no such degree of freedom.
        """
        found = np.all(self.degrees_of_freedom == (node, dof), axis=1)
        if not found.any():
            at = self.degrees_of_freedom[self.degrees_of_freedom[:, 0] == node, 1]
            known = f"Node {node} has {', '.join(map(str, at))}" if at.size else "No such node"
            raise ValueError(
                f"node {node} must have a degree of freedom {dof} among the {len(found)} of the "
                f"model, got none. {known}."
            )
        return found.astype(float)

    def base_load(self, *, dof: int) -> Vector:
        """Return M times the influence vector: the `input_map` of a base that moves along `dof`.

        All supports move by the same displacement in direction `dof`, 1 to 3; shape (n,), kg. Hold
        them by `held`: the mass that couples them to their neighbours counts, and files without
        supports have lost it. Raises `ValueError` for another direction, or where nothing moves.
        """
        check_range("dof", dof, 1.0, 3.0, allowed="1, 2 or 3 (along x, y or z)")
        if not (self.degrees_of_freedom[:, 1] == dof).any():
            raise ValueError(f"dof must be a direction in which a node moves, got {dof}.")
        return self._base_loads[:, dof - 1]

    def held(self, *, nodes: ArrayLike | Sequence[int]) -> "FiniteElements":
        """Return the model with all degrees of freedom of some nodes held, and so left out.

        `nodes` is a list of node numbers. Raises `ValueError` for one that is not of the model.
        """
        wanted = np.atleast_1d(np.asarray(nodes))
        missing = np.setdiff1d(wanted, self.degrees_of_freedom[:, 0])
        if missing.size:
            raise ValueError(f"nodes must be of the model, got {missing[0]}, which it has not.")
        kept = np.flatnonzero(~np.isin(self.degrees_of_freedom[:, 0], wanted))

        def part(matrix: Any) -> Any:
            return None if matrix is None else matrix[kept][:, kept]

        model = FiniteElements(
            mass=part(self.mass),
            stiffness=part(self.stiffness),
            damping=part(self.damping),
            degrees_of_freedom=self.degrees_of_freedom[kept],
        )
        model._base_loads = self._base_loads[kept]
        return model

    def __repr__(self) -> str:
        nodes = len(np.unique(self.degrees_of_freedom[:, 0]))
        damped = "without damping" if self.damping is None else "with damping"
        return (
            f"FiniteElements({len(self.degrees_of_freedom)} degrees of freedom at {nodes} nodes, "
            f"{self.stiffness.nnz} entries of the stiffness, {damped})"
        )


def _sparse(name: str, given: Any, size: int | None) -> Any:
    """Return a matrix as `csc_array`. Raises `ValueError` unless it is symmetric and finite."""
    from scipy import sparse

    try:
        matrix: Any = sparse.csc_array(given, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be a sparse matrix of scipy or an array, got {in_short(given)}."
        ) from None
    n = matrix.shape[0] if size is None else size
    if matrix.shape != (n, n) or n == 0:
        like = "a square matrix" if size is None else "of the shape of stiffness"
        raise ValueError(f"{name} must be {like}, shape ({n}, {n}), got {matrix.shape}.")
    if not np.isfinite(matrix.data).all():
        raise ValueError(f"{name} must be finite, got {matrix.data[~np.isfinite(matrix.data)][0]}.")
    away = abs(matrix - matrix.T).tocoo()
    if away.nnz and away.data.max() > SYMMETRIC * abs(matrix).max():
        k = int(away.data.argmax())
        i, j = sorted((int(away.coords[0][k]), int(away.coords[1][k])))
        raise ValueError(
            f"{name} must be symmetric, got {matrix[i, j]:.6g} at index ({i}, {j}) and "
            f"{matrix[j, i]:.6g} at ({j}, {i})."
        )
    return matrix
