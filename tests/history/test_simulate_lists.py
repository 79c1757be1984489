import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj


@pytest.fixture(scope="module")
def make(rig):
    def one(gap=0.4e-3, force=0.0):
        system = rig(gap=gap, num_modes=2)
        drive = vj.PointForce(force, 0.3) if force else system.drive
        return vj.ImpactingBeam(system.beam, system.stops, drive, 0.02, 2)

    return one


def test_every_lane_is_that_of_a_single_call(make):
    settings = {"frequency_ratio": 1.1, "periods": 4, "samples_per_period": 48}
    found = vj.simulate(make, gap=[0.2e-3, 0.4e-3], **settings)
    assert (found.shape, len(found)) == ((2,), 2)
    for gap, history in zip((0.2e-3, 0.4e-3), found, strict=True):
        single = vj.simulate(make(gap), **settings)
        np.testing.assert_allclose(history.time, single.time, rtol=1e-14)
        size = float(jnp.max(jnp.abs(single.displacement())))
        np.testing.assert_allclose(history.displacement(), single.displacement(), atol=1e-5 * size)
        assert history.status == vj.Status.completed.value
        assert float(history.system.stops[0].gap) == gap
    assert float(found.at(gap=0.21e-3).system.stops[0].gap) == 0.2e-3
    dataset = found.to_xarray()
    assert dataset["tip_displacement"].dims == ("gap", "time")
    assert dataset["tip_displacement"].attrs["units"] == "m"
    assert list(dataset["status"].values) == ["completed", "completed"]
    np.testing.assert_array_equal(dataset["gap"], [0.2e-3, 0.4e-3])
    with pytest.raises(IndexError):
        found[2]
    with pytest.raises(ValueError, match=r"Unknown axis 'gab'. Did you mean 'gap'"):
        found.at(gab=1.0)


@pytest.mark.slow
def test_releases_and_frequencies_are_axes_too(make):
    free = vj.simulate(
        lambda gap: vj.ImpactingBeam(make().beam, make(gap).stops, num_modes=2),
        release=[-1e-3, -2e-3],
        gap=[0.2e-3, 0.4e-3, 0.6e-3],
        duration=0.02,
        sampling_rate=10_000,
    )
    assert free.axes.keys() == {"gap", "release"}
    assert free.shape == (3, 2)
    assert free.lanes.time.shape == (6, 201)
    starts = [float(history.displacement()[0]) for history in free]
    np.testing.assert_allclose(starts, np.tile([-1e-3, -2e-3], 3))
    assert float(free.at(gap=0.6e-3, release=-2e-3).system.stops[0].gap) == 0.6e-3
    with pytest.raises(ValueError, match="Give a value of release too"):
        free.at(gap=0.6e-3)
    driven = vj.simulate(make, force=0.1, frequency=[9.0, 11.0], periods=2)
    dataset = driven.to_xarray()
    assert dataset["time"].dims == ("frequency", "sample")
    np.testing.assert_allclose(dataset["time"][:, -1], [2 / 9, 2 / 11])


def test_new_numbers_do_not_compile_again(make):
    from vibrojax.history.simulate import _solve_all

    settings = {"frequency_ratio": 1.1, "periods": 1, "samples_per_period": 48}
    vj.simulate(make, gap=[0.2e-3, 0.4e-3], **settings)
    before = len(_solve_all.programs)
    vj.simulate(make, gap=[0.3e-3, 0.5e-3], **settings)
    assert len(_solve_all.programs) == before


def test_wrong_input_is_refused_before_anything_runs(make):
    with pytest.raises(ValueError, match=r"release = .* starts .* inside a stop"):
        vj.simulate(make, release=[-1e-3, 5e-3], frequency=9.0, periods=1)
    with pytest.raises(ValueError, match="Unknown argument 'gab'"):
        vj.simulate(make, gab=[1e-3], frequency=9.0, periods=1)
    with pytest.raises(ValueError, match="frequency must be a non-empty list of finite numbers"):
        vj.simulate(make, frequency=[], periods=1)
    with pytest.raises(ValueError, match=r"histories would have .* samples"):
        vj.simulate(make, frequency=[9.0, 11.0], duration=0.5)


