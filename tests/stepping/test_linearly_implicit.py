"""Linearly implicit stepping: against references, other solvers, and as a march."""

import json
from dataclasses import replace
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.stepping.linearly_implicit_step import contact_impulses

REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "pendulum.json").read_text())
PENDULUM = vj.default_pendulum()
LINKS = 17


@pytest.mark.slow
def test_impact_trajectory():
    case = REFERENCE["forced_5p7Hz"]
    history = vj.simulate(
        PENDULUM,
        frequency=case["f"],
        duration=case["t"][-1],
        samples=len(case["t"]),
        initial_state=(np.full(LINKS, case["alpha0"]), np.zeros(LINKS)),
        stepper=vj.LinearlyImplicit(longest_step=1e-4),
    )
    np.testing.assert_allclose(history.coordinates[1:, 0], case["alpha1"], atol=2e-4)
    np.testing.assert_allclose(history.coordinates[1:, -1], case["alphaN"], atol=2e-4)
    np.testing.assert_allclose(history.displacement()[1:], case["tip_x"], atol=4e-5)


@pytest.mark.slow
def test_orbit_of_period_3_closes():
    orbit = REFERENCE["period3_orbits"]["5.7"]
    history = vj.simulate(
        PENDULUM,
        frequency=5.7,
        periods=3,
        samples_per_period=20,
        initial_state=(np.array(orbit["alpha_start"]), np.array(orbit["omega_start"])),
        stepper=vj.LinearlyImplicit(longest_step=1e-4),
    )
    bearing = history.coordinates[:, 0]
    np.testing.assert_allclose(history.coordinates[-1], orbit["alpha_start"], atol=1e-4)
    np.testing.assert_allclose(bearing[1:], orbit["alpha1"], atol=2e-4)


def march_strobes(pendulum, frequencies, starts, periods, kept, seed=0):
    """Bearing angles at phase 0 of the last periods, (kept, frequencies, starts)."""
    method = vj.LinearlyImplicit(steps_per_period=1000)
    equations = pendulum.equations()
    march = method.prepare(equations, pendulum.drive)
    frequency = jnp.repeat(jnp.asarray(frequencies), starts)
    random = np.random.default_rng(seed)
    angle = random.uniform(-0.1, 0.1, frequency.size)
    state = jnp.concatenate(
        [pendulum.modal_coordinates(jnp.ones(LINKS))[:, None] * angle, np.zeros((6, angle.size))]
    )
    once = jnp.ones(frequency.shape, jnp.int32)
    run = jax.jit(lambda x, n: march(x, 2 * jnp.pi * frequency, n, False)[0])
    state = run(state, (periods - kept) * once)
    seen = []
    for _ in range(kept):
        state = run(state, once)
        angles = jax.vmap(equations.observables, in_axes=1)(state[:6])["bearing_angle"]
        seen.append(np.asarray(angles).reshape(len(frequencies), starts))
    return np.array(seen)


def strobed_period(values, longest=20, tolerance=0.02):
    size = np.ptp(values)
    for n in range(1, longest + 1):
        if np.max(np.abs(values[n:] - values[:-n])) < tolerance * size:
            return n
    return 0


@pytest.mark.slow
def test_regimes_of_the_modal_pendulum():
    frequencies = (3.1, 5.7, 6.7, 8.8)
    strobes = march_strobes(PENDULUM.linearised(6), frequencies, 2, 130, 41)
    found = [[strobed_period(strobes[:, i, j]) for j in range(2)] for i in range(4)]
    assert found == [[0, 0], [3, 3], [3, 3], [0, 0]]


def oscillator(damping, stiffness=50.0, law=None):
    law = vj.KelvinVoigt(stiffness, damping, tension=False) if law is None else law
    return vj.MatrixSystem(
        mass=[[1.0]],
        damping=[[0.1]],
        stiffness=[[1.0]],
        stops=(vj.Stop(None, 1.0, law, smoothing=0.0),),
        stop_map=[[1.0]],
        input_map=[1.0],
        response_map=[1.0],
        drive=vj.PointForce(0.3),
    )


