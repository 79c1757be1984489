"""Exact points per second along branches of a rod of many bar elements that meets an obstacle.

    python benchmarks/rod.py                       # 20 elements: 20 degrees of freedom
    python benchmarks/rod.py --elements 5 10 20 40  # how the time per point grows with them

Vadcard, Batailly, Thouverez, J. Sound Vib. 531 (2022) 116950, Table 1. Compile and run apart; the
best of five runs of what was compiled.
"""

import argparse
import time

import numpy as np
import scipy.linalg

import vibrojax as vj
from vibrojax.branches.branch import Branch

LENGTH, AREA, YOUNG, DENSITY = 0.13, 15.6e-4, 210e9, 7800.0
TURN = 2 * np.pi
RANGE = vj.Range(57000 / TURN, 75000 / TURN)


def rod(ratio: float, elements: int) -> vj.MatrixSystem:
    """Make a clamped-free rod whose tip meets an elastic obstacle.

    `ratio` is the stiffness of the obstacle over that of the rod.
    """
    size = LENGTH / elements
    stiffness, mass = np.zeros((2, elements + 1, elements + 1))
    for e in range(elements):
        at = np.ix_((e, e + 1), (e, e + 1))
        stiffness[at] += YOUNG * AREA / size * np.array([[1, -1], [-1, 1]])
        mass[at] += DENSITY * AREA * size / 6 * np.array([[2, 1], [1, 2]])
    stiffness, mass = stiffness[1:, 1:], mass[1:, 1:]
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    damping = mass @ shapes @ np.diag(2 * 0.0075 * np.sqrt(squares)) @ shapes.T @ mass
    tip = np.eye(elements)[-1]
    law = vj.KelvinVoigt(ratio * YOUNG * AREA / LENGTH)
    return vj.MatrixSystem(
        mass,
        damping,
        stiffness,
        stops=vj.Stop(None, 0.2e-3, law),
        stop_map=tip[None],
        drive=vj.PointForce(25e3),
        input_map=tip,
        response_map=tip,
    )


def followed(system: vj.MatrixSystem, settings: vj.ContinuationSettings) -> tuple[float, Branch]:
    """Follow the branch; return the seconds and it."""
    start = time.perf_counter()
    branch = vj.continue_response(system, frequency=RANGE, settings=settings)
    return time.perf_counter() - start, branch


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--elements", type=int, nargs="+", default=[20])
    parser.add_argument("--ratios", type=float, nargs="+", default=[0.4, 4.0])
    given = parser.parse_args()
    print("elements  obstacle  longest step  points  exact  first call  seconds  points/s")
    for elements in given.elements:
        for ratio in given.ratios:
            for settings in (
                vj.ContinuationSettings(),
                vj.ContinuationSettings(longest_step=0.01),
            ):
                system = rod(ratio, elements)
                first, branch = followed(system, settings)
                seconds = min(followed(system, settings)[0] for _ in range(5))
                count = len(branch.values)
                print(
                    f"{elements:8d}  {ratio:8g}  {settings.longest_step:12g}  {count:6d}  "
                    f"{branch.exact_points.sum():5d}  {first:8.1f} s  {seconds:5.2f} s  "
                    f"{count / seconds:8.0f}",
                    flush=True,
                )
