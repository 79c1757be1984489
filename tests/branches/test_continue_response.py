"""Branches: folds, touches, stability and points against independent references."""

import inspect
import json
import re
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray
from scipy.optimize import brentq
from shown import check_result

import vibrojax as vj

DATA = Path(__file__).parents[1] / "data"
NAME = "C_MR0.5_mu0.5"
CASE = json.loads((DATA / "sweeps.json").read_text())["cases"][NAME]
SINGLE = json.loads((DATA / "single_contact.json").read_text())["cases"][NAME]
FOLDS = CASE["jump_down"], CASE["jump_up"]
RANGE = vj.Range(0.85, 1.31)
WIDE = vj.Range(0.85, 1.4)  # through both folds with one mode
GAPS, STIFFNESSES = [0.3e-3, 0.4e-3], [4000.0, 5500.0]


@pytest.fixture(scope="module")
def make(rig):
    def named(gap=0.4e-3, stiffness=5500.0):
        return rig(gap=gap, stiffness=stiffness, num_modes=1)

    return named


@pytest.fixture(scope="module")
def resampled(rig_branch):
    return rig_branch.resample(SINGLE["ratio"])


@pytest.fixture(scope="module")
def along_gap(make):
    return vj.continue_response(make, frequency_ratio=1.15, gap=vj.Range(0.2e-3, 1.0e-3))


@pytest.fixture(scope="module")
def branches(make):
    return vj.continue_response(make, frequency_ratio=WIDE, gap=GAPS, stiffness=STIFFNESSES)


def rounded_rig(one, smoothing=1e-5):
    return replace(one, stops=(replace(one.stops[0], smoothing=smoothing),))


def nearest_crossing(data, wanted):
    """Index of the crossing whose amplitude is the wanted one, at every value."""
    return np.nanargmin(np.abs(data.amplitude_ratio.values - np.array(wanted)[:, None]), axis=1)


def picked(data, name, crossing):
    return data[name].values[np.arange(len(crossing)), crossing]


@pytest.mark.slow
def test_folds_and_status(rig_branch):
    np.testing.assert_allclose(rig_branch.folds, FOLDS, atol=1e-5)
    np.testing.assert_allclose(rig_branch.folds, [1.2267357, 1.0965069], atol=1e-5)
    assert rig_branch.status == "completed"
    assert rig_branch.completed
    assert rig_branch.exact
    assert rig_branch.period_doublings.size == rig_branch.neimark_sackers.size == 0
    upper = next(p for p in rig_branch.special_points if p.kind == "fold")
    assert float(upper) == rig_branch.folds[0]
    assert not any(p.follows for p in rig_branch.special_points)  # unstable between folds only
    assert upper.amplitude_ratio == pytest.approx(33.729, rel=2e-3)  # of the listed jump, beside it
    assert upper.contact_force == pytest.approx(2.7095, rel=2e-3)


def test_grazings_are_where_the_free_motion_fills_the_gap(rig, small_branch):
    one = rig(num_modes=1).equations()
    w = np.asarray(one.angular_frequency)
    gain = np.asarray(one.stop_map[0] * one.input_map)
    zeta = np.asarray(one.damping_ratio)

    def clearance(ratio):
        drive = ratio * w[0]
        motion = gain * 0.2e-3 * drive**2 / (w**2 - drive**2 + 2j * zeta * w * drive)
        return np.abs(motion.sum()) - 0.4e-3

    expected = brentq(clearance, 0.85, 1.0, xtol=1e-14), brentq(clearance, 1.0, 1.3, xtol=1e-14)
    np.testing.assert_allclose(small_branch.grazings, expected, rtol=1e-9)


