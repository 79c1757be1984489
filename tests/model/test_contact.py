import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vibrojax as vj
from vibrojax.model.laws import AbstractContactLaw, KelvinVoigt
from vibrojax.model.stops import DEFAULT_SMOOTHING, Stop, smooth_ramp, smooth_switch

WIDTH = 0.01
widths = st.floats(1e-9, 1.0)
depths = st.floats(-2.0, 2.0)
quick = settings(max_examples=40, deadline=None)


class Cubic(AbstractContactLaw):
    """A law that is not linear, written as a user would."""

    factor: float

    def force(self, penetration, rate):
        return self.factor * penetration**3


@quick
@given(depths, widths)
def test_ramp_is_zero_out_of_contact_and_linear_beyond_its_width(depth, width):
    ramp, switch = smooth_ramp(jnp.asarray(depth), width), smooth_switch(jnp.asarray(depth), width)
    if depth <= 0:
        assert (ramp, switch) == (0, 0)
    elif depth >= width:
        assert ramp == depth
        assert switch == pytest.approx(1.0, abs=1e-15)
    else:
        # Smoothing pulls the corner inwards by less than a fifth of its width.
        assert 0 <= ramp <= 1.001 * depth + 0.2 * width
        assert 0 <= switch <= 1


@pytest.mark.parametrize("function", [smooth_ramp, smooth_switch])
def test_two_continuous_derivatives(function):
    def at(depth, order):
        derived = lambda d: function(d, WIDTH)  # noqa: E731
        for _ in range(order):
            derived = jax.grad(derived)
        return float(derived(jnp.asarray(depth)))

    beyond = {smooth_ramp: (WIDTH, 1.0, 0.0), smooth_switch: (1.0, 0.0, 0.0)}[function]
    tiny = 1e-9
    for order in range(3):
        scale = WIDTH**-order
        assert at(tiny, order) == pytest.approx(0.0, abs=1e-5 * scale)
        assert at(WIDTH - tiny, order) == pytest.approx(beyond[order], abs=1e-5 * scale)
        assert at(WIDTH + tiny, order) == pytest.approx(beyond[order], abs=1e-5 * scale)
        assert at(-tiny, order) == 0


@pytest.mark.parametrize("width", [0.0, WIDTH])
@pytest.mark.parametrize("depth", [-1.0, 0.0, WIDTH, 1.0])
def test_derivatives_are_finite_at_every_corner(depth, width):
    for function in (smooth_ramp, smooth_switch):
        assert np.isfinite(jax.grad(function, argnums=(0, 1))(depth, width)).all()
    stop = Stop(1.0, 0.0, KelvinVoigt(5.0, 0.1, tension=False), smoothing=width)
    slope = jax.grad(lambda d, v: stop.force(d, v), argnums=(0, 1))(depth, 0.0)
    assert np.isfinite(slope).all()


def test_width_zero_keeps_the_corner():
    depth = jnp.array([-1.0, 0.0, 1e-300, 2.0])
    np.testing.assert_array_equal(smooth_ramp(depth, 0.0), [0, 0, 1e-300, 2.0])
    np.testing.assert_array_equal(smooth_switch(depth, 0.0), [0, 0, 1, 1])


def test_narrower_corners_converge_on_the_sharp_one():
    depth = jnp.linspace(-0.1, 0.1, 2001)
    sharp = jnp.maximum(depth, 0.0)
    off = [float(jnp.max(jnp.abs(smooth_ramp(depth, w) - sharp))) for w in (0.1, 0.01, 0.001)]
    np.testing.assert_allclose(off, off[0] * np.array([1, 0.1, 0.01]), rtol=0.05)


@quick
@given(depths, depths, widths, st.booleans())
def test_static_force_never_falls_with_depth(one, other, width, tension):
    stop = Stop(1.0, 0.1, KelvinVoigt(5500.0, 0.0, tension), smoothing=width)
    shallow, deep = sorted((one, other))
    zero = jnp.asarray(0.0)
    assert stop.force(jnp.asarray(shallow), zero) <= stop.force(jnp.asarray(deep), zero)


