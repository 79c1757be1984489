"""The Python of the README runs as printed."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"


@pytest.mark.slow
def test_readme_code_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert len(blocks) == 3  # the three jobs
    names = {}
    exec("\n".join(blocks), names)
    assert names["maps"]["hysteresis_width"].sizes == {"gap": 5}
    low, high = names["fit"].interval["stiffness"]
    assert low < 5500 < high
    assert abs(names["branch"].folds - 1.226736).min() < 1e-5
    for picture in ("map.png", "fit.png", "branch.png"):
        assert (tmp_path / picture).stat().st_size > 5000
