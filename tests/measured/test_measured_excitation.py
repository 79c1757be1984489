"""The drive beside a measured response, and how well its phase is known."""

import dataclasses

import numpy as np
import pytest

import vibrojax as vj

FREQUENCY = np.linspace(8.0, 12.0, 41)
RESPONSE = 1e-3 / (1 - (FREQUENCY / 10) ** 2 + 0.04j * FREQUENCY / 10)
DRIVE = 1.0 - 0.2 * np.exp(-((FREQUENCY - 10) ** 2))
TABLE = {"frequency [Hz]": FREQUENCY, "amplitude [mm]": 1e3 * np.abs(RESPONSE)}


@pytest.mark.parametrize(
    ("header", "settings", "signal", "factor"),
    [
        ("force [N]", dict(columns=dict(drive="force [N]")), "force", 1.0),
        ("shaker force [mN]", {}, "force", 1e-3),
        ("drive_force_N", {}, "force", 1.0),
        ("excitation amplitude [N]", {}, "force", 1.0),
        ("base displacement [mm]", {}, "displacement", 1e-3),
        ("base velocity (mm/s)", {}, "velocity", 1e-3),
        ("base acceleration [g]", {}, "acceleration", 9.80665),
        ("base acceleration rms [m/s2]", {}, "acceleration", 2**0.5),
        ("base_displacement_pp_um", {}, "displacement", 0.5e-6),
        ("drive", dict(units=dict(drive="N")), "force", 1.0),
        ("what", dict(columns=dict(drive="what"), units=dict(drive="m")), "displacement", 1.0),
    ],
)
def test_a_column_of_the_drive(header, settings, signal, factor):
    curve = vj.io.read_measured_curve(TABLE | {header: DRIVE}, **settings)
    assert curve.drive_signal == signal
    np.testing.assert_allclose(curve.drive_amplitude, factor * DRIVE)
    assert curve.contact_force is None
    (note,) = [n for n in curve.notes if "was taken for the drive at each point" in n]
    assert header in note
    assert signal in note
    assert f"drive, {signal}, " in repr(curve)
    left = {**settings, "columns": dict(drive=None, contact_force=None), "units": {}}
    assert vj.io.read_measured_curve(TABLE | {header: DRIVE}, **left).drive_amplitude is None


def test_a_force_may_be_that_of_the_drive():
    with pytest.raises(ValueError, match=r"dict\(drive='force \[N\]'\) for that of the drive"):
        vj.io.read_measured_curve(TABLE | {"force [N]": DRIVE})
    with pytest.raises(ValueError, match="may all be the drive"):
        vj.io.read_measured_curve(TABLE | {"base disp [mm]": DRIVE, "base acc [g]": DRIVE})
    unclear = vj.io.read_measured_curve(TABLE | {"drive level [V]": DRIVE})
    assert unclear.drive_amplitude is None
    assert any("'drive level [V]' was left out" in note for note in unclear.notes)
    with pytest.raises(ValueError, match="Unit of drive must be one of"):
        vj.io.read_measured_curve(
            TABLE | {"drive level [V]": DRIVE}, columns=dict(drive="drive level [V]")
        )
    zero = np.where(np.arange(41) == 5, 0.0, DRIVE)
    gone = vj.io.read_measured_curve(TABLE | {"drive force [N]": zero})
    assert gone.size == 40
    assert any("(drive is not above 0: 0)" in note for note in gone.notes)


def test_a_response_over_a_complex_drive():
    turned = DRIVE * np.exp(0.3j)
    table = {"f_Hz": FREQUENCY, "tip [m]": RESPONSE * np.exp(0.3j), "drive force [N]": turned}
    curve = vj.io.read_measured_curve(table)
    np.testing.assert_allclose(curve.phase, np.angle(RESPONSE))
    np.testing.assert_allclose(curve.drive_amplitude, DRIVE)
    left = vj.io.read_measured_curve(table, columns=dict(phase=None))
    assert left.phase is None
    np.testing.assert_allclose(left.drive_amplitude, DRIVE)
    with pytest.raises(ValueError, match="drive_amplitude must be real"):
        vj.io.read_measured_curve(TABLE | {"drive force [N]": turned})


