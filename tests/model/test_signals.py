"""Signals: what they are between samples, refusals, pulses, random noise of a given density."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import vibrojax as vj

TIME = [0.0, 1.0, 1.5, 4.0]
VALUES = [2.0, -1.0, 0.5, 3.0]
FORCE, BASE = vj.PointForce(), vj.BaseMotion()


def test_straight_between_samples_and_held_outside():
    signal = vj.Sampled(TIME, VALUES)
    at = jnp.linspace(-1.0, 5.0, 61)
    np.testing.assert_allclose(FORCE.input(signal, at), np.interp(at, TIME, VALUES), atol=1e-15)
    np.testing.assert_array_equal(BASE.input(signal, at), -FORCE.input(signal, at))
    assert not signal.equally_spaced


def test_equal_spacing_is_seen_and_read_alike():
    time = np.linspace(3.0, 4.0, 11)
    values = np.sin(40 * time)
    signal = vj.Sampled(time, values)
    at = jnp.linspace(2.9, 4.1, 50)
    assert signal.equally_spaced
    np.testing.assert_allclose(signal.at(at), np.interp(at, time, values), atol=1e-12)
    slope = jax.jit(jax.grad(lambda x: vj.Sampled(time, x * values).at(jnp.asarray(3.33))))(1.0)
    assert slope == pytest.approx(np.interp(3.33, time, values))


@pytest.mark.parametrize(
    ("time", "values", "message"),
    [
        ([0.0, 1.0, 1.0], [1.0, 2.0, 3.0], "time must rise, got 1 s then 1 s at index 2"),
        ([0.0, 1.0, 2.0], [1.0, np.nan, 3.0], "values must be finite, got nan at index 1"),
        ([0.0, 1.0, 2.0], [1.0, 2.0], "time has 3 samples and values have 2"),
        ([0.0], [1.0], "time must be a list of at least 2 samples"),
    ],
)
def test_what_is_no_record_is_refused(time, values, message):
    with pytest.raises(ValueError, match=message):
        vj.Sampled(time, values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([3.0, 2.0],), "frequencies must increase strictly"),
        (([2.0, 3.0], [1.0]), "shares must be one number for every frequency"),
        (([2.0, 3.0], None, [0.0, np.inf]), "phases must be finite"),
    ],
)
def test_what_are_no_tones_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        vj.Tones(*arguments)


def test_tones_are_the_sum_of_harmonics():
    time = jnp.linspace(0.0, 1.0, 37)
    drive = vj.BaseMotion(2e-3)
    tones = vj.Tones([3.0, 7.0], [1.0, 0.5], [0.2, 0.0])
    first, second = 2 * np.pi * 3, 2 * np.pi * 7
    expected = first**2 * np.sin(first * time + 0.2) + 0.5 * second**2 * np.sin(second * time)
    np.testing.assert_allclose(drive.input(tones, time), 2e-3 * expected, atol=1e-12)
    with pytest.raises(ValueError, match="A Tones has no drive phase"):
        tones.phase(jnp.zeros(()))


def test_pulses():
    half = vj.model.half_sine(9.0, 0.02)
    at = jnp.linspace(0.0, 0.02, 777)
    np.testing.assert_allclose(half.at(at), 9 * np.sin(np.pi * at / 0.02), atol=9 * 1.3e-6)
    saw = vj.model.sawtooth(9.0, 0.02)
    np.testing.assert_allclose(saw.at(jnp.array([0.01, 0.02, 0.03])), [4.5, 9.0, 0.0])
    flat = vj.model.trapezoid(9.0, 0.02, 0.004, 0.002)
    at = jnp.array([0.002, 0.01, 0.019, 0.5])
    np.testing.assert_allclose(flat.at(at), [4.5, 9.0, 4.5, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="rise and fall must be at most the duration"):
        vj.model.trapezoid(9.0, 0.02, 0.015, 0.01)


@pytest.mark.parametrize("sides", [1, 2])
def test_noise_has_the_density_asked_for(sides):
    asked = {"frequencies": [10.0, 40.0, 200.0], "density": [1e-3, 0.05, 0.05]}
    noise = vj.model.random_signal(**asked, duration=120.0, seed=4, sides=sides)
    rate = (noise.time.size - 1) / 120.0
    frequency, density = scipy.signal.welch(np.asarray(noise.values), rate, nperseg=2**13)
    flat = (frequency > 50) & (frequency < 190)
    rising = (frequency > 15) & (frequency < 35)
    slope = np.log(50) / np.log(4)
    expected = 1e-3 * (frequency[rising] / 10) ** slope
    assert np.mean(density[flat]) == pytest.approx(sides * 0.05, rel=0.02)
    assert np.mean(density[rising] / expected) == pytest.approx(sides, rel=0.08)
    assert np.max(density[frequency > 210]) < 1e-6


def test_noise_is_that_of_its_seed():
    def noise(seed):
        return np.asarray(vj.model.random_signal([10.0, 40.0], [1.0, 1.0], 1.0, seed=seed).values)

    np.testing.assert_array_equal(noise(1), noise(1))
    assert np.any(noise(1) != noise(2))
    with pytest.raises(ValueError, match="sampling_rate must be at least twice"):
        vj.model.random_signal([10.0, 40.0], [1.0, 1.0], 1.0, seed=1, sampling_rate=70.0)
    with pytest.raises(ValueError, match="Take a longer one"):
        vj.model.random_signal([10.0, 11.0], [1.0, 1.0], 0.01, seed=1)
