"""Example 03 of NLvib: two masses, one of which hits a spring. Curve, table and picture.

python experiments/nlvib_example_03/run.py
"""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import common

import vibrojax as vj

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
UNIT = 2 * np.pi  # angular frequencies as in the example; vibrojax takes Hz
FORCE = 0.1
STIFFNESS = np.array([[1.0, -1.0], [-1.0, 2.0]])
RANGE = (0.5, 0.9)
STEP = 0.03  # of the arclength, so that the curve is drawn smooth
BLUE, GREEN = "#0060a8", "#2a7f3f"

REFERENCE = {
    "largest a2": (0.93631, 5),
    "w of the largest a2": (0.7512, 4),
    "upper fold, w": (0.75563, 5),
    "lower fold, w": (0.65348, 5),
    "upper touch, w": (0.65344014, 8),
    "a2 at the upper touch": (0.57324107, 8),
    "lower touch, w": (0.58189964, 8),
    "a2 at the lower touch": (0.66152236, 8),
}
SHOWN = {"unstable: beyond doubling": None, "stable": 0.635, "unstable: beyond torus": 0.6}
"""Points of the published example whose stability it shows; None is the largest a2."""


class Found(NamedTuple):
    """What the continuation gave."""

    branch: vj.branches.Branch
    doubled: vj.branches.Branch
    rows: list[common.Row]
    stable: dict[str, bool]
    """Stability at the points of the published example."""
    at_touch: dict[float, float]
    """a2 by angular frequency, at the touches."""


def system() -> vj.MatrixSystem:
    return vj.MatrixSystem(
        np.eye(2),
        0.03 * STIFFNESS,
        STIFFNESS,
        stops=vj.Stop(position=None, gap=1.0, law=vj.KelvinVoigt(100.0)),
        stop_map=[[1.0, 0.0]],
        drive=vj.PointForce(FORCE),
        input_map=[0.0, 1.0],
        response_map=[0.0, 1.0],
    )


def a2_of(curve: Any) -> np.ndarray:
    """Amplitude of the first harmonic of mass 2; a branch has it per newton."""
    return FORCE * np.asarray(curve.first_harmonic_ratio)


def free_a2(w: float) -> float:
    """Amplitude of mass 2 without contact, m: linear."""
    receptance = np.linalg.inv(STIFFNESS * (1 + 0.03j * w) - w**2 * np.eye(2))
    return float(FORCE * np.abs(receptance[1, 1]))


def doubled_branch(branch: vj.branches.Branch) -> vj.branches.Branch:
    """Motions of twice the period, from the first period doubling that they can be traced from."""
    settings = vj.ContinuationSettings(longest_step=STEP)
    doubled = [branch.switch(k, settings) for k in reversed(range(len(branch.period_doublings)))]
    return max(doubled, key=lambda b: len(b.values))


def compute() -> Found:
    """Trace the curve and read off it what is known from elsewhere."""
    branch = vj.continue_response(
        system(),
        frequency=vj.Range(*(w / UNIT for w in RANGE)),
        settings=vj.ContinuationSettings(longest_step=STEP),
    )
    top = branch.values[np.argmax(a2_of(branch))]
    low, high = np.sort(branch.grazings) * UNIT
    fine = top + np.linspace(-1.0, 1.0, 401) * 1e-3 / UNIT
    data = branch.resample(np.concatenate([fine, [0.635 / UNIT, 0.6 / UNIT]]))
    a2 = a2_of(data)
    best = np.unravel_index(np.nanargmax(a2[:401]), a2[:401].shape)
    folds = branch.folds
    computed = {
        "largest a2": a2[best],
        "w of the largest a2": fine[best[0]] * UNIT,
        "upper fold, w": folds.max() * UNIT,
        "lower fold, w": folds[np.argmin(np.abs(folds * UNIT - high))] * UNIT,
        "upper touch, w": high,
        "a2 at the upper touch": free_a2(high),
        "lower touch, w": low,
        "a2 at the lower touch": free_a2(low),
    }
    rows = [common.Row(n, r, float(computed[n]), d) for n, (r, d) in REFERENCE.items()]
    shown = dict(zip(SHOWN, (best, (401, 0), (402, 0)), strict=True))
    stable = {name: bool(data.stable.values[at] == 1) for name, at in shown.items()}
    touches = {w: free_a2(w) for w in (low, high)}
    return Found(branch, doubled_branch(branch), rows, stable, touches)


