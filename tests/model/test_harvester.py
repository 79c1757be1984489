"""Beams with piezoelectric layers: closed forms of Erturk and Inman, and stops by scipy."""

import jax
import numpy as np
import pytest
from event_driven import integrate
from scipy.optimize import brentq, minimize_scalar

import vibrojax as vj

# The bimorph of Erturk and Inman 2009, table 2: brass between two layers of PZT-5A, here without
# its tip mass.
NUMBERS = {
    "length": 50.8e-3,
    "width": 31.8e-3,
    "substrate_thickness": 0.14e-3,
    "layer_thickness": 0.26e-3,
    "substrate_modulus": 105e9,
    "layer_modulus": 66e9,
    "substrate_density": 9000.0,
    "layer_density": 7800.0,
    "piezoelectric_constant": -12.54,
    "permittivity": 1500 * 8.854e-12,
}
ZETA, BASE = 0.02, 1e-6


def harvester(resistance=1e4, *, gap=None, coupling=1.0, connection="series", modes=3, **circuit):
    numbers = NUMBERS | {"piezoelectric_constant": coupling * NUMBERS["piezoelectric_constant"]}
    beam, layers = vj.model.bimorph(**numbers, connection=connection)
    stops = () if gap is None else vj.Stop(1.0, gap, vj.KelvinVoigt(5e3, 0.1))
    rig = vj.ImpactingBeam(beam, stops, vj.BaseMotion(BASE), damping_ratio=ZETA, num_modes=modes)
    return vj.Harvester(rig, layers, resistance=resistance, **circuit)


def closed_form(w, resistance, connection="series", modes=3, impedance=None):
    """Voltage (complex, V) by Erturk and Inman 2009, and its equivalent circuits."""
    n = NUMBERS
    hs, hp, b, length = (
        n[k] for k in ("substrate_thickness", "layer_thickness", "width", "length")
    )
    half = hs / 2
    bending = (
        2
        * b
        / 3
        * (n["substrate_modulus"] * half**3 + n["layer_modulus"] * ((hp + half) ** 3 - half**3))
    )
    mass = b * (n["substrate_density"] * hs + 2 * n["layer_density"] * hp)
    layer = n["permittivity"] * b * length / hp
    capacitance, factor = (layer / 2, 1) if connection == "series" else (2 * layer, 2)
    source, inner = 0.0, 0.0
    for r in range(modes):
        at = (r + 0.5) * np.pi
        beta = brentq(lambda x: np.cos(x) + 1 / np.cosh(x), at - 0.8, at + 0.8, xtol=1e-15)
        sigma = (np.sinh(beta) - np.sin(beta)) / (np.cosh(beta) + np.cos(beta))
        slope = (
            beta / length * (np.sinh(beta) + np.sin(beta) - sigma * (np.cosh(beta) - np.cos(beta)))
        )
        natural = beta**2 * np.sqrt(bending / (mass * length**4))
        kappa = -factor * n["piezoelectric_constant"] * b * (hs + hp) / 2
        kappa *= slope / np.sqrt(mass * length)
        force = np.sqrt(mass * length) * 2 * sigma / beta * w**2 * BASE
        dynamic = natural**2 - w**2 + 2j * ZETA * natural * w
        source, inner = source + 1j * w * kappa * force / dynamic, inner + kappa**2 / dynamic
    load = 1 / resistance if impedance is None else 1 / impedance
    return source / (load + 1j * w * (capacitance + inner)), 1j * w * (capacitance + inner)


@pytest.mark.parametrize("connection", ["series", "parallel"])
def test_linear_harvesters_are_the_closed_forms(connection):
    for resistance in (1e2, 1e4, 1e6):
        system = harvester(resistance, connection=connection)
        first = float(system.rig.modes().frequency[0])
        for ratio in (0.9, 1.0):
            found = vj.periodic_response(system, frequency=ratio * first)
            voltage, _ = closed_form(2 * np.pi * ratio * first, resistance, connection)
            power = abs(voltage) ** 2 / resistance
            assert float(found.mean_power) == pytest.approx(power / 2, rel=1e-9)
            assert float(found.peak_power) == pytest.approx(power, rel=1e-9)