def test_stability_changes_at_the_folds(small_branch):
    first, second = (p.after for p in small_branch.special_points if p.kind == "fold")
    leading, between = small_branch.leading_multiplier, slice(first + 1, second)
    assert second - first > 20
    assert (leading[between] > 1).all()
    assert not small_branch.stable[between].any()
    assert small_branch.stable[:first].all()
    assert small_branch.stable[second + 1 :].all()
    # Past a fold it is a real multiplier that has left the circle.
    multipliers = small_branch.floquet_multipliers[between]
    outside = multipliers[np.arange(len(multipliers)), np.argmax(np.abs(multipliers), axis=1)]
    assert (outside.real > 1).all()
    assert (outside.imag == 0).all()


def test_points_are_exact_and_in_order(small_branch):
    points = len(small_branch.values)
    assert 50 < points < 400
    assert small_branch.exact_points.all()
    assert small_branch.residual.max() < 1e-9
    assert (np.diff(small_branch.arclength) > 0).all()
    assert small_branch.arclength[0] == 0
    assert small_branch.frequency_ratio is small_branch.values
    assert small_branch.values[0] == pytest.approx(WIDE.low, abs=1e-3)
    assert small_branch.values[-1] == pytest.approx(WIDE.high, abs=1e-3)
    assert small_branch.values.max() <= WIDE.high + 1e-6
    free = small_branch.contact_fraction == 0
    assert (small_branch.contact_force[free] == 0).all()
    assert (small_branch.contact_force[~free] > 0).all()
    assert set(np.unique(small_branch.contacts_per_period)) <= {0.0, 1.0, 2.0}
    assert small_branch.initial_state.shape == small_branch.floquet_multipliers.shape == (points, 2)
    with pytest.raises(AttributeError, match=r"^This branch runs along frequency_ratio"):
        _ = small_branch.frequency


def test_what_a_branch_has_not_is_no_attribute_of_it(small_branch):
    """So that notebooks can look through all that it has."""
    assert not hasattr(small_branch, "frequency")
    assert dict(inspect.getmembers(small_branch))["completed"]
    with pytest.raises(AttributeError, match="mean_power needs a Harvester with report='power'"):
        _ = small_branch.mean_power


@pytest.mark.slow
def test_resampled_points_are_those_of_the_reference(resampled):
    crossing = nearest_crossing(resampled, SINGLE["half_pp_ratio"])
    for ours, theirs in (
        ("amplitude_ratio", "half_pp_ratio"),
        ("peak_ratio", "amp_ratio"),
        ("contact_force", "max_contact_force"),
        ("contact_fraction", "contact_fraction"),
    ):
        found = picked(resampled, ours, crossing)
        np.testing.assert_allclose(found, SINGLE[theirs], rtol=1e-6, err_msg=ours)
    leading = picked(resampled, "leading_multiplier", crossing)
    np.testing.assert_allclose(leading, SINGLE["max_multiplier"], atol=1e-6)
    assert (picked(resampled, "stable", crossing) == 1).all()


