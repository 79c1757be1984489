import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.model.beam import Cantilever

NUMBERS = {
    "length": 0.2,
    "width": 0.025,
    "thickness": 1e-3,
    "youngs_modulus": 130e9,
    "density": 8250.0,
    "taper": 0.5,
    "mass_ratio": 0.4,
}


def test_derived_numbers():
    beam = Cantilever(**NUMBERS)
    assert beam.root_area == pytest.approx(2.5e-5)
    assert beam.root_inertia == pytest.approx(0.025 * 1e-9 / 12)
    assert beam.reference_mass == pytest.approx(0.04125)
    assert beam.tip_mass == pytest.approx(0.0165)
    wave = math.sqrt(130e9 * 1e-6 / (12 * 8250.0)) / 0.04
    assert beam.frequency_scale == pytest.approx(wave)


def test_straight_and_bare_unless_asked():
    beam = Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0)
    assert (beam.taper, beam.mass_ratio, beam.tip_mass) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("length", 0.0, "length must be above 0 m, got 0.0"),
        ("width", -0.025, "width must be above 0 m, got -0.025"),
        ("thickness", math.inf, "thickness must be above 0 m, got inf"),
        ("youngs_modulus", -1.0, "youngs_modulus must be above 0 Pa, got -1.0"),
        ("density", math.nan, "density must be above 0 kg/m3, got nan"),
        ("taper", 1.0, "taper must be at least 0 and below 1, got 1.0"),
        ("taper", -0.1, "taper must be at least 0 and below 1, got -0.1"),
        ("mass_ratio", -0.5, "mass_ratio must be at least 0"),
        ("taper", "0.5", "taper must be a number, got '0.5'"),
        ("length", True, "length must be a number, got True"),
    ],
)
def test_wrong_numbers_are_refused(name, value, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        Cantilever(**{**NUMBERS, name: value})


@pytest.mark.parametrize("kind", [np.float64, np.asarray, jnp.asarray])
def test_numbers_of_other_libraries(kind):
    beam = Cantilever(**{name: kind(value) for name, value in NUMBERS.items()})
    assert float(beam.reference_mass) == pytest.approx(0.04125)
    with pytest.raises(ValueError, match="taper"):
        Cantilever(**{**NUMBERS, "taper": kind(1.5)})


def test_traced_numbers_pass_and_are_differentiable():
    def scale(length):
        return Cantilever(**{**NUMBERS, "length": length}).frequency_scale

    value, slope = jax.jit(jax.value_and_grad(scale))(0.2)
    assert slope == pytest.approx(-2 * value / 0.2)
    masses = jax.vmap(lambda ratio: Cantilever(**{**NUMBERS, "mass_ratio": ratio}).tip_mass)
    np.testing.assert_allclose(masses(jnp.array([0.0, 2.0])), [0.0, 0.0825])
