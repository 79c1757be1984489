"""Undamped modes driven at their own frequency: growth without stops, bounded motions with them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import vibrojax as vj
from vibrojax.model.systems import equations_of
from vibrojax.stepping.resonance import driven_growth, is_unbounded, unbounded_at

DRIVE = vj.PointForce(0.3)


def oscillator(*, damping=0.0, stiffness=50.0, dashpot=0.0, stops=True):
    """x'' + damping x' + x + contact = 0.3 sin(w t), the stop at 1."""
    stop = vj.Stop(None, 1.0, vj.KelvinVoigt(stiffness, dashpot))
    return vj.MatrixSystem(
        [[1.0]],
        [[damping]],
        [[1.0]],
        stops=stop if stops else (),
        stop_map=[[1.0]] if stops else None,
        drive=DRIVE,
        input_map=[1.0],
        response_map=[1.0],
        proportional=True,
    )


def marched(ratio, times, *, stiffness=50.0, dashpot=0.0):
    """The same by scipy, from rest, the steps short against a contact."""

    def rates(t, y):
        depth = y[0] - 1.0
        push = (stiffness * depth + dashpot * y[1]) * (depth > 0)
        return y[1], 0.3 * np.sin(ratio * t) - y[0] - push

    solved = solve_ivp(
        rates, (0, times[-1]), (0.0, 0.0), "DOP853", times, rtol=1e-11, atol=1e-12, max_step=0.02
    )
    return solved.y[0]


@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-7, 1e-4])
def test_driven_growth_keeps_its_digits_however_close_the_pole(apart):
    decay, rate, angle, w, time = -1e-9, 2.0 + apart, 0.7, 2.0, jnp.array(5.0)
    inputs = np.array([0.3 - 0.1j, 0.2 + 0.4j])
    added = driven_growth(
        jnp.array([decay]), jnp.array([rate]), jnp.asarray(inputs), angle, jnp.array(w), time
    )

    def integrand(s):
        first, second = np.imag(inputs * np.exp(1j * (angle + w * s)))
        return np.exp((decay + 1j * rate) * (5.0 - s)) * (first + 1j * second)

    expected = quad(integrand, 0, 5.0, complex_func=True, epsabs=1e-13)[0]
    np.testing.assert_allclose(added, [expected.real, expected.imag], rtol=1e-12)
    # The derivative too, where a quotient of differences would have none.
    slope = jax.grad(
        lambda r: driven_growth(
            jnp.array([decay]), r[None], jnp.asarray(inputs), angle, jnp.array(w), time
        )[0]
    )(jnp.array(rate))
    step = 1e-5
    ends = [
        driven_growth(
            jnp.array([decay]), jnp.array([x]), jnp.asarray(inputs), angle, jnp.array(w), time
        )[0]
        for x in (rate - step, rate + step)
    ]
    assert float(slope) == pytest.approx(float(ends[1] - ends[0]) / (2 * step), rel=1e-8)


def test_only_undamped_driven_modes_that_no_stop_holds_grow_without_bound():
    def grows(system):
        equations = equations_of(system)
        w = equations.angular_frequency
        return np.asarray(is_unbounded(unbounded_at(equations, system.drive)[:, None], w)).tolist()

    assert grows(oscillator(stops=False)) == [True]
    assert grows(oscillator(stiffness=0.0)) == [True]
    assert grows(oscillator()) == [False]
    assert grows(oscillator(stiffness=0.0, dashpot=0.1)) == [False]
    assert grows(oscillator(damping=1e-6, stops=False)) == [False]

    def masses(**changes):
        numbers = {
            "mass": np.eye(2),
            "damping": np.zeros((2, 2)),
            "stiffness": [[2.0, -1.0], [-1.0, 2.0]],
            "stops": vj.Stop(None, 1.0, vj.KelvinVoigt(100.0)),
            "stop_map": [[1.0, -1.0]],
            "drive": DRIVE,
            "input_map": [1.0, 0.0],
            "response_map": [1.0, 0.0],
        }
        return vj.MatrixSystem(**numbers | changes)

    # The masses move together in the first mode, of which the stop between them is a node.
    assert grows(masses()) == [True, False]
    assert grows(masses(stop_map=[[1.0, 0.0]])) == [False, False]
    # A force on both does not drive the second mode; a dashpot between them does not damp the
    # first one.
    assert grows(masses(stops=(), stop_map=None, input_map=[1.0, 1.0])) == [True, False]
    dashpot = 0.1 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    assert grows(masses(stops=(), stop_map=None, damping=dashpot)) == [True, False]


