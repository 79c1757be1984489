"""Static correction: what the modes left out do at the stops, as a few shapes more.

Modes that are not kept act as springs in series with the stops. Their part of the static deflection
by a unit force at each stop, the residual shape, joins the modes: then the static flexibility at
the stops is exact, and the equations stay modal. Sources: MacNeal 1971, Computers & Structures 1,
581; Rubin 1975, AIAA Journal 13(8), 995; Hintz 1975, AIAA Journal 13(8), 1007.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax.model.beam import Cantilever
from vibrojax.model.dtm import static_deflection
from vibrojax.model.modes import Modes

Scalar = Float[Array, ""]
Points = Float[Array, " points"]
PerMode = Float[Array, " modes"]
Square = Float[Array, "stops stops"]

DEPENDENT = 1e-9
"""Share of a residual flexibility below which the shapes of other stops hold all of it."""
LEAST = 1e-11
"""Share of the static flexibility at a stop that is round-off: the modes hold all of it."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)


def residual_modes(
    flexibility: Square, mass: Square, whole: Float[Array, " stops"], highest: Scalar
) -> tuple[Float[Array, " stops"], Square]:
    """Return angular frequencies, rad/s, of the modes that residual shapes make, and these modes.

    The modes are columns of shares of the shapes, of modal mass 1 kg. Where a shape is none (two
    stops at one place, or modes that hold all of it) the column is 0 and the frequency stands above
    `highest`, that of the modes kept.

    Parameters:
        flexibility: of the residual shapes between the stops, m/N: also their stiffness products.
        mass: mass products of the shapes, kg m2/N2.
        whole: static flexibility at each stop, m/N.
        highest: highest angular frequency of the modes kept, rad/s.
    """
    lower, kept = _independent(flexibility, whole)
    unit = lower @ mass @ lower.T
    # Columns that are none get negative eigenvalues of their own: they stand last and apart, and
    # equal ones would have no derivative.
    order = jnp.arange(len(whole))
    unit = jnp.where(kept[:, None] & kept[None], unit, 0.0)
    unit = unit - jnp.diag(jnp.where(kept, 0.0, (1 + order) / highest**2))
    inverse, across = jnp.linalg.eigh((unit + unit.T) / 2)
    inverse, across = inverse[::-1], across[:, ::-1]
    is_mode = inverse > 0
    root = jnp.sqrt(jnp.where(is_mode, inverse, 0.25 * 0.5**order / highest**2))
    shares = jnp.where(kept[:, None], lower, 0.0).T @ across / root
    return 1 / root, jnp.where(is_mode, shares, 0.0)


def _independent(flexibility: Square, whole: Float[Array, " stops"]) -> tuple[Square, Any]:
    """Return rows that make the shapes orthonormal in stiffness, and which of them are shapes.

    Gram and Schmidt, stop by stop: unlike eigenvectors it has derivatives wherever stops are.
    """
    rows: list[Array] = []
    kept: list[Array] = []
    eye = jnp.eye(len(whole))
    for k in range(len(whole)):
        row = eye[k]
        for other in rows:
            row = row - (other @ flexibility[:, k]) * other
        rest, own = row @ flexibility @ row, flexibility[k, k]
        is_shape = (own > LEAST * whole[k]) & (rest > DEPENDENT * own)
        rows.append(jnp.where(is_shape, row / jnp.sqrt(jnp.where(is_shape, rest, 1.0)), 0.0))
        kept.append(is_shape)
    return jnp.stack(rows), jnp.stack(kept)


class CorrectedModes(eqx.Module):
    """Modes of a beam, and the modes of its residual shapes at the stops behind them.

    They read as `Modes` do: all are orthogonal in mass and in stiffness.
    """

    free: Modes
    taper: Scalar
    forces: Float[Array, " stops"]
    beta: PerMode
    angular_frequency: PerMode
    modal_mass: PerMode
    participation: PerMode
    shares: Float[Array, "stops stops"]

    @property
    def num_modes(self) -> int:
        """How many there are, the residual shapes counted."""
        return self.beta.shape[-1]

    @property
    def knots(self) -> Float[Array, " knots"]:
        """Ends of stretches on which the shapes are smooth: those of the modes, and the stops."""
        return jnp.sort(jnp.concatenate([self.free.knots, self.forces]))

    def shape(self, s: ArrayLike) -> Float[Array, "*points modes"]:
        """Return the shapes at places s = x/L, as `Modes.shape` does."""
        places = jnp.asarray(s, self.taper.dtype)
        rest = _residual_shapes(self.free, self.taper, places.reshape(-1), self.forces)
        rest = (rest @ self.shares).reshape(*places.shape, -1)
        return jnp.concatenate([self.free.shape(places), rest], axis=-1)


def _residual_shapes(
    free: Modes, taper: Scalar, places: Points, forces: Float[Array, " stops"]
) -> Float[Array, "points stops"]:
    kept = (free.shape(places) / free.beta**4) @ free.shape(forces).T
    return static_deflection(taper, places, forces) - kept


def corrected_modes(
    beam: Cantilever, free: Modes, forces: Float[Array, " stops"]
) -> CorrectedModes:
    """Return the modes of a beam with the residual shapes of unit forces at places x/L."""
    taper = jnp.asarray(beam.taper, free.beta.dtype)
    knots = jnp.sort(jnp.concatenate([free.knots, forces]))
    length = jnp.diff(knots)[:, None]
    places = (knots[:-1, None] + length * (1 + _NODES) / 2).reshape(-1)
    weights = (length * _WEIGHTS / 2).reshape(-1) * (1 - taper * places)
    # Point masses and the tip mass: places of their own, in units of rho A0 L.
    points = beam.point_masses
    heavy = [jnp.asarray(p.mass) / beam.reference_mass for p in points]
    at = [jnp.asarray(p.position, free.beta.dtype) for p in points]
    places = jnp.concatenate([places, jnp.stack([*at, jnp.ones(())])])
    weights = jnp.concatenate([weights, jnp.stack([*heavy, jnp.asarray(beam.mass_ratio)])])

    rest = _residual_shapes(free, taper, places, forces)
    mass = rest.T @ (weights[:, None] * rest)
    flexibility = _residual_shapes(free, taper, forces, forces)
    whole = jnp.diagonal(static_deflection(taper, forces, forces))
    squares, shares = residual_modes(flexibility, mass, whole, free.beta[-1] ** 2)
    beta = jnp.concatenate([free.beta, jnp.sqrt(squares)])
    scale = jnp.asarray(beam.frequency_scale)
    return CorrectedModes(
        free=free,
        taper=taper,
        forces=forces,
        beta=beta,
        angular_frequency=scale * beta**2,
        modal_mass=jnp.asarray(beam.reference_mass) * jnp.ones_like(beta),
        participation=jnp.concatenate([free.participation, (weights @ rest) @ shares]),
        shares=shares,
    )
