"""A body given by its matrices, from a finite-element program say, that hits stops."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_count, concrete
from vibrojax._tools.described import shown_value
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive, NoDrive
from vibrojax.model.equations import LinearEquations
from vibrojax.model.matrix_checks import (
    check_array,
    check_definite,
    check_free_modes,
    check_symmetric,
    dense,
)
from vibrojax.model.residual_shapes import residual_modes
from vibrojax.model.states import Displacement, check_coordinates
from vibrojax.model.stop_forces import contact_slope
from vibrojax.model.stops import Stop, as_stops
from vibrojax.model.systems import (
    AbstractSystem,
    check_without_places,
)

if TYPE_CHECKING:
    from scipy.sparse import sparray, spmatrix

    SparseMatrix = sparray | spmatrix

Matrix = ArrayLike | Sequence[Any]


class MatrixModes(NamedTuple):
    """Undamped modes of a `MatrixSystem`, lowest first."""

    angular_frequency: Float[Array, " modes"]
    """rad/s."""
    shapes: Float[Array, "coordinates modes"]
    """One mode per column, each of modal mass 1 kg: displacements are shapes @ q."""

    def __repr__(self) -> str:
        frequencies = shown_value(self.angular_frequency, "rad/s", exact=False)
        return f"MatrixModes(angular_frequency={frequencies}, shapes {np.shape(self.shapes)})"


@validated
class MatrixSystem(AbstractSystem):
    """M x'' + C x' + K x = b a(t) - sum over stops r_s F_s, reduced to its undamped modes.

    The damping need not be proportional. Every number is a leaf: it can be swept, batched and
    differentiated (derivatives with respect to the matrices need natural frequencies that differ).
    There are n coordinates; units below are those of displacements, rotations have theirs.

    Parameters:
        mass: M, shape (n, n), symmetric and positive definite, kg. Each matrix may be a sparse one
            of scipy; large ones are reduced first (`vibrojax.model.reduce`).
        damping: C, shape (n, n), symmetric, N s/m.
        stiffness: K, shape (n, n), symmetric and positive definite, N/m.
        stops: one or several `Stop`, with position None: stop_map places them.
        stop_map: displacement of each contact point towards its stop, by coordinate, shape
            (stops, n); the force acts back along the same row. The row of a stop with side = -1
            is taken with its sign changed, as for a beam: two stops facing each other have the
            same row and opposite sides.
        drive: `BaseMotion`, `PointForce` (its position is not used) or `NoDrive`.
        input_map: generalised force of a unit input, shape (n,): where 1 N acts for a
            `PointForce`, M times the influence vector for a `BaseMotion` (displacements being
            relative to the base).
        response_map: displacement that a frequency response reports, by coordinate, shape (n,).
        num_modes: how many modes are kept; None keeps all n.
        load: forces that stay the same, by coordinate, shape (n,), N: gravity, a preload.
        free_modes: how many modes are motions of a free body, which nothing holds: K has as many
            eigenvalues 0. Histories of free bodies are exact; steady motions hold them by a spring
            so soft that they are wrong by some 1e-6.
        static_correction: whether one shape more for each stop makes the static flexibility there
            exact: modes left out act as a spring in series with a stop (see
            `vibrojax.model.residual_shapes`).
        proportional: whether the damping couples no modes, so that only the diagonal of the modal
            damping matrix is kept, also in derivatives. By default True where the matrices are
            concrete and say so, else False. Give False when other matrices, or numbers to
            differentiate by, are put in the place of these (`equinox.tree_at`).

    Raises `ValueError` for matrices and maps of the wrong shape, that are not finite, not symmetric
    or not positive definite, a missing stop_map or input_map, a stop with a position, stops and
    drive that are none, num_modes outside 1 to n, free_modes that are not the number of
    eigenvalues 0, or proportional=True for damping that couples
    modes. Damping that turns out to couple them only when the equations are computed raises a
    `RuntimeError` there.
    """

    mass: Float[Array, "coordinates coordinates"] = eqx.field(metadata={"units": "kg"})
    damping: Float[Array, "coordinates coordinates"] = eqx.field(metadata={"units": "N s/m"})
    stiffness: Float[Array, "coordinates coordinates"] = eqx.field(metadata={"units": "N/m"})
    stops: tuple[Stop, ...]
    stop_map: Float[Array, "stops coordinates"]
    drive: AbstractDrive
    input_map: Float[Array, " coordinates"]
    response_map: Float[Array, " coordinates"]
    load: Float[Array, " coordinates"] | None
    free_modes: int = eqx.field(static=True)
    num_modes: int | None = eqx.field(static=True)
    static_correction: bool = eqx.field(static=True)
    proportional: bool = eqx.field(static=True)

    def __init__(
        self,
        mass: "Matrix | SparseMatrix",
        damping: "Matrix | SparseMatrix",
        stiffness: "Matrix | SparseMatrix",
        *,
        response_map: Matrix,
        stops: Stop | tuple[Stop, ...] | list[Stop] = (),
        stop_map: Matrix | None = None,
        drive: AbstractDrive | None = None,
        input_map: Matrix | None = None,
        load: Matrix | None = None,
        free_modes: int = 0,
        num_modes: int | None = None,
        static_correction: bool = False,
        proportional: bool | None = None,
    ) -> None:
        self.stops = as_stops(stops)
        self.drive = NoDrive() if drive is None else drive
        check_without_places("a MatrixSystem", self.stops, "Its row of stop_map says where it is.")
        self.mass = dense("mass", mass)
        n = self.mass.shape[0] if self.mass.ndim else 0
        check_array("mass", self.mass, (n, n), "a square matrix")
        self.damping = dense("damping", damping)
        self.stiffness = dense("stiffness", stiffness)
        for name in ("damping", "stiffness"):
            check_array(name, getattr(self, name), (n, n), "of the shape of mass")
        for name in ("mass", "damping", "stiffness"):
            check_symmetric(name, getattr(self, name))
        check_definite("mass", self.mass, "Condense coordinates without mass.")
        check_count("free_modes", free_modes, least=0, most=n)
        self.free_modes = free_modes
        advice = "Hold the body, or say by free_modes in how many ways it moves without force."
        held, added = self._held()
        check_definite("stiffness", held, advice)
        check_free_modes(self.mass, held, added, free_modes)

        self.response_map = jnp.asarray(response_map, float)
        check_array("response_map", self.response_map, (n,), "one number per coordinate")
        if stop_map is None and self.stops:
            raise ValueError(
                f"stop_map must be given with stops: shape ({len(self.stops)}, {n}), the "
                "displacement of each contact point towards its stop by coordinate."
            )
        self.stop_map = jnp.asarray(jnp.zeros((0, n)) if stop_map is None else stop_map, float)
        check_array(
            "stop_map", self.stop_map, (len(self.stops), n), "one row per stop, by coordinate"
        )
        if input_map is None and not isinstance(self.drive, NoDrive):
            raise ValueError(
                f"input_map must be given with a drive: shape ({n},), the generalised force of a "
                "unit input. It is M times the influence vector for a BaseMotion."
            )
        self.input_map = jnp.asarray(jnp.zeros(n) if input_map is None else input_map, float)
        check_array("input_map", self.input_map, (n,), "one number per coordinate")
        self.load = None if load is None else jnp.asarray(load, float)
        if self.load is not None:
            check_array("load", self.load, (n,), "one number per coordinate")
        if free_modes and static_correction:
            raise ValueError("static_correction must be False for a free body, got True.")
        if num_modes is not None:
            check_count("num_modes", num_modes, most=1000)
            if num_modes > n:
                raise ValueError(
                    f"num_modes must be at most {n}, the number of coordinates, got {num_modes}."
                )
        self.num_modes = num_modes
        self.static_correction = static_correction
        self.proportional = self._decide(proportional)

    def _decide(self, proportional: bool | None) -> bool:
        """Say whether only the diagonal of the modal damping is kept, from concrete matrices."""
        if proportional is False:
            return False
        matrices = [concrete(a) for a in (self.mass, self.damping, self._held()[0])]
        if any(matrix is None for matrix in matrices):
            return bool(proportional)
        mass, damping, stiffness = matrices
        if self._is_corrected:
            kept = concrete(self.modes().shapes)
            if kept is None:
                return bool(proportional)
        else:
            from scipy.linalg import eigh

            _, vectors = eigh(mass, stiffness)
            kept = vectors[:, ::-1][:, : self.num_modes]
            kept = kept / np.sqrt(np.einsum("ik,ij,jk->k", kept, mass, kept))
        modal = kept.T @ damping @ kept
        couples = _coupling(np, modal) > _negligible(self.mass)
        if proportional and couples:
            raise ValueError(
                "proportional must be False for damping that couples the modes, got True. Leave "
                "it out to have it decided (proportional=None in dataclasses.replace)."
            )
        return not couples

    def _held(self) -> tuple[Float[Array, "coordinates coordinates"], Float[Array, ""]]:
        """Stiffness that is definite, and the eigenvalue (1/s2) that was added to that end."""
        if not self.free_modes:
            return self.stiffness, jnp.zeros(())
        scale = jnp.trace(self.stiffness) / jnp.trace(self.mass)
        added = lax.stop_gradient(jnp.where(scale > 0, 1e-4 * scale, 1.0))
        return self.stiffness + added * self.mass, added

    @property
    def _is_corrected(self) -> bool:
        fewer = self.num_modes is not None and self.num_modes < self.mass.shape[0]
        return self.static_correction and bool(self.stops) and fewer

    def with_fixed_structure(self) -> "MatrixSystem":
        """Return the system with damping that may couple modes, whatever its numbers are."""
        return replace(self, proportional=False)

    def with_stops(
        self, stops: tuple[Stop, ...], stop_map: Float[Array, "stops coordinates"] | None = None
    ) -> "MatrixSystem":
        """Return the system with further `stops`; `stop_map` has their rows, shape (stops, n).

        Raises `ValueError` without them, or for another shape.
        """
        if stop_map is None or jnp.shape(stop_map) != (len(stops), self.mass.shape[0]):
            raise ValueError(
                f"A MatrixSystem of {self.mass.shape[0]} coordinates needs first_map (or "
                f"second_map) of shape ({len(stops)}, {self.mass.shape[0]}): the displacement of "
                f"each contact point by coordinate, got "
                f"{'none' if stop_map is None else f'shape {jnp.shape(stop_map)}'}."
            )
        rows = jnp.concatenate([self.stop_map, stop_map])
        return replace(self, stops=(*self.stops, *stops), stop_map=rows)

    def modes(self) -> MatrixModes:
        """Return the undamped modes that the model is reduced to.

        The entry that comes first among the large ones of a shape is positive. With
        `static_correction` those of the residual shapes at the stops come behind them.
        """
        # The factor of K rather than that of M: so the lowest modes are the accurate ones, by a
        # factor of 100 in frequency for 50 beam elements, more for finer meshes.
        stiffness, added = self._held()
        lower = jnp.linalg.cholesky(stiffness)
        half = solve_triangular(lower, self.mass, lower=True)
        flexibility, vectors = jnp.linalg.eigh(solve_triangular(lower, half.T, lower=True))
        flexibility = flexibility[::-1][: self.num_modes]
        vectors = vectors[:, ::-1][:, : self.num_modes]
        shapes = solve_triangular(lower.T, vectors, lower=False) / jnp.sqrt(flexibility)
        size = jnp.abs(shapes)
        # Not the largest entry: symmetric bodies have several, of opposite signs.
        first = jnp.argmax(size > 0.3 * jnp.max(size, axis=0), axis=0)
        sign = jnp.sign(jnp.take_along_axis(shapes, first[None], axis=0))
        square = 1 / flexibility - added
        if free := min(self.free_modes, len(square)):
            square = jnp.maximum(square.at[:free].set(0.0), 0.0)
        frequency = jnp.concatenate([square[:free], jnp.sqrt(square[free:])])
        # Modes of mass 1 of the held body are those of the free one.
        kept = MatrixModes(frequency, shapes * sign)
        if not self._is_corrected:
            return kept
        half = solve_triangular(lower, self.stop_map.T, lower=True)
        static = solve_triangular(lower.T, half, lower=False)
        rest = static - shapes @ (flexibility[:, None] * (self.stop_map @ shapes).T)
        frequency, shares = residual_modes(
            self.stop_map @ rest,
            rest.T @ self.mass @ rest,
            jnp.sum(half**2, axis=0),
            kept.angular_frequency[-1],
        )
        return MatrixModes(
            jnp.concatenate([kept.angular_frequency, frequency]),
            jnp.concatenate([kept.shapes, rest @ shares], axis=1),
        )

    def flexibility_left_out(self) -> list[float] | None:
        """Static flexibility at each stop that the modes kept lack, m/N; None of a free body."""
        if self.free_modes:
            return None
        frequency, shapes = self.modes()
        static = jnp.linalg.solve(self.stiffness, self.stop_map.T)
        kept = jnp.sum((self.stop_map @ shapes / frequency) ** 2, axis=1)
        return [float(f) for f in jnp.sum(self.stop_map.T * static, axis=0) - kept]

    def modal_coordinates(self, displacement: Displacement) -> Float[Array, " modes"]:
        """Return q of displacements x (or velocities) of shape (n,); x = modes().shapes @ q.

        What the modes kept cannot represent is left out (as seen by the mass matrix).

        `displacement` are x, or x'. Raises `ValueError` for another shape.
        """
        meaning = "one number per coordinate"
        x = check_coordinates("displacement", displacement, self.mass.shape[0], meaning)
        return self.modes().shapes.T @ (self.mass @ x)

    def equations(self) -> LinearEquations:
        """Reduce the matrices to modes of modal mass 1 kg and place stops and drive on them.

        Raises `RuntimeError` when the damping couples modes though the system is `proportional`.
        """
        frequency, shapes = self.modes()
        if self.free_modes:
            frequency = self._with_unit(frequency, shapes)
        modal = shapes.T @ self.damping @ shapes
        diagonal = jnp.diagonal(modal)
        coupling = None
        if self.proportional:
            # The matrices may have been replaced since; looser than `_decide` for round-off.
            diagonal = eqx.error_if(
                diagonal,
                _coupling(jnp, lax.stop_gradient(modal)) > 10 * _negligible(modal),
                "The damping couples the modes, which that of the matrices at construction did "
                "not. Make the MatrixSystem anew, or with proportional=False.",
            )
        else:
            coupling = modal - jnp.diag(diagonal)
        towards = jnp.asarray([float(stop.side) for stop in self.stops])
        stop_map = towards[:, None] * (self.stop_map @ shapes)
        sign = jnp.where(np.arange(len(frequency)) < self.free_modes, 0.0, 1.0)
        return LinearEquations(
            stops=self.stops,
            angular_frequency=frequency,
            damping_ratio=diagonal / (2 * frequency),
            input_map=shapes.T @ self.input_map,
            stop_map=stop_map,
            force_map=stop_map.T,
            response_map=self.response_map @ shapes,
            modal_mass=jnp.ones_like(frequency),
            damping_coupling=coupling,
            stiffness_sign=sign if self.free_modes else None,
            free=self.free_modes > 0,
            load=None if self.load is None else shapes.T @ self.load,
        )

    def _with_unit(self, frequency: Array, shapes: Array) -> Float[Array, " modes"]:
        """Give free modes a frequency to count time in: that of the next mode, or of contact."""
        if len(frequency) > self.free_modes:
            unit = frequency[self.free_modes]
        else:
            square = [
                contact_slope(stop) * jnp.sum((row @ shapes) ** 2)
                for stop, row in zip(self.stops, self.stop_map, strict=True)
            ]
            hardest = jnp.max(jnp.stack(square)) if square else jnp.zeros(())
            unit = jnp.sqrt(jnp.where(hardest > 0, hardest, 1.0))
        return frequency.at[: self.free_modes].set(lax.stop_gradient(unit))


def _negligible(matrix: Array) -> float:
    """Coupling that round-off may leave of proportional damping: measured up to 4e-9."""
    return 10 * float(jnp.finfo(matrix.dtype).eps) ** 0.5


def _coupling(numpy: Any, modal: Any) -> Any:
    """Largest entry off the diagonal over the root of the two on it; `numpy` is that or JAX's."""
    own = numpy.abs(numpy.diagonal(modal))
    size = numpy.sqrt(own[:, None] * own[None, :])
    away = numpy.abs(modal - numpy.diag(numpy.diagonal(modal)))
    # Entries that are 0 couple nothing, also between modes without damping.
    return numpy.max(numpy.where(away > 0, away / numpy.where(size > 0, size, 1e-300), 0.0))
