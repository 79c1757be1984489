"""Stiff stops tend to an impact with restitution, as theory says."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "experiments"


@pytest.mark.slow
def test_stiff_stops_tend_to_an_impact(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(FOLDER)
    path = FOLDER / "impact_oscillator" / "impact_law.py"
    spec = importlib.util.spec_from_file_location("impact_law", path)
    experiment = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(experiment)
    sys.modules.pop("common", None)
    found = experiment.compute(np.array([1e3, 1e5, 1e7]))
    apart = np.array(found["amplitude_difference"])
    assert 0.12 < apart[0] < 0.13  # p0 of 1,000
    # Contacts last as long as the root of the stiffness is large.
    np.testing.assert_allclose(apart[1:] / apart[:-1], 0.1, rtol=0.06)
    assert apart[2] / apart[1] == pytest.approx(0.1, rel=6e-3)
    # The limit, extrapolated, is the closed form.
    amplitude = np.array(found["amplitude"])
    assert (10 * amplitude[2] - amplitude[1]) / 9 == pytest.approx(
        found["limit"]["amplitude"], 1e-5
    )
    assert np.abs(found["multiplier_difference"][-1]) < 3e-6
    experiment.draw(found, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