def test_resampled_dataset(small_branch):
    ratios = np.linspace(0.86, 1.39, 27)
    resampled, folds = small_branch.resample(ratios), small_branch.folds
    assert resampled.amplitude_ratio.dims == ("frequency_ratio", "crossing")
    np.testing.assert_array_equal(resampled.frequency_ratio, ratios)
    assert resampled.crossing.attrs == {"units": "1", "long_name": "Passage of the branch, from 0"}
    ratio = resampled.frequency_ratio.values
    inside = (ratio > folds.min()) & (ratio < folds.max())
    found = np.isfinite(resampled.amplitude_ratio.values)
    np.testing.assert_array_equal(found.sum(axis=1), np.where(inside, 3, 1))
    np.testing.assert_array_equal(resampled.stable.values[inside], [[1.0, 0.0, 1.0]] * inside.sum())
    assert np.nanmax(resampled.residual) < 1e-9
    # Points of the branch itself are found again, the ends included; nothing beyond them.
    few = [0, len(small_branch.values) // 3, -1]
    again = small_branch.resample([*small_branch.values[few], 0.8, 1.5])
    crossing = nearest_crossing(
        again.isel(frequency_ratio=slice(3)), small_branch.amplitude_ratio[few]
    )
    np.testing.assert_allclose(
        picked(again, "amplitude_ratio", crossing), small_branch.amplitude_ratio[few], rtol=1e-8
    )
    assert np.isnan(again.amplitude_ratio.values[3:]).all()
    beside = small_branch.resample(small_branch.values[[0, -1]] * (1 + np.array([-5e-16, 5e-16])))
    assert np.isfinite(beside.amplitude_ratio[:, 0]).all()  # round-off at the ends
    for wrong in ([], [np.nan], [[1.0]]):
        with pytest.raises(ValueError, match=r"^values must be a non-empty list of finite"):
            small_branch.resample(wrong)


def check_ends(branch):
    """The ends of the range are the ends of the branch, and resampling gives them back."""
    assert branch.completed
    assert (branch.values[0], branch.values[-1]) == branch.range
    assert branch.values.min() == branch.range[0]
    assert branch.values.max() == branch.range[1]
    ends = branch.resample(branch.range)
    assert ends.amplitude_ratio.values[0, 0] == branch.amplitude_ratio[0]
    last = np.isfinite(ends.amplitude_ratio.values[1]).sum() - 1
    assert ends.amplitude_ratio.values[1, last] == branch.amplitude_ratio[-1]
    np.testing.assert_array_equal(ends.initial_state.values[1, last], branch.initial_state[-1])


@pytest.mark.slow
def test_branches_end_at_the_ends_of_their_range(rig):
    rigs = [
        (dict(gap=0.15e-3, stiffness=4.7e3, taper=0.2), (0.7156803, 1.0149318)),
        (dict(gap=0.2e-3, damping=0.02), (1.1, 1.3)),
        (dict(gap=0.3e-3, stiffness=1.1e4), (0.8585197, 1.1437899)),
        (dict(gap=0.1e-3, stiffness=1e3), (0.9203, 1.3969113)),
    ]
    for numbers, span in rigs:
        check_ends(vj.continue_response(rig(**numbers), frequency_ratio=vj.Range(*span)))


@pytest.mark.slow
def test_branches_along_another_number_end_at_the_ends_of_its_range(rig):
    def small(gap):
        return rig(num_modes=1, gap=gap)

    check_ends(vj.continue_response(small, frequency_ratio=1.1, gap=vj.Range(1.3e-4, 9.7e-4)))


def test_new_numbers_do_not_compile_again(rig, small_branch):
    small_branch.resample([1.0, 1.1])
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, _, **__: compiled.append(event) if "backend_compile" in event else None
    )
    one = rig(
        num_modes=1,
        taper=0.3,
        gap=5e-4,
        position=0.55,
        stiffness=4e3,
        damping=1e-3,
        amplitude=1.5e-4,
    )
    other = vj.continue_response(one, frequency_ratio=vj.Range(0.9, 1.25))
    other.resample([1.0, 1.1])
    assert other.completed
    assert not compiled
    jax.jit(lambda x: 3 * x + 17)(1.0)
    assert compiled  # the listener does listen


@pytest.mark.slow
def test_another_number_of_the_rig(small_branch, along_gap):
    """Branches along the gap and along the frequency meet where both have the same rig."""
    assert along_gap.axis == "gap"
    check_ends(along_gap)
    assert along_gap.residual.max() < 1e-9
    here = along_gap.resample([0.4e-3])
    there = small_branch.resample([1.15])
    assert here.amplitude_ratio.dims == ("gap", "crossing")
    assert here.gap.attrs["units"] == "m"
    ours, theirs = (np.sort(d.amplitude_ratio.values[0]) for d in (here, there))
    ours, theirs = ours[np.isfinite(ours)], theirs[np.isfinite(theirs)]
    assert len(theirs) == 3
    # The free motion, isolated from this branch by the touch, is on it only up to a fold.
    for amplitude in ours:
        assert np.abs(theirs / amplitude - 1).min() < 1e-8
    for name in ("contact_force", "leading_multiplier", "rms_ratio"):
        at = np.nanargmax(here.amplitude_ratio.values[0])
        match = np.nanargmax(there.amplitude_ratio.values[0])
        assert here[name].values[0, at] == pytest.approx(there[name].values[0, match], rel=1e-6)


