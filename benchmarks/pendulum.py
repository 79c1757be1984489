"""What the elastic pendulum costs, beside diffrax and scipy, in one run on one core.

    python benchmarks/pendulum.py                    # all; some ten minutes
    python benchmarks/pendulum.py cost precision     # some parts: cost, precision, basins
    python benchmarks/pendulum.py --core 1           # on another core

The script pins itself to one core before JAX starts. Seconds are the least of several repeats
(scipy and the basin maps run once), by the clock and of the processor, to which other programs on
the core do not add; compilation is timed apart, without JAX's cache on disk. Writes
pendulum_results.json, pendulum_results.md and pendulum.png beside itself.
"""

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

PARTS = ("cost", "precision", "basins")
parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; all by default")
parser.add_argument("--core", type=int, default=0, help="core to run on")
OPTIONS = parser.parse_args()
if set(OPTIONS.parts) - set(PARTS):
    parser.error(f"parts are {', '.join(PARTS)}, got {' '.join(OPTIONS.parts)}")
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
for pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[pool] = "1"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {OPTIONS.core})
    PINNED = f"pinned to core {OPTIONS.core} of {os.cpu_count()} by sched_setaffinity"
else:
    PINNED = "not pinned: this system cannot"

import diffrax  # noqa: E402
import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402

import vibrojax as vj  # noqa: E402

jax.config.update("jax_enable_compilation_cache", False)

HERE = Path(__file__).parent
REFERENCE = HERE.parent / "tests/data/pendulum.json"
FREQUENCY, AMPLITUDE, TILT, DURATION = 5.7, 6.33e-3, 0.05, 0.3
"""Hz, m, rad and s of the reference, which are those of `default_pendulum`."""
REPEATS = 3
STEPS = (4e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)
"""s; the first is close to the limit that the damping of this pendulum sets."""
TOLERANCES = (1e-2, 1e-4, 1e-6)
BASIN_STEPS = (400, 1000)
"""Steps per drive period of the basin maps."""
SIDE = 100


def timed(run: Callable[[], Any], repeats: int = REPEATS) -> tuple[Any, dict[str, float]]:
    """Run once to compile and then some times more; what it returned, and the seconds."""

    def once():
        clock, processor = time.perf_counter(), time.process_time()
        found = jax.block_until_ready(run())
        return found, time.perf_counter() - clock, time.process_time() - processor

    _, _, first = once()
    runs = [once() for _ in range(repeats)]
    wall, processor = min(r[1] for r in runs), min(r[2] for r in runs)
    seconds = {"wall": wall, "processor": processor, "compile": max(first - processor, 0.0)}
    return runs[-1][0], seconds


def tilted(system: Any, angles: np.ndarray) -> jnp.ndarray:
    """States of the straight pendulum at rest at some angles (rad), lanes trailing."""
    links = np.ones(vj.default_pendulum().num_links)
    shape = system.modal_coordinates(links) if hasattr(system, "modal_coordinates") else links
    q = np.asarray(shape)[:, None] * angles
    return jnp.asarray(np.concatenate([q, 0 * q]))


@eqx.filter_jit
def marched(march, state, angular_frequency, periods):
    return march(state, angular_frequency, periods, False)[0]


def march_cost(system: Any, step: float, frequency: np.ndarray, seconds: float) -> dict:
    """Seconds per simulated second and lane of lanes that share a rig, about `seconds` long."""
    march = vj.LinearlyImplicit(longest_step=step).prepare(system.equations(), system.drive)
    periods = np.maximum(np.round(frequency * seconds), 1).astype(np.int32)
    state = tilted(system, np.linspace(TILT, -TILT, len(frequency)))
    arrays = jnp.asarray(2 * np.pi * frequency), jnp.asarray(periods)
    end, spent = timed(lambda: marched(march, state, *arrays))
    if not np.isfinite(end).all():
        raise RuntimeError(f"a lane diverged at a step of {step:g} s")
    simulated = float(np.sum(periods / frequency))
    return {
        "lanes": len(frequency),
        "step": step,
        "wall": spent["wall"] / simulated,
        "processor": spent["processor"] / simulated,
        "compile_seconds": spent["compile"],
    }


