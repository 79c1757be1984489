"""Maps of periodic responses and of branches, and derivatives of all of them."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from unit_oscillator import oscillator

import vibrojax as vj
from vibrojax.branches.points import BranchPoints, SpecialPoint
from vibrojax.maps import continuation_map

GRID = np.array([1.0, 1.1, 1.15, 1.2, 1.4])
GAPS = [3.5e-4, 4e-4]


def rig(gap=4e-4, stiffness=5500.0, base_amplitude=0.2e-3, damping=5e-5, num_modes=1):
    return vj.default_rig(
        gap=gap,
        stiffness=stiffness,
        base_amplitude=base_amplitude,
        damping=damping,
        num_modes=num_modes,
    )


@pytest.mark.slow
def test_periodic_points_are_those_of_single_calls():
    found = vj.parameter_map(rig, frequency_ratio=GRID[:3], gap=GAPS, response="periodic")
    assert found.amplitude_ratio.dims == ("gap", "frequency_ratio")
    assert (found.lane_status == 0).all()
    for gap in GAPS:
        for ratio in GRID[:3]:
            one = vj.periodic_response(rig(gap), frequency_ratio=ratio)
            point = found.sel(gap=gap, frequency_ratio=ratio)
            for name in ("amplitude_ratio", "contact_force", "leading_multiplier"):
                assert float(point[name]) == pytest.approx(float(getattr(one, name)), rel=1e-7)
            assert bool(point.stable) == bool(one.stable)
    wanted = found.amplitude_ratio.max("frequency_ratio")
    np.testing.assert_array_equal(found.peak_amplitude_ratio, wanted)


@pytest.fixture(scope="module")
def branches():
    return vj.parameter_map(
        rig,
        frequency_ratio=GRID,
        gap=GAPS,
        response="continuation",
        gradients=["gap", "stiffness"],
        keep_curves=True,
        measures=["fold", "grazing", "hysteresis_width", "peak_amplitude_ratio"],
    )


@pytest.mark.slow
def test_branches_are_those_of_single_calls(branches):
    assert branches.amplitude_ratio.dims == ("gap", "crossing", "frequency_ratio")
    assert branches.lane_status.attrs["flag_meanings"].startswith("completed incomplete")
    for gap in GAPS:
        branch = vj.continue_response(rig(gap), frequency_ratio=vj.Range(GRID[0], GRID[-1]))
        at, lane = branch.resample(GRID), branches.sel(gap=gap)
        crossings = at.sizes["crossing"]
        for name in ("amplitude_ratio", "contact_force", "leading_multiplier", "stable"):
            np.testing.assert_allclose(
                lane[name][:crossings].T, at[name], rtol=1e-7, atol=1e-9, err_msg=name
            )
        assert np.isnan(lane.amplitude_ratio[crossings:]).all()
        folds = np.array(lane.fold)
        np.testing.assert_allclose(folds[np.isfinite(folds)], branch.folds[:4], rtol=1e-7)
        assert float(lane.hysteresis_width) == pytest.approx(np.ptp(branch.folds), rel=1e-7)
    assert (branches.stable == 0).any()


def branch_with(*special_points):
    """A branch of an oscillator that holds nothing but these special points."""
    branch = object.__new__(BranchPoints)
    own = {"values": np.zeros(0), "initial_state": np.zeros((0, 2)), "period": 1, "ticks": 0}
    own |= {"status": "completed", "natural_frequency": 1.0, "special_points": special_points}
    for name, value in own.items():
        object.__setattr__(branch, name, value)
    return branch


def map_of_branch(monkeypatch, branch, measures, **more):
    monkeypatch.setattr(continuation_map, "follow_branches", lambda plan, paths: [branch])
    band = {"frequency": [0.1, 0.3]}
    return vj.parameter_map(
        oscillator, response="continuation", measures=measures, **band, gap=[1.2], **more
    )


@pytest.mark.parametrize(
    ("places", "width"),
    [
        ([], 0.0),
        ([0.2, 0.15], 0.05),
        ([0.2, 0.15, 0.18, 0.16, 0.14], 0.06),
        ([0.2, 0.15, 0.18, 0.16, 0.17, 0.13, 0.27, 0.14], 0.14),
    ],
)
def test_width_counts_folds_that_are_not_kept(monkeypatch, places, width):
    state = np.array([1.5, 0.0])
    branch = branch_with(
        *(SpecialPoint("fold", float(place), 5.0, 3.0, state, k) for k, place in enumerate(places))
    )
    found = map_of_branch(monkeypatch, branch, ["fold", "hysteresis_width"])
    assert float(found.hysteresis_width[0]) == pytest.approx(width, abs=1e-12)
    kept = found.fold[0].values
    np.testing.assert_array_equal(kept[np.isfinite(kept)], places[:4])


def test_a_fold_at_a_first_touch_has_a_derivative(monkeypatch):
    """There the amplitude without contact is the gap: |0.3 / (1 - w^2 + 0.1 w i)| = gap."""

    def touch(gap):
        b = 2 - 0.01
        square = (b - np.sqrt(b**2 - 4 * (1 - (0.3 / gap) ** 2))) / 2
        return float(np.sqrt(square)) / (2 * np.pi)

    place, step = touch(1.2), 1e-5
    corner = SpecialPoint("touch_fold", place, 4.0, 0.0, None, 1)
    branch = branch_with(corner, SpecialPoint("fold", 0.2, 5.0, 3.0, None, 2))
    found = map_of_branch(monkeypatch, branch, ["fold"], gradients="gap")
    slope = (touch(1.2 + step) - touch(1.2 - step)) / (2 * step)
    own = found.d_fold_d_gap[0].values
    assert own[0] == pytest.approx(slope, rel=1e-7)
    assert np.isnan(own[1:]).all()


def assert_difference(make, found, names, numbers, at, step=1e-4, rtol=2e-3):
    """Derivatives of a dataset against central differences of datasets made anew."""
    for number, value in numbers.items():
        ends = [make(**{number: value * (1 + side * step)}) for side in (1, -1)]
        for name in names:
            high, low = (at(end[name]) for end in ends)
            slope = (high - low) / (2 * step * value)
            own = at(found[f"d_{name}_d_{number}"])
            scale = np.nanmax(np.abs(slope))
            there = np.isfinite(own) & np.isfinite(slope)
            assert there.any(), (name, number)
            np.testing.assert_allclose(
                own[there], slope[there], rtol, rtol * scale, err_msg=f"{name} by {number}"
            )


@pytest.mark.slow
def test_derivatives_along_branches(branches):
    def make(**changed):
        numbers = {"gap": GAPS[1]} | changed
        return vj.parameter_map(
            rig,
            frequency_ratio=GRID,
            response="continuation",
            keep_curves=True,
            measures=["fold", "hysteresis_width"],
            **numbers,
        )

    one = branches.sel(gap=GAPS[1])
    numbers = {"gap": GAPS[1], "stiffness": 5500.0}
    names = ["amplitude_ratio", "contact_force", "fold", "hysteresis_width"]
    assert_difference(make, one, names, numbers, np.asarray)
    # Unstable motions have derivatives too.
    unstable = one.stable.values == 0
    assert np.isfinite(one.d_amplitude_ratio_d_gap.values[unstable]).all()


SWEEP = vj.SweepSettings(tolerance=1e-6, refine_jumps=1e-4)


def area_under(curve):
    return jnp.trapezoid(curve["amplitude_ratio"][0], curve["frequency_ratio"])


@pytest.mark.slow
@pytest.mark.long
def test_derivatives_of_sweeps():
    measures = {"area_under": area_under, "peak": lambda c: jnp.nanmax(c["amplitude_ratio"])}

    def make(**changed):
        numbers = {"stiffness": 5500.0, "base_amplitude": 0.2e-3} | changed
        return vj.parameter_map(
            rig,
            frequency_ratio=GRID,
            gap=GAPS,
            response=SWEEP,
            measures=measures,
            keep_curves=True,
            **numbers,
        )

    found = vj.parameter_map(
        rig,
        frequency_ratio=GRID,
        gap=GAPS,
        response=SWEEP,
        measures=measures,
        keep_curves=True,
        gradients=["stiffness", "base_amplitude"],
    )
    names = ["area_under", "peak", "amplitude_ratio", "contact_force", "rms_ratio"]
    assert_difference(
        make, found, names, {"stiffness": 5500.0, "base_amplitude": 0.2e-3}, np.asarray
    )
    assert found.d_peak_d_stiffness.attrs["units"] == "1/(N/m)"


@pytest.fixture(scope="module")
def slopes_of_folds():
    """Derivatives of the frequencies of the folds, down and up, with respect to the gap."""

    def one(gap):
        branches = (
            vj.continue_response(rig(gap * by), frequency_ratio=vj.Range(1.0, 1.45))
            for by in (0.999, 1.001)
        )
        a, b = (branch.folds for branch in branches)
        return (max(b) - max(a)) / (0.002 * gap), (min(b) - min(a)) / (0.002 * gap)

    return [one(gap) for gap in GAPS]


@pytest.mark.slow
@pytest.mark.parametrize("settle", ["follow", "march"])
def test_derivatives_of_jumps_are_those_of_their_folds(settle, slopes_of_folds):
    """A coarse grid: folds lie far from its points, and touches between them, which are passed.

    Folds have been solved for, or are looked for next to where motions jump that are marched to.
    """
    jumps = vj.parameter_map(
        rig,
        frequency_ratio=[1.0, 1.15, 1.25, 1.35, 1.45],
        gap=GAPS,
        response=dataclasses.replace(SWEEP, settle=settle),
        measures=["jump_up", "jump_down", "hysteresis_width", "natural_frequency"],
        gradients=["gap", "stiffness"],  # as of the branches: one program
    )
    assert jumps.d_jump_down_d_gap.attrs["units"] == "1/m"
    for k, (down, up) in enumerate(slopes_of_folds):
        assert float(jumps.d_jump_down_d_gap[k]) == pytest.approx(down, rel=1e-2)
        assert float(jumps.d_jump_up_d_gap[k]) == pytest.approx(up, rel=1e-2)
        assert float(jumps.d_hysteresis_width_d_gap[k]) == pytest.approx(down - up, rel=1e-2)
    assert (jumps.d_natural_frequency_d_gap == 0).all()


@pytest.mark.slow
def test_no_derivative_where_there_is_no_steady_state():
    settings = {"frequency_ratio": GRID, "gap": GAPS}
    # With so few periods nothing settles: the curve is flagged, and so is its derivative.
    found = vj.parameter_map(
        rig,
        response=vj.SweepSettings(max_period=1, max_periods=3, refine_jumps=None),
        gradients="gap",
        measures=["aperiodic_fraction", "peak_amplitude_ratio"],
        keep_curves=True,
        **settings,
    )
    aperiodic = found.status.values == 1
    assert aperiodic.any()
    assert np.isnan(found.d_amplitude_ratio_d_gap.values[aperiodic]).all()
    lost = (found.aperiodic_fraction == 1).values
    assert np.isnan(found.d_peak_amplitude_ratio_d_gap.values[lost]).all()
    assert lost.any()


@pytest.mark.slow
def test_a_measure_that_jax_cannot_trace_is_said():
    with pytest.raises(UserWarning, match="'numpy_only' cannot be differentiated"):
        vj.parameter_map(
            rig,
            frequency_ratio=[1.0, 1.05],
            gap=GAPS,
            response=vj.SweepSettings("forward", refine_jumps=None),
            measures={"numpy_only": lambda c: np.array(c["amplitude_ratio"]).max()},
            gradients="gap",
        )
