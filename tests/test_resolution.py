"""The check of resolution: what is varied, and what it says."""

import io

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.model.rigidity import with_shorter_contacts


def study(system, method):
    """Numbers that say what the study was given."""
    width = float(system.stops[0].width)
    return {
        "samples": 1.0 + 1.0 / method.samples,
        "modes": 10.0 + system.num_modes,
        "width": 1.0 + width,
        "fixed": np.array([1.0, 2.0]),
    }


def test_exact_corner_is_not_varied(rig):
    check = vj.check_resolution(study, rig(), samples=128)
    assert set(check.moved) == {"twice the samples", "one more mode"}
    assert "exact" in check.skipped["half the rounding"]
    np.testing.assert_allclose(check.moved["twice the samples"]["samples"], 1 / 256)
    assert check.moved["one more mode"]["modes"] == 1.0
    assert check.relative["one more mode"]["fixed"] == 0.0
    np.testing.assert_allclose(check.worst, 1 / 15)
    assert "one more mode" in repr(check)


def test_rounding_is_halved(rig):
    base = rig()
    stop = vj.Stop(0.5, 4e-4, vj.KelvinVoigt(5500.0), smoothing=1e-5)
    rounded = vj.ImpactingBeam(base.beam, stop, base.drive, 0.018)
    check = vj.check_resolution(study, rounded)
    np.testing.assert_allclose(check.moved["half the rounding"]["width"], 5e-6, rtol=1e-9)


def test_a_number_that_appears_or_disappears_shows_as_nan(rig):
    def sometimes(system, method):
        return {"always": 1.0} | ({"fold": 1.2} if method.samples > 128 else {})

    check = vj.check_resolution(sometimes, rig(), samples=128)
    assert np.isnan(check.moved["twice the samples"]["fold"])
    assert np.isnan(check.worst)


def test_refuses_what_cannot_be_compared(rig):
    with pytest.raises(ValueError, match="study must return"):
        vj.check_resolution(lambda s, m: 3.0, rig())


def test_a_motion_without_contact_has_no_change_of_its_force(rig):
    one = rig(gap=0.1, num_modes=1)
    response = vj.periodic_response(one, frequency_ratio=0.5)
    check = vj.check_resolution(lambda system, method: response, one)
    for numbers in check.relative.values():
        assert numbers["contact_force"] == 0.0
    assert np.isfinite(check.worst)
    assert "0 (it is 0 in both)" in repr(check)
    assert "nan" not in repr(check)
    assert np.isfinite(check.to_xarray()["relative_change"]).all()
    check.plot().savefig(io.BytesIO())


@pytest.mark.parametrize(
    ("before", "after", "relative", "words"),
    [
        (0.0, 0.0, 0.0, "0 (it is 0 in both)"),
        (np.zeros(2), np.zeros(2), 0.0, "0 (it is 0 in both)"),
        (0.0, 0.25, np.inf, "from 0 to 2.50e-01"),
        (2.0, 2.0, 0.0, "0.00e+00"),
        (np.nan, np.nan, np.nan, "nan (it came or went, or is not finite)"),
        (np.inf, np.inf, np.nan, "nan (it came or went, or is not finite)"),
        (np.zeros(0), np.zeros(0), 0.0, "0 (it is 0 in both)"),
        (np.ones(2), np.ones(3), np.nan, "nan (it came or went, or is not finite)"),
    ],
)
def test_changes_that_have_no_size(rig, before, after, relative, words):
    def numbers(system, method):
        return {"number": before if method.samples == 128 else after, "one": 1.0}

    check = vj.check_resolution(numbers, rig(num_modes=1), samples=128)
    np.testing.assert_equal(check.relative["twice the samples"]["number"], relative)
    assert words in repr(check)
    assert check.to_xarray()["relative_change"].shape == (2, 2)
    check.plot().savefig(io.BytesIO())


def impact_oscillator(stiffness):
    law = vj.KelvinVoigt.from_restitution(0.7, stiffness=stiffness, mass=1.0)
    stop = vj.Stop(None, 1.0, law)
    return vj.model.Oscillator(1.0, 1.0, 0.1, stops=stop, drive=vj.PointForce(1.0))


