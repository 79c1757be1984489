import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray

from vibrojax.measured.curve import MeasuredCurve, MeasuredCurves
from vibrojax.measured.directions import guess_directions
from vibrojax.measured.reading import read_measured_curve
from vibrojax.measured.units import find_unit, split_header

CASES = json.loads((Path(__file__).parents[1] / "data" / "sweeps.json").read_text())["cases"]


def noisy(case, seed, level=0.02):
    both = (case["forward"], case["backward"])
    amplitude = np.concatenate([part["half_pp_ratio"] for part in both])
    rng = np.random.default_rng(seed)
    return MeasuredCurve(
        np.concatenate([part["ratio"] for part in both]),
        "frequency_ratio",
        amplitude * (1 + level * rng.standard_normal(len(amplitude))),
        direction=np.repeat([1, -1], [len(part["ratio"]) for part in both]),
    )


def resonance(points=50, damping=0.02):
    frequency = np.linspace(0.8, 1.3, points)
    return frequency, 1 / np.hypot(1 - frequency**2, 2 * damping * frequency)


def write(folder, text, name="sweep.csv", encoding="utf-8"):
    path = folder / name
    path.write_text(text, encoding=encoding)
    return path


def note(curve, words):
    return any(words in sentence for sentence in curve.notes)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("seed", range(10))
def test_jumps_of_the_reference_sweeps_are_found(name, seed):
    case = CASES[name]
    curve = noisy(case, seed)
    down, up = curve.jumps()
    assert (down.direction, up.direction) == (1, -1)
    assert down.before - 2e-3 <= case["jump_down"] <= down.after + 2e-3
    assert up.after - 2e-3 <= case["jump_up"] <= up.before + 2e-3
    assert down.change < 0.5
    assert up.change > 1.25
    assert curve.amplitude[down.at] / curve.amplitude[down.at - 1] == pytest.approx(down.change)
    assert curve.frequency[up.at] == up.after


def test_a_smooth_resonance_has_no_jump():
    frequency, amplitude = resonance()
    for seed in range(10):
        noise = 1 + 0.02 * np.random.default_rng(seed).standard_normal(50)
        curve = MeasuredCurve(frequency, "frequency", amplitude * noise, direction=np.ones(50, int))
        assert curve.jumps() == []


def test_deviations_and_unknown_directions_silence_jumps():
    case = CASES["C_MR0.5_mu0.5"]
    curve = noisy(case, 0)
    fields = dict(frequency=curve.frequency, frequency_name="frequency", amplitude=curve.amplitude)
    sure = MeasuredCurve(**fields, direction=curve.direction, amplitude_deviation=np.array([0.05]))
    unsure = MeasuredCurve(**fields, direction=curve.direction, amplitude_deviation=np.array([3.0]))
    assert len(sure.jumps()) == 2
    assert unsure.jumps() == []
    assert MeasuredCurve(**fields).jumps() == []


def test_the_points_of_a_jump_need_not_be_in_order():
    curve = noisy(CASES["C_MR0.5_mu0"], 1)
    shuffle = np.random.default_rng(0).permutation(curve.size)
    mixed = MeasuredCurve(
        curve.frequency[shuffle],
        "frequency_ratio",
        curve.amplitude[shuffle],
        direction=curve.direction[shuffle],
    )
    for one, other in zip(curve.jumps(), mixed.jumps(), strict=True):
        assert one[:4] == other[:4]
        assert shuffle[other.at] == one.at


