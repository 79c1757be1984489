"""A cantilever of Euler beam elements: sparse matrices with the labels of a finite-element file."""

import numpy as np
from scipy import sparse

import vibrojax as vj

BEAM = vj.Cantilever(length=0.5, width=0.03, thickness=0.003, youngs_modulus=2.1e11, density=7800.0)


def matrices(elements=20, clamped=True):
    """K, M and labels (node, dof) of the beam, node 1 clamped or loose.

    Node 1 + k is at x/L = k/elements. Degree of freedom 3 is the deflection, 5 the rotation.
    """
    first, h = 2 * clamped, BEAM.length / elements
    rigidity = BEAM.youngs_modulus * BEAM.root_inertia
    bend = np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, 4 * h**2, -6 * h, 2 * h**2],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, 2 * h**2, -6 * h, 4 * h**2],
        ]
    )
    heavy = np.array(
        [
            [156, 22 * h, 54, -13 * h],
            [22 * h, 4 * h**2, 13 * h, -3 * h**2],
            [54, 13 * h, 156, -22 * h],
            [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
        ]
    )
    place = 2 * np.arange(elements)[:, None] + np.arange(4)
    rows, columns = np.repeat(place, 4, axis=1).ravel(), np.tile(place, (1, 4)).ravel()

    def assembled(one):
        values = np.tile(one.ravel(), elements)
        return sparse.coo_array((values, (rows, columns))).tocsc()[first:, first:]

    stiffness = assembled(bend * rigidity / h**3)
    mass = assembled(heavy * BEAM.density * BEAM.root_area * h / 420)
    nodes = np.repeat(np.arange(1, elements + 2), 2)
    labels = np.stack([nodes, np.tile([3, 5], elements + 1)], axis=1)
    return stiffness, mass, labels[first:]


def model(elements=20, damping=None):
    """The beam, held at node 1; its damping is so many seconds times the stiffness."""
    stiffness, mass, labels = matrices(elements, clamped=False)
    damping = None if damping is None else damping * stiffness
    loose = vj.model.FiniteElements(
        mass=mass, stiffness=stiffness, damping=damping, degrees_of_freedom=labels
    )
    return loose.held(nodes=[1])
