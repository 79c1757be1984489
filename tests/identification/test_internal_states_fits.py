"""Fits of systems with internal states: stops that relax, and beams with a circuit."""

import dataclasses

import numpy as np
import pytest
from test_history_misfit import at, differences, sampled

import vibrojax as vj
from vibrojax.identification.history_misfit import HistoryMisfit
from vibrojax.identification.trial_rigs import Maker
from vibrojax.io import MeasuredCurve, MeasuredHistory, read_measured_curve
from vibrojax.model.drives import NoDrive

SOLID = {"stiffness": 3000.0, "maxwell_stiffness": 2000.0, "relaxation_time": 2e-3}
SOLID_GUESS = {"stiffness": 2000.0, "maxwell_stiffness": 4000.0, "relaxation_time": 5e-3}
CIRCUIT = {"resistance": 2e4, "gap": 8e-6}


def relaxing(stiffness, maxwell_stiffness, relaxation_time, amplitude=0.2e-3):
    rig = vj.default_rig(num_modes=2, damping_ratio=0.02)
    law = vj.StandardLinearSolid(stiffness, maxwell_stiffness, relaxation_time)
    return dataclasses.replace(
        rig, stops=(vj.Stop(0.5, 0.4e-3, law),), drive=vj.BaseMotion(amplitude)
    )


def released(stiffness, maxwell_stiffness, relaxation_time):
    rig = relaxing(stiffness, maxwell_stiffness, relaxation_time)
    return dataclasses.replace(rig, drive=NoDrive())


def bimorph(resistance, gap, report="voltage"):
    beam, layers = vj.model.bimorph(
        length=50.8e-3,
        width=31.8e-3,
        substrate_thickness=0.14e-3,
        layer_thickness=0.26e-3,
        substrate_modulus=105e9,
        layer_modulus=66e9,
        substrate_density=9000.0,
        layer_density=7800.0,
        piezoelectric_constant=-12.54,
        permittivity=1500 * 8.854e-12,
    )
    stop = vj.Stop(1.0, gap, vj.KelvinVoigt(5e3, 0.1))
    rig = vj.ImpactingBeam(beam, stop, vj.BaseMotion(1e-6), damping_ratio=0.02, num_modes=2)
    return vj.Harvester(rig, layers, resistance=resistance, report=report)


def pulls(fits, true):
    """By how many standard deviations estimates miss the truth."""
    return np.array(
        [[(f.estimate[n] - true[n]) / f.standard_deviation[n] for n in true] for f in fits]
    )


def drive_of(count):
    noise = np.random.default_rng(3).standard_normal(count + 1)
    return vj.Sampled(1e-3 * np.arange(count + 1), 2 * np.cumsum(noise))


@pytest.mark.slow
@pytest.mark.parametrize(
    "begins",
    [
        "signal",
        pytest.param("release", marks=pytest.mark.long),  # to compile
        pytest.param("settled", marks=pytest.mark.long),
    ],
)
def test_histories_of_a_stop_that_relaxes_have_no_misfit_at_the_truth(begins):
    make, options, part, facts = relaxing, {"frequency_ratio": 1.1}, slice(-65, -1), {}
    if begins == "release":
        make, part, facts = released, slice(5, None), {"release": -3e-3}
        options = facts | {"duration": 0.3, "samples": 150}
    elif begins == "signal":
        facts = {"waveform": drive_of(300)}
        options, part = facts | {"samples": 300}, slice(1, None, 6)
    else:
        facts = options
        options = options | {"periods": 402, "samples_per_period": 32}
    history = vj.simulate(make(**SOLID), gradient="forward", **options)
    channels = ("displacement", "acceleration", "contact_force")
    time, signals = sampled(history, channels, part)
    time = time - (time[0] if begins == "settled" else 0.0)
    assert signals["contact_force"].max() > 0.5
    deviation = {n: 0.01 * np.abs(values).max() for n, values in signals.items()}
    target = HistoryMisfit(
        Maker(make, tuple(SOLID), {}, {}),
        [MeasuredHistory(time=time, deviation=deviation, align_phase=False, **signals, **facts)],
    )
    true = np.array(list(SOLID.values()))
    residual, derivative = at(true, target)
    assert np.abs(residual).max() < 1e-6
    error = np.abs(derivative - differences(target, true)).max(axis=0)
    assert (error < 1e-5 * np.abs(derivative).max(axis=0)).all()


@pytest.mark.slow
def test_relaxation_from_a_history_is_as_far_off_as_its_intervals_say():
    drive = drive_of(300)
    history = vj.simulate(relaxing(**SOLID), waveform=drive, samples=300, gradient="forward")
    time, signals = sampled(history, ("displacement", "contact_force"), slice(1, None, 2))
    deviation = {name: 0.01 * np.abs(values).max() for name, values in signals.items()}
    rng = np.random.default_rng(0)
    measured = []
    for _ in range(8):
        noisy = {n: v + deviation[n] * rng.standard_normal(v.shape) for n, v in signals.items()}
        measured.append(MeasuredHistory(time=time, deviation=deviation, waveform=drive, **noisy))
    fits = vj.identify(relaxing, measured, SOLID_GUESS, together=False)
    assert all(all(fit.identifiable.values()) for fit in fits)
    missed = pulls(fits, SOLID)
    assert np.abs(missed).max() < 3.5
    assert 0.5 < np.sqrt(np.mean(missed**2)) < 1.5
    assert max(fit.standard_deviation["stiffness"] for fit in fits) < 60


