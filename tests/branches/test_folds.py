"""Folds as functions of the numbers of the system, and followed in a second one."""

import dataclasses
import sys

import jax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.branches.folds import Fold

RATIO = {"axis": "frequency_ratio"}


def folds(branch):
    return [p for p in branch.special_points if p.kind == "fold"]


def test_fold_response_refuses(small_branch, rig):
    fold = folds(small_branch)[0]
    with pytest.raises(ValueError, match="axis must be"):
        vj.fold_response(rig(), fold, axis="ratio")
    touch = next(p for p in small_branch.special_points if p.kind == "grazing")
    with pytest.raises(ValueError, match="fold with contact"):
        vj.fold_response(rig(), touch, **RATIO)
    base = rig()
    law = vj.KelvinVoigt(5500.0, 5e-5)
    soft = vj.ImpactingBeam(base.beam, vj.Stop(0.5, 4e-4, law, smoothing=1e-5), base.drive, 0.018)
    with pytest.raises(ValueError, match="linear stops"):
        vj.fold_response(soft, fold, **RATIO)


def test_fold_curves_refuse():
    with pytest.raises(ValueError, match="function that makes the system"):
        vj.fold_curves(
            vj.default_rig(), frequency_ratio=vj.Range(0.9, 1.3), gap=vj.Range(3e-4, 5e-4)
        )
    with pytest.raises(ValueError, match="frequency_ratio must be a Range"):
        vj.fold_curves(vj.default_rig, frequency_ratio=1.1, gap=vj.Range(3e-4, 5e-4))
    with pytest.raises(ValueError, match="is a list"):
        vj.fold_curves(
            vj.default_rig,
            frequency_ratio=vj.Range(0.9, 1.3),
            gap=vj.Range(3e-4, 5e-4),
            taper=[0.0, 0.5],
        )
    with pytest.raises(ValueError, match="start must be from"):
        vj.fold_curves(
            vj.default_rig, frequency_ratio=vj.Range(0.9, 1.3), gap=vj.Range(3e-4, 5e-4, 1e-3)
        )
    with pytest.raises(ValueError, match="frequency_ratio must be above 0"):
        vj.fold_curves(
            vj.default_rig, frequency_ratio=vj.Range(-0.5, 1.3), gap=vj.Range(3e-4, 5e-4)
        )

    def soft(gap):
        base, law = vj.default_rig(num_modes=1), vj.KelvinVoigt(5500.0, 5e-5)
        return vj.ImpactingBeam(
            base.beam, vj.Stop(0.5, gap, law, smoothing=1e-5), base.drive, 0.018
        )

    with pytest.raises(ValueError, match="fold_curves needs linear stops"):
        vj.fold_curves(soft, frequency_ratio=vj.Range(0.9, 1.3), gap=vj.Range(3e-4, 5e-4))


def function_of(near):
    def parameter(gap, stiffness, taper):
        rig = vj.default_rig(gap=gap, stiffness=stiffness, taper=taper, num_modes=1)
        return vj.fold_response(rig, near, **RATIO).parameter

    return parameter


AT = (0.4e-3, 5500.0, 0.5)


@pytest.mark.long  # two minutes
@pytest.mark.slow
def test_folds_and_their_gradients(small_branch):
    steps = (1e-8, 0.5, 1e-5)
    for fold, expected in zip(folds(small_branch), small_branch.folds, strict=True):
        parameter = function_of(fold)
        assert abs(float(parameter(*AT)) - expected) < 2e-7
        slopes = jax.grad(parameter, (0, 1, 2))(*AT)
        for k, step in enumerate(steps):
            up, down = ([*AT[:k], AT[k] + s * step, *AT[k + 1 :]] for s in (1, -1))
            difference = (parameter(*up) - parameter(*down)) / (2 * step)
            np.testing.assert_allclose(slopes[k], difference, rtol=2e-5)


@pytest.mark.slow
def test_forward_and_reverse_gradients_of_a_fold_agree(small_branch):
    parameter = function_of(folds(small_branch)[0])
    forward = jax.jacfwd(parameter, (0, 1, 2))(*AT)
    reverse = jax.grad(parameter, (0, 1, 2))(*AT)
    np.testing.assert_allclose(np.array(forward), np.array(reverse), rtol=1e-8)


@pytest.mark.long  # to compile
@pytest.mark.slow
def test_second_derivatives_of_a_fold_are_differences_of_the_first(small_branch):
    at = function_of(folds(small_branch)[0])
    slope, step = jax.grad(at, 1), 2.0
    second = jax.hessian(at, 1)(*AT)
    up, down = (slope(AT[0], AT[1] + s * step, AT[2]) for s in (1, -1))
    np.testing.assert_allclose(second, (up - down) / (2 * step), rtol=1e-5)


@pytest.mark.parametrize(("start", "low_ends"), [(4e-4, False), (3.005e-4, True)])
def test_a_fold_curve_has_as_many_points_as_are_allowed(
    small_branch, rig, monkeypatch, start, low_ends
):
    """Both ways together; what one of them does not need is there for the other."""
    module = sys.modules["vibrojax.branches.fold_curves"]
    few, none = "the points allowed did not suffice", jax.numpy.zeros(2)

    def fold_response(system, near, axis):
        return Fold(1.2 - 100 * system.stops[0].gap, 3.0, 1.0, none, jax.numpy.asarray(True))

    monkeypatch.setattr(module, "fold_response", fold_response)
    monkeypatch.setattr(module, "compile_search", lambda *_: None)
    monkeypatch.setattr(module, "continue_response", lambda *_, **__: small_branch)
    bounds, gap = vj.Range(0.9, 1.3), vj.Range(3e-4, 5e-4, start)
    for curve in vj.fold_curves(rig, frequency_ratio=bounds, gap=gap, max_points=9):
        assert len(curve.values) == 9
        assert np.all(np.diff(curve.values) > 0)
        assert curve.endings == ("end of the range" if low_ends else few, few)
        below = np.sum(curve.values < start)
        assert below == (2 if low_ends else 4)
    every = vj.fold_curves(rig, frequency_ratio=bounds, gap=gap)
    assert {curve.endings for curve in every} == {("end of the range", "end of the range")}
    assert every.to_xarray().attrs["low_ending"] == "end of the range"
    first, second = every
    other = dataclasses.replace(second, endings=(few, "end of the range"))
    attributes = dataclasses.replace(every, curves=(first, other)).to_xarray().attrs
    assert "low_ending" not in attributes  # it is not that of both


@pytest.mark.slow
def test_fold_curves_pass_through_the_folds_of_branches():
    def make(gap):
        return vj.default_rig(gap=gap, num_modes=1)

    bounds = vj.Range(0.9, 1.4)
    curves = vj.fold_curves(make, frequency_ratio=bounds, gap=vj.Range(0.36e-3, 0.6e-3, 0.4e-3))
    assert len(curves) == 2
    upper, lower = curves.curves
    assert upper.endings == lower.endings == ("end of the range", "end of the range")
    assert np.all(np.diff(upper.values) > 0)
    assert np.all(np.diff(upper.folds) < 0)
    branch = vj.continue_response(make(0.6e-3), frequency_ratio=bounds)
    assert abs(upper.folds[-1] - max(branch.folds)) < 1e-6
    # Near the touch there are more folds: the curve ends on one of them.
    assert np.min(np.abs(lower.folds[-1] - branch.folds)) < 1e-6
    data = curves.to_xarray()
    assert data.sizes["fold"] == 2
    assert data["gap"].attrs["units"] == "m"
    assert "gap" in repr(curves)
    assert curves.plot().axes[0].get_ylabel() == "Gap (m)"
