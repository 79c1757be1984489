"""What maps cost beside the bare engine, and how they scale.

    python benchmarks/maps.py overhead     the map against the engine on the same lanes, in one run
    python benchmarks/maps.py workers      two workers of a LocalCluster against one
    python benchmarks/maps.py memory       peak memory of 1e5 and of 1e6 lanes
    python benchmarks/maps.py jumps        what it costs to ask for jumps too

Every figure is printed and kept in `maps.json`. Compilation is left out: each is run once before.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import vibrojax as vj

HERE = Path(__file__).parent
AXES = {
    "taper": np.linspace(0.0, 0.75, 4),
    "gap": np.linspace(0.2e-3, 1.0e-3, 16),
    "stiffness": np.linspace(1000.0, 10000.0, 8),
}
RATIOS = np.linspace(0.95, 1.3, 12)
SWEEP = vj.SweepSettings(refine_jumps=None)


def engine() -> float:
    """Seconds of the bare engine for the lanes of AXES, the rigs already built."""
    from vibrojax.ensemble.arguments import arguments_of
    from vibrojax.maps.rig_maker import RigMaker
    from vibrojax.stepping.prepared_rigs import prepare
    from vibrojax.sweep.swept_lanes import sweep_rigs

    maker = RigMaker(vj.default_rig, arguments_of(vj.default_rig, (), AXES))
    rigs = maker.rigs(tuple(np.arange(len(v)) for v in AXES.values()))
    plan = SWEEP.plan(maker.sample(), "frequency_ratio", RATIOS)
    started = time.perf_counter()
    sweep_rigs(plan, prepare(plan.stepper, rigs))
    return time.perf_counter() - started


def one_map(store: str | None, **settings: Any) -> float:
    """Seconds of the map of the same lanes."""
    started = time.perf_counter()
    vj.parameter_map(
        vj.default_rig, frequency_ratio=RATIOS, response=SWEEP, store=store, **settings, **AXES
    )
    return time.perf_counter() - started


def overhead() -> dict[str, Any]:
    """Engine and map in turn, three times each, the fastest of each kept."""
    with tempfile.TemporaryDirectory() as folder:
        engine()
        one_map(f"{folder}/first.zarr")
        bare, whole = [], []
        for k in range(3):
            bare.append(engine())
            whole.append(one_map(f"{folder}/{k}.zarr"))
    lanes = int(np.prod([len(v) for v in AXES.values()]))
    found = {"lanes": lanes, "points": lanes * 2 * len(RATIOS)}
    found |= {"engine_seconds": bare, "map_seconds": whole}
    return found | {"share_of_engine_rate": min(bare) / min(whole)}


def jumps() -> dict[str, Any]:
    """Maps of peaks alone and of peaks and jumps, in turn, three times each."""
    axes: dict[str, Any] = {n: AXES[n] for n in ("gap", "stiffness")}
    asked = {"peaks": ["peak_amplitude_ratio"], "jumps": ["peak_amplitude_ratio", "jump_up"]}
    seconds: dict[str, list[float]] = {name: [] for name in asked}
    for _ in range(4):
        for name, measures in asked.items():
            started = time.perf_counter()
            vj.parameter_map(
                vj.default_rig, frequency_ratio=np.linspace(0.9, 1.3, 41), measures=measures, **axes
            )
            seconds[name].append(time.perf_counter() - started)
    return {"lanes": 128, "points": 128 * 2 * 41} | {n: s[1:] for n, s in seconds.items()}


def workers() -> dict[str, Any]:
    """The same map on one and on two workers, one core each, after a map that compiles."""
    from distributed import Client, LocalCluster

    found: dict[str, Any] = {}
    for count in (1, 2):
        with (
            tempfile.TemporaryDirectory() as folder,
            LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            client.run(_one_core)
            one_map(f"{folder}/first.zarr", client=client, chunk_lanes=32)
            seconds = [
                one_map(f"{folder}/{k}.zarr", client=client, chunk_lanes=32) for k in range(2)
            ]
            found[f"seconds_of_{count}"] = seconds
    found["speed_up"] = min(found["seconds_of_1"]) / min(found["seconds_of_2"])
    return found


def _one_core(dask_worker: Any = None) -> None:
    """Hold a worker to one core, as two on one machine share it."""
    import os

    cores = sorted(os.sched_getaffinity(0))
    number = int(str(dask_worker.name)) if str(dask_worker.name).isdecimal() else 0
    os.sched_setaffinity(0, {cores[number % len(cores)]})


def oscillator(gap: Any = 1.0, stiffness: Any = 50.0) -> vj.MatrixSystem:
    """One mass on a spring with a stop: as cheap as a lane gets."""
    stop = vj.Stop(None, gap, vj.KelvinVoigt(stiffness, 0.1))
    return vj.MatrixSystem(
        [[1.0]],
        [[0.3]],
        [[1.0]],
        response_map=[1.0],
        stops=stop,
        stop_map=[[1.0]],
        drive=vj.BaseMotion(1.0),
        input_map=[1.0],
    )


def peak(lanes: int) -> dict[str, Any]:
    """Run a map of so many cheap lanes; peak memory of this process and the rate."""
    gaps = np.linspace(0.5, 1.5, lanes // 100)
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        vj.parameter_map(
            oscillator,
            frequency_ratio=0.9,
            gap=gaps,
            stiffness=np.linspace(5.0, 50.0, 100),
            response=vj.SweepSettings("forward", max_periods=100),
            measures=["peak_amplitude_ratio", "largest_contact_force"],
            store=f"{folder}/map.zarr",
        )
        seconds = time.perf_counter() - started
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {"lanes": lanes, "seconds": seconds, "peak_bytes": size}


def memory() -> dict[str, Any]:
    """Peak memory of maps ten times apart, each in a process of its own."""
    found = []
    for lanes in (100_000, 1_000_000):
        command = [sys.executable, __file__, "peak", str(lanes)]
        found.append(json.loads(subprocess.check_output(command, text=True)))
    return {"runs": found, "ratio": found[1]["peak_bytes"] / found[0]["peak_bytes"]}


def main() -> None:
    what = sys.argv[1] if len(sys.argv) > 1 else ""
    if what == "peak":
        print(json.dumps(peak(int(sys.argv[2]))))
        return
    kinds = {"overhead": overhead, "workers": workers, "memory": memory, "jumps": jumps}
    if what not in kinds:
        sys.exit(str(__doc__))
    found = kinds[what]()
    path = HERE / "maps.json"
    kept = json.loads(path.read_text()) if path.exists() else {}
    kept[what] = found
    path.write_text(json.dumps(kept, indent=1) + "\n")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
