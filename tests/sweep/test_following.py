"""Sweeps that follow settled motions: they are the sweeps that march, and march where they must."""

import json
import os
import subprocess
import sys

import jax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.steady import lane_pool
from vibrojax.steady.following import advance
from vibrojax.stepping.contact_phases import contact_phases

RATIOS = np.linspace(0.9, 1.4, 33)


def swept(system, settle, ratios=RATIOS, **settings):
    settings = vj.SweepSettings(settle=settle, **settings)
    return vj.frequency_sweep(system, frequency_ratio=ratios, settings=settings)


@pytest.fixture(scope="module")
def both(rig):
    return {settle: swept(rig(num_modes=1), settle) for settle in ("follow", "march")}


def test_it_is_the_sweep_that_marches_to_every_point(both):
    ours, theirs = both["follow"], both["march"]
    np.testing.assert_array_equal(ours.period, theirs.period)
    np.testing.assert_array_equal(ours.status, theirs.status)
    for name in ("amplitude_ratio", "peak_ratio", "rms_ratio", "first_harmonic_ratio"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=2e-6)
    np.testing.assert_array_equal(ours.contacts_per_period, theirs.contacts_per_period)
    np.testing.assert_allclose(ours.contact_force, theirs.contact_force, rtol=1e-3)
    for name in ("jump_up", "jump_down"):
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=2e-3)


def test_most_points_are_not_marched_to(both):
    assert (np.asarray(both["march"].periods_marched) > 0).all()
    marched = np.asarray(both["follow"].periods_marched) > 0
    assert (marched[0, 0], marched[1, -1]) == (True, True)  # where the sweeps begin, at rest
    assert marched.mean() < 0.35


@pytest.mark.usefixtures("on_a_cpu")
def test_a_call_solves_for_many_points_of_few_lanes(rig, both, monkeypatch):
    calls = []

    def counted(*given):
        calls.append(given[2].shape)
        return advance(*given)

    monkeypatch.setattr(lane_pool, "advance", counted)
    again = swept(rig(num_modes=1), "follow", refine_jumps=None)
    assert len(calls) < 0.5 * len(RATIOS)
    assert {shape[1] for shape in calls} == {2}
    np.testing.assert_array_equal(again.amplitude_ratio, both["follow"].amplitude_ratio)


@pytest.mark.parametrize(("damping_ratio", "marched"), [(0.018, 2), (2e-4, 8)])
def test_a_sweep_without_contact_marches_to_its_first_points_only(rig, damping_ratio, marched):
    """With light damping, where half of a transient is left after 600 periods, by its peak too."""
    one = rig(num_modes=1, gap=1.0, damping_ratio=damping_ratio)
    curve = swept(one, "follow")
    assert (np.asarray(curve.periods_marched) > 0).sum() <= marched
    # One mode after another, in closed form.
    equations = one.equations()
    w, z = np.asarray(equations.angular_frequency), np.asarray(equations.damping_ratio)
    drive = (RATIOS * w[0])[:, None]
    gain = equations.input_map * equations.response_map / (w**2 - drive**2 + 2j * z * w * drive)
    exact = np.abs(gain.sum(axis=1)) * drive[:, 0] ** 2
    for way in (0, 1):
        np.testing.assert_allclose(curve.amplitude_ratio[way], exact, rtol=1e-7)
        np.testing.assert_allclose(curve.rms_ratio[way], exact / np.sqrt(2), rtol=1e-9)
        np.testing.assert_allclose(curve.first_harmonic_ratio[way], exact, rtol=1e-9)


def test_impacts_of_a_lightly_damped_beam_settle(rig):
    one, ratios = rig(num_modes=1, gap=1e-3, damping_ratio=1e-3), np.linspace(0.92, 1.08, 9)
    for most in (600, None):
        curve = swept(one, "follow", ratios, refine_jumps=None, max_periods=most)
        assert np.mean(np.asarray(curve.period) > 0) > 0.6
        assert (np.asarray(curve.periods_marched).max() > 600) == (most is None)


def test_where_a_motion_doubles_its_period_the_sweep_does(oscillator):
    """Past the flip of the followed motion the lane marches to the motion of twice the period."""
    found = {}
    for settle in ("follow", "march"):
        equations = vj.MatrixSystem(
            mass=[[1.0]],
            damping=[[0.1]],
            stiffness=[[1.0]],
            stops=(vj.Stop(None, 0.0, vj.KelvinVoigt(30.0, 0.0, True)),),
            stop_map=[[1.0]],
            drive=vj.BaseMotion(1.0),
            input_map=[1.0],
            response_map=[1.0],
            proportional=True,
        )
        found[settle] = swept(equations, settle, np.linspace(2.4, 4.0, 17), refine_jumps=None)
    periods = np.asarray(found["march"].period)
    assert {1, 2} <= set(periods.ravel().tolist())
    same = np.asarray(found["follow"].period) == periods
    assert same.mean() > 0.9
    # Chaos is another one after another march.
    same &= periods > 0
    ours, theirs = (np.asarray(found[s].amplitude_ratio)[same] for s in ("follow", "march"))
    np.testing.assert_allclose(ours, theirs, rtol=1e-4)
    doubled = same & (periods == 2)
    followed = np.asarray(found["follow"].periods_marched)[doubled] == 0
    assert followed.mean() > 0.3


