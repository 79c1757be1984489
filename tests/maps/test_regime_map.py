"""Regimes in parameter maps."""

import numpy as np
import pytest
from unit_oscillator import oscillator

import vibrojax as vj

UNIT = 2 * np.pi
SETTINGS = {
    "transient": 150,
    "periods": 120,
    "max_period": 8,
    "samples_per_period": 16,
    "spectrum": False,
}
W = np.array([0.87, 0.89, 0.94])
GAPS = [1.0, 10.0]


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "regimes.zarr"
    response = vj.RegimeSettings(
        strobes=True,
        observables=("displacement",),
        **SETTINGS,
    )

    def run():
        return vj.parameter_map(
            oscillator,
            frequency=W / UNIT,
            gap=GAPS,
            response=response,
            store=path,
            progress=False,
        )

    return run(), run


def test_a_map_is_its_bifurcation_diagrams(mapped):
    found, _ = mapped
    diagram = vj.bifurcation_diagram(
        oscillator,
        frequency=W / UNIT,
        gap=GAPS,
        progress=False,
        settings=vj.RegimeSettings(**SETTINGS),
    )
    assert found.regime.dims == ("gap", "direction", "frequency")
    assert found.displacement.dims == ("gap", "direction", "frequency", "strobe")
    for name in ("period", "regime", "lyapunov_exponent", "strain_power_rms", "displacement"):
        np.testing.assert_allclose(found[name], diagram[name], rtol=1e-7, err_msg=name)
    assert found.strain_power_rms.attrs["units"] == "W"
    assert "quasi_periodic" in found.regime.attrs["flag_meanings"]


def test_measures_of_regimes(mapped):
    found, _ = mapped
    chaotic = found.regime == vj.Regime.chaotic.value
    np.testing.assert_allclose(found.chaotic_fraction, chaotic.mean(["direction", "frequency"]))
    assert float(found.chaotic_fraction[0]) == pytest.approx(1 / 6)
    assert found.periodic_fraction.values.tolist() == pytest.approx([5 / 6, 1.0])
    np.testing.assert_allclose(
        found.largest_strain_power, found.strain_power_rms.max(["direction", "frequency"])
    )
    assert found.largest_lyapunov_exponent[0] > 0 > found.largest_lyapunov_exponent[1]
    assert (found.displacement_max > found.displacement_rms).all()


def test_a_stored_map_is_not_computed_again(mapped):
    import time

    found, run = mapped
    before = time.perf_counter()
    again = run()
    assert time.perf_counter() - before < 5
    np.testing.assert_array_equal(again.lyapunov_exponent, found.lyapunov_exponent)


@pytest.mark.slow
def test_only_periodic_motions_have_derivatives():
    found = vj.parameter_map(
        oscillator,
        frequency=W / UNIT,
        gap=GAPS,
        response=vj.RegimeSettings(**SETTINGS),
        measures=["chaotic_fraction"],
        gradients=["gap"],
        keep_curves=True,
        progress=False,
    )
    slope = found.d_amplitude_ratio_d_gap
    periodic = (found.period > 0).values
    assert np.isnan(slope.values[~periodic]).all()
    assert np.isfinite(slope.values[periodic]).all()
    np.testing.assert_allclose(slope.sel(gap=10.0), 0.0, atol=1e-9)
    assert (slope.sel(gap=1.0, frequency=W[-1] / UNIT) > 1).all()


def test_wrong_settings_are_refused_before_anything_runs():
    with pytest.raises(ValueError, match="direction must be one of"):
        vj.RegimeSettings(
            direction="up", periods=100, max_period=16, samples_per_period=32, spectrum=False
        )
    with pytest.raises(ValueError, match="periods must be a whole number of at least 32"):
        vj.RegimeSettings(periods=4, max_period=16, samples_per_period=32, spectrum=False)
    unknown = vj.RegimeSettings(
        observables=("chord_reducton",),
        **SETTINGS,
    )
    with pytest.raises(ValueError, match="Unknown observable 'chord_reducton'"):
        vj.parameter_map(oscillator, frequency=0.2, gap=GAPS, response=unknown)
    with pytest.raises(ValueError, match="'regimes'"):
        vj.parameter_map(oscillator, frequency=0.2, gap=GAPS, response="regime")
