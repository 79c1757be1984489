"""The docs: their Python runs as printed, their links lead somewhere, no public name is missing."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import public_names

import vibrojax as vj

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
FENCE = re.compile(r"^(`{3,}).*?^\1[ ]*$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^()\s]+)\)|src=\"([^\"]+)\"")
GENERATED = {"docs/validation.md"}
"""Pages that exist on the site only."""


def pages(*patterns):
    return sorted(path for pattern in patterns for path in ROOT.glob(pattern))


LONG = {"docs/start.md"} | {
    f"docs/how_to/{page}.md"
    for page in (
        *("regimes", "design", "identification", "histories", "own_system", "harvesters"),
        *("sweeps_and_branches", "maps", "contact_laws"),
    )
}
"""Pages whose code takes minutes, most of it compiling, and one that does what README does."""
WITH_CODE = [page for page in pages("docs/**/*.md") if BLOCK.search(page.read_text())]
LINKING = pages("*.md", "docs/**/*.md", "benchmarks/*.md", "experiments/*/*.md", "tests/data/*.md")


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def module_of(name):
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# What the blocks of a page leave behind, beyond running to their end.


def check_start(names):
    assert names["curves"].jump_down.shape == (3,)
    assert names["curve"].jump_up == pytest.approx(1.0965, abs=1e-3)


def check_branches(names):
    assert np.abs(names["branch"].folds - 1.226736).min() < 1e-5
    assert names["orbit"].stable


def check_maps(names):
    assert names["maps"]["hysteresis_width"].sizes == {"gap": 3, "taper": 2}
    assert set(names["numbers"]) >= {"peak_amplitude_ratio", "hysteresis_width"}


def check_identification(names):
    low, high = names["fit"].interval["stiffness"]
    assert low < 5500 < high


def check_measurements(names):
    assert names["history"].contact_force.max() == pytest.approx(2 * 0.499)


def check_laws(names):
    assert float(names["orbit"].contact_force) > 0.1
    assert len(names["history"].contacts()) > 2
    memory = names["softened"].memory[:, 0]  # the dent only grows, and the stop is softer by it
    assert (memory[1:] >= memory[:-1]).all()
    assert float(memory[-1]) > 1e-5
    blocks = BLOCK.findall((DOCS / "how_to" / "contact_laws.md").read_text())
    (own,) = [block for block in blocks if "class Bumper" in block]
    lines = own.split("class Bumper")[1].strip().split("\n")
    assert len([line for line in lines if line.strip()]) <= 10
    assert 0.01 < names["check"].rigidity.worst < 0.1


def check_histories(names):
    assert len(names["contacts"]) == 6  # as in experiments/ledezma_ramirez_soft_support
    assert names["contacts"].peak_force.max() == pytest.approx(10.24, abs=0.01)


def check_own_system(names):
    assert (names["curve"].contact_force > 0).any()
    assert names["steady"].stable
    assert float(names["steady"].amplitude_ratio) > 0
    assert 0.5 < float(names["rolled"].contacts().restitution[0]) < 0.95  # rubber
    assert 0.1 < float(names["x"][:, 2].max()) < 2.0  # N: the filter lets less through


def check_harvesters(names):
    power = names["power"].sel(direction="forward").max("frequency")
    assert (power.sel(gap=0.4e-3) > power.sel(gap=5e-3)).all()
    assert names["voltage"].max() > 1.0  # V
    assert len(names["history"].contacts()) > 2


def check_design(names):
    best, sure, front = names["best"], names["sure"], names["front"]
    assert best.status == "converged"
    assert best.constraints["contact_force"] == pytest.approx(1.0, abs=1e-4)
    assert best.value > 0.08
    assert 0.06 < sure.value < best.value  # what the tolerances cost
    assert "nearly linear" in names["scatter"].findings["contact_force"]
    assert len(front.values) == 4
    assert (np.diff(front.values, axis=0) < 0).all()  # narrower, and softer


def check_regimes(names):
    assert names["found"].period.tolist() == [[0, 3, 0], [0, 3, 0]]
    assert names["exponent"].exponent > 3.0


CHECKS = {
    "docs/start.md": check_start,
    "docs/how_to/sweeps_and_branches.md": check_branches,
    "docs/how_to/maps.md": check_maps,
    "docs/how_to/identification.md": check_identification,
    "docs/how_to/measurements.md": check_measurements,
    "docs/how_to/contact_laws.md": check_laws,
    "docs/how_to/histories.md": check_histories,
    "docs/how_to/own_system.md": check_own_system,
    "docs/how_to/harvesters.md": check_harvesters,
    "docs/how_to/design.md": check_design,
    "docs/how_to/regimes.md": check_regimes,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=pytest.mark.long) if name_of(p) in LONG else p for p in WITH_CODE],
    ids=name_of,
)
def test_code_runs_as_printed(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names, text = {"__name__": "page"}, page.read_text()
    for block in BLOCK.finditer(text):
        lines_above = "\n" * (text[: block.start()].count("\n") + 1)
        exec(compile(lines_above + block[1], name_of(page), "exec"), names)
        pictures = re.findall(r"savefig\(\"(\w+\.png)\"\)", block[1])
        assert all((tmp_path / picture).stat().st_size > 5000 for picture in pictures)
    check = CHECKS.get(name_of(page))
    if check:
        check(names)


def test_checks_are_of_pages():
    assert set(CHECKS) <= {name_of(page) for page in WITH_CODE}


# Links


def anchors_of(text):
    """Anchors of the headings, as the site makes them and as GitHub does."""
    found = set()
    for heading in re.findall(r"^#+\s+(.+?)\s*$", FENCE.sub("", text), re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        slug = re.sub(r"[^\w\s-]", "", plain).strip().lower()
        found |= {re.sub(r"[-\s]+", "-", slug), slug.replace(" ", "-")}
    return found


def broken_links(text, path):
    """Links of a page, whose path is from the root, to files or headings that are not there."""
    broken = []
    prose = re.sub(r"`[^`\n]+`", "", FENCE.sub("", text))
    for pair in LINK.findall(prose):
        link = pair[0] or pair[1]
        if re.match(r"[a-z]+:", link):
            continue
        target, _, anchor = link.partition("#")
        meant = (ROOT / path).parent / target if target else ROOT / path
        if meant.resolve().relative_to(ROOT).as_posix() in GENERATED:
            continue
        if not meant.is_file() or (anchor and anchor not in anchors_of(meant.read_text())):
            broken.append(link)
    return broken


@pytest.mark.parametrize("page", LINKING, ids=name_of)
def test_links(page):
    assert not broken_links(page.read_text(), page.relative_to(ROOT))


def test_broken_links_are_found():
    text = "# Title\n[a](README.md) [b](no.md) ![c](no.png) [d](README.md#no) [e](README.md#start)"
    assert broken_links(text, Path("CHANGELOG.md")) == ["no.md", "no.png", "README.md#no"]


# The reference


def test_every_public_name_is_on_one_page_of_the_reference():
    text = "\n".join(page.read_text() for page in pages("docs/api/*.md"))
    listed = re.findall(r"^::: vibrojax\.([\w.]+)$", text, re.M)
    assert sorted(listed) == sorted(public_names())


# What is generated


def test_validation_shows_every_reference_and_paper():
    validation = module_of("validation")
    text = validation.page()
    assert not broken_links(text, Path("docs/validation.md"))
    for data in (ROOT / "tests" / "data").glob("*.json"):
        assert f"`{data.name}`" in text, data.name
    for run in (ROOT / "experiments").glob("*/run.py"):
        assert f"python experiments/{run.parent.name}/run.py" in text, run.parent.name
    recorded = json.loads((DOCS / "validation.json").read_text())["tables"]
    assert set(recorded) == set(validation.REFERENCES)
    assert "1.096506" in text  # a jump, of the reference and ours


def test_imports_run_downwards_as_drawn():
    house = module_of("house")
    found = house.imports()
    assert house.upward(found) == []
    assert house.circle(found) == []
    assert house.too_long() == []
    assert (DOCS / "house.svg").read_text() == house.drawing(found), "python docs/house.py"


def test_citation_is_of_this_version():
    yaml = pytest.importorskip("yaml")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert str(citation["version"]) == vj.__version__
    assert len(citation["references"]) == 3


def test_dead_links_of_a_built_site_are_found(tmp_path):
    (tmp_path / "index.html").write_text(
        '<h1 id="a">A</h1><a href="#a">1</a><a href="#b">2</a><a href="sub/#c%20d">3</a>'
        '<img src="sub/picture.png"><a href="/sub/index.html#e">4</a><a href="https://x.y/#z">5</a>'
    )
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "index.html").write_text('<p id="c d"></p><a href="..#a">6</a>')
    assert module_of("check_links").dead_links(tmp_path) == [
        "index.html: #b",
        "index.html: /sub/index.html#e",
        "index.html: sub/picture.png",
    ]