def test_noise_is_estimated_from_the_scatter():
    frequency, amplitude = resonance()
    frequency = np.concatenate([frequency, frequency[::-1]])
    amplitude = np.concatenate([amplitude, amplitude[::-1]])
    levels = []
    for seed in range(40):
        noise = 1 + 0.02 * np.random.default_rng(seed).standard_normal(100)
        curve = MeasuredCurve(
            frequency, "frequency", amplitude * noise, direction=np.repeat([1, -1], 50)
        )
        at = int(np.argmax(curve.amplitude))
        found = curve.noise()
        levels.append(found.amplitude[at] / curve.amplitude[at])
        percent = float(re.search(r"of (\S+) %", found.sentence)[1])
        assert percent / 100 == pytest.approx(levels[-1], rel=0.1)
    assert np.mean(levels) == pytest.approx(0.02, rel=0.15)
    assert np.mean(np.abs(np.array(levels) / 0.02 - 1) < 0.25) > 0.85


@pytest.mark.parametrize("name", CASES)
def test_noise_is_not_taken_in_by_jumps(name):
    levels = []
    for seed in range(20):
        curve = noisy(CASES[name], seed)
        at = int(np.argmax(curve.amplitude))
        levels.append(curve.noise().amplitude[at] / curve.amplitude[at])
    assert np.mean(levels) == pytest.approx(0.02, rel=0.15)


def test_noise_given_is_kept_and_floors_hold():
    frequency, amplitude = resonance()
    given = np.full(50, 0.1)
    curve = MeasuredCurve(frequency, "frequency", amplitude, given, contact_force=np.zeros(50))
    noise = curve.noise()
    np.testing.assert_array_equal(noise.amplitude, given)
    assert (noise.contact_force > 0).all()
    assert "Contact force" in noise.sentence
    assert "Amplitude" not in noise.sentence
    assert MeasuredCurve(frequency, "frequency", amplitude, given).noise().sentence is None

    clean = MeasuredCurve(np.arange(1.0, 21), "frequency", np.full(20, 2.0)).noise()
    np.testing.assert_allclose(clean.amplitude, 2.0 * np.hypot(0.002, 0.005))
    few = MeasuredCurve(frequency[:7], "frequency", amplitude[:7]).noise()
    floor = 0.005 * np.median(amplitude[:7])
    np.testing.assert_allclose(few.amplitude, np.hypot(0.02 * amplitude[:7], floor))
    assert "too few" in few.sentence


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (dict(amplitude=np.array([1.0, -2.0])), r"amplitude .*at least 0.*-2 \(line 7\)"),
        (dict(amplitude=np.array([1.0, np.nan])), "amplitude must be finite"),
        (dict(amplitude=np.array([1.0])), "amplitude has 1 points, frequency has 2"),
        (dict(amplitude=np.zeros(2)), "0 at every point"),
        (dict(amplitude=None), "Give amplitude or contact_force"),
        (dict(amplitude_deviation=np.array([1.0, 0.0])), "amplitude_deviation .*above 0"),
        (dict(contact_force_deviation=np.ones(2)), "without contact_force"),
        (dict(contact_force=np.array([0.0, -1.0])), "contact_force"),
        (dict(frequency=np.array([0.0, 1.0])), r"frequency .*above 0.*line 5"),
        (dict(frequency=np.array([])), "at least one point"),
        (dict(frequency_name="omega"), "frequency_name must be one of"),
        (dict(quantity="mean"), "quantity must be one of"),
        (dict(signal="strain"), "signal must be one of"),
        (dict(frame="moving"), "frame must be one of"),
        (dict(signal="acceleration"), "is_ratio must be False .* m/s2"),
        (dict(signal="power", quantity="rms"), "one of 'mean', 'peak' for a power, got 'rms'"),
        (dict(signal="voltage", frame="absolute"), "frame is of motions, got 'absolute'"),
        (dict(direction=np.array([1, 2])), "direction must be 1, -1 or 0"),
        (dict(direction=np.array([1, 1, 1])), "direction has 3 entries"),
        (dict(parameters={"gap": np.nan}), r"parameters\['gap'\] must be a finite number"),
    ],
)
def test_what_is_no_curve_is_refused(changed, message):
    fields = dict(
        frequency=np.array([0.9, 1.0]),
        frequency_name="frequency_ratio",
        amplitude=np.array([1.0, 2.0]),
        lines=np.array([5, 7]),
    )
    assert MeasuredCurve(**fields).size == 2
    with pytest.raises(ValueError, match=message):
        MeasuredCurve(**(fields | changed))