def test_the_best_load_is_where_the_closed_form_has_most_power():
    system = harvester()
    frequency = 1.02 * float(system.rig.modes().frequency[0])

    def loss(exponent):
        voltage, _ = closed_form(2 * np.pi * frequency, 10**exponent)
        return -(abs(voltage) ** 2) / 10**exponent

    best = minimize_scalar(loss, bounds=(2, 7), method="bounded", options={"xatol": 1e-9})
    assert float(system.optimal_resistance(frequency)) == pytest.approx(10**best.x, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("inductor", ["series", "parallel"])
def test_inductances_are_in_the_circuit_where_they_are_said_to_be(inductor):
    resistance, inductance = 2e4, 30.0
    system = harvester(resistance, inductance=inductance, inductor=inductor, report="voltage")
    frequency = 1.05 * float(system.rig.modes().frequency[0])
    reactance = 2j * np.pi * frequency * inductance
    if inductor == "series":
        voltage, _ = closed_form(2 * np.pi * frequency, 1.0, impedance=resistance + reactance)
        voltage = voltage * resistance / (resistance + reactance)
    else:
        both = 1 / (1 / resistance + 1 / reactance)
        voltage, _ = closed_form(2 * np.pi * frequency, 1.0, impedance=both)
    found = vj.periodic_response(system, frequency=frequency)
    assert float(found.voltage) == pytest.approx(abs(voltage), rel=1e-9)


@pytest.mark.slow
def test_without_coupling_the_beam_moves_as_without_a_circuit():
    system = harvester(gap=5e-6, coupling=0.0, report="displacement", modes=2)
    found = vj.periodic_response(system, frequency_ratio=1.05)
    wanted = vj.periodic_response(system.rig, frequency_ratio=1.05)
    assert found.ratio_units == "1"
    assert wanted.contact_force > 0
    for name in ("rms_ratio", "contact_force"):
        assert float(getattr(found, name)) == pytest.approx(float(getattr(wanted, name)), rel=1e-11)


def by_scipy(system, state, ratio, modes):
    """Integrate beam, circuit and stop over a drive period."""
    beam, stop = system.rig.equations(), system.rig.stops[0]
    w, place = np.asarray(beam.angular_frequency), np.asarray(beam.stop_map[0])
    push, drive = np.asarray(beam.force_map[:, 0]), np.asarray(beam.input_map)
    theta, mass = np.asarray(system.coupling()), np.asarray(beam.modal_mass)
    capacitance, resistance = float(system.layers.capacitance), float(system.resistance)
    frequency = ratio * w[0]

    def rate(t, x, inside):
        q, v, voltage = x[:modes], x[modes : 2 * modes], x[2 * modes]
        force = 0.0
        if inside:
            force = stop.law.stiffness * (place @ q - stop.gap) + stop.law.damping * (place @ v)
        a = drive * BASE * frequency**2 * np.sin(frequency * t) - w**2 * q - 2 * ZETA * w * v
        a = a - theta / mass * voltage - push * force
        flow = (theta @ v - voltage / resistance) / capacitance
        return np.concatenate([v, a, [flow], 0 * x[2 * modes + 1 :]])

    def signal(x):
        return place @ x[:modes] - stop.gap

    end = 2 * np.pi / frequency
    return integrate(rate, signal, state, end, inside=signal(state) > 0)


@pytest.mark.slow
def test_with_a_stop_the_motion_returns_as_scipy_integrates_it():
    system = harvester(3e4, gap=5e-6, modes=2)
    found = vj.periodic_response(system, frequency_ratio=1.05)
    assert found.converged
    assert found.exact
    assert found.contact_force > 0
    start = np.asarray(found.initial_state)
    back, changes, _ = by_scipy(system, start, 1.05, 2)
    assert len(changes) == 2 * int(found.contacts_per_period)
    scale = np.abs(start)
    np.testing.assert_allclose(back[:5], start[:5], atol=1e-9 * scale[:2].max(), rtol=1e-8)


@pytest.mark.slow
def test_sweeps_branches_maps_and_histories_have_voltage_and_power_with_units():
    make = lambda resistance, gap: harvester(resistance, gap=gap, modes=2)  # noqa: E731
    system = make(3e4, 5e-6)
    ratios, settings = np.linspace(0.9, 1.2, 13), vj.SweepSettings(refine_jumps=None)
    sweep = vj.frequency_sweep(system, frequency_ratio=ratios, settings=settings)
    branch = vj.continue_response(system, frequency_ratio=vj.Range(0.89, 1.21))
    assert branch.exact_points.all()
    compared = branch.compare(sweep)
    assert np.nanmax(compared.relative_difference) < 1e-6
    maps = vj.parameter_map(
        make, resistance=[3e4], gap=[5e-6], frequency_ratio=ratios, response=settings
    )
    for dataset in (sweep.to_xarray(), branch.to_xarray(), maps):
        for name in ("mean_power", "peak_power"):
            assert dataset[name].attrs["units"] == "W"
            assert dataset[name].max() > 0
    np.testing.assert_allclose(maps["mean_power"].squeeze(), sweep.mean_power, rtol=1e-6)
    branch.plot("mean_power")
    history = vj.simulate(system, frequency_ratio=1.05, periods=60)
    data = history.to_xarray()
    assert data["voltage"].attrs["units"] == "V"
    last = data["voltage"].values[-128:]
    index = int(np.argmin(np.abs(np.asarray(sweep.frequencies) - 1.05)))
    assert np.mean(last**2) / 3e4 == pytest.approx(float(sweep.mean_power[0, index]), rel=1e-3)
    with pytest.raises(AttributeError, match="voltage needs a Harvester with report='voltage'"):
        sweep.voltage  # noqa: B018


@pytest.mark.slow
def test_power_has_derivatives_by_load_and_gap():
    def power(resistance, gap):
        system = harvester(resistance, gap=gap, modes=2)
        return vj.periodic_response(system, frequency_ratio=1.05).mean_power

    at = 3e4, 5e-6
    for k, slope in enumerate(jax.grad(power, (0, 1))(*at)):
        step = 1e-4 * at[k]
        ends = [power(*(x + s * step * (i == k) for i, x in enumerate(at))) for s in (1, -1)]
        assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-5)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: harvester(0.0), "resistance must be above 0"),
        (lambda: harvester(1.0, inductance=-1.0), "inductance must be above 0"),
        (lambda: harvester(1.0, report="current"), "report must be"),
        (lambda: harvester(1.0, connection="star"), "connection must be"),
        (lambda: vj.model.PiezoLayers(1e-4, 0.0), "capacitance must be above 0"),
        (lambda: vj.model.PiezoLayers(1e-4, 1e-8, 0.5, 0.2), "end must be beyond start = 0.5"),
    ],
)
def test_what_is_no_harvester_is_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()