@pytest.mark.slow
@pytest.mark.long
def test_relaxation_from_curves_at_two_drive_levels():
    rng, measured = np.random.default_rng(1), []
    ratio = np.linspace(0.9, 1.5, 25)
    for amplitude in (0.1e-3, 0.4e-3):
        sweep = vj.frequency_sweep(relaxing(**SOLID, amplitude=amplitude), frequency_ratio=ratio)
        data = sweep.to_xarray().stack(point=("direction", "frequency_ratio"))
        ways = np.where(data.direction.values == "forward", 1, -1)
        shown = [data.amplitude_ratio.values, data.contact_force.values.reshape(-1)]
        deviation = [0.01 * np.abs(shown[0]), np.full(50, 0.01 * shown[1].max())]
        noisy = [v + d * rng.standard_normal(50) for v, d in zip(shown, deviation, strict=True)]
        measured.append(
            MeasuredCurve(
                data.frequency_ratio.values,
                "frequency_ratio",
                noisy[0],
                deviation[0],
                np.maximum(noisy[1], 0.0),
                deviation[1],
                direction=ways,
                parameters={"amplitude": amplitude},
            )
        )
    fit = vj.identify(relaxing, measured, SOLID_GUESS)
    assert all(fit.identifiable.values())
    assert fit.reduced_chi_square < 1.5
    for name, value in SOLID.items():
        low, high = fit.interval[name]
        assert low < value < high
    assert fit.standard_deviation["relaxation_time"] < 1e-3


@pytest.fixture(scope="module")
def swept():
    ratio = np.linspace(0.8, 1.25, 28)
    return {
        report: vj.frequency_sweep(bimorph(**CIRCUIT, report=report), frequency_ratio=ratio)
        for report in ("voltage", "power")
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["voltage", "mean_power", "peak_power"])
def test_load_and_gap_from_a_curve_of_voltage_or_power(swept, tmp_path, name):
    report = "voltage" if name == "voltage" else "power"
    data = swept[report].to_xarray().stack(point=("direction", "frequency_ratio"))
    scatter = 1 + 0.01 * np.random.default_rng(0).standard_normal(data.point.size)
    unit, size = ("mV", 1e3) if report == "voltage" else ("uW", 1e6)
    columns = np.stack([data.frequency_ratio.values, size * data[name].values * scatter])
    path = tmp_path / "curve.csv"
    words = np.where(data.direction.values == "forward", "up", "down")
    rows = [f"{a:.8g},{b:.8g},{way}" for a, b, way in zip(*columns, words, strict=True)]
    path.write_text("\n".join([f"ratio,{name} [{unit}],sweep", *rows]))
    measured = read_measured_curve(path)
    assert measured.unit == ("V" if report == "voltage" else "W")
    np.testing.assert_allclose(measured.amplitude, columns[1] / size, rtol=1e-6)
    fit = vj.identify(
        lambda resistance, gap: bimorph(resistance, gap, report),
        measured,
        {"resistance": 3e4, "gap": 1e-5},
    )
    assert all(fit.identifiable.values())
    for number, value in CIRCUIT.items():
        low, high = fit.interval[number]
        assert low < value < high
        assert fit.estimate[number] == pytest.approx(value, rel=0.05)


@pytest.mark.slow
def test_sweeps_of_harvesters_are_read_as_what_they_report(swept):
    voltage = read_measured_curve(swept["voltage"].to_xarray())
    assert (voltage.signal, voltage.quantity, voltage.unit) == ("voltage", "amplitude", "V")
    power = read_measured_curve(swept["power"].to_xarray())
    assert (power.signal, power.quantity, power.unit) == ("power", "mean", "W")
    largest = read_measured_curve(swept["power"].to_xarray(), quantity="peak")
    wanted = np.sort(np.asarray(swept["power"].peak_power).ravel())
    np.testing.assert_allclose(np.sort(largest.amplitude), wanted)


@pytest.mark.parametrize(
    ("report", "signal", "sentence"),
    [
        ("power", "voltage", r"'voltage' was measured, but the Harvester reports its power.* in W"),
        ("displacement", "power", "'power' was measured, but the Harvester reports its displ"),
        ("voltage", "displacement", "'displacement' was measured, but the .* its voltage.* in V"),
    ],
)
def test_a_signal_that_is_not_reported_is_refused(report, signal, sentence):
    curve = MeasuredCurve([0.9, 1.0], "frequency_ratio", [1.0, 2.0], signal=signal, is_ratio=False)
    with pytest.raises(ValueError, match=sentence):
        vj.identify(
            lambda resistance: bimorph(resistance, 1e-5, report), curve, {"resistance": 1e4}
        )


def test_histories_of_a_rounded_stop_that_relaxes_are_refused():
    def rounded(stiffness):
        rig = relaxing(stiffness, 2000.0, 2e-3)
        stop = dataclasses.replace(rig.stops[0], smoothing=1e-4)
        return dataclasses.replace(rig, stops=(stop,))

    time = np.linspace(0.0, 0.1, 20)
    history = MeasuredHistory(time=time, displacement=np.sin(90 * time), frequency=10.0)
    with pytest.raises(ValueError, match="has internal states, and its contact is not exact"):
        HistoryMisfit(Maker(rounded, ("stiffness",), {}, {}), [history])