@pytest.mark.slow
def test_points_along_a_number_that_changes_the_modes_are_on_branches_along_the_frequency():
    """However short the steps: the rig is known to first order only next to where it was made."""

    def make(taper):
        return vj.default_rig(taper=taper, num_modes=1)

    settings = vj.ContinuationSettings(longest_step=0.02)
    over = vj.Range(0.1, 0.8)
    branch = vj.continue_response(make, frequency_ratio=1.02, taper=over, settings=settings)
    assert len(branch.values) > 20
    for k in np.flatnonzero(branch.contacts_per_period)[::4]:
        system = make(float(branch.values[k]))
        other = vj.continue_response(system, frequency_ratio=vj.Range(1.0, 1.04)).resample([1.02])
        assert np.nanmin(np.abs(other.amplitude_ratio / branch.amplitude_ratio[k] - 1)) < 1e-9


def test_one_branch_per_value_of_the_axes(branches, small_branch):
    assert branches.shape == (2, 2)
    assert len(branches) == 4
    assert (branches.status == "completed").all()
    assert branches.status.shape == (2, 2)
    assert [b.labels for b in branches] == [
        {"gap": g, "stiffness": k} for g in GAPS for k in STIFFNESSES
    ]
    assert branches[1] is branches.sel(gap=0.31e-3, stiffness=6e3)
    assert repr(branches).startswith("Branches(gap: 2, stiffness: 2): ")
    own = branches.sel(gap=0.4e-3, stiffness=5500.0)
    # Where along the curve its points lie depends on rounding, the curve does not.
    np.testing.assert_allclose(own.values, small_branch.values, rtol=1e-5)
    np.testing.assert_allclose(own.folds, small_branch.folds, rtol=1e-9)
    np.testing.assert_allclose(own.grazings, small_branch.grazings, rtol=1e-12)
    ratios = [0.9, 1.0, 1.15, 1.3, 1.39]
    again, resampled = own.resample(ratios), small_branch.resample(ratios)
    for name in ("amplitude_ratio", "contact_force", "rms_ratio", "leading_multiplier"):
        np.testing.assert_allclose(again[name], resampled[name], rtol=1e-9, atol=1e-12)
    # A stiffer stop and a smaller gap bend the curve further up.
    down = np.array([b.folds.max() for b in branches]).reshape(2, 2)
    assert (np.diff(down, axis=0) < 0).all()
    assert (np.diff(down, axis=1) > 0).all()
    with pytest.raises(ValueError, match=r"^Unknown axis 'gaps'. Did you mean 'gap'\?"):
        branches.sel(gaps=1.0)
    with pytest.raises(ValueError, match=r"^Give a value of stiffness too"):
        branches.sel(gap=0.4e-3)


def test_dataset_over_axes(branches):
    data = branches.to_xarray()
    longest = max(len(b.values) for b in branches)
    assert dict(data.amplitude_ratio.sizes) == {"gap": 2, "stiffness": 2, "point": longest}
    np.testing.assert_array_equal(data.gap, GAPS)
    np.testing.assert_array_equal(data.stiffness, STIFFNESSES)
    assert data.folds.sizes["fold"] == max(len(b.folds) for b in branches)
    assert data.point.attrs == {"units": "1", "long_name": "Point, from 0"}
    for name, variable in data.variables.items():
        assert {"units", "long_name"} <= variable.attrs.keys(), name
    for b in branches:
        lane = data.sel(**b.labels)
        count = len(b.values)
        np.testing.assert_array_equal(lane.amplitude_ratio[:count], b.amplitude_ratio)
        np.testing.assert_array_equal(lane.frequency_ratio[:count], b.values)
        assert np.isnan(lane.amplitude_ratio[count:]).all()
        assert lane.status.item() == "completed"
        assert lane.ticks.item() == b.ticks


