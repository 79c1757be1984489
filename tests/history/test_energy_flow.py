"""The energy of a history: held, lost and put in."""

import jax.numpy as jnp
import numpy as np
import pytest
from test_contacts import Body, released, soft_rig

import vibrojax as vj

RELEASE = {"release": 0.01, "duration": 0.15, "samples_per_period": 256}
SPLIT = {"release": 0.01, "duration": 0.03, "samples_per_period": 256}
LAWS = {
    "hertz": vj.Hertz(1e6),
    "hunt_crossley": vj.HuntCrossley(1e6, 0.3),
    "rubber": vj.StandardLinearSolid(22e3, 10e3, 2e-3),
}


def several(*laws):
    gaps, sides, places = (4e-3, 2.2e-3, 1e-3), (-1, -1, -1), (1.0, 0.75, 0.5)
    rows = zip(places, gaps, laws, sides, strict=False)
    return tuple(vj.Stop(place, gap, law, side=side) for place, gap, law, side in rows)


def check(energy, closes):
    assert abs(energy.balance).max() < closes
    # At rest, as a driven motion begins, there is nothing to share.
    held = energy.modal_energy.sum(axis=1) > 0
    np.testing.assert_allclose(energy.share.sum(axis=1), held, rtol=1e-12)
    assert held[1:].all()
    assert (np.diff(energy.beam_loss, axis=0) > -1e-15).all()
    lost = energy.contact_loss.sum() + energy.stop_energy.sum()
    assert np.isfinite(lost)


def test_a_release_closes_to_rounding():
    rig = soft_rig(20.0)
    history = vj.simulate(rig, **RELEASE)
    energy, contacts = history.energy(), history.contacts()
    check(energy, 1e-9)
    assert energy.contact_loss[-1, 0] == pytest.approx(contacts.energy_lost.sum(), rel=1e-12)
    assert energy.input_work[-1] == 0
    assert (np.diff(energy.contact_loss, axis=0) > -1e-15).all()


