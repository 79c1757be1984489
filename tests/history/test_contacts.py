"""Contacts and peaks of a history between its samples.

`data/soft_support.json` (made without JAX: exact event-driven propagation, peaks read off a fine
grid and so never too high) is that of a beam released or driven against a soft stop, after
Ledezma-Ramirez et al.
"""

import json
import math
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import vibrojax as vj
from vibrojax.history import exact_cells, exact_pieces

REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "soft_support.json").read_text())
G = REFERENCE["parameters"]["g"]


def soft_rig(c1=0.0, *, tension=True, drive=None, tip_mass=0.0, stops=None, side=-1):
    numbers = REFERENCE["parameters"]
    size = numbers["L"], numbers["b"], numbers["h"], numbers["E"], numbers["rho"]
    mass = numbers["rho"] * numbers["b"] * numbers["h"] * numbers["L"]
    beam = vj.Cantilever(*size, mass_ratio=tip_mass / mass)
    law = vj.KelvinVoigt(numbers["k1"], c1, tension)
    stops = stops or (vj.Stop(1.0, numbers["gap"], law, side=side),)
    return vj.ImpactingBeam(beam, stops, drive or vj.NoDrive(), numbers["zeta"], 5)


class Body(vj.model.AbstractSystem):
    """A system of given equations."""

    made: vj.model.LinearEquations
    drive: vj.model.AbstractDrive = vj.NoDrive()

    def equations(self):
        return self.made


@pytest.fixture(scope="module")
def strike(oscillator):
    """A mass of 1 kg on a spring of next to no stiffness, thrown at a stop 1 cm away."""

    def run(law, speed=1.0, **settings):
        equations = oscillator(frequency=0.1, gap=0.01)
        stop = eqx.tree_at(lambda s: s.law, equations.stops[0], law)
        body = Body(eqx.tree_at(lambda e: e.stops, equations, (stop,)))
        state = (jnp.zeros(1), jnp.asarray([speed]))
        settings = {"samples": 400, "duration": 0.1, **settings}
        return vj.simulate(body, initial_state=state, **settings)

    return run


def released(case, **settings):
    free = case.get("law") != "no_tension"
    rig = soft_rig(case["c1"], tension=free, tip_mass=case.get("tip_mass", 0.0))
    settings = {"samples_per_period": 256, "tolerance": 1e-8, **settings}
    return vj.simulate(rig, release=case["x0"], duration=0.5, **settings)


@pytest.mark.parametrize(
    "number",
    [
        n if n < 6 else pytest.param(n, marks=pytest.mark.slow)
        for n in range(len(REFERENCE["free"]))
    ],
)
def test_releases_agree_with_the_reference(number):
    case = REFERENCE["free"][number]
    history = released(case)
    contacts = history.contacts()
    assert len(contacts) == case["contacts"]
    peak = history.peak("acceleration")
    assert abs(peak.value) / G == pytest.approx(case["peak_acc_g"], rel=5e-4)
    assert abs(peak.value) / G > case["peak_acc_g"] * (1 - 1e-9)
    assert abs(history.acceleration()[0]) / G == pytest.approx(case["acc_at_release_g"], rel=1e-9)
    force = history.peak("contact_force")
    assert force.value == pytest.approx(case["peak_force"], rel=1e-4)
    assert contacts.lowest_force.min(initial=0.0) == pytest.approx(case["min_force"], abs=1e-9)
    if case["contacts"]:
        first = contacts.touch[0], contacts.departure[0]
        assert first == pytest.approx(case["first_contact"], abs=1e-12)
        assert contacts.peak_force.max() == pytest.approx(force.value, rel=1e-6)
    assert abs(history.energy().balance).max() < 1e-9