def test_a_sweep_says_what_grows_without_bound_and_does_not_march_it():
    with pytest.warns(UserWarning, match=r"^frequency_ratio = 1: An undamped mode is driven"):
        curve = vj.frequency_sweep(
            oscillator(stops=False),
            frequency_ratio=[0.53, 1.0, 1.47],
            settings=vj.SweepSettings(max_periods=40, refine_jumps=None),
        )
    status = np.asarray(curve.status)
    assert (status[:, 1] == vj.Status.unbounded.value).all()
    assert "without bound" in vj.Status.unbounded.sentence
    assert np.isnan(curve.amplitude_ratio[:, 1]).all()
    assert (np.asarray(curve.periods_marched)[:, 1] == 0).all()
    assert (np.asarray(curve.steps)[:, 1] == 0).all()
    # Beats last for ever without damping: bounded, but no period is found.
    assert (status[:, [0, 2]] == vj.Status.aperiodic.value).all()
    assert np.isfinite(curve.amplitude_ratio[:, [0, 2]]).all()
    assert "2 unbounded" in repr(curve)
    assert "unbounded" in curve.to_xarray().status.attrs["flag_meanings"]
    assert "unbounded" in str([t.get_text() for t in curve.plot().legends[0].get_texts()])


def test_with_a_stop_the_motion_is_computed():
    ratios = [0.95, 1.0, 1.0 + 1e-12, 1.05]
    lossy = oscillator(dashpot=1.0)
    curve = vj.frequency_sweep(
        lossy, frequency_ratio=ratios, settings=vj.SweepSettings(direction="forward")
    )
    assert (np.asarray(curve.status) == vj.Status.settled.value).all()
    amplitude = np.asarray(curve.amplitude_ratio)[0]
    assert amplitude[1] == pytest.approx(amplitude[2], rel=1e-9)
    # Without any loss it does not settle, but it stays finite.
    curve = vj.frequency_sweep(
        oscillator(),
        frequency_ratio=ratios,
        settings=vj.SweepSettings(direction="forward", max_periods=40),
    )
    assert not (np.asarray(curve.status) == vj.Status.diverged.value).any()
    assert np.isfinite(curve.amplitude_ratio).all()


