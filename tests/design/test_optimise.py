"""Searches for designs, on functions in closed form."""

import threading
import time
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import xarray
from closed_forms import ClosedForm, Interrupted, rosenbrock

import vibrojax as vj
from vibrojax.design import rig_functions
from vibrojax.design.constraints import Constraint
from vibrojax.design.optimise import optimise, search_design
from vibrojax.design.settings import OptimiseSettings
from vibrojax.design.variables import variables_of

BOX = variables_of({"x": (-2.0, 2.0), "y": (-1.0, 3.0)})
FEW = OptimiseSettings(starts=2, screened=16)


def bowl(place):
    return (place[0] - 1.0) ** 2 + 2 * (place[1] - 0.5) ** 2 + place[0] * place[1]


def wavy(place):
    return jnp.sum(place**2 - jnp.cos(4 * place)) + 0.1 * place[0] ** 3 * place[1]


@pytest.mark.parametrize("method", ["SLSQP", "trust-constr"])
def test_rosenbrock_within_a_disc(method):
    disc = Constraint(len, most=1.5)
    rigs = ClosedForm({"rosenbrock": rosenbrock, "disc": lambda place: jnp.sum(place**2)})
    how = OptimiseSettings(starts=2, screened=16, max_rounds=200, method=method, tolerance=1e-8)
    found = search_design(rigs, BOX, [disc], settings=how)
    on_circle = scipy.optimize.minimize_scalar(
        lambda a: float(rosenbrock(np.sqrt(1.5) * np.array([np.cos(a), np.sin(a)]))),
        bounds=(0.5, 1.0),
        method="bounded",
        options={"xatol": 1e-12},
    )
    assert found.status == "converged"
    assert found.value == pytest.approx(on_circle.fun, abs=1e-6 if method == "SLSQP" else 1e-4)
    assert found.constraints["disc"] <= 1.5 + 1e-6
    if method == "SLSQP":
        assert found.active == ("disc at most 1.5",)
        assert found.numbers["x"] == pytest.approx(np.sqrt(1.5) * np.cos(on_circle.x), abs=1e-4)


def test_the_best_of_several_minima_with_gradient_curvature_and_history():
    rigs = ClosedForm({"wavy": wavy})
    found = search_design(rigs, BOX, settings=OptimiseSettings(starts=4))
    by_force = scipy.optimize.brute(lambda p: float(wavy(p)), ((-2, 2), (-1, 3)), Ns=60)
    assert found.value == pytest.approx(float(wavy(by_force)), abs=1e-6)
    at = jnp.array(list(found.numbers.values()))
    np.testing.assert_allclose(found.curvature, jax.hessian(wavy)(at), rtol=0.03, atol=0.02)
    np.testing.assert_allclose(list(found.gradient.values()), jax.grad(wavy)(at), atol=1e-9)
    assert rigs.batches[:2] == [32, 32]  # side by side
    assert max(rigs.batches[2:]) == 4
    assert found.evaluations == sum(rigs.batches)
    history = found.history
    np.testing.assert_allclose(history.value, [wavy(p) for p in history.design], atol=1e-12)
    assert set(history.search.tolist()) == {0, 1, 2, 3, 4, -1}
    assert found.value == history.value.min()
    assert len(found.ends) == 4
    assert all(end.value >= found.value for end in found.ends)
    assert [n.name for n in found.neighbours] == ["x", "x", "y", "y"]
    assert all(n.value > found.value for n in found.neighbours)
    assert found.neighbours[0].number < found.numbers["x"] < found.neighbours[1].number


def test_the_largest_at_bounds_in_logarithms_is_given_in_the_users_numbers():
    box = variables_of({"gap": (1e-4, 1e-2), "stiffness": vj.Range(1e3, 1e5, 2e3)})
    rigs = ClosedForm(
        {"power": lambda p: 5.0 - jnp.log(p[0] / 1e-3) ** 2 + 0.1 * jnp.log(p[1])}, box.names
    )
    found = search_design(rigs, box, maximise=True, settings=FEW)
    assert found.status == "converged"
    assert found.numbers["gap"] == pytest.approx(1e-3, rel=1e-3)
    assert found.numbers["stiffness"] == 1e5
    assert found.active == ("stiffness at its upper bound",)
    assert found.gradient["stiffness"] == pytest.approx(0.1 / 1e5)
    np.testing.assert_allclose(found.curvature[0, 0], -2 / 1e-6, rtol=0.02)
    np.testing.assert_allclose(found.curvature[1, 1], -0.1 / 1e10, rtol=0.05)
    assert found.first == {"gap": pytest.approx(1e-3), "stiffness": pytest.approx(2e3)}
    assert found.history.design[0].tolist() == pytest.approx([1e-3, 2e3])
    assert "largest power" in repr(found)
    assert "stiffness = 100000 N/m" in repr(found)


