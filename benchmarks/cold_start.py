"""How long the first answer of a process takes, and where that time goes.

python benchmarks/cold_start.py                          every job, some six minutes
python benchmarks/cold_start.py --jobs sweep branch      some of them
python benchmarks/cold_start.py --json benchmarks/cold_start.json

Every job runs in new processes: one with an empty cache of compiled programs (a folder of its own),
and then one with the cache that the first has filled. In each the same call is made a second time.
`--times 3` does all of that three times and keeps of each the process with the shortest wait.

The seconds of tracing, lowering and XLA come from jax.monitoring. Spans within other spans (the
tracing of a function inside another one's) are taken off the outer ones, so nothing counts twice.
XLA's include the reading of programs from the cache; what was not read is "made anew".
The explorer needs `pip install ".[notebook]"`.
"""

import argparse
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PARTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowering",
    "/jax/core/compile/backend_compile_duration": "xla",
}
READ = "/jax/compilation_cache/cache_hits"
SLOW = 0.2
"""Seconds of XLA from which a program is named below the table; --json names all."""
LEFT_OUT = ("JAX_", "XLA_", "VIBROJAX_")
"""Environment variables that a user who sets nothing does not have, by how they begin."""
COLUMNS = (
    *("wait", "import", "first", "tracing", "lowering", "xla"),
    *("programs", "made_anew", "second", "new_function"),
)
TITLES = (
    *("job", "cache", "wait [s]", "import [s]", "first call [s]", "tracing [s]", "lowering [s]"),
    *("XLA [s]", "programs", "made anew", "second call [s]", "new function [s]"),
)

# The jobs. Each makes a function that gives the answer; it runs twice in a process.


def sweep() -> Callable[[], Any]:
    import numpy as np

    import vibrojax as vj

    ratios = np.linspace(0.8, 1.4, 121)
    return lambda: vj.frequency_sweep(vj.default_rig(), frequency_ratio=ratios, progress=False)


def branch() -> Callable[[], Any]:
    import vibrojax as vj

    over = vj.Range(0.85, 1.31)
    return lambda: vj.continue_response(vj.default_rig(), frequency_ratio=over)


def own_rig() -> Callable[..., Any]:
    """A function of the user's, another object at every call."""
    import vibrojax as vj

    def make(stiffness: Any, damping: Any) -> Any:
        return vj.default_rig(stiffness=stiffness, damping=damping)

    return make


def noisy_sweep() -> Any:
    """The reference's sweeps of the default rig, 94 points in both directions, with 2 % noise."""
    import numpy as np

    import vibrojax as vj

    cases = json.loads((HERE.parent / "tests" / "data" / "sweeps.json").read_text())["cases"]
    default = {"mr": 0.5, "mu": 0.5, "variant": "consistent", "lam": 0.4e-3}
    case = next(
        c for c in cases.values() if all(c["parameters"][n] == v for n, v in default.items())
    )
    up, down = case["forward"], case["backward"]
    ratio = np.array(up["ratio"] + down["ratio"])
    amplitude = np.array(up["half_pp_ratio"] + down["half_pp_ratio"])
    deviation = np.hypot(0.02 * amplitude, 0.05)
    noise = deviation * np.random.default_rng(0).standard_normal(ratio.size)
    return vj.io.MeasuredCurve(
        ratio,
        "frequency_ratio",
        amplitude=np.abs(amplitude + noise),
        amplitude_deviation=deviation,
        direction=np.repeat([1, -1], [len(up["ratio"]), len(down["ratio"])]),
    )


def identify(make: Callable[..., Any] | None = None) -> Callable[[], Any]:
    import vibrojax as vj

    measured, make = noisy_sweep(), make or own_rig()
    return lambda: vj.identify(make, measured, {"stiffness": 3000.0, "damping": 1e-4})


def periodic() -> Callable[[], Any]:
    import vibrojax as vj

    return lambda: vj.periodic_response(vj.default_rig(), frequency_ratio=1.1)


def gradient() -> Callable[[], Any]:
    import jax

    import vibrojax as vj

    def amplitude(gap: Any) -> Any:
        return vj.periodic_response(vj.default_rig(gap=gap), frequency_ratio=1.1).amplitude_ratio

    return lambda: jax.grad(amplitude)(4e-4)


