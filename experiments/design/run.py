"""Three designs by `vj.optimise`, beside a global search of 10,000 rigs and a map around each.

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
from problems import PROBLEMS, Problem

import vibrojax as vj

sys.path.insert(0, str(Path(__file__).parents[1]))
import common

HERE = Path(__file__).parent
SETTINGS = {
    "band": vj.design.OptimiseSettings(screened=64, starts=3, max_rounds=40),
    "quiet": vj.design.OptimiseSettings(screened=32, starts=3, max_rounds=45),
    "power": vj.design.OptimiseSettings(screened=32, starts=3, max_rounds=45),
}
SEEDS = 1, 2
"""Other seeds of the designs screened, to see how much hangs on them."""
SIDE = 15
"""Values along each axis of a map."""
REACH = 4.0
"""How far a map goes from the optimum, as a ratio, if the bounds let it."""
POINTS = 301
"""Frequencies of the sweeps of a map."""
CURVES = ("amplitude_ratio", "contact_force", "mean_power")


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


def map_around(problem: Problem, numbers: dict[str, float]) -> dict[str, Any]:
    """Sweep rigs all around a design, both ways, and take objective and constraint from that.

    Sweeps settle from one frequency to the next by marches: nothing of it is what the design was
    found by.
    """
    axes = {n: axis_around(numbers[n], *problem.variables[n]) for n in problem.map_axes}
    others = {n: v for n, v in numbers.items() if n not in axes}
    ((axis, along),) = problem.frequency.items()
    frequencies = {axis: np.linspace(along.low, along.high, POINTS)}
    begun = time.process_time()
    maps = vj.parameter_map(problem.make_system, **axes, **others, **frequencies, progress=False)
    seconds = time.process_time() - begun
    x, y = problem.map_axes
    value, bounded = np.full((2, len(axes[x]), len(axes[y])), np.nan)
    for i, j in np.ndindex(value.shape):
        swept = Swept(maps.isel({x: i, y: j}), axis)
        value[i, j] = problem.objective(swept)
        if problem.constraint is not None:
            bounded[i, j] = problem.constraint(swept)
    other = (maps["status"] != 0) | (maps["period"] != 1)
    fits = ~(bounded > 1.002 * problem.most)
    sought = np.where(fits, value if problem.maximise else -value, -np.inf)
    i, j = np.unravel_index(np.argmax(sought), value.shape)
    k, m = (int(np.flatnonzero(axes[n] == numbers[n])[0]) for n in problem.map_axes)
    return {
        x: axes[x].tolist(),
        y: axes[y].tolist(),
        "value": value.tolist(),
        "constraint": np.nan_to_num(bounded).tolist(),
        "best": {x: float(axes[x][i]), y: float(axes[y][j]), "value": float(value[i, j])},
        "steps_apart": [int(abs(i - k)), int(abs(j - m))],
        "at_optimum": float(value[k, m]),
        "constraint_at_optimum": float(np.nan_to_num(bounded[k, m])),
        "not_of_the_drive_period": float(other.mean()),
        "points": int(maps["status"].size),
        "processor_seconds": round(seconds, 1),
    }


def branch_of(response: Any) -> dict[str, list[Any]]:
    """The curves of a response, to be drawn."""
    branch = response.branch
    found = {"x": branch.values.tolist(), "stable": branch.stable.tolist()}
    for name in CURVES:
        if hasattr(branch, name):
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
    summary = {"title": problem.title, "unit": problem.unit, **summary_of(found, seconds)}
    summary |= {"settings": fields, "other_seeds": others}
    around = map_around(problem, found.numbers)
    kept = ("best", "steps_apart", "at_optimum", "constraint_at_optimum", "points")
    kept += ("not_of_the_drive_period", "processor_seconds")
    summary["map"] = {key: around[key] for key in kept}
    print(json.dumps(summary["map"]), flush=True)
    curves = {"first": branch_of(found.first_response), "best": branch_of(found.response)}
    common.write_json(HERE / "results" / f"{name}.json", summary)
    common.write_json(HERE / "results" / f"drawn_{name}.json", curves | {"map": around})


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
