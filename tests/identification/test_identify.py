"""Identification from measured curves: recovery, uncertainty, and what it says of poor data."""

import base64
import io
import json
import re
import runpy
import zipfile
from pathlib import Path

import numpy as np
import optax
import pytest
from scipy.signal import butter, sosfilt

import vibrojax as vj
from vibrojax.identification.coordinates import coordinate_of, estimate_at
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.findings import modes_left_out
from vibrojax.identification.least_squares import LevenbergMarquardt
from vibrojax.identification.trail import Trail, residuals_along
from vibrojax.identification.trial_rigs import Maker
from vibrojax.identification.uncertainty import influence, uncertainty

DATA = Path(__file__).parents[1] / "data"
SWEEPS = json.loads((DATA / "sweeps.json").read_text())["cases"]
GUESS = dict(stiffness=3000.0, damping=1e-4)


def listed(name):
    """A sweep of the independent reference, both ways."""
    case = SWEEPS[name]
    ratio = np.concatenate([case[way]["ratio"] for way in ("forward", "backward")])
    amplitude = np.concatenate([case[way]["half_pp_ratio"] for way in ("forward", "backward")])
    count = len(case["forward"]["ratio"])
    direction = np.repeat([1, -1], [count, len(ratio) - count])
    return ratio, amplitude, direction


def measured(seed=0, *, name, noise=0.02, **facts):
    """The sweep with noise."""
    ratio, amplitude, direction = listed(name)
    deviation = np.hypot(noise * amplitude, 0.05)
    scatter = deviation * np.random.default_rng(seed).standard_normal(ratio.size)
    return vj.io.MeasuredCurve(
        ratio,
        "frequency_ratio",
        amplitude=np.abs(amplitude + scatter),
        amplitude_deviation=deviation,
        direction=direction,
        **facts,
    )


@pytest.fixture(scope="module")
def name():
    """The reference case with the default rig."""
    for name, case in SWEEPS.items():
        p = case["parameters"]
        if p["mr"] == p["mu"] == 0.5 and p["variant"] == "consistent" and p["lam"] == 0.4e-3:
            return name
    raise AssertionError("no reference case with the default rig")


@pytest.fixture(scope="module")
def make(rig):
    def make(stiffness=5500.0, damping=5e-5, gap=0.4e-3):
        return rig(stiffness=stiffness, damping=damping, gap=gap)

    return make


@pytest.fixture(scope="module")
def fit(make, name):
    return vj.identify(make, measured(name=name), GUESS)


def test_recovers_the_stiffness_and_bounds_the_damping(fit):
    low, high = fit.interval["stiffness"]
    assert low < 5500 < high
    assert fit.estimate["stiffness"] == pytest.approx(5500, rel=0.04)
    assert fit.identifiability["stiffness"] == "identifiable"
    # 5e-5 N s/m cannot be seen in an amplitude curve: a bound, not a number.
    assert fit.identifiability["damping"].startswith("not identifiable")
    assert not fit.identifiable["damping"]
    assert fit.interval["damping"][0] == 0.0
    assert 5e-5 < fit.interval["damping"][1] <= 1.0
    assert 0.6 < fit.reduced_chi_square < 1.3
    assert fit.warnings == ()


