"""Fronts of two objectives that are known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from closed_forms import ClosedForm, Interrupted

from vibrojax.design.constraints import Constraint
from vibrojax.design.optimise import search_design
from vibrojax.design.pareto import pareto, search_front
from vibrojax.design.settings import OptimiseSettings
from vibrojax.design.variables import variables_of

BOX = variables_of({"x": (-2.0, 2.0), "y": (-1.0, 3.0)})
FEW = OptimiseSettings(starts=2, screened=16)


def near(place):
    return jnp.sum(place**2)


def far(place):
    return jnp.sum((place - 1.0) ** 2)


def test_the_front_of_two_bowls(tmp_path):
    # Between the two middles, where the roots of both add up to their distance.
    rigs = ClosedForm({"near": near, "far": far})
    front = search_front(rigs, BOX, points=7, settings=FEW)
    assert front.values.shape == (7, 2)
    assert set(front.status) == {"converged"}
    np.testing.assert_allclose(np.sqrt(front.values).sum(axis=1), np.sqrt(2), atol=2e-4)
    np.testing.assert_allclose(front.values[:, 1], np.linspace(2.0, 0.0, 7), atol=1e-3)
    np.testing.assert_allclose(front.designs[:, 0], front.designs[:, 1], atol=2e-3)
    assert max(rigs.batches[1:]) >= 10  # all points side by side
    data = front.to_xarray()
    for name, variable in data.variables.items():
        assert {"units", "long_name"} <= variable.attrs.keys(), name
    front.save(tmp_path / "front.nc")
    assert xarray.load_dataset(tmp_path / "front.nc").identical(data)
    figure = front.plot()
    assert figure.axes[0].get_xlabel() == "Near (least sought)"
    assert len(figure.axes) == 3
    figure.savefig(tmp_path / "front.png")
    assert front.design(6) == dict(zip("xy", front.designs[-1].tolist(), strict=True))
    with pytest.raises(ValueError, match="point must be a whole number from 0 to 6, got 7"):
        front.design(7)


def test_one_is_made_large_within_a_constraint():
    rigs = ClosedForm({"near": near, "closeness": lambda p: -far(p), "y": lambda p: p[1]})
    low = Constraint(len, most=0.25)
    front = search_front(rigs, BOX, [low], maximise=["closeness"], points=5, settings=FEW)
    assert front.values[-1].tolist() == pytest.approx([1.0625, -0.5625], abs=1e-3)
    assert (np.diff(front.values, axis=0) > 0).all()
    assert (front.constraints["y"] <= 0.25 + 1e-6).all()
    # Each is the least of one at the level of the other.
    level = Constraint(len, least=float(front.values[2, 1]))
    alone = search_design(rigs, BOX, [level, low], settings=FEW)
    assert front.values[2, 0] == pytest.approx(alone.value, abs=1e-4)


def test_dominated_points_are_left_out_and_said():
    front = search_front(ClosedForm({"near": near, "twice": lambda p: 2 * near(p)}), BOX)
    assert len(front.values) == 1
    assert "no trade" in front.sentence
    assert "left out" in front.sentence


def test_designs_without_a_value_of_one_objective_are_on_no_front():
    rigs = ClosedForm({"near": near, "far": lambda p: jnp.where(p[0] > 0.3, far(p), jnp.nan)})
    front = search_front(rigs, BOX, points=5, settings=FEW)
    assert np.isfinite(front.values).all()
    assert front.values[-1].tolist() == pytest.approx([2.0, 0.0], abs=1e-3)
    assert (front.designs[:, 0] >= 0.3).all()


def test_no_front_where_constraints_cannot_be_met():
    rigs = ClosedForm({"near": near, "far": far, "y": lambda p: p[1]})
    with pytest.warns(UserWarning, match="there is no front"):
        front = search_front(rigs, BOX, [Constraint(len, most=-5.0)], settings=FEW)
    assert front.values.shape == (0, 2)
    with pytest.raises(ValueError, match="nothing to draw"):
        front.plot()


@pytest.mark.parametrize("batch", [1, 3, 11])
def test_ctrl_c_leaves_the_front_so_far(batch):
    rigs = Interrupted({"near": near, "far": far}, batch=batch)
    front = search_front(rigs, BOX)
    assert front.sentence.startswith("Interrupted")
    assert len(front.values) >= 2
    assert set(front.status) <= {"converged", "interrupted"}
    assert "interrupted" in front.status


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"objectives": {"near": near}}, "two functions by name, got 1"),
        ({"maximise": ["nearr"]}, "Did you mean 'near'"),
        ({"points": 2}, "points must be a whole number of at least 3"),
    ],
)
def test_wrong_calls_are_answered_by_a_sentence(wrong, words):
    call = {"objectives": {"near": near, "far": far}, "variables": {"gap": (1e-4, 1e-3)}} | wrong
    with pytest.raises(ValueError, match=words):
        pareto(lambda gap: None, **call)