def test_a_curve_says_what_it_is():
    text = repr(
        MeasuredCurve(
            np.array([10.0, 12.0]),
            "frequency",
            np.array([1.0, 2.0]),
            direction=np.array([1, -1]),
            quantity="rms",
            signal="acceleration",
            is_ratio=False,
            frame="absolute",
            notes=("Row 3 left out.",),
        )
    )
    for words in ("1 forward, 1 backward", "10 to 12 Hz", "rms", "m/s2", "absolute", "not given"):
        assert words in text
    assert "Row 3 left out." in text


@pytest.mark.parametrize(
    ("header", "words", "unit"),
    [
        ("frequency [Hz]", "frequency", "Hz"),
        ("f_Hz", "f", "Hz"),
        ("f / Hz", "f", "Hz"),
        ("tip/mm", "tip", "mm"),
        ("Tip Acceleration (m/s²)", "tipacceleration", "m/s2"),
        ("acceleration_m/s2", "acceleration", "m/s2"),
        ("acc/m/s2", "acc", "m/s2"),
        ("first_harmonic_ratio", "firstharmonic", "ratio"),
        ("contact_force", "contactforce", None),
        ("tip [µm]", "tip", "um"),
        ("amplitude_1", "amplitude1", None),
    ],
)
def test_headers_are_taken_apart(header, words, unit):
    found = split_header(header)
    assert found.words == words
    assert (find_unit(found.unit) if found.unit else None) == unit


def test_mega_is_not_milli():
    assert find_unit("mN") == "mN"
    assert find_unit("MN") is None


def test_a_file_with_all_columns(tmp_path):
    path = write(
        tmp_path,
        "# a rig\nfrequency [rad/s],Tip [mm],sd [%],dir,Contact force [mN],contact_force_sd [N]\n"
        "62.83185307179586,2.0,5,up,100,0.01\n# pause\n125.66370614359172,3.0,5,DOWN,200,0.01\n",
    )
    curve = read_measured_curve(path, quantity="peak", parameters=dict(gap=0.4e-3))
    assert curve.frequency_name == "frequency"
    np.testing.assert_allclose(curve.frequency, [10.0, 20.0])
    np.testing.assert_allclose(curve.amplitude, [2e-3, 3e-3])
    np.testing.assert_allclose(curve.amplitude_deviation, [1e-4, 1.5e-4])
    np.testing.assert_allclose(curve.contact_force, [0.1, 0.2])
    np.testing.assert_allclose(curve.contact_force_deviation, 0.01)
    np.testing.assert_array_equal(curve.direction, [1, -1])
    np.testing.assert_array_equal(curve.lines, [3, 5])
    assert (curve.quantity, curve.signal, curve.is_ratio) == ("peak", "displacement", False)
    assert (curve.parameters, curve.label) == ({"gap": 0.4e-3}, "sweep")
    assert curve.notes == (
        "Columns were taken so: 'frequency [rad/s]' as frequency in rad/s, 'Tip [mm]' as amplitude "
        "in mm, 'sd [%]' as deviation in %, 'Contact force [mN]' as contact force in mN, "
        "'contact_force_sd [N]' as contact force deviation in N, 'dir' as direction.",
    )


