"""The Python of the README and of the docs runs as printed."""

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


@pytest.mark.slow
def test_laws_of_the_docs_run():
    names = {}
    exec("\n".join(code_of("docs/contact_laws.md")), names)
    assert float(names["orbit"].contact_force) > 0.1
    assert len(names["history"].contacts()) > 2
    # The dent only grows, and the stop is softer by it.
    memory = names["softened"].memory[:, 0]
    assert (memory[1:] >= memory[:-1]).all()
    assert float(memory[-1]) > 1e-5
    lines = code_of("docs/contact_laws.md")[0].split("class Bumper")[1].strip().split("\n")
    assert len([line for line in lines if line.strip()]) <= 10


@pytest.mark.slow
@pytest.mark.long
def test_regimes_of_the_docs_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec("\n".join(code_of("docs/regimes.md")), names)
    assert names["found"].period.tolist() == [[0, 3, 0], [0, 3, 0]]
    assert names["exponent"].exponent > 3.0
    assert (tmp_path / "chirp.png").exists()