@pytest.mark.slow
def test_stops_are_compared_with_rigid_ones():
    # The motion with restitution 0.7 in closed form: Shaw and Holmes 1983, see
    # experiments/impact_oscillator/impact_law.py.
    limit = 1.6024

    def periodic(system, method):
        return vj.periodic_response(system, frequency=1.4 / (2 * np.pi))

    check = vj.check_resolution(periodic, impact_oscillator(1e4), rigid_within=1e-2)
    rigidity = check.rigidity
    assert "contact_force" not in rigidity.errors  # it has no limit
    error = float(check.values["amplitude_ratio"]) / limit - 1
    np.testing.assert_allclose(rigidity.errors["amplitude_ratio"], error, rtol=0.03)
    (stop,) = rigidity.stops
    np.testing.assert_allclose(stop.stiffness_ratio, 1e4, rtol=1e-12)
    np.testing.assert_allclose(stop.contact_duration, np.pi / 100, rtol=1e-12)
    np.testing.assert_allclose(stop.drive_period, 2 * np.pi / 1.4, rtol=1e-12)
    assert "not stiff enough for 1.0e-02" in repr(check)
    assert "p0 = 1e+04" in repr(check)
    np.testing.assert_allclose(check.to_xarray()["rigid_error"][0], error, rtol=0.03)
    # With the law that is named the worst error is the one asked for, of the closed form too.
    enough = periodic(impact_oscillator(float(stop.stiff_enough.stiffness)), None)
    share = rigidity.errors["amplitude_ratio"] / rigidity.worst
    reached = float(enough.amplitude_ratio) / limit - 1
    np.testing.assert_allclose(reached, 1e-2 * share, rtol=0.05)


def test_stiffer_laws_halve_contacts_and_keep_the_loss():
    def study(system, method):
        law = system.stops[0].law
        return {"contact": 1 + float(law.stiffness) ** (-1 / (1 + law.exponent))}

    stop = vj.Stop(None, 1.0, vj.HuntCrossley(1e5, 0.1, exponent=3.0), smoothing=0.0)
    system = vj.model.Oscillator(1.0, 1.0, 0.1, stops=stop, drive=vj.PointForce(1.0))
    check = vj.check_resolution(study, system, rigid_within=1e-2)
    size = 1e5**-0.25
    np.testing.assert_allclose(check.rigidity.errors["contact"], size / (1 + size), rtol=1e-12)
    enough = check.rigidity.stops[0].stiff_enough
    factor = size / (1 + size) / 1e-2
    np.testing.assert_allclose(enough.stiffness, 1e5 * factor**4, rtol=1e-12)
    assert float(enough.dissipation) == 0.1
    lost = vj.check_resolution(
        lambda s, m: {"fold": 1.0} if s.stops[0].law.stiffness < 2e5 else {"other": 1.0},
        system,
        rigid_within=1e-2,
    )
    assert np.isnan(lost.rigidity.worst)
    assert "stiff enough: not known" in repr(lost)
    rubber = vj.StandardLinearSolid(1e3, 2e3, 1e-2).with_shorter_contacts(2.0)
    assert (rubber.stiffness, rubber.maxwell_stiffness, rubber.relaxation_time) == (4e3, 8e3, 5e-3)
    pair = vj.Joined(system, vj.model.Oscillator(1.0, 2.0), vj.Stop(None, 1.0, vj.Hertz(1e5)))
    stiffer = with_shorter_contacts(pair, 2.0)
    laws = [stop.law.stiffness for stop in stiffer.stops]
    np.testing.assert_allclose(laws, [1e5 * 2**2.5, 1e5 * 2**4])


def test_a_law_that_does_not_say_how_it_gets_stiffer_is_not_compared(rig):
    class Own(vj.model.AbstractContactLaw):
        def force(self, penetration, rate):
            return 1e3 * penetration

    base = rig(num_modes=1)
    own = vj.ImpactingBeam(base.beam, vj.Stop(0.5, 4e-4, Own()), base.drive, 0.018, num_modes=1)
    check = vj.check_resolution(study, own, rigid_within=1e-2)
    assert check.rigidity is None
    assert "with_shorter_contacts" in check.skipped["half the length of contacts"]
    with pytest.raises(ValueError, match="rigid_within must be above 0"):
        vj.check_resolution(study, own, rigid_within=0.0)
