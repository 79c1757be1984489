import json
import logging
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from finite_element_beam import FiniteElementBeam

from vibrojax.model.beam import Cantilever
from vibrojax.model.modes import Modes, modes

DATA = Path(__file__).parents[1] / "data"
REFERENCE = json.loads((DATA / "modes.json").read_text())
TWELVE = json.loads((DATA / "modes_12.json").read_text())
REFERENCE_MASS = 0.04125
# One count of modes wherever it does not matter, to compile once.
N = 8


def beam(taper=0.0, mass_ratio=0.0, **numbers) -> Cantilever:
    given = {
        "length": 0.2,
        "width": 0.025,
        "thickness": 1e-3,
        "youngs_modulus": 130e9,
        "density": 8250.0,
        **numbers,
    }
    return Cantilever(**given, taper=taper, mass_ratio=mass_ratio)


def column(case, key) -> np.ndarray:
    return np.array([mode[key] for mode in case["modes"]])


def case_name(case) -> str:
    return "-".join(str(case[k]) for k in ("mu", "Mr", "taper", "mass_ratio") if k in case)


@pytest.mark.parametrize("case", REFERENCE["cases"], ids=case_name)
def test_first_eight_modes(case):
    rig = beam(case["mu"], case["Mr"])
    found, printed = modes(rig, N), modes(rig, N, "as_printed")
    np.testing.assert_allclose(found.beta, column(case, "beta"), rtol=1e-12)
    norm = column(case, "modal_mass_consistent") ** -0.5  # the reference has phi(1) = 1
    shapes = column(case, "phi").T * norm
    np.testing.assert_allclose(found.shape(REFERENCE["points_s"]), shapes, atol=1e-11)
    np.testing.assert_allclose(
        found.participation, column(case, "participation_consistent") / norm, atol=1e-11
    )
    np.testing.assert_allclose(found.modal_mass, REFERENCE_MASS, rtol=1e-12)
    np.testing.assert_array_equal(printed.beta, found.beta)
    np.testing.assert_allclose(
        printed.participation, column(case, "participation_as_printed") / norm, atol=1e-11
    )
    np.testing.assert_allclose(
        printed.modal_mass / REFERENCE_MASS,
        column(case, "modal_mass_as_printed") * norm**2,
        rtol=1e-11,
    )


@pytest.mark.parametrize("row", REFERENCE["table2"], ids=lambda r: f"{r['mu']}-{r['MR']}")
def test_published_table(row):
    squares = np.asarray(modes(beam(row["mu"], row["MR"]), N).beta[:3]) ** 2
    printed = np.array(row["printed"])
    if (row["mu"], row["MR"]) == (0.3, 0):
        printed[1] = 22.78  # printed as 22.98
    assert ((squares - printed > -1e-9) & (squares - printed < 0.011)).all()


@pytest.mark.parametrize("case", TWELVE["cases"], ids=case_name)
def test_first_twelve_modes(case):
    found = modes(beam(case["taper"], case["mass_ratio"]), 12)
    np.testing.assert_allclose(found.beta, case["beta"], rtol=1e-12)
    np.testing.assert_allclose(found.shape(TWELVE["points_s"]).T, case["shape"], atol=1e-10)
    np.testing.assert_allclose(found.participation, case["participation"], atol=1e-10)


@pytest.mark.parametrize(("taper", "mass_ratio"), [(0.2, 0.1), (0.8, 3.0), (0.95, 10.0)])
def test_finite_elements(taper, mass_ratio):
    s = np.array([0.1, 0.33, 0.6, 0.85, 0.97, 1.0])
    elements = FiniteElementBeam(taper, mass_ratio, num_modes=12, elements=64)
    found = modes(beam(taper, mass_ratio), 12)
    np.testing.assert_allclose(found.beta, elements.beta, rtol=1e-9)
    np.testing.assert_allclose(found.shape(s), elements.shape(s), atol=1e-6)


