"""Continuation: speed of the batched balance, of exact points, and one whole curve beside peers.

    python benchmarks/continuation.py [--peers] [--json FILE]

Compile and run apart; every number is the best of three runs of what was compiled. The peers
(AUTO-07p, NLvib under Octave, stepped scipy) are those of continuation_peers.py, where installed.
"""

import argparse
import json
import platform
import time

import jax
import numpy as np

import vibrojax as vj
from vibrojax.branches.along import frequency_paths
from vibrojax.branches.over_range import trace_over
from vibrojax.ensemble.lanes import lanes_of

BOUNDS = (0.85, 1.31)
EXACT_FOLDS = (1.226735776, 1.096506842)


def best(function, times: int = 3):
    seconds, out = [], None
    for _ in range(times):
        start = time.perf_counter()
        out = function()
        seconds.append(time.perf_counter() - start)
    return min(seconds), out


def batch(samples: int, lanes: int) -> dict:
    """Points per second over lanes that differ in gap: traced, and made exact with stability."""
    gaps = list(np.linspace(0.2e-3, 0.8e-3, lanes)) if lanes > 1 else [0.4e-3]
    paths = frequency_paths(lanes_of(vj.default_rig, {"gap": gaps}).systems, True, True)
    start_at = np.full(lanes, BOUNDS[0])

    def trace():
        return trace_over(paths, start_at, *BOUNDS, scale=1.0, samples=samples)

    start = time.perf_counter()
    traced = trace()
    compile_trace = time.perf_counter() - start
    seconds, traced = best(trace)
    points = sum(len(t.parameter) for t in traced)
    return {
        "samples": samples,
        "lanes": lanes,
        "points": points,
        "ticks_per_point": sum(t.ticks for t in traced) / points,
        "traced_per_second": points / seconds,
        "first_call": compile_trace,
    }


def exact_batch(lanes: int) -> dict:
    """Exact branches of several gaps at once: points with stability and all special points."""

    def run():
        gaps = np.linspace(0.2e-3, 0.8e-3, lanes)
        return vj.continue_response(vj.default_rig, frequency_ratio=vj.Range(*BOUNDS), gap=gaps)

    start = time.perf_counter()
    run()
    first = time.perf_counter() - start
    seconds, branches = best(run)
    points = sum(len(branch.values) for branch in branches)
    return {
        "lanes": lanes,
        "points": points,
        "solved_per_point": sum(branch.ticks for branch in branches) / points,
        "points_per_second": points / seconds,
        "first_call": first,
    }


def whole_curve() -> dict:
    """The public call on the default rig: exact points, stability, refined folds."""

    def run():
        return vj.continue_response(vj.default_rig(), frequency_ratio=vj.Range(*BOUNDS))

    start = time.perf_counter()
    run()
    first = time.perf_counter() - start
    seconds, branch = best(run)
    return {
        "name": "vibrojax continue_response",
        "seconds": seconds,
        "first_call": first,
        "points": len(branch.values),
        "folds": branch.folds.tolist(),
        "errors": np.abs(branch.folds - EXACT_FOLDS).tolist(),
        "worst_residual": float(branch.residual.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--json", default=None)
    given = parser.parse_args()
    results: dict = {
        "machine": f"{platform.processor() or platform.machine()}, jax {jax.__version__}",
        "batches": [batch(n, lanes) for n, lanes in ((128, 32), (256, 32), (128, 1))],
        "exact": exact_batch(32),
        "curve": whole_curve(),
    }
    for row in results["batches"]:
        print({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()})
    print(results["exact"])
    print(results["curve"])
    if given.peers:
        import continuation_peers

        results["peers"] = [vars(continuation_peers.measure(n, 2)) for n in continuation_peers.RUNS]
        for row in results["peers"]:
            print(row)
    if given.json:
        with open(given.json, "w") as file:
            json.dump(results, file, indent=1, default=str)


if __name__ == "__main__":
    main()
