"""Clamped-free eigenproblem of a beam tapered in width, by power series in several segments.

The differential transform method of Gandhi and Vyas 2017 (sec. 2.2, eqs. 14, 16) expands a mode
in powers of s about the root. In float64 that loses about e^beta and converges as taper^k. Here
the beam is cut into segments with one expansion each; the two solutions that satisfy the clamp
are carried from segment to segment and made orthonormal at every joint (Godunov 1961, Conte
1966), so no digits are lost to growth. Only the numbers of segments and of terms are static.

Everything is dimensionless: s = x/L, u = 1 - taper s, beta^4 = rho A0 L^4 omega^2 / (E I0).
"""

from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

_TERMS = 40  # 1e-17 of the sum, or less, for taper up to 0.99 and every mode
_QUADRATURE = np.polynomial.legendre.leggauss(20)

# Row d takes the coefficients of a series in t to its d-th derivative at t = 1.
_FALLING = np.array(
    [[np.prod(k - np.arange(d), initial=1.0) for k in range(_TERMS)] for d in range(4)]
)
_FACTORIALS = np.array([1.0, 1.0, 2.0, 6.0])


class Shapes(NamedTuple):
    """Mode shapes as one power series in t = (s - knot)/(segment length) per segment."""

    beta: Float[Array, " modes"]
    knots: Float[Array, " knots"]
    coefficients: Float[Array, "modes segments terms"]
    area_integral_of_square: Float[Array, " modes"]
    area_integral: Float[Array, " modes"]
    tip: Float[Array, " modes"]


def num_segments(num_modes: int) -> int:
    """Segments that keep the growth within each small up to the highest mode wanted."""
    return max(10, 2 * num_modes)


def _knots(taper: Float[Array, ""], segments: int) -> Float[Array, " knots"]:
    """Joints of the segments, uniform in log u: every series then converges equally fast."""
    taper = jax.lax.stop_gradient(taper)  # the answer does not depend on where the joints are
    xi = np.linspace(0.0, 1.0, segments + 1)
    uniform = taper < 1e-8
    safe = jnp.where(uniform, 0.5, taper)
    graded = -jnp.expm1(xi * jnp.log1p(-safe)) / safe
    return jnp.where(uniform, xi, graded).at[-1].set(1.0)


def _series(
    beta: Float[Array, ""], taper: Float[Array, ""], knots: Float[Array, " knots"]
) -> tuple[Float[Array, "terms segments 4"], Float[Array, "segments 4"]]:
    """Coefficients, in powers of t, of the four solutions that start from a unit state.

    The state is (phi, phi'/k, phi''/k^2, phi'''/k^3) with k = sqrt(1 + beta^2), which keeps its
    entries alike for every mode. Also returns (k h)^d, the unit of state entry d in powers of t.
    """
    h = jnp.diff(knots)
    slope = taper * h / (1 - taper * knots[:-1])
    unit = jnp.sqrt(1 + beta**2) * h
    scale = jnp.stack([jnp.ones_like(h), unit, unit**2, unit**3], axis=1)
    first = np.diag(1 / _FACTORIALS)[:, None, :] * scale  # (4 terms, segments, 4)
    slope, stiffness = slope[:, None], ((beta * h) ** 4)[:, None]

    def term(previous, factors):
        a0, a1, a2, a3, a4 = previous
        ratio, quotient = factors
        new = ratio * slope * a4 + quotient * stiffness * (a1 - slope * a0)
        return (a1, a2, a3, a4, new), new

    k = np.arange(_TERMS - 4.0)
    factors = ((k + 2) / (k + 4), 1 / ((k + 4) * (k + 3) * (k + 2) * (k + 1)))
    start = (jnp.zeros_like(first[0]), *first)
    _, rest = jax.lax.scan(term, start, jax.tree.map(jnp.asarray, factors))
    return jnp.concatenate([first, rest]), scale