def test_searches_come_back_from_where_there_is_no_value():
    # The unbounded minimum, at (0.857, 0.286), lies within the known part; starts do not all.
    rigs = ClosedForm({"bowl": bowl}, known=lambda p: p[0] + p[1] < 1.3)
    found = search_design(rigs, BOX, settings=OptimiseSettings(starts=4, screened=16))
    assert found.status == "converged"
    np.testing.assert_allclose(list(found.numbers.values()), [6 / 7, 2 / 7], atol=1e-3)
    lost = np.isnan(found.history.value)
    assert lost.any()
    assert {n for n, gone in zip(found.history.note, lost, strict=True) if gone} == {
        "the branch was lost."
    }


def test_a_minimum_at_the_edge_of_what_has_values_is_no_convergence():
    rigs = ClosedForm({"bowl": bowl}, known=lambda p: p[0] < 0.5)
    found = search_design(rigs, BOX, settings=FEW)
    assert found.status in ("kink", "limit")
    assert 0.45 < found.numbers["x"] < 0.5
    assert found.numbers["y"] == pytest.approx(0.5 - found.numbers["x"] / 4, abs=0.05)


def test_where_two_peaks_are_equally_high_a_search_ends_at_the_kink():
    rigs = ClosedForm(
        {"peak": lambda p: jnp.maximum(10 * p[0] + p[1] ** 2, (p[0] - 1) ** 2 - p[1] + p[1] ** 2)}
    )
    found = search_design(rigs, BOX, settings=FEW)
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 401), np.linspace(-1, 1, 401)))
    first, second = 10 * grid[0] + grid[1] ** 2, (grid[0] - 1) ** 2 - grid[1] + grid[1] ** 2
    assert found.value == pytest.approx(np.maximum(first, second).min(), abs=0.02)
    assert found.status == "kink"
    assert "equally high" in found.sentence
    assert found.evaluations < 100


def test_a_missing_derivative_ends_a_search_with_the_reason():
    rigs = ClosedForm({"bowl": bowl}, smooth=lambda p: False)
    found = search_design(rigs, BOX, settings=FEW)
    assert found.status == "no slope"
    assert "a fold vanishes." in found.sentence
    assert np.isfinite(found.value)


def test_what_never_has_a_value_is_an_error_with_the_first_note():
    rigs = ClosedForm({"peak_force": bowl}, known=lambda p: False)
    with pytest.raises(ValueError, match=r"peak force has no value .* 16 designs .* was lost\."):
        search_design(rigs, BOX, settings=FEW)


def test_constraints_that_cannot_be_met_are_said_with_the_least_violation():
    rigs = ClosedForm({"bowl": bowl, "reach": lambda p: p[0] + p[1]})
    with pytest.warns(UserWarning, match="reach is 5 and must be at least 6"):
        found = search_design(rigs, BOX, [Constraint(len, least=6.0)], settings=FEW)
    assert found.status == "infeasible"
    assert found.numbers == pytest.approx({"x": 2.0, "y": 3.0})
    assert found.constraints == pytest.approx({"reach": 5.0})


def test_constraints_that_no_screened_design_meets_are_met():
    rigs = ClosedForm({"bowl": bowl, "ring": lambda p: (p[0] + 1) ** 2 + (p[1] - 2) ** 2})
    found = search_design(rigs, BOX, [Constraint(len, most=1e-3)], settings=FEW)
    assert not found.history.feasible[found.history.search == 0].any()
    assert found.status == "converged"
    assert found.active == ("ring at most 0.001",)
    angle = np.linspace(0.0, 2 * np.pi, 10_001)
    circle = np.sqrt(1e-3) * np.stack([np.cos(angle), np.sin(angle)])
    least = float(bowl(np.array([[-1.0], [2.0]]) + circle).min())
    assert found.value == pytest.approx(least, rel=1e-4)


def test_a_search_ends_when_its_designs_are_used_up():
    rigs = ClosedForm({"rosenbrock": rosenbrock})
    how = OptimiseSettings(starts=2, screened=16, max_rounds=4)
    found = search_design(rigs, BOX, settings=how)
    assert found.status == "limit"
    assert found.evaluations == 16 + 2 * 4 + 4
    assert "max_rounds" in found.sentence


@pytest.fixture
def threads():
    """Function that says which threads of pools there are that were not there before the test."""
    before = set(threading.enumerate())

    def new():
        return [
            t for t in threading.enumerate() if t.name.startswith("ThreadPool") and t not in before
        ]

    return new