@pytest.mark.slow
def test_stops_that_let_go_and_several_of_them():
    laws = (vj.KelvinVoigt(22e3, c, t) for c, t in ((20.0, False), (5.0, True), (3.0, False)))
    history = vj.simulate(soft_rig(stops=several(*laws)), **RELEASE)
    energy, contacts = history.energy(), history.contacts()
    check(energy, 1e-8)
    assert set(contacts.stop) == {1, 2, 3}
    for stop in (1, 2, 3):
        taken = contacts.energy_lost[contacts.stop == stop].sum()
        assert energy.contact_loss[-1, stop - 1] == pytest.approx(taken, rel=1e-9)
    assert (np.diff(contacts.touch) > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("drive", [vj.PointForce(12.0, 0.175), vj.BaseMotion(1e-3)])
def test_driven_motions_close(drive):
    rig = soft_rig(10.0, drive=drive)
    energy = vj.simulate(rig, frequency=16.0, periods=10, tolerance=1e-8).energy()
    check(energy, 1e-8)
    assert energy.input_work[-1] > 0
    sweep = vj.Chirp(12.0, 20.0, 0.5)
    history = vj.simulate(rig, waveform=sweep, duration=0.5, samples_per_period=256)
    check(history.energy(), 1e-7)


@pytest.mark.slow
def test_work_is_force_times_path(oscillator):
    """Without stop and damping the energy is the work, here of a force known in closed form."""
    equations = oscillator(frequency=10.0, gap=1.0)
    body = Body(equations, vj.PointForce(2.0, 1.0))
    history = vj.simulate(body, frequency=1.0, periods=1.3, samples=200)
    energy = history.energy()
    w, own, t = 2 * np.pi, 10.0, np.asarray(history.time)
    rate = 2.0 * w / (own**2 - w**2) * (np.cos(w * t) - np.cos(own * t))
    np.testing.assert_allclose(np.asarray(history.rates)[:, 0], rate, atol=1e-12)
    work = np.cumsum(
        np.diff(t) * ((2 * np.sin(w * t) * rate)[1:] + (2 * np.sin(w * t) * rate)[:-1])
    )
    np.testing.assert_allclose(energy.input_work[1:], work / 2, rtol=1e-2, atol=1e-5)
    check(energy, 1e-10)
    assert energy.beam_loss[-1].sum() == 0


@pytest.mark.slow
def test_a_free_beam_loses_what_its_modes_lose():
    energy = vj.simulate(soft_rig(), release=0.003, duration=0.1, samples_per_period=256).energy()
    assert energy.contact_loss[-1, 0] == 0
    held = energy.modal_energy + energy.beam_loss
    np.testing.assert_allclose(held, np.broadcast_to(held[0], held.shape), rtol=1e-10)


@pytest.mark.slow
def test_coupled_damping_is_counted_whole():
    mass, stiffness = np.eye(2), np.array([[200.0, -100.0], [-100.0, 300.0]])
    damping = np.array([[0.4, -0.4], [-0.4, 1.0]]) * np.array([[1.0, 0.2], [0.2, 1.0]])
    stop = vj.Stop(None, 0.02, vj.KelvinVoigt(2000.0, 3.0))
    body = vj.MatrixSystem(
        mass, damping, stiffness, stops=stop, stop_map=[[1.0, 0.0]], response_map=[0.0, 1.0]
    )
    state = (jnp.zeros(2), jnp.asarray([0.7, -1.0]))
    history = vj.simulate(body, initial_state=state, duration=3.0, samples=600)
    assert history.motion.equations.damping_coupling is not None
    assert len(history.contacts()) > 1
    energy = history.energy()
    assert abs(energy.balance).max() < 1e-8
    assert energy.beam_loss[-1].sum() > 0


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_other_laws_close_too(law):
    stops = several(LAWS[law])
    history = vj.simulate(soft_rig(stops=stops), **SPLIT)
    energy, contacts = history.energy(), history.contacts()
    check(energy, 1e-6)
    assert len(contacts) >= 1
    if law == "hertz":
        np.testing.assert_allclose(energy.contact_loss[-1], 0.0, atol=1e-6 * energy.total[0])
    else:
        # Rubber still creeps back at the end, and will lose what is left in it.
        assert np.isfinite(contacts.departure).all()
        taken = energy.contact_loss[-1, 0] + energy.stop_energy[-1, 0]
        assert taken == pytest.approx(contacts.energy_lost.sum(), rel=1e-6)
    force = history.peak("contact_force")
    # Of a motion that is known exactly the one is read off it, the other off cubics.
    near = 1e-7 if law == "rubber" else 1e-9
    assert force.value == pytest.approx(contacts.peak_force.max(), rel=near)
    assert force.value == pytest.approx(np.asarray(history.contact_force).max(), rel=1e-2)
    late = history.peak("acceleration", start=0.02)
    seen = np.asarray(history.acceleration())[np.asarray(history.time) >= 0.02]
    assert abs(late.value) >= abs(seen).max() * (1 - 1e-9)
    assert late.time >= 0.02


@pytest.mark.slow
def test_laws_of_all_kinds_driven_by_a_chirp():
    stops = several(LAWS["rubber"], LAWS["hunt_crossley"])
    rig = soft_rig(stops=stops, drive=vj.PointForce(20.0, 0.175))
    sweep = vj.Chirp(12.0, 20.0, 0.4)
    history = vj.simulate(rig, waveform=sweep, duration=0.4, samples_per_period=256)
    assert set(history.contacts().stop) == {1, 2}
    check(history.energy(), 1e-6)


@pytest.mark.slow
def test_rounded_corners_close_too():
    law = vj.KelvinVoigt(22e3, 10.0)
    rounded = vj.Stop(1.0, 4e-3, law, side=-1, smoothing=4e-6)
    history = vj.simulate(soft_rig(stops=(rounded,)), **SPLIT)
    sharp = vj.simulate(soft_rig(10.0), **SPLIT)
    check(history.energy(), 1e-6)
    ours, exact = history.contacts(), sharp.contacts()
    np.testing.assert_allclose(ours.touch, exact.touch, atol=5e-5)
    np.testing.assert_allclose(ours.energy_lost, exact.energy_lost, rtol=2e-2)


def test_shares_and_the_dataset():
    energy = released({"c1": 10.0, "x0": 0.01}).energy()
    assert isinstance(energy, vj.history.EnergyFlow)
    mean = energy.mean_share(0.01, 0.02)
    assert mean.shape == (5,)
    assert mean.sum() == pytest.approx(1.0)
    assert mean[0] > 0.95
    assert energy.mean_share(0.03, 0.1)[1] > mean[1]
    with pytest.raises(ValueError, match="No sample lies"):
        energy.mean_share(2.0, 3.0)
    data = energy.to_xarray()
    assert data["modal_energy"].dims == ("time", "mode")
    assert data["contact_loss"].attrs["units"] == "J"
    assert all(data[name].attrs["long_name"] for name in data)
    assert "mean shares" in repr(energy)


def test_the_picture(tmp_path):
    energy = released({"c1": 10.0, "x0": 0.01}).energy()
    for kind in ("stacked", "lines"):
        figure = energy.plot(kind)
        top, bottom = figure.axes
        assert top.get_ylabel() == "Share of the energy"
        assert bottom.get_xlabel() == "Time (s)"
        words = [text.get_text() for text in figure.legends[0].get_texts()]
        assert words[:5] == [f"mode {i + 1}" for i in range(5)]
        figure.savefig(tmp_path / f"{kind}.png")
    with pytest.raises(ValueError, match="kind must be"):
        energy.plot("bars")
