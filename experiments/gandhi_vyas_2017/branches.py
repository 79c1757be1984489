"""The branches under the sweeps of Figs 8 to 10: unstable parts, and folds beside the jumps.

python experiments/gandhi_vyas_2017/branches.py       uses the sweeps that run.py left in results/
"""

import argparse
import itertools
import json
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from paper_rig import FORMULATIONS, MASS_RATIOS, TAPERS, rig_of

sys.path.insert(0, str(Path(__file__).parents[1]))
import common

import vibrojax as vj

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
RANGES = {"consistent": vj.Range(0.85, 1.35), "as_printed": vj.Range(0.85, 1.80)}
NEAR = 0.01
NAMES = {"consistent": "consistent", "as_printed": "as printed"}
FORWARD, BACKWARD, BRANCH = "#1f5fa8", "#d9541e", "0.25"
RATIO_LABEL = "drive frequency / first natural frequency"
PEAK_LABEL = "peak ratio  max|y tip| / σ"


def trace(formulation: str, tapers=TAPERS, mass_ratios=MASS_RATIOS) -> list[vj.branches.Branch]:
    """Trace the branches of Figs 8 to 10 of one formulation, one by one."""
    branches = []
    for mass_ratio, taper in itertools.product(mass_ratios, tapers):
        branches += vj.continue_response(
            rig_of(formulation),
            frequency_ratio=RANGES[formulation],
            taper=[taper],
            mass_ratio=[mass_ratio],
        )
    return branches


def nearest(folds: np.ndarray, jump: float) -> float:
    """The fold nearest to a jump; NaN where there is none within `NEAR`."""
    away = np.abs(folds - jump)
    return float(folds[np.argmin(away)]) if np.min(away, initial=np.inf) < NEAR else float("nan")


def compare(
    formulation: str, branches: list[vj.branches.Branch], summary: pd.DataFrame
) -> pd.DataFrame:
    """One row per branch: its folds beside the jumps of the sweep in `summary`."""
    swept = summary[(summary["study"] == "fig8to10") & (summary["formulation"] == formulation)]
    rows = []
    for branch in branches:
        taper, mass_ratio = branch.labels["taper"], branch.labels["mass_ratio"]
        at = np.isclose(swept["taper"], taper) & np.isclose(swept["mass_ratio"], mass_ratio)
        (row,) = swept[at].to_dict("records")
        touch = branch.grazings.max()
        up, down = (nearest(branch.folds, row[f"jump_{way}"]) for way in ("up", "down"))
        rows.append(
            {
                "formulation": formulation,
                "taper": taper,
                "mass_ratio": mass_ratio,
                "jump_down": row["jump_down"],
                "fold_down": down,
                "jump_up": row["jump_up"],
                "fold_up": up,
                "touch": touch,
                "folds": len(branch.folds),
                "period_doublings": len(branch.period_doublings),
                "points": len(branch.values),
                "unstable_points": int((~branch.stable).sum()),
                "ending": branch.sentence,
            }
        )
    return pd.DataFrame(rows)


