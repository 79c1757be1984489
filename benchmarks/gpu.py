"""The standard problem of `peers.py` on a GPU, with a thousand to a million lanes.

    python benchmarks/gpu.py               # on what JAX finds: a GPU, or else the CPU
    python benchmarks/gpu.py --most 8192   # fewer lanes
    python benchmarks/gpu.py --sweeps 4096 32768   # settled sweeps of so many rigs instead

Exact contact beside diffrax's Tsit5 and a plain Tsit5 of fixed steps under `jax.vmap`, in float64:
lane-periods/s, the error of the tip after 20 periods against exact event-driven propagation, and
what compiling takes (all at the same time). Exact contact also with lanes of 256 rigs, from states
at random, over 60 periods; its error is then against the same on the processor.

Sweeps are those of `maps.py`: four tapers, gaps and stiffnesses, twelve ratios both ways.
"""

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, NamedTuple

import diffrax
import exact_propagation as exact
import jax
import jax.numpy as jnp
import numpy as np
import ours
import peers

import vibrojax as vj
from vibrojax.ensemble.arguments import arguments_of
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.stepping.prepared_rigs import prepare, rigs_of
from vibrojax.sweep.swept_lanes import sweep_rigs

LANES = (1024, 8192, 65536, 2**20)
JUDGED = 32
"""Lanes whose error is looked at."""
PROBLEM = exact.rigs()["default"]
TIP = np.asarray(PROBLEM.shape_at_tip)
MANY = "exact contact, 256 rigs"


class Case(NamedTuple):
    """A program of tips after so many periods, and what it is called with."""

    name: str
    asked: float
    """Accuracy, tolerance or steps a period."""
    lanes: int
    periods: int
    program: Callable[..., Any]
    arguments: tuple[Any, ...]
    """Lanes along the last axis of each array, the drive frequencies (rad/s) last."""


def on_host() -> Any:
    return jax.default_device(jax.local_devices(backend="cpu")[0])


def marched(periods: int) -> Callable[..., Any]:
    def tips(march, start, omega):
        count = jnp.full(omega.shape, periods, jnp.int32)
        return TIP @ march(start, omega, count, False)[0][: TIP.size]

    return tips


def exact_contact(lanes: int, accuracy: float) -> Case:
    """The bare loop, from rest."""
    with on_host():
        march = jax.tree.map(np.asarray, ours.march(PROBLEM, vj.ExactContact(accuracy)))
    start, omega = np.zeros((2 * TIP.size, lanes)), peers.standard_frequencies(PROBLEM, lanes)
    return Case("exact contact", accuracy, lanes, 20, marched(20), (march, start, omega))


def of_many_rigs(lanes: int, accuracy: float) -> Case:
    """The bare loop with 16 gaps and 16 stiffnesses, from displacements in the first mode."""
    gaps, laws = np.linspace(0.2e-3, 1e-3, 16), np.linspace(1e3, 1e4, 16)
    rng, w = np.random.default_rng(0), PROBLEM.angular_frequency[0]
    with on_host():
        rig = jax.vmap(lambda gap, k: vj.default_rig(gap=gap, stiffness=k, num_modes=TIP.size))
        rigs = rigs_of(rig(*(a.ravel() for a in np.meshgrid(gaps, laws))))
        rigs = jax.tree.map(np.asarray, prepare(vj.ExactContact(accuracy), rigs).march)
    which, omega = rng.integers(0, 256, lanes), rng.choice(np.linspace(0.95, 1.3, 16), lanes) * w
    size, angle = 1e-3 * rng.uniform(0.3, 2, lanes), rng.uniform(0, 2 * np.pi, lanes)
    start = np.zeros((2 * TIP.size, lanes))
    start[0], start[TIP.size] = size * np.cos(angle), -w * size * np.sin(angle)
    march = jax.tree.map(lambda a: a[..., which], rigs)
    return Case(MANY, accuracy, lanes, 60, marched(60), (march, start, omega))


def in_diffrax(lanes: int, tolerance: float) -> Case:
    """diffrax's Tsit5, each lane with its own steps."""
    program = peers.diffrax_program(PROBLEM, 20, "Tsit5", 50.0)

    def tips(omega):
        return program(omega, tolerance)[:, -1]

    omega = peers.standard_frequencies(PROBLEM, lanes)
    return Case("diffrax Tsit5", tolerance, lanes, 20, tips, (omega,))