@pytest.mark.parametrize("damping", [0.0, 2.0])
def test_single_mass_converges_to_the_exact_motion(damping):
    system = oscillator(damping)
    kept = {"frequency": 1.1 / (2 * np.pi), "periods": 4, "samples_per_period": 16}
    start = {"initial_state": (np.array([1.3]), np.array([0.2]))}
    exact = vj.simulate(system, **kept, **start, stepper=vj.ExactContact(1e-8))

    def error(steps):
        method = vj.LinearlyImplicit(steps_per_period=steps)
        found = vj.simulate(system, **kept, **start, stepper=method)
        return np.max(np.abs(found.displacement() - exact.displacement()))

    coarse, fine = error(512), error(2048)
    assert np.max(exact.contact_force) > 1.0
    assert coarse < 5e-3
    assert fine < coarse / 3.5


def test_other_laws_agree_with_kvaerno5():
    system = oscillator(0.0, law=vj.HuntCrossley(200.0, 0.3))
    settings = {"frequency": 1.1 / (2 * np.pi), "periods": 2, "samples_per_period": 16}
    start = {"initial_state": (np.array([1.3]), np.array([0.2]))}
    expected = vj.simulate(system, **settings, **start, stepper=diffrax.Kvaerno5(), tolerance=1e-9)
    method = vj.LinearlyImplicit(steps_per_period=4000)
    found = vj.simulate(system, **settings, **start, stepper=method)
    np.testing.assert_allclose(found.displacement(), expected.displacement(), atol=2e-4)


@pytest.mark.slow
def test_pendulum_agrees_with_kvaerno5():
    pendulum = vj.default_pendulum(num_links=4)
    settings = {"frequency": 5.7, "duration": 0.25, "samples": 25}
    start = {"initial_state": (np.full(4, 0.05), np.zeros(4))}
    method = vj.LinearlyImplicit(longest_step=2e-5)
    found = vj.simulate(pendulum, **settings, **start, stepper=method)
    expected = vj.simulate(
        pendulum, **settings, **start, stepper=diffrax.Kvaerno5(), tolerance=1e-8
    )
    assert np.max(expected.contact_force) > 0.1
    np.testing.assert_allclose(found.coordinates, expected.coordinates, atol=1e-4)