def draw(found: Found, path: Path) -> None:
    """Draw the whole curve, and its upper end with the branch of twice the period."""
    figure, (whole, end) = plt.subplots(
        1, 2, figsize=(13, 6), layout="constrained", gridspec_kw={"width_ratios": (1.25, 1)}
    )
    curves = ((found.branch, BLUE), (found.doubled, GREEN))
    for axes in (whole, end):
        for branch, color in curves:
            y = a2_of(branch)
            common.draw_branch(axes, branch, branch.values * UNIT, y, color)
            for point in branch.special_points:
                if point.kind == "grazing":
                    continue
                w = point.parameter * UNIT
                common.mark(axes, w, common.place(branch, y, point)[1], point.kind, color)
        for w, y in found.at_touch.items():
            common.mark(axes, w, y, "grazing", BLUE)
        axes.set_xlabel("angular frequency of the force  w (rad/s)", fontsize=12)
        common.finish(axes)
    whole.set(xlim=RANGE, ylim=(0, None))
    whole.set_ylabel("first harmonic of mass 2  a2 (m)", fontsize=12)
    whole.set_title("the whole curve", fontsize=12, loc="left")
    end.set(xlim=(0.733, 0.758), ylim=(0.86, 0.96))
    end.set_title("its upper end", fontsize=12, loc="left")
    low, high = sorted(found.at_touch)
    common.label(whole, low, found.at_touch[low], f"touch {low:.4f}", (-12, 4), BLUE)
    common.label(whole, high, found.at_touch[high], f"touch and fold {high:.4f}", (16, -9), BLUE)
    for point in found.branch.special_points:
        w = point.parameter * UNIT
        _, y = common.place(found.branch, a2_of(found.branch), point)
        if point.kind == "fold" and w > 0.7:
            common.label(whole, w, y, f"fold {w:.5f}", (12, 0), BLUE)
        elif point.kind == "neimark_sacker":
            common.label(whole, w, y, f"Neimark-Sacker {w:.4f}", (-8, 22), BLUE)
    entries = common.legend_entries(("fold", "grazing", "period_doubling", "neimark_sacker"))
    colors = ((BLUE, "period 1"), (GREEN, "period 2"))
    entries += [plt.Line2D([], [], color=c, lw=3, label=words) for c, words in colors]
    figure.legend(handles=entries, loc="outside lower center", ncols=8, fontsize=11, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def as_data(branch: vj.branches.Branch) -> dict[str, Any]:
    """A branch as plain lists, in the units of the example."""
    points = [
        {"kind": p.kind, "w": round(p.parameter * UNIT, 9), "contact_force": p.contact_force}
        for p in branch.special_points
    ]
    return {
        "period": branch.period,
        "ending": branch.sentence,
        "special_points": points,
        "w": np.round(branch.values * UNIT, 9).tolist(),
        "a2": np.round(a2_of(branch), 9).tolist(),
        "stable": branch.stable.astype(int).tolist(),
        "leading_multiplier": np.round(branch.leading_multiplier, 6).tolist(),
        "contact_force": np.round(branch.contact_force, 6).tolist(),
    }


def main() -> None:
    started = time.perf_counter()
    found = compute()
    seconds = round(time.perf_counter() - started, 1)
    rows = [r._asdict() | {"difference": r.difference} for r in found.rows]
    about = {"vibrojax": vj.__version__, "seconds": seconds, "processor_s": time.process_time()}
    table = {"about": about, "rows": rows, "stable": found.stable}
    common.write_json(HERE / "results" / "table.json", table)
    branches = {"period_1": as_data(found.branch), "period_2": as_data(found.doubled)}
    common.write_json(HERE / "results" / "branches.json", branches)
    draw(found, HERE / "pictures" / "response.png")
    print(found.branch, found.doubled, common.to_markdown(found.rows), found.stable, sep="\n")
    print(f"{seconds} s")


if __name__ == "__main__":
    main()
