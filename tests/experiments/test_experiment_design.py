"""The experiment with designs: measures of its maps, and what its page says."""

import importlib.util
import json
from pathlib import Path

import pytest

import vibrojax as vj

FOLDER = Path(__file__).parents[2] / "experiments" / "design"


def load(name):
    # By its path: other experiments have modules of the same names.
    spec = importlib.util.spec_from_file_location(f"design_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_measures_of_the_maps_are_near_the_exact_ones():
    problem = load("problems").PROBLEMS["quiet"]
    best = json.loads((FOLDER / "results" / "quiet.json").read_text())
    response = vj.design.respond(problem.make_system, **best["numbers"], **problem.frequency)
    assert float(problem.objective(response)) == pytest.approx(best["value"], rel=1e-6)
    assert float(problem.constraint(response)) == pytest.approx(best["constraint"], rel=1e-6)
    on_branch = load("on_branch").OnBranch(response.branch)
    for function in (problem.objective, problem.constraint):
        assert function(on_branch) == pytest.approx(float(function(response)), rel=2e-3)
    exact = response.half_power_bandwidth(), response.mean("contact_force")
    found = on_branch.half_power_bandwidth(), on_branch.mean("contact_force")
    assert found == pytest.approx(exact, rel=5e-3)


def test_the_page_has_the_table_and_the_designs_keep_to_their_bounds():
    page = (FOLDER / "README.md").read_text()
    assert (FOLDER / "results" / "table.md").read_text() in page
    for name, problem in load("problems").PROBLEMS.items():
        found = json.loads((FOLDER / "results" / f"{name}.json").read_text())
        for number, (low, high) in problem.variables.items():
            assert low <= found["numbers"][number] <= high
        if problem.constraint is not None:
            assert found["constraint"] <= 1.0001 * problem.most
