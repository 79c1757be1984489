import json
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shown import check_result

import vibrojax as vj
from vibrojax.model.systems import as_arrays, equations_of
from vibrojax.steady.contact_times import Orbit, follow_events
from vibrojax.steady.orbit_reading import state_in
from vibrojax.steady.single_contact import (
    check_single_stop,
    laid_out,
    read_single_contact,
    single_contact,
    unit_phases,
    unit_tables,
)
from vibrojax.steady.single_contact_surface import evaluate

DATA = Path(__file__).parents[1] / "data"
PARAMETERS = {
    name: case["parameters"]
    for name, case in json.loads((DATA / "sweeps.json").read_text())["cases"].items()
}
REFERENCE = json.loads((DATA / "single_contact.json").read_text())["cases"]
VIRTUAL = "C_fig7_MR1.5_mu0"
"""Its jump up is a fold of a motion with two contacts."""


def named_rig(rig, name):
    p = PARAMETERS[name]
    return rig(
        taper=p["mu"],
        mass_ratio=p["mr"],
        gap=p["lam"],
        position=p["s1"],
        formulation=p["variant"],
        num_modes=p["n_modes"],
    )


@pytest.fixture(scope="module")
def lanes(rig):
    """Equations and unit phases of every reference rig."""
    found = {}
    for name in REFERENCE:
        system = as_arrays(named_rig(rig, name))
        equations = equations_of(system)
        found[name] = system, equations, eqx.filter_jit(unit_phases)(equations)
    return found


def listed(name):
    case = REFERENCE[name]
    return {key: np.array(values) for key, values in case.items() if key != "folds"}


def refined(phases, drive, w, fraction, gap):
    """Contact fractions at which the gap ratio is this one, by Newton's method."""

    def one(w, f):
        tables = unit_tables(phases, drive, w)
        for _ in range(2):
            gap_ratio = lambda f: single_contact(tables, f).gap_ratio  # noqa: E731
            value, slope = jax.value_and_grad(gap_ratio)(f)
            f = f - (value - gap) / slope
        return f

    return jax.jit(jax.vmap(one))(w, fraction)


@pytest.mark.parametrize("name", REFERENCE)
def test_reference_motions(lanes, name):
    system, equations, phases = lanes[name]
    wanted, gap = listed(name), PARAMETERS[name]["lam"] / 0.2e-3
    w = wanted["ratio"] * float(equations.angular_frequency[0])
    points = evaluate(phases, system.drive, np.stack([wanted["contact_fraction"], w], axis=1))
    assert len(w) > 12
    np.testing.assert_allclose(points.gap_ratio, gap, rtol=1e-10)
    assert points.valid.all()
    np.testing.assert_allclose(points.amplitude, wanted["half_pp_ratio"], rtol=1e-9)
    np.testing.assert_allclose(points.peak, wanted["amp_ratio"], rtol=1e-9)
    np.testing.assert_allclose(points.force * 0.2e-3, wanted["max_contact_force"], rtol=1e-6)
    np.testing.assert_allclose(points.multiplier, wanted["max_multiplier"], atol=1e-9)


@pytest.mark.slow  # to compile
def test_states_and_the_return_under_the_events(lanes):
    name = "C_MR0.5_mu0.5_s1_0.75"
    system, equations, phases = lanes[name]
    wanted, gap = listed(name), PARAMETERS[name]["lam"] / 0.2e-3
    w = wanted["ratio"] * equations.angular_frequency[0]
    fraction = refined(phases, system.drive, w, wanted["contact_fraction"], gap)

    @jax.jit
    @jax.vmap
    def orbit(w, fraction):
        tables = unit_tables(phases, system.drive, w)
        found = single_contact(tables, fraction)
        own, events, motion = laid_out(tables, found)
        begin = state_in(own, motion, 0, events.section)
        again = follow_events(own, events, Orbit(begin, motion.times), 1)
        size = jnp.linalg.norm(phases.weight * begin)
        missed = jnp.linalg.norm(phases.weight * (again.end - begin)) / size
        reading, _ = read_single_contact(tables, found)
        moved = jnp.max(jnp.abs(again.times - motion.times))
        touched = state_in(own, motion, 1, motion.start[1])
        scale = jnp.linalg.norm(phases.weight * found.state)
        apart = jnp.linalg.norm(phases.weight * (touched - found.state)) / scale
        return found.gap_ratio, missed, moved, apart, reading.initial_state

    ratio, missed, moved, apart, state = orbit(w, fraction)
    np.testing.assert_allclose(ratio, gap, rtol=1e-12)
    assert missed.max() < 1e-10
    assert moved.max() < 1e-10
    assert apart.max() < 1e-10
    # The reference normalises its shapes to 1 at the tip.
    tip = np.tile(np.asarray(vj.modes(system.beam, 5).shape(1.0)), 2)
    weight = np.asarray(phases.weight)
    expected = wanted["state0"] / tip / 0.2e-3
    error = np.linalg.norm(weight * (state - expected), axis=1)
    assert (error < 1e-8 * np.linalg.norm(weight * expected, axis=1)).all()