def _orthonormal(v: Float[Array, "4 2"]) -> tuple[Float[Array, "4 2"], Float[Array, " 3"]]:
    """QR with a positive diagonal, R as (r11, r12, r22): smooth in v, unlike a library QR."""
    r11 = jnp.sqrt(v[:, 0] @ v[:, 0])
    q1 = v[:, 0] / r11
    r12 = q1 @ v[:, 1]
    rest = v[:, 1] - r12 * q1
    r22 = jnp.sqrt(rest @ rest)
    return jnp.stack([q1, rest / r22], axis=1), jnp.stack([r11, r12, r22])


class _March(NamedTuple):
    series: Float[Array, "terms segments 4"]
    bases: Float[Array, "segments 4 2"]
    triangles: Float[Array, "segments 3"]
    end: Float[Array, "2 2"]


def _march(
    beta: Float[Array, ""],
    taper: Float[Array, ""],
    mass_ratio: Float[Array, ""],
    knots: Float[Array, " knots"],
) -> _March:
    """Carry the clamped solutions to the tip; `end` holds the two conditions there (eq. 16)."""
    series, scale = _series(beta, taper, knots)
    transfer = jnp.einsum("dk,kji->jdi", _FALLING, series) / scale[:, :, None]

    def cross(basis, matrix):
        new, triangle = _orthonormal(matrix @ basis)
        return new, (basis, triangle)

    clamped = jnp.eye(4, dtype=beta.dtype)[:, 2:]
    tip, (bases, triangles) = jax.lax.scan(cross, clamped, transfer)
    inertia = mass_ratio * beta**4 / ((1 - taper) * jnp.sqrt(1 + beta**2) ** 3)
    shear = (tip[3] + inertia * tip[0]) / (1 + inertia)  # of order 1 for any tip mass
    return _March(series, bases, triangles, jnp.stack([tip[2], shear]))


def _frequency_equation(beta, args) -> Float[Array, ""]:
    end = _march(beta, *args).end
    return end[0, 0] * end[1, 1] - end[0, 1] * end[1, 0]


@lru_cache(maxsize=64)
def _ritz_basis(size: int) -> tuple[np.ndarray, ...]:
    """Polynomials whose second derivative is 1/sqrt(weight) at one Gauss point, 0 at the others.

    Their stiffness matrix int u psi'' psi'' is diagonal and exact, for every taper. Returns the
    Gauss points, the mass matrices for u = 1 and u = s, and the values at s = 1.
    """
    legendre = np.polynomial.legendre
    x, w = legendre.leggauss(size)
    k = np.arange(size)
    curvature = (legendre.legvander(x, size - 1) * np.sqrt(w)[:, None]).T * (k + 0.5)[:, None]
    twice = legendre.legint(curvature, m=2, lbnd=-1, scl=1) / 4 * np.sqrt(2)
    y, v = legendre.leggauss(size + 4)
    values = legendre.legval(y, twice)
    points = (1 + y) / 2
    mass = (values * (v / 2)) @ values.T
    mass_s = (values * (v * points / 2)) @ values.T
    return (1 + x) / 2, mass, mass_s, legendre.legval(1.0, twice)


def _start(
    taper: Float[Array, ""], mass_ratio: Float[Array, ""], num_modes: int
) -> Float[Array, " modes"]:
    """All wanted beta, none missed, by Rayleigh-Ritz: only a start, so no gradient."""
    taper, mass_ratio = jax.lax.stop_gradient((taper, mass_ratio))
    points, mass, mass_s, tip = _ritz_basis(2 * num_modes + 12)
    weight = 1 / jnp.sqrt(1 - taper * points)
    matrix = mass - taper * mass_s + mass_ratio * np.outer(tip, tip)
    # Mass against stiffness, not the reverse: the largest eigenvalues are the accurate ones.
    flexibility = jnp.linalg.eigvalsh(weight[:, None] * matrix * weight)
    return flexibility[::-1][:num_modes] ** -0.25


