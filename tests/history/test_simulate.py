"""Time histories: against the oracle, across solvers, gradients, spectra and refusals."""

import diffrax
import exact_propagation as oracle
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.history.simulate import solve

PERIODS = 6


def oracle_tip(ratio, samples_per_period, periods=PERIODS):
    problem = oracle.default_problem()
    omega = ratio * problem.angular_frequency[0]
    times = np.arange(periods * samples_per_period + 1) * 2 * np.pi / omega / samples_per_period
    start = np.zeros(2 * len(problem.angular_frequency))
    states, _ = oracle.propagate(problem, omega, start, 0.0, times[-1], times)
    return problem.tip(states), problem.contact_force(states)


def relative_error(values, exact):
    return np.max(np.abs(np.asarray(values) - exact)) / np.max(np.abs(exact))


@pytest.mark.parametrize(
    ("solver", "gradient", "bound"),
    [
        (None, "reverse", 1e-9),
        (None, "forward", 1e-9),
        (vj.ExponentialSplitting(1e-5), "reverse", 1e-4),
        (diffrax.Tsit5(), "reverse", 1e-4),
    ],
)
def test_history_matches_exact_propagation(solver, gradient, bound):
    history = vj.simulate(
        vj.default_rig(),
        frequency_ratio=1.1,
        periods=PERIODS,
        samples_per_period=64,
        stepper=solver,
        gradient=gradient,
    )
    tip, force = oracle_tip(1.1, 64)
    assert int(history.status) == vj.Status.completed.value
    assert relative_error(history.displacement(), tip) < bound
    # The force of the history is rounded over the default width: 1e-3 of the gap.
    assert relative_error(history.contact_force[:, 0], force) < max(10 * bound, 2e-3)


def test_any_implicit_solver_runs():
    history = vj.simulate(
        vj.default_rig(),
        frequency_ratio=1.1,
        periods=1,
        samples_per_period=16,
        stepper=diffrax.Kvaerno3(),
        tolerance=1e-4,
    )
    tip, _ = oracle_tip(1.1, 16, 1)
    assert relative_error(history.displacement(), tip) < 1e-3


def test_rates_and_accelerations_are_derivatives():
    history = vj.simulate(
        vj.default_rig(gap=1.0), frequency_ratio=0.7, periods=1, samples_per_period=1024
    )
    interval = float(history.time[1] - history.time[0])
    for value, rate in (
        (history.displacement(0.6), history.velocity(0.6)),
        (history.velocity(0.6), history.acceleration(0.6)),
    ):
        slope = (np.asarray(value)[2:] - np.asarray(value)[:-2]) / (2 * interval)
        np.testing.assert_allclose(
            slope, rate[1:-1], atol=2e-3 * float(np.max(np.abs(np.asarray(rate))))
        )


def test_release_starts_from_the_static_shape_and_decays():
    rig = vj.default_rig(gap=1.0, damping_ratio=0.01)
    free = vj.ImpactingBeam(rig.beam, damping_ratio=0.01, num_modes=5)
    history = vj.simulate(free, release=2e-3, periods=10, samples_per_period=64)
    tip = np.asarray(history.displacement())
    assert tip[0] == pytest.approx(2e-3, rel=1e-12)
    found = vj.modes(free.beam, 5)
    # Closed form: every mode decays on its own.
    w, zeta = np.asarray(found.angular_frequency), 0.01
    q0 = np.asarray(history.coordinates[0])
    t = np.asarray(history.time)[:, None]
    wd = w * np.sqrt(1 - zeta**2)
    q = np.exp(-zeta * w * t) * (np.cos(wd * t) + zeta * w / wd * np.sin(wd * t)) * q0
    np.testing.assert_allclose(np.asarray(history.coordinates), q, atol=1e-14)


@pytest.mark.parametrize("solver", [vj.ExactContact(1e-8), vj.ExponentialSplitting(1e-3)])
def test_an_undamped_mode_turns_at_its_own_frequency(rig, solver):
    system = vj.ImpactingBeam(rig().beam, rig().stops, num_modes=1)
    history = vj.simulate(system, release=-1e-4, periods=2, stepper=solver)
    assert history.status == vj.Status.completed.value
    turn = 2 * np.pi * np.linspace(0, 2, 257)
    np.testing.assert_allclose(history.displacement(), -1e-4 * np.cos(turn), atol=1e-12)


def test_chirp_of_equal_ends_is_the_harmonic():
    rig = vj.default_rig()
    frequency = 1.1 * float(vj.modes(rig.beam).frequency[0])
    harmonic = vj.simulate(rig, frequency=frequency, duration=0.5, samples=200)
    chirp = vj.simulate(
        rig, waveform=vj.Chirp(frequency, frequency, 0.5), duration=0.5, samples=200
    )
    np.testing.assert_allclose(harmonic.displacement(), chirp.displacement(), atol=1e-12)


def test_chirp_matches_an_adaptive_solver():
    rig = vj.default_rig()
    wave = vj.Chirp(8.0, 12.0, 1.0, "logarithmic")
    ours = vj.simulate(rig, waveform=wave, duration=1.0, samples=4000)
    other = vj.simulate(
        rig, waveform=wave, duration=1.0, samples=4000, stepper=diffrax.Dopri8(), tolerance=1e-9
    )
    assert relative_error(ours.displacement(), np.asarray(other.displacement())) < 2e-3


def test_spectrum_reads_the_amplitude_of_a_sine():
    rig = vj.default_rig(gap=1.0, damping_ratio=0.5)
    history = vj.simulate(rig, frequency_ratio=0.6, periods=40, samples_per_period=64)
    frequency = 0.6 * float(vj.modes(rig.beam).frequency[0])
    late = 20 / frequency
    spectrum = history.spectrum("displacement", start=late, window="flattop")
    at = np.argmax(spectrum.amplitude)
    tip = np.asarray(history.displacement())[np.asarray(history.time) >= late]
    assert spectrum.frequency[at] == pytest.approx(frequency, rel=0.05)
    assert spectrum.amplitude[at] == pytest.approx(np.ptp(tip) / 2, rel=2e-3)


