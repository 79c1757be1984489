"""The explorer: a live curve beside the exact branch, sliders, and the still picture."""

import asyncio
import types

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.branches.continuation import Ending
from vibrojax.explorer import explorer as explorer_module
from vibrojax.explorer.live_curve import LiveCurve
from vibrojax.explorer.swept_curve import swept_curve

RANGE = vj.Range(0.85, 1.31)
GAP = vj.Range(1e-4, 1e-3)
traced = []


def rig(gap=0.4e-3, stiffness=5500.0, taper=0.5):
    traced.append(type(gap).__name__ != "float")
    return vj.default_rig(gap=gap, stiffness=stiffness, taper=taper)


@pytest.fixture(scope="module")
def explorer():
    return vj.explore(
        rig,
        gap=vj.Range(0.2e-3, 0.8e-3),
        stiffness=vj.Range(500, 50000, 5500.0),
        frequency_ratio=RANGE,
    )


def s_curve():
    """A branch that bends to the right: folds at 1.2 (index 20) and 1.1 (index 30)."""
    up, back, on = np.linspace(0.8, 1.2, 21), np.linspace(1.2, 1.1, 11), np.linspace(1.1, 1.4, 16)
    frequency = np.concatenate([up, back[1:], on[1:]])
    multiplier = np.full(len(frequency), 0.5)
    multiplier[21:30] = 2.0
    direction = np.ones(len(frequency))
    direction[21:31] = -1.0
    response = np.concatenate([np.linspace(1, 10, 21), np.linspace(10, 4, 11)[1:], np.full(15, 2)])
    nothing = np.zeros(len(frequency))
    return LiveCurve(
        frequency, response, nothing, multiplier, direction, Ending.completed, nothing, None, None
    )


def test_sweeps_jump_at_the_folds_of_their_direction():
    curve = s_curve()
    (up,), (down,) = swept_curve(curve, 1).jumps, swept_curve(curve, -1).jumps
    np.testing.assert_allclose(up, [[1.2, 10.0], [1.2, 2.0]])
    np.testing.assert_allclose(down[:, 0], [1.1, 1.1])
    assert down[1, 1] > down[0, 1]
    places = swept_curve(curve, 1).places(np.array([0.9, 1.15, 1.3]))
    np.testing.assert_allclose(places[:, 1], [3.25, 8.875, 2.0])
    assert swept_curve(curve, -1).places(np.array([1.15]))[0, 1] == 2.0
    assert [round(fold, 3) for _, fold in curve.folds] == [1.2, 1.1]


def test_a_sweep_passes_over_a_window_without_a_stable_motion():
    curve = s_curve()
    curve.leading_multiplier[8:11] = 1.5  # 0.96 to 1.00
    sweep = swept_curve(curve, 1)
    assert len(sweep.jumps) == 1
    assert len(sweep.places(np.array([0.98]))) == 0
    assert len(sweep.places(np.array([0.9, 1.1]))) == 2


def test_the_live_curve_is_the_branch(explorer):
    curve, branch = explorer.curve(), explorer.branch()
    assert curve.ending is Ending.completed
    found = sorted(value for _, value in curve.folds)
    np.testing.assert_allclose(found, sorted(float(f) for f in branch.folds), atol=1e-4)
    # On the rising part, which both have as a function of the frequency.
    at = np.linspace(0.86, 1.2, 30)
    exact = np.interp(at, *up_to_the_fold(branch.values, branch.amplitude_ratio))
    live = np.interp(at, *up_to_the_fold(curve.frequency, curve.response))
    np.testing.assert_allclose(live, exact, rtol=1e-2)
    exact = np.interp(at, *up_to_the_fold(branch.values, branch.contact_force))
    live = np.interp(at, *up_to_the_fold(curve.frequency, curve.contact_force))
    np.testing.assert_allclose(live, exact, atol=0.02 * exact.max())
    assert curve.stable[0]
    assert not curve.stable.all()
    # Between the folds the branch goes back, and is unstable.
    assert np.mean(curve.stable == (curve.direction > 0)) > 0.97


