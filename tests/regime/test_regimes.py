"""Which regime a system is in, over frequency, numbers of the rig and starts."""

import numpy as np
import pytest
from shown import check_result
from splitting_settings import with_settings
from unit_oscillator import oscillator

import vibrojax as vj
from vibrojax.regime import observing
from vibrojax.regime.observing import amplitude_spectrum, sides
from vibrojax.steady import observed
from vibrojax.steady.kinds import Regime, regime_of

UNIT = 2 * np.pi
PERIODS = 120
MARCHED = vj.RegimeSettings(transient=150, periods=PERIODS, max_period=8, samples_per_period=16)
SETTINGS = {"settings": MARCHED, "progress": False}
W = np.array([0.87, 0.9, 0.9331, 1.2])
"""Angular frequencies with period 3, chaos, period 1 and period 1."""


@pytest.fixture(scope="module")
def found():
    return vj.regimes(oscillator, frequency=W / UNIT, gap=[1.0, 10.0], **SETTINGS)


def test_kinds_of_the_impact_oscillator(found):
    kinds = [Regime(k).name for k in found.regime[0]]
    assert kinds == ["periodic", "chaotic", "periodic", "periodic"]
    assert found.period[0].tolist() == [3, 0, 1, 1]
    assert found.period[1].tolist() == [1, 1, 1, 1]
    exponent, error = found.lyapunov_exponent[0], found.lyapunov_standard_error[0]
    assert exponent[1] > 5 * error[1]
    np.testing.assert_allclose(exponent[[0, 3]], -0.05, rtol=0.03)
    assert found["contact_force"][0, :3].min() > 0
    assert (found["contact_force"][1] == 0).all()
    assert found.fraction("chaotic") == 1 / 8
    assert "chaotic" in repr(found)


def test_energies_of_a_linear_motion(found):
    amplitude = 0.3 / np.hypot(1 - W**2, 0.1 * W)
    lane = {name: values[1] for name, values in found.variables.items()}
    np.testing.assert_allclose(0.3 * lane["amplitude_ratio"], amplitude, rtol=2e-3)
    np.testing.assert_allclose(lane["displacement_rms"], amplitude / np.sqrt(2), rtol=2e-3)
    np.testing.assert_allclose(lane["strain_energy_mean"], amplitude**2 / 4, rtol=4e-3)
    power = amplitude**2 * W / 2 / np.sqrt(2)
    np.testing.assert_allclose(lane["strain_power_rms"], power, rtol=4e-3)
    np.testing.assert_allclose(lane["crossings_per_period"], 2.0, atol=0.02)
    assert (lane["cross_well"] == 1).all()


def test_strobes_and_spectrum_show_the_period(found):
    strobes = np.stack([found["displacement"][0, 0], found["velocity"][0, 0]], axis=1)
    assert len(np.unique(np.round(strobes, 4), axis=0)) == 3
    lines = found["spectrum"][0, 0]
    thirds = np.isclose(found.orders * 3 % 1, 0) | np.isclose(found.orders * 3 % 1, 1)
    assert found.orders[1] == 1 / PERIODS
    inside = np.isclose(found.orders, 1 / 3)
    assert lines[inside] > 0.03
    far = np.min(np.abs(found.orders[:, None] - found.orders[thirds]), axis=1) > 0.1
    assert lines[far].max() < 1e-2 * lines[inside]
    linear = found["spectrum"][1, 3]
    amplitude = 0.3 / np.hypot(1 - 1.2**2, 0.12)
    assert linear[np.isclose(found.orders, 1.0)] == pytest.approx(amplitude, rel=2e-3)


def test_lanes_do_not_know_of_each_other(found):
    turned = vj.regimes(oscillator, frequency=W[[0, 3]] / UNIT, gap=[10.0, 1.0], **SETTINGS)
    for name in ("lyapunov_exponent", "strain_power_rms", "contact_force", "return_error"):
        own = found[name][::-1][:, [0, 3]]
        np.testing.assert_allclose(turned[name], own, rtol=1e-6, atol=1e-9, err_msg=name)


def test_random_starts_are_the_same_for_a_seed_and_lie_outside_of_the_stop():
    before = len(observed.observe.programs), len(observing._sampled.programs)
    settings = SETTINGS | {"starts": 6, "frequency": W[:2] / UNIT}
    one = vj.regimes(oscillator(), seed=3, **settings)
    again = vj.regimes(oscillator(), seed=3, **settings)
    other = vj.regimes(oscillator(gap=1.1), seed=4, **settings)
    # Other numbers, and other numbers of rigs, run in the loops there are.
    after = len(observed.observe.programs), len(observing._sampled.programs)
    assert max(a - b for a, b in zip(after, before, strict=True)) <= 1
    assert one.dims == ("start", "frequency")
    np.testing.assert_array_equal(one.starts, again.starts)
    np.testing.assert_array_equal(one.lyapunov_exponent, again.lyapunov_exponent)
    assert (one.starts[:, 0] < 1.0).all()
    assert not np.allclose(one.starts, other.starts)
    # Several starts, one chaotic motion: the same within the error.
    chaotic, error = one.lyapunov_exponent[:, 1], one.lyapunov_standard_error[:, 1]
    assert (np.abs(chaotic - chaotic.mean()) < 4 * error).all()