@pytest.mark.slow  # to compile
@pytest.mark.parametrize("name", REFERENCE)
def test_folds_are_the_jumps(rig, lanes, name):
    system, equations, phases = lanes[name]
    first = float(equations.angular_frequency[0])
    wanted = dict(REFERENCE[name]["folds"])
    if name == VIRTUAL:
        ratio, fraction = wanted.pop("jump_up")
        assert not evaluate(phases, system.drive, np.array([fraction, ratio * first])).valid
    ratios = sorted(ratio for ratio, _ in wanted.values())
    grid = np.linspace(ratios[0] - 0.05, ratios[-1] + 0.05, 31)
    response = vj.single_contact_response(named_rig(rig, name), frequency_ratio=grid)
    for ratio in ratios:
        found = response.folds()
        assert found[np.argmin(np.abs(found - ratio))] == pytest.approx(ratio, rel=1e-6)


@pytest.fixture(scope="module")
def response(rig):
    return vj.single_contact_response(rig(), frequency_ratio=np.linspace(1.0, 1.3, 13))


def test_response_on_a_grid(response):
    assert response.gap_ratio.shape == (97, 13)
    assert response.own_gap_ratio == pytest.approx(2.0)
    # A second contact on the way: the reference has two contacts at 1.09 and 1.10.
    assert not response.valid.all()
    assert np.isnan(response.amplitude_ratio[~response.valid]).all()
    assert np.isfinite(response.amplitude_ratio[response.valid]).all()
    assert (response.gap_ratio[response.valid] >= 0).all()
    assert (response.stable <= response.valid).all()
    assert response.stable.any()
    assert (response.valid & ~response.stable).any()
    assert "valid" in repr(response)


def test_short_contacts_end_at_the_touch(lanes, response):
    system, equations, phases = lanes["C_MR0.5_mu0.5"]
    w = response.frequencies * float(equations.angular_frequency[0])
    for fraction in (1e-3, 1e-4, 1e-5):
        places = np.stack([np.full_like(w, fraction), w], axis=1)
        points = evaluate(phases, system.drive, places)
        error = np.abs(points.gap_ratio / response.touch_gap_ratio - 1)
        assert error.max() < 200 * fraction**2 + 1e-12


def test_virtual_motions_are_refused(lanes, response):
    """Where the march finds two contacts, the motion with one is not a motion."""
    system, equations, phases = lanes[VIRTUAL]
    place = np.array([0.05, 1.0947267498 * float(equations.angular_frequency[0])])
    point = evaluate(phases, system.drive, place)
    assert point.gap_ratio == pytest.approx(2.0, rel=1e-6)
    assert not point.valid


def test_folds_on_the_grid(response):
    up, down = (REFERENCE["C_MR0.5_mu0.5"]["folds"][k][0] for k in ("jump_up", "jump_down"))
    np.testing.assert_allclose(response.folds(), [up, down], rtol=1e-6)
    wide = [REFERENCE["C_MR0.5_mu0.5_gap0.8"]["folds"][k][0] for k in ("jump_up", "jump_down")]
    np.testing.assert_allclose(response.folds(4.0), wide, rtol=1e-6)
    assert response.folds(1000.0).shape == (0,)
    with pytest.raises(ValueError, match=r"^gap_ratio must be at least 0"):
        response.folds(-1.0)