def to_markdown(table: pd.DataFrame) -> str:
    lines = [
        "| formulation | taper | mass ratio | jump down | fold | difference "
        "| jump up | fold | difference | touch |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in table.itertuples():
        cells = [NAMES[r.formulation], f"{r.taper:g}", f"{r.mass_ratio:g}"]
        for jump, fold in ((r.jump_down, r.fold_down), (r.jump_up, r.fold_up)):
            cells.append(f"{jump:.4f}")
            cells += [f"{fold:.4f}", f"{jump - fold:+.4f}"] if np.isfinite(fold) else ["none", ""]
        lines.append(f"| {' | '.join(cells)} | {r.touch:.4f} |")
    return "\n".join(lines) + "\n"


def draw_panel(axes, branch: vj.branches.Branch, sweep: pd.DataFrame) -> None:
    """One branch under the settled points of the sweep in both directions."""
    x, y = branch.values, branch.peak_ratio
    common.draw_branch(axes, branch, x, y, BRANCH, 1.5)
    for way, color, marker in (("forward", FORWARD, ">"), ("backward", BACKWARD, "<")):
        key = f"taper_{branch.labels['taper']:g}_{way}"
        once = sweep[f"{key}_period"] == 1
        # So many that they can be distinguished.
        thinned = np.linspace(*branch.range, 36) + (0.004 if way == "backward" else 0.0)
        at = np.unique(np.searchsorted(sweep["frequency_ratio"], thinned).clip(0, len(sweep) - 1))
        shown = sweep.iloc[at][once.iloc[at]]
        style = {"color": color, "ms": 7, "mew": 0, "alpha": 0.75, "zorder": 2}
        axes.plot(shown["frequency_ratio"], shown[f"{key}_peak_ratio"], marker, **style)
    for point in branch.special_points:
        common.mark(
            axes, point.parameter, common.place(branch, y, point)[1], point.kind, BRANCH, 6.5
        )
    axes.set_xlim(*branch.range)
    common.finish(axes)


def draw(branches: dict[str, list[vj.branches.Branch]], results: Path, folder: Path) -> None:
    """Figs 8 to 10 with their branches: a row per formulation, a panel per taper."""
    for j, mass_ratio in enumerate(MASS_RATIOS):
        figure, grid = plt.subplots(
            len(branches),
            len(TAPERS),
            figsize=(16, 4 * len(branches)),
            layout="constrained",
            sharey="row",
            squeeze=False,
        )
        for row, (formulation, some) in zip(grid, branches.items(), strict=True):
            sweep = pd.read_csv(results / f"fig{8 + j}_{formulation}.csv")
            own = [b for b in some if b.labels["mass_ratio"] == mass_ratio]
            for axes, branch in zip(row, own, strict=True):
                draw_panel(axes, branch, sweep)
                taper = branch.labels["taper"]
                axes.set_title(f"{NAMES[formulation]}, taper {taper:g}", fontsize=12)
                axes.set_xlabel(RATIO_LABEL, fontsize=11)
            row[0].set_ylabel(PEAK_LABEL, fontsize=11)
            row[0].set_ylim(0, None)
        figure.suptitle(
            f"Fig. {8 + j} with its branches: mass ratio {mass_ratio:g}, gap 0.4 mm at s1 = 0.5, "
            "σ = 0.2 mm; motions of the drive's period",
            fontsize=13,
        )
        kinds = {p.kind for some in branches.values() for b in some for p in b.special_points}
        entries = common.legend_entries(tuple(k for k in common.MARKS if k in kinds))
        for color, marker, words in ((FORWARD, ">", "forward"), (BACKWARD, "<", "backward")):
            style = {
                "color": color,
                "marker": marker,
                "ls": "none",
                "ms": 8,
                "label": f"{words} sweep",
            }
            entries.append(plt.Line2D([], [], **style))
        figure.legend(
            handles=entries, loc="outside lower center", ncols=8, fontsize=11, frameon=False
        )
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(folder / f"fig{8 + j}_branches.png", dpi=90)
        plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=HERE / "results", help="of run.py")
    results = parser.parse_args().results
    started = time.perf_counter()
    summary = pd.read_csv(results / "summary.csv")
    branches, tables, seconds = {}, [], {}
    for formulation in FORMULATIONS:
        begun = time.process_time()
        branches[formulation] = trace(formulation)
        seconds[formulation] = round(time.process_time() - begun, 1)
        for branch in branches[formulation]:
            print(branch, flush=True)
        tables.append(compare(formulation, branches[formulation], summary))
    table = pd.concat(tables, ignore_index=True)
    table.round(7).to_csv(results / "branches.csv", index=False)
    (results / "branches.md").write_text(to_markdown(table))
    draw(branches, results, results.parent / "pictures")
    total = round(time.perf_counter() - started, 1)
    about = {"vibrojax": vj.__version__, "seconds": total, "processor_seconds": seconds}
    (results / "branches.json").write_text(json.dumps(about, indent=1) + "\n")
    print(to_markdown(table), f"{total} s", sep="\n")


if __name__ == "__main__":
    main()
