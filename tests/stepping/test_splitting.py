"""Exponential splitting against exact contact and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import vibrojax as vj
from vibrojax.model.systems import as_arrays, equations_of
from vibrojax.stepping import splitting


@pytest.mark.parametrize("zeta", [0.0, 0.1, 1.0, 2.5])
def test_drift_is_the_exact_flow(zeta):
    w, time = 30.0, 0.07
    flow = splitting.drift(jnp.array([w]), jnp.array([zeta]), jnp.array(time))
    exact = expm(np.array([[0.0, 1.0], [-(w**2), -2 * zeta * w]]) * time)
    ours = np.array([[flow.qq[0], flow.qv[0]], [flow.vq[0], flow.vv[0]]])
    np.testing.assert_allclose(ours, exact, atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize("zeta", [0.1, 1.0, 2.5])
def test_drift_gradient_is_finite(zeta):
    def entry(z):
        return splitting.drift(jnp.array([30.0]), jnp.array([z]), jnp.array(0.07)).qq[0]

    assert np.isfinite(jax.grad(entry)(zeta))


def march(rig, ratio, periods, steps):
    equations = equations_of(as_arrays(rig))
    angular = jnp.atleast_1d(ratio) * equations.angular_frequency[0]
    amplitude = rig.drive.complex_amplitude(angular, jnp.zeros_like(angular))
    state = jnp.zeros((2 * equations.size, angular.size))
    end, _, _ = splitting.march(
        equations,
        amplitude,
        angular,
        state,
        jnp.full(angular.shape, periods, jnp.int32),
        jnp.asarray(steps, jnp.int32),
    )
    return np.asarray(end)


def exact(rig, ratio, periods):
    history = vj.simulate(
        rig, frequency_ratio=ratio, periods=periods, samples=4, stepper=vj.ExactContact(1e-9)
    )
    return np.concatenate([history.coordinates[-1], history.rates[-1]])


def test_force_gradient_beats_the_plain_kick():
    rig = vj.default_rig()
    state = exact(rig, 1.15, 5)
    size = np.max(np.abs(state[:5]))
    coarse, fine = (march(rig, 1.15, 5, n)[:, 0] for n in (400, 1600))
    assert np.max(np.abs(coarse - state)[:5]) / size < 5e-3
    assert np.max(np.abs(fine - state)[:5]) / size < 2e-4


@pytest.mark.slow
def test_two_stops_at_once_and_lanes_like_a_loop():
    stops = tuple(
        vj.Stop(s, 0.4e-3, vj.KelvinVoigt(5500.0, 0.05), side=side)
        for s, side in ((0.5, 1), (0.6, 1), (0.5, -1))
    )
    base = vj.default_rig()
    rig = vj.ImpactingBeam(base.beam, stops, base.drive, 0.018)
    ratios = jnp.array([1.0, 1.1, 1.2])
    together = march(rig, ratios, 3, 800)
    alone = np.stack([march(rig, r, 3, 800)[:, 0] for r in ratios], axis=1)
    np.testing.assert_allclose(together, alone, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(together[:5, 1], exact(rig, 1.1, 3)[:5], atol=2e-6)


def test_sweep_with_a_rounded_stop_agrees_with_exact_contact():
    base = vj.default_rig()
    rounded = vj.Stop(0.5, 0.4e-3, base.stops[0].law, smoothing=1e-8)
    rig = vj.ImpactingBeam(base.beam, rounded, base.drive, 0.018)
    ratios = [1.05, 1.15]
    ours = vj.frequency_sweep(
        rig, frequency_ratio=ratios, settings=vj.SweepSettings(direction="forward", tolerance=1e-3)
    )
    truth = vj.frequency_sweep(
        base, frequency_ratio=ratios, settings=vj.SweepSettings(direction="forward")
    )
    assert "ExponentialSplitting" in ours.attributes["stepper"]
    np.testing.assert_allclose(ours.amplitude_ratio, truth.amplitude_ratio, rtol=2e-3)
    np.testing.assert_allclose(ours.contact_force, truth.contact_force, rtol=5e-3)
    np.testing.assert_array_equal(ours.period, truth.period)
    np.testing.assert_allclose(ours.contact_fraction, truth.contact_fraction, atol=5e-3)
    np.testing.assert_allclose(ours.contacts_per_period, truth.contacts_per_period)


def test_linear_response_is_exact_at_any_step():
    rig = vj.default_rig(gap=1.0)
    rounded = vj.Stop(0.5, 1.0, rig.stops[0].law, smoothing=1e-6)
    linear = vj.ImpactingBeam(rig.beam, rounded, rig.drive, 0.018)
    settings = {
        "frequency_ratio": [0.9, 1.3],
        "settings": vj.SweepSettings(direction="forward"),
    }
    ours = vj.frequency_sweep(linear, **settings)
    truth = vj.frequency_sweep(rig, **settings)
    np.testing.assert_allclose(ours.amplitude_ratio, truth.amplitude_ratio, rtol=1e-8)


def test_exact_contact_refuses_a_rounded_stop():
    base = vj.default_rig()
    rounded = vj.Stop(0.5, 0.4e-3, base.stops[0].law, smoothing=1e-6)
    rig = vj.ImpactingBeam(base.beam, rounded, base.drive, 0.018)
    with pytest.raises(ValueError, match="ExponentialSplitting"):
        vj.frequency_sweep(
            rig, frequency_ratio=[1.0], settings=vj.SweepSettings(stepper=vj.ExactContact())
        )
