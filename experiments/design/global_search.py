"""A global search by brute force: 10,000 rigs spread evenly between the bounds.

python experiments/design/global_search.py band quiet power   # 10 to 40 minutes each, on one core
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

HERE = Path(__file__).parent
RIGS, TOGETHER, BEST = 10_000, 50, 20
"""Rigs tried, those followed side by side, and those of which the exact value is computed."""


def places(problem: Problem, count: int) -> dict[str, np.ndarray]:
    """Numbers of rigs spread evenly, by their logarithm where the bounds are apart by ten times."""
    unit = scipy.stats.qmc.Sobol(len(problem.variables), seed=7).random(count)
    found = {}
    for u, (name, (low, high)) in zip(unit.T, problem.variables.items(), strict=True):
        ratio = high / low if low > 0 else 1.0
        found[name] = low * ratio**u if ratio >= 10 else low + u * (high - low)
    return found


def search(problem: Problem, count: int = RIGS) -> dict:
    """Evaluate rigs from the points of their branches, then the best of them exactly."""
    numbers = places(problem, count)
    begun, rows = time.process_time(), []
    for k in range(0, count, TOGETHER):
        some = {name: values[k : k + TOGETHER].tolist() for name, values in numbers.items()}
        branches = vj.continue_response(
            problem.make_system, design=vj.zipped(**some), **problem.frequency
        )
        for branch in branches:
            coarse = Coarse(branch)
            if not branch.completed or not coarse.parts:
                rows.append((np.nan, np.nan))
                continue
            bounded = 0.0 if problem.constraint is None else problem.constraint(coarse)
            rows.append((float(problem.objective(coarse)), float(bounded)))
        if k % 1000 == 0:
            print(k, round(time.process_time() - begun), "s", flush=True)
    seconds = time.process_time() - begun
    value, bounded = np.array(rows).T
    fits = np.isfinite(value) & (bounded <= 1.005 * problem.most)
    cost = np.where(fits, -value if problem.maximise else value, np.inf)
    best = []
    for k in np.argsort(cost)[:BEST]:
        own = {name: float(values[k]) for name, values in numbers.items()}
        response = vj.design.respond(problem.make_system, **own, **problem.frequency)
        exact = float(problem.objective(response))
        held = 0.0 if problem.constraint is None else float(problem.constraint(response))
        if held <= problem.most:
            best.append({"numbers": own, "value": exact, "constraint": held})
    best.sort(key=lambda row: -row["value"] if problem.maximise else row["value"])
    return {
        "rigs": count,
        "not_followed": int(np.sum(~np.isfinite(value))),
        "feasible": int(fits.sum()),
        "processor_seconds": round(seconds, 1),
        "best": best,
        "numbers": {name: values.round(8).tolist() for name, values in numbers.items()}
        if count <= 100
        else {},
    }


def main() -> None:
    for name in sys.argv[1:] or PROBLEMS:
        found = search(PROBLEMS[name])
        path = HERE / "results" / f"global_{name}.json"
        path.write_text(json.dumps(found, indent=1) + "\n")
        print(name, found["processor_seconds"], found["best"][:1], flush=True)


if __name__ == "__main__":
    main()