def _roots(
    taper: Float[Array, ""],
    mass_ratio: Float[Array, ""],
    knots: Float[Array, " knots"],
    num_modes: int,
) -> Float[Array, " modes"]:
    """Solve the frequency equation by Newton; the derivative is that of the implicit function."""
    start = _start(taper, mass_ratio, num_modes)
    # Newton is quadratic: a last step of this size leaves only rounding.
    tolerance = float(jnp.finfo(start.dtype).eps) ** 0.6
    newton = optx.Newton(rtol=tolerance, atol=tolerance)

    def polish(beta):
        solution = optx.root_find(
            _frequency_equation,
            newton,
            beta,
            args=(taper, mass_ratio, knots),
            max_steps=16,
            throw=False,
        )
        # A lane that fails must not look like an answer, nor stop the other lanes.
        return jnp.where(solution.result == optx.RESULTS.successful, solution.value, jnp.nan)

    return jax.vmap(polish)(start)


def _assemble(
    beta: Float[Array, ""],
    taper: Float[Array, ""],
    mass_ratio: Float[Array, ""],
    knots: Float[Array, " knots"],
) -> tuple[Float[Array, "segments terms"], Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """Shape of one mode, mass-normalised, with int u phi^2, int u phi and phi(1)."""
    march = _march(beta, taper, mass_ratio, knots)
    # Both rows of `end` are orthogonal to the answer; the longer one says so more precisely.
    rows = jnp.sum(march.end**2, axis=1)
    row = jnp.where(rows[0] > rows[1], march.end[0], march.end[1])
    at_tip = jnp.stack([-row[1], row[0]])

    def back(weights, triangle):
        second = weights[1] / triangle[2]
        first = (weights[0] - triangle[1] * second) / triangle[0]
        new = jnp.stack([first, second])
        return new, new

    _, weights = jax.lax.scan(back, at_tip, march.triangles, reverse=True)
    states = jnp.einsum("jdc,jc->jd", march.bases, weights)
    coefficients = jnp.einsum("kji,ji->jk", march.series, states)

    node, weight = (1 + _QUADRATURE[0]) / 2, _QUADRATURE[1] / 2
    h = jnp.diff(knots)[:, None]
    values = coefficients @ (node ** np.arange(_TERMS)[:, None])
    area = (1 - taper * (knots[:-1, None] + h * node)) * h * weight
    tip = jnp.sum(coefficients[-1])
    square = jnp.sum(area * values**2)
    norm = jnp.where(tip < 0, -1, 1) / jnp.sqrt(square + mass_ratio * tip**2)
    return coefficients * norm, square * norm**2, jnp.sum(area * values) * norm, tip * norm


@eqx.filter_jit
def solve(taper: Float[Array, ""], mass_ratio: Float[Array, ""], num_modes: int) -> Shapes:
    """First `num_modes` modes, normalised to int u phi^2 ds + mass_ratio phi(1)^2 = 1, phi(1) > 0.

    The count is static; the two numbers may be traced, and new ones do not compile again.
    """
    knots = _knots(taper, num_segments(num_modes))
    beta = _roots(taper, mass_ratio, knots, num_modes)
    assemble = jax.vmap(_assemble, in_axes=(0, None, None, None))
    coefficients, square, linear, tip = assemble(beta, taper, mass_ratio, knots)
    return Shapes(beta, knots, coefficients, square, linear, tip)


@eqx.filter_jit
def evaluate(
    knots: Float[Array, " knots"],
    coefficients: Float[Array, "modes segments terms"],
    s: Float[Array, "*points"],
    derivative: int,
) -> Float[Array, "*points modes"]:
    """Values of the `derivative`-th derivative with respect to s (static, 0 to 3)."""
    segments = coefficients.shape[1]
    inner = jax.lax.stop_gradient(s)
    index: Int[Array, "*points"] = jnp.searchsorted(knots[1:-1], inner, side="right")
    index = jnp.clip(index, 0, segments - 1)
    h = jnp.diff(knots)[index]
    t = ((s - knots[index]) / h)[..., None]
    series = (coefficients * _FALLING[derivative])[:, :, derivative:]
    local = jnp.moveaxis(series, 2, 0)[:, :, index]  # (terms, modes, *points)
    local = jnp.moveaxis(local, 1, -1)

    def horner(total, term):
        return total * t + term, None

    total, _ = jax.lax.scan(horner, jnp.zeros_like(local[0] * t), local, reverse=True)
    return total / h[..., None] ** derivative