def test_other_laws_are_followed_on_the_map_of_a_period(rig):
    one, law = rig(num_modes=1), vj.HuntCrossley(stiffness=5e5, dissipation=0.2)
    system = vj.ImpactingBeam(
        one.beam, (vj.Stop(0.5, 0.4e-3, law),), drive=one.drive, damping_ratio=0.018, num_modes=1
    )
    ratios, settings = np.linspace(0.98, 1.3, 17), {"tolerance": 1e-3, "refine_jumps": None}
    ours, theirs = (swept(system, s, ratios, **settings) for s in ("follow", "march"))
    followed = np.asarray(ours.periods_marched) == 0
    assert followed.mean() > 0.5
    assert (followed & (np.asarray(ours.contact_force) > 0)).sum() > 10
    np.testing.assert_array_equal(ours.period, theirs.period)
    apart = ~np.isclose(ours.amplitude_ratio, theirs.amplitude_ratio, rtol=1e-5)
    apart |= np.asarray(ours.contacts_per_period) != np.asarray(theirs.contacts_per_period)
    # Downwards as with two stops, below.
    assert apart.sum() <= 1
    assert not apart[0].any()


def test_two_stops_are_followed_too(rig):
    two = rig(num_modes=1)
    near, far = (vj.Stop(0.5, 0.4e-3, vj.KelvinVoigt(5500.0, 5e-5, False), side=s) for s in (1, -1))
    system = vj.ImpactingBeam(
        two.beam, stops=(near, far), drive=two.drive, damping_ratio=0.018, num_modes=1
    )
    ours, theirs = (swept(system, s, refine_jumps=None) for s in ("follow", "march"))
    assert (np.asarray(ours.periods_marched) > 0).mean() < 0.5
    apart = ~np.isclose(ours.amplitude_ratio, theirs.amplitude_ratio, rtol=2e-6)
    # Downwards the free motion is followed until it touches; a march that overshoots is earlier.
    assert apart.sum() <= 1
    assert not apart[0].any()


def test_a_second_sweep_with_other_numbers_compiles_nothing(rig, both):
    programs = len(advance.programs)
    swept(rig(num_modes=1, gap=0.5e-3, stiffness=4000.0), "follow")
    assert len(advance.programs) == programs


@pytest.mark.slow
def test_a_rig_without_damping_beside_it_changes_nothing(rig):
    """An undamped rig is marched; its neighbours are followed as they would be alone."""

    def make(damping_ratio):
        return rig(num_modes=1, damping_ratio=damping_ratio)

    settings = vj.SweepSettings(max_periods=200, refine_jumps=None)
    ratios = np.linspace(1.1, 1.3, 6)
    both = vj.frequency_sweep(
        make, frequency_ratio=ratios, settings=settings, damping_ratio=[0.0, 0.018]
    )
    alone = vj.frequency_sweep(make(0.018), frequency_ratio=ratios, settings=settings)
    assert (np.asarray(both.periods_marched)[0] > 0).all()
    np.testing.assert_array_equal(both.periods_marched[1], alone.periods_marched)
    np.testing.assert_allclose(both.amplitude_ratio[1], alone.amplitude_ratio, rtol=1e-10)


def test_an_unknown_way_to_settle_is_refused():
    with pytest.raises(ValueError, match="settle"):
        vj.SweepSettings(settle="jump")


def test_means_are_exact(rig):
    """Those of a motion with contact, beside a dense sampling of it."""
    system = rig(num_modes=1)
    found = vj.periodic_response(system, frequency_ratio=1.15)
    march = vj.simulate(
        system, frequency_ratio=1.15, initial_state=found.initial_state, periods=1, samples=20001
    )
    x = np.asarray(march.displacement())[:-1] / float(system.drive.amplitude)
    assert float(found.rms_ratio) == pytest.approx(np.sqrt(np.mean(x**2)), rel=1e-7)


def test_phases_are_solved_for_as_one_batch(rig):
    """Batches of LAPACK's side by side on few threads may wait for each other for ever."""
    rigs = jax.vmap(lambda gap: rig(num_modes=2, gap=gap).equations())(np.linspace(1e-4, 1e-3, 3))
    text = jax.jit(jax.vmap(contact_phases)).lower(rigs).as_text()
    assert text.count("@lapack_dgeev_ffi") == 1
    assert text.count("@lapack_dgetrf_ffi") == 1


def test_xla_has_one_thread_unless_asked_for_more():
    code = """if True:
        import importlib, json, os
        import vibrojax
        from vibrojax._tools import threads
        by_itself = os.environ["PJRT_NPROC"]
        os.environ["PJRT_NPROC"] = "3"
        importlib.reload(threads)
        print(json.dumps([by_itself, os.environ["PJRT_NPROC"]]))
    """
    own = {k: v for k, v in os.environ.items() if k != "PJRT_NPROC"}
    run = [sys.executable, "-c", code]
    out = subprocess.run(run, env=own, capture_output=True, check=True, text=True)
    assert json.loads(out.stdout) == ["1", "3"]