def loss(x, **settings):
    rig = vj.default_rig(
        gap=x[0] * 1e-3, stiffness=x[1] * 1e3, damping=x[2], taper=x[3], num_modes=1
    )
    history = vj.simulate(rig, frequency_ratio=1.1, periods=2, samples_per_period=32, **settings)
    tip = history.displacement() * 1e3
    return jnp.mean(tip**2) + tip[-1]


POINT = jnp.array([0.4, 5.5, 0.05, 0.5])


def finite_differences(function, x, step=1e-6):
    def one(i):
        return (function(x.at[i].add(step)) - function(x.at[i].add(-step))) / (2 * step)

    return np.array([float(one(i)) for i in range(x.size)])


@pytest.mark.slow
def test_gradients_of_a_history_match_finite_differences():
    expected = finite_differences(loss, POINT)
    reverse = jax.grad(loss)(POINT)
    np.testing.assert_allclose(reverse, expected, rtol=2e-5)
    forward = jax.jacfwd(lambda x: loss(x, gradient="forward"))(POINT)
    np.testing.assert_allclose(forward, reverse, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("samples_per_period", [48, 50])
def test_reverse_mode_goes_as_far_as_forward_mode(samples_per_period):
    # An interval in period 91 takes 13 attempts, one more than reverse mode once had.
    def run(gradient):
        return vj.simulate(
            vj.default_rig(),
            frequency_ratio=1.1,
            periods=150,
            samples_per_period=samples_per_period,
            gradient=gradient,
        )

    reverse, forward = run("reverse"), run("forward")
    assert int(reverse.status) == vj.Status.completed.value
    np.testing.assert_allclose(reverse.displacement(), forward.displacement(), atol=1e-11)


@pytest.mark.slow
def test_reverse_mode_matches_forward_mode_where_intervals_take_many_attempts():
    def last(x, gradient):
        rig = vj.default_rig(num_modes=1, gap=x[0] * 1e-3, stiffness=x[1] * 1e6)
        run = vj.simulate(
            rig, frequency_ratio=1.1, periods=3, samples_per_period=16, gradient=gradient
        )
        return run.displacement()[-1] * 1e3

    point = jnp.array([0.3, 3.0])
    reverse = jax.grad(lambda x: last(x, "reverse"))(point)
    forward = jax.jacfwd(lambda x: last(x, "forward"))(point)
    assert np.all(np.abs(np.asarray(reverse)) > 0)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8)


@pytest.mark.slow
def test_gradients_nest_with_vmap():
    points = POINT * jnp.array([[1.0, 1.0, 1.0, 1.0], [1.02, 0.97, 1.1, 0.9]])
    both = jax.vmap(jax.grad(loss))(points)
    summed = jax.grad(lambda p: jnp.sum(jax.vmap(loss)(p)))(points)
    np.testing.assert_allclose(summed, both, rtol=1e-7)


@pytest.mark.slow
def test_gradient_of_splitting_matches_finite_differences():
    settings = {"stepper": vj.ExponentialSplitting(steps_per_period=512)}
    gradient = jax.grad(lambda x: loss(x, **settings))(POINT)
    expected = finite_differences(lambda x: loss(x, **settings), POINT)
    np.testing.assert_allclose(gradient, expected, rtol=1e-4)


def test_new_numbers_and_like_lengths_do_not_recompile():
    def run(gap, periods=1.0):
        return vj.simulate(
            vj.default_rig(gap=gap), frequency_ratio=1.1, periods=periods, samples_per_period=24
        )

    longest = run(0.4e-3, 27 / 24)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    run(0.3e-3, 27 / 24)
    assert not compiled
    programs = len(solve.programs)
    # The samples that both have are the same; where a history ends nothing is added.
    shorter = run(0.4e-3)
    assert len(solve.programs) == programs
    assert [len(h.time) for h in (shorter, longest)] == [25, 28]
    np.testing.assert_allclose(
        shorter.displacement(), longest.displacement()[:25], rtol=1e-9, atol=1e-15
    )


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"frequency_ratio": 1.1}, "periods or duration"),
        ({"frequency_ratio": 1.1, "periods": 1, "duration": 1.0}, "periods or duration"),
        ({"periods": 1}, "has a drive"),
        ({"frequency": 9.0, "frequency_ratio": 1.0, "periods": 1}, "not several"),
        ({"frequency_ratio": -1.0, "periods": 1}, "frequency_ratio must be above 0"),
        ({"frequency_ratio": 1.1, "periods": 0}, "periods must be above 0"),
        ({"frequency_ratio": 1.1, "periods": 1, "release": 2e-3}, "inside a stop"),
        ({"frequency_ratio": 1.1, "periods": 1, "gradient": "both"}, "gradient must be"),
        (
            {"frequency_ratio": 1.1, "periods": 1, "initial_state": ([0.0], [0.0])},
            "shape \\(5,\\)",
        ),
    ],
)
def test_refusals(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        vj.simulate(vj.default_rig(), **arguments)


def test_dataset_and_picture(tmp_path):
    history = vj.simulate(vj.default_rig(), frequency_ratio=1.1, periods=2, samples_per_period=32)
    dataset = history.to_xarray()
    assert dataset["tip_displacement"].attrs["units"] == "m"
    assert dataset["contact_force"].dims == ("time", "stop")
    history.plot().savefig(tmp_path / "history.png")
    assert (tmp_path / "history.png").stat().st_size > 10_000