@pytest.mark.parametrize(
    ("header", "quantity", "signal", "value"),
    [
        ("peak_ratio", "peak", "displacement", 1.0),
        ("rms acceleration [g]", "rms", "acceleration", 9.80665),
        ("peak-to-peak (um)", "peak_to_peak", "displacement", 1e-6),
        ("velocity amplitude [mm/s]", "amplitude", "velocity", 1e-3),
        ("half peak to peak [m]", "amplitude", "displacement", 1.0),
        ("first_harmonic_ratio", "first_harmonic", "displacement", 1.0),
        ("rms_voltage [mV]", "rms", "voltage", 1e-3),
        ("load voltage amplitude (V)", "amplitude", "voltage", 1.0),
        ("mean_power [W]", "mean", "power", 1.0),
        ("power_uW", "mean", "power", 1e-6),
        ("peak power [mW]", "peak", "power", 1e-3),
    ],
)
def test_the_name_of_a_column_says_quantity_and_signal(header, quantity, signal, value):
    curve = read_measured_curve({"frequency_ratio": [0.9, 1.0], header: [1.0, 1.0]})
    assert (curve.quantity, curve.signal) == (quantity, signal)
    np.testing.assert_allclose(curve.amplitude, value)
    assert note(curve, "absolute") == (signal == "acceleration")


@pytest.mark.parametrize(
    "text",
    [
        "f [Hz];amplitude [mm]\n10,5;1,25\n11;2\n",
        "f [Hz]\tamplitude [mm]\n10.5\t1.25\n11\t2\n",
        "f [Hz]   amplitude [mm]\n10.5  1.25\n  11  2\n",
        "# f_Hz amplitude_mm\n10.5 1.25\n11 2\n",
        '\ufeff"f [Hz]", "amplitude [mm]"\n10.5, 1.25\n\n11, 2\n',
    ],
)
def test_delimiters(tmp_path, text):
    curve = read_measured_curve(write(tmp_path, text))
    np.testing.assert_allclose(curve.frequency, [10.5, 11.0])
    np.testing.assert_allclose(curve.amplitude, [1.25e-3, 2e-3])


def test_columns_by_position_and_name(tmp_path):
    path = write(tmp_path, "1,10,0.5\n2,11,0.6\n")
    units = dict(frequency="rpm", amplitude="m/s")
    with pytest.raises(ValueError, match=r"no header.*columns=dict\(frequency=0"):
        read_measured_curve(path, units=units)
    curve = read_measured_curve(path, columns=dict(frequency=1, amplitude=2), units=units)
    np.testing.assert_allclose(curve.frequency, [1 / 6, 11 / 60])
    assert curve.signal == "velocity"
    source = {"a": [1.0, 2.0], "b": [3.0, 4.0], "force": [1.0, 1.0]}
    columns = dict(frequency="a", amplitude="b", contact_force=None)
    curve = read_measured_curve(source, columns=columns, units=dict(frequency="kHz", amplitude="m"))
    np.testing.assert_allclose(curve.frequency, [1e3, 2e3])
    assert curve.contact_force is None