@pytest.mark.parametrize(
    "solver",
    [None, pytest.param(vj.ExponentialSplitting(steps_per_period=4096), marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("ratio", [1.0, 1.0 + 1e-12, 1.0 - 1e-6])
def test_histories_at_resonance_match_an_adaptive_solver(ratio, solver):
    system = oscillator(dashpot=0.2)
    history = vj.simulate(
        system, frequency_ratio=ratio, periods=6, samples_per_period=32, stepper=solver
    )
    expected = marched(ratio, np.asarray(history.time), dashpot=0.2)
    bound = 1e-7 if solver is None else 2e-3  # the corner is rounded
    np.testing.assert_allclose(history.displacement(), expected, atol=bound * np.ptp(expected))
    free = replace(system, stops=(), stop_map=None)
    run = vj.simulate(free, frequency_ratio=1.0, periods=3, samples_per_period=32, stepper=solver)
    time = np.asarray(run.time)
    growing = 0.15 * (np.sin(time) - time * np.cos(time))
    np.testing.assert_allclose(run.displacement(), growing, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("gradient", ["reverse", "forward"])
def test_derivatives_at_resonance(gradient):
    def last(x):
        system = oscillator(damping=x[0], stiffness=x[1], dashpot=0.2)
        run = vj.simulate(
            system,
            frequency_ratio=x[2],
            periods=3,
            samples_per_period=16,
            gradient=gradient,
            tolerance=1e-9,
        )
        return run.displacement()[-1]

    point = jnp.array([0.0, 50.0, 1.0])
    found = (jax.grad if gradient == "reverse" else jax.jacfwd)(last)(point)
    steps = np.diag([1e-6, 1e-4, 1e-6])
    expected = [(last(point + s) - last(point - s)) / (2 * s.sum()) for s in steps]
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.slow
def test_periodic_responses_at_resonance():
    free = oscillator(stops=False)
    grows = vj.periodic_response(free, frequency_ratio=1.0)
    assert int(grows.status) == vj.Status.unbounded.value
    assert "without bound" in grows.sentence
    assert np.isnan(grows.amplitude_ratio)
    # Beside it there is a steady response, which a march does not reach.
    near = vj.periodic_response(free, frequency_ratio=1.0 + 1e-6)
    assert near.converged
    assert float(near.amplitude_ratio) == pytest.approx(1 / ((1 + 1e-6) ** 2 - 1), rel=1e-9)
    held = vj.periodic_response(oscillator(dashpot=1.0), frequency_ratio=1.0)
    assert held.converged
    run = vj.simulate(
        oscillator(dashpot=1.0),
        frequency_ratio=1.0,
        periods=1,
        initial_state=tuple(np.split(np.asarray(held.initial_state), 2)),
        tolerance=1e-9,
    )
    np.testing.assert_allclose(run.coordinates[-1], run.coordinates[0], rtol=1e-7)


@pytest.mark.slow
def test_derivative_of_a_periodic_response_at_resonance():
    def amplitude(stiffness):
        system = oscillator(stiffness=stiffness, dashpot=1.0)
        return vj.periodic_response(system, frequency_ratio=1.0).amplitude_ratio

    slope = float(jax.grad(amplitude)(50.0))
    assert slope == pytest.approx(float(amplitude(50.01) - amplitude(49.99)) / 0.02, rel=1e-5)


@pytest.mark.slow
def test_branches_pass_begin_and_end_at_resonance():
    system = oscillator(dashpot=1.0)
    found = []
    for span in ((0.7, 1.1), (1.0, 1.1), (0.7, 1.0)):
        branch = vj.continue_response(system, frequency_ratio=vj.Range(*span))
        assert branch.completed
        assert (branch.values[0], branch.values[-1]) == span
        assert branch.exact_points.all()
        assert branch.residual.max() < 1e-9
        found.append(float(branch.resample([1.0]).amplitude_ratio[0, 0]))
    np.testing.assert_allclose(found, found[0], rtol=1e-9)
    response = vj.single_contact_response(system, frequency_ratio=[0.9, 1.0, 1.1])
    assert np.isinf(response.touch_gap_ratio).tolist() == [False, True, False]


@pytest.mark.slow
def test_maps_and_regimes_flag_what_grows_without_bound():
    def free(force=0.3):
        return replace(oscillator(stops=False), drive=vj.PointForce(force))

    swept = vj.parameter_map(
        free,
        frequency_ratio=[0.53, 1.0],
        force=[0.3, 0.4],
        response=vj.SweepSettings(max_periods=40),
        progress=False,
    )
    words = swept.status.attrs["flag_meanings"].split()
    assert [words[k] for k in swept.status.values[0, 0]] == ["aperiodic", "unbounded"]
    assert (swept.lane_status.values == vj.Status.diverged.value).all()
    points = vj.parameter_map(
        free,
        frequency_ratio=[0.53, 1.0],
        force=[0.3, 0.4],
        response=vj.PeriodicSettings(),
        progress=False,
    )
    words = points.status.attrs["flag_meanings"].split()
    assert [words[k] for k in points.status.values[0]] == ["found", "unbounded"]
