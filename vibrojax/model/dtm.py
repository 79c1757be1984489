"""Clamped-free eigenproblem of a beam tapered in width, by power series in several segments.

The differential transform method of Gandhi and Vyas 2017 (sec. 2.2, eqs. 14, 16) expands a mode
in powers of s about the root. In float64 that loses about e^beta and converges as taper^k. Here
the beam is cut into segments with one expansion each; the two solutions that satisfy the clamp
are carried from segment to segment and made orthonormal at every joint (Godunov 1961, Conte
1966), so no digits are lost to growth. Every point mass sits on a joint, where u phi''' jumps by
beta^4 mass phi, so it is exact too. Only the numbers of segments, terms and masses are static.

Everything is dimensionless: s = x/L, u = 1 - taper s, beta^4 = rho A0 L^4 omega^2 / (E I0), and
masses are in units of rho A0 L. "Masses" have one entry per knot, that of the tip the last.
"""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from vibrojax._tools.compiled import compiled

Scalar = Float[Array, ""]
Knots = Float[Array, " knots"]
PerMode = Float[Array, " modes"]
Points = Float[Array, " points"]

_TERMS = 40  # 1e-17 of the sum, or less, for taper up to 0.99 and every mode
_SHORT = 1e-7  # of a segment: dividing by its cube would cost the derivatives too many digits
_QUADRATURE = np.polynomial.legendre.leggauss(20)

# Row d takes the coefficients of a series in t to its d-th derivative at t = 1.
_FALLING = np.array(
    [[np.prod(k - np.arange(d), initial=1.0) for k in range(_TERMS)] for d in range(4)]
)
_FACTORIALS = np.array([1.0, 1.0, 2.0, 6.0])


class Shapes(NamedTuple):
    """Mode shapes as one power series in t = (s - knot)/(segment length) per segment."""

    beta: PerMode
    knots: Knots
    coefficients: Float[Array, "modes segments terms"]
    area_integral_of_square: PerMode
    area_integral: PerMode
    masses: Knots
    at_knots: Float[Array, "modes knots"]


def num_segments(num_modes: int) -> int:
    """Segments that keep the growth within each small up to the highest mode wanted."""
    return max(10, 2 * num_modes)


def _joints(taper: Scalar, segments: int) -> Float[Array, " joints"]:
    """Joints of the segments, uniform in log u: every series then converges equally fast."""
    taper = jax.lax.stop_gradient(taper)  # the answer does not depend on where the joints are
    xi = np.linspace(0.0, 1.0, segments + 1)
    uniform = taper < 1e-8
    safe = jnp.where(uniform, 0.5, taper)
    graded = -jnp.expm1(xi * jnp.log1p(-safe)) / safe
    return jnp.where(uniform, xi, graded).at[-1].set(1.0)


def _place(
    joints: Float[Array, " joints"], mass_ratio: Scalar, point_masses: Points, positions: Points
) -> tuple[Knots, Knots]:
    """Knots, one of them at every point mass, and the mass at each.

    Only the positions of masses carry a gradient, right also where one meets a joint or another.
    """
    on_beam = (positions > 0) & (positions <= 1)
    point_masses = jnp.where(on_beam, point_masses, jnp.nan)  # elsewhere is not an answer
    # A mass at a joint comes before it, so that the tip is last.
    knots = jnp.concatenate([positions, joints])
    masses = jnp.concatenate([point_masses, jnp.zeros_like(joints).at[-1].set(mass_ratio)])
    order = jnp.argsort(jax.lax.stop_gradient(knots))
    return knots[order], masses[order]


def add_masses(
    integral: Float[Array, "*modes"], masses: Knots, values: Float[Array, "*modes knots"]
) -> Float[Array, "*modes"]:
    """Integral over beam and masses, from that over the beam and the values at the knots."""
    inner = jnp.sum(masses[:-1] * values[..., :-1], axis=-1)
    return integral + inner + masses[-1] * values[..., -1]


