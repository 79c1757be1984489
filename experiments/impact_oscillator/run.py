"""One mass on a spring that hits a second spring: its curve, and what rounding the corner does.

python experiments/impact_oscillator/run.py
"""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import matplotlib
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import common

import vibrojax as vj

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
UNIT = 2 * np.pi  # angular frequencies in the text; vibrojax takes Hz
FORCE, STIFFNESS, GAP = 0.3, 50.0, 1.0
RANGE = (0.6, 1.6)
ROUNDED_STEP = 0.01
ROUNDED_RANGE = (0.7, 1.55)
WIDTHS = (0.003, 0.01, 0.03)
"""Lengths eps of the rounded corner, m."""
LEAD = 0.6
"""How far before the gap the rounded force begins to be counted, m: its tail is long."""
SAMPLES = 512
BLUE, GREEN = "#0060a8", "#2a7f3f"
SHADES = ("#e9a13b", "#d1590a", "#8c2d04")


class RootSpring(vj.model.AbstractContactLaw):
    """k (d + sqrt(d^2 + eps^2)) / 2 with d counted from the gap, `LEAD` after the stop's own."""

    eps: float

    def force(self, penetration, rate):
        depth = penetration - LEAD
        return STIFFNESS / 2 * (depth + jnp.sqrt(depth**2 + self.eps**2))


class Found(NamedTuple):
    """What the continuation gave."""

    branch: vj.branches.Branch
    doubled: vj.branches.Branch
    rounded: list[vj.branches.Branch]
    """With the rounded spring, by width."""
    ramped: vj.branches.Branch
    """With the ramp of `Stop(smoothing=0.01)`."""
    rows: list[common.Row]


EXACT = vj.Stop(None, GAP, vj.KelvinVoigt(STIFFNESS))
RAMPED = vj.Stop(None, GAP, vj.KelvinVoigt(STIFFNESS), smoothing=0.01)


def system(stop: vj.Stop = EXACT) -> vj.MatrixSystem:
    """x'' + 0.1 x' + x + 50 max(x - 1, 0) = 0.3 cos(w t), or with another stop."""
    return vj.MatrixSystem(
        [[1.0]],
        [[0.1]],
        [[1.0]],
        stops=stop,
        stop_map=[[1.0]],
        drive=vj.PointForce(FORCE),
        input_map=[1.0],
        response_map=[1.0],
    )


def amplitude_of(curve: Any) -> np.ndarray:
    """Half of peak to peak, m; a branch has it per newton."""
    return FORCE * np.asarray(curve.amplitude_ratio)


def jump_up(branch: vj.branches.Branch) -> float:
    """Angular frequency at which a sweep downwards leaves the motion that hardly touches."""
    return float(branch.folds.min()) * UNIT


def trace_rounded(stop: vj.Stop, step: float) -> vj.branches.Branch:
    """Trace a curve whose force has no corner, by harmonic balance."""
    return vj.continue_response(
        system(stop),
        frequency=vj.Range(*(w / UNIT for w in ROUNDED_RANGE)),
        settings=vj.ContinuationSettings(
            longest_step=step, method=vj.HarmonicBalance(samples=SAMPLES)
        ),
    )


def lowest(branch: vj.branches.Branch) -> float:
    """Lowest w of the points between the two folds and on the lower branch."""
    top = int(np.argmax(branch.values * (branch.contact_force > 1.0)))
    return float(branch.values[top:].min()) * UNIT


def compute() -> Found:
    """Trace the exact curve, its doubled branch and three rounded ones."""
    branch = vj.continue_response(system(), frequency=vj.Range(*(w / UNIT for w in RANGE)))
    rounded = [
        trace_rounded(vj.Stop(None, GAP - LEAD, RootSpring(width)), ROUNDED_STEP)
        for width in WIDTHS
    ]
    ramped = trace_rounded(RAMPED, ROUNDED_STEP)
    last = len(branch.period_doublings) - 1
    doubled = branch.switch(last)
    fold = next(p for p in branch.special_points if p.kind == "fold")
    low, high = np.sort(branch.grazings) * UNIT
    rows = [
        common.Row("upper fold (jump down), w", 1.4484, fold.parameter * UNIT, 4),
        common.Row("largest x there", 1.3126, GAP + fold.contact_force / STIFFNESS, 4),
        common.Row("upper touch, w", 1.1304366, high, 7),
        common.Row("lower touch, w", 0.8438679, low, 7),
        common.Row("lower fold (jump up), w", 1.1304366, jump_up(branch), 7),
        common.Row("period doubling, w", 0.9285, branch.period_doublings[last] * UNIT, 4),
        common.Row("jump up, corner rounded, eps 0.01", 1.137, jump_up(rounded[1]), 3),
    ]
    return Found(branch, doubled, rounded, ramped, rows)


