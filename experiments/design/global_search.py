"""A global search by brute force: a map of 16,384 rigs spread evenly between the bounds.

python experiments/design/global_search.py                # all three problems, some 15 minutes
python experiments/design/global_search.py band quiet     # some of them

Every rig is swept both ways over a grid of frequencies; the best of them are then evaluated
exactly.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
import scipy
from coarse import Coarse
from problems import PROBLEMS, Problem

import vibrojax as vj
from vibrojax.design.measures import NoSuchPlace

HERE = Path(__file__).parent
RIGS, TOGETHER, BEST, FREQUENCIES = 2**14, 2**11, 40, 61
"""Rigs tried, those of one map, those of which the exact value is computed, and the grid."""


def places(problem: Problem, count: int) -> dict[str, np.ndarray]:
    """Numbers of rigs spread evenly, by their logarithm where the bounds are apart by ten times."""
    unit = scipy.stats.qmc.Sobol(len(problem.variables), seed=7).random(count)
    found = {}
    for u, (name, (low, high)) in zip(unit.T, problem.variables.items(), strict=True):
        ratio = high / low if low > 0 else 1.0
        found[name] = low * ratio**u if ratio >= 10 else low + u * (high - low)
    return found


def swept(problem: Problem, numbers: dict[str, np.ndarray]) -> list[tuple[float, float]]:
    """Objective and constraint of some rigs from their settled sweeps."""
    ((axis, along),) = problem.frequency.items()
    grid = {axis: np.linspace(along.low, along.high, FREQUENCIES)}
    rigs = vj.zipped(**{name: values.tolist() for name, values in numbers.items()})
    settings = vj.SweepSettings(refine_jumps=None)
    maps = vj.parameter_map(
        problem.make_system, rigs, response=settings, measures=[], keep_curves=True, **grid
    )
    dimension = "_".join(numbers)
    rows = []
    for k in range(maps.sizes[dimension]):
        coarse = Coarse(maps.isel({dimension: k}), axis)
        bounded = 0.0 if problem.constraint is None else problem.constraint(coarse)
        rows.append((float(problem.objective(coarse)), float(bounded)))
    return rows


def search(problem: Problem, count: int = RIGS) -> dict:
    """Evaluate rigs by their sweeps, then the best of them exactly."""
    numbers = places(problem, count)
    begun, rows = time.process_time(), []
    for k in range(0, count, TOGETHER):
        rows += swept(problem, {n: values[k : k + TOGETHER] for n, values in numbers.items()})
        print(len(rows), round(time.process_time() - begun), "s", flush=True)
    seconds = time.process_time() - begun
    value, bounded = np.array(rows).T
    fits = np.isfinite(value) & (bounded <= 1.01 * problem.most)
    cost = np.where(fits, -value if problem.maximise else value, np.inf)
    best, left = [], 0
    for k in np.argsort(cost)[:BEST]:
        own = {name: float(values[k]) for name, values in numbers.items()}
        try:
            response = vj.design.respond(problem.make_system, **own, **problem.frequency)
            exact = float(problem.objective(response))
            held = 0.0 if problem.constraint is None else float(problem.constraint(response))
        except NoSuchPlace:
            left += 1
            continue
        if held <= problem.most:
            row = {"numbers": own, "value": exact, "constraint": held}
            best.append(row | {"swept": float(value[k])})
    best.sort(key=lambda row: -row["value"] if problem.maximise else row["value"])
    return {
        "rigs": count,
        "without_value": int(np.sum(~np.isfinite(value))),
        "feasible": int(fits.sum()),
        "processor_seconds": round(seconds, 1),
        "evaluated_exactly": BEST - left,
        "best": best,
    }


def main() -> None:
    for name in sys.argv[1:] or PROBLEMS:
        found = search(PROBLEMS[name])
        path = HERE / "results" / f"global_{name}.json"
        path.write_text(json.dumps(found, indent=1) + "\n")
        print(name, found["processor_seconds"], found["best"][:1], flush=True)


if __name__ == "__main__":
    main()