@pytest.mark.parametrize(
    ("names", "settings", "message"),
    [
        (["x", "amplitude_ratio"], {}, r"frequency.*'x', 'amplitude_ratio'.*dict\(frequency="),
        (["f_Hz", "x"], {}, r"No column for the amplitude.*dict\(amplitude="),
        (["f_Hz", "tip_mm", "rms_mm"], {}, r"'tip_mm', 'rms_mm' may all be .*dict\(amplitude="),
        (["frequency", "tip_mm"], {}, r"no unit of the frequency.*frequency='Hz'"),
        (["f_Hz", "tip"], {}, r"no unit of the amplitude.*amplitude='mm'"),
        (["f_Hz", "tip"], dict(units=dict(amplitude="inch")), "'ratio', 'm', 'mm'.* got 'inch'"),
        (["f_Hz", "tip"], dict(units=dict(amplitude="Hz")), "Unit of amplitude must be one of"),
        (["f_Hz", "tip_mm"], dict(units=dict(tip="mm")), "units: unknown key 'tip'"),
        (
            ["f_Hz", "tip_mm"],
            dict(columns=dict(amp="tip_mm")),
            "unknown key 'amp'.*amplitude, deviation",
        ),
        (["f_Hz", "tip_mm"], dict(columns=dict(amplitude="tap")), "no column 'tap'.*tip_mm"),
        (["f_Hz", "voltage [V]", "power [W]"], {}, "'voltage .V.', 'power .W.' may all be"),
        (["f_Hz", "power [V]"], {}, "that of a voltage, but column .* power"),
        (["f_Hz", "tip_w"], {}, "No column for the amplitude"),
        (["f_Hz", "displacement [g]"], {}, "acceleration, but column .* displacement"),
        (["f_Hz", "tip_mm"], dict(signal="velocity"), "displacement, but signal says velocity"),
        (["f_Hz", "tip_mm"], dict(quantity="mean"), "quantity must be one of"),
        (["f_Hz", "tip_mm"], dict(direction="sideways"), "direction must be"),
        (["f_Hz", "tip_mm"], dict(split="gap"), "no column 'gap'"),
        (["f_Hz", "contact_force_N", "sd"], {}, "column for deviation, but none for amplitude"),
        (["f_Hz", "tip_mm", "sd", "weight"], {}, "weight and a deviation"),
    ],
)
def test_columns_and_units_that_are_not_clear_are_refused(names, settings, message):
    with pytest.raises(ValueError, match=message):
        read_measured_curve({name: [1.0, 2.0] for name in names}, **settings)


def test_unusable_rows_are_named(tmp_path):
    path = write(
        tmp_path,
        "frequency_ratio,amplitude_ratio\n0.9,1\n0.95,\n1.0,bad\n-1,2\n1.1,-3\n1.15\n1.2,4\n1.3,5\n"
        "1.4,nan\n",
    )
    curve = read_measured_curve(path)
    np.testing.assert_array_equal(curve.lines, [2, 8, 9])
    assert note(curve, "6 unusable rows left out: line 3 (amplitude is no number: '')")
    for words in (
        "line 4 (amplitude is no number: 'bad')",
        "line 5 (frequency is not above 0: -1)",
        "line 6 (amplitude is negative: -3)",
        "line 7 (too few cells)",
        "line 10 (amplitude is nan)",
    ):
        assert note(curve, words)
    with pytest.raises(ValueError, match=r"6 unusable rows: line 3 .*skip_unusable=True"):
        read_measured_curve(path, skip_unusable=False)


def test_files_that_are_no_curves_are_refused(tmp_path):
    head = "frequency_ratio,amplitude_ratio"
    with pytest.raises(ValueError, match="looks like a signal or decibels"):
        read_measured_curve(write(tmp_path, f"{head}\n0.9,-20\n1,-10\n1.1,3\n"))
    with pytest.raises(ValueError, match=r"no usable row: line 2"):
        read_measured_curve(write(tmp_path, f"{head}\n0.9,x\n1,y\n"))
    with pytest.raises(ValueError, match="no usable row"):
        read_measured_curve(write(tmp_path, f"{head}\n"))
    with pytest.raises(ValueError, match="no rows"):
        read_measured_curve(write(tmp_path, "# nothing\n"))
    with pytest.raises(ValueError, match=r"more cells .* line 3"):
        read_measured_curve(write(tmp_path, f"{head}\n0.9,1\n1,1,5\n"))
    with pytest.raises(ValueError, match="does not exist"):
        read_measured_curve(tmp_path / "none.csv")
    with pytest.raises(ValueError, match="cannot be read as NetCDF"):
        read_measured_curve(write(tmp_path, head, "no.nc"))
    with pytest.raises(ValueError, match="equally long"):
        read_measured_curve({"frequency_ratio": [1.0, 2.0], "amplitude_ratio": [1.0]})
    with pytest.raises(ValueError, match="source must be"):
        read_measured_curve(3.0)


