"""The experiment with a piezoelectric harvester: its closed form, and what its page says."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

import vibrojax as vj

FOLDER = Path(__file__).parents[2] / "experiments" / "piezo_harvester"


@pytest.fixture
def run():
    spec = importlib.util.spec_from_file_location("piezo_harvester_run", FOLDER / "run.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_power_is_that_of_the_closed_form_and_largest_at_the_best_load(run):
    def power(resistance):
        voltage = run.closed_form(run.make(resistance=resistance, with_stop=False), [47.0])[0]
        return abs(voltage) ** 2 / 2 / resistance

    system = run.make(with_stop=False)
    found = vj.periodic_response(system, frequency=47.0)
    assert float(found.mean_power) == pytest.approx(power(1e5), rel=1e-9)
    best = float(system.optimal_resistance(47.0))
    assert power(best) > max(power(0.99 * best), power(1.01 * best))


def test_tables_of_the_page_are_the_results():
    page = (FOLDER / "README.md").read_text()
    rows = json.loads((FOLDER / "results" / "results.json").read_text())["stops"]
    for name, unit, digits in (("peak", "mW", 2), ("bandwidth", "Hz", 1)):
        for gap in np.unique([row["gap_mm"] for row in rows]):
            cells = [
                " / ".join(
                    f"{row[f'{name}_{d}_{unit}']:.{digits}f}" for d in ("forward", "backward")
                )
                for row in rows
                if row["gap_mm"] == gap
            ]
            assert f"| {' | '.join(cells)} |" in page
