"""Sweeps and branches of random rigs: which of them come to an end, and whether they agree.

    python benchmarks/random_rigs.py --rigs 1000 --seed 1 --json random_rigs.json

Taper 0 to 0.95, mass ratio 0 to 10, damping ratio 0 to 0.2, base motion 1e-6 to 1e-2 m
(logarithmic), one to three stops on both sides, each with a gap of 0 to 2 mm, a stiffness of 1 to
1e7 N/m (logarithmic), a damping of 0 to 50 N s/m and a place of 0.05 to 1; 1 to 12 modes; frequency
ratio 0.6 to 2. Every number of modes and stops is compiled once: `--modes` and `--stops` choose
some of them, and `--only` goes through those of the rigs that have so many modes. The file is
written after each rig, and rigs that are in it already are not run again.

    python benchmarks/random_rigs.py --rigs 60 --modes 1 2 --stops 1 2 --steps 0.08 0.03

With `--steps` only branches are followed, in steps of up to these, and their lists of special
points compared, as well as with that of the rig whose numbers differ by round-off. With `--doubled`
those of what leaves at the first period doublings of short branches.
"""

import argparse
import inspect
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import vibrojax as vj
from vibrojax.branches import SpecialPoint

BOUNDS = vj.Range(0.6, 2.0)
RATIOS = np.linspace(0.6, 2.0, 20)
SIDES = (1, -1, 1)
SHORT, DOUBLINGS = 1500, 4
"""Most points of branches whose first so many period doublings are followed."""
OF_STOP = ("position", "gap", "stiffness", "damping")
OF_RIG = ("taper", "mass_ratio", "damping_ratio", "base_amplitude")


def random_numbers(count: int, seed: int = 1) -> list[dict[str, float]]:
    """Numbers of the default rig that are often met: for `settling.py`."""
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


def random_rigs(
    count: int, seed: int, modes: list[int], stops: list[int]
) -> list[tuple[int, int, dict[str, float]]]:
    """Numbers of modes and stops and the other numbers of rigs of all kinds."""
    random = np.random.default_rng(seed)
    rigs = []
    for _ in range(count):
        kind = int(random.choice(modes)), int(random.choice(stops))
        numbers = {
            "taper": random.uniform(0.0, 0.95),
            "mass_ratio": random.uniform(0.0, 10.0),
            "damping_ratio": random.uniform(0.0, 0.2),
            "base_amplitude": 10 ** random.uniform(-6, -2),
        }
        for k in range(kind[1]):
            numbers |= {
                f"position_{k}": random.uniform(0.05, 1.0),
                f"gap_{k}": random.uniform(0.0, 2e-3),
                f"stiffness_{k}": 10 ** random.uniform(0, 7),
                f"damping_{k}": random.uniform(0.0, 50.0),
            }
        rigs.append((*kind, numbers))
    return rigs


def maker(modes: int, stops: int) -> Callable[..., vj.ImpactingBeam]:
    """A function that makes rigs of a kind from their numbers."""

    def make(**given: Any) -> vj.ImpactingBeam:
        beam = vj.default_rig(taper=given["taper"], mass_ratio=given["mass_ratio"]).beam
        every = []
        for k in range(stops):
            place, gap, stiffness, damping = (given[f"{name}_{k}"] for name in OF_STOP)
            law = vj.KelvinVoigt(stiffness, damping)
            every.append(vj.Stop(position=place, gap=gap, law=law, side=SIDES[k]))
        return vj.ImpactingBeam(
            beam=beam,
            stops=tuple(every),
            drive=vj.BaseMotion(amplitude=given["base_amplitude"]),
            damping_ratio=given["damping_ratio"],
            num_modes=modes,
        )

    names = [*OF_RIG, *(f"{name}_{k}" for k in range(stops) for name in OF_STOP)]
    kind = inspect.Parameter.KEYWORD_ONLY
    parameters = [inspect.Parameter(name, kind) for name in names]
    setattr(make, "__signature__", inspect.Signature(parameters))  # noqa: B010
    return make


def measure(make: Callable[..., vj.ImpactingBeam], numbers: dict[str, float]) -> dict[str, Any]:
    """Sweep a rig, follow its branch, and compare the two."""
    rig = make(**numbers)
    settings = vj.SweepSettings(refine_jumps=None)
    started = time.perf_counter()
    sweep = vj.frequency_sweep(rig, frequency_ratio=RATIOS, settings=settings, progress=False)
    between = time.perf_counter()
    branch = vj.continue_response(rig, frequency_ratio=BOUNDS)
    ended = time.perf_counter()
    status = Counter(vj.Status(value).name for value in np.ravel(sweep.status).tolist())
    row: dict[str, Any] = numbers | {
        "sweep": dict(status),
        "branch": branch.status,
        "sentence": branch.sentence,
        "points": len(branch.values),
        "touching": int(np.sum(branch.contacts_per_period > 0)),
        "inexact": int(np.sum(~branch.exact_points)),
        "unrefined": sum(not point.refined for point in branch.special_points),
        "special": dict(Counter(point.kind for point in branch.special_points)),
        "sweep_seconds": between - started,
        "branch_seconds": ended - between,
    }
    if len(branch.values) > 1:
        on = branch.compare(sweep)["on_branch"].values
        row |= {"compared": int(np.sum(on >= 0)), "on_branch": int(np.sum(on == 1))}
        if (on == 0).any() and branch.status == "completed":
            # What a sweep settles on beside the branch should be on an isola.
            wider = vj.continue_response(rig, frequency_ratio=BOUNDS, isolas=True)
            on = wider.compare(sweep)["on_branch"].values
            row |= {"isolas": len(wider.isolas)}
        row |= {"on_any": int(np.sum(on == 1))}
    return row