def test_saved_and_loaded(small_branch, branches, tmp_path):
    check_result(small_branch)
    small_branch.save(tmp_path / "branch.nc")
    with xarray.open_dataset(tmp_path / "branch.nc", engine="h5netcdf") as loaded:
        loaded.load()
    data = small_branch.to_xarray()
    xarray.testing.assert_equal(loaded, data)
    assert loaded.attrs["status"] == "completed"
    assert loaded.attrs["rig"]
    assert data.amplitude_ratio.dims == ("point",)
    assert {"frequency_ratio", "arclength"} <= set(data.coords)
    np.testing.assert_array_equal(loaded.folds, small_branch.folds)
    for name, variable in loaded.data_vars.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    branches.to_xarray().to_netcdf(tmp_path / "branches.nc", engine="h5netcdf")


def test_summary_in_words(small_branch):
    text = repr(small_branch)
    assert "fold at 1.381305" in text
    assert f"{small_branch.stable.sum()} of {len(small_branch.values)} points" in text
    assert "The branch reaches the end of the range." in text


@pytest.fixture(scope="module")
def rounded(make):
    return vj.continue_response(rounded_rig(make()), frequency_ratio=WIDE)


@pytest.mark.slow
def test_rounded_stop_by_harmonic_balance(rounded, small_branch):
    assert rounded.completed
    assert not rounded.exact
    assert len(rounded.folds) == 2
    assert rounded.neimark_sackers.size == 0
    np.testing.assert_allclose(rounded.folds, small_branch.folds, rtol=1e-3)
    assert rounded.residual.max() < 1e-3
    inside = (rounded.values > 1.11) & (rounded.values < 1.36)
    assert inside.sum() > 20
    leading = rounded.leading_multiplier[inside]
    first, second = (p.after for p in rounded.special_points if p.kind == "fold")
    order = np.flatnonzero(inside)
    unstable = (order > first) & (order < second)
    assert (leading[unstable] > 1).all()
    assert (leading[~unstable] < 1).all()


@pytest.mark.slow
def test_rounded_stop_resampled(rounded, small_branch):
    data, sharp = (branch.resample([1.0, 1.05, 1.15, 1.2]) for branch in (rounded, small_branch))
    np.testing.assert_array_equal(np.isfinite(data.amplitude_ratio).sum(axis=1), [1, 1, 3, 3])
    np.testing.assert_allclose(data.amplitude_ratio, sharp.amplitude_ratio, rtol=1e-2)


@pytest.mark.slow
def test_start_inside_the_range(make, small_branch):
    """From the upper motion at 1.15 the branch is followed both ways."""
    upper = vj.periodic_response(make(), frequency_ratio=1.15, guess=_upper(small_branch, 1.15))
    both = vj.continue_response(make(), frequency_ratio=WIDE, start=upper)
    check_ends(both)
    np.testing.assert_allclose(both.folds, small_branch.folds, atol=1e-7)
    np.testing.assert_allclose(both.grazings, small_branch.grazings, atol=1e-9)
    assert (np.diff(both.arclength) > 0).all()
    assert both.residual.max() < 1e-9
    again = vj.continue_response(
        make(), frequency_ratio=WIDE, start=(np.asarray(upper.initial_state), 1.15)
    )
    np.testing.assert_allclose(again.folds, both.folds, atol=1e-9)
    with pytest.raises(ValueError, match=r"^start has frequency_ratio = 1.5, outside the range"):
        vj.continue_response(make(), frequency_ratio=WIDE, start=(upper.initial_state, 1.5))
    with pytest.raises(ValueError, match=r"^start must be a PeriodicResponse or a tuple of 2"):
        vj.continue_response(make(), frequency_ratio=WIDE, start="here")


def _upper(branch, ratio):
    return branch.resample([ratio]).initial_state.values[0, 0]


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"period": 0}, "period must be"),
        ({"max_points": 5}, "max_points must be"),
        ({"longest_step": 0.0}, "longest_step must be from 1e-4 to 1"),
        ({"tolerance": 0.0}, "tolerance must be above 0, up to 0.1"),
    ],
)
def test_wrong_settings_are_refused(settings, sentence):
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}"):
        vj.ContinuationSettings(**settings)