def parameter_map(response: str = "sweep") -> Callable[[], Any]:
    import numpy as np

    import vibrojax as vj

    return lambda: vj.parameter_map(
        vj.default_rig,
        frequency_ratio=np.linspace(0.9, 1.3, 24),
        gap=np.linspace(0.2e-3, 0.8e-3, 8),
        response=response,
        progress=False,
    )


def folds() -> Callable[[], Any]:
    import vibrojax as vj

    over, gaps = vj.Range(0.9, 1.4), vj.Range(0.36e-3, 0.6e-3, 0.4e-3)
    return lambda: vj.fold_curves(vj.default_rig, frequency_ratio=over, gap=gaps)


def explorer() -> Callable[[], Any]:
    """What a notebook's cell does until sliders and picture are sent to the browser."""
    import vibrojax as vj

    def show() -> Any:
        view = vj.explore(
            vj.default_rig, gap=vj.Range(0.1e-3, 1e-3), stiffness=vj.Range(500, 50000)
        )
        return view.widget, view._repr_mimebundle_()

    return show


JOBS: dict[str, Callable[[], Callable[[], Any]] | None] = {
    "import": None,
    "sweep": sweep,
    "command": None,
    "branch": branch,
    "identify": identify,
    "periodic": periodic,
    "gradient": gradient,
    "map": parameter_map,
    "periodic_map": lambda: parameter_map("periodic"),
    "folds": folds,
    "explorer": explorer,
}


# Inside the new process.


class Spans:
    """What JAX reports of the time that it spends on making programs."""

    def __init__(self) -> None:
        import jax

        self.found: list[tuple[int, float, float, str, str, bool]] = []
        self._read = threading.local()
        jax.monitoring.register_event_listener(self._event)
        jax.monitoring.register_event_time_span_listener(self._span)

    def _event(self, event: str, **_: Any) -> None:
        if event == READ:  # the program whose span ends next in this thread
            self._read.now = True

    def _span(self, event: str, start: float, end: float, **facts: Any) -> None:
        part = PARTS.get(event)
        if part is None:
            return
        read = part == "xla" and getattr(self._read, "now", False)
        self._read.now = False
        name = str(facts.get("fun_name", "?"))
        self.found.append((threading.get_ident(), start, end, part, name, read))

    def take(self) -> dict[str, Any]:
        """Return seconds by part and numbers of programs since the last time.

        What compiles in the background counts too: the parts may be more than the first call.
        """
        found, self.found = sorted(self.found, key=lambda s: (s[0], s[1], -s[2])), []
        seconds = dict.fromkeys(PARTS.values(), 0.0)
        around: list[tuple[int, float, float, str, str, bool]] = []
        for span in found:
            while around and (around[-1][0] != span[0] or around[-1][2] <= span[1]):
                around.pop()
            seconds[span[3]] += span[2] - span[1]
            if around:
                seconds[around[-1][3]] -= span[2] - span[1]
            around.append(span)
        programs = [
            {"program": name, "seconds": round(end - start, 3), "read": read}
            for _, start, end, part, name, read in found
            if part == "xla"
        ]
        anew = sum(not one["read"] for one in programs)
        return {**seconds, "programs": len(programs), "made_anew": anew, "each": programs}


def seconds_of(answer: Callable[[], Any]) -> float:
    import jax

    begun = time.perf_counter()
    jax.block_until_ready(answer())
    return time.perf_counter() - begun


def inside(job: str, started: float) -> dict[str, Any]:
    """Run a job in this process, which began at `started`."""
    begun = time.perf_counter()
    import vibrojax  # noqa: F401  its time is part of the wait

    found: dict[str, Any] = {"import": time.perf_counter() - begun}
    spans, make = Spans(), JOBS[job]
    assert make is not None
    answer = make()
    found["first"] = seconds_of(answer)
    found["wait"] = time.time() - started
    found |= spans.take()
    found["second"] = seconds_of(answer)
    found["second_programs"] = spans.take()["programs"]
    if job == "identify":
        found["new_function"] = seconds_of(identify(own_rig()))
        found["new_function_programs"] = spans.take()["programs"]
    return found


