import logging
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from finite_element_beam import FiniteElementBeam
from scipy.optimize import brentq

import vibrojax as vj

# rho A0 L = 1 kg and E I0/(rho A0 L^4) = 1, so that nothing needs scaling.
UNIT = {"length": 1.0, "width": 12.0, "thickness": 1.0, "youngs_modulus": 1.0, "density": 1 / 12}
# One count of modes and of masses wherever it does not matter, to compile once.
N = 6


def beam(masses=(), positions=(), taper=0.0, mass_ratio=0.0) -> vj.Cantilever:
    points = [vj.PointMass(m, s) for m, s in zip(masses, positions, strict=True)]
    return vj.Cantilever(**UNIT, taper=taper, mass_ratio=mass_ratio, point_masses=points)


def assert_same(found, expected):
    s = np.linspace(0, 1, 41)
    np.testing.assert_allclose(found.beta, expected.beta, rtol=1e-12)
    np.testing.assert_allclose(found.participation, expected.participation, atol=1e-11)
    np.testing.assert_allclose(found.modal_mass, expected.modal_mass, rtol=1e-12)
    np.testing.assert_allclose(found.shape(s), expected.shape(s), atol=1e-11)


RIGS = [
    (0.0, 0.0, (0.05, 0.02), (0.5, 0.875)),
    (0.0, 0.5, (20.0, 0.3), (0.375, 1.0)),
    (0.0, 0.0, (20.0, 20.0), (0.125, 0.25)),
    (0.6, 0.0, (0.5, 5.0), (0.75, 0.25)),
    (0.9, 2.0, (3.0, 20.0), (0.625, 0.6875)),
]


@pytest.mark.parametrize(("taper", "mass_ratio", "masses", "positions"), RIGS)
def test_finite_elements(taper, mass_ratio, masses, positions):
    points = [*zip(masses, positions, strict=True)]
    # More elements lose digits to the conditioning of their matrices, 1e-9 of beta at 128.
    elements = FiniteElementBeam(taper, mass_ratio, N, 64, points)
    found = vj.modes(beam(masses, positions, taper, mass_ratio), N)
    s = np.concatenate([np.linspace(0.01, 1, 23), positions])
    np.testing.assert_allclose(found.beta, elements.beta, rtol=1e-8)
    np.testing.assert_allclose(found.shape(s), elements.shape(s), atol=1e-6)


@partial(jax.jit, static_argnums=0)
@partial(jax.vmap, in_axes=(None, 0, 0, 0, 0))
def betas(num_modes, masses, positions, taper, mass_ratio):
    return vj.modes(beam(masses, positions, taper, mass_ratio), num_modes).beta


@pytest.mark.slow
def test_every_mode_is_found_once():
    rng, rigs, elements = np.random.default_rng(5), 40, 48
    masses = 10 ** rng.uniform(-2, np.log10(20), (rigs, 4))
    positions = rng.integers(1, elements + 1, (rigs, 4)) / elements
    taper = rng.choice([0.0, 0.5, 0.9], rigs)
    mass_ratio = rng.choice([0.0, 0.3, 5.0], rigs)
    found = betas(8, masses, positions, taper, mass_ratio)
    for i in range(rigs):
        points = [*zip(masses[i], positions[i], strict=True)]
        expected = FiniteElementBeam(taper[i], mass_ratio[i], 8, elements, points).beta
        np.testing.assert_allclose(found[i], expected, rtol=1e-6, err_msg=str((points, taper[i])))


@pytest.mark.parametrize("ratio", [0.5, 1.0])
def test_closed_form_of_a_tip_mass(ratio):
    def equation(b):
        return (1 + np.cosh(b) * np.cos(b)) / np.cosh(b) + ratio * b * (
            np.cos(b) * np.tanh(b) - np.sin(b)
        )

    found = np.asarray(vj.modes(beam([ratio], [1.0]), N).beta)
    assert found[0] == pytest.approx({0.5: 1.419964, 1.0: 1.247917}[ratio], abs=5e-7)
    for b in found:
        assert b == pytest.approx(brentq(equation, b - 0.1, b + 0.1, xtol=1e-14), rel=1e-12)