def test_a_column_of_how_well_the_phase_is_known():
    table = TABLE | {"phase [deg]": np.degrees(np.angle(RESPONSE)), "phase sd [deg]": 0 * DRIVE + 2}
    curve = vj.io.read_measured_curve(table)
    np.testing.assert_allclose(curve.phase_deviation, np.radians(2))
    assert vj.io.read_measured_curve(table, columns=dict(phase=None)).phase_deviation is None
    del table["phase [deg]"]
    assert vj.io.read_measured_curve(table).phase_deviation is None
    table["amplitude [mm]"] = 1e3 * RESPONSE
    np.testing.assert_allclose(vj.io.read_measured_curve(table).phase_deviation, np.radians(2))


def test_how_well_a_phase_is_known():
    found = []
    for seed in range(8):
        scatter = 0.01 * np.random.default_rng(seed).standard_normal(41)
        phase = np.angle(RESPONSE) + scatter + 2 * np.pi * (np.arange(41) % 2)
        curve = vj.io.MeasuredCurve(
            FREQUENCY, "frequency", np.abs(RESPONSE), is_ratio=False, phase=phase, quantity="rms"
        )
        noise = curve.noise()
        found.append(noise.phase[np.argmax(curve.amplitude)])
        assert noise.phase[0] > found[-1]
    assert np.mean(found) == pytest.approx(0.01, rel=0.25)
    assert "Phase: a standard deviation of 0.0" in noise.sentence
    given = dataclasses.replace(curve, phase_deviation=[0.1], amplitude_deviation=[1e-5])
    np.testing.assert_array_equal(given.noise().phase, 0.1)
    complex_one = vj.io.MeasuredCurve(
        FREQUENCY, "frequency", RESPONSE, amplitude_deviation=[1e-5], is_ratio=False
    )
    np.testing.assert_allclose(complex_one.noise().phase, 1e-5 / np.abs(RESPONSE))
    assert complex_one.noise().sentence is None


def test_points_of_no_sweep_are_neighbours_in_their_order():
    """Up, back and up again, as stepped phase goes over an S: sorted by frequency they scatter."""
    along = np.linspace(-1.6, 1.6, 60)
    frequency, amplitude = 10 + 0.3 * (along**3 - 1.5 * along), 2.5 - np.tanh(2 * along)
    rng = np.random.default_rng(0)
    noisy = amplitude * (1 + 0.01 * rng.standard_normal(60))
    curve = vj.io.MeasuredCurve(frequency, "frequency", noisy, is_ratio=False)
    level = np.median(curve.noise().amplitude / amplitude)
    assert level == pytest.approx(0.01, rel=0.5)
    mixed = rng.permutation(60)
    assert np.median(curve_of(curve, mixed).noise().amplitude / amplitude[mixed]) > 0.03


def curve_of(curve, at):
    return dataclasses.replace(curve, frequency=curve.frequency[at], amplitude=curve.amplitude[at])


@pytest.mark.parametrize(
    ("about", "sentence"),
    [
        (dict(drive_amplitude=[0.0]), "drive_amplitude must be finite and above 0"),
        (dict(drive_amplitude=[1.0, 2.0]), "drive_amplitude has 2 points, frequency has 41"),
        (dict(drive_signal="voltage"), "drive_signal must be one of"),
        (dict(phase_deviation=[0.1]), "phase_deviation is given without phase"),
        (dict(phase=0 * DRIVE, phase_deviation=[-1.0]), "phase_deviation must be finite and above"),
        (
            dict(phase=0 * DRIVE, signal="power", is_ratio=False),
            "phase is given, and a power has none",
        ),
        (
            dict(
                drive_amplitude=[1.0], drive_signal="acceleration", frequency_name="frequency_ratio"
            ),
            "follows from frequencies in Hz",
        ),
    ],
)
def test_what_is_no_excitation_is_refused(about, sentence):
    given = dict(frequency_name="frequency", amplitude=np.abs(RESPONSE)) | about
    with pytest.raises(ValueError, match=sentence):
        vj.io.MeasuredCurve(FREQUENCY, **given)
