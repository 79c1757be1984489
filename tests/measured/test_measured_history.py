import numpy as np
import pytest
import xarray

from vibrojax.measured.history import MeasuredHistory
from vibrojax.measured.history_reading import read_measured_history

TIME = np.linspace(0.0, 1.0, 401)
SINE = 1e-3 * np.sin(2 * np.pi * 10 * TIME)


def test_fields_and_words():
    history = MeasuredHistory(
        TIME, SINE, deviation={"displacement": 1e-5}, frequency=10.0, notes=("As measured.",)
    )
    assert (history.size, list(history.channels), history.settled) == (401, ["displacement"], True)
    for words in ("401 samples", "0 to 1 s", "deviation 1e-05", "frequency 10 Hz", "As measured."):
        assert words in repr(history)


def test_a_released_beam_is_never_settled():
    history = MeasuredHistory(TIME, SINE, release=-1e-3)
    assert not history.settled
    assert "release -0.001 m, transient" in repr(history)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (dict(displacement=None), "at least one of displacement"),
        (dict(displacement=SINE[1:]), "displacement has 400 samples, time has 401"),
        (dict(displacement=np.where(TIME == 0.5, np.inf, SINE)), "finite, got inf at index 200"),
        (dict(time=np.where(TIME == 0.5, 0.0, TIME)), "time must rise.*index 200"),
        (dict(frequency=None), "frequency_ratio, its waveform as measured, the release"),
        (dict(frequency_ratio=1.0), "not both"),
        (dict(frequency=-1.0), "frequency must be above 0 Hz"),
        (dict(frequency=None, release=np.inf), "release must be a finite"),
        (dict(position=1.5), "position must be"),
        (dict(frame="moving"), "frame must be one of"),
        (dict(deviation={"velocity": 1.0}), "no channel 'velocity'"),
        (dict(deviation={"displacement": 0.0}), "deviation of displacement must be above 0"),
        (dict(window=(0.5, 0.4)), "window must be .* with 0; time runs from 0 to 1 s"),
        (dict(parameters={"gap": np.inf}), r"parameters\['gap'\] must be a finite number"),
    ],
)
def test_what_is_no_history_is_refused(changed, message):
    fields = dict(time=TIME, displacement=SINE, frequency=10.0)
    with pytest.raises(ValueError, match=message):
        MeasuredHistory(**(fields | changed))


def test_windowed_keeps_what_counts():
    force = np.arange(401.0)
    history = MeasuredHistory(TIME, SINE, contact_force=force, frequency=10.0, window=(0.25, 0.5))
    part = history.windowed()
    np.testing.assert_array_equal(part.time, TIME[100:201])
    np.testing.assert_array_equal(part.contact_force, force[100:201])
    assert part.velocity is None
    assert (part.frequency, part.size) == (10.0, 101)


def test_noise_is_estimated_from_the_scatter_of_the_window():
    rng = np.random.default_rng(0)
    found = []
    for _ in range(20):
        noise = np.where(TIME < 0.5, 2e-5, 2e-3) * rng.standard_normal(401)
        history = MeasuredHistory(TIME, SINE + noise, frequency=10.0, window=(0.0, 0.499))
        found.append(history.noise().deviation["displacement"])
    assert np.mean(found) == pytest.approx(2e-5, rel=0.15)
    assert "displacement" in history.noise().sentence


def test_noise_given_and_floors():
    given = MeasuredHistory(TIME, SINE, deviation={"displacement": 3e-5}, frequency=10.0).noise()
    assert given == ({"displacement": 3e-5}, None)
    clean = MeasuredHistory(TIME, SINE, velocity=1 + 0 * TIME, frequency=10.0).noise().deviation
    assert clean["velocity"] == pytest.approx(0.002)
    few = MeasuredHistory(TIME[:5], 1 + SINE[:5], frequency=10.0).noise()
    assert few.deviation["displacement"] == pytest.approx(0.02 * (1 + SINE[:5].max()))
    assert "too few" in few.sentence


def test_reading_a_file(tmp_path):
    path = tmp_path / "tip.csv"
    path.write_text("t [ms],tip [mm],acc_g\n0,1,1\n1,2,-1\n2,oops,0\n3,-4,0\n")
    history = read_measured_history(path, frequency=10.0, parameters=dict(gap=1e-3), settled=False)
    np.testing.assert_allclose(history.time, [0, 1e-3, 3e-3])
    np.testing.assert_allclose(history.displacement, [1e-3, 2e-3, -4e-3])
    np.testing.assert_allclose(history.acceleration, [9.80665, -9.80665, 0])
    assert any("line 4 (displacement is no number: 'oops')" in n for n in history.notes)
    assert any("frame='absolute'" in n for n in history.notes)
    assert (history.settled, history.label, history.parameters) == (False, "tip", {"gap": 1e-3})
    with pytest.raises(ValueError, match="1 unusable row: line 4"):
        read_measured_history(path, frequency=10.0, skip_unusable=False)


@pytest.mark.parametrize(
    ("names", "settings", "message"),
    [
        (["x", "tip_mm"], {}, r"No column for the time.*'x', 'tip_mm'"),
        (["t_s", "x"], {}, "No column for the displacement or another signal"),
        (["t_s", "tip"], {}, r"no unit of the displacement.*units=dict\(displacement='m'\)"),
        (["t_s", "tip_g"], {}, "Unit of displacement must be one of 'm', 'mm', 'um', got 'g'"),
        (["t_s", "tip_ratio"], {}, "Unit of displacement must be one of"),
        (["t_s", "tip_mm"], dict(units=dict(tip="mm")), "units: unknown key 'tip'"),
        (["t_s", "tip_mm", "y_mm"], {}, "may all be the displacement"),
        (["t_s", "tip_mm"], dict(frequency=None), "Measured history from 'dict': Give the drive"),
    ],
)
def test_what_is_not_clear_is_refused(names, settings, message):
    source = {name: [1.0, 2.0, 3.0] for name in names}
    with pytest.raises(ValueError, match=message):
        read_measured_history(source, **(dict(frequency=10.0) | settings))


def test_datasets_and_time_without_a_unit():
    dataset = xarray.Dataset(
        {
            "tip_displacement": ("time", SINE, {"units": "m"}),
            "tip_velocity": ("time", SINE, {"units": "m/s"}),
            "coordinates": (("time", "mode"), np.zeros((401, 2)), {"units": "m"}),
            "contact_force": (("time", "stop"), np.ones((401, 2)), {"units": "N"}),
        },
        {"time": ("time", TIME, {"units": "s"})},
    )
    history = read_measured_history(dataset, frequency=10.0)
    np.testing.assert_array_equal(history.velocity, SINE)
    np.testing.assert_array_equal(history.contact_force, 2.0)
    assert history.size == 401
    plain = read_measured_history({"t": TIME, "tip_m": SINE}, frequency_ratio=1.1)
    assert any("Time was taken to be in s" in n for n in plain.notes)
    np.testing.assert_array_equal(plain.time, TIME)