@pytest.mark.parametrize(("taper", "mass_ratio"), [(0.0, 0.0), (0.7, 0.4)])
@pytest.mark.parametrize("mass", [0.3, 20.0])
def test_at_the_tip_it_is_the_tip_mass(taper, mass_ratio, mass):
    found = vj.modes(beam([mass / 4, 3 * mass / 4], [1.0, 1.0], taper, mass_ratio), N)
    expected = vj.modes(beam(taper=taper, mass_ratio=mass_ratio + mass), N)
    assert_same(found, expected)
    third = [np.asarray(m.shape(1.0, derivative=3)) for m in (found, expected)]
    np.testing.assert_allclose(third[0], third[1], atol=1e-8 * np.abs(third[1]).max())


@pytest.mark.parametrize("place", [0.5, 0.37, 1.0])
def test_two_at_one_place_are_their_sum(place):
    assert_same(
        vj.modes(beam([0.3, 0.9], [place, place], 0.5, 0.1), N),
        vj.modes(beam([1.2], [place], 0.5, 0.1), N),
    )


def test_no_mass_is_no_mass():
    none = vj.modes(beam(taper=0.5, mass_ratio=0.5), N)
    assert_same(vj.modes(beam([0.0, 0.0], [0.4, 1.0], 0.5, 0.5), N), none)
    assert_same(vj.modes(beam([0.2], [1e-6], 0.5, 0.5), N), none)  # next to the clamp


@pytest.mark.parametrize(("taper", "mass_ratio", "masses", "positions"), RIGS)
def test_orthogonality_momentum_and_jump(taper, mass_ratio, masses, positions):
    rig = beam(masses, positions, taper, mass_ratio)
    found, printed = vj.modes(rig, N), vj.modes(rig, N, "as_printed")
    x, w = np.polynomial.legendre.leggauss(24)
    knots = np.asarray(found.knots)
    h = np.diff(knots)[:, None]
    s = (knots[:-1, None] + h * (1 + x) / 2).ravel()
    weight = (h * w / 2).ravel() * (1 - taper * s)
    shapes, tip = np.asarray(found.shape(s)), np.asarray(found.shape(1.0))
    area = shapes.T @ (shapes * weight[:, None])
    at_masses = np.asarray(found.shape(np.array(positions)))
    gram = area + mass_ratio * np.outer(tip, tip) + (at_masses.T * masses) @ at_masses
    np.testing.assert_allclose(gram, np.eye(N), atol=1e-11)
    root = [np.asarray(found.shape(0.0, derivative=d)) for d in (2, 3)]
    momentum = (taper * root[0] - root[1]) / np.asarray(found.beta) ** 4
    np.testing.assert_allclose(found.participation, momentum, atol=1e-10)
    load = weight @ shapes + mass_ratio * tip + masses @ at_masses
    np.testing.assert_allclose(found.participation, load, atol=1e-11)
    # As printed, no mass counts in the projection.
    np.testing.assert_allclose(printed.modal_mass, np.diag(area), atol=1e-11)
    np.testing.assert_allclose(
        printed.participation * printed.modal_mass, weight @ shapes, atol=1e-11
    )
    place = positions[0]
    third = [np.asarray(found.shape(at, derivative=3)) for at in (place - 1e-13, place)]
    jump = np.asarray(found.beta) ** 4 * masses[0] * at_masses[0] / (1 - taper * place)
    np.testing.assert_allclose(third[1] - third[0], jump, atol=1e-9 * np.abs(third).max())


def flat(masses, positions, taper=0.5, mass_ratio=0.2):
    found = vj.modes(beam(masses, positions, taper, mass_ratio), 3)
    shapes = found.shape(jnp.array([0.37, 1.0])).ravel()
    return jnp.concatenate([found.frequency, shapes, found.participation])


FLAT = jax.jit(flat)
FORWARD = jax.jit(jax.jacfwd(flat, (0, 1)))
REVERSE = jax.jit(jax.jacrev(flat, (0, 1)))


