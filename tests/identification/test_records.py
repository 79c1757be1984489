"""Numbers of records, known or fitted: beginnings, gains, offsets, clocks. Windows of impacts."""

import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.identification.history_misfit import HistoryMisfit
from vibrojax.identification.history_motions import start_of
from vibrojax.identification.trial_rigs import Maker
from vibrojax.io import MeasuredHistory

DEVIATION = {"contact_force": 0.05, "velocity": 5e-3}


def cart(stiffness, damping, mass=0.58):
    law = vj.KelvinVoigt(stiffness, damping, tension=False)
    return vj.model.Oscillator(mass, stops=(vj.Stop(None, 0.0, law),))


def record(velocity=0.8, *, late=0.1037, slow=4, **rig):
    """A cart that flies until `late` (s); the velocity is sampled every `slow` samples only."""
    made = cart(**({"stiffness": 82.0, "damping": 0.8} | rig))
    state = made.state(velocity=[velocity])
    fine = vj.simulate(made, initial_state=state, duration=0.5, samples=5000)
    time = 0.01 * np.arange(45)
    force = np.interp(time - late, fine.time, np.sum(fine.contact_force, axis=1), left=0.0)
    speed = np.interp(time - late, fine.time, fine.quantity("velocity"), left=velocity)
    speed[np.arange(45) % slow > 0] = np.nan
    return time, force, speed


def history(time, force, speed=None, **facts):
    channels = {"contact_force": force} | ({} if speed is None else {"velocity": speed})
    facts = {"initial_displacement": 0.0, "initial_velocity": 0.75} | facts
    deviation = {name: DEVIATION[name] for name in channels}
    return MeasuredHistory(time, **channels, deviation=deviation, **facts)


@pytest.mark.slow
def test_a_force_record_of_a_free_body_gives_the_stop_and_the_velocity():
    time, force, _ = record()
    fit = vj.identify(
        cart, history(time, force), dict(stiffness=40.0, damping=2.0, initial_velocity=None)
    )
    assert fit.estimate["stiffness"] == pytest.approx(82.0, rel=1e-3)
    assert fit.estimate["damping"] == pytest.approx(0.8, rel=1e-2)
    assert fit.estimate["initial_velocity"] == pytest.approx(0.8, rel=1e-3)
    assert fit.chi_square < 0.1


@pytest.mark.slow
def test_sensors_are_fitted_on_clocks_of_their_own():
    """With a slow sensor of the velocity, which is late, the mass is known too."""
    time, force, _ = record()
    gone = record(late=0.1037 + 0.012)[2]
    gain = dict(contact_force=-0.9, velocity=1.1)
    measured = history(time, -0.9 * force + 0.3, 1.1 * gone, gain=gain)
    wanted = dict(stiffness=60.0, damping=0.5, mass=0.5, initial_velocity=None)
    sensors = dict(contact_force_offset=None, velocity_delay=None)
    fit = vj.identify(cart, measured, wanted | sensors)
    truth = dict(stiffness=82.0, damping=0.8, mass=0.58, initial_velocity=0.8)
    truth |= dict(contact_force_offset=0.3, velocity_delay=0.012)
    for name, value in truth.items():
        assert fit.estimate[name] == pytest.approx(value, rel=2e-2), name


def misfit(measured, names):
    held = {"stiffness": 82.0, "damping": 0.8, "mass": 0.58}
    return HistoryMisfit(
        Maker(cart, names, {k: v for k, v in held.items() if k not in names}, {}), [measured]
    )


@pytest.mark.slow
def test_derivatives_in_numbers_of_records():
    names = ("stiffness", "initial_displacement", "initial_velocity")
    names += ("contact_force_gain", "contact_force_offset", "velocity_delay")
    time, force, speed = record()
    values = np.array([80.0, -0.013, 0.83, 0.97, 0.02, 0.003])
    target = misfit(history(time, force, speed, align_phase=False), names)
    step = 1e-6
    rows = values + step * np.concatenate([np.eye(len(values)), -np.eye(len(values))])
    residual, _ = target.residuals(rows, np.zeros(len(rows), int), 1.0, precisely=True)
    ahead, behind = np.split(residual, 2)
    expected = ((ahead - behind) / (2 * step)).T
    _, derivative = target.residuals(values[None], np.zeros(1, int), 1.0, precisely=True)
    error = np.abs(derivative[0] - expected).max(axis=0)
    assert (error < 1e-4 * np.abs(expected).max(axis=0)).all()


