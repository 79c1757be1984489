"""The reproduction of Gandhi and Vyas (2017): its comparisons, and a coarse run of all of it."""

import importlib
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "experiments" / "gandhi_vyas_2017"


@pytest.fixture
def experiment(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    return importlib.import_module


def test_table_2_agrees_by_truncation_but_for_the_misprint(experiment):
    table2 = experiment("table2")
    entries = table2.compare()
    assert len(entries) == 27
    (odd,) = [e for e in entries if not e.agrees]
    assert (odd.taper, odd.mass_ratio, odd.mode, odd.printed) == (0.3, 0, 2, "22.98")
    assert table2.agrees_by_truncation(odd.computed, "22.78")


@pytest.mark.parametrize(
    ("value", "printed", "agrees"),
    [
        (3.9199, "3.91", True),
        (3.9201, "3.91", False),
        (51.1007, "51.10", True),
        (1.51, "1.511", False),
    ],
)
def test_truncation(experiment, value, printed, agrees):
    assert experiment("table2").agrees_by_truncation(value, printed) is agrees


@pytest.mark.parametrize(
    ("values", "sign", "expected"),
    [
        ([1.0, 2.0, 3.0], 1, True),
        ([1.0, 2.0, 3.0], -1, False),
        ([3.0, 2.0, 2.005, 1.0], -1, True),
        ([1.0, 3.0, 2.0], 1, False),
        ([1.0, 1.001, 1.002], 1, False),
    ],
)
def test_a_trend_forgives_steps_within_the_slack(experiment, values, sign, expected):
    assert experiment("claims").follows(np.array(values), sign, 0.01) is expected


@pytest.mark.parametrize("formulation", ["consistent", "as_printed"])
def test_4_mm_is_out_of_reach(experiment, formulation):
    paper_rig = experiment("paper_rig")
    ratios = np.linspace(0.9, 1.1, 401)
    reach = paper_rig.stop_amplitude(formulation, ratios, taper=0.0, mass_ratio=1.5)
    assert 1e-3 < reach.max() < 4e-3
    numbers = {"taper": 0.0, "mass_ratio": 1.5}
    assert np.isnan(paper_rig.touch_frequency(formulation, **numbers, gap=4e-3))
    assert paper_rig.touch_frequency(formulation, **numbers) > 1.05


@pytest.mark.slow
@pytest.mark.long  # minutes
def test_quick_run(experiment, tmp_path):
    verdicts = experiment("run").reproduce(tmp_path, quick=True)
    assert {v.formulation for v in verdicts} == {"either", "consistent", "as_printed"}
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 7
    assert (tmp_path / "results" / "claims.md").read_text().count("\n") > len(verdicts)
