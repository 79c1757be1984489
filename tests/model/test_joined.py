"""Two bodies that meet, against an event-driven integration by scipy that is written here.

The bodies of the reference are uniform cantilevers in their first mode, known in closed form, and
masses on springs.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import vibrojax as vj

WIDTH, THICKNESS, MODULUS, DENSITY = 0.025, 1e-3, 130e9, 8250.0
STIFFNESS, DAMPING, GAP = 1000.0, 2.0, 1e-3
LAW = vj.KelvinVoigt(STIFFNESS, DAMPING)
FORCE, PLACE = 0.05, 0.8
BETA = 1.8751040687119611
"""First root of cos(b) cosh(b) = -1."""


def cantilever(length, drive=None, modes=1, stops=()):
    beam = vj.Cantilever(length, WIDTH, THICKNESS, MODULUS, DENSITY)
    return vj.ImpactingBeam(beam, stops, drive or vj.NoDrive(), 0.02, num_modes=modes)


def beams(gap=GAP, lengths=(0.2, 0.19), drive=None, stops=(), others=()):
    """Two cantilevers side by side, the tip of the first beside a place of the second."""
    first = cantilever(lengths[0], drive or vj.PointForce(FORCE), stops=stops)
    second = cantilever(lengths[1], stops=others)
    return vj.Joined(first, second, vj.Stop(1.0, gap, LAW), second_position=PLACE)


def on_a_spring(mass=0.02, stiffness=800.0, gap=GAP, drive=None):
    """A cantilever and a stop that has a mass."""
    stop = vj.Stop(1.0, gap, LAW)
    first = cantilever(0.2, drive or vj.PointForce(FORCE))
    return vj.Joined(first, vj.model.Oscillator(mass, stiffness, 0.3), stop)


class Pair(NamedTuple):
    """Numbers of two masses with a Kelvin-Voigt stop between them, the force on the first."""

    mass: np.ndarray
    rate: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    """Of the first and the second, at the stop."""
    pushed: float
    """Shape of the first at the force."""

    def field(self, w, touching):
        def rates(t, y):
            q, v = y[:2], y[2:]
            towards = self.shape * [1, -1]
            push = STIFFNESS * (towards @ q - GAP) + DAMPING * (towards @ v) if touching else 0.0
            force = -push * towards + [self.pushed * FORCE * np.sin(w * t), 0]
            own = -2 * self.damping_ratio * self.rate * v - self.rate**2 * q
            return np.concatenate([v, own + force / self.mass])

        return rates

    def integrate(self, w, state, end, times):
        """States at times, and the largest force, from one change of contact to the next."""
        towards = self.shape * [1, -1]
        start, touching, rows, largest = 0.0, towards @ state[:2] > GAP, [], 0.0
        while start < end:

            def depth(t, y):
                return towards @ y[:2] - GAP

            depth.terminal, depth.direction = True, -1 if touching else 1
            run = solve_ivp(
                self.field(w, touching),
                (start, end),
                state,
                method="DOP853",
                rtol=1e-12,
                max_step=0.004 / w,  # one flight lasts 80 microseconds
                atol=1e-14,
                events=depth,
                dense_output=True,
            )
            inside = (times >= start) & (times <= run.t[-1])
            rows.append(run.sol(times[inside]).T)
            if touching:
                y = run.sol(np.linspace(start, run.t[-1], 20001))
                along = STIFFNESS * (towards @ y[:2] - GAP) + DAMPING * (towards @ y[2:])
                largest = max(largest, along.max())
            start, state = run.t[-1], run.y[:, -1]
            touching = not touching
        return np.concatenate(rows), state, largest


def first_mode(length):
    """Mass, angular frequency, and shape function of the first mode of a clamped-free beam."""
    mass = DENSITY * WIDTH * THICKNESS * length
    inertia = WIDTH * THICKNESS**3 / 12
    rate = BETA**2 * np.sqrt(MODULUS * inertia / (mass * length**3))
    ratio = (np.cosh(BETA) + np.cos(BETA)) / (np.sinh(BETA) + np.sin(BETA))

    def shape(s):
        b = BETA * s
        return np.cosh(b) - np.cos(b) - ratio * (np.sinh(b) - np.sin(b))

    return mass, rate, shape  # the integral of the square of this shape is 1


def reference(second):
    m1, w1, shape1 = first_mode(0.2)
    if second == "beam":
        m2, w2, shape2 = first_mode(0.19)
        zeta, touched = 0.02, shape2(PLACE)
    else:
        m2, touched = 0.02, 1.0
        w2 = np.sqrt(800.0 / m2)
        zeta = 0.3 / (2 * m2 * w2)
    numbers = [m1, m2], [w1, w2], [0.02, zeta], [shape1(1.0), touched]
    return Pair(*map(np.array, numbers), pushed=shape1(1.0))


SYSTEMS = {"beam": beams, "mass": on_a_spring}


def in_units_of(reference, system, q):
    """Coordinates of the reference, by tips: its shapes may have another length."""
    maps = np.abs(np.asarray(system.equations().stop_map[0]))
    return np.asarray(q) * maps / np.abs(reference.shape)


@pytest.mark.slow
@pytest.mark.parametrize("second", ["mass", "beam"])
def test_start_up_agrees_with_scipy(second):
    system, other = SYSTEMS[second](), reference(second)
    periods, ratio = 4, 0.98
    w = ratio * other.rate[0]
    times = np.linspace(0.0, periods * 2 * np.pi / w, 257)
    rows, _, largest = other.integrate(w, np.zeros(4), times[-1], times)
    history = vj.simulate(system, frequency_ratio=ratio, periods=periods, samples_per_period=64)
    assert len(history.contacts()) >= 2
    q = in_units_of(other, system, history.coordinates)
    np.testing.assert_allclose(q, rows[:, :2], rtol=0, atol=1e-9 * abs(rows[:, :2]).max())
    np.testing.assert_allclose(history.peak("contact_force").value, largest, rtol=1e-6)
    # The first reports its tip, the second where the force pushes it.
    tip = rows[:, 0] * other.pushed
    np.testing.assert_allclose(history.displacement(), tip, rtol=0, atol=1e-9 * abs(tip).max())
    np.testing.assert_allclose(history.displacement(1.0), history.displacement(), rtol=1e-12)
    seen = history.quantity("second_displacement")
    reported = first_mode(0.19)[2](1.0) if second == "beam" else 1.0
    np.testing.assert_allclose(
        seen, rows[:, 1] * reported, rtol=0, atol=1e-9 * abs(rows[:, 1]).max()
    )


def steady(other, system, state, ratio):
    """Half of peak to peak (m) over the force, and largest force, after one period by scipy."""
    w = ratio * other.rate[0]
    state = np.asarray(state)
    state = np.concatenate([in_units_of(other, system, part) for part in (state[:2], state[2:])])
    times = np.linspace(0.0, 2 * np.pi / w, 40001)
    rows, end, largest = other.integrate(w, state, times[-1], times)
    np.testing.assert_allclose(end, state, rtol=0, atol=1e-9 * abs(state).max())
    return np.ptp(rows[:, 0]) / 2 * other.pushed / FORCE, largest


@pytest.mark.slow
@pytest.mark.parametrize("second", ["beam", "mass"])
def test_periodic_responses_agree_with_scipy(second):
    system, other, ratio = SYSTEMS[second](), reference(second), 0.98
    response = vj.periodic_response(system, frequency_ratio=ratio)
    amplitude, largest = steady(other, system, response.initial_state, ratio)
    np.testing.assert_allclose(response.amplitude_ratio, amplitude, rtol=1e-7)
    np.testing.assert_allclose(response.contact_force, largest, rtol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("second", ["beam", "mass"])
def test_sweeps_and_branches_agree_with_scipy(second):
    system, other, ratio = SYSTEMS[second](), reference(second), 0.98
    settings = vj.SweepSettings(tolerance=1e-8)
    sweep = vj.frequency_sweep(system, frequency_ratio=[0.97, ratio], settings=settings)
    response = vj.periodic_response(system, frequency_ratio=ratio)
    amplitude, _ = steady(other, system, response.initial_state, ratio)
    np.testing.assert_allclose(sweep.amplitude_ratio[..., -1].max(), amplitude, rtol=1e-6)
    branch = vj.continue_response(system, frequency_ratio=vj.Range(0.9, 1.0))
    assert branch.exact
    point = int(np.argmax(branch.contact_force))
    amplitude, largest = steady(other, system, branch.initial_state[point], branch.values[point])
    np.testing.assert_allclose(branch.amplitude_ratio[point], amplitude, rtol=1e-7)
    np.testing.assert_allclose(branch.contact_force[point], largest, rtol=1e-7)


@pytest.mark.slow
def test_derivatives_of_two_equal_beams():
    # Equal bodies have equal natural frequencies: in flight all pairs of eigenvalues come twice.
    def amplitude(gap):
        pair = beams(gap, lengths=(0.2, 0.2))
        return vj.periodic_response(pair, frequency_ratio=0.98).amplitude_ratio

    step = 1e-7
    difference = (amplitude(GAP + step) - amplitude(GAP - step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(amplitude)(GAP), difference, rtol=1e-6)


@pytest.mark.slow
def test_a_heavy_stiff_second_body_is_a_fixed_stop():
    drive = vj.PointForce(FORCE)
    fixed = cantilever(0.2, drive, stops=vj.Stop(1.0, GAP, LAW))
    held = on_a_spring(1e3, 1e10)
    for ratio in (0.98, 1.02):
        given = {"frequency_ratio": ratio}
        one, two = (vj.periodic_response(system, **given) for system in (fixed, held))
        assert one.contact_force > 0
        for name in ("amplitude_ratio", "contact_force"):
            expected = getattr(one, name)
            np.testing.assert_allclose(getattr(two, name), expected, rtol=1e-6, err_msg=name)


@pytest.mark.slow
def test_bodies_that_do_not_meet_move_as_each_alone():
    drive, ratio = vj.BaseMotion(2e-4), 0.9
    apart = beams(gap=1.0, drive=drive)
    settings = {"periods": 3, "samples_per_period": 32}
    both = vj.simulate(apart, frequency_ratio=ratio, **settings)
    first = vj.simulate(cantilever(0.2, drive), frequency_ratio=ratio, **settings)
    # The base moves the second too, though the drive is the first one's.
    second = vj.simulate(
        cantilever(0.19, drive), frequency=first.motion.waveform.frequency, **settings
    )
    np.testing.assert_allclose(both.displacement(), first.displacement(), atol=1e-15)
    np.testing.assert_allclose(
        both.quantity("second_displacement"), second.displacement(), atol=1e-15
    )


@pytest.mark.slow
def test_the_numbers_of_either_body_are_axes():
    masses, settings = [0.01, 0.02, 0.04], vj.SweepSettings(direction="forward")
    sweep = vj.frequency_sweep(on_a_spring, frequency_ratio=0.98, mass=masses, settings=settings)
    assert dict(sweep.to_xarray().sizes)["mass"] == 3
    for k, mass in enumerate(masses):
        one = vj.periodic_response(on_a_spring(mass), frequency_ratio=0.98)
        np.testing.assert_allclose(
            np.ravel(sweep.amplitude_ratio)[k], one.amplitude_ratio, rtol=1e-3
        )
    found = vj.parameter_map(
        on_a_spring,
        frequency_ratio=[0.97, 0.98],
        mass=masses,
        stiffness=[400.0, 800.0],
        response=settings,
    )
    last = found["peak_amplitude_ratio"].sel(stiffness=800.0).values
    assert last.shape == (3,)
    assert np.all(last >= np.ravel(sweep.amplitude_ratio) * (1 - 1e-3))


CHAIN = [(1.0, 100.0, 0.3), (2.0, 500.0, 0.5), (0.5, 70.0, 0.2)]
"""Mass, stiffness and damping of three oscillators; none of their frequencies are equal."""


def oscillators(drive=None):
    drives = (drive or vj.NoDrive(), vj.NoDrive(), vj.NoDrive())
    return [
        vj.model.Oscillator(*numbers, stops=vj.Stop(None, 2e-3 * (k + 1), LAW), drive=one)
        for k, (numbers, one) in enumerate(zip(CHAIN, drives, strict=True))
    ]


def chain(drive):
    """A stop of its own for each, the first between the others."""
    first, second, third = oscillators(drive)
    pair = vj.Joined(first, second, vj.Stop(None, 1e-3, LAW))
    return vj.Joined(pair, third, vj.Stop(None, 3e-3, LAW, side=-1))


def chain_of_matrices(drive):
    """The same as matrices, in the same order of coordinates and stops."""
    mass, stiffness, damping = map(np.diag, zip(*CHAIN, strict=True))
    gaps = [3e-3, 6e-3, 1e-3, 4e-3, 2e-3]
    sides = [-1, 1, 1, 1, 1]
    return vj.MatrixSystem(
        mass,
        damping,
        stiffness,
        stops=tuple(
            vj.Stop(None, gap, LAW, side=side) for gap, side in zip(gaps, sides, strict=True)
        ),
        stop_map=[[1, 0, -1], [0, 0, 1], [1, -1, 0], [0, 1, 0], [1, 0, 0]],
        drive=drive,
        input_map=[1, 0, 0] if isinstance(drive, vj.PointForce) else np.diagonal(mass),
        response_map=[1, 0, 0],
    )


@pytest.mark.parametrize("drive", [vj.PointForce(1.0), vj.BaseMotion(1e-3)])
def test_three_bodies_are_what_their_matrices_say(drive):
    joined, matrices = chain(drive), chain_of_matrices(drive)
    shapes = np.asarray(matrices.modes().shapes)
    one, two = joined.equations(), matrices.equations()
    assert [float(s.gap) for s in one.stops] == [float(s.gap) for s in two.stops]
    assert [s.law for s in one.stops] == [s.law for s in joined.stops]
    x, v = jnp.array([5e-3, 2e-3, 9e-3]), jnp.array([0.1, -0.2, 0.3])
    q, rate = (matrices.modal_coordinates(part) for part in (x, v))
    np.testing.assert_allclose(one.penetration(x), two.penetration(q), atol=1e-15)
    accelerations = one.acceleration(x, v, 0.7)
    expected = shapes @ np.asarray(two.acceleration(q, rate, 0.7))
    np.testing.assert_allclose(accelerations, expected, rtol=1e-11)
    np.testing.assert_allclose(one.response(x), 5e-3)
    # Body 1 against body 3: both give way to a sudden force.
    np.testing.assert_allclose(joined.mass_at(1), 1 / (1 / 1.0 + 1 / 0.5), rtol=1e-12)


def test_matrices_are_placed_by_rows():
    stop = vj.Stop(None, GAP, LAW)
    mass, stiffness, damping = CHAIN[0]
    matrices = vj.MatrixSystem([[mass]], [[damping]], [[stiffness]], response_map=[1.0])
    drive = vj.PointForce(1.0)
    first = vj.model.Oscillator(2.0, 30.0, 0.1, drive=drive)
    one = vj.Joined(first, vj.model.Oscillator(*CHAIN[0]), stop).equations()
    two = vj.Joined(first, matrices, stop, second_map=[[np.sqrt(mass)]]).equations()
    q, rate = jnp.array([5e-3, -2e-3]), jnp.array([0.1, 0.2])
    expected = one.acceleration(q, rate, 0.5)
    np.testing.assert_allclose(two.acceleration(q, rate, 0.5), expected, rtol=1e-12)
    with pytest.raises(ValueError, match=r"second_map.* of shape \(1, 1\)"):
        vj.Joined(first, matrices, stop)


def test_states_places_and_what_modes_leave_out():
    first = cantilever(0.2, vj.PointForce(FORCE), modes=2, stops=vj.Stop(0.5, GAP, LAW))
    second = cantilever(0.19, modes=2)
    pair = vj.Joined(first, second, [vj.Stop(1.0, GAP, LAW), vj.Stop(0.7, GAP, LAW, side=-1)])
    state = pair.state((None, {0.5: 1e-3, 1.0: 3e-3}), velocity=({0.5: 0.1, 1: 0.3}, None))
    q, rate = np.asarray(state[:4]), np.asarray(state[4:])
    assert np.all(q[:2] == 0)
    assert np.all(rate[2:] == 0)
    np.testing.assert_allclose(pair.shape_at(0.5) @ rate, 0.1, rtol=1e-12)
    np.testing.assert_allclose(second.shape_at(1.0) @ q[2:], 3e-3, rtol=1e-12)
    np.testing.assert_allclose(pair.shape_at(1.0) @ pair.static_shape(2e-3), 2e-3, rtol=1e-12)
    left_out = pair.flexibility_left_out()
    own = [
        cantilever(length, modes=2, stops=vj.Stop(place, GAP, LAW)).flexibility_left_out()[0]
        for length, place in [(0.2, 1.0), (0.19, 1.0), (0.2, 0.7), (0.2, 0.5)]
    ]
    np.testing.assert_allclose(left_out, [own[0] + own[1], own[2] + own[1], own[3]], rtol=1e-12)
    # A third body below the first, while the places are traced.
    third = vj.Joined(pair, vj.model.Oscillator(0.1, 10.0), vj.Stop(0.5, GAP, LAW, side=-1))
    shape, modal = first.shape_at(0.5), first.modes().modal_mass
    np.testing.assert_allclose(third.mass_at(), 1 / (jnp.sum(shape**2 / modal) + 10), rtol=1e-12)
    on_mass = vj.Joined(first, vj.model.Oscillator(0.1, 10.0), vj.Stop(1.0, GAP, LAW))
    np.testing.assert_allclose(on_mass.flexibility_left_out(), [own[0], own[3]], rtol=1e-12)
    assert on_mass.state((None, 2e-3))[2] == 2e-3


BEAM, MASS = cantilever(0.2, vj.BaseMotion(1e-4)), vj.model.Oscillator(1.0, 100.0)
STOP = vj.Stop(1.0, GAP, LAW)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: vj.Joined(BEAM, MASS, ()), "between must hold at least one Stop"),
        (lambda: vj.Joined(BEAM, BEAM, STOP), "drive must be that of one body"),
        (lambda: vj.Joined(BEAM, MASS, STOP, second_position=0.5), "second_position must be None"),
        (lambda: vj.Joined(BEAM, MASS, vj.Stop(None, GAP, LAW)), "position must be above 0"),
        (lambda: vj.Joined(MASS, BEAM, STOP), "position must be None for a Stop of an Oscillator"),
        (
            lambda: vj.Joined(BEAM, cantilever(0.1), STOP, second_position=[0.5, 0.6]),
            "one for each of the 1",
        ),
        (
            lambda: vj.Joined(BEAM, cantilever(0.1), STOP, second_position=1.5),
            "second_position must be above 0",
        ),
        (
            lambda: vj.Joined(BEAM, cantilever(0.1), STOP, first_map=[[1.0]]),
            "first_map and second_map are for bodies without places",
        ),
        (lambda: vj.Joined(cantilever(0.1), vj.default_pendulum(), STOP), "takes no further stops"),
        (
            lambda: vj.Joined(
                BEAM,
                vj.MatrixSystem([[1.0]], [[1.0]], [[1.0]], response_map=[1.0]),
                STOP,
                second_map=[[1.0]],
            ),
            "input_map of the second body must be given",
        ),
        (lambda: vj.Joined(BEAM, MASS, STOP).state(1e-3), "displacement must be a tuple of two"),
        (lambda: vj.model.Oscillator(0.0, 1.0), "mass must be above 0 kg"),
        (lambda: vj.model.Oscillator(1.0, 0.0), "stiffness must be above 0 N/m"),
    ],
)
def test_refusals(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()