def up_to_the_fold(x, y):
    last = int(np.argmax(x[: np.argmax(np.diff(x) < 0)])) + 1
    return np.asarray(x[:last]), np.asarray(y[:last])


def test_other_numbers_compile_nothing(explorer):
    explorer.curve(gap=0.3e-3)
    traced.clear()
    for gap in (0.35e-3, 0.45e-3):
        curve = explorer.curve(gap=gap, stiffness=4000.0)
        assert len(curve.frequency) > 20
    assert not any(traced)  # only ever called with plain numbers


def test_the_orbit_is_the_one_of_its_point(explorer):
    orbit, curve = explorer.orbit(1.1), explorer.curve()
    at = explorer_module.nearest_point(curve, 1.1)
    assert abs(curve.frequency[at] - 1.1) < 0.02
    assert curve.stable[at]
    assert curve.response[at] > 10  # the upper one of two
    assert orbit.contact_force.max() == pytest.approx(curve.contact_force[at], rel=1e-2)
    assert np.ptp(orbit.displacement) / 2 / 0.2e-3 == pytest.approx(curve.response[at], rel=1e-3)
    # The velocity is the derivative of the displacement.
    time = orbit.phase / (curve.frequency[at] * explorer.branch().natural_frequency)
    slope = np.gradient(orbit.displacement, time)
    np.testing.assert_allclose(slope[2:-2], orbit.velocity[2:-2], atol=0.01 * np.ptp(slope))
    assert orbit.displacement[0] == orbit.displacement[-1]


@pytest.mark.slow
def test_a_curve_that_winds_is_looked_at_quickly(explorer):
    look = explorer.quick_curve(False, stiffness=50000.0)
    assert look.harmonics is not None
    assert look.ending is Ending.completed
    assert len(look.frequency) <= 251
    assert explorer.quick_curve(False).harmonics is None


def moved_panel(explorer):
    explorer.widget  # noqa: B018
    return explorer._panel


def test_a_slider_moves_the_picture(explorer):
    panel = moved_panel(explorer)
    image, words = panel._image.value, panel._words.value
    assert bytes(image).startswith(b"\x89PNG")
    panel._sliders["gap"].value = 0.5e-3
    assert explorer.values["gap"] == pytest.approx(0.5e-3)
    assert panel._image.value != image
    assert panel._words.value != words
    assert explorer.system().stops[0].gap == pytest.approx(0.5e-3)
    panel._sliders["gap"].value = 0.4e-3


def test_the_orbit_follows_the_mouse_and_the_slider(explorer):
    panel = moved_panel(explorer)
    left = {
        "boundingRectWidth": 1100,
        "boundingRectHeight": 520,
        "relativeX": 120,
        "relativeY": 430,
    }
    panel._hovered(left)
    assert panel._curve.frequency[panel._at] < 0.95
    before = panel._image.value
    panel._along.value = 1.0
    assert panel._at == len(panel._curve.frequency) - 1
    assert panel._image.value != before
    outside = left | {"relativeX": 1000}
    panel._hovered(outside)
    assert panel._at == len(panel._curve.frequency) - 1


def test_without_a_kernel_there_is_a_still_picture_with_a_note(explorer, tmp_path):
    bundle = explorer._repr_mimebundle_()
    assert set(bundle) == {"text/plain", "image/png"}
    assert "still picture" in bundle["text/plain"]
    explorer.save(str(tmp_path / "still.png"), gap=0.3e-3)
    assert (tmp_path / "still.png").stat().st_size > 20_000


def test_in_a_kernel_there_are_widgets(explorer, monkeypatch):
    monkeypatch.setattr(explorer_module, "kernel_is_live", lambda: True)
    bundle = explorer._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in bundle
    assert "image/png" in bundle


