"""Period of a motion on the stroboscopic map, on signals whose period is known."""

import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.steady.observed import period_number

COUNT, LONGEST = 80, 20


def found(signals, tolerance=0.02, longest=LONGEST):
    """Period of scalar signals (count, lanes)."""
    strobes = jnp.asarray(np.atleast_2d(np.asarray(signals, float).T).T)[:, None, :]
    return [np.asarray(a) for a in period_number(strobes, tolerance, longest)]


def repeating(n, seed=0):
    pattern = np.random.default_rng(seed + n).normal(size=n) if n > 1 else np.ones(1)
    return pattern[np.arange(COUNT) % n]


def test_every_period_up_to_the_longest_is_found():
    orders = np.arange(1, 24)
    period, error = found(np.stack([repeating(n) for n in orders], axis=1))
    np.testing.assert_array_equal(period, np.where(orders <= LONGEST, orders, 0))
    assert (error[period > 0] == 0).all()
    assert (error[period == 0] > 0.02).all()


@pytest.mark.parametrize("order", [1, 3, 7])
def test_noise_hides_a_period_only_beyond_the_tolerance(order):
    signal = repeating(order)
    size = np.std(signal) if order > 1 else 1.0
    noise = np.random.default_rng(7).uniform(-1, 1, COUNT)
    quiet, loud = (signal + level * size * noise for level in (0.8e-2, 3e-2))
    period, error = found(np.stack([quiet, loud], axis=1))
    assert period.tolist() == [order, 0]
    assert 0.008 < error[0] < 0.02 < error[1]


def test_motion_on_a_torus_has_no_period_however_slowly_it_turns():
    turns = np.array([(np.sqrt(5) - 1) / 2, 2e-3, 1 / 3 + 1e-3])
    angle = 2 * np.pi * turns * np.arange(COUNT)[:, None]
    strobes = jnp.asarray(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert period_number(strobes, 0.02, LONGEST)[0].tolist() == [0, 0, 0]


def test_a_small_split_is_a_doubling_as_soon_as_the_tolerance_says_so():
    split = np.array([0.01, 0.03])
    signal = 1 + split / 2 * np.where(np.arange(COUNT) % 2, 1, -1)[:, None]
    assert found(signal)[0].tolist() == [1, 2]
    assert found(signal, tolerance=0.001)[0].tolist() == [2, 2]


def test_rest_and_lost_lanes():
    lost = np.ones(COUNT)
    lost[-3:] = np.nan
    period, error = found(np.stack([np.zeros(COUNT), np.full(COUNT, 1e-300), lost], axis=1))
    assert period.tolist() == [1, 1, 0]
    assert error[0] == 0
    assert error[2] == np.inf


def test_a_motion_that_has_not_come_to_rest_is_not_period_one():
    decay = 1 + np.exp(-np.arange(COUNT) / 40.0)
    assert found(decay)[0].tolist() == [0]


def test_logistic_map_at_known_parameters():
    window = 1 + np.sqrt(8) + 2e-3
    rates = np.array([2.8, 3.2, 3.5, 3.55, window, 4.0])
    x = np.full(len(rates), 0.3)
    record = []
    for k in range(20_000 + COUNT):
        x = rates * x * (1 - x)
        if k >= 20_000:
            record.append(x)
    assert found(np.stack(record))[0].tolist() == [1, 2, 4, 8, 3, 0]


def test_wrong_settings_are_refused():
    strobes = jnp.zeros((10, 1))
    with pytest.raises(ValueError, match="at least 2 max_period = 12 states, got 10"):
        period_number(strobes, 0.02, 6)
    with pytest.raises(ValueError, match="tolerance must be above 0"):
        period_number(strobes, 0.0, 2)