def build(gap=0.4e-3, stiffness=5500.0):
    raise AssertionError("not to be called")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({}, "Give frequency_ratio or frequency, one of the two."),
        ({"frequency_ratio": RANGE, "frequency": RANGE}, "Give frequency_ratio or frequency, one"),
        (
            {"frequency_ratio": vj.Range(0.0, 1.0)},
            "frequency_ratio must be above 0 (ratio)",
        ),
        (
            {"frequency_ratio": (1.0, 1.1)},
            "frequency_ratio must be a range, vj.Range(low",
        ),
        ({"frequency_ratio": [1.0, 1.1, 1.2]}, "frequency_ratio must be a range, vj.Range(low"),
        ({"frequency_ratio": 1.0}, "Give exactly one vj.Range(low, high) to follow"),
        ({"frequency_ratio": 1.0, "gap": 1e-3}, "Give exactly one vj.Range(low, high) to follow"),
        (
            {"frequency_ratio": RANGE, "gap": vj.Range(1e-4, 1e-3)},
            "Give exactly one vj.Range(low, high)",
        ),
        (
            {"frequency_ratio": 1.0, "gap": vj.Range(1e-4, 1e-3), "stiffness": vj.Range(1.0, 2.0)},
            "Give exactly one vj.Range(low, high) to follow",
        ),
        (
            {"frequency_ratio": 1.0, "gaap": vj.Range(1e-4, 1e-3)},
            "Unknown argument 'gaap' of the rig. Did you mean",
        ),
        ({"frequency_ratio": RANGE, "gap": []}, "gap must be a non-empty list of finite numbers"),
        ({"frequency_ratio": RANGE, "gap": [np.nan]}, "gap must be a non-empty list of finite"),
    ],
)
def test_wrong_arguments_are_refused(arguments, sentence):
    with pytest.raises(ValueError, match="^" + re.escape(sentence)):
        vj.continue_response(build, **arguments)


def test_systems_that_cannot_be_followed(rig):
    one = rig()
    with pytest.raises(ValueError, match=r"^Unknown argument 'gap'. To follow or vary"):
        vj.continue_response(one, frequency_ratio=1.0, gap=vj.Range(1e-4, 1e-3))
    with pytest.raises(ValueError, match=r"needs a drive with an amplitude above 0"):
        vj.continue_response(replace(one, drive=vj.NoDrive()), frequency_ratio=RANGE)
    with pytest.raises(ValueError, match=r"^The system has no stops, so its response is linear"):
        vj.continue_response(replace(one, stops=()), frequency_ratio=RANGE)
    with pytest.raises(ValueError, match=r"must return a system, got None"):
        vj.continue_response(lambda: None, frequency_ratio=RANGE)
    with pytest.raises(ValueError, match=r"^start is for one branch: give no lists besides it"):
        vj.continue_response(
            lambda gap: rig(gap=gap), frequency_ratio=RANGE, gap=GAPS, start=(np.zeros(10), 1.0)
        )
    with pytest.raises(ValueError, match=r"taper"):  # the ends of a range are built, so checked
        vj.continue_response(
            lambda taper: rig(taper=taper), frequency_ratio=1.0, taper=vj.Range(-0.1, 0.5)
        )


@pytest.mark.parametrize(
    ("method", "tolerance", "sentence"),
    [
        (vj.HarmonicBalance(samples=32), 1e-5, r"^tolerance = 1e-05 is out of reach of 32 samples"),
        (None, 1e-9, r"^tolerance = 1e-09 is out of reach of harmonic balance"),
    ],
)
def test_tolerance_out_of_reach(rig, method, tolerance, sentence):
    with pytest.raises(ValueError, match=sentence):
        vj.continue_response(
            rounded_rig(rig()),
            frequency_ratio=RANGE,
            settings=vj.ContinuationSettings(method=method, tolerance=tolerance),
        )