def difference(function, x, high=np.inf):
    """Fourth-order differences, one-sided next to the upper bound."""
    h = 5e-4
    weights = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    if x + 2 * h > high:
        weights = {0: 137 / 60, -1: -5, -2: 5, -3: -10 / 3, -4: 5 / 4, -5: -1 / 5}
    return sum(w * np.asarray(function(x + k * h)) for k, w in weights.items()) / h


ROUND = [(0.5, 0.175), (0.1, 1.0), (0.3, 0.3), (1.0, 1.0), (0.5 + 2e-7, 0.812)]
MASSES = np.array([0.4, 0.8])


@pytest.mark.slow
@pytest.mark.parametrize("taper", [0.0, 0.5])
@pytest.mark.parametrize("positions", ROUND)
def test_gradients(taper, positions):
    positions = np.array(positions)
    by_mass, by_position = FORWARD(MASSES, positions, taper)
    for i in range(2):
        unit = np.eye(2)[i]
        masses = difference(
            lambda x, e=unit: FLAT(MASSES + (x - MASSES) * e, positions, taper), MASSES[i]
        )
        places = difference(
            lambda x, e=unit: FLAT(MASSES, positions + (x - positions) * e, taper),
            positions[i],
            high=1.0,
        )
        np.testing.assert_allclose(by_mass[:, i], masses, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(by_position[:, i], places, rtol=2e-6, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("positions", ROUND)
@pytest.mark.long  # to compile
def test_forward_and_reverse_gradients_agree(positions):
    reverse, forward = REVERSE(MASSES, np.array(positions)), FORWARD(MASSES, np.array(positions))
    for ours, theirs in zip(reverse, forward, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("positions", [(0.5, 0.1), (0.3, 1.0), (0.2, 0.2)])
def test_gradient_of_frequency_is_that_of_rayleigh(positions):
    positions = np.array(positions)
    found = vj.modes(beam(MASSES, positions, 0.5, 0.2), 3)
    value, slope = (np.asarray(found.shape(positions, derivative=d)).T for d in (0, 1))
    frequency = np.asarray(found.frequency)[:, None]
    by_mass, by_position = FORWARD(MASSES, positions, 0.5)
    np.testing.assert_allclose(by_mass[:3], -frequency * value**2 / 2, rtol=1e-11, atol=1e-11)
    expected = -frequency * MASSES * value * slope
    np.testing.assert_allclose(by_position[:3], expected, rtol=1e-11, atol=1e-11)


def first_frequency(rig):
    return vj.modes(rig, 3).frequency[0]


PLACES = [(s, 0.5) for s in np.linspace(0.1, 1, 10)]
STACKED = jax.tree.map(
    lambda *leaves: jnp.stack([*map(jnp.asarray, leaves)]),
    *(beam(MASSES, places, 0.5, 0.2) for places in PLACES),
)


@pytest.mark.slow
def test_mapped_over_positions():
    frequency, slope = jax.jit(jax.vmap(jax.value_and_grad(first_frequency)))(STACKED)
    for i, places in enumerate(PLACES):
        place = np.array(places)
        by_mass, by_position = FORWARD(MASSES, place, 0.5)
        assert float(frequency[i]) == pytest.approx(float(FLAT(MASSES, place, 0.5)[0]), rel=1e-13)
        for k, point in enumerate(slope.point_masses):
            assert float(point.mass[i]) == pytest.approx(float(by_mass[0, k]), rel=1e-10)
            assert float(point.position[i]) == pytest.approx(float(by_position[0, k]), abs=1e-11)
    # All stiffness, or all mass, times a factor.
    np.testing.assert_allclose(slope.youngs_modulus, frequency / 2, rtol=1e-11)
    together = slope.density * STACKED.density + sum(
        ours.mass * theirs.mass
        for ours, theirs in zip(slope.point_masses, STACKED.point_masses, strict=True)
    )
    np.testing.assert_allclose(together, -frequency / 2, rtol=1e-11)


@pytest.mark.slow
def test_gradient_of_a_batch():
    slope = jax.jit(jax.grad(lambda batch: jax.vmap(first_frequency)(batch).sum()))(STACKED)
    for i, places in enumerate(PLACES):
        expected = FORWARD(MASSES, np.array(places), 0.5)[1][0]
        found = [float(point.position[i]) for point in slope.point_masses]
        np.testing.assert_allclose(found, expected, atol=1e-11)


def test_off_the_beam_is_not_an_answer():
    found = FLAT(jnp.array([0.4, 0.8]), jnp.array([0.5, 1.01]))
    assert np.isnan(found[:3]).all()


def test_new_numbers_do_not_compile_again(caplog):
    vj.modes(beam([0.1, 0.2], [0.3, 0.4]), 3).shape(0.5)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        vj.modes(beam([0.3, 0.0], [1.0, 0.2], 0.1), 3).shape(0.4)
        vj.modes(beam([jnp.asarray(0.3), np.float64(1)], [np.asarray(0.7), 0.2]), 3).shape(0.4)
    compiled = [r.getMessage() for r in caplog.records if "solve" in r.getMessage()]
    assert compiled == []


def test_kilograms():
    rig = vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0, point_masses=vj.PointMass(0.5 * 0.04125))
    found = vj.modes(rig, N)
    assert float(found.angular_frequency[0] / rig.frequency_scale) == pytest.approx(
        1.419964**2, rel=1e-6
    )
    np.testing.assert_allclose(found.modal_mass, 0.04125, rtol=1e-12)


def test_one_or_several():
    point = vj.PointMass(0.01, 0.5)
    assert vj.Cantilever(**UNIT).point_masses == ()
    assert vj.Cantilever(**UNIT, point_masses=point).point_masses == (point,)
    assert vj.Cantilever(**UNIT, point_masses=[point, point]).point_masses == (point, point)
    assert vj.PointMass(0.01).position == 1.0


@pytest.mark.parametrize("given", [0.01, [0.01], "heavy", None, {"mass": 0.01}])
def test_what_is_no_point_mass_is_refused(given):
    with pytest.raises(ValueError, match=r"^point_masses.* must be .*PointMass.*, got "):
        vj.Cantilever(**UNIT, point_masses=given)


@pytest.mark.parametrize(
    ("mass", "position", "sentence"),
    [
        (-0.1, 0.5, "mass must be at least 0 kg, got -0.1"),
        (np.nan, 0.5, "mass must be at least 0 kg, got nan"),
        ("0.1", 0.5, "mass must be a number, got '0.1'"),
        (0.1, 0.0, r"position must be above 0 \(root\) and at most 1 \(tip\), got 0.0"),
        (
            0.1,
            jnp.asarray(1.5),
            r"position must be above 0 \(root\) and at most 1 \(tip\), got 1.5",
        ),
        (0.1, True, "position must be a number, got True"),
    ],
)
def test_wrong_numbers_are_refused(mass, position, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        vj.PointMass(mass, position)


def test_arrays_are_for_vmap():
    with pytest.raises(ValueError, match=r"^beam holds a batch, .* its position has the shape"):
        vj.modes(beam([0.1], [jnp.array([0.1, 0.2])]), 3)


def test_masses_leave_the_static_deflection_of_an_impacting_beam():
    def deflection(num_modes, points):
        base = vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0, mass_ratio=0.2, point_masses=points)
        reduced = vj.ImpactingBeam(base, num_modes=num_modes).equations()
        np.testing.assert_allclose(reduced.modal_mass, base.reference_mass, rtol=1e-12)
        stiffness = reduced.modal_mass * reduced.angular_frequency**2
        return float(jnp.sum(reduced.response_map**2 / stiffness)) * (
            3 * base.youngs_modulus * base.root_inertia / base.length**3
        )

    points = (vj.PointMass(0.02, 0.5), vj.PointMass(0.004, 0.8))
    left_out = [1 - deflection(n, points) for n in (3, N)]
    assert 0 < left_out[1] < left_out[0] / 4
    assert left_out[1] < 1e-3