def costs() -> list[dict]:
    """Cost of the march for both models, lanes over 3 to 9 Hz."""
    full = vj.default_pendulum()
    rows = []
    for name, system, lanes, seconds in (
        ("17 links", full, 1, 3.0),
        ("17 links", full, 64, 1.0),
        ("17 links", full, 256, 0.5),
        ("6 modes", full.linearised(6), 64, 2.0),
        ("6 modes", full.linearised(6), 1024, 0.5),
    ):
        row = march_cost(system, 1e-4, np.linspace(3.0, 9.0, lanes), seconds)
        rows.append({"model": name, **row})
        print(f"cost {name:9s} {lanes:5d} lanes {row['processor']:.4f} s", flush=True)
    return rows


def right_hand_side(equations: Any, amplitude: float) -> Callable:
    """Equations of motion in plain numpy, for scipy (design as in `PendulumEquations`)."""
    e = jax.tree.map(np.asarray, equations)
    n, link, height = len(e.moment), float(e.link_length), float(e.limiter_height)
    face = int(np.argmax(e.facing))
    stops = [(s.side, float(s.gap), float(s.law.stiffness), float(s.law.damping)) for s in e.stops]
    omega = 2 * np.pi * FREQUENCY

    def derivative(t, state):
        q, rate = state[:n], state[n:]
        s, c = np.sin(q), np.cos(q)
        apart_c, apart_s = np.outer(c, c) + np.outer(s, s), np.outer(s, c) - np.outer(c, s)
        push = float(e.gravity) * e.moment * s - (e.inertia * apart_s) @ rate**2
        push -= e.stiffness @ q + e.damping @ rate
        push += e.moment * c * amplitude * omega**2 * np.sin(omega * t)
        across, along = link * s[:face].sum(), link * c[:face].sum()
        reach = across * c[face] + (height - along) * s[face]
        grow = np.zeros(n)
        grow[:face] = link * (c[:face] * c[face] + s[:face] * s[face])
        grow[face] = -across * s[face] + (height - along) * c[face]
        for side, gap, stiffness, damping in stops:
            depth = side * reach - gap * c[face]
            if depth > 0:
                slope = side * grow
                slope[face] += gap * s[face]
                push -= slope * max(stiffness * depth + damping * (slope @ rate), 0.0)
        return np.concatenate([rate, np.linalg.solve(e.inertia * apart_c, push)])

    return derivative


def precision() -> list[dict]:
    """Error of the bearing angle over 0.3 s of impacts, and what it cost."""
    case = json.loads(REFERENCE.read_text())["forced_5p7Hz"]
    times, angle = np.asarray(case["t"]), np.asarray(case["alpha1"])
    system = vj.default_pendulum()
    n = system.num_links
    rows = []

    def add(program, asked, lanes, spent, found, per):
        error = float(np.max(np.abs(np.asarray(found) - angle)))
        row = {"program": program, "asked": asked, "lanes": lanes, "error": error}
        row |= {"wall": spent["wall"] / per, "processor": spent["processor"] / per}
        rows.append(row | {"compile_seconds": spent["compile"]})
        print(
            f"precision {program:34s} {lanes:3d} lanes {asked:7.0e} error {error:8.1e} "
            f"{row['processor']:9.4f} s, compile {spent['compile']:.1f} s",
            flush=True,
        )

    def solved(tilt, **settings):
        state = tilt * jnp.ones(n), jnp.zeros(n)
        history = vj.simulate(
            system, frequency=FREQUENCY, duration=DURATION, samples=60, initial_state=state,
            gradient="forward", **settings,
        )  # fmt: skip
        return history.coordinates[1:, 0]

    for step in STEPS:
        method = vj.LinearlyImplicit(longest_step=step)
        found, spent = timed(lambda m=method: solved(TILT, stepper=m))
        add("vibrojax LinearlyImplicit, diffrax", step, 1, spent, found, DURATION)
        cost = march_cost(system, step, np.full(64, FREQUENCY), 2 / FREQUENCY)
        spent = {"wall": cost["wall"], "processor": cost["processor"]}
        spent["compile"] = cost["compile_seconds"]
        add("vibrojax LinearlyImplicit, march", step, 64, spent, found, 1.0)
    for tolerance in TOLERANCES:
        settings = {"solver": diffrax.Kvaerno5(), "tolerance": tolerance}
        found, spent = timed(lambda s=settings: solved(TILT, **s), repeats=2)
        add("diffrax Kvaerno5", tolerance, 1, spent, found, DURATION)
    tilts = jnp.linspace(TILT, TILT + 0.015, 16)
    settings = {"solver": diffrax.Kvaerno5(), "tolerance": 1e-4}
    batch = jax.vmap(lambda tilt: solved(tilt, **settings))
    found, spent = timed(lambda: batch(tilts), repeats=1)
    add("diffrax Kvaerno5, vmap", 1e-4, 16, spent, found[0], 16 * DURATION)
    derivative = right_hand_side(system.equations(), AMPLITUDE)
    begin = np.concatenate([np.full(n, TILT), np.zeros(n)])
    for method in ("Radau", "BDF", "LSODA"):
        for tolerance in TOLERANCES:

            def run(method=method, tolerance=tolerance):
                return solve_ivp(
                    derivative, (0.0, DURATION), begin, method, t_eval=times, rtol=tolerance,
                    atol=1e-3 * tolerance, max_step=1 / FREQUENCY / 40,
                ).y[0]  # fmt: skip

            clock, processor = time.perf_counter(), time.process_time()
            found = run()
            spent = {"wall": time.perf_counter() - clock, "compile": 0.0}
            spent["processor"] = time.process_time() - processor
            add(f"scipy {method}", tolerance, 1, spent, found, DURATION)
    return rows