FORCED = [case for case in REFERENCE["forced"] if case["period"]]


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(FORCED)))
def test_steady_motions_agree_with_the_reference(number):
    case, numbers = FORCED[number], REFERENCE["parameters"]
    drive = vj.PointForce(case["force"], numbers["s_force"])
    rig = soft_rig(case["c1"], drive=drive)
    settings = {"frequency": case["freq"], "tolerance": 1e-8}
    settled = vj.simulate(rig, periods=600, samples_per_period=64, **settings)
    state = (settled.coordinates[-1], settled.rates[-1])
    history = vj.simulate(rig, periods=4, samples_per_period=8192, initial_state=state, **settings)
    contacts = history.contacts()
    acceleration = np.asarray(history.acceleration())[1:] / G
    assert len(contacts) / 4 == case["contacts_per_period"]
    # Of the reference's grid a peak may miss what a fine one shows.
    assert abs(history.peak().value) / G == pytest.approx(case["peak_acc_g"], rel=1.5e-3)
    assert history.peak("contact_force").value == pytest.approx(case["peak_force"], rel=5e-4)
    assert contacts.lowest_force.min() == pytest.approx(case["min_force"], rel=3e-3)
    assert np.sqrt(np.mean(acceleration**2)) == pytest.approx(case["rms_acc_g"], rel=2.5e-2)
    largest = history.peak("displacement")
    assert largest.value == pytest.approx(case["tip_max"], rel=1e-4)
    depth = -case["tip_min"] - numbers["gap"]
    assert contacts.penetration.max() == pytest.approx(depth, rel=2e-3)


@pytest.mark.slow
def test_largest_force_of_the_start_up_agrees_with_the_reference():
    # The reference pushes towards the stop first: the same as our rig with the sides exchanged.
    # It also reads its forces off a grid, so ours are a little higher.
    numbers = REFERENCE["parameters"]
    for case in FORCED[:2]:
        rig = soft_rig(case["c1"], drive=vj.PointForce(case["force"], numbers["s_force"]), side=1)
        history = vj.simulate(
            rig, frequency=case["freq"], periods=40, samples_per_period=64, tolerance=1e-8
        )
        largest = history.peak("contact_force").value
        assert case["peak_force_transient"] <= largest
        assert largest == pytest.approx(case["peak_force_transient"], rel=5e-3)