def draw_response(found: Found, path: Path) -> None:
    """Draw the whole curve, and the period doubling closely."""
    figure, (whole, close) = plt.subplots(
        1, 2, figsize=(13, 6), layout="constrained", gridspec_kw={"width_ratios": (1.25, 1)}
    )
    curves = ((found.branch, BLUE), (found.doubled, GREEN))
    for axes in (whole, close):
        for branch, color in curves:
            w = branch.values * UNIT
            common.draw_branch(axes, branch, w, amplitude_of(branch), color)
            for point in branch.special_points:
                touch = point.kind == "grazing"
                y = GAP if touch else FORCE * point.amplitude_ratio
                common.mark(axes, point.parameter * UNIT, y, point.kind, color)
        axes.set_xlabel("angular frequency of the force  w (rad/s)", fontsize=12)
        common.finish(axes)
    whole.axhline(GAP, color="0.6", lw=0.9, ls=":")
    whole.text(RANGE[1], GAP + 0.01, "gap", color="0.4", fontsize=10, ha="right", va="bottom")
    whole.set(xlim=RANGE, ylim=(0, None))
    whole.set_ylabel("half of peak to peak of x (m)", fontsize=12)
    whole.set_title("the whole curve", fontsize=12, loc="left")
    w2 = found.doubled.values * UNIT
    y2 = amplitude_of(found.doubled)
    margin, room = 0.1 * np.ptp(w2) + 5e-3, 0.15 * np.ptp(y2) + 5e-3
    close.set(xlim=(w2.min() - margin, w2.max() + margin), ylim=(y2.min() - room, y2.max() + room))
    close.set_title("motions of twice the period", fontsize=12, loc="left")
    for row, offset in zip(found.rows[:4:2], ((10, 6), (14, -14)), strict=True):
        y = GAP if "touch" in row.quantity else amplitude_of(found.branch).max()
        words = "touch and fold" if "touch" in row.quantity else "fold"
        common.label(whole, row.computed, y, f"{words} {row.computed:.4f}", offset, BLUE)
    low = found.rows[3].computed
    common.label(whole, low, GAP, f"touch {low:.4f}", (-10, 8), BLUE)
    entries = common.legend_entries(("fold", "grazing", "period_doubling"))
    colors = ((BLUE, "period 1"), (GREEN, "period 2"))
    entries += [plt.Line2D([], [], color=c, lw=3, label=words) for c, words in colors]
    figure.legend(handles=entries, loc="outside lower center", ncols=7, fontsize=11, frameon=False)
    save(figure, path)


def draw_corner(found: Found, path: Path) -> None:
    """Draw the curves near the touch for the exact corner and the rounded ones."""
    figure, axes = plt.subplots(figsize=(9, 5.6), layout="constrained")
    branches = [(found.branch, BLUE, "exact corner")]
    for branch, shade, width in zip(found.rounded, SHADES, WIDTHS, strict=True):
        branches.append((branch, shade, f"rounded, ε = {width:g} m"))
    for branch, color, words in branches:
        w, y = branch.values * UNIT, amplitude_of(branch)
        common.draw_branch(axes, branch, w, y, color)
        low = min((p for p in branch.special_points if p.kind == "fold"), key=float)
        common.mark(axes, float(low) * UNIT, common.place(branch, y, low)[1], "fold", color)
        axes.plot([], [], color=color, lw=3, label=f"{words}: jump up {jump_up(branch):.4f}")
    axes.axhline(GAP, color="0.6", lw=0.9, ls=":")
    axes.text(1.1795, GAP + 1e-3, "gap", color="0.4", fontsize=10, ha="right", va="bottom")
    axes.set(xlim=(1.125, 1.18), ylim=(0.88, 1.08))
    axes.set_xlabel("angular frequency of the force  w (rad/s)", fontsize=12)
    axes.set_ylabel("half of peak to peak of x (m)", fontsize=12)
    common.finish(axes)
    for entry in common.legend_entries(("fold",)):
        axes.add_line(entry)
    figure.legend(loc="outside lower center", ncols=3, fontsize=10.5, frameon=False)
    save(figure, path)


def save(figure: Any, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def as_data(branch: vj.branches.Branch) -> dict[str, Any]:
    """A branch as plain lists, w in rad/s."""
    points = [
        {"kind": p.kind, "w": round(p.parameter * UNIT, 9), "contact_force": p.contact_force}
        for p in branch.special_points
    ]
    return {
        "period": branch.period,
        "ending": branch.sentence,
        "special_points": points,
        "w": np.round(branch.values * UNIT, 9).tolist(),
        "amplitude": np.round(amplitude_of(branch), 9).tolist(),
        "stable": branch.stable.astype(int).tolist(),
        "leading_multiplier": np.round(branch.leading_multiplier, 6).tolist(),
        "contact_force": np.round(branch.contact_force, 6).tolist(),
    }


def main() -> None:
    started = time.perf_counter()
    found = compute()
    seconds = round(time.perf_counter() - started, 1)
    rows = [r._asdict() | {"difference": r.difference} for r in found.rows]
    jumps = {str(w): jump_up(b) for w, b in zip(WIDTHS, found.rounded, strict=True)}
    about = {"vibrojax": vj.__version__, "seconds": seconds, "processor_s": time.process_time()}
    ramp = {"reported": jump_up(found.ramped), "lowest_point": lowest(found.ramped)}
    table = {"about": about, "rows": rows, "jump_up_by_width": jumps, "ramp_0.01": ramp}
    common.write_json(HERE / "results" / "table.json", table)
    branches = {"period_1": as_data(found.branch), "period_2": as_data(found.doubled)}
    branches |= {f"rounded_{w:g}": as_data(b) for w, b in zip(WIDTHS, found.rounded, strict=True)}
    common.write_json(HERE / "results" / "branches.json", branches)
    draw_response(found, HERE / "pictures" / "response.png")
    draw_corner(found, HERE / "pictures" / "corner.png")
    print(found.branch, found.doubled, common.to_markdown(found.rows), jumps, ramp, sep="\n")
    print(f"{seconds} s")


if __name__ == "__main__":
    main()