@pytest.mark.parametrize(
    ("frequency", "expected"),
    [
        ([1, 2, 3], [1, 1, 1]),
        ([3, 2, 1], [-1, -1, -1]),
        ([1, 2, 3, 2, 1], [1, 1, 1, -1, -1]),
        ([1, 2, 3, 3, 2, 1], [1, 1, 1, -1, -1, -1]),
        ([1, 1, 2, 2, 3, 3], [1] * 6),
        ([1, 2, 3, 1, 2, 3], [1] * 6),
        ([3, 2, 1, 2, 3], [-1, -1, -1, 1, 1]),
        ([1, 3, 2, 5, 4, 6], [0] * 6),
        ([2], [0]),
    ],
)
def test_directions_are_guessed_from_the_order(frequency, expected):
    found, sentence = guess_directions(np.array(frequency, float))
    np.testing.assert_array_equal(found, expected)
    assert ("not known" in sentence) == (expected[0] == 0)


def test_directions_given():
    source = {"frequency_ratio": [0.9, 1.0, 1.1, 1.2], "amplitude_ratio": [1.0, 2.0, 3.0, 4.0]}
    guessed = read_measured_curve(source)
    assert guessed.forward.all()
    assert note(guessed, "Directions were guessed")
    directed = read_measured_curve(source, direction="backward")
    assert directed.backward.all()
    assert not note(directed, "Directions were guessed")
    named = read_measured_curve(source | {"sweep": ["F", "b", "-1", "sideways"]})
    np.testing.assert_array_equal(named.direction, [1, -1, -1])
    assert note(named, "row 4 (direction is not")
    numbered = read_measured_curve(source | {"Direction": np.array([1.0, -1.0, 0.0, 1.0])})
    np.testing.assert_array_equal(numbered.direction, [1, -1, 0, 1])


def test_relative_deviations_at_zero():
    curve = read_measured_curve(
        {"r": [0.9, 1.0], "impact_force_N": [0.0, 10.0], "force_error": [0.1, 0.1]},
        units=dict(contact_force_deviation="relative"),
    )
    np.testing.assert_allclose(curve.contact_force_deviation, [0.01, 1.0])


def test_weights_become_deviations():
    frequency, amplitude = resonance()
    amplitude = amplitude * (1 + 0.02 * np.random.default_rng(0).standard_normal(50))
    weight = np.where(frequency < 1, 1.0, 4.0)
    source = {"frequency_ratio": frequency, "amplitude_ratio": amplitude}
    curve = read_measured_curve(source | {"weight": weight})
    plain = read_measured_curve(source)
    assert plain.amplitude_deviation is None
    np.testing.assert_allclose(
        curve.amplitude_deviation * np.sqrt(weight), curve.amplitude_deviation[0]
    )
    assert np.median(curve.amplitude_deviation) == pytest.approx(np.median(plain.noise().amplitude))
    assert note(curve, "1/sqrt(weight)")


def test_several_curves(tmp_path):
    path = write(
        tmp_path,
        "gap [mm],frequency_ratio,amplitude_ratio\n0.4,0.9,1\n0.4,1,2\n0.8,1,3\n0.8,0.9,4\n",
    )
    curves = read_measured_curve(path, split="gap", parameters=dict(taper=0.5))
    assert isinstance(curves, MeasuredCurves)
    assert [c.parameters for c in curves] == [
        {"taper": 0.5, "gap": 0.4e-3},
        {"taper": 0.5, "gap": 0.8e-3},
    ]
    np.testing.assert_array_equal(curves[1].lines, [4, 5])
    assert curves[0].forward.all()
    assert curves[1].backward.all()
    assert "2 curves, 4 points" in repr(curves)
    both = read_measured_curve([path, path], split=["gap"])
    assert len(both) == 4
    named = read_measured_curve(
        {"rig": ["A", "B"], "r": [0.9, 1.0], "rms_ratio": [1, 2]}, split="rig"
    )
    assert [c.label for c in named] == ["rig = A", "rig = B"]
    assert named[0].parameters == {}
    with pytest.raises(ValueError, match="at least one"):
        MeasuredCurves(())