def basin_maps(keep: Callable[[list[dict]], object]) -> list[dict]:
    """Maps of 100 by 100 starts of the modal model at 5.7 Hz; `keep` hears of each."""
    system = vj.default_pendulum().linearised(6)
    straight = np.asarray(tilted(system, np.ones(1)))[: system.num_modes, 0]

    def start(angle, rate):
        return angle * straight, rate * straight

    rows, maps = [], []
    for steps in BASIN_STEPS:

        def run(steps=steps):
            return vj.basins(
                system,
                frequency=FREQUENCY,
                start=start,
                angle=np.linspace(-0.14, 0.14, SIDE),
                rate=np.linspace(-4.0, 4.0, SIDE),
                units={"angle": "rad", "rate": "rad/s"},
                progress=False,
                settings=vj.BasinSettings(
                    transient=150,
                    period_tolerance=0.02,
                    stepper=vj.LinearlyImplicit(steps_per_period=steps),
                ),
            )

        clock, processor = time.perf_counter(), time.process_time()
        found = run()
        row = {
            "starts": SIDE * SIDE,
            "steps_per_period": steps,
            "wall": time.perf_counter() - clock,
            "processor": time.process_time() - processor,
            "periods_marched": float(np.mean(found.periods_marched)),
            "attractors": int(np.sum(found.share > 0)),
            "periods": [int(p) for p in found.period],
            "shares": [float(s) for s in found.share],
        }
        # Compared by their means: attractors go by share, and two of like share may change places.
        means = found.mean_displacement
        maps.append(np.where(found.attractor, means[found.attractor - 1], np.nan))
        apart = np.diff(np.unique(means)).min(initial=np.inf)
        row["mean_displacements"] = [float(m) for m in means]
        row["same"] = float(np.mean(np.abs(maps[-1] - maps[0]) < apart / 4))
        rows.append(row)
        print(f"basins {row}", flush=True)
        keep(rows)
    return rows