@pytest.mark.parametrize(
    ("taper", "mass_ratio", "expected"),
    [
        (0.0, 0.1, 1.722742**2),
        (0.0, 0.5, 1.419964**2),
        (0.0, 2.0, 1.076196**2),
        (0.0, 5.0, 0.870021**2),
        (0.0, 10.0, 0.735782**2),
        (0.5, 0.0, 4.31517),
    ],
)
def test_closed_forms(taper, mass_ratio, expected):
    rig = beam(taper, mass_ratio)
    found = modes(rig, N)
    omega = float(found.angular_frequency[0] / rig.frequency_scale)
    assert omega == pytest.approx(expected, rel=2e-6)
    assert float(found.frequency[0]) == pytest.approx(omega * rig.frequency_scale / (2 * math.pi))


def test_heavy_tip_is_a_spring_and_a_mass():
    ratio = 1e6
    assert float(modes(beam(0.0, ratio), N).beta[0]) == pytest.approx((3 / ratio) ** 0.25, rel=1e-6)


@pytest.mark.parametrize(("taper", "mass_ratio"), [(0.0, 0.0), (0.6, 2.0), (0.99, 0.3)])
def test_end_conditions_orthogonality_and_momentum(taper, mass_ratio):
    found = modes(beam(taper, mass_ratio), N)
    beta = np.asarray(found.beta)
    root = [np.asarray(found.shape(0.0, derivative=d)) for d in range(4)]
    tip = [np.asarray(found.shape(1.0, derivative=d)) / beta**d for d in range(4)]
    np.testing.assert_allclose(root[0], 0, atol=1e-14)
    np.testing.assert_allclose(root[1], 0, atol=1e-14)
    size = np.abs(root[2]) / beta**2
    np.testing.assert_allclose(tip[2] / size, 0, atol=1e-9)
    shear = tip[3] * (1 - taper) + mass_ratio * beta * tip[0]
    np.testing.assert_allclose(shear / size, 0, atol=1e-9)
    assert (tip[0] > 0).all()
    # Gauss points in log u: the last modes of a slender tip are crowded there.
    x, w = np.polynomial.legendre.leggauss(120)
    end = math.log1p(-taper)
    s = -np.expm1(end * (1 + x) / 2) / taper if taper else (1 + x) / 2
    w = w / 2 * (-end * (1 - taper * s) / taper if taper else 1)
    shapes = np.asarray(found.shape(s))
    gram = shapes.T @ (shapes * (w * (1 - taper * s))[:, None])
    gram += mass_ratio * np.outer(tip[0], tip[0])
    np.testing.assert_allclose(gram, np.eye(N), atol=1e-11)
    momentum = (taper * root[2] - root[3]) / beta**4
    np.testing.assert_allclose(found.participation, momentum, atol=1e-11)


@pytest.mark.parametrize("taper", [0.99, 0.999])
@pytest.mark.slow
def test_slender_tip(taper):
    # The taper 0.999 is past what is promised: it must still be close.
    found = modes(beam(taper, 1.0), N)
    elements = FiniteElementBeam(taper, 1.0, num_modes=N, elements=160)
    np.testing.assert_allclose(found.beta, elements.beta, rtol=1e-7)


@pytest.mark.slow
def test_twenty_modes_are_all_there():
    found = np.asarray(modes(beam(0.9, 1.0), 20).beta)
    np.testing.assert_allclose(np.diff(found)[3:], np.pi, rtol=0.05)
    elements = FiniteElementBeam(0.9, 1.0, num_modes=20, elements=80)
    np.testing.assert_allclose(found, elements.beta, rtol=1e-8)


def test_mode_counts_agree():
    few, many = modes(beam(0.7, 0.5), 1), modes(beam(0.7, 0.5), N)
    assert (few.num_modes, many.num_modes) == (1, N)
    np.testing.assert_allclose(few.beta[0], many.beta[0], rtol=1e-13)
    np.testing.assert_allclose(few.shape(0.4)[0], many.shape(0.4)[0], rtol=1e-12)


