"""Branches beside the one that is followed, which no sweep from rest finds."""

import numpy as np
import pytest

import vibrojax as vj

AMPLITUDE = 3.8215e-5
"""Below 4.17e-5 m free motions nowhere reach the stop; from 3.8206e-5 m on there is an isola."""
ABOUT = vj.Range(0.9, 1.4)


def rig(base_amplitude=AMPLITUDE, stiffness=1e6):
    return vj.default_rig(base_amplitude=base_amplitude, stiffness=stiffness, num_modes=1)


@pytest.fixture(scope="module")
def branch():
    return vj.continue_response(rig(), frequency_ratio=ABOUT, isolas=True)


@pytest.mark.slow
def test_an_isola_is_found_and_closes(branch):
    (isola,) = branch.isolas
    assert (branch.contact_fraction == 0).all()
    assert (isola.contact_fraction > 0).all()
    assert isola.status == "closed"
    assert isola.values[0] == isola.values[-1]
    # It lies between two of the places at which others are looked for.
    assert np.ptp(isola.values) < 0.02
    assert 0 < isola.stable.sum() < len(isola.values)
    assert np.max(isola.residual) < 1e-9
    assert "closed" in repr(branch)
    assert branch.plot().axes[0].lines


@pytest.mark.slow
def test_its_folds_are_those_along_the_amplitude(branch):
    """At the frequency of a fold the branch along the amplitude folds at that of the rig."""
    (isola,) = branch.isolas
    assert len(isola.folds) == 2
    for fold in isola.folds:
        along = vj.continue_response(
            rig, frequency_ratio=fold, base_amplitude=vj.Range(0.2e-4, 2e-3)
        )
        assert np.abs(along.folds / AMPLITUDE - 1).min() < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(("amplitude", "isolas"), [(3.8200e-5, 0), (4.0e-5, 1)])
def test_others_are_found_where_there_are_any(amplitude, isolas):
    """Where the curve of folds just fails to reach the gap; and an isola of half the range."""
    other = vj.continue_response(rig(amplitude), frequency_ratio=ABOUT, isolas=True)
    assert len(other.isolas) == isolas


@pytest.mark.slow
def test_what_is_on_the_branch_is_no_isola(branch):
    """With hysteresis two stable motions coexist: both are of the branch."""
    soft = vj.continue_response(rig(2e-4, 5500.0), frequency_ratio=vj.Range(0.9, 1.6), isolas=True)
    assert len(soft.folds) == 2
    assert soft.isolas == ()


@pytest.mark.slow
@pytest.mark.parametrize("beyond", [0.1, 2e-3])
def test_what_leaves_the_range_and_comes_back_is_compared_too(beyond):
    """The branch goes up beyond the range: its lower part comes back in at the high end."""
    soft = rig(2e-4, 5500.0)
    fold = vj.continue_response(soft, frequency_ratio=vj.Range(0.9, 1.6)).folds.min()
    settings = vj.SweepSettings(direction="backward")
    ratios = fold + np.array([0.5 * beyond, 0.8 * beyond, 0.12])  # downwards from beyond the range
    lower = vj.frequency_sweep(soft, frequency_ratio=ratios, settings=settings)
    bounds = vj.Range(0.9, fold + beyond)
    alone = vj.continue_response(soft, frequency_ratio=bounds)
    assert alone.compare(lower)["on_branch"].values.tolist() == [[0, 0, -1]]
    both = vj.continue_response(soft, frequency_ratio=bounds, isolas=True)
    assert both.compare(lower)["on_branch"].values.tolist() == [[1, 1, -1]]


def test_stops_that_are_not_linear_are_refused():
    beam = vj.default_rig().beam
    hertz = vj.ImpactingBeam(beam, vj.Stop(0.5, 4e-4, vj.Hertz(1e8)), vj.BaseMotion(2e-4))
    with pytest.raises(ValueError, match="isolas must be False"):
        vj.continue_response(hertz, frequency_ratio=ABOUT, isolas=True)