def fixed_steps(lanes: int, steps: float) -> Case:
    """Tsit5 of so many steps a period."""
    field, tip = peers.vector_field(PROBLEM)
    table, count = diffrax.Tsit5.tableau, round(steps)

    def along(row, slopes):
        return sum(float(a) / count * k for a, k in zip(row, slopes, strict=True) if a)

    def step(t, x, drive):
        slopes = [field(t, x, drive)]
        for c, row in zip(table.c[:-1], table.a_lower[:-1], strict=True):
            slopes.append(field(t + float(c) / count, x + along(row, slopes), drive))
        return x + along(table.a_lower[-1], slopes)

    def lane(drive):
        def go(k, x):
            return step(k / count, x, drive)

        return jax.lax.fori_loop(0, count * 20, go, jnp.zeros_like(tip)) @ tip

    omega = peers.standard_frequencies(PROBLEM, lanes)
    return Case("Tsit5 of fixed steps", steps, lanes, 20, jax.vmap(lane), (omega,))


MAKERS = {
    exact_contact: (1e-6,),
    of_many_rigs: (1e-6,),
    in_diffrax: (1e-3, 1e-6),
    fixed_steps: (400, 1600),
}


def all_cases(most: int) -> list[Case]:
    return [
        make(lanes, asked)
        for make, choices in MAKERS.items()
        for asked in choices
        for lanes in LANES
        if lanes <= most
    ]


def lowered(case: Case) -> Any:
    """Traced one after the other: tracing takes Python."""
    kinds = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype), case.arguments)
    return jax.jit(case.program).lower(*kinds)


def compiled(lowered: Any) -> tuple[Callable[..., Any], float]:
    started = time.perf_counter()
    return lowered.compile(), time.perf_counter() - started


def truth_of(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Tips of the lanes that are judged, and their sizes."""
    own = slice(None, None, case.lanes // JUDGED)
    if case.name == MANY:
        chosen = jax.tree.map(lambda a: a[..., own], case.arguments)
        with on_host():
            tips = np.asarray(jax.jit(case.program)(*chosen))
        return tips, np.full_like(tips, np.abs(tips).max())
    tips = peers.exact_tip(PROBLEM, case.arguments[-1][own], case.periods)
    return tips[:, -1], np.abs(tips).max(axis=1)


def measure(case: Case, program: Callable[..., Any], compiling: float) -> None:
    given = jax.block_until_ready(jax.device_put(case.arguments, jax.devices()[0]))
    seconds: list[float] = []
    while len(seconds) < 4 and sum(seconds) < 8:
        started = time.perf_counter()
        tips = jax.block_until_ready(program(*given))
        seconds.append(time.perf_counter() - started)
    truth, size = truth_of(case)
    error = np.abs(np.asarray(tips)[:: case.lanes // JUDGED] - truth) / size
    rate = case.lanes * case.periods / min(seconds)
    print(
        f"| {case.name} | {case.asked:g} | {case.lanes:,} | {rate:,.0f} | {error.max():.1e} | "
        f"{compiling:.0f} |",
        flush=True,
    )


def sweep(rigs: int) -> None:
    """Print the settled points/s of sweeps, and what the first of them takes, with compiling."""
    axes = {
        "taper": np.linspace(0, 0.75, 4),
        "gap": np.linspace(0.2e-3, 1e-3, 32),
        "stiffness": np.linspace(1e3, 1e4, rigs // 128),
    }
    ratios = np.linspace(0.95, 1.3, 12)
    with on_host():
        maker = RigMaker(vj.default_rig, arguments_of(vj.default_rig, (), axes))
        plan = vj.SweepSettings(refine_jumps=None).plan(maker.sample(), "frequency_ratio", ratios)
        own = maker.rigs(tuple(np.arange(len(values)) for values in axes.values()))
        prepared = jax.tree.map(np.asarray, prepare(plan.stepper, own))
    seconds = []
    for _ in range(3):
        started = time.perf_counter()
        swept = sweep_rigs(plan, prepared)
        seconds.append(time.perf_counter() - started)
    status = swept.curves["status"]
    print(
        f"| {rigs:,} | {status.size:,} | {np.mean(status == 0):.4f} | "
        f"{status.size / min(seconds[1:]):,.0f} | {seconds[0]:.0f} |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--most", type=int, default=LANES[-1], help="lanes")
    parser.add_argument("--sweeps", type=int, nargs="*", help="rigs")
    options = parser.parse_args()
    print(f"{jax.devices()[0].device_kind}, jax {jax.__version__}", flush=True)
    for rigs in options.sweeps or ():
        sweep(rigs)
    if options.sweeps:
        return
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        cases = {pool.submit(compiled, lowered(case)): case for case in all_cases(options.most)}
        for done in as_completed(cases):
            measure(cases[done], *done.result())


if __name__ == "__main__":
    main()
