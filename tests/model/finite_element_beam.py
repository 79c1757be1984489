"""An independent tapered cantilever with a tip mass: quintic Hermite finite elements in numpy."""

import numpy as np


def _quintic() -> np.ndarray:
    """Coefficients (function, power of t) of the six Hermite functions on [0, 1].

    In order: value, slope, curvature at t = 0, then the same at t = 1.
    """
    conditions = np.zeros((6, 6))
    for order in range(3):
        for power in range(6):
            factor = np.prod(power - np.arange(order), initial=1.0)
            conditions[order, power] = factor * (power == order)
            conditions[3 + order, power] = factor
    return np.linalg.inv(conditions).T


def _derivative(coefficients: np.ndarray, order: int) -> np.ndarray:
    for _ in range(order):
        coefficients = coefficients[..., 1:] * np.arange(1, coefficients.shape[-1])
    return coefficients


def _values(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    return coefficients @ t ** np.arange(coefficients.shape[-1])[:, None]


class FiniteElementBeam:
    """(u phi'')'' = beta^4 u phi with u = 1 - taper s, clamped at 0, a mass at 1.

    `point_masses` are further masses at nodes, (mass, place s) each, in the unit of `mass_ratio`.
    `beta` is (modes,); `shape(s)` is (points, modes), normalised to
    int u phi^2 + mass_ratio phi(1)^2 + sum of mass phi^2 = 1 and phi(1) > 0.
    """

    def __init__(
        self, taper: float, mass_ratio: float, num_modes: int, elements: int, point_masses=()
    ):
        self.elements, h = elements, 1 / elements
        basis = _quintic()
        node, weight = np.polynomial.legendre.leggauss(8)
        node, weight = (1 + node) / 2, weight / 2
        value = _values(basis, node)
        curvature = _values(_derivative(basis, 2), node) / h**2
        size = 3 * (elements + 1)
        stiffness, mass = np.zeros((size, size)), np.zeros((size, size))
        for e in range(elements):
            u = (1 - taper * (e + node) * h) * weight * h
            place = slice(3 * e, 3 * e + 6)
            stiffness[place, place] += (curvature * u) @ curvature.T
            mass[place, place] += (value * u) @ value.T
        mass[-3, -3] += mass_ratio
        for extra, place in point_masses:
            node = 3 * round(place * elements)
            assert np.isclose(node, 3 * place * elements)
            mass[node, node] += extra
        # Freedoms are phi, h phi', h^2 phi'': equal units keep the matrices well scaled.
        lower = np.linalg.cholesky(stiffness[2:, 2:])
        half = np.linalg.solve(lower, mass[2:, 2:])
        flexibility, vectors = np.linalg.eigh(np.linalg.solve(lower, half.T))
        kept = slice(None, -num_modes - 1, -1)
        self.beta = flexibility[kept] ** -0.25
        freedoms = np.zeros((size, num_modes))
        freedoms[2:] = np.linalg.solve(lower.T, vectors[:, kept])
        freedoms /= np.sqrt(np.einsum("im,ij,jm->m", freedoms, mass, freedoms))
        self.freedoms = freedoms * np.sign(freedoms[-3])
        self.basis = basis

    def shape(self, s: np.ndarray) -> np.ndarray:
        element = np.minimum((s * self.elements).astype(int), self.elements - 1)
        t = s * self.elements - element
        local = self.freedoms[3 * element[:, None] + np.arange(6)]
        return np.einsum("fp,pfm->pm", _values(self.basis, t), local)
