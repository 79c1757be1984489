"""Bodies that nothing holds and forces that stay the same, against closed forms and scipy."""

from math import exp, pi, sqrt

import event_driven
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj

MASS, STIFFNESS, DAMPING, GAP, SPEED = 0.4, 2e4, 30.0, 1e-3, 0.5
LAW = vj.KelvinVoigt(STIFFNESS, DAMPING)
GRAVITY = 9.81


def ball(stiffness=STIFFNESS, damping=DAMPING, mass=MASS, **given):
    """A mass without a spring in front of a stop."""
    stop = vj.Stop(None, GAP, vj.KelvinVoigt(stiffness, damping))
    return vj.model.Oscillator(mass, stops=stop, **given)


def thrown(system, speed=SPEED, duration=0.05, samples=16, **given):
    start = system.state(velocity=speed)
    return vj.simulate(system, initial_state=start, duration=duration, samples=samples, **given)


def bounce(stiffness=STIFFNESS, damping=DAMPING, mass=MASS):
    """Restitution and duration of a contact with a stop that pulls, if nothing else acts."""
    ratio = damping / (2 * sqrt(stiffness * mass))
    root = sqrt(1 - ratio**2)
    return exp(-pi * ratio / root), pi / (sqrt(stiffness / mass) * root)


def test_a_mass_comes_back_from_a_stop_by_the_closed_form():
    history = thrown(ball())
    restitution, duration = bounce()
    contacts = history.contacts()
    assert len(contacts) == 1
    np.testing.assert_allclose(contacts.touch, GAP / SPEED, rtol=1e-9)
    np.testing.assert_allclose(contacts.duration, duration, rtol=1e-6)
    np.testing.assert_allclose(contacts.restitution, restitution, rtol=1e-6)
    # Of the samples, which are marched to without a spring.
    np.testing.assert_allclose(history.states[-1, 1], -restitution * SPEED, rtol=1e-9)
    wanted = GAP - restitution * SPEED * (0.05 - GAP / SPEED - duration)
    np.testing.assert_allclose(history.states[-1, 0], wanted, rtol=1e-9)
    energy = history.energy()
    assert np.max(np.abs(energy.balance)) < 1e-7
    lost = MASS * SPEED**2 / 2 * (1 - restitution**2)
    np.testing.assert_allclose(energy.contact_loss[-1], lost, rtol=1e-6)


def test_without_loss_a_ball_comes_back_to_where_it_fell_from():
    fall, rate = sqrt(2 * GAP / GRAVITY), sqrt(STIFFNESS / MASS)
    touching = 2 * (pi - np.arctan(GRAVITY * fall * rate / GRAVITY)) / rate
    history = vj.simulate(
        ball(damping=0.0, force=MASS * GRAVITY), duration=2 * fall + touching, samples=16
    )
    contacts = history.contacts()
    np.testing.assert_allclose(contacts.touch, fall, rtol=1e-8)
    np.testing.assert_allclose(contacts.duration, touching, rtol=1e-6)
    np.testing.assert_allclose(history.states[-1, 0], 0.0, atol=1e-9 * GAP)
    np.testing.assert_allclose(history.states[-1, 1], 0.0, atol=1e-9 * GRAVITY * fall)


def by_scipy(start, end, *, force=0.0, amplitude=0.0, rate=0.0):
    """State of the ball, changes of contact."""

    def rates(time, state, touching):
        push = STIFFNESS * (state[0] - GAP) + DAMPING * state[1] if touching else 0.0
        shaken = amplitude * rate**2 * np.sin(rate * time)
        return np.array([state[1], (force - push) / MASS + shaken])

    state, changes, _ = event_driven.integrate(rates, lambda x: x[0] - GAP, start, end)
    return state, changes


def contact_times(history):
    contacts = history.contacts()
    times = np.stack([contacts.touch, contacts.departure], axis=1).ravel()
    return times[np.isfinite(times)]


@pytest.mark.slow
def test_a_falling_ball_bounces_as_by_scipy_and_gravity_works():
    weight, duration = MASS * GRAVITY, 0.1
    history = vj.simulate(ball(force=weight), duration=duration, samples=16)
    state, changes = by_scipy([0.0, 0.0], duration, force=weight)
    assert len(changes) == 3
    np.testing.assert_allclose(history.states[-1], state, rtol=1e-9)
    np.testing.assert_allclose(contact_times(history), changes, rtol=1e-7)
    # How high it comes back, read by scipy at the moment it turns.
    highest = changes[1] + history.contacts().departure_speed[0] / GRAVITY
    top, _ = by_scipy([0.0, 0.0], highest, force=weight)
    back = vj.simulate(ball(force=weight), duration=highest, samples=16)
    np.testing.assert_allclose(back.states[-1, 0], top[0], rtol=1e-9)
    energy = history.energy()
    np.testing.assert_allclose(energy.input_work, weight * history.states[:, 0], atol=1e-9)
    assert np.max(np.abs(energy.balance)) < 1e-7


