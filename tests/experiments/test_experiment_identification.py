"""The identification experiment: a coarse run of every part."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "experiments" / "identification" / "run.py"


@pytest.mark.slow
@pytest.mark.long
def test_quick_run(tmp_path):
    # In a process of its own: other experiments have modules of the same names.
    command = [sys.executable, str(SCRIPT), "--quick", "--to", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, timeout=600)
    results = json.loads((tmp_path / "results.json").read_text())
    assert list(results) == [
        "recovery",
        "coverage",
        "early_jump",
        "model_error",
        "gaps",
        "free_gap",
        "drive",
        "whole_curve",
    ]
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 5
    (found,) = results["recovery"]["damping 5e-05"]
    low, high = found["interval"]["stiffness"]
    assert low < 5500 < high
    assert found["interval"]["damping"][1] < 0.3
    early = results["early_jump"]["damping 5e-05 distance early"]
    assert all("jumped early" in fit["warnings"][0] for fit in early["fits"])
    for part, kinds in (("drive", ["as measured"]), ("whole_curve", ["complex", "amplitudes"])):
        for kind in kinds:
            for fit in results[part][kind]["fits"]:
                low, high = fit["interval"]["stiffness"]
                assert low < 5500 < high