@pytest.mark.slow
def test_the_script_of_a_report_finds_the_same_numbers(fit, tmp_path):
    fit.report(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text("utf-8")
    archive = re.search(r'data:application/zip;base64,([^"]+)', page)
    assert archive is not None
    zipfile.ZipFile(io.BytesIO(base64.b64decode(archive[1]))).extractall(tmp_path)
    again = runpy.run_path(str(tmp_path / "run_again.py"))["fit"]
    assert again.estimate == pytest.approx(fit.estimate, rel=1e-9)
    assert again.interval["stiffness"] == pytest.approx(fit.interval["stiffness"], rel=1e-9)


@pytest.mark.slow
def test_poor_guesses_end_in_the_same_place_soon(make, name, fit):
    for stiffness, damping in ((500.0, 10.0), (50000.0, 1e-6)):
        other = vj.identify(make, measured(name=name), dict(stiffness=stiffness, damping=damping))
        assert other.chi_square == pytest.approx(fit.chi_square, abs=0.1)
        near = 0.25 * fit.standard_deviation["stiffness"]
        assert other.estimate["stiffness"] == pytest.approx(fit.estimate["stiffness"], abs=near)
        assert other.evaluations <= 30


def test_repetitions_side_by_side_are_what_they_are_alone(make, name, fit):
    curves = [measured(1, name=name), measured(0, name=name)]
    together = vj.identify(make, curves, GUESS, together=False)
    assert len(together) == 2
    alone = fit.estimate["stiffness"]
    # Searches end within a hundredth of a standard deviation.
    near = 0.05 * fit.standard_deviation["stiffness"]
    assert together[1].estimate["stiffness"] == pytest.approx(alone, abs=near)
    assert together[0].estimate["stiffness"] != pytest.approx(alone, abs=near)


def test_residuals_are_distances_over_the_deviation(fit):
    both = np.concatenate([fit.residuals("forward"), fit.residuals("backward")])
    assert both.size == fit.measured[0].size
    assert np.sum(both**2) == pytest.approx(fit.chi_square, rel=1e-9)
    assert 0.3 < np.mean(both > 0) < 0.7
    with pytest.raises(ValueError, match="forward"):
        fit.residuals("up")


@pytest.mark.slow
def test_the_derivative_of_the_misfit(make, name):
    data = measured(name=name)
    misfit = CurveMisfit(Maker(make, ("stiffness", "damping"), {}, {}), [data])
    which = np.zeros(1, int)

    def squares(numbers):
        residual, _ = misfit.residuals(numbers[None], which, 0.001, precisely=True)
        return float(np.sum(residual**2))

    at = np.array([5300.0, 0.05])
    residual, derivative = misfit.residuals(at[None], which, 0.001, precisely=True)
    slope = 2 * residual[0] @ derivative[0]
    for k, step in enumerate((2.5, 5e-4)):
        way = np.eye(2)[k] * step

        def central(h, way=way, step=step):
            return (squares(at + h * way) - squares(at - h * way)) / (2 * h * step)

        richardson = (4 * central(1.0) - central(2.0)) / 3
        assert slope[k] == pytest.approx(richardson, rel=1e-6, abs=1e-6)
    extreme = np.array([[1e-3, 0.0], [1e8, 1e3], [np.nan, 1.0]])
    residual, derivative = misfit.residuals(extreme, np.zeros(3, int), 0.005)
    assert np.isfinite(residual).all()
    assert np.isfinite(derivative).all()


def test_a_trial_that_is_near_follows_no_curve(make, name, monkeypatch):
    misfit = CurveMisfit(Maker(make, ("stiffness", "damping"), {}, {}), [measured(name=name)])
    which, trail = np.zeros(1, int), Trail()

    def along(numbers):
        return residuals_along(trail, [(0, 0)], misfit, np.array([numbers]), which, 0.001, False)

    def no_curve(*_):
        raise AssertionError("a curve was followed")

    first = along([5480.0, 0.05])
    expected = misfit.residuals(np.array([[5495.0, 0.08]]), which, 0.001)
    with monkeypatch.context() as patched:
        patched.setattr(CurveMisfit, "curves", no_curve)
        again = along([5480.0, 0.05])
        near = along([5495.0, 0.08])
        with pytest.raises(AssertionError, match="followed"):
            along([2000.0, 0.05])
    # Searches solve for a point to a thousandth of the motion: distances are off by its square,
    # derivatives next to folds by more.
    np.testing.assert_allclose(near[0], expected[0], atol=5e-3)
    close = np.isclose(near[1], expected[1], rtol=1e-3, atol=2e-3 * np.abs(expected[1]).max())
    assert close.mean() > 0.97
    assert all(np.array_equal(a, b) for a, b in zip(again, first, strict=True))
    # Points without contact stay where they are.
    kept = trail[0, 0]
    assert 10 < kept.rests.sum() < misfit.points
    still = kept.nearest.derivative[kept.rests]
    assert not still.any()


def test_a_point_that_was_predicted_wrongly_is_looked_for_on_the_curve(make, name):
    misfit = CurveMisfit(Maker(make, ("stiffness", "damping"), {}, {}), [measured(name=name)])
    which, at = np.zeros(1, int), np.array([[5480.0, 0.05]])
    trail = Trail()
    residuals_along(trail, [(0, 0)], misfit, at, which, 0.001, False)
    kept = trail[0, 0]
    # A point that is on the curve, but far from the one that is nearest.
    elsewhere = kept.nearest.frequency.copy()
    point = int(np.flatnonzero(~kept.rests)[5])
    elsewhere[point] = kept.nearest.frequency[point - 5]
    depth = kept.nearest.depth.copy()
    depth[point] = kept.nearest.depth[point - 5]
    wrong = kept.nearest._replace(frequency=elsewhere, depth=depth)
    trail[0, 0] = kept._replace(nearest=wrong)
    near = at + np.array([[1.0, 0.0]])
    found, _ = residuals_along(trail, [(0, 0)], misfit, near, which, 0.001, False)
    expected, _ = misfit.residuals(near, which, 0.001)
    np.testing.assert_allclose(found, expected, atol=0.01)


@pytest.mark.slow
def test_an_early_jump_biases_nothing_and_is_named(make, name):
    data = measured(3, name=name)
    amplitude = data.amplitude.copy()
    forward = np.flatnonzero(data.direction == 1)
    jump = next(j for j in data.jumps() if j.direction == 1)
    last = int(np.flatnonzero(forward == jump.at)[0])
    backward = {
        r: a
        for r, a, d in zip(data.frequency, data.amplitude, data.direction, strict=True)
        if d == -1
    }
    for k in forward[last - 3 : last]:
        amplitude[k] = backward[data.frequency[k]]
    deviation = np.hypot(0.02 * amplitude, 0.05)
    early = vj.io.MeasuredCurve(
        data.frequency,
        "frequency_ratio",
        amplitude=amplitude,
        amplitude_deviation=deviation,
        direction=data.direction,
    )
    fit = vj.identify(make, early, GUESS)
    assert fit.estimate["stiffness"] == pytest.approx(5500, rel=0.06)
    low, high = fit.interval["stiffness"]
    assert low < 5500 < high
    assert any("forward sweep jumped early" in w for w in fit.warnings)


@pytest.mark.long
@pytest.mark.slow
def test_the_gap_too(make, name):
    fit = vj.identify(make, measured(4, name=name), GUESS | dict(gap=0.7e-3))
    assert fit.estimate["gap"] == pytest.approx(0.4e-3, rel=0.01)
    assert fit.estimate["stiffness"] == pytest.approx(5500, rel=0.04)
    assert any("gap of" in n for n in fit.notes)
    profile = fit.profile("gap")
    assert profile.interval[0] < 0.4e-3 < profile.interval[1]
    np.testing.assert_allclose(profile.interval, fit.interval["gap"], rtol=0.005)


@pytest.mark.long
@pytest.mark.slow
def test_a_wrong_model_is_noticed(rig, name):
    def printed(stiffness=5500.0, damping=5e-5):
        return rig(stiffness=stiffness, damping=damping, formulation="as_printed")

    fit = vj.identify(printed, measured(5, name=name), GUESS)
    assert fit.reduced_chi_square > 10
    assert any("does not explain" in w for w in fit.warnings)
    assert any("same sign" in w for w in fit.warnings)


@pytest.mark.slow
@pytest.mark.long
def test_shared_and_private_numbers(make, name):
    curves = [measured(6, name=name, label="a"), measured(7, name=name, label="b")]
    fit = vj.identify(make, curves, GUESS | dict(gap=0.4e-3), private=("gap",))
    assert fit.names == ("stiffness", "damping", "gap[a]", "gap[b]")
    for label in "ab":
        assert fit.estimate[f"gap[{label}]"] == pytest.approx(0.4e-3, rel=0.01)
    one = vj.identify(make, curves[0], GUESS | dict(gap=0.4e-3))
    assert fit.standard_deviation["stiffness"] < 0.9 * one.standard_deviation["stiffness"]


@pytest.mark.long
@pytest.mark.slow
def test_the_posterior_agrees_with_the_interval(make, name):
    pytest.importorskip("blackjax")
    strong = vj.frequency_sweep(make(damping=2.0), frequency_ratio=np.linspace(0.85, 1.31, 50))
    data = vj.io.read_measured_curve(strong.to_xarray())
    deviation = np.hypot(0.02 * data.amplitude, 0.05)
    scatter = deviation * np.random.default_rng(1).standard_normal(data.size)
    noisy = vj.io.MeasuredCurve(
        data.frequency,
        "frequency_ratio",
        amplitude=data.amplitude + scatter,
        amplitude_deviation=deviation,
        direction=data.direction,
    )
    fit = vj.identify(make, noisy, GUESS)
    assert fit.interval["damping"][0] > 0
    assert fit.interval["damping"][0] < 2.0 < fit.interval["damping"][1]
    posterior = fit.sample(2000)
    assert posterior.effective_size > 50
    for n in fit.names:
        width = fit.interval[n][1] - fit.interval[n][0]
        np.testing.assert_allclose(posterior.interval[n], fit.interval[n], atol=0.25 * width)
    suggested = fit.what_next("damping", gap=[0.3e-3, 0.5e-3])
    assert suggested.best.deviation < 0.9
    assert {c.changes["gap"] for c in suggested.candidates} == {0.3e-3, 0.5e-3}
    with pytest.raises(ValueError, match="what is fitted"):
        fit.what_next("damping", stiffness=[1e3])


@pytest.mark.slow
@pytest.mark.long
def test_optax_and_the_other_objectives(make, name, fit):
    adam = vj.identify(
        make,
        measured(name=name),
        dict(stiffness=5000.0),
        search=vj.identification.Optax(optax.adam(0.02), steps=60),
    )
    assert adam.estimate["stiffness"] == pytest.approx(fit.estimate["stiffness"], rel=0.01)
    for objective in ("pointwise", "folds"):
        other = vj.identify(make, measured(name=name), GUESS, objective=objective)
        assert other.estimate["stiffness"] == pytest.approx(5500, rel=0.04)


@pytest.fixture(scope="module")
def one_mode(rig):
    """Maker of a rig with one mode, and a noisy sweep of it."""

    def make(stiffness=5500.0):
        return rig(stiffness=stiffness, num_modes=1)

    swept = vj.frequency_sweep(make(), frequency_ratio=np.linspace(0.85, 1.45, 40))
    data = vj.io.read_measured_curve(swept.to_xarray())
    deviation = np.hypot(0.02 * data.amplitude, 0.05)
    scatter = deviation * np.random.default_rng(2).standard_normal(data.size)
    noisy = vj.io.MeasuredCurve(
        data.frequency,
        "frequency_ratio",
        amplitude=np.abs(data.amplitude + scatter),
        amplitude_deviation=deviation,
        direction=data.direction,
    )
    return make, noisy


@pytest.mark.slow
def test_every_objective_and_search_on_one_mode(one_mode):
    adam = vj.identification.Optax(optax.adam(0.02), steps=60)
    for more in ({"objective": "pointwise"}, {"objective": "folds"}, {"search": adam}):
        fit = vj.identify(*one_mode, dict(stiffness=5000.0), **more)
        assert fit.estimate["stiffness"] == pytest.approx(5500, rel=0.04), more


@pytest.mark.slow
def test_profile_and_posterior_agree_with_the_interval_on_one_mode(one_mode):
    pytest.importorskip("blackjax")
    fit = vj.identify(*one_mode, dict(stiffness=5000.0))
    low, high = fit.interval["stiffness"]
    assert low < 5500 < high
    near = 0.25 * (high - low)
    np.testing.assert_allclose(fit.profile("stiffness").interval, (low, high), atol=near)
    np.testing.assert_allclose(fit.sample(1000).interval["stiffness"], (low, high), atol=near)


def test_what_it_refuses(make, name):
    data = measured(name=name)
    with pytest.raises(ValueError, match="Did you mean 'stiffness'"):
        vj.identify(make, data, dict(stifness=3000.0))
    with pytest.raises(ValueError, match="outside its bounds"):
        vj.identify(make, data, GUESS, bounds=dict(stiffness=vj.Range(1e4, 1e5)))
    with pytest.raises(ValueError, match="bounds of stiffness must be a range"):
        vj.identify(make, data, GUESS, bounds=dict(stiffness=(1e3, 1e5)))
    with pytest.raises(ValueError, match="gap must be one value that is held fixed"):
        vj.identify(make, data, GUESS, gap=[3e-4, 4e-4])
    with pytest.raises(ValueError, match="each of its elements to be fitted by itself"):
        vj.identify(make, data, GUESS, together=False)
    with pytest.raises(ValueError, match="both fitted"):
        vj.identify(make, data, GUESS, stiffness=5500.0)
    with pytest.raises(ValueError, match="fewer measured points"):
        vj.identify(
            make,
            vj.io.MeasuredCurve(np.array([1.0]), "frequency_ratio", amplitude=np.array([9.0])),
            GUESS,
        )
    hertz = vj.io.MeasuredCurve(
        data.frequency * 1e4, "frequency", amplitude=data.amplitude, direction=data.direction
    )
    with pytest.raises(ValueError, match="do not overlap"):
        vj.identify(make, hertz, GUESS)
    with pytest.raises(ValueError, match="at least one number"):
        vj.identify(make, data, {})


def test_a_curve_without_contact_is_refused(make):
    free = vj.continue_response(make(gap=0.4e-3), frequency_ratio=vj.Range(0.3, 0.5))
    assert free.contact_force.max() == 0
    ratio = np.linspace(0.3, 0.5, 20)
    data = vj.io.MeasuredCurve(
        ratio,
        "frequency_ratio",
        amplitude=np.interp(ratio, free.values, free.amplitude_ratio),
        amplitude_deviation=np.array([0.05]),
        direction=np.ones(20, int),
    )
    with pytest.raises(ValueError, match="never touches the stop"):
        vj.identify(make, data, GUESS)


def test_a_report_and_a_dataset(fit, tmp_path):
    report, picture = fit.save(tmp_path / "fit")
    saved = json.loads(report.read_text())
    assert saved["parameters"]["stiffness"]["estimate"] == fit.estimate["stiffness"]
    assert saved["parameters"]["damping"]["identifiability"].startswith("not identifiable")
    assert picture.stat().st_size > 10_000
    data = fit.to_xarray()
    assert data.estimate.sel(parameter="stiffness") == fit.estimate["stiffness"]
    assert data.influence.sizes == {"point": fit.measured[0].size, "parameter": 2}
    data.to_netcdf(tmp_path / "fit.nc", engine="h5netcdf")


# The parts


def test_modes_left_out_are_named(rig):
    """One mode fitted to a motion of five gives 2039 N/m for 5500; no misfit shows it."""
    (said,) = modes_left_out(rig(num_modes=1, stiffness=2039.0), 20.0)
    assert "num_modes=1" in said
    shift = float(re.search(r"by about ([\d.e+]+) N/m", said).group(1))
    assert 2039 + shift == pytest.approx(5500, rel=0.1)
    assert modes_left_out(rig(), 75.0) == []


def test_coordinates_hold_their_bounds():
    stiffness = coordinate_of("stiffness", 3000.0, vj.Range(100.0, 1e5))
    assert stiffness.kind == "log"
    np.testing.assert_allclose(stiffness.number(np.array(stiffness.limits)), [100.0, 1e5])
    damping = coordinate_of("damping", 0.0)
    assert damping.kind == "asinh"
    assert damping.limits[0] == 0.0
    assert coordinate_of("gap", 1e-4, vj.Range(0.0, 1e100)).limits == (-np.inf, np.inf)
    assert coordinate_of("damping_ratio", 0.01).kind == "log"
    assert coordinate_of("offset", -1.0).kind == "linear"
    for c, u in ((stiffness, 8.0), (damping, 0.7)):
        slope = (c.number(u + 1e-6) - c.number(u - 1e-6)) / 2e-6
        assert float(c.slope(u)) == pytest.approx(float(slope), rel=1e-8)


def test_an_estimate_at_its_bound_is_within_it():
    """So that it may be the guess of a further fit, whatever round-off does."""
    assert np.exp(np.log(220.0)) > 220.0
    kinds = {"asinh": -220.0, "linear": -220.0, "log": 1e-3}
    coordinates = [coordinate_of(k, 3.0, vj.Range(low, 220.0), k) for k, low in kinds.items()]
    for end in (0, 1):
        found = estimate_at(coordinates, np.array([c.limits[end] for c in coordinates]))
        for c in coordinates:
            assert found[c.name] == pytest.approx((c.low, c.high)[end], rel=1e-14)
            assert c.low <= found[c.name] <= c.high


def test_least_squares_stays_within_bounds():
    """Rosenbrock's valley from two starts, its minimum (1, 1) cut off for one run."""

    def valley(points, lanes):
        x, y = points.T
        one, zero = np.ones_like(x), np.zeros_like(x)
        residual = np.stack([10 * (y - x**2), 1 - x], axis=1)
        rows = [np.stack([-20 * x, 10 * one], 1), np.stack([-one, zero], 1)]
        return residual, np.stack(rows, axis=1)

    start = np.array([[-1.2, 1.0], [3.0, 3.0]])
    everywhere = np.full(2, np.inf)
    found = LevenbergMarquardt()(valley, start, -everywhere, everywhere, 1e-10)
    np.testing.assert_allclose(found.point, 1.0, atol=1e-4)
    assert found.converged.all()
    found = LevenbergMarquardt()(valley, start, -everywhere, np.array([0.5, 9.0]), 1e-8)
    np.testing.assert_allclose(found.point, [[0.5, 0.25]] * 2, atol=1e-3)
    # Cut short just after a step that went too far: the point is the one of the least cost.
    found = LevenbergMarquardt(3)(valley, start, -everywhere, everywhere, 1e-10)
    residual, _ = valley(found.point, None)
    np.testing.assert_allclose(np.sum(residual**2, axis=1), found.cost, rtol=1e-12)


def test_uncertainty_of_a_straight_line():
    """Against the closed form; what the data do not depend on is said not to be known."""
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 1, 40)
    jacobian = -np.stack([np.ones_like(x), x, np.zeros_like(x)], axis=1)
    residual = rng.standard_normal(40)
    point = np.linalg.lstsq(jacobian[:, :2], -residual, rcond=None)[0]
    residual = residual + jacobian[:, :2] @ point
    coordinates = tuple(coordinate_of(n, 1.0, kind="linear") for n in ("level", "slope", "nothing"))
    known = uncertainty(residual, jacobian, np.zeros(3), coordinates, 37, 0.95)
    excess = max(1.0, residual @ residual / 37)
    np.testing.assert_allclose(
        known.deviation[:2], np.sqrt(excess * np.array([1 / 40, 1 / np.sum(x**2)])), rtol=1e-9
    )
    assert known.identifiable == (True, True, False)
    assert "do not depend" in known.identifiability[2]
    moved = influence(residual, jacobian[:, :2], 1)
    left = np.delete(np.arange(40), 7)
    again = np.linalg.lstsq(jacobian[left, :2], -residual[left], rcond=None)[0]
    deviation = np.sqrt([1 / 40, 1 / np.sum(x**2)])
    np.testing.assert_allclose(np.abs(moved[7]), np.abs(again) / deviation, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.long
def test_a_history_under_a_measured_drive():
    noise = np.random.default_rng(3)
    near = butter(2, [5.0, 15.0], "bandpass", fs=1000.0, output="sos")  # the first natural one
    shaken = 20 * sosfilt(near, noise.standard_normal(601))
    drive = vj.Sampled(1e-3 * np.arange(601), shaken)
    history = vj.simulate(vj.default_rig(), waveform=drive, gradient="forward")
    assert len(history.contacts().touch) > 3
    tip = np.asarray(history.displacement())[1:] + 2e-5 * noise.standard_normal(600)
    measured = vj.io.MeasuredHistory(
        time=np.asarray(drive.time)[1:],
        displacement=tip,
        deviation={"displacement": 2e-5},
        waveform=drive,
    )
    found = vj.identify(vj.default_rig, measured, {"stiffness": 4500.0, "gap": 4.5e-4})
    for name, true in (("stiffness", 5500.0), ("gap", 4e-4)):
        low, high = found.interval[name]
        assert low < true < high
        assert high - low < 0.1 * true
    assert found.reduced_chi_square == pytest.approx(1.0, abs=0.2)
