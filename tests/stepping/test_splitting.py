"""Exponential splitting against exact contact and closed forms."""

import dataclasses

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


class Coupled(vj.model.AbstractMemoryLaw):
    """A law whose memories change by a matrix, the rates of each by the others too."""

    flow: jax.Array
    uptake: jax.Array

    @property
    def memory_size(self):
        return len(self.uptake)

    def force_with_memory(self, penetration, rate, memory):
        return 5500.0 * penetration - 100.0 * jnp.sum(memory, axis=0)

    def memory_rate(self, penetration, rate, memory):
        return jnp.tensordot(self.flow, memory, 1) + jnp.multiply.outer(self.uptake, penetration)

    def stored_energy_with_memory(self, penetration, memory):
        return 2750.0 * penetration**2


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("lanes", [(), (2,)])
def test_coupled_memories_take_the_midpoint_rule(size, lanes):
    flow = np.random.default_rng(size).normal(size=(size, size)) - 2 * np.eye(size)
    uptake = np.arange(1.0, size + 1)
    law, rubber = Coupled(jnp.asarray(flow), jnp.asarray(uptake)), vj.KelvinVoigt(5500.0)
    solid = vj.StandardLinearSolid(3000.0, 2000.0, 0.5)
    rig = vj.default_rig(num_modes=2)
    stops = [vj.Stop(place, 0.0, own) for place, own in ((0.4, rubber), (0.6, law), (1.0, solid))]
    rig = dataclasses.replace(rig, stops=tuple(stops))
    equations = equations_of(as_arrays(rig))
    depth = jnp.broadcast_to(1e-3 * jnp.arange(1.0, 4).reshape(3, *(1 for _ in lanes)), (3, *lanes))
    memory = np.random.default_rng(1).normal(size=(equations.memory_size, *lanes)) * 1e-3
    step = 0.8
    contact = splitting.contact_of(equations, len(lanes))
    rate, duration = jnp.zeros_like(depth), jnp.full(lanes, step)
    _, after = splitting.kick(contact, depth, rate, jnp.asarray(memory), duration)
    # (z1 - z0)/h = A (z0 + z1)/2 + b d, and that of the solid alone.
    half, unit = step / 2 * flow, np.eye(size)
    gained = step * np.multiply.outer(uptake, np.asarray(depth[1]))
    right = np.tensordot(unit + half, memory[:size], 1) + gained
    wanted = np.linalg.solve(unit - half, right.reshape(size, -1)).reshape(size, *lanes)
    np.testing.assert_allclose(after[:size], wanted, rtol=1e-12, atol=1e-18)
    own = ((1 - 0.8) * memory[size] + 1.6 * np.asarray(depth[2])) / (1 + 0.8)
    np.testing.assert_allclose(after[size], own, rtol=1e-12)
    assert not np.any(after[size + 1 :])  # what idles


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