def test_a_free_body_on_a_base_that_vibrates():
    amplitude, frequency, duration = 1e-3, 20.0, 0.2
    given = {"amplitude": amplitude, "rate": 2 * pi * frequency, "force": 2.0}
    history = vj.simulate(
        ball(drive=vj.BaseMotion(amplitude), force=2.0),
        frequency=frequency,
        duration=duration,
        samples=64,
    )
    state, changes = by_scipy([0.0, 0.0], duration, **given)
    assert len(changes) > 2
    np.testing.assert_allclose(history.states[-1], state, rtol=1e-9)
    np.testing.assert_allclose(contact_times(history), changes, rtol=1e-6)
    assert np.max(np.abs(history.energy().balance)) < 1e-4


def dumbbell(free_modes=1, spring=900.0, damping=0.3, **given):
    """Two masses with a spring between them, the second in front of the stop."""
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    return vj.MatrixSystem(
        MASS * np.eye(2),
        damping * pair,
        spring * pair,
        free_modes=free_modes,
        stops=vj.Stop(None, GAP, LAW),
        stop_map=[[0.0, 1.0]],
        response_map=[1.0, 0.0],
        **given,
    )


def test_two_masses_that_nothing_holds():
    system, duration = dumbbell(), 0.08

    def rates(time, state, touching):
        x, v = state[:2], state[2:]
        pull = 900.0 * (x[1] - x[0]) + 0.3 * (v[1] - v[0])
        push = STIFFNESS * (x[1] - GAP) + DAMPING * v[1] if touching else 0.0
        return np.array([*v, pull / MASS, (-pull - push) / MASS])

    start = [0.0, 0.0, 0.5, 0.3]
    state, changes, _ = event_driven.integrate(rates, lambda x: x[1] - GAP, start, duration)
    assert len(changes) >= 4
    begin = system.state(velocity=start[2:])
    history = vj.simulate(system, initial_state=begin, duration=duration, samples=32)
    shapes = np.asarray(system.modes().shapes)
    for part, wanted in ((slice(2), state[:2]), (slice(2, 4), state[2:])):
        found = shapes @ np.asarray(history.states[-1, part])
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(contact_times(history), changes, rtol=1e-6)
    momentum = MASS * np.sum(shapes @ np.asarray(history.states[:, 2:]).T, axis=0)
    impulse = np.sum(history.contacts().impulse)
    np.testing.assert_allclose(momentum[0] - momentum[-1], impulse, rtol=1e-6)
    assert np.max(np.abs(history.energy().balance)) < 1e-6


def test_two_free_bodies_that_meet():
    first, second = vj.model.Oscillator(0.4), vj.model.Oscillator(0.6)
    pair = vj.Joined(first, second, vj.Stop(None, GAP, LAW))
    begin = pair.state(velocity=(0.5, 0.2))
    history = vj.simulate(pair, initial_state=begin, duration=0.05, samples=16)
    restitution, duration = bounce(mass=0.4 * 0.6)  # over their sum, 1 kg
    v = np.asarray(history.states[-1, 2:])
    np.testing.assert_allclose(0.4 * v[0] + 0.6 * v[1], 0.4 * 0.5 + 0.6 * 0.2, rtol=1e-12)
    np.testing.assert_allclose(v[1] - v[0], restitution * 0.3, rtol=1e-9)
    np.testing.assert_allclose(history.contacts().duration, duration, rtol=1e-6)
    np.testing.assert_allclose(history.contacts().touch, GAP / 0.3, rtol=1e-9)


@pytest.mark.parametrize("gradient", ["forward", "reverse"])
def test_derivatives_of_the_velocity_after_the_bounce(gradient):
    def found(stiffness, damping):
        return thrown(ball(stiffness, damping), gradient=gradient).states[-1, 1]

    def expected(stiffness, damping):
        ratio = damping / (2 * jnp.sqrt(stiffness * MASS))
        return -SPEED * jnp.exp(-jnp.pi * ratio / jnp.sqrt(1 - ratio**2))

    take = jax.jacfwd if gradient == "forward" else jax.jacrev
    slopes = [np.array(take(f, (0, 1))(STIFFNESS, DAMPING)) for f in (found, expected)]
    np.testing.assert_allclose(slopes[0], slopes[1], rtol=1e-8)


STIFF, MASSES = np.array([[3e3, -1e3], [-1e3, 1e3]]), np.diag([0.5, 0.4])
LOAD = np.array([0.0, 0.8])
SAG = np.linalg.solve(STIFF, LOAD)
"""Where the pair rests under the load, m."""


def pair(gap=2e-3, load=None):
    """Two masses on springs, shaken, the second in front of the stop."""
    return vj.MatrixSystem(
        MASSES,
        1e-3 * STIFF,
        STIFF,
        stops=vj.Stop(None, gap, LAW),
        stop_map=[[0.0, 1.0]],
        response_map=[0.0, 1.0],
        drive=vj.BaseMotion(2e-4),
        input_map=np.diag(MASSES),
        load=load,
    )


