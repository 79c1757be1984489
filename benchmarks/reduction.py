"""How long reading and reducing large finite-element models takes: python benchmarks/reduction.py.

Models are solid steel bricks of eight nodes, clamped at one end: a plate and a bar of 100,000
degrees of freedom. `python benchmarks/reduction.py 10` takes a tenth of them.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy import sparse

import vibrojax as vj

STEEL = {"youngs_modulus": 2.1e11, "poisson_ratio": 0.3, "density": 7800.0}
CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def element(size, youngs_modulus, poisson_ratio, density):
    """Stiffness and mass of a brick with linear shapes, by 2 x 2 x 2 points of Gauss."""
    shear = youngs_modulus / 2 / (1 + poisson_ratio)
    first = 2 * shear * poisson_ratio / (1 - 2 * poisson_ratio)
    elasticity = np.diag([2 * shear] * 3 + [shear] * 3)
    elasticity[:3, :3] += first
    stiffness, mass = np.zeros((2, 24, 24))
    signs, volume = 2 * CORNERS - 1, np.prod(size) / 8
    for point in signs / np.sqrt(3):
        factors = 1 + signs * point
        value = np.kron(np.prod(factors, axis=1) / 8, np.eye(3))
        other = [np.prod(np.delete(factors, d, axis=1), axis=1) for d in range(3)]
        slope = signs.T * np.array(other) / 8 * (2 / size)[:, None]
        strain = np.zeros((6, 24))
        for d in range(3):
            strain[d, d::3] = slope[d]
        for row, (d, e) in enumerate(((0, 1), (1, 2), (2, 0)), 3):
            strain[row, d::3], strain[row, e::3] = slope[e], slope[d]
        stiffness += strain.T @ elasticity @ strain * volume
        mass += density * value.T @ value * volume
    return stiffness, mass


def bricks(counts, lengths):
    """Return stiffness, mass and labels of a box of bricks, nodes counted from 1, clamped at x = 0.

    Counts and lengths are along x, y and z.
    """
    counts = np.array(counts)
    every = np.arange(np.prod(counts + 1)).reshape(counts + 1)
    nodes = [
        every[i : i + counts[0], j : j + counts[1], k : k + counts[2]].ravel()
        for i, j, k in CORNERS
    ]
    place = (3 * np.stack(nodes, axis=1)[:, :, None] + np.arange(3)).reshape(-1, 24)
    rows, columns = np.repeat(place, 24, axis=1).ravel(), np.tile(place, (1, 24)).ravel()
    labels = np.stack([np.repeat(every.ravel() + 1, 3), np.tile([1, 2, 3], every.size)], axis=1)
    stiffness, mass = (
        sparse.coo_array((np.tile(one.ravel(), len(place)), (rows, columns))).tocsc()
        for one in element(np.array(lengths) / counts, **STEEL)
    )
    elements = vj.model.FiniteElements(mass=mass, stiffness=stiffness, degrees_of_freedom=labels)
    return elements.held(nodes=every[0].ravel() + 1)


def main(part):
    thick = max(1, round(12 / part**0.5))
    models = {
        "plate": (bricks((round(105 / part), 104, 2), (0.2, 0.1, 0.002)), 4000.0),
        "bar": (bricks((200, thick, thick), (0.2, 0.012, 0.012)), 5000.0),
    }
    print(
        "| model | degrees of freedom | modes | method | frequencies | flexibility | seconds | "
        "of the processor |\n|---|---|---|---|---|---|---|---|"
    )
    for name, (elements, highest) in models.items():
        tip = elements.row(node=int(elements.degrees_of_freedom[-1, 0]), dof=3)
        size = len(elements.degrees_of_freedom)
        middle = elements.row(node=int(elements.degrees_of_freedom[size // 2, 0]), dof=3)
        for method in ("craig_bampton", "modal"):
            start, used = time.perf_counter(), time.process_time()
            found = vj.model.reduce(
                elements,
                highest_frequency=highest,
                stop_map=[tip, middle],
                response_map=tip,
                input_map=elements.base_load(dof=3),
                method=method,
            )
            seconds, used = time.perf_counter() - start, time.process_time() - used
            print(
                f"| {name} | {size:,} | {found.angular_frequency.size} | {method} | "
                f"{found.frequency_error.max():.0e} | {found.flexibility_error:.0e} | "
                f"{seconds:.0f} | {used:.0f} |",
                flush=True,
            )
    with tempfile.TemporaryDirectory() as folder:
        path, lines = Path(folder) / "K.mtx", round(1e6 / part)
        nodes = np.arange(1, lines + 1)
        table = np.stack([nodes, 0 * nodes + 3, nodes, 0 * nodes + 3, 1.0 / nodes], axis=1)
        np.savetxt(path, table, fmt="%d,%d, %d,%d, %.15e")
        start = time.perf_counter()
        vj.io.read_matrices(stiffness=path, mass=path)
        print(f"two Abaqus files of {lines:,} lines: {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0)