def _series(
    beta: Scalar, taper: Scalar, knots: Knots
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


def _short_transfer(beta: Scalar, taper: Scalar, knots: Knots) -> Float[Array, "segments 4 4"]:
    """Transfer over segments so short, or of no length, that two terms of it are exact.

    At no length it is the identity, but its derivative with respect to the length is not zero.
    """
    unit = jnp.sqrt(1 + beta**2)
    middle = (knots[1:] + knots[:-1]) / 2
    one = np.eye(4)
    rate = unit * np.eye(4, k=1) + beta**4 / unit**3 * np.outer(one[3], one[0])
    change_of_width = 2 * taper / (1 - taper * middle)
    rate = rate + change_of_width[:, None, None] * np.outer(one[3], one[3])
    change = rate * jnp.diff(knots)[:, None, None]
    return change + change @ change / 2 + one


class _March(NamedTuple):
    series: Float[Array, "terms segments 4"]
    bases: Float[Array, "segments 4 2"]
    triangles: Float[Array, "segments 3"]
    end: Float[Array, "2 2"]


def _march(beta: Scalar, taper: Scalar, masses: Knots, knots: Knots) -> _March:
    """Carry the clamped solutions to the tip; `end` holds the two conditions there (eq. 16)."""
    series, scale = _series(beta, taper, knots)
    short = (jnp.diff(knots) < _SHORT)[:, None, None]
    transfer = jnp.einsum("dk,kji->jdi", _FALLING, series)
    transfer = transfer / jnp.where(short, 1.0, scale[:, :, None])
    transfer = jnp.where(short, _short_transfer(beta, taper, knots), transfer)
    inertia = masses * beta**4 / ((1 - taper * knots) * jnp.sqrt(1 + beta**2) ** 3)

    def cross(basis, segment):
        matrix, jump = segment
        basis = basis.at[3].add(jump * basis[0])
        new, triangle = _orthonormal(matrix @ basis)
        return new, (basis, triangle)

    clamped = jnp.eye(4, dtype=beta.dtype)[:, 2:]
    tip, (bases, triangles) = jax.lax.scan(cross, clamped, (transfer, inertia[:-1]))
    # Divided so, it is of order 1 for any tip mass.
    shear = (tip[3] + inertia[-1] * tip[0]) / (1 + inertia[-1])
    return _March(series, bases, triangles, jnp.stack([tip[2], shear]))


@lru_cache(maxsize=64)
def _ritz_basis(size: int) -> tuple[np.ndarray, ...]:
    """Polynomials whose second derivative is 1/sqrt(weight) at one Gauss point, 0 at the others.

    Their stiffness matrix int u psi'' psi'' is diagonal and exact, for every taper. Returns the
    Gauss points, the mass matrices for u = 1 and u = s, the values at s = 1 and the Legendre
    coefficients.
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
    return (1 + x) / 2, mass, mass_s, legendre.legval(1.0, twice), twice


def _legendre(x: Points, number: int) -> Float[Array, "number points"]:
    """Values of the first Legendre polynomials."""

    def following(last, k):
        return (last[1], ((2 * k + 1) * x * last[1] - k * last[0]) / (k + 1)), last[0]

    _, values = jax.lax.scan(following, (jnp.ones_like(x), x), jnp.arange(1.0, number + 1))
    return values


def static_deflection(
    taper: Scalar, places: Points, forces: Float[Array, " forces"]
) -> Float[Array, "points forces"]:
    """Return the deflection at places x/L by unit forces at others, in units of L3/(E I0)."""

    def one(place: Scalar, force: Scalar) -> Scalar:
        # In y, with dy = ds / (1 - taper s), the integrand is smooth for every taper.
        near = jnp.minimum(place, force)
        flat = jnp.abs(taper) < 1e-6
        safe = jnp.where(flat, 0.5, taper)
        end = jnp.where(flat, near * (1 + taper * near / 2), -jnp.log1p(-safe * near) / safe)
        y = end * (1 + _QUADRATURE[0]) / 2
        s = jnp.where(flat, y * (1 - taper * y / 2), -jnp.expm1(-safe * y) / safe)
        return jnp.sum((place - s) * (force - s) * _QUADRATURE[1]) * end / 2

    return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(places, forces)


def _start(
    taper: Scalar,
    mass_ratio: Scalar,
    point_masses: Points,
    positions: Points,
    num_modes: int,
) -> PerMode:
    """All wanted beta, none missed, by Rayleigh-Ritz: only a start, so no gradient.

    Polynomials bend slowly to the kink that a point mass makes in phi''. So the static deflections
    by forces at the masses join them: what of those the polynomials lack, made orthonormal in
    stiffness. It moves little but the masses themselves, so that alone is counted.
    """
    taper, mass_ratio, point_masses, positions = jax.lax.stop_gradient(
        (taper, mass_ratio, point_masses, positions)
    )
    points, mass, mass_s, tip, coefficients = _ritz_basis(2 * num_modes + 12)
    weight = 1 / jnp.sqrt(1 - taper * points)
    matrix = mass - taper * mass_s + mass_ratio * np.outer(tip, tip)
    matrix = weight[:, None] * matrix * weight
    values = weight[:, None] * (coefficients.T @ _legendre(2 * positions - 1, len(coefficients)))
    lacking = static_deflection(taper, positions, positions) - values.T @ values
    # It is singular when masses share a place.
    rounding = 1e3 * jnp.finfo(lacking.dtype).eps * jnp.eye(positions.size)
    values = jnp.concatenate([values, jnp.linalg.cholesky(lacking + rounding).T])
    matrix = jnp.pad(matrix, (0, positions.size)) + (values * point_masses) @ values.T
    # Mass against stiffness, not the reverse: the largest eigenvalues are the accurate ones.
    return jnp.linalg.eigvalsh(matrix)[::-1][:num_modes] ** -0.25


def _roots(start: PerMode, taper: Scalar, masses: Knots, knots: Knots) -> PerMode:
    """Solve the frequency equation by Newton; the derivative is that of the implicit function."""
    # Newton is quadratic: a last step of this size leaves only rounding.
    tolerance = float(jnp.finfo(start.dtype).eps) ** 0.6
    newton = optx.Newton(rtol=tolerance, atol=tolerance)

    def equation(beta):
        end = _march(beta, taper, masses, knots).end
        return end[0, 0] * end[1, 1] - end[0, 1] * end[1, 0]

    def solve(_, beta):
        found = optx.root_find(lambda b, _: equation(b), newton, beta, max_steps=16, throw=False)
        # A lane that fails must not look like an answer, nor stop the other lanes.
        return jnp.where(found.result == optx.RESULTS.successful, found.value, jnp.nan)

    def polish(beta):
        return jax.lax.custom_root(equation, beta, solve, lambda g, y: y / g(jnp.ones_like(y)))

    return jax.vmap(polish)(start)


def _assemble(
    beta: Scalar, taper: Scalar, masses: Knots, knots: Knots
) -> tuple[Float[Array, "segments terms"], Scalar, Scalar, Knots]:
    """Shape of one mode, mass-normalised, with int u phi^2, int u phi and phi at the knots."""
    march = _march(beta, taper, masses, knots)
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
    at_knots = jnp.append(coefficients[:, 0], tip)
    square = jnp.sum(area * values**2)
    norm = jnp.where(tip < 0, -1, 1) / jnp.sqrt(add_masses(square, masses, at_knots**2))
    return coefficients * norm, square * norm**2, jnp.sum(area * values) * norm, at_knots * norm


@compiled
def solve(
    taper: Scalar, mass_ratio: Scalar, point_masses: Points, positions: Points, num_modes: int
) -> Shapes:
    """First `num_modes` modes, normalised to int u phi^2 ds + sum of mass phi^2 = 1, phi(1) > 0.

    The sum is over the tip mass and the point masses. The counts are static; the numbers may be
    traced, and new ones do not compile again.
    """
    joints = _joints(taper, num_segments(num_modes))
    knots, masses = _place(joints, mass_ratio, point_masses, positions)
    start = _start(taper, mass_ratio, point_masses, positions, num_modes)
    beta = _roots(start, taper, masses, knots)
    assemble = jax.vmap(_assemble, in_axes=(0, None, None, None))
    coefficients, square, linear, at_knots = assemble(beta, taper, masses, knots)
    return Shapes(beta, knots, coefficients, square, linear, masses, at_knots)


@compiled
def evaluate(
    knots: Knots,
    coefficients: Float[Array, "modes segments terms"],
    s: Float[Array, "*points"],
    derivative: int,
) -> Float[Array, "*points modes"]:
    """Values of the `derivative`-th derivative with respect to s (static, 0 to 3)."""
    inner = jax.lax.stop_gradient(s)
    index: Int[Array, "*points"] = jnp.searchsorted(knots[1:-1], inner, side="right")
    # A mass at the tip leaves a segment of no length there, which is not to be used.
    index = jnp.minimum(index, jnp.searchsorted(knots, knots[-1]) - 1)
    h = jnp.diff(knots)[index]
    t = ((s - knots[index]) / h)[..., None]
    series = (coefficients * _FALLING[derivative])[:, :, derivative:]
    local = jnp.moveaxis(series, 2, 0)[:, :, index]  # (terms, modes, *points)
    local = jnp.moveaxis(local, 1, -1)

    def horner(total, term):
        return total * t + term, None

    total, _ = jax.lax.scan(horner, jnp.zeros_like(local[0] * t), local, reverse=True)
    return total / h[..., None] ** derivative
