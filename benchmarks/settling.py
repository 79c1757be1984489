"""Sweeps that follow settled motions beside sweeps that march to every point, in one run.

    python benchmarks/settling.py rates           the default sweep, and 256 rigs at 24 ratios
    python benchmarks/settling.py agreement 300   random rigs: where the two differ, and how
    python benchmarks/settling.py march           the bare march, lanes alike and of different rigs

Compilation is left out of the rates: each is run once before. The random rigs are those of
`random_rigs.py`, swept over ratios of 0.7 to 1.6.
"""

import sys
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from random_rigs import random_numbers

import vibrojax as vj
from vibrojax._tools.programs import options
from vibrojax.stepping.prepared_rigs import prepare, rigs_of

WAYS = ("follow", "march")
SAME = 1e-4
"""Relative difference of amplitudes below which two points are the same."""


def swept(settle: str, ratios: np.ndarray, refine: float | None, *zipped: Any, **numbers: Any):
    """One sweep and its seconds."""
    settings = vj.SweepSettings(settle=settle, refine_jumps=refine)
    started = time.perf_counter()
    curve = vj.frequency_sweep(
        vj.default_rig,
        *zipped,
        frequency_ratio=ratios,
        settings=settings,
        progress=False,
        **numbers,
    )
    return curve, time.perf_counter() - started


def rates() -> None:
    axes = {"gap": np.linspace(0.2e-3, 1e-3, 16), "stiffness": np.geomspace(1e3, 1e4, 16)}
    cases: dict[str, Any] = {
        "default sweep, 2 x 121, jumps refined": ({}, np.linspace(0.85, 1.35, 121), 1e-4),
        "256 rigs, 2 x 24": (axes, np.linspace(0.95, 1.3, 24), None),
    }
    for name, (numbers, ratios, refine) in cases.items():
        for settle in WAYS:
            swept(settle, ratios, refine, **numbers)
            curve, seconds = min(
                (swept(settle, ratios, refine, **numbers) for _ in range(3)),
                key=lambda pair: pair[1],
            )
            marched = np.asarray(curve.periods_marched)
            print(
                f"{name:40s} {settle:7s} {seconds:6.2f} s, {marched.size / seconds:6.0f} points/s, "
                f"{(marched > 0).mean():.0%} marched",
                flush=True,
            )


def march() -> None:
    """Lane-periods/s of the bare march: from rest, and of 256 rigs from states at random."""
    frequencies = vj.default_rig().equations().linear_between_contacts.angular_frequency
    first, size, rng = frequencies[0], 2 * len(frequencies), np.random.default_rng(0)
    for lanes in (128, 1024):
        which = rng.permutation(4096)[:lanes]
        amplitude, angle = 1e-3 * rng.uniform(0.3, 2, lanes), rng.uniform(0, 2 * np.pi, lanes)
        thrown = np.zeros((size, lanes))
        thrown[0] = amplitude * np.cos(angle)
        thrown[size // 2] = -first * amplitude * np.sin(angle)
        gaps, laws = np.linspace(0.2e-3, 1e-3, 16), np.linspace(1e3, 1e4, 16)
        every = np.ones(lanes)
        cases = {
            "lanes of one rig": (5e-4 * every, 5500 * every, np.linspace(0.95, 1.25, lanes)),
            "lanes of 256 rigs": (
                gaps[which // 256],
                laws[which // 16 % 16],
                np.linspace(0.95, 1.3, 16)[which % 16],
            ),
        }
        for name, (gap, stiffness, ratios) in cases.items():
            alike = name == "lanes of one rig"
            systems = jax.vmap(lambda g, k: vj.default_rig(gap=g, stiffness=k))(gap, stiffness)
            rigs = prepare(vj.ExactContact(), rigs_of(systems))
            start, periods = (0 * thrown, 20) if alike else (thrown, 60)
            number = jnp.full(lanes, periods, jnp.int32)
            call = (rigs.march, jnp.asarray(start), jnp.asarray(ratios * first), number)
            program = jax.jit(lambda own, *numbers: own(*numbers, False)).lower(*call)
            program = program.compile(compiler_options=options())
            seconds = []
            for _ in range(6):
                started = time.process_time()
                _, rounds, _ = jax.block_until_ready(program(*call))
                seconds.append(time.process_time() - started)
            rate, each = lanes * periods / min(seconds[1:]), np.asarray(rounds) / periods
            print(
                f"{name}, {lanes}: {rate:9,.0f} lane-periods/s, {each.mean():.2f} rounds a period, "
                f"slowest {each.max():.2f}",
                flush=True,
            )


def agreement(count: int) -> None:
    ratios = np.linspace(0.7, 1.6, 46)
    rows = random_numbers(count)
    rigs = {name: [row[name] for row in rows] for name in rows[0]}
    found = {s: swept(s, ratios, None, vj.zipped(**rigs)) for s in WAYS}
    (ours, a), (theirs, b) = found["follow"], found["march"]
    x, y = np.asarray(ours.amplitude_ratio), np.asarray(theirs.amplitude_ratio)
    p, q = np.asarray(ours.period), np.asarray(theirs.period)
    periodic = q > 0
    same = (np.abs(x - y) <= SAME * y) & (p == q)
    print(f"{a:.1f} s and {b:.1f} s; {periodic.mean():.2%} of the marched points are periodic")
    print(f"same: {same.mean():.2%} of all points, {same[periodic].mean():.2%} of periodic ones")
    for rig, way, at in np.argwhere(~same & periodic):
        before = np.clip(at + (1 if way else -1), 0, len(ratios) - 1)
        print(
            f"rig {rig}, {ours.directions[way]}, ratio {ratios[at]:.3f}: "
            f"followed {x[rig, way, at]:.5f} (period {p[rig, way, at]}), "
            f"marched {y[rig, way, at]:.5f} (period {q[rig, way, at]}), "
            f"before {x[rig, way, before]:.5f} and {y[rig, way, before]:.5f}"
        )


if __name__ == "__main__":
    {"rates": rates, "agreement": agreement, "march": march}[sys.argv[1]](*map(int, sys.argv[2:]))
