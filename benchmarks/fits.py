"""Fits of the default rig's stiffness and damping to a noisy sweep: processor time, compiled.

python benchmarks/fits.py             every kind of fit, some two minutes
python benchmarks/fits.py --times 3   the best of three
"""

import argparse
import json
import time
from collections.abc import Callable

import numpy as np

import vibrojax as vj

NEAR = {"stiffness": 4000.0, "damping": 1e-2}
FAR = [{"stiffness": s, "damping": c} for s in (550.0, 55000.0) for c in (1e-3, 1.0)]
DRAWS = 10


def measured(seed: int) -> vj.io.MeasuredCurve:
    """Return the curve that the README fits: 46 points in each direction, 2 % of noise."""
    sweep = vj.frequency_sweep(vj.default_rig(), frequency_ratio=np.linspace(0.9, 1.35, 46))
    data = sweep.to_xarray()[["amplitude_ratio"]]
    noise = np.random.default_rng(seed).normal(size=data["amplitude_ratio"].shape)
    data["amplitude_ratio"] = data["amplitude_ratio"] * (1 + 0.02 * noise)
    found = vj.io.read_measured_curve(data)
    assert isinstance(found, vj.io.MeasuredCurve)
    return found


def best(what: Callable[[], object], times: int) -> float:
    """Return the least processor time of some runs, after one that compiles."""
    what()
    seconds = []
    for _ in range(times):
        start = time.process_time()
        what()
        seconds.append(time.process_time() - start)
    return round(min(seconds), 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=2)
    times = parser.parse_args().times
    one, many = measured(0), [measured(seed) for seed in range(DRAWS)]

    def fit(guess: dict[str, float]) -> vj.identification.Identification:
        return vj.identify(vj.default_rig, one, guess)

    found = fit(NEAR)
    table: dict[str, float | list[float]] = {
        "near guess": best(lambda: fit(NEAR), times),
        "guess off by ten": [best(lambda guess=guess: fit(guess), times) for guess in FAR],
        f"{DRAWS} draws, each by itself": best(
            lambda: vj.identify(vj.default_rig, many, NEAR, together=False), times
        ),
        "profile": [best(lambda name=name: found.profile(name), times) for name in NEAR],
        "sample": best(found.sample, times),
    }
    ends = [f.estimate | {"chi_square": f.chi_square} for f in map(fit, [NEAR, *FAR])]
    print(json.dumps({"processor seconds": table, "ends": ends}, indent=1))


if __name__ == "__main__":
    main()