def differing(
    one: tuple[SpecialPoint, ...], other: tuple[SpecialPoint, ...]
) -> list[tuple[str, float]]:
    """Kinds and places of the special points of one of two branches that the other lacks."""
    found = []
    for own, others in ((one, other), (other, one)):
        left = list(others)
        for point in own:
            same = [
                each
                for each in left
                if each.kind == point.kind and abs(each.parameter / point.parameter - 1) < 1e-7
            ]
            if same:
                left.remove(same[0])
            else:
                found.append((point.kind, point.parameter))
    return found


Rigs = list[tuple[int, int, dict[str, float]]]
Lists = Iterator[tuple[str, list[list[SpecialPoint]]]]


def compare(every: Lists) -> None:
    """Say which special points differ: of each case with those that are to be the same."""
    different = number = total = unrefined = 0
    for words, (first, *others) in every:
        apart = [differing(first, other) for other in others]
        number, total = number + 1, total + len(first)
        unrefined += sum(not point.refined for point in first)
        if any(apart):
            different += 1
            print(words, apart, flush=True)
    print(f"{different} of {number} differ; {unrefined} of {total} points are unrefined")


def lists_of_branches(rigs: Rigs, chosen: list[int], steps: list[float]) -> Lists:
    """Special points of branches in several steps, and of rigs that differ by round-off."""
    for k in chosen:
        modes, stops, numbers = rigs[k]
        make = maker(modes, stops)
        moved = numbers | {name: numbers[name] * (1 + 3e-16) for name in ("taper", "gap_0")}
        cases = [(numbers, steps[0]), (moved, steps[0]), *((numbers, step) for step in steps[1:])]
        yield (
            f"rig {k} modes {modes} stops {stops}",
            [
                vj.continue_response(
                    make(**own),
                    frequency_ratio=BOUNDS,
                    settings=vj.ContinuationSettings(longest_step=step),
                ).special_points
                for own, step in cases
            ],
        )


def lists_of_doubled(rigs: Rigs, chosen: list[int], steps: list[float]) -> Lists:
    """Special points of branches of the doubled period in several steps."""
    settings = [vj.ContinuationSettings(longest_step=s, max_points=SHORT) for s in steps]
    for k in chosen:
        modes, stops, numbers = rigs[k]
        rig = maker(modes, stops)(**numbers)
        branch = vj.continue_response(rig, frequency_ratio=BOUNDS, settings=settings[0])
        for i in range(min(branch.period_doublings.size, DOUBLINGS)):
            words = f"rig {k} modes {modes} stops {stops} doubling {i}"
            try:
                lists = [branch.switch(i, each).special_points for each in settings]
            except ValueError as refused:
                print(words, refused, flush=True)
                continue
            yield words, lists


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Count what became of all rigs."""
    points = Counter()
    for row in rows:
        points.update(row["sweep"])
    return {
        "rigs": len(rows),
        "sweep_points": dict(points),
        "branches": dict(Counter(row["branch"] for row in rows)),
        "all_exact": sum(row["inexact"] == 0 and row["points"] > 0 for row in rows),
        "special_points": sum(sum(row["special"].values()) for row in rows),
        "unrefined": sum(row["unrefined"] for row in rows),
        "compared": sum(row.get("compared", 0) for row in rows),
        "on_branch": sum(row.get("on_branch", 0) for row in rows),
        "on_branch_or_isola": sum(row.get("on_any", 0) for row in rows),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--modes", type=int, nargs="*", default=list(range(1, 13)))
    parser.add_argument("--stops", type=int, nargs="*", default=[1, 2, 3])
    parser.add_argument("--only", type=int, nargs="*", default=None)
    parser.add_argument("--steps", type=float, nargs="*", default=None)
    parser.add_argument("--doubled", action="store_true")
    parser.add_argument("--json", default=None)
    given = parser.parse_args()
    rigs = random_rigs(given.rigs, given.seed, given.modes, given.stops)
    chosen = [k for k, rig in enumerate(rigs) if given.only is None or rig[0] in given.only]
    if given.steps:
        lists = lists_of_doubled if given.doubled else lists_of_branches
        compare(lists(rigs, chosen, given.steps))
        return
    makers = {kind: maker(*kind) for kind in {rig[:2] for rig in rigs}}
    file = None if given.json is None else Path(given.json)
    rows = json.loads(file.read_text())["rigs"] if file is not None and file.exists() else []
    done = {row["rig"] for row in rows}
    for k in sorted(set(chosen) - done, key=lambda k: rigs[k][:2]):
        modes, stops, numbers = rigs[k]
        row = {"rig": k, "modes": modes, "stops": stops} | measure(makers[modes, stops], numbers)
        rows.append(row)
        words = ("rig", "modes", "stops", "sweep", "branch", "points", "inexact", "unrefined")
        print(*(f"{name} {row[name]}" for name in words), flush=True)
        on = row.get("on_branch"), row.get("on_any")
        print("   ", *on, "of", row.get("compared"), row["sentence"], flush=True)
        if file is not None:
            record = {"seed": given.seed, "summary": summary(rows), "rigs": rows}
            file.write_text(json.dumps(record, indent=1))
    print(json.dumps(summary(rows), indent=1))


if __name__ == "__main__":
    main()
