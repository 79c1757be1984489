"""Complete curves over random rigs: how often the branch reaches the end of its range, and why not.

    python benchmarks/random_rigs.py --rigs 300 --json random_rigs.json

Taper 0 to 0.8, mass ratio 0 to 5, gap 0.1 to 1.5 mm, position 0.3 to 1, stiffness 500 to 50000 N/m
(logarithmic), damping ratio 0.005 to 0.05 (logarithmic); frequency ratio 0.6 to 2.
"""

import argparse
import json
import time

import numpy as np

import vibrojax as vj

BOUNDS = vj.Range(0.6, 2.0)
CLASSES = ((0.0, 10.0), (10.0, 50.0), (50.0, 200.0), (200.0, np.inf))


def random_numbers(count: int, seed: int = 1) -> list[dict[str, float]]:
    random = np.random.default_rng(seed)
    return [
        {
            "taper": random.uniform(0.0, 0.8),
            "mass_ratio": random.uniform(0.0, 5.0),
            "gap": random.uniform(0.1e-3, 1.5e-3),
            "position": random.uniform(0.3, 1.0),
            "stiffness": 10 ** random.uniform(np.log10(500), np.log10(50000)),
            "damping_ratio": 10 ** random.uniform(np.log10(0.005), np.log10(0.05)),
        }
        for _ in range(count)
    ]


def stiffness_number(rig: vj.ImpactingBeam) -> float:
    """Ks phi_1(s1)^2 / (m_1 w_1^2): how stiff the stop is to the first mode."""
    e = rig.equations()
    push = float(e.stop_map[0, 0] * e.force_map[0, 0])
    return float(rig.stops[0].law.stiffness) * push / float(e.angular_frequency[0]) ** 2


def measure(count: int, seed: int = 1, show: bool = True) -> list[dict]:
    rows = []
    for k, numbers in enumerate(random_numbers(count, seed)):
        rig = vj.default_rig(**numbers)
        start = time.perf_counter()
        branch = vj.continue_response(rig, frequency_ratio=BOUNDS)
        seconds = time.perf_counter() - start
        row = numbers | {
            "p0": stiffness_number(rig),
            "status": branch.status,
            "fallback": "fallback" in branch.sentence,
            "points": len(branch.values),
            "balance_only": int(np.sum(~branch.exact_points)),
            "folds": len(branch.folds),
            "residual": float(np.max(branch.residual, initial=0.0)),
            "ticks": branch.ticks,
            "seconds": seconds,
        }
        rows.append(row)
        if show:
            print(
                k,
                f"p0 {row['p0']:8.2f}",
                row["status"],
                branch.sentence[:90],
                row["points"],
                row["balance_only"],
                f"{seconds:.2f} s",
                flush=True,
            )
    return rows


def summary(rows: list[dict]) -> list[dict]:
    out = []
    for low, high in CLASSES:
        chosen = [r for r in rows if low <= r["p0"] < high]
        if chosen:
            done = [r for r in chosen if r["status"] == "completed"]
            out.append(
                {
                    "p0": [low, high],
                    "rigs": len(chosen),
                    "complete": len(done) / len(chosen),
                    "by_fallback": sum(r["fallback"] for r in done) / len(chosen),
                    "balance_only": sum(r["balance_only"] for r in done)
                    / max(1, sum(r["points"] for r in done)),
                    "median_seconds": float(np.median([r["seconds"] for r in chosen])),
                }
            )
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", default=None)
    given = parser.parse_args()
    rows = measure(given.rigs, given.seed)
    table = summary(rows)
    for row in table:
        print(row)
    if given.json:
        with open(given.json, "w") as file:
            json.dump({"summary": table, "rigs": rows}, file, indent=1)


if __name__ == "__main__":
    main()