@pytest.mark.slow
@pytest.mark.long  # laws are compared with several records, too
def test_private_beginnings_of_several_records():
    """Each record has its own velocity; the stop is the same, and blanks need not agree."""
    speeds = {"slow": 0.5, "fast": 1.1}
    measured = []
    for k, (label, velocity) in enumerate(speeds.items()):
        time, force, _ = record(velocity, late=0.1 + 0.003 * k)
        force[5 * k : 5 * k + 2] = np.nan
        measured.append(history(time, force, label=label))
    fit = vj.identify(
        cart,
        measured,
        dict(stiffness=60.0, damping=0.5, initial_velocity=None),
        private=["initial_velocity"],
    )
    for label, velocity in speeds.items():
        assert fit.estimate[f"initial_velocity[{label}]"] == pytest.approx(velocity, rel=1e-3)
    assert fit.estimate["stiffness"] == pytest.approx(82.0, rel=1e-3)


def test_where_motions_begin():
    """Of a beam the tip of its static shape; else as a force at the sensor pulls, a blow moves."""
    rig, begun = vj.default_rig(), jnp.array([-2e-3, 0.3])
    q, v = start_of(rig, rig.equations(), begun)
    np.testing.assert_allclose(q, rig.static_shape(-2e-3))
    np.testing.assert_allclose(v, rig.static_shape(0.3))
    mass, stiffness = np.diag([1.0, 2.0]), np.array([[300.0, -100.0], [-100.0, 100.0]])
    system = vj.MatrixSystem(
        mass, 0 * mass, stiffness, response_map=np.array([0.0, 1.0]), proportional=True
    )
    shapes = system.modes().shapes
    q, v = start_of(system, system.equations(), begun)
    np.testing.assert_allclose(shapes @ v, [0.0, 0.3], atol=1e-12)
    np.testing.assert_allclose(shapes @ q, [-2e-3 / 3, -2e-3], atol=1e-12)


def test_windows_around_impacts():
    time = np.linspace(0.0, 2.0, 401)
    noise = 0.01 * np.random.default_rng(0).standard_normal(401)
    bump = lambda at: np.where(np.abs(time - at) < 0.1, np.cos((time - at) * 5 * np.pi), 0)  # noqa: E731
    force = -0.05 - 5 * bump(0.5) - 3 * bump(1.4) + noise
    force[300] = 4.0  # a spike
    measured = MeasuredHistory(time, contact_force=force, initial_velocity=0.8, label="run")
    found = measured.impacts(margin=0.25)
    assert [one.label for one in found] == ["run, impact 1", "run, impact 2"]
    for one, at in zip(found, (0.5, 1.4), strict=True):
        assert one.window == pytest.approx((at - 0.14, at + 0.14), abs=0.02)
    with pytest.raises(ValueError, match="lower threshold"):
        measured.impacts(threshold=100.0)
    quiet = MeasuredHistory(time, velocity=force, initial_velocity=0.8)
    with pytest.raises(ValueError, match="contact_force, which was not measured"):
        quiet.impacts()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(initial_velocity=0.8, release=1e-3), "Give release or initial_velocity, not both"),
        (dict(initial_velocity=np.inf), "initial_velocity must be .*finite"),
        (
            dict(initial_velocity=1.0, gain=dict(contact_force=0.0)),
            "gain of contact_force must not",
        ),
        (dict(initial_velocity=1.0, offset=dict(velocity=0.1)), "offset: there is no channel"),
        (
            dict(initial_velocity=1.0, delay=dict(contact_force=np.nan)),
            r"delay\[.contact_force.\] must be a finite",
        ),
        (dict(), "the initial_displacement .m. and initial_velocity"),
    ],
)
def test_records_that_are_none(settings, words):
    with pytest.raises(ValueError, match=words):
        MeasuredHistory(np.arange(4.0), contact_force=np.zeros(4), **settings)


def test_a_channel_needs_samples():
    blank = np.array([np.nan, 1.0, np.nan])
    with pytest.raises(ValueError, match="velocity must have at least 2 samples"):
        MeasuredHistory(np.arange(3.0), velocity=blank, initial_velocity=1.0)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("displacement_gain", "displacement_gain is a number of a record, and nothing measured"),
        ("stifness", "Unknown argument 'stifness' of the rig in guess"),
    ],
)
def test_numbers_that_nothing_has(name, words):
    time, force, _ = record()
    with pytest.raises(ValueError, match=words):
        vj.identify(cart, history(time, force), {"stiffness": 80.0, "damping": 1.0, name: 1.0})
