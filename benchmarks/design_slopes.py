"""Derivatives of all measures of a branch beside finite differences, on random rigs.

python benchmarks/design_slopes.py              # 20 rigs, some five minutes with compiling
python benchmarks/design_slopes.py --rigs 3 --seed 5

Each rig is moved along a random direction in all of its numbers at once, by steps whose error is
extrapolated (Richardson). Where the shape of the branch is not the same at all of these (a fold or
a touch comes or goes), the rig is counted apart.
"""

import argparse
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import vibrojax as vj
from vibrojax.design.measures import NoSuchPlace
from vibrojax.design.rig_evaluator import RigEvaluator

RESULTS = Path(__file__).parent / "design_slopes.json"
RANGES = {
    "gap": (2e-4, 8e-4),
    "stiffness": (1e3, 2e4),
    "damping": (1e-3, 1.0),
    "taper": (0.0, 0.8),
    "position": (0.3, 0.9),
    "mass_ratio": (0.1, 2.0),
    "damping_ratio": (0.01, 0.04),
}
FREQUENCY = vj.Range(0.9, 1.4)
DOUBT = 1e-4
"""Most that the finite differences of both steps may differ, over their size, to count."""
STEP = 2e-4
"""Over the size of each number."""
MEASURES: dict[str, Callable[[Any], Any]] = {
    "peak amplitude": lambda r: r.peak(),
    "peak of all motions": lambda r: r.peak("rms_ratio", stable=False),
    "largest contact force": lambda r: r.peak("contact_force"),
    "largest impulse": lambda r: r.peak("impulse"),
    "largest contact fraction": lambda r: r.peak("contact_fraction"),
    "peak frequency": lambda r: r.peak_frequency(),
    "resonance shift": lambda r: r.resonance_shift("rms_ratio"),
    "amplitude at a frequency": lambda r: r.at("amplitude_ratio", 1.08),
    "force at a frequency, lower": lambda r: r.at("contact_force", 1.08, of="lower"),
    "upper fold, frequency": lambda r: r.fold_frequency(),
    "upper fold, height": lambda r: r.fold_height(),
    "lower fold, frequency": lambda r: r.fold_frequency(0),
    "lower fold, force": lambda r: r.fold_height("contact_force", 0),
    "hysteresis width": lambda r: r.hysteresis_width(),
    "bandwidth": lambda r: r.bandwidth(10.0),
    "bandwidth, lower": lambda r: r.bandwidth(8.0, of="lower"),
    "half-power bandwidth": lambda r: r.half_power_bandwidth(),
    "area": lambda r: r.area("rms_ratio"),
    "mean force in a band": lambda r: r.mean("contact_force", low=1.0, high=1.2),
    "area, lower": lambda r: r.area("amplitude_ratio", of="lower"),
}


def make(**numbers: Any) -> vj.ImpactingBeam:
    """Make the default rig with two modes."""
    return vj.default_rig(**numbers, num_modes=2)


def compared(rng: np.random.Generator, evaluator: RigEvaluator) -> dict[str, Any]:
    """Compare the derivatives of one random rig along one random direction."""
    low, high = np.array(list(RANGES.values())).T
    place = low + rng.random(len(low)) * (high - low)
    way = place * rng.choice([-1.0, 1.0], len(low)) * rng.uniform(0.3, 1.0, len(low))
    steps = STEP * np.array([0.0, 1.0, -1.0, 0.5, -0.5])
    responses = evaluator.responses(place + steps[:, None] * way)
    shapes = {response.shape for response in responses}
    found: dict[str, Any] = {"numbers": place.tolist(), "same_shape": len(shapes) == 1}
    for name, function in MEASURES.items():
        try:
            value, slopes = responses[0].differentiate(function)
            moved = [float(function(response)) for response in responses[1:]]
        except NoSuchPlace:
            continue
        exact = float(slopes @ way)
        if np.isnan(exact):
            found["unknown"] = [*found.get("unknown", []), name]
            continue
        whole, half = (
            (a - b) / (2 * s)
            for a, b, s in zip(moved[::2], moved[1::2], (STEP, STEP / 2), strict=True)
        )
        finite = half + (half - whole) / 3
        # Of what does not change, the change is over its size.
        size = max(abs(finite), 1e-3 * abs(value), 1e-12)
        found[name] = {"slope": exact, "difference": abs(exact - finite) / size}
        found[name]["doubt"] = abs(half - whole) / size
    return found


def run(rigs: int, seed: int) -> list[dict[str, Any]]:
    """Compare the derivatives of so many rigs."""
    names = tuple(RANGES)
    evaluator = RigEvaluator(
        make,
        MEASURES,
        names,
        axis="frequency_ratio",
        range=FREQUENCY,
        settings=vj.ContinuationSettings(),
        numbers={},
    )
    rng = np.random.default_rng(seed)
    return [compared(rng, evaluator) for _ in range(rigs)]


def main() -> None:
    """Run, print and record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=22)
    asked = parser.parse_args()
    begun = time.process_time()
    found = run(asked.rigs, asked.seed)
    same = [row for row in found if row["same_shape"]]
    table = {}
    for name in MEASURES:
        own = [row[name] for row in same if name in row]
        firm = [one["difference"] for one in own if one["doubt"] <= DOUBT]
        if firm:
            most = max(firm)
            counts = {"rigs": len(firm), "in_doubt": len(own) - len(firm)}
            table[name] = counts | {"median": float(np.median(firm)), "largest": most}
            words = ", ".join(f"{count} {what}" for what, count in counts.items())
            print(f"{name:30s} {words}, median {np.median(firm):.1e}, most {most:.1e}")
    unknown = [row["unknown"] for row in same if "unknown" in row]
    print(f"Said to be unknown: {unknown}")
    print(f"{len(found) - len(same)} of {len(found)} rigs change their shape within the steps")
    if asked.rigs == 20 and asked.seed == 22:
        RESULTS.write_text(
            json.dumps(
                {
                    "processor": platform.processor() or platform.machine(),
                    "processor_seconds": round(time.process_time() - begun, 1),
                    "changed_shape": len(found) - len(same),
                    "said_to_be_unknown": unknown,
                    "measures": table,
                },
                indent=1,
            )
            + "\n"
        )


if __name__ == "__main__":
    main()
