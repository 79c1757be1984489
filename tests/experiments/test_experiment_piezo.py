"""The harvester: its linear case beside the closed form, in a coarse run."""

import importlib.util
from pathlib import Path

import pytest

PATH = Path(__file__).parents[2] / "experiments" / "piezo_harvester" / "run.py"


@pytest.mark.slow
def test_the_linear_harvester_is_the_published_closed_form(monkeypatch, tmp_path):
    spec = importlib.util.spec_from_file_location("piezo_harvester", PATH)
    experiment = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(experiment)
    monkeypatch.setattr(experiment, "HERE", tmp_path)
    monkeypatch.setattr(experiment, "LOADS", experiment.LOADS[[0, 3]])
    found = experiment.linear(coarse=True)
    assert found["worst_relative_difference_of_power"] < 1e-9
    assert found["largest_distance_from_the_best_of_400_loads"] < 0.02  # their spacing
    assert found["short_circuit_frequency"] == pytest.approx(45.70, abs=0.01)
    assert (tmp_path / "linear.png").stat().st_size > 10_000
