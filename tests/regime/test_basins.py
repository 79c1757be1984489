"""Basins of the 1-DOF impact oscillator x'' + 0.1 x' + x + 50 max(x - gap, 0) = 0.3 cos(w t)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from splitting_settings import with_settings

import vibrojax as vj
from vibrojax.model.systems import as_arrays
from vibrojax.plot.regime import plot_orbits
from vibrojax.regime.basins_result import boundary_share, standard_error, wilson_interval

X, SPEED = np.linspace(-2.0, 1.0, 11), np.linspace(-2.0, 2.0, 11)
BISTABLE, THREEFOLD, CHAOTIC = (w / (2 * np.pi) for w in (1.3, 0.86, 0.9))


def make(gap=1.0):
    return vj.MatrixSystem(
        [[1.0]],
        [[0.1]],
        [[1.0]],
        stops=vj.Stop(None, gap, vj.KelvinVoigt(50.0)),
        stop_map=[[1.0]],
        drive=vj.PointForce(0.3),
        input_map=[1.0],
        response_map=[1.0],
    )


def start(x, speed):
    return [x], [speed]


PLANE = {"start": start, "x": X, "speed": SPEED, "progress": False}


@pytest.fixture(scope="module")
def bistable():
    return vj.basins(make(), frequency=BISTABLE, units={"x": "m", "speed": "m/s"}, **PLANE)


def amplitudes(frequency, periods=60, steps=500):
    """Half of peak to peak of the last period from every start: plain Runge-Kutta steps."""
    w = 2 * np.pi * frequency
    x, v = (a.copy() for a in np.meshgrid(X, SPEED, indexing="ij"))
    h = 2 * np.pi / w / steps

    def pull(t, x, v):
        return v, 0.3 * np.sin(w * t) - 0.1 * v - x - 50 * np.maximum(x - 1.0, 0)

    high, low = np.full_like(x, -np.inf), np.full_like(x, np.inf)
    for k in range(periods * steps):
        t = k * h
        a = pull(t, x, v)
        b = pull(t + h / 2, x + h / 2 * a[0], v + h / 2 * a[1])
        c = pull(t + h / 2, x + h / 2 * b[0], v + h / 2 * b[1])
        d = pull(t + h, x + h * c[0], v + h * c[1])
        x = x + h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
        v = v + h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
        if k >= (periods - 1) * steps:
            high, low = np.maximum(high, x), np.minimum(low, x)
    return (high - low) / 2


def test_two_basins_are_those_of_plain_integration(bistable):
    np.testing.assert_array_equal(bistable.period, [1, 1])
    size = amplitudes(BISTABLE)
    # The motion that touches nothing, of known amplitude, and the one that hits.
    w = 2 * np.pi * BISTABLE
    free = 0.3 / np.hypot(1 - w**2, 0.1 * w)
    quiet = int(np.argmin(np.abs(bistable.mean_displacement))) + 1
    expected = np.abs(size - free) < 0.05 * free
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(bistable.attractor == quiet, expected)
    # Power of the spring: x x', of amplitude free^2 w/2.
    assert bistable.strain_power_rms[quiet - 1] == pytest.approx(
        free**2 * w / 2 / np.sqrt(2), rel=1e-3
    )
    assert bistable.mean_displacement[quiet - 1] == pytest.approx(0.0, abs=1e-6)
    assert bistable.share[0] >= bistable.share[1]
    assert bistable.share.sum() == pytest.approx(1.0)
    assert bistable.cross_well.all()


def test_a_barrier_that_is_not_crossed():
    found = vj.basins(make(), frequency=BISTABLE, **PLANE, settings=vj.BasinSettings(barrier=5.0))
    assert not found.cross_well.any()


def test_phases_of_one_orbit_are_one_attractor_or_several(bistable):
    one = vj.basins(make(), frequency=THREEFOLD, **PLANE)
    np.testing.assert_array_equal(one.period, [3])
    assert one.share[0] == 1.0
    three = vj.basins(
        make(), frequency=THREEFOLD, **PLANE, settings=vj.BasinSettings(distinguish_phases=True)
    )
    np.testing.assert_array_equal(three.period, [3, 3, 3])
    assert three.share.sum() == pytest.approx(1.0)
    # A start one drive period further on its way is of the next phase.
    states = [([x], [v]) for x, v in zip(X[:4], SPEED[:4], strict=True)]
    ahead = [
        vj.simulate(make(), frequency=THREEFOLD, periods=1, initial_state=s, samples_per_period=8)
        for s in states
    ]
    later = [(float(h.coordinates[-1, 0]), float(h.rates[-1, 0])) for h in ahead]
    before = [(float(s[0][0]), float(s[1][0])) for s in states]
    table = np.array(before + later)

    def chosen(number, nothing):
        return jnp.asarray(table)[jnp.asarray(number, int)].reshape(2, 1)

    listed = vj.basins(
        make(),
        frequency=THREEFOLD,
        start=chosen,
        number=np.arange(8.0),
        nothing=np.arange(15.0),
        progress=False,
        settings=vj.BasinSettings(distinguish_phases=True),
    ).attractor[:, 0]
    assert (listed[:4] != listed[4:]).all()
    turn = {int(a): int(b) for a, b in zip(listed[:4], listed[4:], strict=True)}
    assert all(turn[int(a)] == b for a, b in zip(listed[:4], listed[4:], strict=True))


def test_motions_without_a_period_are_one_class():
    found = vj.basins(make(), frequency=CHAOTIC, **PLANE, settings=vj.BasinSettings(transient=60))
    np.testing.assert_array_equal(found.period, [0])
    assert found.periodic_share == 0.0
    assert found.cross_well.all()
    assert found.periods_marched.max() <= 60 + 2 * 24
    assert "no period" in repr(found)


def test_results_do_not_depend_on_neighbours_or_order(bistable):
    few = {"start": start, "x": X[3:9], "speed": SPEED[2:8], "progress": False}
    found = vj.basins(make(), frequency=BISTABLE, **few)
    part = bistable.attractor[3:9, 2:8]
    same = {int(a): int(b) for a, b in zip(part.ravel(), found.attractor.ravel(), strict=True)}
    np.testing.assert_array_equal(np.vectorize(same.get)(part), found.attractor)
    for a, b in same.items():
        assert bistable.mean_displacement[a - 1] == pytest.approx(
            found.mean_displacement[b - 1], abs=2e-3
        )

    def swapped(speed, x):
        return [x], [speed]

    settings = {"speed": SPEED, "x": X, "progress": False}
    other = vj.basins(make(), frequency=BISTABLE, start=swapped, **settings)
    np.testing.assert_array_equal(other.attractor, bistable.attractor.T)


def test_new_numbers_do_not_compile_again(bistable):
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    vj.basins(
        make(),
        frequency=1.01 * BISTABLE,
        **PLANE,
        settings=vj.BasinSettings(period_tolerance=0.012),
    )
    assert not compiled


def test_random_starts_and_axes():
    box = {"start": start, "x": vj.Range(-2, 1), "speed": vj.Range(-2, 2), "progress": False}
    settings = {"starts": 60, "seed": 3}
    found = vj.basins(make, frequency=[BISTABLE, 0.4], gap=[1.0], **settings, **box)
    assert found.attractor.shape == (1, 2, 60)
    assert found.share.shape == (1, 2, 2)
    np.testing.assert_array_equal(found.period[0, 1], [1, -1])
    assert np.isnan(found.mean_displacement[0, 1, 1])
    again = vj.basins(make, frequency=[BISTABLE, 0.4], gap=[1.0], **settings, **box)
    np.testing.assert_array_equal(found.attractor, again.attractor)
    data = found.to_xarray()
    assert data["attractor"].dims == ("gap", "frequency", "start")
    assert data["x"].dims == ("start",)
    with pytest.raises(ValueError, match="Random starts have no cells"):
        _ = found.boundary_share
    with pytest.raises(ValueError, match="Give a value of frequency too"):
        found.plot()
    figure = found.plot(frequency=BISTABLE)
    assert "frequency" in figure.axes[0].get_title(loc="left")


def test_errors_of_shares():
    assert standard_error(0.5, 100) == pytest.approx(0.05)
    low, high = wilson_interval(np.array([0.0, 0.5]), 100)
    # Of 0 successes in 100 the upper end is z^2/(n + z^2).
    z = 1.959963984540054
    assert high[0] == pytest.approx(z**2 / (100 + z**2))
    assert low[0] == pytest.approx(0.0, abs=1e-12)
    assert (low[1], high[1]) == pytest.approx((0.40383, 0.59617), abs=1e-5)
    halves = np.repeat([[1] * 5 + [2] * 5], 4, axis=0)
    assert boundary_share(halves) == pytest.approx(0.2)


def test_dataset_file_and_picture(bistable, tmp_path):
    import xarray

    data = bistable.to_xarray()
    assert data["attractor"].dims == ("x", "speed")
    assert data["x"].attrs["units"] == "m"
    for name in data.data_vars:
        assert {"units", "long_name"} <= set(data[name].attrs)
    assert (data["share_low"] <= data["share"]).all()
    assert float(data["boundary_share"]) == bistable.boundary_share > 0
    bistable.save(tmp_path / "basins.nc")
    with xarray.open_dataset(tmp_path / "basins.nc", engine="h5netcdf") as loaded:
        np.testing.assert_array_equal(loaded["attractor"], bistable.attractor)
    figure = bistable.plot()
    assert figure.axes[0].get_xlabel() == "x (m)"
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(words) == 2
    assert all("period 1" in one and "±" in one for one in words)
    figure.savefig(tmp_path / "basins.png")
    assert "cells at a boundary" in repr(bistable)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"start": lambda x: ([x], [x])}, "start must be a function of two named numbers"),
        ({"start": lambda x, y: ([x], [y])}, "Give a list of y"),
        ({"start": lambda x, speed: ([x, x], [speed])}, r"of shape \(1,\) each"),
        ({"start": lambda x, speed: ([np.inf * x], [speed])}, "finite numbers"),
        ({"x": [1.0, 0.0]}, "x must be a list of at least two increasing"),
        ({"gab": 1.0}, "Unknown argument 'gab'"),
        ({"starts": 7}, "starts = 7 is for random ones: give x and speed as vj.Range"),
        ({"starts": np.eye(2)}, "^starts = .{1,60} is for random ones"),
        ({"start_size": 1.0}, "start_size is for random states"),
        ({"periods": 10}, "periods must be a whole number of at least 24"),
        ({"period_tolerance": 0.0}, "period_tolerance must be above 0"),
        ({"frequency_ratio": 1.0}, "frequency_ratio or frequency"),
        ({"units": {"y": "m"}}, "units are of the numbers of start"),
    ],
)
def test_refusals(arguments, sentence):
    settings = {"frequency": BISTABLE, **PLANE} | arguments
    with pytest.raises(ValueError, match=sentence):
        vj.basins(make(), **with_settings(vj.BasinSettings, settings))


def test_a_map_of_basin_fractions(bistable):
    response = vj.maps.BasinFractions(start, x=X, speed=SPEED)
    found = vj.parameter_map(
        make, frequency=[BISTABLE, 0.4], gap=[1.0, 3.0], response=response, progress=False
    )
    assert found["attractors"].dims == ("gap", "frequency")
    np.testing.assert_array_equal(found["attractors"], [[2, 1], [1, 1]])
    point = found.isel(gap=0, frequency=0)
    assert float(point["largest_share"]) == pytest.approx(bistable.share[0])
    assert float(point["largest_share_error"]) == pytest.approx(bistable.standard_error[0])
    np.testing.assert_array_equal(found["periodic_share"], 1.0)
    np.testing.assert_array_equal(found["most_attractors"], [2, 1])
    assert "periodic" in found["lane_status"].attrs["flag_meanings"]
    # What a store knows a response by does not depend on where Python keeps the function.
    assert "0x" not in repr(response)
    assert repr(response) != repr(
        vj.maps.BasinFractions(
            lambda x, speed: ([-x], [speed]), x=vj.Range(0.0, 1.0), speed=vj.Range(0.0, 1.0)
        )
    )
    with pytest.raises(ValueError, match="Unknown argument 'angle'"):
        vj.maps.BasinFractions(
            start, angle=vj.Range(0.0, 1.0), x=vj.Range(0.0, 1.0), speed=vj.Range(0.0, 1.0)
        )


# Coexisting motions of a beam: random states, and their branches


def test_states_are_counted_or_given(rig):
    with pytest.raises(ValueError, match="starts must be"):
        vj.basins(rig(), frequency_ratio=1.1, starts=0)
    with pytest.raises(ValueError, match="start_size must be"):
        vj.basins(rig(), frequency_ratio=1.1, start_size=-1.0)
    with pytest.raises(ValueError, match="Unknown argument"):
        vj.basins(rig(), frequency_ratio=1.1, gap=1e-3)


@pytest.mark.slow
def test_both_motions_of_the_hysteresis_are_found_and_lie_on_one_branch(rig, small_branch):
    found = vj.basins(rig(num_modes=1), frequency_ratio=1.15, starts=24)
    here = small_branch.resample([1.15])
    stable = np.asarray(here.amplitude_ratio)[np.asarray(here.stable) == 1]
    assert found.period.tolist() == [1, 1]
    np.testing.assert_allclose(sorted(found.amplitude_ratio), sorted(stable), rtol=1e-4)
    assert found.start_states.shape == (24, 2)
    again = vj.basins(rig(num_modes=1), frequency_ratio=1.15, starts=24)
    np.testing.assert_array_equal(again.attractor, found.attractor)
    (branch,) = found.branches(vj.Range(0.85, 1.4))  # the second motion lies on that of the first
    np.testing.assert_allclose(sorted(branch.folds), sorted(small_branch.folds), atol=1e-6)
    history = found.history(2)
    np.testing.assert_allclose(history.states[-1], found.initial_state[1], atol=1e-8)
    assert found.to_xarray()["start_state"].dims == ("start", "state")
    assert len(found.plot_orbits().axes[0].lines) == 4
    with pytest.raises(ValueError, match="not two numbers"):
        found.plot()


def by_hand(axes, period):
    """Basins of three starts at every place of one axis, or of none."""
    *over, found = np.shape(period)
    there = np.where(np.array(period) < 0, np.nan, 1e-3)
    names = ("mean_displacement", "strain_power_rms", "amplitude_ratio", "contact_force")
    return vj.regime.Basins(
        axes=axes,
        starts={},
        start_states=np.zeros((3, 2)),
        sampling="random",
        attractor=np.ones((*over, 3), int),
        period=np.array(period),
        cross_well=np.zeros_like(period, bool),
        **dict.fromkeys(names, there),
        initial_state=np.zeros((*over, found, 2)),
        periods_marched=np.ones((*over, 3), int),
        systems=jax.tree.map(lambda a: a[None], as_arrays(vj.default_rig(num_modes=1))),
        frequency_axis="frequency_ratio",
        frequencies=np.array([1.1]),
        units={},
        attributes={},
    )


def test_an_attractor_that_only_another_place_has_is_no_attractor():
    found = by_hand({"gap": np.array([1e-4, 2e-4])}, [[1, 2], [1, -1]])
    assert found.name_of(2, (0,)) == "period 2"
    with pytest.raises(ValueError, match="attractor must be a whole number from 1 to 1, got 2"):
        found.name_of(2, (1,))


def test_a_picture_of_orbits_at_one_place_begins_with_no_mark():
    drawn = by_hand({}, [1]).to_xarray()
    figure = plot_orbits(drawn, [(np.zeros(5), np.ones(5))], ["period 1"], 4)
    assert figure.axes[0].get_title("left") == "dots: drive phase 0"
