"""The inverted elastic pendulum of Litak et al. against values made without JAX."""

import json
from dataclasses import replace
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj

REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "pendulum.json").read_text())
PENDULUM = vj.default_pendulum()
EQUATIONS = PENDULUM.equations()
LINKS = 17


@pytest.mark.parametrize("case", REFERENCE["rhs_vectors"])
def test_accelerations_forces_and_energies(case):
    q, rate = jnp.array(case["alpha"]), jnp.array(case["omega"])
    found = EQUATIONS.acceleration(q, rate, -case["ax0"])
    np.testing.assert_allclose(found, case["acc"], rtol=1e-9)
    gaps = -np.array(EQUATIONS.penetration(q))
    np.testing.assert_allclose(gaps, [case["gap_right"], case["gap_left"]], rtol=1e-10)
    np.testing.assert_allclose(EQUATIONS.contact_forces(q, rate), case["Fn"], rtol=1e-9)
    np.testing.assert_allclose(EQUATIONS.kinetic_energy(q, rate), case["T"], rtol=1e-12)
    np.testing.assert_allclose(EQUATIONS.potential_energy(q), case["V"], rtol=1e-12)
    chord = EQUATIONS.observables(q)["chord_reduction"]
    np.testing.assert_allclose(chord, case["chord_reduction"], rtol=1e-10)


def test_mass_matrix_is_that_of_its_product():
    q = jnp.linspace(-1.0, 2.0, LINKS)
    vector = jnp.cos(jnp.arange(LINKS))
    expected = EQUATIONS.mass(q) @ vector
    np.testing.assert_allclose(EQUATIONS.mass_times(q, vector), expected, rtol=1e-12)


def test_natural_frequencies():
    expected = REFERENCE["linear_frequencies_hz"]
    hinged = PENDULUM.natural_frequencies()
    np.testing.assert_allclose(hinged, expected["hinged_tip_gravity"], rtol=1e-6)
    clamped = PENDULUM.natural_frequencies("clamped")[:4]
    np.testing.assert_allclose(clamped, expected["clamped_tip_gravity"], rtol=1e-6)
    for height, values in expected["propped_tip_gravity_by_h"].items():
        propped = vj.default_pendulum(limiter_height=float(height)).natural_frequencies("propped")
        np.testing.assert_allclose(propped[:3], values, rtol=1e-6)


def test_rest_on_a_limiter_is_an_equilibrium():
    well = REFERENCE["static_well"]
    q, rest = jnp.array(well["alpha"]), jnp.zeros(LINKS)
    force = EQUATIONS.contact_forces(q, rest)
    np.testing.assert_allclose(np.max(force), well["contact_force"], rtol=1e-6)
    depth = EQUATIONS.potential_energy(rest) - EQUATIONS.potential_energy(q)
    np.testing.assert_allclose(depth, well["depth_J"], rtol=5e-3)  # the springs of the limiters
    # Moments in balance: what is left over accelerates no link by more than round-off of them.
    left = EQUATIONS.mass(q) @ EQUATIONS.acceleration(q, rest, 0.0)
    assert np.max(np.abs(left)) < 1e-8


@pytest.mark.slow
def test_energy_is_conserved_without_damping():
    case = REFERENCE["conservative"]
    free = replace(PENDULUM, joint_damping=0.0, bearing_damping=0.0, limiters=None)
    free = replace(free, drive=vj.NoDrive())
    history = vj.simulate(
        free,
        frequency=5.0,
        duration=0.2,
        samples=40,
        initial_state=(np.array(case["alpha0"]), np.zeros(LINKS)),
        stepper=diffrax.Dopri8(),
        tolerance=1e-11,
    )
    equations = free.equations()
    energy = jax.vmap(equations.kinetic_energy)(history.coordinates, history.rates)
    energy += jax.vmap(equations.potential_energy)(history.coordinates)
    np.testing.assert_allclose(energy, case["E0"], rtol=1e-8)
    at = np.round(np.array(case["t"]) / 0.2 * 40).astype(int)
    np.testing.assert_allclose(history.coordinates[at], case["alpha"], atol=1e-7)


