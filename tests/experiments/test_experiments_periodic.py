"""The experiments with branches: their tables against the reference values."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

FOLDER = Path(__file__).parents[2] / "experiments"

pytestmark = [pytest.mark.slow, pytest.mark.long]


@pytest.fixture
def load(monkeypatch):
    """Load a module of an experiment under a name of its own: several have a run.py."""
    kept = dict(sys.modules)

    def load(folder, name):
        monkeypatch.syspath_prepend(FOLDER)
        monkeypatch.syspath_prepend(FOLDER / folder)
        spec = importlib.util.spec_from_file_location(
            f"{folder}_{name}", FOLDER / folder / f"{name}.py"
        )
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    yield load
    for name in set(sys.modules) - set(kept):
        if name in ("common", "paper_rig"):
            del sys.modules[name]


def assert_agree(rows):
    """Every row to 1e-4 of its reference, or to its last printed decimal where that is coarser."""
    for row in rows:
        allowed = max(1e-4 * abs(row.reference), 0.51 * 10**-row.decimals)
        assert abs(row.difference) < allowed, row


def test_two_masses_of_nlvib(load, tmp_path):
    run = load("nlvib_example_03", "run")
    found = run.compute()
    assert_agree(found.rows)
    assert found.branch.completed
    assert list(found.stable.values()) == [False, True, False]
    assert found.doubled.period == 2
    assert found.doubled.stable.any()
    run.draw(found, tmp_path / "response.png")
    assert (tmp_path / "response.png").stat().st_size > 20_000


def test_impact_oscillator(load, tmp_path):
    run = load("impact_oscillator", "run")
    found = run.compute()
    assert_agree(found.rows)
    assert found.branch.completed
    assert found.doubled.stable.any()
    jumps = [run.jump_up(b) for b in found.rounded]
    exact = run.jump_up(found.branch)
    assert (np.diff([exact, *jumps]) > 0).all()  # the wider the corner, the higher
    run.draw_response(found, tmp_path / "response.png")
    run.draw_corner(found, tmp_path / "corner.png")
    assert len(list(tmp_path.glob("*.png"))) == 2


def test_folds_of_gandhi_and_vyas_are_the_jumps(load):
    branches = load("gandhi_vyas_2017", "branches")
    results = FOLDER / "gandhi_vyas_2017" / "results"
    some = branches.trace("consistent", tapers=(0.5,), mass_ratios=(0.5,))
    table = branches.compare("consistent", some, pd.read_csv(results / "summary.csv"))
    (row,) = table.to_dict("records")
    stored = pd.read_csv(results / "branches.csv").set_index(["formulation", "taper", "mass_ratio"])
    for name in ("fold_down", "fold_up", "touch"):
        assert row[name] == pytest.approx(stored[name]["consistent", 0.5, 0.5], abs=1e-6)
    # Known exactly from elsewhere.
    assert row["fold_down"] == pytest.approx(1.226736, rel=1e-6)
    assert row["fold_up"] == pytest.approx(1.096507, rel=1e-6)
    # Jumps down come late by the steps and transients of the sweep.
    assert 0 <= row["jump_down"] - row["fold_down"] < 3e-3
    assert abs(row["jump_up"] - row["fold_up"]) < 2e-3
