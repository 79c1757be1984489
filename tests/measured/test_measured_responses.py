"""Complex responses, and forces of which nothing says whose they are."""

import warnings

import numpy as np
import pandas
import pytest
import xarray

import vibrojax as vj
from vibrojax.measured.curve import check_parameters

FREQUENCY = np.linspace(8.0, 12.0, 31)
RESPONSE = 1e-3 / (1 - (FREQUENCY / 10) ** 2 + 0.04j * FREQUENCY / 10)
NAMES = ("frequency [Hz]", "amplitude [m]")


def csv_of(template):
    def make(folder):
        path = folder / "response.csv"
        rows = (
            template.format(f=f, h=h, re=h.real, im=h.imag)
            for f, h in zip(FREQUENCY.tolist(), RESPONSE.tolist(), strict=True)
        )
        path.write_text("\n".join([",".join(NAMES), *rows]))
        return path

    return make


def dataset(folder):
    return xarray.Dataset(
        {"tip": ("f", RESPONSE, {"units": "m"})}, {"f": ("f", FREQUENCY, {"units": "Hz"})}
    )


def netcdf(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # complex numbers are no standard of NetCDF
        dataset(folder).to_netcdf(folder / "response.nc", engine="h5netcdf", invalid_netcdf=True)
    return folder / "response.nc"


def series(folder):
    return pandas.Series(RESPONSE, pandas.Index(FREQUENCY, name=NAMES[0]), name=NAMES[1])


SOURCES = {
    "arrays": lambda folder: dict(zip(NAMES, (FREQUENCY, RESPONSE), strict=True)),
    "lists": lambda folder: dict(zip(NAMES, (FREQUENCY.tolist(), list(RESPONSE)), strict=True)),
    "data frame": lambda folder: pandas.DataFrame({NAMES[0]: FREQUENCY, NAMES[1]: RESPONSE}),
    "objects": lambda folder: pandas.DataFrame(
        {NAMES[0]: FREQUENCY, NAMES[1]: RESPONSE.astype(object)}
    ),
    "stacked": lambda folder: pandas.DataFrame(
        np.column_stack([FREQUENCY, RESPONSE]), columns=list(NAMES)
    ),
    "series": series,
    "dataset": dataset,
    "data array": lambda folder: dataset(folder)["tip"],
    "netcdf": netcdf,
    "text of python": csv_of("{f!r},{h!r}"),
    "text of matlab": csv_of("{f!r},{re!r} {im:+.17g}i"),
    "parts": lambda folder: {
        NAMES[0]: FREQUENCY,
        "Re(H) [m]": RESPONSE.real,
        "Im(H) [m]": RESPONSE.imag,
    },
    "named parts": lambda folder: {
        NAMES[0]: FREQUENCY,
        "H real [mm]": 1e3 * RESPONSE.real,
        "H imag [mm]": 1e3 * RESPONSE.imag,
    },
}


@pytest.mark.parametrize("source", SOURCES)
def test_a_complex_column_is_a_response_with_magnitude_and_phase(tmp_path, source):
    curve = vj.io.read_measured_curve(SOURCES[source](tmp_path))
    assert curve.size == 31
    np.testing.assert_allclose(curve.amplitude, np.abs(RESPONSE), rtol=1e-12)
    np.testing.assert_allclose(curve.phase, np.angle(RESPONSE), rtol=1e-12)
    assert curve.quantity == "first_harmonic"
    assert any("complex: its magnitude" in n and "is fitted too" in n for n in curve.notes)
    assert "phase, rad: -3.033 to -0.08866" in repr(curve)
    left = vj.io.read_measured_curve(SOURCES[source](tmp_path), columns=dict(phase=None))
    assert left.phase is None
    np.testing.assert_allclose(left.amplitude, np.abs(RESPONSE), rtol=1e-12)
    assert left.quantity == "first_harmonic"


def test_a_curve_made_of_complex_amplitudes():
    curve = vj.io.MeasuredCurve(FREQUENCY, "frequency", RESPONSE, is_ratio=False)
    np.testing.assert_array_equal(curve.amplitude, np.abs(RESPONSE))
    np.testing.assert_array_equal(curve.phase, np.angle(RESPONSE))
    assert curve.quantity == "first_harmonic"
    named = vj.io.MeasuredCurve(FREQUENCY, "frequency", RESPONSE, quantity="rms", is_ratio=False)
    assert named.quantity == "rms"
    with pytest.raises(ValueError, match="phase is given, but the amplitude is complex"):
        vj.io.MeasuredCurve(FREQUENCY, "frequency", RESPONSE, phase=FREQUENCY)
    with pytest.raises(ValueError, match="phase has 2 points, frequency has 31"):
        vj.io.MeasuredCurve(FREQUENCY, "frequency", FREQUENCY, phase=np.zeros(2))
    with pytest.raises(ValueError, match="phase is given without amplitude"):
        vj.io.MeasuredCurve(FREQUENCY, "frequency", contact_force=FREQUENCY, phase=FREQUENCY)
    assert vj.io.MeasuredCurve(FREQUENCY, "frequency", FREQUENCY).phase is None


def test_magnitude_and_phase_in_two_columns():
    source = {NAMES[0]: FREQUENCY, "magnitude [m]": np.abs(RESPONSE)}
    degrees = np.degrees(np.angle(RESPONSE))
    degrees[3] = np.inf
    curve = vj.io.read_measured_curve(source | {"phase [deg]": degrees})
    assert (curve.size, curve.quantity) == (31, "amplitude")
    np.testing.assert_allclose(np.delete(curve.phase - np.angle(RESPONSE), 3), 0, atol=1e-12)
    assert np.isnan(curve.phase[3])
    assert any("'phase [deg]' was taken for the phase" in note for note in curve.notes)
    unclear = vj.io.read_measured_curve(source | {"phase": degrees})
    assert unclear.phase is None
    assert any("'phase' was left out, as it says no unit" in note for note in unclear.notes)
    in_degrees = vj.io.read_measured_curve(source | {"phase": degrees}, units=dict(phase="deg"))
    np.testing.assert_array_equal(in_degrees.phase, curve.phase)
    both = source | {"real [m]": RESPONSE.real, "imag [m]": RESPONSE.imag}
    assert vj.io.read_measured_curve(both).phase is None


@pytest.mark.parametrize(
    ("columns", "settings", "sentence"),
    [
        ({"f_Hz": RESPONSE, "tip_m": FREQUENCY}, {}, "'f_Hz' is complex .* frequency must be real"),
        ({"sd": RESPONSE}, {}, "'sd' is complex .* on row 1.: the deviation must be real"),
        ({"weight": RESPONSE}, {}, "'weight' is complex .*: the weight must be real"),
        ({"gap": RESPONSE}, dict(split="gap"), "'gap' is complex .*: the gap must be real"),
        ({"contact_force_N": RESPONSE}, {}, "contact_force must be real.*contact_force=None"),
        ({"tip_m": RESPONSE, "phase_rad": FREQUENCY}, {}, "is complex, and 'phase_rad' is a phase"),
        ({"tip_m": RESPONSE.real, "re": FREQUENCY}, dict(columns=dict(real="re")), "leave one"),
    ],
)
def test_complex_numbers_elsewhere_are_refused(columns, settings, sentence):
    source = {"f_Hz": FREQUENCY, "tip_m": np.abs(RESPONSE)} | columns
    with pytest.raises(ValueError, match=f"Measured curve from 'dict': .*{sentence}"):
        vj.io.read_measured_curve(source, **settings)


@pytest.mark.parametrize(
    ("columns", "settings", "sentence"),
    [
        (["H real [m]"], {}, "'H real .m.' is the real part .* no other part"),
        (["Im H [m]"], {}, "is the imaginary part of a response"),
        (["H real [m]", "H imag [mm]"], {}, "must be in one unit, got 'm' and 'mm'"),
        (["real [m]"], dict(columns=dict(amplitude="real [m]")), "one part of a complex response"),
    ],
)
def test_a_part_of_a_response_is_not_an_amplitude(columns, settings, sentence):
    source = {"f_Hz": FREQUENCY} | {name: FREQUENCY for name in columns}
    with pytest.raises(ValueError, match=sentence):
        vj.io.read_measured_curve(source, **settings)


def test_complex_parameters_are_refused():
    with pytest.raises(ValueError, match=r"gap must be a finite number, got np\.complex128"):
        check_parameters({"gap": np.complex128(1 + 2j)})


def test_complex_signals_over_time_are_refused():
    for source in ({"t_s": FREQUENCY, "tip_m": RESPONSE}, {"t_s": RESPONSE, "tip_m": FREQUENCY}):
        with pytest.raises(ValueError, match=r"is complex .* must be real"):
            vj.io.read_measured_history(source, frequency=10.0)
    with pytest.raises(ValueError, match="displacement must be real, got the complex number"):
        vj.io.MeasuredHistory(FREQUENCY, RESPONSE, frequency=10.0)
    with pytest.raises(ValueError, match="frequency must be real"):
        vj.io.MeasuredCurve(RESPONSE, "frequency", FREQUENCY)


AMBIGUOUS = (
    "force [N]",
    "Force",
    "force_N",
    "F [N]",
    "F_max [mN]",
    "max force [N]",
    "load [N]",
    "load cell (N)",
)


@pytest.mark.parametrize("name", AMBIGUOUS)
def test_a_plain_force_is_asked_about(name):
    source = {"f_Hz": FREQUENCY, "tip amplitude [m]": np.abs(RESPONSE), name: FREQUENCY}
    units = dict(contact_force="N") if name == "Force" else {}
    with pytest.raises(ValueError, match="may be the contact force or the force of the") as caught:
        vj.io.read_measured_curve(source)
    for choice in (f"columns=dict(contact_force={name!r})", "columns=dict(contact_force=None)"):
        assert choice in str(caught.value)
    with pytest.raises(ValueError, match="may be the contact force or the force of the drive"):
        vj.io.read_measured_curve({"f_Hz": FREQUENCY, name: FREQUENCY})
    named = vj.io.read_measured_curve(source, columns=dict(contact_force=name), units=units)
    assert named.contact_force is not None
    left = vj.io.read_measured_curve(source, columns=dict(contact_force=None))
    assert left.contact_force is None
    history = {"t_s": FREQUENCY, "tip_m": FREQUENCY, name: FREQUENCY}
    with pytest.raises(ValueError, match="may be the contact force or the force of the drive"):
        vj.io.read_measured_history(history, frequency=10.0)
    left = vj.io.read_measured_history(history, frequency=10.0, columns=dict(contact_force=None))
    assert left.contact_force is None


def test_forces_that_say_whose_they_are():
    source = {"f_Hz": FREQUENCY, "tip amplitude [m]": np.abs(RESPONSE)}
    for name in ("contact force [N]", "impact_force_N", "max contact force [mN]"):
        assert vj.io.read_measured_curve(source | {name: FREQUENCY}).contact_force is not None
    both = vj.io.read_measured_curve(
        source | {"contact_force_N": FREQUENCY, "force [N]": FREQUENCY}
    )
    np.testing.assert_array_equal(both.contact_force, FREQUENCY)
    for name in ("shaker force [N]", "drive_force_N", "excitation force [N]"):
        assert vj.io.read_measured_curve(source | {name: FREQUENCY}).contact_force is None
    deviation = source | {"force [N]": FREQUENCY, "force_sd": FREQUENCY}
    left = vj.io.read_measured_curve(deviation, columns=dict(contact_force=None))
    assert left.contact_force_deviation is None
    named = vj.io.read_measured_curve(deviation, columns=dict(contact_force="force [N]"))
    np.testing.assert_array_equal(named.contact_force_deviation, FREQUENCY)