def test_observables_of_the_full_and_the_linearised_pendulum_agree_for_small_angles():
    modal = PENDULUM.linearised(LINKS)
    angles = 1e-3 * jnp.cos(jnp.linspace(0, 3, LINKS))
    q = modal.modal_coordinates(angles)
    np.testing.assert_allclose(modal.angles(q), angles, atol=1e-15)
    full, linear = EQUATIONS.observables(angles), modal.equations().observables(q)
    assert full.keys() == linear.keys()
    for name, value in full.items():
        np.testing.assert_allclose(linear[name], value, rtol=1e-5, err_msg=name)


def test_linearised_equations_are_the_derivative_of_the_full_ones():
    modal = PENDULUM.linearised(LINKS)
    equations = modal.equations()
    q, rate = 1e-8 * jnp.sin(jnp.arange(LINKS)), 1e-7 * jnp.cos(jnp.arange(LINKS))
    full = EQUATIONS.acceleration(modal.angles(q), modal.angles(rate), 0.3)
    linear = equations.acceleration(q, rate, 0.3)
    np.testing.assert_allclose(modal.angles(linear), full, rtol=1e-5, atol=1e-5 * np.max(full))
    depth = equations.penetration(q) - EQUATIONS.penetration(modal.angles(q))
    np.testing.assert_allclose(depth, 0.0, atol=1e-8)
    signed = equations.stiffness_sign * equations.angular_frequency / (2 * np.pi)
    np.testing.assert_allclose(signed, PENDULUM.natural_frequencies(), rtol=1e-9)


def test_numbers_of_the_pendulum_can_be_traced():
    def lowest(height, links_modulus):
        pendulum = vj.default_pendulum(limiter_height=height, youngs_modulus=links_modulus)
        return pendulum.natural_frequencies("propped")[0]

    heights = jnp.linspace(0.03, 0.05, 3)
    modulus = jnp.full(3, 350e6)
    by_lane = jax.vmap(jax.grad(lowest, argnums=1))(heights, modulus)
    step = 350e6 * 1e-5
    change = jax.vmap(lowest)(heights, modulus + step) - jax.vmap(lowest)(heights, modulus - step)
    np.testing.assert_allclose(by_lane, change / (2 * step), rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"limiter_height": 0.25}, "limiters.height must be above 0 .* 0.195 m .*got 0.25"),
        ({"limiter_height": -0.01}, "limiter_height must be above 0 m, got -0.01"),
        ({"limiter_height": 0.0}, "limiter_height must be above 0 m"),
        ({"limiter_distance": 0.0}, "distance must be above 0 m"),
        ({"num_links": 1}, "num_links must be a whole number of at least 2, got 1"),
        ({"num_links": -3}, "num_links must be a whole number"),
        ({"length": 0.0}, "length must be above 0 m"),
        ({"tip_mass": -1e-3}, "tip_mass must be at least 0 kg"),
        ({"joint_damping_time": -1.0}, "joint_damping_time must be at least 0"),
        ({"bearing_damping": np.nan}, "bearing_damping must be at least 0"),
    ],
)
def test_what_is_no_pendulum_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        vj.default_pendulum(**change)


def test_other_refusals():
    with pytest.raises(ValueError, match="drive must be BaseMotion or NoDrive"):
        replace(PENDULUM, drive=vj.PointForce(1.0))
    with pytest.raises(ValueError, match="support = 'propped' needs limiters"):
        replace(PENDULUM, limiters=None).natural_frequencies("propped")
    with pytest.raises(ValueError, match="support must be one of"):
        PENDULUM.natural_frequencies("glued")
    with pytest.raises(ValueError, match="num_modes must be at most 17"):
        PENDULUM.linearised(18)
    with pytest.raises(ValueError, match="gravity must be above 0"):
        vj.default_pendulum(gravity=0.0).linearised(4)