def test_shape_sizes_and_derivatives():
    found = modes(beam(0.5, 0.5), N)
    s = jnp.concatenate([jnp.linspace(0.0, 1.0, 7), found.knots])
    assert found.shape(0.3).shape == (N,)
    assert found.shape([0.3, 0.4]).shape == (2, N)
    assert found.shape(jnp.full((2, 3), 0.3)).shape == (2, 3, N)
    for order in range(3):
        slope = jax.vmap(jax.jacfwd(lambda x, d=order: found.shape(x, derivative=d)))(s)
        expected = found.shape(s, derivative=order + 1)
        np.testing.assert_allclose(slope, expected, atol=1e-9)


def flat(taper, mass_ratio):
    # As printed, because the consistent modal mass does not depend on the mode or the rig.
    found = modes(beam(taper, mass_ratio), 3, "as_printed")
    shapes = found.shape(jnp.array([0.37, 1.0])).ravel()
    masses = found.modal_mass / REFERENCE_MASS
    return jnp.concatenate([found.beta, shapes, masses, found.participation])


def difference(function, x, low):
    """Fourth-order differences, one-sided next to the lower bound."""
    h = 1e-3
    weights = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    if x - 2 * h < low:
        weights = {0: -137 / 60, 1: 5, 2: -5, 3: 10 / 3, 4: -5 / 4, 5: 1 / 5}
    return sum(w * np.asarray(function(x + k * h)) for k, w in weights.items()) / h


FLAT_FORWARD = jax.jit(jax.jacfwd(flat, (0, 1)))
FLAT_REVERSE = jax.jit(jax.jacrev(flat, (0, 1)))


