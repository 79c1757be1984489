"""Three designs by `vj.optimise`, beside a global search of 16,384 rigs and a map around each.

python experiments/design/run.py                # all three
python experiments/design/run.py --only band    # one of band, quiet, power
python experiments/design/run.py --pictures     # only draw what was computed

The global searches are those of global_search.py, which come first and take longest.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pictures
import xarray
from on_branch import OnBranch
from problems import PROBLEMS, Problem

import vibrojax as vj

sys.path.insert(0, str(Path(__file__).parents[1]))
import common

HERE = Path(__file__).parent
SETTINGS = {
    "band": vj.design.OptimiseSettings(screened=48, starts=6, max_rounds=21),
    "quiet": vj.design.OptimiseSettings(screened=32, starts=3, max_rounds=45),
    "power": vj.design.OptimiseSettings(screened=32, starts=3, max_rounds=45),
}
SEEDS = 1, 2
"""Other seeds of the designs screened, to see how much depends on them."""
SIDE = 15
"""Values along each axis of a map."""
REACH = 4.0
"""How far a map goes from the optimum, as a ratio, if the bounds let it."""
TOGETHER = 45
"""Rigs of a map that are followed side by side."""
NEAR, POINTS = 1.1, 181
"""Ratio of the numbers of rigs that are swept, and frequencies of their sweeps."""
CURVES = {"band": "amplitude_ratio", "quiet": "amplitude_ratio", "power": "mean_power"}
"""What is drawn of a rig, beside the contact force."""


def optimise(problem: Problem, settings: vj.design.OptimiseSettings) -> tuple[Any, float]:
    """Find a design; return it and the processor time that it took, s."""
    constraints = []
    if problem.constraint is not None:
        constraints.append(vj.design.Constraint(problem.constraint, most=problem.most))
    begun = time.process_time()
    found = vj.optimise(
        problem.make_system,
        problem.objective,
        variables=problem.variables,
        constraints=constraints,
        maximise=problem.maximise,
        settings=settings,
        **problem.frequency,
    )
    return found, time.process_time() - begun


def summary_of(found: Any, seconds: float) -> dict[str, Any]:
    """What is kept of an optimum."""
    return {
        "numbers": found.numbers,
        "value": found.value,
        "constraint": next(iter(found.constraints.values()), None),
        "held_by": list(found.active),
        "status": found.status,
        "sentence": found.sentence,
        "first_value": found.first_value,
        "curves": found.evaluations + 2,  # those of the first and of the best rig, for the result
        "processor_seconds": round(seconds, 1),
        "ends": [{"value": e.value, "status": e.status, **e.numbers} for e in found.ends],
        "next_to_it": [
            {
                n.name: n.number,
                "value": n.value,
                "constraint": next(iter(n.constraints.values()), 0),
            }
            for n in found.neighbours
        ],
    }


def axis_around(best: float, low: float, high: float) -> np.ndarray:
    """Values around the best one, which is one of them, within the bounds."""
    ends = max(low, best / REACH), min(high, best * REACH)
    values = np.geomspace(*ends, SIDE)
    values[np.argmin(np.abs(np.log(values / best)))] = best
    return values


class Swept:
    """Stands for a `Response` in an objective: the highest settled motion of sweeps both ways."""

    def __init__(self, curves: xarray.Dataset, axis: str):
        self.x, self.curves = curves[axis].values, curves

    def _top(self, variable: str) -> np.ndarray:
        settled = (self.curves["status"] == 0) & (self.curves["period"] == 1)
        return np.nan_to_num(self.curves[variable].where(settled).max("direction").values)

    def peak(self, variable: str = "amplitude_ratio") -> float:
        return float(self._top(variable).max())

    def mean(self, variable: str) -> float:
        return float(np.trapezoid(self._top(variable), self.x) / np.ptp(self.x))

    def half_power_bandwidth(self, variable: str = "amplitude_ratio") -> float:
        fine = np.linspace(self.x[0], self.x[-1], 20_001)
        y = np.interp(fine, self.x, self._top(variable))
        return float(np.mean(y >= y.max() / np.sqrt(2.0)) * np.ptp(self.x))


def values_of(problem: Problem, response: Any) -> tuple[float, float]:
    """Objective and constraint, the latter 0 where there is none."""
    bounded = 0.0 if problem.constraint is None else problem.constraint(response)
    return float(problem.objective(response)), float(bounded)


def map_around(problem: Problem, numbers: dict[str, float]) -> dict[str, Any]:
    """Take objective and constraint of rigs all around a design, from points of their branches."""
    axes = {n: axis_around(numbers[n], *problem.variables[n]) for n in problem.map_axes}
    others = {n: v for n, v in numbers.items() if n not in axes}
    x, y = problem.map_axes
    both = [grid.ravel() for grid in np.meshgrid(axes[x], axes[y], indexing="ij")]
    found, begun = [], time.process_time()
    for k in range(0, len(both[0]), TOGETHER):
        some = {n: values[k : k + TOGETHER] for n, values in zip((x, y), both, strict=True)}
        branches = vj.continue_response(
            problem.make_system, design=vj.zipped(**some), **others, **problem.frequency
        )
        found += [values_of(problem, OnBranch(branch)) for branch in branches]
    value, bounded = np.array(found).T.reshape(2, SIDE, SIDE)
    sought = value if problem.maximise else -value
    fits = np.isfinite(value) & (bounded <= 1.002 * problem.most)
    i, j = np.unravel_index(np.argmax(np.where(fits, sought, -np.inf)), value.shape)
    k, m = (int(np.flatnonzero(axes[n] == numbers[n])[0]) for n in problem.map_axes)
    return {
        x: axes[x].tolist(),
        y: axes[y].tolist(),
        "value": value.tolist(),
        "constraint": bounded.tolist(),
        "best": {x: float(axes[x][i]), y: float(axes[y][j]), "value": float(value[i, j])},
        "steps_apart": [int(abs(i - k)), int(abs(j - m))],
        "at_optimum": float(value[k, m]),
        "processor_seconds": round(time.process_time() - begun, 1),
    }


def sweeps_around(problem: Problem, numbers: dict[str, float]) -> dict[str, Any]:
    """Sweep the design and eight rigs around it, both ways: a map by marches that settle.

    So nothing of it is what the design was found by.
    """
    axes = {}
    for name in problem.map_axes:
        low, high = problem.variables[name]
        near = np.clip(np.array([1 / NEAR, 1.0, NEAR]) * numbers[name], low, high)
        axes[name] = np.unique(near)
    others = {n: v for n, v in numbers.items() if n not in axes}
    ((axis, along),) = problem.frequency.items()
    frequencies = {axis: np.linspace(along.low, along.high, POINTS)}
    maps = vj.parameter_map(problem.make_system, **axes, **others, **frequencies, progress=False)
    rows = []
    for place in np.ndindex(*(len(values) for values in axes.values())):
        own = dict(zip(axes, place, strict=True))
        value, bounded = values_of(problem, Swept(maps.isel(own), axis))
        rig = {name: float(axes[name][k]) for name, k in own.items()}
        rows.append(rig | {"value": value, "constraint": bounded})
    at = [row for row in rows if all(row[n] == numbers[n] for n in axes)]
    other = (maps["status"] != 0) | (maps["period"] != 1)
    return {
        "at_optimum": at[0]["value"],
        "constraint_at_optimum": at[0]["constraint"],
        "share_not_of_the_drive_period": float(other.mean()),
        "rigs": rows,
    }


def branch_of(response: Any, variable: str) -> dict[str, list[Any]]:
    """The curves of a response, to be drawn."""
    branch = response.branch
    found = {"x": branch.values.tolist(), "stable": branch.stable.tolist()}
    for name in (variable, "contact_force"):
        found[name] = np.asarray(getattr(branch, name)).tolist()
    return found


def study(name: str) -> None:
    """Find a design, compare it, and write what was found."""
    problem, settings = PROBLEMS[name], SETTINGS[name]
    fields = {k: getattr(settings, k) for k in ("screened", "starts", "max_rounds")}
    others = []
    for seed in SEEDS:  # first: they compile what is timed afterwards
        own = summary_of(*optimise(problem, vj.design.OptimiseSettings(**fields, seed=seed)))
        keys = ("value", "constraint", "status", "curves", "processor_seconds", "numbers")
        others.append({"seed": seed} | {key: own[key] for key in keys})
        print(others[-1], flush=True)
    found, seconds = optimise(problem, settings)
    print(name, found, f"{seconds:.1f} s", sep="\n", flush=True)
    (HERE / "pictures").mkdir(exist_ok=True)
    found.plot().savefig(HERE / "pictures" / f"optimum_{name}.png", dpi=100)
    both = {"first": found.first_response, "best": found.response}
    curves = {rig: branch_of(response, CURVES[name]) for rig, response in both.items()}
    path = HERE / "results" / f"{name}.json"
    summary = {"title": problem.title, "unit": problem.unit, **summary_of(found, seconds)}
    summary |= {"settings": fields, "other_seeds": others}
    common.write_json(path, summary)
    around = map_around(problem, found.numbers)
    summary["map"] = {k: around[k] for k in ("best", "steps_apart", "at_optimum")}
    summary["map"] |= {"rigs": SIDE**2, "processor_seconds": around["processor_seconds"]}
    common.write_json(path, summary)
    common.write_json(HERE / "results" / f"drawn_{name}.json", curves | {"map": around})
    print(summary["map"], flush=True)
    summary["sweeps"] = sweeps_around(problem, found.numbers)
    common.write_json(path, summary)
    print(summary["sweeps"], flush=True)


def compare() -> None:
    """Put the designs beside the best of the global searches: results.json and table.md."""
    rows = {}
    for name, problem in PROBLEMS.items():
        path, other = (HERE / "results" / f"{n}.json" for n in (name, f"global_{name}"))
        if not (path.exists() and other.exists()):
            continue
        own, everywhere = json.loads(path.read_text()), json.loads(other.read_text())
        best = everywhere["best"][0]["value"]
        gain = (own["value"] - best) * (1 if problem.maximise else -1) / abs(best)
        curves, seconds = own["curves"], own["processor_seconds"]
        rows[name] = {
            "design": problem.title,
            "unit": problem.unit,
            "best of the global search": best,
            "vj.optimise": own["value"],
            "better by": gain,
            "curves of the search": everywhere["rigs"],
            "curves of vj.optimise": curves,
            "seconds of the search": everywhere["processor_seconds"],
            "seconds of vj.optimise": seconds,
            "within 0.5 % or better": bool(gain >= -0.005),
            "at most 1/50 of the curves": bool(50 * curves <= everywhere["rigs"]),
            "under 60 s": bool(seconds < 60),
        }
    common.write_json(HERE / "results" / "results.json", rows)
    lines = [
        "| design | best of the global search | vj.optimise | better by | curves | "
        "processor time (s) |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows.values():
        a, b = (row[f"curves of {who}"] for who in ("the search", "vj.optimise"))
        s, t = (row[f"seconds of {who}"] for who in ("the search", "vj.optimise"))
        values = [f"{row[k]:.5g}" for k in ("best of the global search", "vj.optimise")]
        lines.append(
            f"| {row['design']} ({row['unit']}) | {values[0]} | {values[1]} | "
            f"{100 * row['better by']:.2f} % | {a} / {b} | {s:.0f} / {t:.0f} |"
        )
    (HERE / "results" / "table.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


def main() -> None:
    """Compute what is asked for, then write the table and draw the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=PROBLEMS, help="one problem")
    parser.add_argument("--pictures", action="store_true", help="only draw what was computed")
    asked = parser.parse_args()
    names = [asked.only] if asked.only else list(PROBLEMS)
    for name in names if not asked.pictures else ():
        study(name)
    compare()
    for name in names:
        pictures.draw(name)


if __name__ == "__main__":
    main()