@pytest.mark.parametrize("tension", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_kelvin_voigt_returns_what_its_closed_form_says(strike, tension):
    k, z = 50e3, 0.2
    contacts = strike(vj.KelvinVoigt(k, 2 * z * math.sqrt(k), tension)).contacts()
    root = math.sqrt(1 - z**2)
    turn = math.pi if tension else math.pi - math.atan2(2 * z * root, 1 - 2 * z**2)
    restitution = math.exp(-z / root * turn)
    assert len(contacts) == 1
    np.testing.assert_allclose(contacts.touch, 0.01, rtol=1e-6)
    np.testing.assert_allclose(contacts.duration, turn / (root * math.sqrt(k)), rtol=1e-5)
    np.testing.assert_allclose(contacts.restitution, restitution, rtol=1e-5)
    np.testing.assert_allclose(contacts.energy_lost, (1 - restitution**2) / 2, rtol=1e-5)
    np.testing.assert_allclose(contacts.impulse, 1 + restitution, rtol=1e-5)
    # The spring of the weak body takes next to nothing.
    np.testing.assert_allclose(contacts.approach_speed, 1.0, rtol=1e-6)


@pytest.mark.parametrize(("speed", "dissipation"), [(0.5, 1.0), (2.0, 0.2)])
def test_hunt_crossley_returns_what_its_first_integral_says(strike, speed, dissipation):
    contacts = strike(vj.HuntCrossley(1e6, dissipation), speed).contacts()
    mu = 1.5 * dissipation

    def left(u):
        return mu * (speed + u) - math.log(1 + mu * speed) + math.log(1 - mu * u)

    u = brentq(left, 1e-9, min(speed, 1 / mu - 1e-12))
    np.testing.assert_allclose(contacts.restitution, u / speed, rtol=1e-5)
    np.testing.assert_allclose(contacts.energy_lost, (speed**2 - u**2) / 2, rtol=1e-5)


def test_hertz_takes_as_long_as_it_should_and_loses_nothing(strike):
    k, speed = 1e6, 0.5
    contacts = strike(vj.Hertz(k), speed).contacts()
    # Johnson, Contact Mechanics (1985), sec. 11.4: T = 2.94 d/v at the largest depth d.
    depth = (5 * speed**2 / (4 * k)) ** 0.4
    lasts = 2 * depth / speed * math.sqrt(math.pi) * math.gamma(1.4) / math.gamma(0.9)
    np.testing.assert_allclose(contacts.penetration, depth, rtol=1e-5)
    np.testing.assert_allclose(contacts.duration, lasts, rtol=1e-6)
    np.testing.assert_allclose(contacts.restitution, 1.0, rtol=1e-6)
    np.testing.assert_allclose(contacts.energy_lost, 0.0, atol=1e-6 * speed**2)


@pytest.mark.slow
def test_rubber_agrees_with_its_matrix_exponential(strike):
    k, maxwell, lag = 50e3, 30e3, 5e-3
    history = strike(vj.StandardLinearSolid(k, maxwell, lag))
    contacts = history.contacts()
    matrix = np.array([[0, 1, 0], [-(k + maxwell), 0, maxwell], [1 / lag, 0, -1 / lag]])

    def state(time):  # depth, speed, stretch of the dashpot
        return expm(matrix * time) @ np.array([0.0, 1.0, 0.0])

    def force(time):
        depth, _, stretch = state(time)
        return (k + maxwell) * depth - maxwell * stretch

    end = brentq(force, 5e-3, 20e-3)
    depth, speed, stretch = state(end)
    places, weights = np.polynomial.legendre.leggauss(24)
    along = np.array([state((1 + x) * end / 2) for x in places])
    dashpot = end / 2 * weights @ (maxwell * (along[:, 0] - along[:, 2]) ** 2 / lag)
    kept = k * depth**2 / 2 + maxwell * (depth - stretch) ** 2 / 2
    np.testing.assert_allclose(contacts.restitution, -speed, rtol=1e-5)
    np.testing.assert_allclose(contacts.duration, end, rtol=1e-5)
    np.testing.assert_allclose(contacts.energy_lost, (1 - speed**2) / 2, rtol=1e-5)
    # What is in the springs at departure is lost while the surface creeps back.
    np.testing.assert_allclose(contacts.energy_lost, dashpot + kept, rtol=1e-5)
    loss = history.energy().contact_loss[:, 0]
    lost = np.interp(contacts.departure[0], np.asarray(history.time), loss)
    np.testing.assert_allclose(lost, dashpot, rtol=5e-3)
    np.testing.assert_allclose(loss[-1], dashpot + kept, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("tension", [True, False])
def test_how_finely_one_samples_does_not_matter(tension):
    case = {"c1": 10.0, "x0": 0.01, "law": "printed" if tension else "no_tension"}
    tables = [released(case, samples_per_period=n, tolerance=1e-10).contacts() for n in (64, 500)]
    coarse, fine = (table.to_xarray() for table in tables)
    assert coarse.sizes == fine.sizes
    for name in ("touch", "departure"):
        np.testing.assert_allclose(coarse[name], fine[name], rtol=0, atol=1e-9)
    for name in ("peak_force", "penetration", "impulse", "approach_speed", "energy_lost"):
        np.testing.assert_allclose(coarse[name], fine[name], rtol=1e-5, atol=1e-9)


@pytest.mark.slow
def test_coarse_samples_have_the_peaks_of_fine_ones():
    case = {"c1": 10.0, "x0": 0.01}
    coarse = released(case, samples_per_period=64, tolerance=1e-10)
    fine = released(case, samples_per_period=8000, tolerance=1e-10)
    for quantity in ("displacement", "velocity", "acceleration", "contact_force"):
        for start in (0.0, 0.0333):
            values = np.asarray(fine.quantity(quantity))[np.asarray(fine.time) >= start]
            largest = values.max() if quantity == "contact_force" else abs(values).max()
            peak = coarse.peak(quantity, start=start)
            assert abs(peak.value) == pytest.approx(largest, rel=1e-3)
            assert abs(peak.value) >= largest * (1 - 1e-8)
            assert start <= peak.time <= 0.5
    middle, seen = coarse.peak("displacement", 0.5), np.asarray(fine.displacement(0.5))
    assert abs(middle.value) == pytest.approx(abs(seen).max(), rel=1e-6)


@pytest.mark.parametrize("law", [vj.KelvinVoigt(5e4, 1.0), vj.Hertz(1e6)])
def test_the_peak_from_the_end_on_is_the_last_value(strike, law):
    history = strike(law)
    end = float(history.time[-1])
    last = history.peak("displacement", start=end)
    assert last.time == pytest.approx(end, abs=1e-9)
    assert last.value == pytest.approx(float(np.ravel(history.displacement())[-1]), rel=1e-6)


@pytest.mark.slow
def test_a_history_that_begins_and_ends_in_contact(oscillator):
    body = Body(
        oscillator(frequency=10.0, damping_ratio=0.01, stiffness=1e4, damping=1.0, gap=0.01)
    )
    state = (jnp.asarray([0.012]), jnp.zeros(1))
    settings = {"initial_state": state, "samples": 500, "gradient": "forward"}
    contacts = vj.simulate(body, duration=1.0, **settings).contacts()
    assert np.isnan(contacts.touch[0])
    assert np.isfinite(contacts.departure[0])
    assert np.isnan(contacts.duration[0])
    assert np.isnan(contacts.restitution[0])
    assert np.isfinite(contacts.touch[1:]).all()
    # Up to its deepest point only: it began there and is over there.
    middle = float(contacts.touch[1]) + 5e-3
    short = vj.simulate(body, duration=middle, **settings).contacts()
    assert np.isnan(short.departure[-1])
    assert short.touch[-1] == pytest.approx(contacts.touch[1], abs=1e-9)
    assert 0 < short.energy_lost[-1] < contacts.energy_lost[1]


def test_the_table_reads_well():
    contacts = released({"c1": 10.0, "x0": 0.01}).contacts()
    assert isinstance(contacts, vj.history.Contacts)
    text = repr(contacts)
    assert text.startswith("Contacts(6)")
    assert "restitution" in text
    data = contacts.to_xarray()
    assert data["peak_force"].attrs["units"] == "N"
    assert all(data[name].attrs["long_name"] for name in data)
    assert set(contacts.stop) == {1}
    none = released({"c1": 10.0, "x0": 0.004}).contacts()
    assert repr(none) == "Contacts(0)"
    assert none.to_xarray().sizes["contact"] == 0


def test_new_values_compile_nothing():
    released({"c1": 10.0, "x0": 0.01}).contacts()
    compiled = (exact_pieces._first_event, exact_cells._measure_batch)
    before = [len(function.programs) for function in compiled]
    history = released({"c1": 11.0, "x0": 0.009})
    history.contacts()
    history.energy()
    assert [len(function.programs) for function in compiled] == before


def test_refusals(oscillator):
    history = released({"c1": 10.0, "x0": 0.01})
    with pytest.raises(ValueError, match=r"Did you mean|one of"):
        history.peak("force")
    with pytest.raises(ValueError, match="start must be at most"):
        history.peak(start=2.0)
    with pytest.raises(ValueError, match="position must be one number"):
        history.peak(position=np.array([0.5, 1.0]))
    lanes = jax.tree.map(lambda a: jnp.stack([a, a]) if eqx.is_array(a) else a, history)
    for ask in ("contacts", "peak", "energy"):
        with pytest.raises(ValueError, match="Take one"):
            getattr(lanes, ask)()
        with pytest.raises(ValueError, match="outside jit"):
            eqx.filter_jit(lambda h, ask=ask: getattr(h, ask)())(history)
        failed = eqx.tree_at(lambda h: h.status, history, jnp.asarray(vj.Status.diverged.value))
        with pytest.raises(ValueError, match="diverged"):
            getattr(failed, ask)()
    coarse = released({"c1": 10.0, "x0": 0.01}, samples_per_period=2)
    coarse = eqx.tree_at(lambda h: h.time, coarse, 10 * coarse.time)
    with pytest.raises(ValueError, match="sample finer"):
        coarse.contacts()
    coupled = eqx.tree_at(
        lambda e: e.damping_coupling,
        oscillator(),
        jnp.ones((1, 1)),
        is_leaf=lambda leaf: leaf is None,
    )
    law = vj.Hertz(1e3)
    stop = eqx.tree_at(lambda s: s.law, coupled.stops[0], law)
    coupled = eqx.tree_at(lambda e: e.stops, coupled, (stop,))
    moved = replace(history.motion, equations=coupled, prepared=None)
    with pytest.raises(ValueError, match="modes are coupled"):
        replace(history, motion=moved).contacts()