@pytest.mark.parametrize(
    ("taper", "mass_ratio"), [(0.0, 0.0), (0.0, 1.0), (0.5, 0.0), (0.5, 0.5), (0.8, 5.0)]
)
@pytest.mark.slow
def test_gradients(taper, mass_ratio):
    forward = FLAT_FORWARD(taper, mass_ratio)
    by_taper = difference(lambda x: flat(x, mass_ratio), taper, 0.0)
    by_mass = difference(lambda x: flat(taper, x), mass_ratio, 0.0)
    np.testing.assert_allclose(forward[0], by_taper, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(forward[1], by_mass, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_forward_and_reverse_gradients_agree():
    for numbers in [(0.0, 0.0), (0.5, 0.5), (0.9, 10.0)]:
        reverse, forward = FLAT_REVERSE(*numbers), FLAT_FORWARD(*numbers)
        np.testing.assert_allclose(reverse, forward, rtol=1e-11, atol=1e-11)


TOGETHER = jax.jit(jax.vmap(lambda taper, ratio: modes(beam(taper, ratio), 3)))


def test_batch_equals_loop():
    tapers, ratios = jnp.array([0.0, 0.3, 0.9]), jnp.array([0.0, 2.0, 10.0])
    together = TOGETHER(tapers, ratios)
    for i, (taper, ratio) in enumerate(zip(tapers, ratios, strict=True)):
        alone = modes(beam(taper, ratio), 3)
        lane = jax.tree.map(lambda leaf, i=i: leaf[i], together)
        np.testing.assert_allclose(lane.beta, alone.beta, rtol=1e-13)
        np.testing.assert_allclose(lane.shape(0.7), alone.shape(0.7), atol=1e-12)


def first_frequency(rig):
    return modes(rig, 3).frequency[0]


RIGS = [beam(0.0, 0.0), beam(0.3, 0.2), beam(0.9, 10.0)]
STACKED = jax.tree.map(lambda *leaves: jnp.stack([*map(jnp.asarray, leaves)]), *RIGS)
BATCHED_GRADIENT = jax.jit(jax.vmap(jax.grad(first_frequency)))


def test_batched_gradients_in_every_number_of_the_beam():
    slope = BATCHED_GRADIENT(STACKED)
    frequency = np.array([float(first_frequency(rig)) for rig in RIGS])
    np.testing.assert_allclose(slope.length, -2 * frequency / 0.2, rtol=1e-12)
    np.testing.assert_allclose(slope.thickness, frequency / 1e-3, rtol=1e-12)
    np.testing.assert_allclose(slope.youngs_modulus, frequency / 130e9 / 2, rtol=1e-12)
    np.testing.assert_allclose(slope.density, -frequency / 8250 / 2, rtol=1e-12)
    np.testing.assert_allclose(slope.width, 0.0, atol=1e-9)
    for i, rig in enumerate(RIGS):
        by_taper = difference(
            lambda x, r=rig: first_frequency(beam(x, r.mass_ratio)), rig.taper, 0.0
        )
        by_mass = difference(
            lambda x, r=rig: first_frequency(beam(r.taper, x)), rig.mass_ratio, 0.0
        )
        assert float(slope.taper[i]) == pytest.approx(by_taper, rel=1e-6)
        assert float(slope.mass_ratio[i]) == pytest.approx(by_mass, rel=1e-6)


@pytest.mark.slow
def test_gradient_of_a_batch_is_a_batch_of_gradients():
    outside = jax.grad(lambda batch: jax.vmap(first_frequency)(batch).sum())(STACKED)
    inside = BATCHED_GRADIENT(STACKED)
    for ours, theirs in zip(jax.tree.leaves(inside), jax.tree.leaves(outside), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-9)


@pytest.mark.slow
def test_second_derivative():
    def frequency(taper):
        return modes(beam(taper, 0.5), 3).frequency[0]

    slope = jax.jit(jax.grad(frequency))
    second = jax.jit(jax.jacfwd(jax.grad(frequency)))(0.3)
    assert float(second) == pytest.approx(difference(slope, 0.3, 0.0), rel=1e-7)


def test_impossible_lane_is_not_an_answer():
    beta = TOGETHER(jnp.array([0.5, 1.5, 0.2]), jnp.array([0.5, 0.5, 0.5])).beta
    assert np.isfinite(beta[::2]).all()
    assert np.isnan(beta[1]).all()


def test_new_numbers_do_not_compile_again(caplog):
    modes(beam(0.11, 0.2), 3).shape(0.5)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        modes(beam(0.12, 0.3, length=0.3), 3).shape(0.4)
        modes(beam(jnp.asarray(0.13), np.float64(0.1)), 3).shape(jnp.asarray(0.3))
    compiled = [r.getMessage() for r in caplog.records if "solve" in r.getMessage()]
    assert compiled == []


def test_repr():
    found = modes(beam(0.5, 0.5), N)
    lines = repr(found).splitlines()
    assert lines[0] == "Modes(num_modes=8, formulation='consistent')"
    assert len(lines) == 2 + N
    assert "9.21" in lines[2]
    shown = []
    jax.jit(lambda t: shown.append(repr(modes(beam(t), 3))) or t)(0.5)
    assert shown == ["Modes(num_modes=3, formulation='consistent')"]
    batch = TOGETHER(jnp.array([0.1, 0.2, 0.3]), jnp.zeros(3))
    assert repr(batch).endswith("batch (3,)")
    assert isinstance(batch, Modes)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"num_modes": 0}, "num_modes must be a whole number of at least 1, got 0"),
        ({"num_modes": -2}, "num_modes must be a whole number of at least 1, got -2"),
        ({"formulation": "printed"}, "formulation must be one of 'consistent', 'as_printed'"),
    ],
)
def test_wrong_options_are_refused(options, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        modes(beam(), **options)


def test_wrong_places_are_refused():
    found = modes(beam(0.5, 0.5), N)
    with pytest.raises(ValueError, match=r"^s must be from 0 \(root\) to 1 \(tip\), got 1.2"):
        found.shape([0.3, 1.2])
    with pytest.raises(ValueError, match=r"^derivative must be 0, 1, 2 or 3, got 4"):
        found.shape(0.5, derivative=4)
    with pytest.raises(ValueError, match=r"^beam holds a batch.*taper.*\(2,\).*vmap"):
        modes(beam(jnp.array([0.1, 0.2])), 3)
