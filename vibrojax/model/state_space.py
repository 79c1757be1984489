"""A structure given in first order, x' = A x + B u, that hits stops."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import concrete
from vibrojax._tools.eigenvalues import eigenvalues
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive, NoDrive
from vibrojax.model.equations import LinearEquations
from vibrojax.model.internal_states import InternalStates
from vibrojax.model.matrix_checks import check_array
from vibrojax.model.states import Displacement, check_coordinates
from vibrojax.model.stops import Stop, as_stops
from vibrojax.model.systems import AbstractSystem, check_without_places

Matrix = ArrayLike | Sequence[Any]
SAME = 1e-9
"""Relative size below which numbers are taken as 0."""


@validated
class StateSpace(AbstractSystem):
    """x' = flow x + input_map u(t) - sum over stops of force_map_s F_s, linear between contacts.

    For what is not of second order in all its states: circuits, amplifiers, filters, dampers that
    remember, beside displacements and velocities. The displacements at the stops and the reported
    response become the coordinates q of the equations, the rest internal states; `state_of` and
    `states` go from x to states of motion and back. Every number is a leaf: it can be swept,
    batched and differentiated. There are n states; units are your own, displacements in m.

    Parameters:
        flow: A, shape (n, n), 1/s. Stable: its eigenvalues have real parts below 0.
        response_map: what a frequency response reports, by state, shape (n,): a displacement, or
            another quantity that neither the input nor a contact force changes at once.
        stops: one or several `Stop`, with position None: stop_map places them.
        stop_map: displacement of each contact point towards its stop, by state, shape (stops, n).
            The row of a stop with side = -1 is taken with its sign changed, as for a beam.
        force_map: rate of the states by a force of 1 N that pulls the contact point towards the
            stop, by stop, shape (n, stops); the contact force acts against it. Its sign is changed
            with that of the row.
        drive: `BaseMotion`, `PointForce` (its position is not used) or `NoDrive`.
        input_map: B, rate of the states by a unit input, shape (n,): 1 N of a `PointForce`, minus
            the acceleration of the base, 1 m/s2, of a `BaseMotion`.

    Raises `ValueError` for maps of the wrong shape or that are not finite, a structure that is not
    stable, a displacement that a force or the input changes at once or whose velocity the states do
    not hold, a missing map, a stop with a position, and stops and drive that are none.
    """

    flow: Float[Array, "states states"] = eqx.field(metadata={"units": "1/s"})
    stops: tuple[Stop, ...]
    stop_map: Float[Array, "stops states"]
    force_map: Float[Array, "states stops"]
    drive: AbstractDrive
    input_map: Float[Array, " states"]
    response_map: Float[Array, " states"]
    independent: tuple[int, ...] = eqx.field(static=True)
    """Which of the rows of stop_map and, last, response_map are the coordinates."""

    def __init__(
        self,
        flow: Matrix,
        *,
        response_map: Matrix,
        stops: Stop | tuple[Stop, ...] | list[Stop] = (),
        stop_map: Matrix | None = None,
        force_map: Matrix | None = None,
        drive: AbstractDrive | None = None,
        input_map: Matrix | None = None,
    ) -> None:
        self.stops = as_stops(stops)
        self.drive = NoDrive() if drive is None else drive
        check_without_places("a StateSpace", self.stops, "Its row of stop_map says where it is.")
        self.flow = jnp.asarray(flow, float)
        n, count = self.flow.shape[0] if self.flow.ndim else 0, len(self.stops)
        missing = {"stop_map": stop_map is None and count, "force_map": force_map is None and count}
        missing["input_map"] = input_map is None and not isinstance(self.drive, NoDrive)
        for name, misses in missing.items():
            if misses:
                raise ValueError(f"{name} must be given, with stops or a drive: see StateSpace.")
        self.response_map = jnp.asarray(response_map, float)
        self.stop_map = jnp.asarray(jnp.zeros((0, n)) if stop_map is None else stop_map, float)
        self.force_map = jnp.asarray(jnp.zeros((n, 0)) if force_map is None else force_map, float)
        self.input_map = jnp.asarray(jnp.zeros(n) if input_map is None else input_map, float)
        shapes = {
            "flow": ((n, n), "a square matrix"),
            "response_map": ((n,), "one number per state"),
            "stop_map": ((count, n), "one row per stop, by state"),
            "force_map": ((n, count), "one column per stop, by state"),
            "input_map": ((n,), "one number per state"),
        }
        if not count:
            del shapes["force_map"]
        for name, expected in shapes.items():
            check_array(name, getattr(self, name), *expected)
        _check_stable(self.flow)
        # As they were given: what JAX is tracing it makes of constants, too.
        given = [] if stop_map is None else [stop_map]
        self.independent = self._independent(_known([*given, [response_map]]))

    def _independent(self, rows: np.ndarray | None) -> tuple[int, ...]:
        """Choose the coordinates: which rows are displacements of their own.

        Rows that JAX is tracing are taken to be so, all of them.
        """
        names = [f"stop_map[{s}]" for s in range(len(self.stops))] + ["response_map"]
        if rows is None:
            return tuple(range(len(names)))
        kept: list[int] = []
        for k, name in enumerate(names):
            if not rows[k].any():
                raise ValueError(f"{name} must read some state, got zeros.")
            if not _spans(rows[kept], rows[k]):
                kept.append(k)
        flow, inputs = concrete(self.flow), concrete(self._inputs())
        if flow is None or inputs is None:
            return tuple(kept)
        scale = np.diagonal(scipy.linalg.matrix_balance(flow, permute=False)[1])
        rows, flow, inputs = rows * scale, flow * scale / scale[:, None], inputs / scale[:, None]
        for name, row in zip(names, rows, strict=True):
            reach = np.linalg.norm(row) * np.linalg.norm(inputs, axis=0)
            if (np.abs(row @ inputs) > SAME * np.where(reach > 0, reach, 1.0)).any():
                raise ValueError(
                    f"{name} must be a displacement, which no force changes at once, but "
                    f"{name} @ input_map or @ force_map is not 0. Is it a velocity?"
                )
        chosen = rows[kept] / np.linalg.norm(rows[kept], axis=1)[:, None]
        moves = chosen @ flow
        both = np.concatenate([chosen, moves / np.linalg.norm(moves, axis=1)[:, None]])
        if len(both) > len(flow) or np.linalg.matrix_rank(both, tol=1e-8) < len(both):
            raise ValueError(
                "The states must hold the velocities of the displacements that stop_map and "
                "response_map read (their rows times flow), apart from the displacements "
                "themselves. Give a structure of second order there."
            )
        return tuple(kept)

    def _rows(self) -> Float[Array, "rows states"]:
        return jnp.concatenate([self.stop_map, self.response_map[None]])

    def _inputs(self) -> Float[Array, "states inputs"]:
        return jnp.concatenate([self.force_map, self.input_map[:, None]], axis=1)

    def _new_states(self) -> tuple[Array, Array, Array]:
        """Rows that read (q, q', internal) off x, their inverse, and the size of internal ones."""
        chosen = self._rows()[np.array(self.independent)]
        known = jnp.concatenate([chosen, chosen @ self.flow])
        scale = lax.stop_gradient(_balance(self.flow))
        size = jnp.linalg.norm(lax.stop_gradient(known) * scale, axis=1)
        _, _, right = jnp.linalg.svd(lax.stop_gradient(known) * scale / size[:, None])
        rest = right[len(known) :] / scale
        rows = jnp.concatenate([known, rest])
        return rows, jnp.linalg.inv(rows), jnp.max(size[: len(chosen)])

    def equations(self) -> LinearEquations:
        """Take displacements, their velocities and internal states in the place of x."""
        rows, back, size = self._new_states()
        r = len(self.independent)
        flow = rows @ self.flow @ back
        towards = jnp.asarray([float(stop.side) for stop in self.stops])
        pushes, drive = rows @ (self.force_map * towards), rows @ self.input_map
        reads = (self._rows() @ back)[:, :r]
        unit = _natural(self.flow)
        natural = jnp.full(r, unit)
        internal = InternalStates(
            flow=flow[2 * r :, 2 * r :],
            from_displacement=flow[2 * r :, :r],
            from_velocity=flow[2 * r :, r : 2 * r],
            from_input=drive[2 * r :],
            from_force=pushes[2 * r :],
            acceleration=flow[r : 2 * r, 2 * r :],
            response=jnp.zeros(flow.shape[0] - 2 * r),
            weight=jnp.full(flow.shape[0] - 2 * r, unit * size),
        )
        return LinearEquations(
            stops=self.stops,
            angular_frequency=natural,
            damping_ratio=jnp.zeros(r),
            input_map=drive[r : 2 * r],
            stop_map=towards[:, None] * reads[:-1],
            force_map=pushes[r : 2 * r],
            response_map=reads[-1],
            modal_mass=jnp.ones(r),
            damping_coupling=-flow[r : 2 * r, r : 2 * r],
            stiffness_coupling=-flow[r : 2 * r, :r] - jnp.diag(natural**2),
            internal=internal if internal.size else None,
        )

    def modal_coordinates(self, displacement: Displacement) -> Float[Array, " coordinates"]:
        """Return displacements at stops and response; `state_of` takes all states x.

        `displacement` has one number per coordinate; raises `ValueError` for another shape.
        """
        count = len(self.independent)
        return check_coordinates("displacement", displacement, count, "one number per coordinate")

    @validated(traceable=True)
    def state_of(self, x: ArrayLike) -> Float[Array, " motion_states"]:
        """Return the state of motion of states `x`, shape (n,), its stops at rest.

        It is what `initial_state=`, `guess=` and `start=` take. Raises `TypeError` for another
        shape.
        """
        rows, _, _ = self._new_states()
        found = rows @ jnp.asarray(x, float)
        equations = jax.eval_shape(self.equations)
        return jnp.concatenate([found, jnp.zeros(equations.state_size - len(found))])

    @validated(traceable=True)
    def states(self, state: ArrayLike) -> Float[Array, "... states"]:
        """Return the states x of states of motion, shape (..., motion states): of a history, say.

        `state` is `history.states`, or one of them.
        """
        _, back, _ = self._new_states()
        return jnp.asarray(state)[..., : len(back)] @ back.T


def _known(rows: list[Any]) -> np.ndarray | None:
    """Rows one below the other as numbers; None where JAX is tracing some."""
    try:
        return np.concatenate([np.asarray(row, float) for row in rows])
    except TypeError:
        return None


def _spans(rows: np.ndarray, row: np.ndarray) -> bool:
    """Whether a row is a sum of others."""
    if not len(rows):
        return False
    shares, *_ = np.linalg.lstsq(rows.T, row, rcond=None)
    return bool(np.linalg.norm(row - shares @ rows) <= SAME * np.linalg.norm(row))


def _balance(matrix: Float[Array, "n n"]) -> Float[Array, " n"]:
    """Sizes of the states by which rows and columns of their matrix become alike (Osborne 1960)."""
    away = jnp.abs(matrix) * (1 - jnp.eye(len(matrix)))

    def step(_: Any, scale: Array) -> Array:
        scaled = away * scale / scale[:, None]
        row, column = jnp.linalg.norm(scaled, axis=1), jnp.linalg.norm(scaled, axis=0)
        both = (row > 0) & (column > 0)
        return scale * jnp.where(both, row / jnp.where(both, column, 1.0), 1.0) ** 0.25

    return lax.fori_loop(0, 60, step, jnp.ones(len(matrix)))


def _natural(flow: Float[Array, "n n"]) -> Float[Array, ""]:
    """Size of the lowest eigenvalue that turns, rad/s; of the lowest of all where none does."""
    values = eigenvalues(flow)
    size = jnp.abs(values)
    turns = jnp.abs(values.imag) > SAME * size
    lowest = jnp.min(jnp.where(turns, size, jnp.inf))
    return jnp.where(jnp.isfinite(lowest), lowest, jnp.min(size))


def _check_stable(flow: Array) -> None:
    values = concrete(flow)
    if values is None:
        return
    found = np.linalg.eigvals(values)
    worst = found[np.argmax(found.real)]
    if worst.real >= -1e-14 * np.abs(found).max():
        raise ValueError(
            "flow must be stable, its eigenvalues left of the imaginary axis, got "
            f"{worst:.4g} 1/s. Give it damping, and take a free body as a MatrixSystem."
        )
