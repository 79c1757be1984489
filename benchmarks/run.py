"""Work against precision of vibrojax and its peers, in one run on one core.

    taskset -c 0 python benchmarks/run.py            # some minutes; needs the `bench` extra
    taskset -c 0 python benchmarks/run.py --quick

Writes results.json, results.md (the table of the README) and work_precision.png beside itself. On
a machine with a GPU it is used by vibrojax and diffrax; the peers stay on the CPU.
"""

import argparse
import json
import os
import platform
from pathlib import Path

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

import exact_propagation as exact
import jax
import ours
import peers

HERE = Path(__file__).parent
PERIODS = 20


def measure(rig: str, name: str, run, accuracy: float, lanes: int) -> dict:
    problem = exact.rigs()[rig]
    drives = peers.standard_frequencies(problem, lanes)
    result = run(problem, drives, PERIODS, accuracy)
    row = {
        "rig": rig,
        "program": name,
        "lanes": lanes,
        "asked": accuracy,
        "error": peers.tip_error(problem, drives, result.tip),
        "lane_periods_per_second": lanes * PERIODS / result.seconds,
        "run_seconds": result.seconds,
        "compile_seconds": result.compile_seconds,
    }
    print(
        f"{rig:13s} {name:34s} {lanes:5d} lanes {accuracy:7.0e} error {row['error']:8.1e} "
        f"{row['lane_periods_per_second']:10.0f}/s compile {row['compile_seconds']:5.1f} s",
        flush=True,
    )
    return row


def all_rows(quick: bool) -> list[dict]:
    rows = []
    others = peers.available()
    for name, run in ours.RUNS.items():
        for accuracy in ours.ACCURACIES[name]:
            rows.append(measure("default", name, run, accuracy, 1024))
    for name, run in others.items():
        lanes = 64 if name.startswith("scipy") else 1024
        for accuracy in peers.ACCURACIES[name]:
            if not (quick and name.startswith("scipy")):
                rows.append(measure("default", name, run, accuracy, lanes))
    if quick:
        return rows
    bare = "vibrojax ExactContact, bare loop"
    for lanes in (1, 4, 16, 64, 256, 4096):
        rows.append(measure("default", bare, ours.run_bare, 1e-3, lanes))
        rows.append(measure("default", bare, ours.run_bare, 1e-6, lanes))
    for rig in exact.rigs():
        if rig != "default":
            for accuracy in (1e-3, 1e-6):
                rows.append(measure(rig, bare, ours.run_bare, accuracy, 256))
            name = "vibrojax ExponentialSplitting"
            rows.append(measure(rig, name, ours.run_splitting, 1e-3, 256))
            if "heyoka" in others:
                for accuracy in (1e-2, 1e-6):
                    rows.append(measure(rig, "heyoka", others["heyoka"], accuracy, 256))
    return rows


def table(rows: list[dict]) -> str:
    head = "| rig | program | lanes | asked | error | lane-periods/s | compile [s] |"
    lines = [head, "|---|---|---|---|---|---|---|"]
    for r in rows:
        lines.append(
            f"| {r['rig']} | {r['program']} | {r['lanes']} | {r['asked']:.0e} | "
            f"{r['error']:.1e} | {r['lane_periods_per_second']:,.0f} | "
            f"{r['compile_seconds']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def picture(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), dpi=130, layout="constrained")
    axes = figure.subplots()
    chosen = [r for r in rows if r["rig"] == "default"]
    chosen = [r for r in chosen if r["lanes"] == 1024 or r["program"].startswith("scipy")]
    programs = list(dict.fromkeys(r["program"] for r in chosen))
    for marker, program in zip("os^vDP*Xh", programs, strict=False):
        points = sorted(
            (max(r["error"], 1e-14), r["lane_periods_per_second"])
            for r in chosen
            if r["program"] == program
        )
        errors, rates = zip(*points, strict=True)
        width = 2.5 if program.startswith("vibrojax") else 1.2
        axes.loglog(errors, rates, marker=marker, linewidth=width, markersize=8, label=program)
    axes.invert_xaxis()
    axes.set_xlabel("Largest error of the tip, relative (smaller to the right)", fontsize=12)
    axes.set_ylabel("Drive periods integrated per second", fontsize=12)
    axes.set_title("Default rig, 5 modes, 1024 lanes (scipy 64), one core", fontsize=12)
    axes.grid(which="both", alpha=0.25)
    axes.tick_params(labelsize=11)
    axes.legend(fontsize=10)
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="1024 lanes only, no scipy")
    options = parser.parse_args()
    machine = {
        "processor": platform.processor() or platform.machine(),
        "device": jax.devices()[0].device_kind,
        "python": platform.python_version(),
        "jax": jax.__version__,
    }
    rows = all_rows(options.quick)
    (HERE / "results.json").write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))
    (HERE / "results.md").write_text(table(rows))
    picture(rows, HERE / "work_precision.png")


if __name__ == "__main__":
    main()
