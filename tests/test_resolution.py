"""The check of resolution: what is varied, and what it says."""

import io

import numpy as np
import pytest

import vibrojax as vj


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
