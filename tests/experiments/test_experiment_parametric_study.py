"""The parametric study: a coarse run of it, and that its store is not computed again."""

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

FOLDER = Path(__file__).parents[2] / "experiments" / "parametric_study"


def files_of(store):
    return {p: p.stat().st_mtime_ns for p in store.rglob("*") if p.is_file()}


def study(folder):
    # In a process of its own: other experiments have modules of the same names.
    command = [sys.executable, str(FOLDER / "study.py"), "--quick", "--output", str(folder)]
    command += ["--store", str(folder / "curves.zarr")]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=600).stdout


@pytest.mark.long
@pytest.mark.slow
def test_quick_study(tmp_path):
    assert "16 of 16 lanes computed" in study(tmp_path)
    results = tmp_path / "results"
    said = json.loads((results / "run.json").read_text())
    assert said["lanes"] == said["run"]["lanes_computed"] == 16
    assert said["lanes_that_touch"] > 8
    measures = pd.read_csv(results / "measures.csv")
    assert len(measures) == 16
    assert measures["settled_peak_ratio"].between(10, 100).all()
    table = (results / "trends.md").read_text()
    rows = [row for row in table.splitlines() if row.count("%") == 3]
    assert len(rows) == 13
    (wider,) = [row for row in rows if "larger gap: smaller shift" in row]
    assert "| 100 % | 0 % | 0 % |" in wider
    pictures = {path.name for path in (tmp_path / "pictures").glob("*.png")}
    names = ("peak", "hysteresis", "aperiodic", "frequencies", "trends", "summary")
    assert pictures == {f"{name}.png" for name in names}

    kept = files_of(tmp_path / "curves.zarr")
    assert "0 of 16 lanes computed" in study(tmp_path)
    assert files_of(tmp_path / "curves.zarr") == kept
    assert json.loads((results / "run.json").read_text()) == said


@pytest.mark.slow
def test_trends_of_the_results_that_are_kept():
    # Written by the run whose numbers the README quotes: every claim, from as many pairs.
    table = (FOLDER / "results" / "trends.md").read_text()
    rows = [row.split("|") for row in table.splitlines() if row.count("%") == 3]
    assert len(rows) == 13
    for row in rows:
        shares = [int(cell.strip().removesuffix(" %")) for cell in row[3:6]]
        assert 99 <= sum(shares) <= 101