def test_measured_points_are_laid_over():
    measured = vj.io.MeasuredCurve(
        frequency=np.linspace(0.9, 1.25, 8),
        frequency_name="frequency_ratio",
        amplitude=np.linspace(5.0, 30.0, 8),
        direction=np.r_[np.ones(4, int), -np.ones(4, int)],
    )
    explorer = vj.explore(rig, gap=vj.Range(0.2e-3, 0.8e-3), measured=measured)
    picture = explorer.picture()
    drawn = [line for line in picture.response.lines if line.get_label().startswith("measured")]
    assert sum(len(line.get_xdata()) for line in drawn) == 8
    low, high = picture.response.get_xlim()
    assert low < 0.9
    assert high > 1.25


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (dict(gap=(1e-4, 1e-3)), "gap must be a range"),
        (dict(gap=[1e-4, 1e-3], stiffness=vj.Range(1e3, 1e4)), "gap must be a range"),
        (dict(gap=0.4e-3), "at least one number a range"),
        (dict(gab=GAP), "Did you mean 'gap'"),
        (dict(taper=vj.Range(-0.1, 0.5)), "taper must be"),
        (dict(gap=GAP, frequency_ratio=vj.Range(0.0, 0.9)), "frequency_ratio must be"),
        (dict(gap=GAP, frequency_ratio=(0.9, 1.2)), "frequency_ratio must be a Range"),
        (dict(gap=GAP, variable="amplitude"), "variable must be one of"),
        (dict(gap=GAP, frequency=vj.Range(5.0, 20.0), frequency_ratio=RANGE), "one of the two"),
    ],
)
def test_wrong_calls_are_refused(call, words):
    with pytest.raises(ValueError, match=words):
        vj.explore(rig, **call)


def test_a_rig_in_place_of_a_function_is_refused(explorer):
    with pytest.raises(ValueError, match="must be a function"):
        vj.explore(rig(), gap=GAP)
    with pytest.raises(ValueError, match="Did you mean 'gap'"):
        explorer.curve(gab=1e-3)


@pytest.mark.slow
def test_any_law_and_any_quantity():
    def soft(gap=0.4e-3, hardness=1e8):
        stop = vj.Stop(0.5, gap, vj.Hertz(hardness))
        return vj.ImpactingBeam(
            vj.default_rig().beam, stop, vj.BaseMotion(0.2e-3), damping_ratio=0.018, num_modes=1
        )

    ranges = dict(gap=vj.Range(0.2e-3, 0.8e-3), hardness=vj.Range(1e7, 1e9))
    explorer = vj.explore(soft, **ranges, variable="contact_force")
    curve = explorer.curve()
    assert len(curve.frequency) > 20
    np.testing.assert_array_equal(curve.response, curve.contact_force)
    assert curve.contact_force.max() > 0.1
    assert curve.stable[0]
    assert "contact force" in explorer.picture().response.get_ylabel()


def test_completion_shows_what_is_for_users(explorer):
    assert not [name for name in dir(explorer) if name.startswith("_")]
    assert isinstance(explorer.orbit, types.MethodType)
    assert repr(explorer).startswith("Explorer(gap 0.0002 to 0.0008 m, stiffness 500 to 50000 N/m)")


def test_a_slider_that_goes_on_shows_what_was_computed_ahead(explorer, monkeypatch):
    panel, slow = moved_panel(explorer), explorer.quick_curve
    slider, asked = panel._sliders["gap"], []

    def counted(winds, **numbers):
        asked.append(numbers["gap"])
        return slow(winds, **numbers)

    monkeypatch.setattr(explorer, "quick_curve", counted)

    async def every():
        shown = []
        first, step = 0.3e-3, slider.step
        for gap in (first, first + step, first + 2 * step, first + step, first + 3 * step):
            slider.value = gap
            await asyncio.sleep(0.1)
            shown.append((gap, len(asked), panel._curve))
        return shown

    shown = asyncio.run(every())
    # One ahead of the third, which is then there; another way round, and by two steps, it is not.
    assert [count for _, count, _ in shown] == [1, 3, 4, 6, 7]
    for gap, _, curve in shown:
        np.testing.assert_allclose(curve.response, slow(False, gap=gap).response, rtol=1e-6)