def test_kelvin_voigt_by_hand():
    law = KelvinVoigt(1000.0, 2.0)
    depth, rate = jnp.array([0.0, 1e-3, 1e-3]), jnp.array([0.0, 0.1, -1.0])
    np.testing.assert_allclose(law.force(depth, rate), [0.0, 1.2, -1.0])
    free = KelvinVoigt(1000.0, 2.0, tension=False)
    np.testing.assert_allclose(free.force(depth, rate), [0.0, 1.2, 0.0])
    assert (law.can_pull, free.can_pull) == (True, False)
    assert law.linear_coefficients() == free.linear_coefficients() == (1000.0, 2.0)


@quick
@given(depths, st.floats(-5.0, 5.0))
def test_forces_of_a_stop(depth, rate):
    depth, rate = jnp.asarray(depth), jnp.asarray(rate)
    printed, cut = KelvinVoigt(1e3, 7.0), KelvinVoigt(1e3, 7.0, tension=False)
    for law in (printed, cut):
        rounded, sharp = Stop(1.0, 0.2, law), Stop(1.0, 0.2, law, smoothing=0.0)
        assert sharp.force(depth, rate) == sharp.exact_force(depth, rate)
        if not 0 < depth < DEFAULT_SMOOTHING * 0.2:
            assert rounded.force(depth, rate) == pytest.approx(float(sharp.force(depth, rate)))
    no_pull = Stop(1.0, 0.2, cut).force(depth, rate)
    assert no_pull >= 0
    assert no_pull == max(float(Stop(1.0, 0.2, printed).force(depth, rate)), 0.0)


def test_what_is_linear_in_contact():
    law = KelvinVoigt(1.0)
    assert Stop(1.0, 0.1, law).is_linear
    assert Stop(1.0, 0.1, law, smoothing=0.0).is_linear
    assert not Stop(1.0, 0.1, law, smoothing=1e-6).is_linear
    assert not Stop(1.0, 0.1, Cubic(1.0)).is_linear


def test_width_follows_the_gap_unless_given():
    assert Stop(1.0, 0.5, KelvinVoigt(1.0)).width == pytest.approx(0.5 * DEFAULT_SMOOTHING)
    assert Stop(1.0, 0.5, KelvinVoigt(1.0), smoothing=0.25).width == 0.25


def test_a_law_of_ones_own():
    stop = Stop(1.0, 0.1, Cubic(3.0))
    assert stop.force(jnp.asarray(2.0), jnp.asarray(0.0)) == 24.0
    assert stop.force(jnp.asarray(-2.0), jnp.asarray(0.0)) == 0.0


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: KelvinVoigt(-1.0), "stiffness must be at least 0 N/m, got -1.0"),
        (lambda: KelvinVoigt(math.nan), "stiffness must be at least 0 N/m, got nan"),
        (lambda: KelvinVoigt(math.inf), "stiffness must be at least 0 N/m, got inf"),
        (lambda: KelvinVoigt(1.0, -1e-5), "damping must be at least 0 N s/m, got -1e-05"),
        (lambda: KelvinVoigt("stiff"), "stiffness must be a number, got 'stiff'"),
        (lambda: KelvinVoigt([1.0]), "stiffness must be a number"),
        (lambda: Stop(0.0, 1e-3, KelvinVoigt(1.0)), "position must be above 0 .* got 0.0"),
        (lambda: Stop(1.01, 1e-3, KelvinVoigt(1.0)), "position must be .* at most 1 .* got 1.01"),
        (lambda: Stop(math.nan, 1e-3, KelvinVoigt(1.0)), "position must be .* got nan"),
        (
            lambda: Stop(0.5, math.inf, KelvinVoigt(1.0)),
            "gap must be a finite length in m, got inf",
        ),
        (lambda: Stop(0.5, 1e-3, KelvinVoigt(1.0), side=0), "side must be one of 1, -1, got 0"),
        (
            lambda: Stop(0.5, 1e-3, KelvinVoigt(1.0), smoothing=-1e-6),
            "smoothing must be at least 0 m, got -1e-06",
        ),
    ],
)
def test_bad_input_is_one_clear_sentence(make, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        make()


def test_equations_take_one_stop_or_several():
    def equations(stops):
        one, table = jnp.ones(1), jnp.ones((1, 1))
        return vj.model.LinearEquations(
            stops=stops,
            angular_frequency=one,
            damping_ratio=0.05 * one,
            input_map=one,
            stop_map=table,
            force_map=table,
            response_map=one,
            modal_mass=one,
        )

    stop = vj.Stop(None, 1e-3, vj.KelvinVoigt(50.0))
    assert eqx.tree_equal(equations(stop), equations([stop]), equations((stop,)))