def loaded_and_moved():
    """The pair under a load, and the same without it but with a gap that is as much smaller."""
    return pair(load=LOAD), pair(2e-3 - SAG[1])


@pytest.mark.slow
@pytest.mark.parametrize("method", [None, vj.HarmonicBalance()])
def test_a_load_moves_the_gap(method):
    settings = vj.PeriodicSettings(method=method)
    loaded, moved = (
        vj.periodic_response(s, frequency_ratio=1.02, settings=settings) for s in loaded_and_moved()
    )
    assert loaded.contact_force > 0
    for name in ("amplitude_ratio", "contact_force"):
        # The corner that a balance rounds is as wide as the gap says.
        within = 1e-8 if method is None else 2e-4
        np.testing.assert_allclose(getattr(loaded, name), getattr(moved, name), rtol=within)


def test_a_loaded_pair_moves_about_where_it_rests():
    loaded, moved = loaded_and_moved()
    given = {"frequency_ratio": 1.02, "periods": 3, "samples_per_period": 32}
    still = vj.simulate(moved, **given)
    found = vj.simulate(loaded, initial_state=loaded.state(displacement=SAG), **given)
    assert len(found.contacts()) > 1
    size = np.abs(still.displacement()).max()
    away = found.displacement() - SAG[1] - still.displacement()
    np.testing.assert_allclose(away, 0, atol=1e-9 * size)
    np.testing.assert_allclose(contact_times(found), contact_times(still), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.long
def test_gravity_of_a_beam_moves_the_gap():
    beam = vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0)

    def rig(gap, gravity=None):
        stop = vj.Stop(1.0, gap, vj.KelvinVoigt(5500.0, 0.5))
        drive = vj.BaseMotion(2e-4)
        return vj.ImpactingBeam(beam, stop, drive, 0.02, num_modes=3, gravity=gravity)

    # Of a uniform cantilever under its weight, and what three modes have of it.
    weight, flexural = 8250.0 * 0.025 * 1e-3 * GRAVITY, 130e9 * 0.025 * 1e-9 / 12
    whole = weight * 0.2**4 / (8 * flexural)
    equations = rig(1e-3, GRAVITY).equations()
    sag = float(equations.stop_map[0] @ (equations.load / equations.angular_frequency**2))
    np.testing.assert_allclose(sag, whole, rtol=1e-3)
    for method in (None, vj.HarmonicBalance()):
        settings = vj.PeriodicSettings(method=method)
        loaded, moved = (
            vj.periodic_response(one, frequency_ratio=1.02, settings=settings)
            for one in (rig(1e-3 + sag, GRAVITY), rig(1e-3))
        )
        assert loaded.contact_force > 0
        # The corner that a balance rounds is as wide as the gap says.
        within = 1e-8 if method is None else 2e-4
        np.testing.assert_allclose(loaded.amplitude_ratio, moved.amplitude_ratio, rtol=within)
        np.testing.assert_allclose(loaded.contact_force, moved.contact_force, rtol=within)


@pytest.mark.slow
def test_a_sweep_of_a_bouncing_mass():
    # On a soft stop it rests inside: linear, at the amplification of a mass on that spring.
    weight, amplitude = MASS * GRAVITY, 1e-5
    soft = ball(2e3, 5.0, force=weight, drive=vj.BaseMotion(amplitude))
    sweep = vj.frequency_sweep(soft, frequency=[15.0, 18.0, 21.0])
    rate = 2 * pi * np.array([15.0, 18.0, 21.0])
    expected = np.abs(MASS * rate**2 / (2e3 - MASS * rate**2 + 5j * rate))
    found = np.squeeze(sweep.amplitude_ratio)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=1e-3)
    # Shaken harder than it weighs it leaves the stop.
    hard = ball(2e3, 5.0, force=weight, drive=vj.BaseMotion(1.5e-3))
    sweep = vj.frequency_sweep(hard, frequency=[15.0, 18.0, 21.0])
    assert (sweep.contact_fraction[sweep.period > 0] < 1).any()


REFUSED = [
    (lambda: dumbbell(free_modes=0), "stiffness must be positive definite"),
    (lambda: dumbbell(free_modes=2), "free_modes must be"),
    (lambda: dumbbell(free_modes=3), "free_modes must be"),
    (lambda: dumbbell(spring=0.0), "free_modes must be"),
    (lambda: dumbbell(load=[1.0]), "load must be one number per coordinate"),
    (lambda: ball(force=float("nan")), "force must be a finite force"),
    (lambda: dumbbell(static_correction=True), "static_correction must be False"),
]


@pytest.mark.parametrize(("wrong", "words"), REFUSED)
def test_refusals(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()