# In this process.


def process(command: list[str], cache: Path) -> tuple[float, str]:
    """Run a Python process with this cache; seconds that it takes, and what it prints."""
    own = {name: value for name, value in os.environ.items() if not name.startswith(LEFT_OUT)}
    own["VIBROJAX_CACHE"] = str(cache)
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *command], env=own, stdout=subprocess.PIPE, text=True, check=True
    )
    return time.perf_counter() - begun, done.stdout


def of_import(module: str, cache: Path) -> dict[str, Any]:
    code = (
        "import time; begun = time.perf_counter(); "
        f"import {module}; print(time.perf_counter() - begun)"
    )
    wall, printed = process(["-c", code], cache)
    return {"wait": wall, "import": float(printed)}


def of_command(cache: Path) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        results = ["--output", f"{folder}/sweep.nc", "--picture", f"{folder}/sweep.png"]
        wall, _ = process(["-m", "vibrojax.cli.command", "sweep", *results], cache)
    return {"wait": wall}


def of_job(job: str, cache: Path) -> dict[str, Any]:
    _, printed = process([__file__, "--inside", job, repr(time.time())], cache)
    return json.loads(printed.splitlines()[-1])


def measured(job: str) -> list[dict[str, Any]]:
    """Rows of one job: with an empty cache, and with the one that is then full."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder)
        if job == "import":
            for module in ("jax", "vibrojax"):  # what is read from the disk is then in memory
                of_import(module, cache)
            return [
                {"job": f"import {m}", "cache": "", **of_import(m, cache)}
                for m in ("jax", "vibrojax")
            ]
        run = of_command if job == "command" else lambda cache: of_job(job, cache)
        return [{"job": job, "cache": state, **run(cache)} for state in ("empty", "filled")]


def best(job: str, times: int) -> list[dict[str, Any]]:
    every = [measured(job) for _ in range(times)]
    return [min(rows, key=lambda row: row["wait"]) for rows in zip(*every, strict=True)]


def line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def written(row: dict[str, Any]) -> str:
    """The row as one of the markdown table."""
    values = [row.get(name, "") for name in COLUMNS]
    cells = (f"{v:.2f}" if isinstance(v, float) else str(v) for v in values)
    return line((row["job"], row["cache"], *cells))


def slow_programs(rows: list[dict[str, Any]]) -> list[str]:
    """What XLA takes long for although the cache is full."""
    return [
        f"{row['job']}: {one['program']}, {one['seconds']:.2f} s, "
        f"{'read from the cache' if one['read'] else 'made anew'}"
        for row in rows
        if row["cache"] == "filled"
        for one in row.get("each", ())
        if one["seconds"] > SLOW
    ]


def machine() -> dict[str, Any]:
    """Facts of the machine, as far as the system says."""
    name, facts = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    for fact in facts.read_text().splitlines() if facts.exists() else ():
        if fact.startswith("model name"):
            name = fact.partition(":")[2].strip()
            break
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count())
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "processor": name,
        "cores": len(cores),
        "load_at_start": load,
        "system": platform.platform(),
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in ("jax", "jaxlib")},
        "date": time.strftime("%Y-%m-%d"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", nargs="+", choices=tuple(JOBS), default=tuple(JOBS))
    parser.add_argument("--times", type=int, default=1, help="how often; the shortest wait is kept")
    parser.add_argument("--json", type=Path, metavar="FILE", help="where to keep the numbers")
    parser.add_argument("--inside", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        job, started = options.inside
        print(json.dumps(inside(job, float(started))))
        return
    facts, rows = machine(), []
    print(", ".join(f"{name} {value}" for name, value in facts.items()), end="\n\n")
    print(line(TITLES), line("---" for _ in TITLES), sep="\n", flush=True)
    for job in options.jobs:
        for row in best(job, options.times):
            rows.append(row)
            print(written(row), flush=True)
    slow = slow_programs(rows)
    if slow:
        print(f"\nMore than {SLOW} s of XLA with a filled cache:", *slow, sep="\n- ")
    if options.json:
        options.json.write_text(json.dumps({"machine": facts, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
