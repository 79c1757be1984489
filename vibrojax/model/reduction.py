"""A large finite-element model reduced to what its stops and sensors feel, up to a frequency."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_choice, check_not_negative, check_positive
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.finite_elements import FiniteElements
from vibrojax.model.matrix_system import MatrixSystem
from vibrojax.model.stops import Stop

METHODS = ("craig_bampton", "modal")
MARGIN = 2.0
"""Modes are kept up to so many times the highest frequency of interest."""
DEPENDENT = 1e-10
"""Share of the strain energy of a static shape below which the others hold all of it."""
SINGULAR = 1e-13
"""Pivot over the diagonal entry of the stiffness, below which the body is loose."""
Held = Float[np.ndarray, "coordinates held"]
Shapes = Float[np.ndarray, "coordinates modes"]
Squares = Float[np.ndarray, " modes"]
Static = Float[np.ndarray, "coordinates loads"]
Solve = Callable[[np.ndarray], np.ndarray]


class Reduction(eqx.Module):
    """What a finite-element model is reduced to: modes of modal mass 1 kg, and the error of it.

    Coordinates q are of these modes: displacements of the whole model are `shapes @ q`. Made by
    `reduce`.
    """

    method: str = eqx.field(static=True)
    """`craig_bampton` or `modal`."""
    highest_frequency: float = eqx.field(static=True)
    """Up to where the model was asked to hold, Hz."""
    angular_frequency: Float[np.ndarray, " modes"]
    """Natural angular frequencies of the reduced model, lowest first, rad/s."""
    shapes: Float[np.ndarray, "coordinates modes"]
    """Displacement of the finite-element model by mode, each of modal mass 1 kg."""
    damping: Float[np.ndarray, "modes modes"]
    """Damping matrix of the model, by mode, 1/s."""
    stop_map: Float[np.ndarray, "stops modes"]
    """Displacement of each contact point, by mode."""
    input_map: Float[np.ndarray, " modes"] | None
    """Generalised force of a unit input, by mode."""
    response_map: Float[np.ndarray, " modes"]
    """Displacement that is reported, by mode."""
    frequency_error: Float[np.ndarray, " kept"]
    """Bound of the relative error of each natural frequency up to `highest_frequency`."""
    flexibility_error: float
    """Largest error of the flexibility between stops and sensor, over the static one.

    Found by solving the whole model, undamped, at the middle of the band and at its end.
    """

    @validated
    def system(
        self,
        *,
        stops: Stop | tuple[Stop, ...] | list[Stop] = (),
        drive: AbstractDrive | None = None,
        damping_ratio: float | Float[Array, "..."] = 0.0,
    ) -> MatrixSystem:
        """Return the system with stops and a drive on it; cheap, so that numbers can be swept.

        Parameters:
            stops: as many as `stop_map` has rows, with position None.
            drive: what drives it, by the `input_map` that `reduce` was given.
            damping_ratio: damping ratio of every mode, beside the damping matrix of the model.

        Raises `ValueError` as `MatrixSystem` does, or for a negative damping ratio.
        """
        check_not_negative("damping_ratio", damping_ratio, "(fraction of critical)")
        frequency = jnp.asarray(self.angular_frequency)
        return MatrixSystem(
            mass=jnp.eye(frequency.size),
            damping=self.damping + jnp.diag(2 * damping_ratio * frequency),
            stiffness=jnp.diag(frequency**2),
            stops=stops,
            stop_map=self.stop_map,
            drive=drive,
            input_map=self.input_map,
            response_map=self.response_map,
            proportional=None if self.damping.any() else True,
        )

    def __repr__(self) -> str:
        n, m = self.shapes.shape
        worst = np.max(self.frequency_error, initial=0.0)
        return (
            f"Reduction({n} degrees of freedom to {m} by {self.method!r}, up to "
            f"{self.highest_frequency:.6g} Hz)\n"
            f"  {self.frequency_error.size} natural frequencies up to there, within {worst:.1e}\n"
            f"  flexibility between stops and sensor within {self.flexibility_error:.1e} of the "
            "static one"
        )


class _Model(NamedTuple):
    mass: Any
    stiffness: Any
    solve: Solve
    """K x = b, for one or several columns."""


@validated
def reduce(
    elements: FiniteElements,
    *,
    highest_frequency: float,
    response_map: ArrayLike | Sequence[Any],
    stop_map: ArrayLike | Sequence[Any] | None = None,
    input_map: ArrayLike | Sequence[Any] | None = None,
    method: str = "craig_bampton",
) -> Reduction:
    """Reduce a finite-element model to its modes up to a frequency and the static shapes there.

    `craig_bampton` takes the modes with stops and sensor held, `modal` those of the free structure;
    both up to twice the highest frequency. To either the static shapes by unit forces at the
    stops, at the sensor and by the drive are added: so the flexibility there is exact at low
    frequencies, and no modes left out act as a spring in series with a stop. Sources: Craig and
    Bampton 1968, AIAA Journal 6(7); Rubin 1975, AIAA Journal 13(8), whose residual shapes `modal`
    has. The modes of what comes of it are those of the reduced model.

    The stiffness is factored once (scipy's SuperLU), modes are found by Lanczos iterations in
    shift-invert mode (ARPACK). Errors are estimated: of natural frequencies by the residual in the
    norm of the inverse stiffness (Kato and Temple, for eigenvalues apart), of the flexibility by
    solving the whole model iteratively at some frequencies.

    Parameters:
        elements: the model, from `vibrojax.io.read_matrices`.
        highest_frequency: up to where the reduced model has to hold, Hz.
        response_map: displacement that a frequency response reports, shape (n,), such as
            `elements.row(node=12, dof=3)`.
        stop_map: one row per stop, shape (stops, n).
        input_map: generalised force of a unit input, shape (n,): `elements.row(...)` for a force,
            `elements.base_load(dof=3)` for a base motion.
        method: `craig_bampton` or `modal`.

    Raises `ValueError` for rows of the wrong length, that are not finite or 0, a stiffness that is
    not positive definite (a loose or unstable structure), a model without mass where its stops are,
    or one too small for a reduction up to there.
    """
    check_positive("highest_frequency", highest_frequency, "Hz")
    check_choice("method", method, METHODS)
    n = len(elements.degrees_of_freedom)
    response = _rows("response_map", response_map, (n,))
    stops = np.zeros((0, n)) if stop_map is None else _rows("stop_map", stop_map, (-1, n))
    load = None if input_map is None else _rows("input_map", input_map, (n,))
    model = _Model(elements.mass, elements.stiffness, _factor(elements))

    seen = np.unique(np.vstack([stops, response]), axis=0)
    loads = seen if load is None else np.vstack([seen, load])
    static = model.solve(loads.T)
    held = _independent(seen) if method == "craig_bampton" else np.zeros((n, 0))
    limit = MARGIN * 2 * np.pi * float(highest_frequency)
    squares, shapes = _modes_to(limit, model, held)
    squares, shapes = _united(squares, shapes, static, model)

    frequency = np.sqrt(squares)
    inside = int(np.sum(frequency <= 2 * np.pi * highest_frequency))
    damping = elements.damping
    no_damping = np.zeros((len(squares),) * 2)
    return Reduction(
        method=method,
        highest_frequency=float(highest_frequency),
        angular_frequency=frequency,
        shapes=shapes,
        damping=no_damping if damping is None else shapes.T @ (damping @ shapes),
        stop_map=stops @ shapes,
        input_map=None if load is None else load @ shapes,
        response_map=response @ shapes,
        frequency_error=_frequency_error(squares, shapes, inside, model),
        flexibility_error=_flexibility_error(
            seen, static[:, : len(seen)], squares, shapes, float(highest_frequency), model
        ),
    )


def _rows(name: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return rows over the coordinates of the model. Raises `ValueError` for other shapes."""
    rows = np.asarray(given, float)
    if rows.ndim != len(shape) or rows.shape[-1] != shape[-1] or 0 in rows.shape:
        wanted = f"({shape[-1]},)" if len(shape) == 1 else f"(stops, {shape[-1]})"
        raise ValueError(
            f"{name} must have one number per coordinate, shape {wanted}, got an array of shape "
            f"{rows.shape}. elements.row(node=, dof=) makes a row."
        )
    if not np.isfinite(rows).all() or not np.any(rows, axis=-1).all():
        raise ValueError(
            f"{name} must be finite and not 0 everywhere, got a row that is. "
            "elements.row(node=, dof=) makes a row."
        )
    return rows


def _factor(elements: FiniteElements) -> Solve:
    """Factor the stiffness. Raises `ValueError` unless it is positive definite."""
    from scipy.sparse.linalg import splu

    loose = (
        "stiffness must be positive definite, got a singular one. Hold the structure "
        "(elements.held(nodes=...)): it can move without force."
    )
    try:
        # Ordered and pivoted as a symmetric matrix, so that the signs of the pivots are those of
        # the eigenvalues (Sylvester); also 10 times faster than the default order.
        factor = splu(
            elements.stiffness,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        raise ValueError(loose) from None
    pivots = factor.U.diagonal()
    size = elements.stiffness.diagonal()[np.argsort(factor.perm_c)]
    lowest = int(np.argmin(pivots / size))
    if pivots[lowest] < -SINGULAR * size[lowest]:
        raise ValueError(
            f"stiffness must be positive definite, got {int(np.sum(pivots < 0))} negative "
            "eigenvalues: the structure is unstable. Look for elements of the wrong sign, or loads "
            "beyond buckling."
        )
    if pivots[lowest] < SINGULAR * size[lowest]:
        raise ValueError(loose)
    return factor.solve


def _independent(rows: Float[np.ndarray, "rows coordinates"]) -> Held:
    """Return orthonormal columns that span the rows."""
    _, size, across = np.linalg.svd(rows, full_matrices=False)
    return across[size > 1e-9 * size[0]].T


def _operator(size: int, apply: Solve) -> Any:
    from scipy.sparse.linalg import LinearOperator

    make: Any = LinearOperator  # whose stub has the arguments of one of its subclasses
    return make((size, size), matvec=apply, dtype=float)


def _modes_to(limit: float, model: _Model, held: Held) -> tuple[Squares, Shapes]:
    """Return the squares and shapes of the modes up to a limit, rad/s, with columns held."""
    from scipy.sparse.linalg import ArpackError, eigsh

    n = model.mass.shape[0]
    answer = model.solve(held)
    # Displacements by unit forces, with the held columns pulled back to 0: no second factor.
    constraint = answer @ np.linalg.inv(held.T @ answer)

    def apply(force: np.ndarray) -> np.ndarray:
        moved = model.solve(np.ravel(force))
        return moved - constraint @ (held.T @ moved)

    inverse = _operator(n, apply)
    start = np.random.default_rng(0).standard_normal(n)
    count, most = 24, (n - held.shape[1]) // 2
    while True:
        count = min(count, most)
        try:
            if count < 1:
                raise ArpackError(-1)
            squares, shapes = eigsh(
                model.stiffness, count, model.mass, sigma=0.0, OPinv=inverse, v0=start
            )
        except ArpackError:
            squares, shapes = np.zeros(0), np.zeros((n, 0))
        if squares.size and squares[-1] > limit**2:
            kept = max(1, int(np.sum(squares <= limit**2)))
            return squares[:kept], shapes[:, :kept]
        if count == most:
            raise ValueError(
                "highest_frequency must be so low that most modes can be left out, got "
                f"{limit / (2 * np.pi * MARGIN):.6g} Hz for {n} degrees of freedom. Give a "
                "MatrixSystem the matrices themselves."
            )
        count *= 2


def _united(
    squares: Squares, shapes: Shapes, static: Static, model: _Model
) -> tuple[Float[np.ndarray, " united"], Float[np.ndarray, "coordinates united"]]:
    """Return squares and shapes of the modes of the model that modes and static shapes span."""
    product = model.stiffness @ static
    energy = np.einsum("ij,ij->j", static, product)
    static, product = static / np.sqrt(energy), product / np.sqrt(energy)
    rest = static - shapes @ ((shapes.T @ product) / squares[:, None])
    gram = rest.T @ (model.stiffness @ rest)
    share, across = np.linalg.eigh((gram + gram.T) / 2)
    lasting = share > DEPENDENT
    rest = rest @ (across[:, lasting] / np.sqrt(share[lasting]))
    # Orthonormal in stiffness, so the large eigenvalues of the mass, the low modes, are accurate.
    basis = np.hstack([shapes / np.sqrt(squares), rest])
    mass = basis.T @ (model.mass @ basis)
    inverse, across = np.linalg.eigh((mass + mass.T) / 2)
    inverse, across = inverse[::-1], across[:, ::-1]
    if inverse[-1] <= 1e-15 * inverse[0]:
        raise ValueError(
            "mass must be above 0 where the stops, the sensor and the drive are, got none. Give "
            "the nodes there a mass."
        )
    return 1 / inverse, basis @ across / np.sqrt(inverse)


def _frequency_error(
    squares: Squares, shapes: Shapes, count: int, model: _Model
) -> Float[np.ndarray, " kept"]:
    """Bound the relative error of the first natural frequencies.

    The residual of a mode in the norm of the inverse stiffness bounds the distance to an
    eigenvalue; its square over the distance to the next one does too (Kato and Temple; Parlett
    1998, The Symmetric Eigenvalue Problem, ch. 11). Modes closer than the bound count together.
    """
    residual = model.stiffness @ shapes - (model.mass @ shapes) * squares
    norm = np.einsum("ij,ij->j", residual, model.solve(residual))
    share = np.sqrt(np.maximum(norm, 0.0) / squares)
    away = np.abs(squares[:, None] / squares[None] - 1)
    together = away <= share[:, None]
    next_one = np.min(np.where(together, np.inf, away), axis=1)
    return np.minimum(share, together @ share**2 / next_one)[:count] / 2


def _flexibility_error(
    rows: Float[np.ndarray, "rows coordinates"],
    static: Float[np.ndarray, "coordinates rows"],
    squares: Squares,
    shapes: Shapes,
    highest_frequency: float,
    model: _Model,
) -> float:
    """Return the largest error of the flexibility between the rows, over the static one."""
    from scipy.sparse.linalg import minres

    inverse = _operator(len(shapes), model.solve)
    natural = np.concatenate([[0.0], np.sqrt(squares)])
    size, worst = np.linalg.norm(rows @ static), 0.0
    for wanted in 2 * np.pi * highest_frequency * np.array([0.5, 1.0]):
        # Half-way between resonances, at which any error is infinite.
        above = min(int(np.searchsorted(natural, wanted)), len(natural) - 1)
        w2 = float(np.mean(natural[above - 1 : above + 1]) ** 2)
        dynamic = model.stiffness - w2 * model.mass
        missing = rows.T - dynamic @ (shapes @ ((shapes.T @ rows.T) / (squares - w2)[:, None]))
        # What is missing lies where the stiffness rules: by it the iteration takes a few steps.
        error = [rows @ minres(dynamic, one, M=inverse, rtol=1e-4)[0] for one in missing.T]
        worst = max(worst, float(np.linalg.norm(error)) / float(size))
    return worst