def tables(kept: dict) -> str:
    """Tables of all parts, for people."""
    lines = [f"Recorded {kept['machine']['when']}: {', '.join(kept['machine']['how'])}.", ""]
    if "cost" in kept:
        lines += [
            "Seconds per simulated second and lane, `LinearlyImplicit(longest_step=1e-4)`, lanes",
            "over 3 to 9 Hz that share a rig:",
            "",
            "| model | lanes | processor [s] | clock [s] | compile [s] |",
            "|---|---|---|---|---|",
        ]
        lines += [
            f"| {r['model']} | {r['lanes']} | {r['processor']:.4f} | {r['wall']:.4f} | "
            f"{r['compile_seconds']:.1f} |"
            for r in kept["cost"]
        ]
        lines.append("")
    if "precision" in kept:
        lines += [
            "Largest error of the bearing angle over 0.3 s from 0.05 rad at 5.7 Hz (17 links),",
            "against what a simulated second of a lane costs; the ratio is to the march at 1e-4 s:",
            "",
            "| program | lanes | step [s] or rtol | error [rad] | processor [s] | clock [s] | "
            "ratio | compile [s] |",
            "|---|---|---|---|---|---|---|---|",
        ]
        ours = (r for r in kept["precision"] if r["lanes"] == 64 and r["asked"] == 1e-4)
        unit = next(ours)["processor"]
        for r in kept["precision"]:
            lines.append(
                f"| {r['program']} | {r['lanes']} | {r['asked']:.0e} | {r['error']:.1e} | "
                f"{r['processor']:.3g} | {r['wall']:.3g} | {r['processor'] / unit:.3g} | "
                f"{r['compile_seconds']:.1f} |"
            )
        lines.append("")
    if "basins" in kept:
        lines += [
            "Basin map of 100 by 100 starts of the 6-mode model at 5.7 Hz (bearing angle -0.14 to",
            "0.14 rad, rate -4 to 4 rad/s), once, compiling included:",
            "",
            "| steps per period | processor [s] | clock [s] | periods per start | "
            "attractors (period: share) | starts as in the first row |",
            "|---|---|---|---|---|---|",
        ]
        for r in kept["basins"]:
            seen = ", ".join(
                f"{p or 'none'}: {s:.1%}"
                for p, s in zip(r["periods"], r["shares"], strict=True)
                if s > 0
            )
            lines.append(
                f"| {r['steps_per_period']} | {r['processor']:.0f} | {r['wall']:.0f} | "
                f"{r['periods_marched']:.0f} | "
                f"{r['attractors']} ({seen}) | {r['same']:.1%} |"
            )
        lines.append("")
    return "\n".join(lines)


def picture(rows: list[dict], path: Path) -> None:
    """Draw work against precision."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), dpi=130, layout="constrained")
    axes = figure.subplots()
    labels = dict.fromkeys((r["program"], r["lanes"]) for r in rows)
    for marker, (program, lanes) in zip("osv^DP*X", labels, strict=False):
        points = sorted(
            (r["error"], r["processor"])
            for r in rows
            if (r["program"], r["lanes"]) == (program, lanes)
        )
        errors, cost = zip(*points, strict=True)
        width = 2.5 if program.startswith("vibrojax") else 1.2
        name = f"{program}, {lanes} lane{'s' if lanes > 1 else ''}"
        axes.loglog(errors, cost, marker=marker, linewidth=width, markersize=8, label=name)
    axes.invert_xaxis()
    axes.set_xlabel("Largest error of the bearing angle [rad] (smaller to the right)", fontsize=12)
    axes.set_ylabel("Processor time per simulated second and lane [s]", fontsize=12)
    axes.set_title("Elastic pendulum, 17 links, 0.3 s of impacts at 5.7 Hz, one core", fontsize=12)
    axes.grid(which="both", alpha=0.25)
    axes.tick_params(labelsize=11)
    axes.legend(fontsize=10)
    figure.savefig(path)


def main() -> None:
    path = HERE / "pendulum_results.json"
    kept = json.loads(path.read_text()) if path.exists() else {}
    kept["machine"] = {
        "when": time.strftime("%Y-%m-%d"),
        "how": [
            PINNED,
            f"other programs on the machine (load {os.getloadavg()[0]:.1f} at the start)",
            platform.processor() or platform.machine(),
            f"Python {platform.python_version()}",
            f"jax {jax.__version__}",
        ],
    }

    def keep(part: str, rows: list[dict]) -> None:
        kept[part] = rows
        path.write_text(json.dumps(kept, indent=1) + "\n")
        (HERE / "pendulum_results.md").write_text(tables(kept))

    kinds: dict[str, Callable[[], list[dict]]] = {
        "cost": costs,
        "precision": precision,
        "basins": lambda: basin_maps(lambda rows: keep("basins", rows)),
    }
    for part in OPTIONS.parts or PARTS:
        keep(part, kinds[part]())
    if "precision" in kept:
        picture(kept["precision"], HERE / "pendulum.png")


if __name__ == "__main__":
    main()
