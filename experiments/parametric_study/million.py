"""A map of a million rigs at one drive frequency: its time, rate, memory and size, recorded.

python experiments/parametric_study/million.py --workers 2     a million lanes on two cores
python experiments/parametric_study/million.py --quick         about a thousandth of it
python experiments/parametric_study/million.py --plan          only what it would take

The store stays in work/ (or `--store`): the same command again continues what was interrupted, and
reads what is whole.
"""

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import workers
import xarray
from study import HERE, lanes_there, size_of

import vibrojax as vj

matplotlib.use("Agg")

RANGES = {
    "taper": (0.0, 0.9, 10),
    "mass_ratio": (0.2, 5.0, 10),
    "gap": (0.05e-3, 0.5e-3, 20),
    "position": (0.4, 0.85, 10),
    "stiffness": (300.0, 3000.0, 50),
}
RATIO = 1.15
CHUNK = 5000
"""Lanes of a chunk: 200 chunks of a million, which divide its grid evenly."""


def period(curve: dict[str, Any]) -> float:
    """Drive periods after which the motion repeats, 0 where it does not."""
    return float(np.ravel(curve["period"])[0])


def axes_of(scale: float) -> dict[str, np.ndarray]:
    """Values of every axis, fewer of each for a part of the million."""
    factor = scale ** (1 / len(RANGES))
    return {
        name: np.linspace(low, high, max(2, round(count * factor)))
        for name, (low, high, count) in RANGES.items()
    }


def make_map(store: Path, scale: float, client: Any, plan: bool = False) -> Any:
    """The million: one call. Five modes and a damping ratio of 0.018 are the rig's own."""
    axes = axes_of(scale)
    lanes = math.prod(len(values) for values in axes.values())
    return vj.parameter_map(
        vj.default_rig,
        **axes,
        num_modes=3,
        damping_ratio=0.05,
        frequency_ratio=RATIO,
        response=vj.SweepSettings("forward", max_periods=150),
        measures=["peak_amplitude_ratio", "largest_contact_force", "aperiodic_fraction", period],
        chunk_lanes=min(CHUNK, max(64, lanes // 8)),
        store=store,
        client=client,
        dry_run=plan,
    )


def summarise(dataset: xarray.Dataset) -> dict[str, Any]:
    """The million in numbers, one variable in memory at a time."""
    periods = dataset["period"].values
    force = dataset["largest_contact_force"].values
    steps = dataset["lane_steps"].values
    values, counts = np.unique(periods, return_counts=True)
    peak = dataset["peak_amplitude_ratio"]
    return {
        "lanes": int(periods.size),
        "share_that_touch": float(np.mean(force > 0)),
        "share_aperiodic": float(dataset["aperiodic_fraction"].mean()),
        "share_by_period": {
            f"{p:g}": round(n / periods.size, 6) for p, n in zip(values, counts, strict=True)
        },
        "steps": int(steps.sum()),
        "steps_of_a_lane": {
            "median": int(np.median(steps)),
            "99 %": int(np.percentile(steps, 99)),
            "most": int(steps.max()),
        },
        "peak_amplitude_ratio": [round(float(f(peak)), 4) for f in (np.min, np.max)],
        "largest_contact_force": round(float(force.max()), 4),
    }


def draw(dataset: xarray.Dataset, path: Path) -> None:
    """Draw the contact force over gap and stiffness for one rig, at four stop positions."""
    places = np.unique(np.linspace(0, dataset.sizes["position"] - 1, 4).astype(int))
    middle = {n: dataset.sizes[n] // 2 for n in ("taper", "mass_ratio")}
    slice_of = dataset.isel(middle | {"position": places}).load()
    figure = vj.plot_map(slice_of, "largest_contact_force", x="stiffness", y="gap")
    figure.savefig(path, dpi=100)


def run(output: Path, store: Path, scale: float, count: int) -> dict[str, Any]:
    """Make the map, or what is missing of it, and write its record and its picture."""
    results, drawn = output / "results", output / "pictures"
    for place in (results, drawn, store.parent):
        place.mkdir(parents=True, exist_ok=True)
    already = lanes_there(store)
    started = time.perf_counter()
    with workers.local_client(count) as client:
        between = time.perf_counter()
        dataset = make_map(store, scale, client)
        seconds = time.perf_counter() - between
        cost = workers.taken(client)
    said = summarise(dataset)
    computed = said["lanes"] - already
    print(f"{computed:,} of {said['lanes']:,} lanes computed in {seconds:.1f} s", flush=True)
    if computed:
        said["run"] = {
            "vibrojax": vj.__version__,
            "lanes_computed": computed,
            "workers": count,
            "seconds": round(seconds, 1),
            "seconds_to_start_workers": round(between - started, 1),
            "lanes_per_second": round(computed / seconds, 1),
            "store_megabytes": round(size_of(store) / 1e6, 2),
            "store_files": sum(path.is_file() for path in store.rglob("*")),
            **cost,
        }
        (results / "million.json").write_text(json.dumps(said, indent=1) + "\n")
    draw(dataset, drawn / "million.png")
    print(json.dumps(said, indent=1))
    return said


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lanes-scale", type=float, default=1.0, help="part of the million")
    parser.add_argument("--quick", action="store_true", help="the same as --lanes-scale 0.001")
    parser.add_argument("--plan", action="store_true", help="only say what it would take")
    parser.add_argument("--store", type=Path, help="Zarr store (default: in work/ here)")
    parser.add_argument("--workers", type=int, default=1, help="processes, one core each")
    parser.add_argument(
        "--output", type=Path, help="folder to write into (default: here; a part: quick/ here)"
    )
    given = parser.parse_args()
    scale = 0.001 if given.quick else given.lanes_scale
    output = given.output or (HERE if scale == 1 else HERE / "quick")
    store = given.store or output / "work" / f"million_{scale:g}.zarr"
    if given.plan:
        print(make_map(store, scale, None, plan=True))
    else:
        run(output, store, scale, given.workers)


if __name__ == "__main__":
    main()
