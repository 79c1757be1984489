"""Jumps that are folds are solved for: exact, whatever the grid and whoever sweeps beside them."""

import jax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.model.systems import as_arrays
from vibrojax.steady.fold_ahead import folds_ahead
from vibrojax.stepping.prepared_rigs import prepare, rigs_of
from vibrojax.sweep.swept_lanes import sweep_rigs

RANGE = 1.0, 1.42


def swept(system, step=0.02, settle="follow", **axes):
    ratios = np.arange(RANGE[0], RANGE[1] + step / 2, step)
    settings = vj.SweepSettings(settle=settle)
    return vj.frequency_sweep(system, frequency_ratio=ratios, settings=settings, **axes)


@pytest.fixture(scope="module")
def beam(rig):
    return rig(num_modes=1)


@pytest.fixture(scope="module")
def curve(beam):
    return swept(beam)


@pytest.fixture(scope="module")
def branch(beam):
    return vj.continue_response(beam, frequency_ratio=vj.Range(0.9, RANGE[1]))


def test_it_is_the_fold_of_the_branch_on_any_grid(beam, curve, branch):
    fold = max(branch.folds)
    assert curve.jump_down == pytest.approx(fold, rel=1e-9)
    assert swept(beam, step=0.007).jump_down == pytest.approx(fold, rel=1e-9)


def test_the_result_says_that_it_is_exact(curve):
    low, high = curve.jump_down_bracket
    assert low == high == curve.jump_down
    assert repr(curve).count("(a fold, exact)") == 2


def test_a_jump_close_behind_a_touch_is_exact_too(curve, branch):
    assert curve.jump_up == pytest.approx(min(branch.folds), rel=1e-9)
    (touch,) = branch.grazings[branch.grazings > RANGE[0]]
    assert 1e-6 < touch - curve.jump_up < 1e-4
    low, high = curve.jump_up_bracket
    assert low == high


def test_where_every_point_is_marched_to_so_are_jumps(beam, curve):
    marched = swept(beam, settle="march")
    low, high = marched.jump_down_bracket
    assert 0 < high - low <= 1e-4
    assert low <= curve.jump_down <= high


def test_lanes_do_not_depend_on_their_neighbours(rig, beam, curve):
    gaps = np.array([1.0, 3e-4, 4e-4, 6e-4])  # the first has no contact and does not jump
    both = swept(lambda gap: rig(num_modes=1, gap=gap), gap=gaps)
    widths = np.diff(both.jump_down_bracket, axis=1)[:, 0]
    assert np.isnan(both.jump_down[0])
    assert (widths[1:] == 0).all()
    assert both.jump_down[2] == pytest.approx(curve.jump_down, rel=1e-10)


def test_on_a_coarse_grid_they_are_those_of_a_fine_one(rig):
    """In one step of it forwards the response rises more than backwards it jumps."""
    gaps = np.array([3.5e-4, 4e-4])
    coarse, fine = (
        vj.frequency_sweep(lambda gap: rig(num_modes=1, gap=gap), frequency_ratio=ratios, gap=gaps)
        for ratios in (np.array([1.0, 1.1, 1.2, 1.3, 1.45]), np.linspace(1.0, 1.45, 91))
    )
    assert np.isfinite([fine.jump_up, fine.jump_down]).all()
    np.testing.assert_allclose(coarse.jump_down, fine.jump_down, rtol=1e-9)
    np.testing.assert_allclose(coarse.jump_up, fine.jump_up, rtol=1e-9)


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_one_direction_alone_finds_its_own(rig, direction):
    """On the way up the resonance is steep, backwards the response rises as fast as it jumps."""
    ratios, gaps = np.arange(0.9, 1.51, 0.05), np.array([3.5e-4, 4e-4])
    both, alone = (
        vj.frequency_sweep(
            lambda gap: rig(num_modes=1, gap=gap),
            frequency_ratio=ratios,
            gap=gaps,
            settings=vj.SweepSettings(direction=way),
        )
        for way in ("both", direction)
    )
    found, none = alone.jump_down, alone.jump_up
    if direction == "backward":
        found, none = none, found
    np.testing.assert_allclose(
        found, both.jump_down if direction == "forward" else both.jump_up, rtol=1e-9
    )
    assert np.isfinite(found).all()
    assert np.isnan(none).all()


@pytest.mark.parametrize("settle", ["follow", "march"])
def test_what_is_only_steep_is_none(rig, settle):
    linear = rig(num_modes=1, gap=0.1, damping_ratio=1e-3)
    settings = vj.SweepSettings(direction="forward", settle=settle)
    found = vj.frequency_sweep(
        linear, frequency_ratio=[0.9, 0.95, 0.98, 1.001, 1.01, 1.1], settings=settings
    )
    assert found.peak_amplitude_ratio > 20 * found.amplitude_ratio[0, 0]
    assert np.isnan([found.jump_up, found.jump_down]).all()


def ahead_of(beam, last, ways):
    """The folds ahead of where a forward sweep settles at its last ratio, for some ways."""
    grid = np.arange(RANGE[0], last + 0.01, 0.02)
    plan = vj.SweepSettings(direction="forward").plan(beam, "frequency_ratio", grid)
    prepared = prepare(plan.stepper, rigs_of(jax.tree.map(lambda a: a[None], as_arrays(beam))))
    upper = sweep_rigs(plan, prepared).states[0, 0, -1]
    first, count = float(prepared.first_frequency[0]), len(ways)
    start = np.zeros(count, int), np.tile(upper, (count, 1)), np.full(count, grid[-1] * first)
    way = np.array(ways) * first
    found, state = folds_ahead(prepared.march, *start, way, np.zeros(count, bool))
    return found / first, state


def test_none_is_found_that_lies_too_far_or_the_other_way(beam, curve):
    found, state = ahead_of(beam, 1.36, [0.1, 0.005, -0.1])
    assert np.isfinite(state).tolist() == [[True] * 2, [False] * 2, [False] * 2]
    assert found[0] == pytest.approx(curve.jump_down, rel=1e-9)
    assert np.isnan(found[1:]).all()


def test_the_branch_may_bend_much_in_the_last_step_before_a_fold(beam, curve):
    found, _ = ahead_of(beam, 1.34, [0.0595, 0.0597, 0.133, 0.1332, 0.267, 0.2672, 0.2674, 0.2676])
    np.testing.assert_allclose(found, curve.jump_down, rtol=1e-9)