def own_dataset():
    """What `frequency_sweep` writes, with an axis of the call."""
    dims, shape = ("gap", "direction", "frequency_ratio"), (2, 2, 3)
    values = 1.0 + np.arange(12.0).reshape(shape)
    data = {
        f"{name}_ratio": (dims, values * factor, {"units": "1"})
        for name, factor in dict(amplitude=1, peak=2, rms=3, first_harmonic=4).items()
    }
    data["contact_force"] = (dims, values / 10, {"units": "N"})
    data["status"] = (dims, np.where(values == 5.0, 1, 0))
    data["peak_amplitude_ratio"] = (("gap",), np.zeros(2), {"units": "1"})
    data["natural_frequency"] = (("gap",), np.zeros(2), {"units": "Hz"})
    coordinates = {
        "gap": [0.4e-3, 0.8e-3],
        "direction": ["forward", "backward"],
        "frequency_ratio": ("frequency_ratio", [0.9, 1.0, 1.1], {"units": "1"}),
    }
    return xarray.Dataset(data, coordinates)


def test_datasets_of_our_own(tmp_path):
    dataset = own_dataset()
    with pytest.raises(ValueError, match="split='gap'"):
        read_measured_curve(dataset)
    first, second = read_measured_curve(dataset, split="gap")
    assert first.parameters == {"gap": 0.4e-3}
    np.testing.assert_allclose(first.amplitude, [1, 2, 3, 4, 6])
    np.testing.assert_array_equal(first.direction, [1, 1, 1, -1, -1])
    np.testing.assert_allclose(second.contact_force, np.arange(7, 13) / 10)
    assert note(first, "not settled")
    forceless = read_measured_curve(dataset, split="gap", columns=dict(contact_force=None))
    assert forceless[0].contact_force is None
    path = tmp_path / "sweep.nc"
    dataset.sel(gap=0.8e-3).to_netcdf(path, engine="h5netcdf")
    stored = read_measured_curve(path, quantity="rms")
    assert (stored.quantity, stored.parameters) == ("rms", {"gap": 0.8e-3})
    np.testing.assert_allclose(stored.amplitude, 3 * second.amplitude)


class Frame:
    """As much of a data frame as is used."""

    def __init__(self, columns):
        self._columns = columns
        self.columns = list(columns)

    def __getitem__(self, name):
        return Frame({name: self._columns[name]})

    def to_numpy(self):
        return np.asarray(next(iter(self._columns.values())))


def test_data_frames_and_datasets():
    frame = Frame({"f_Hz": [10, 11], "tip_um": [1.0, 2.0]})
    curve = read_measured_curve(frame)
    np.testing.assert_allclose(curve.amplitude, [1e-6, 2e-6])
    dataset = xarray.Dataset(
        {"tip": ("f", [1.0, 2.0], {"units": "mm"})}, {"f": ("f", [10.0, 11.0], {"units": "Hz"})}
    )
    curve = read_measured_curve(dataset)
    np.testing.assert_allclose(curve.amplitude, [1e-3, 2e-3])
    np.testing.assert_allclose(curve.frequency, [10.0, 11.0])


def test_a_curve_takes_lists_and_refuses_directions_that_are_no_numbers():
    curve = MeasuredCurve([1.0, 1.1], "frequency", amplitude=[1, 2], direction=[1, -1])
    np.testing.assert_array_equal(curve.direction, [1, -1])
    np.testing.assert_array_equal(curve.amplitude, [1.0, 2.0])
    for name in ("direction", "lines"):
        for wrong in (np.array(["a", "b"]), np.array([1.5, np.nan])):
            with pytest.raises(ValueError, match=f"{name} must be whole numbers"):
                MeasuredCurve([1.0, 1.1], "frequency", amplitude=[1, 2], **{name: wrong})