def test_march_is_the_history_and_lanes_do_not_matter():
    modal = PENDULUM.linearised(3)
    method = vj.LinearlyImplicit(steps_per_period=300)
    march = method.prepare(modal.equations(), modal.drive)
    frequency = jnp.array([4.0, 5.7, 8.0])
    state = jnp.zeros((6, 3)).at[0].set(1e-3)
    two = jnp.full(3, 2, jnp.int32)
    end, steps, measures = march(state, 2 * jnp.pi * frequency, two, True)
    assert list(steps) == [600] * 3
    one, _, own = march(state[:, 1], 2 * jnp.pi * frequency[1], jnp.asarray(2), True)
    np.testing.assert_allclose(end[:, 1], one, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(measures.highest[1], own.highest, rtol=1e-9)
    history = vj.simulate(
        modal,
        frequency=5.7,
        periods=2,
        samples=300,
        initial_state=(state[:3, 1], state[3:, 1]),
        stepper=method,
    )
    np.testing.assert_allclose(one[:3], history.coordinates[-1], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(own.highest, np.max(history.displacement()), rtol=1e-3)


def test_several_stops_at_one_place_share_the_force():
    stops = tuple(vj.Stop(None, 1.0, vj.KelvinVoigt(k, c)) for k, c in ((3.0, 0.5), (5.0, 0.2)))
    both = contact_impulses(
        stops, jnp.zeros(2), jnp.full(2, 0.1), jnp.full(2, 0.2), jnp.full((2, 2), 0.3)
    )
    single = (vj.Stop(None, 1.0, vj.KelvinVoigt(8.0, 0.7)),)
    alone = contact_impulses(
        single, jnp.zeros(1), jnp.full(1, 0.1), jnp.full(1, 0.2), jnp.full((1, 1), 0.3)
    )
    np.testing.assert_allclose(jnp.sum(both), alone[0], rtol=1e-3)  # corners rounded over 1e-3
    three = tuple(vj.Stop(None, 1.0, vj.KelvinVoigt(k, 0.0), smoothing=0.0) for k in (1, 3, 4))
    dense = contact_impulses(
        three, jnp.zeros(3), jnp.full(3, 0.1), jnp.full(3, 0.2), jnp.full((3, 3), 0.3)
    )
    np.testing.assert_allclose(dense / dense[0], [1, 3, 4], rtol=1e-9)


def test_new_numbers_do_not_compile_again():
    traces = []

    @jax.jit
    def end(amplitude, height):
        traces.append(None)
        pendulum = vj.default_pendulum(base_amplitude=amplitude, limiter_height=height, num_links=3)
        march = vj.LinearlyImplicit(steps_per_period=200).prepare(
            pendulum.equations(), pendulum.drive
        )
        return march(jnp.full(6, 0.01), jnp.asarray(36.0), jnp.asarray(1), False)[0]

    assert not np.allclose(end(5e-3, 0.04), end(6e-3, 0.05))
    assert len(traces) == 1


def last_tip(numbers, gradient="reverse"):
    pendulum = vj.default_pendulum(
        base_amplitude=numbers[0] * 6.33e-3,
        limiter_distance=numbers[1] * 0.012,
        joint_damping_time=numbers[2] * 2.91e-4,
        contact_damping=numbers[3] * 100.0,
    ).linearised(6)
    history = vj.simulate(
        pendulum,
        frequency=5.7,
        duration=1.0,
        samples=20,
        initial_state=(pendulum.modal_coordinates(jnp.full(LINKS, 0.05)), jnp.zeros(6)),
        stepper=vj.LinearlyImplicit(longest_step=1e-4),
        gradient=gradient,
    )
    return 1e3 * history.displacement()[-1]


@pytest.mark.slow
@pytest.mark.long
def test_gradients_through_a_second_of_impacts():
    point = jnp.ones(4)
    reverse = jax.grad(last_tip)(point)
    forward = jax.jacfwd(lambda x: last_tip(x, "forward"))(point)
    np.testing.assert_allclose(reverse, forward, rtol=1e-7)
    step = 1e-8
    for i in range(4):
        up, down = (last_tip(point.at[i].add(s * step), "forward") for s in (1, -1))
        np.testing.assert_allclose((up - down) / (2 * step), forward[i], rtol=1e-4)


@pytest.mark.slow
def test_gradients_of_a_window_nest_with_vmap():
    def tip(amplitude, gradient="reverse"):
        pendulum = vj.default_pendulum(base_amplitude=amplitude, num_links=3)
        history = vj.simulate(
            pendulum,
            frequency=5.7,
            duration=0.3,
            samples=6,
            initial_state=(jnp.full(3, 0.05), jnp.zeros(3)),
            stepper=vj.LinearlyImplicit(longest_step=2e-4),
            gradient=gradient,
        )
        return 1e3 * history.displacement()[-1]

    points = jnp.array([6.0e-3, 6.5e-3])
    by_lane = jax.vmap(jax.grad(tip))(points)
    of_sum = jax.grad(lambda x: jnp.sum(jax.vmap(tip)(x)))(points)
    np.testing.assert_allclose(by_lane, of_sum, rtol=1e-9)
    step = 1e-9
    tips = jax.vmap(lambda a: tip(a, "forward"))
    change = (tips(points + step) - tips(points - step)) / (2 * step)
    np.testing.assert_allclose(by_lane, change, rtol=1e-4)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"tolerance": 0.0}, "tolerance must be above 0"),
        ({"steps_per_period": 2}, "steps_per_period must be a whole number of at least 4"),
        ({"longest_step": -1e-4}, "longest_step must be above 0 s"),
        ({"refinements": 0}, "refinements must be a whole number of at least 1"),
        ({"longest_step": 1e-4, "steps_per_period": 500}, "not both"),
    ],
)
def test_settings_that_cannot_work_are_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        vj.LinearlyImplicit(**settings)