def test_free_and_forced_oscillations_together_are_quasi_periodic():
    system = oscillator(gap=10.0, damping=0.0)
    starts = [[0.5, 0.0], [0.0, 0.3], [0.2, 0.2]]
    found = vj.regimes(system, frequency=0.73 / UNIT, starts=starts, **SETTINGS)
    assert found.regime.ravel().tolist() == [Regime.quasi_periodic.value] * 3
    np.testing.assert_allclose(found.lyapunov_exponent, 0.0, atol=2e-3)


def test_dataset_file_and_pictures(found, tmp_path):
    import xarray

    dataset = found.to_xarray()
    assert dataset.displacement.dims == ("gap", "frequency", "strobe")
    assert dataset.spectrum.dims == ("gap", "frequency", "order")
    assert dataset.regime.attrs["flag_meanings"].split()[2] == "chaotic"
    check_result(found)
    for name, variable in dataset.variables.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    assert dataset.strain_power_rms.attrs["units"] == "W"
    path = tmp_path / "regimes.nc"
    found.save(path)
    with xarray.open_dataset(path, engine="h5netcdf") as read:
        np.testing.assert_array_equal(read.period, dataset.period)
    for figure in (
        found.plot(),
        found.plot(gap=1.0),
        found.poincare(gap=1.0, frequency=0.9 / UNIT),
        found.poincare(gap=1.0),
        found.plot_spectrum(gap=1.0, frequency=0.87 / UNIT),
    ):
        figure.canvas.draw()
        assert all(a.get_ylabel() for a in figure.axes)
    with pytest.raises(ValueError, match="Unknown axis 'gab'"):
        found.plot(gab=1.0)
    with pytest.raises(ValueError, match="axes are left"):
        found.poincare()


def test_sides_of_a_barrier_on_known_signals():
    angle = np.linspace(0, 2 * np.pi * 10, 1000, endpoint=False)
    across = 1.5 + np.sin(angle)
    touching = 1.5 + np.maximum(np.sin(angle), -0.01)
    assert [a.tolist() for a in sides(np.stack([across, touching]), 1.5)] == [
        [True, False],
        [19, 0],
    ]
    assert sides(across[None], 0.0)[1].tolist() == [0]


def test_spectrum_of_known_lines():
    orders = vj.RegimeSettings(periods=60, samples_per_period=32).orders
    phase = np.arange(60 * 32) / 32
    signal = 0.4 + 2.0 * np.cos(2 * np.pi * phase) + 0.5 * np.sin(2 * np.pi * phase * 1.5)
    lines = amplitude_spectrum(signal[None], 60)[0]
    at = {order: lines[np.isclose(orders, order)].item() for order in (0.0, 0.5, 1.0, 1.5)}
    assert at == pytest.approx({0.0: 0.4, 0.5: 0.0, 1.0: 2.0, 1.5: 0.5}, abs=1e-9)


def test_kinds_from_periods_and_growths():
    period = np.array([2, 0, 0, 0, 0, 0, 3, 0])
    growth = np.array([-9.0, 30.0, 0.5, -40.0, 8.0, np.nan, 20.0, 0.1])
    error = np.array([0.1, 5.0, 1.0, 1.0, 6.0, np.nan, 1.0, 1.0])
    away = np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.03])
    alive = np.ones(8, bool)
    words = [Regime(k).word for k in regime_of(period, growth, error, away, 0.02, alive)]
    assert words == [
        "periodic",
        "chaotic",
        "quasi-periodic",
        "undecided",  # neighbours meet, but no period: longer, or not settled
        "undecided",  # within the error of the exponent
        "undecided",  # no exponent
        "undecided",  # returns, but neighbours part
        "undecided",  # nearly returns: a slow transient
    ]
    lost = regime_of(period, growth, error, away, 0.02, ~alive)
    assert (lost == Regime.diverged.value).all()


def test_a_lane_that_is_lost_is_flagged_and_spares_the_others():
    starts = [[0.0, 0.0], [0.1, 0.0], [1e200, 0.0]]
    found = vj.regimes(oscillator(), frequency=[0.87 / UNIT], starts=starts, **SETTINGS)
    assert found.regime[0, 0] == Regime.periodic.value
    if found.regime[2, 0] == Regime.diverged.value:
        assert np.isnan(found["strain_power_rms"][2, 0])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "Give frequency_ratio or frequency"),
        ({"frequency": [0.2, 0.1]}, "frequency must increase strictly"),
        ({"frequency": 0.2, "periods": 30}, "periods must be a whole number of at least 40"),
        ({"frequency": 0.2, "period_tolerance": 0.0}, "period_tolerance must be above 0"),
        ({"frequency": 0.2, "barrier": np.nan}, "barrier must be a finite number"),
        ({"frequency": 0.2, "starts": 0}, "starts must be a whole number"),
        ({"frequency": 0.2, "starts": [[0.0]]}, r"states \(q, q'\) of shape \(starts, 2\)"),
        ({"frequency": 0.2, "starts": 3, "start_size": -1.0}, "start_size must be above 0 m"),
        ({"frequency": 0.2, "start_size": 1.0}, "start_size is for random starts"),
        ({"frequency": 0.2, "gab": [1.0]}, "Did you mean 'gap'"),
    ],
)
def test_wrong_input_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        vj.regimes(oscillator, **with_settings(vj.RegimeSettings, settings))