@pytest.mark.parametrize(("batch", "tried"), [(1, 32), (2, 64), (4, 70)])
def test_what_was_found_before_ctrl_c_is_returned(batch, tried, threads):
    rigs = Interrupted({"rosenbrock": rosenbrock}, batch=batch)
    begin = time.monotonic()
    found = search_design(rigs, BOX, settings=OptimiseSettings(starts=3))
    assert time.monotonic() - begin < 5.0
    assert found.status == "interrupted"
    assert found.value == np.nanmin(found.history.value)
    assert found.evaluations == tried
    assert len(found.neighbours) == 0
    assert "Interrupted" in repr(found)
    assert not threads()
    found.plot()
    found.to_xarray()


def test_ctrl_c_before_anything_is_known_stays_one():
    with pytest.raises(KeyboardInterrupt):
        search_design(Interrupted({"bowl": bowl}, batch=0), BOX, settings=FEW)


def test_what_an_evaluation_raises_ends_all_searches(threads):
    class Broken(ClosedForm):
        def evaluate(self, places, *, slopes=True):
            if len(self.batches) == 3:
                raise ValueError("The function must return one number.")
            return super().evaluate(places, slopes=slopes)

    with pytest.raises(ValueError, match="must return one number"):
        search_design(Broken({"bowl": bowl}), BOX, settings=FEW)
    assert not threads()


def test_dataset_file_and_picture(tmp_path):
    rigs = ClosedForm({"bowl": bowl, "reach": lambda p: p[0] + p[1]})
    found = search_design(rigs, BOX, [Constraint(len, least=1.5)], settings=FEW)
    data = found.to_xarray()
    for name, variable in data.data_vars.items():
        assert {"units", "long_name"} <= set(variable.attrs), name
    assert data["design"].dims == ("evaluation", "variable")
    assert data["neighbour_constraint"].shape == (2, 2, 1)
    assert data.attrs["status"] == "converged"
    found.save(tmp_path / "optimum.nc")
    assert xarray.load_dataset(tmp_path / "optimum.nc").identical(data)
    figure = found.plot()
    assert len(figure.axes) == 1 + 2 + 2
    figure.savefig(tmp_path / "optimum.png")


@pytest.fixture
def closed_rigs(monkeypatch):
    """Rigs whose response is their numbers, in place of those that are computed."""
    seen = {}

    class Rigs(ClosedForm):
        def __init__(self, make_system, functions, names, **how):
            super().__init__(dict(functions), names)
            self.make = make_system
            seen.update(how)

        def check(self, place):
            return self.make(**dict(zip(self.names, map(float, place), strict=True)))

        def response(self, place):
            return types.SimpleNamespace(place=place, branch=None)

    monkeypatch.setattr(rig_functions, "RigEvaluator", Rigs)
    return seen


CALL = {"variables": {"gap": (1e-4, 1e-3)}, "frequency_ratio": vj.Range(0.9, 1.3)}


def test_a_call(closed_rigs):
    found = optimise(
        vj.default_rig, lambda p: (1e3 * p[0] - 0.5) ** 2, **CALL, taper=0.4, settings=FEW
    )
    assert found.status == "converged"
    assert found.numbers["gap"] == pytest.approx(5e-4, rel=1e-3)
    assert found.objective == "objective"
    assert found.response.place.tolist() == list(found.numbers.values())
    assert closed_rigs["axis"] == "frequency_ratio"
    assert closed_rigs["numbers"] == {"taper": 0.4}
    assert closed_rigs["settings"].tolerance == 1e-4


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"objective": 3.0}, "objective must be a function"),
        ({"variables": {"gap": (1e-3, 1e-4)}}, "the high bound first"),
        ({"variables": {"gpa": (1e-4, 1e-3)}}, "Did you mean 'gap'"),
        ({"variables": {"taper": (0.0, 1.5)}}, "no rig, 1.5"),
        ({"constraints": [3.0]}, r"constraints\[0\] must be a Constraint"),
        ({"frequency_ratio": None}, "frequency_ratio or frequency, one of the two"),
        ({"frequency_ratio": 1.0}, "frequency_ratio must be a Range"),
        ({"frequency": vj.Range(10.0, 20.0)}, "one of the two"),
        ({"gap": 1e-3}, "gap is given twice"),
    ],
)
def test_wrong_calls_are_answered_by_a_sentence(closed_rigs, wrong, words):
    call = {"objective": lambda p: p[0], **CALL, **wrong}
    with pytest.raises(ValueError, match=words):
        optimise(vj.default_rig, **call)