def test_steps_too_long_for_the_damping_are_refused(monkeypatch):
    run = {"frequency": 5.7, "periods": 1}
    with pytest.raises(ValueError, match=r"longest_step makes steps of 0.002 s, .* at most 0.0004"):
        vj.simulate(PENDULUM, **run, stepper=vj.LinearlyImplicit(longest_step=2e-3))
    with pytest.raises(ValueError, match=r"steps_per_period makes steps of .* for this damping"):
        vj.simulate(PENDULUM, **run, stepper=vj.LinearlyImplicit(steps_per_period=64))
    with pytest.raises(ValueError, match="longest_step makes steps"):
        vj.frequency_sweep(
            PENDULUM,
            frequency=[5.0, 6.0],
            settings=vj.SweepSettings(stepper=vj.LinearlyImplicit(longest_step=2e-3)),
        )
    coarse = vj.LinearlyImplicit(steps_per_period=64)
    # Nothing compiles before.
    monkeypatch.setattr("vibrojax.sweep.frequency_sweep.compile_ahead", pytest.fail)
    for given in ({"stepper": coarse}, {"steps_per_period": 64}):
        with pytest.raises(ValueError, match=r"steps_per_period makes steps"):
            vj.frequency_sweep(PENDULUM, frequency=[5.0, 6.0], settings=vj.SweepSettings(**given))
    beam, coarse = vj.default_rig(damping_ratio=0.9), vj.LinearlyImplicit(steps_per_period=4)
    with pytest.raises(ValueError, match=r"steps_per_period makes steps"):
        vj.frequency_sweep(
            beam, frequency_ratio=[1.0, 1.1], settings=vj.SweepSettings(stepper=coarse)
        )
    with pytest.raises(ValueError, match=r"steps_per_period makes steps"):
        vj.regimes(PENDULUM, frequency=[5.0, 6.0], settings=vj.RegimeSettings(stepper=coarse))
    # By itself the method takes as many steps as the damping asks for.
    stiff = replace(PENDULUM, joint_damping=PENDULUM.joint_damping * 100)
    assert vj.LinearlyImplicit(1e-3).steps(vj.motion(stiff, frequency=5.7)) > 20_000


def test_longest_step_holds_for_numbers_that_are_traced():
    method = vj.LinearlyImplicit(longest_step=1e-2)

    def steps(damping, frequency):
        counts.append(method.steps(vj.motion(oscillator(damping), frequency=frequency)))
        return damping

    counts = []
    jax.eval_shape(lambda damping: steps(damping, 0.2), 1.0)
    jax.grad(lambda damping: steps(damping, 0.1))(1.0)
    assert counts == [500, 1000]
    with pytest.raises(ValueError, match="a frequency that JAX is tracing: give LinearlyImplicit"):
        jax.eval_shape(lambda frequency: steps(1.0, frequency), 0.2)


def test_stops_with_memory_are_refused():
    system = oscillator(0.0, law=vj.StandardLinearSolid(50.0, 20.0, 1.0))
    with pytest.raises(
        ValueError, match="LinearlyImplicit takes systems and contact laws without internal"
    ):
        vj.simulate(system, frequency=0.2, periods=1, stepper=vj.LinearlyImplicit())


@pytest.mark.slow
@pytest.mark.long
def test_derivative_of_a_locked_orbit_and_none_of_a_chaotic_motion():
    def make(amplitude=6.33e-3):
        pendulum = vj.default_pendulum(base_amplitude=amplitude, num_links=4, limiter_height=0.045)
        return pendulum.linearised(2)

    response = vj.RegimeSettings(
        transient=180,
        periods=42,
        lyapunov=True,
        direction="forward",
        samples_per_period=16,
        max_period=6,
        stepper=vj.LinearlyImplicit(steps_per_period=400),
        spectrum=False,
    )

    def mapped(amplitude, **more):
        return vj.parameter_map(
            make, amplitude=[amplitude], frequency=[5.0, 5.7], response=response, **more
        )

    found = mapped(6.33e-3, gradients=["amplitude"])
    assert found.period.values.ravel().tolist() == [3, 0]
    assert found.regime.values.ravel()[1] == vj.Regime.chaotic.value
    slope = found.d_amplitude_ratio_d_amplitude.values.ravel()
    assert np.isnan(slope[1])
    step = 1e-8  # less than what moves an impact to another step
    up, down = (mapped(6.33e-3 + s * step).amplitude_ratio.values.ravel() for s in (1, -1))
    np.testing.assert_allclose(slope[0], (up - down)[0] / (2 * step), rtol=1e-3)
