"""The Python of the README runs as printed."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def code_of(path):
    return re.findall(r"```python\n(.*?)```", (ROOT / path).read_text(), re.DOTALL)


@pytest.mark.slow
def test_readme_code_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = code_of("README.md")
    assert len(blocks) >= 4
    names = {}
    exec("\n".join(blocks), names)
    assert (tmp_path / "curve.png").exists()
    assert (tmp_path / "curve.nc").exists()
    assert names["curves"].jump_down.shape == (3, 2)
    assert abs(float(names["slope"])) > 0