def test_a_function_without_a_list_gives_one_history(make):
    settings = {"frequency_ratio": 1.1, "periods": 1, "samples_per_period": 48}
    found = vj.simulate(make, gap=0.2e-3, **settings)
    assert isinstance(found, vj.history.History)
    np.testing.assert_array_equal(
        found.displacement(), vj.simulate(make(0.2e-3), **settings).displacement()
    )
    last = jax.jit(lambda gap: vj.simulate(make, gap=gap, **settings).displacement()[-1])
    np.testing.assert_allclose(last(0.2e-3), found.displacement()[-1], rtol=1e-6)


def test_lists_cannot_be_traced(make):
    def several(rig):
        return vj.simulate(rig, frequency=[9.0, 11.0], periods=1).lanes.time

    with pytest.raises(ValueError, match=r"simulate over lists cannot be traced.*system holds"):
        eqx.filter_jit(several)(jax.tree.map(jnp.asarray, make()))


def test_sampling_rate(make):
    history = vj.simulate(make(), frequency=9.0, duration=0.25, sampling_rate=2048)
    np.testing.assert_allclose(jnp.diff(history.time), 1 / 2048)
    highest = float(make().modes().frequency[-1])
    with pytest.raises(ValueError, match="sampling_rate must be at least twice the highest"):
        vj.simulate(make(), frequency=9.0, duration=0.25, sampling_rate=1.9 * highest)
    vj.simulate(make(), frequency=9.0, duration=0.05, sampling_rate=2.1 * highest)
    with pytest.raises(ValueError, match="Give samples or sampling_rate"):
        vj.simulate(make(), frequency=9.0, duration=0.25, sampling_rate=2e3, samples=100)
    with pytest.raises(ValueError, match="JAX is tracing"):
        jax.jit(lambda f: vj.simulate(make(), frequency=f, periods=1, sampling_rate=2e3).time)(9.0)


def test_initial_states_and_a_chirp(make):
    starts = [([1e-4, 0.0], [0.0, 0.0]), ([-1e-4, 1e-5], [1e-3, 0.0])]
    settings = {"waveform": vj.Chirp(8.0, 11.0, 0.3), "duration": 0.3, "samples": 384}
    found = vj.simulate(make(), initial_states=starts, **settings)
    assert found.shape == (2,)
    np.testing.assert_array_equal(found.axes["start"], [1, 2])
    swapped = vj.simulate(make(), initial_states=starts[::-1], **settings)
    for k, (q, rate) in enumerate(starts):
        np.testing.assert_allclose(found[k].coordinates[0], q)
        np.testing.assert_allclose(found[k].rates[0], rate)
        other = swapped[1 - k].displacement()
        size = float(jnp.max(jnp.abs(other)))
        np.testing.assert_allclose(found[k].displacement(), other, atol=1e-9 * size)
    assert float(found[0].motion.waveform.phase(jnp.asarray(0.3))[1]) == 2 * np.pi * 11.0
    assert found.to_xarray()["tip_displacement"].dims == ("start", "time")
    cycles = found.cycles(threshold=0.0)
    assert set(cycles.history) == {1, 2}
    alone = found[1].cycles(threshold=0.0)
    np.testing.assert_allclose(cycles.drive_periods[cycles.history == 2], alone.drive_periods)
    for other in ({"release": -1e-3}, {"initial_state": starts[0]}):
        with pytest.raises(ValueError, match=r"Give initial_state.* or .*, not both"):
            vj.simulate(make(), initial_states=starts, frequency=9.0, periods=1, **other)
    with pytest.raises(ValueError, match=r"initial_states must be a list of \(q, q'\)"):
        vj.simulate(make(), initial_states=[], frequency=9.0, periods=1)
    with pytest.raises(ValueError, match=r"shape \(2,\) each"):
        vj.simulate(make(), initial_states=[([0.0], [0.0])], frequency=9.0, periods=1)
