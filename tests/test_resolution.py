"""The check of resolution: what is varied, and what it says."""

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
