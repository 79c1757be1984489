"""The explorer in JupyterLab under a headless browser: sliders move the picture."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "explorer.py"


@pytest.mark.slow
@pytest.mark.skipif(
    not (shutil.which("chromium") or shutil.which("google-chrome")),
    reason="needs Chromium or Chrome",
)
def test_a_slider_changes_the_picture_in_a_browser(tmp_path):
    pytest.importorskip("playwright")
    pytest.importorskip("jupyterlab")
    results = tmp_path / "explorer.json"
    command = [sys.executable, str(BENCHMARK), "--steps", "3", "--results", str(results)]
    subprocess.run(command, check=True, timeout=500, capture_output=True)
    found = json.loads(results.read_text())
    assert found["gap"]["changed"] == 3
    assert found["stiffness"]["changed"] == 3
    assert all(time > 0 for time in found["gap"]["key_to_picture_ms"])
    assert found["orbit_follows_mouse"]