def test_dataset(response, tmp_path):
    import xarray

    check_result(response)
    response.save(tmp_path / "map.nc")
    with xarray.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"contact_fraction": 97, "frequency_ratio": 13}
        assert data["gap_ratio"].attrs["units"] == "1"
        assert data["contact_force"].attrs["units"] == "N"
        assert all(data[name].attrs["long_name"] for name in data)


def test_picture(response):
    figure = response.plot([1.0, 2.0])
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "gap / drive 2 (this system)" in labels
    assert {"no contact", "stable", "unstable", "folds"} <= set(labels)
    lines = figure.axes[0].lines
    heights = np.concatenate([np.asarray(line.get_ydata(), float) for line in lines[:-2]])
    assert np.nanmax(heights) < figure.axes[0].get_ylim()[1]


@pytest.mark.slow  # to compile
def test_a_force_and_hertz(rig):
    one = rig()
    forced = vj.ImpactingBeam(
        one.beam, one.stops, vj.PointForce(0.05), damping_ratio=0.018, num_modes=5
    )
    first = float(forced.equations().angular_frequency[0]) / (2 * np.pi)
    two = vj.single_contact_response(
        forced, frequency=[1.1 * first, 1.2 * first], contact_fraction=[0.2]
    )
    assert two.ratio_units == "m/N"
    assert two.to_xarray()["gap_ratio"].attrs["units"] == "m/N"
    # One motion per gap and amplitude: the same force of the stop at twice both is twice as large.
    double = replace(forced, drive=vj.PointForce(0.1))
    other = vj.single_contact_response(
        double, frequency=[1.1 * first, 1.2 * first], contact_fraction=[0.2]
    )
    np.testing.assert_allclose(other.gap_ratio, two.gap_ratio, rtol=1e-12)
    np.testing.assert_allclose(other.contact_force, 2 * two.contact_force, rtol=1e-12)
    with pytest.raises(ValueError, match="at least two frequencies and two contact fractions"):
        two.plot()


def test_systems_without_a_closed_form_are_refused(oscillator):
    def refused(equations, match):
        with pytest.raises(ValueError, match=match):
            check_single_stop(equations)

    one = oscillator()
    assert check_single_stop(one) is one
    refused(oscillator(tension=False), r"got KelvinVoigt with tension=False")
    refused(oscillator(sides=(1, -1)), r"need a system with one stop, got 2")
    refused(replace(one, stops=()), r"need a system with one stop, got 0")
    (stop,) = one.stops
    refused(replace(one, stops=(replace(stop, smoothing=1e-6),)), r"keep the corner .* smoothing")
    assert check_single_stop(replace(one, stops=(replace(stop, smoothing=0.0),)))


def test_wrong_arguments_are_refused(rig):
    one = rig()

    def refused(match, system=one, **settings):
        with pytest.raises(ValueError, match=match):
            vj.single_contact_response(system, **({"frequency_ratio": [1.0, 1.1]} | settings))

    nothing = replace(one, drive=vj.NoDrive())
    refused(r"^Single-contact motions need a drive with an amplitude above 0", nothing)
    refused(r"^contact_fraction must be above 0 and below 1", contact_fraction=[0.0, 0.1])
    refused(r"^contact_fraction must increase", contact_fraction=[0.2, 0.1])
    refused(r"^contact_fraction must be a list", contact_fraction=np.array([[0.2, 0.1]]))
    refused(r"^frequency_ratio must increase", frequency_ratio=[1.1, 1.0])
    refused(r"^Give frequency_ratio or frequency", frequency=[5.0])


def test_oscillators_without_a_force_are_one_mode_that_moves_alone():
    """Else they would have no single-contact motions, and Hertz's law no splitting."""
    stop = vj.Stop(None, 0.5, vj.KelvinVoigt(10.0, 0.1))
    oscillator = vj.model.Oscillator(2.0, 3.0, 0.1, stops=stop, drive=vj.PointForce(0.2))
    assert check_single_stop(equations_of(as_arrays(oscillator))).is_modal
    pulled = replace(oscillator, force=0.1)
    with pytest.raises(ValueError, match="need a system without a constant force"):
        check_single_stop(equations_of(as_arrays(pulled)))
    pair = vj.Joined(vj.model.Oscillator(1.0, 1.0), vj.model.Oscillator(1.0, 2.0), stop)
    assert equations_of(as_arrays(pair)).load is None
