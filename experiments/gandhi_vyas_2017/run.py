"""Reproduce Gandhi and Vyas (2017): Table 2, Figs 6 to 12, and every claim judged by number.

python experiments/gandhi_vyas_2017/run.py            the whole, about 10 minutes on one core
python experiments/gandhi_vyas_2017/run.py --quick    coarse, to see that everything runs
"""

import argparse
import json
import time
from pathlib import Path

import claims
import curves
import pandas as pd
import pictures
import table2
from paper_rig import FORMULATIONS

import vibrojax as vj

HERE = Path(__file__).parent


def write_curves(study: curves.Study, folder: Path) -> None:
    """Write the curves of Figs 8 to 10 of one formulation, one file per figure."""
    for j in range(len(study.curve.axes["mass_ratio"])):
        table = curves.curve_table(study.curve, j)
        table.to_csv(folder / f"fig{8 + j}_{study.formulation}.csv", index=False)


def reproduce(folder: Path, quick: bool = False) -> list[claims.Verdict]:
    """Run everything and write `results/` and `pictures/` into the folder."""
    started = time.perf_counter()
    results, drawn = folder / "results", folder / "pictures"
    for place in (results, drawn):
        place.mkdir(parents=True, exist_ok=True)
    entries = table2.compare()
    table2.write(entries, results)
    pictures.draw_shapes(drawn)
    studies, tables, seconds = [], [], {}
    for formulation in FORMULATIONS:
        begun = time.perf_counter()
        for study in curves.run_studies(formulation, quick):
            tables.append(curves.summarise(study, quick))
            studies.append(study)
            label = f"{formulation} {study.name} N {study.num_modes}"
            seconds[label] = round(time.perf_counter() - begun, 1)
            lanes = len(tables[-1])
            print(f"{label}: {lanes} lanes, {seconds[label]} s", flush=True)
            begun = time.perf_counter()
    summary = pd.concat(tables, ignore_index=True)
    rounded = summary.round({"gap": 7, "contact_force": 4}).round(6)
    rounded.to_csv(results / "summary.csv", index=False)
    for study in studies:
        if study.name == "fig8to10":
            write_curves(study, results)
    pictures.draw_fig7([s for s in studies if s.name == "fig7"], drawn)
    pictures.draw_responses([s for s in studies if s.name == "fig8to10"], drawn)
    for name in ("gap", "position"):
        pictures.draw_peaks(summary, name, drawn)
    verdicts = claims.judge(summary, entries)
    (results / "claims.md").write_text(claims.to_markdown(verdicts))
    pd.DataFrame(verdicts).to_csv(results / "claims.csv", index=False)
    total = round(time.perf_counter() - started, 1)
    about = {"vibrojax": vj.__version__, "quick": quick, "seconds": total}
    about |= {"cpu_seconds": round(time.process_time(), 1), "parts": seconds}
    (results / "run.json").write_text(json.dumps(about, indent=1) + "\n")
    print(f"{sum(e.agrees for e in entries)} of {len(entries)} entries of Table 2 agree")
    for v in verdicts:
        print(f"{v.verdict:15s} {v.formulation:11s} {v.claim}")
    print(f"written to {folder} in {total} s")
    return verdicts


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarse grids and few lanes")
    parser.add_argument(
        "--output", type=Path, help="folder to write into (default: here; --quick: quick/ here)"
    )
    given = parser.parse_args()
    reproduce(given.output or (HERE / "quick" if given.quick else HERE), given.quick)


if __name__ == "__main__":
    main()
