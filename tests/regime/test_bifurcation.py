"""Bifurcation diagrams: the motion carried along a parameter, up and down."""

import numpy as np
import pytest
from splitting_settings import with_settings
from unit_oscillator import oscillator

import vibrojax as vj
from vibrojax.ensemble.lanes import lanes_of
from vibrojax.regime.bifurcation import _lanes_along
from vibrojax.regime.table import PeriodChange

UNIT = 2 * np.pi
PERIODS = 120
MARCHED = vj.RegimeSettings(
    transient=150, periods=PERIODS, max_period=8, samples_per_period=16, spectrum=False
)
SETTINGS = {"settings": MARCHED, "progress": False}
W = np.array([0.87, 0.89, 0.915, 0.925, 0.9275, 0.9295, 0.94])


@pytest.fixture(scope="module")
def diagram():
    return vj.bifurcation_diagram(oscillator, frequency=W / UNIT, gap=[1.0, 10.0], **SETTINGS)


def test_period_doubling_is_bracketed_in_both_directions(diagram):
    found = [c for c in diagram.period_doublings(gap=1.0) if c.period_high == 1]
    assert [c.direction for c in found] == ["forward", "backward"]
    for change in found:
        assert change.low * UNIT < 0.9285 < change.high * UNIT
        assert change.period_low == 2
    assert diagram.period_doublings(gap=10.0) == []


def test_directions_differ_where_motions_coexist(diagram):
    assert diagram.dims == ("gap", "direction", "frequency")
    assert diagram["displacement"].shape == (2, 2, len(W), PERIODS)
    period, regime = diagram.period[0], diagram.regime[0]
    assert period[0, :2].tolist() == [3, 3]
    assert regime[1, 1] == vj.Regime.chaotic.value  # the chaos that comes down from above
    assert (period[:, -1] == 1).all()
    assert (diagram.period[1] == 1).all()
    spread = np.ptp(diagram["displacement"][0], axis=-1)
    assert (spread[:, -1] < 1e-6).all()


def test_first_values_are_those_of_regimes(diagram):
    alone = vj.regimes(oscillator, frequency=W[:1] / UNIT, gap=[1.0, 10.0, 12.0], **SETTINGS)
    for name in ("period", "lyapunov_exponent", "strain_power_rms"):
        np.testing.assert_allclose(
            diagram[name][:, 0, 0], alone[name][:2, 0], rtol=1e-6, err_msg=name
        )


def test_what_is_carried():
    lanes = lanes_of(oscillator, {"gap": [1.0, 1.1, 1.2], "damping": [0.1, 0.2]})
    grid = np.array([0.1, 0.2, 0.3, 0.4])
    paths = _lanes_along(lanes, "frequency", grid, None)
    assert paths.name == "frequency"
    assert paths.rig.shape == (6, 4)
    np.testing.assert_array_equal(paths.rig, np.arange(6)[:, None] * np.ones(4))
    np.testing.assert_array_equal(paths.frequency, np.ones((6, 1)) * grid)
    paths = _lanes_along(lanes, "frequency", grid, "gap")
    assert list(paths.axes) == ["damping", "frequency"]
    assert paths.rig.shape == (8, 3)
    np.testing.assert_array_equal(paths.rig[0], [0, 2, 4])
    np.testing.assert_array_equal(paths.rig[4], [1, 3, 5])
    np.testing.assert_array_equal(paths.frequency[:, 0], np.tile(grid, 2))
    only = lanes_of(oscillator, {"gap": [1.0, 1.1]})
    assert _lanes_along(only, "frequency", grid[:1], None).name == "gap"


def test_doublings_among_changes():
    ends = [(1, 2, True), (4, 2, True), (0, 4, False), (2, 3, False), (0, 0, False)]
    for low, high, doubles in ends:
        assert PeriodChange("forward", 0.0, 1.0, low, high).is_doubling == doubles


def test_dataset_and_picture(diagram):
    dataset = diagram.to_xarray()
    assert dataset.displacement.dims == ("gap", "direction", "frequency", "strobe")
    assert dataset.direction.values.tolist() == ["forward", "backward"]
    figure = diagram.plot(gap=1.0)
    figure.canvas.draw()
    assert all(axes.get_ylabel() for axes in figure.axes)
    assert figure.axes[-1].get_xlabel() == "Drive frequency (Hz)"
    diagram.plot(gap=1.0, direction="backward").canvas.draw()
    with pytest.raises(ValueError, match="Give a value of gap"):
        diagram.plot()
    assert "BifurcationDiagram(gap: 2, direction: 2, frequency: 7)" in repr(diagram)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frequency": [0.2, 0.3], "along": "gap"}, "along must name a list, got 'gap'"),
        ({"frequency": 0.2, "gap": [1.1, 1.0]}, "gap must increase strictly, got 1.1 then 1.0"),
        ({"frequency": 0.2, "gap": [1.0, 1.1], "damping": [0.1, 0.2]}, "say which the motion"),
        ({"frequency": 0.2, "direction": "up"}, "direction must be one of"),
        ({"frequency": 0.2, "start": [0.0]}, r"start must be .* of shape \(2,\), got"),
        ({"frequency": 0.2, "periods": 10}, "periods must be a whole number of at least 40"),
    ],
)
def test_wrong_input_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        vj.bifurcation_diagram(oscillator, **with_settings(vj.RegimeSettings, settings))


def test_directions_have_a_long_name():
    lanes, kinds = (2, 3), ("period", "regime", "lyapunov_exponent", "lyapunov_standard_error")
    diagram = vj.regime.BifurcationDiagram(
        parameter="frequency",
        values=np.arange(1.0, 4.0),
        directions=("forward", "backward"),
        axes={},
        variables={name: np.zeros(lanes, int) for name in kinds},
        orders=None,
        ratio_units="1",
        attributes={},
    )
    about = diagram.to_xarray()["direction"].attrs
    assert about == {"units": "1", "long_name": "Direction of the sweep"}
