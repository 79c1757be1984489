"""Largest Lyapunov exponents against what is known of systems."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from unit_oscillator import oscillator

import vibrojax as vj
from vibrojax.regime import lyapunov
from vibrojax.steady.growth import first_tangent, mean_rate, tangent_growth


def exponent(angular_frequency, system=None, periods=300):
    system = oscillator() if system is None else system
    found = vj.lyapunov_exponent(
        system, frequency=angular_frequency / (2 * np.pi), periods=periods, transient=200
    )
    return found, angular_frequency / (2 * np.pi)


@pytest.mark.parametrize("damping", [0.1, 0.4])
def test_linear_oscillator_decays_at_its_damping(damping):
    found, _ = exponent(1.3, oscillator(gap=10.0, damping=damping))
    assert float(found.exponent) == pytest.approx(-damping / 2, rel=1e-3)
    assert found.standard_error < 2e-3 * damping


@pytest.mark.slow  # to compile
@pytest.mark.parametrize("angular_frequency", [0.9331, 0.95])
def test_periodic_motion_has_the_exponent_of_its_leading_multiplier(angular_frequency):
    found, frequency = exponent(angular_frequency)
    orbit = vj.periodic_response(oscillator(), frequency=frequency, guess=found.final_state)
    leading = np.abs(np.asarray(orbit.floquet_multipliers)).max()
    assert orbit.contact_force > 0.1
    assert float(found.exponent) == pytest.approx(np.log(leading) * frequency, rel=2e-3)
    assert float(found.per_period) == pytest.approx(np.log(leading), rel=2e-3)


def test_chaotic_motion_has_a_positive_exponent_beyond_its_error():
    found, _ = exponent(0.9)
    assert found.significance > 5
    assert 0.03 < float(found.exponent) < 0.06
    assert len(found.rates) == 300
    assert float(found.exponent) == pytest.approx(float(found.rates.mean()), rel=0.05)
    assert "+-" in repr(found)


def test_undamped_motion_has_a_zero_exponent():
    found, _ = exponent(1.3, oscillator(gap=10.0, damping=0.0))
    assert abs(float(found.exponent)) < 1e-3


def test_a_second_call_with_other_numbers_does_not_compile_again():
    exponent(1.2)
    before = len(lyapunov._exponent.programs)
    exponent(1.1, oscillator(gap=0.9, damping=0.2))
    assert len(lyapunov._exponent.programs) == before


def lorenz(state, time=1.0, steps=100):
    """Runge and Kutta's fourth-order steps of the Lorenz equations at 10, 28, 8/3."""

    def rate(s):
        x, y, z = s
        return jnp.stack([10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z])

    def step(s, _):
        h = time / steps
        a = rate(s)
        b = rate(s + h / 2 * a)
        c = rate(s + h / 2 * b)
        return s + h / 6 * (a + 2 * b + 2 * c + rate(s + h * c)), None

    return jax.lax.scan(step, state, None, length=steps)[0]


def test_lorenz_has_its_published_exponent():
    lanes = 64
    state = 1.0 + jax.random.normal(jax.random.key(0), (3, lanes))
    weight = jnp.ones((3, lanes))

    @jax.jit
    def run(state):
        state, tangent, _, _ = tangent_growth(lorenz, state, first_tangent(weight), weight, 20)
        return tangent_growth(lorenz, state, tangent, weight, 250)[3]

    rates, errors = mean_rate(run(state), 1.0)
    error = float(jnp.std(rates)) / np.sqrt(lanes)
    assert float(rates.mean()) == pytest.approx(0.9056, abs=max(4 * error, 1e-3))  # Sprott 2003
    assert error < 0.005
    # The error of a lane covers what the lanes differ by, also here, where growths make up for
    # each other.
    assert 1 < float(errors.mean()) / float(jnp.std(rates)) < 4


def test_the_error_knows_of_growths_that_are_correlated():
    draws = np.random.default_rng(1).normal(size=(4000, 200))
    memory = 0.8
    series = np.zeros_like(draws)
    for k in range(1, len(draws)):
        series[k] = memory * series[k - 1] + draws[k]
    means, errors = mean_rate(jnp.asarray(series[1000:]), 0.5)
    wanted = float(jnp.std(means))
    assert float(errors.mean()) == pytest.approx(wanted, rel=0.15)
    naive = series[1000:].std() / np.sqrt(3000) / 0.5
    assert wanted > 2.5 * naive


def test_a_tangent_that_vanishes_does_not_make_a_number_that_is_none():
    one = jnp.ones((2, 1))
    log_growth = tangent_growth(lambda x: 0 * x, one, one, one, 3)[3]
    assert np.isfinite(log_growth).all()
    assert (log_growth < -700).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "Give frequency_ratio or frequency"),
        ({"frequency": 0.2, "frequency_ratio": 1.0}, "one of the two"),
        ({"frequency": -1.0}, "frequency must be above 0 Hz"),
        ({"frequency": 0.2, "periods": 2}, "periods must be a whole number of at least 4"),
        ({"frequency": 0.2, "transient": -1}, "transient must be a whole number"),
        ({"frequency": 0.2, "tolerance": 0.5}, "tolerance must be above 0"),
        ({"frequency": 0.2, "initial_state": [0.0]}, r"of shape \(2,\), got an array"),
    ],
)
def test_wrong_input_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        vj.lyapunov_exponent(oscillator(), **settings)
