import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.model.drives import BaseMotion, Chirp, Harmonic, NoDrive, PointForce

WAVEFORMS = {
    "harmonic": Harmonic(7.0),
    "rising": Chirp(5.0, 9.0, 2.0),
    "falling": Chirp(9.0, 5.0, 2.0),
    "level": Chirp(5.0, 5.0, 2.0),
    "logarithmic": Chirp(5.0, 9.0, 2.0, "logarithmic"),
    "logarithmic falling": Chirp(9.0, 5.0, 2.0, "logarithmic"),
    "logarithmic level": Chirp(5.0, 5.0, 2.0, "logarithmic"),
    "logarithmic almost level": Chirp(5.0, 5.0 + 1e-9, 2.0, "logarithmic"),
}
# Before, during and after, away from the corners at 0 and 2 s.
TIMES = jnp.array([-0.4, 0.1, 0.77, 1.3, 1.9, 2.1, 3.0])


def difference(function, time, h):
    """First derivative by central differences of fourth order."""
    outer = function(time + 2 * h) - function(time - 2 * h)
    return (8 * (function(time + h) - function(time - h)) - outer) / (12 * h)


@pytest.fixture(params=WAVEFORMS.values(), ids=WAVEFORMS.keys())
def waveform(request):
    return request.param


def test_derivatives_of_the_phase(waveform):
    _, rate, second = waveform.phase(TIMES)
    h = 1e-3
    by_difference = difference(lambda t: waveform.phase(t)[0], TIMES, h)
    np.testing.assert_allclose(by_difference, rate, rtol=1e-9)
    np.testing.assert_allclose(
        difference(lambda t: waveform.phase(t)[1], TIMES, h), second, rtol=1e-8, atol=1e-8
    )
    for order in range(2):
        exact = jax.vmap(jax.grad(lambda t, k=order: waveform.phase(t)[k]))(TIMES)
        np.testing.assert_allclose(exact, waveform.phase(TIMES)[order + 1], rtol=1e-12, atol=1e-12)


def test_phase_is_continuous_from_zero(waveform):
    phase = waveform.phase(jnp.array([0.0, 2.0 - 1e-12, 2.0, 2.0 + 1e-12]))[0]
    assert phase[0] == 0
    np.testing.assert_allclose(phase[1:], phase[2], rtol=1e-10)


def test_known_phases():
    end = jnp.asarray(2.0)
    assert WAVEFORMS["rising"].phase(end)[0] == pytest.approx(2 * math.pi * 7.0 * 2)
    mean = 4.0 / math.log(9 / 5)  # of a frequency that grows geometrically
    assert WAVEFORMS["logarithmic"].phase(end)[0] == pytest.approx(2 * math.pi * mean * 2)
    middle = WAVEFORMS["logarithmic"].phase(jnp.asarray(1.0))[1]
    assert middle == pytest.approx(2 * math.pi * math.sqrt(45.0))


def test_chirp_to_its_own_frequency_is_a_harmonic():
    for kind in ("linear", "logarithmic"):
        level = Chirp(5.0, 5.0, 2.0, kind)
        for a, b in zip(level.phase(TIMES), Harmonic(5.0).phase(TIMES), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-14)
    slope = jax.grad(lambda end: Chirp(5.0, end, 2.0, "logarithmic").phase(jnp.asarray(1.0))[0])
    assert np.isfinite(slope(5.0))


def test_base_motion_is_minus_the_acceleration_of_the_base(waveform):
    sigma, h = 3e-4, 1e-3
    drive = BaseMotion(sigma)

    def base(t):
        return sigma * jnp.sin(waveform.phase(t)[0])

    acceleration = difference(lambda t: difference(base, t, h), TIMES, h)
    np.testing.assert_allclose(
        drive.input(waveform, TIMES), -acceleration, atol=1e-5 * sigma * (18 * math.pi) ** 2
    )
    exact = jax.vmap(jax.grad(jax.grad(base)))(TIMES)
    np.testing.assert_allclose(drive.input(waveform, TIMES), -exact, rtol=1e-9, atol=1e-9)


def test_point_force_and_none(waveform):
    force = PointForce(12.0, 0.35).input(waveform, TIMES)
    np.testing.assert_allclose(force, 12 * jnp.sin(waveform.phase(TIMES)[0]), atol=1e-12)
    assert not NoDrive().input(waveform, TIMES).any()


def test_references():
    assert BaseMotion(2e-4).reference == (2e-4, "1")
    assert PointForce(3.0).reference == (3.0, "m/N")
    assert NoDrive().reference == (1.0, "m")


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Harmonic(0.0), "frequency must be above 0 Hz, got 0.0"),
        (lambda: Harmonic(math.nan), "frequency must be above 0 Hz, got nan"),
        (lambda: Chirp(-1.0, 2.0, 1.0), "start must be above 0 Hz, got -1.0"),
        (lambda: Chirp(1.0, math.inf, 1.0), "end must be above 0 Hz, got inf"),
        (lambda: Chirp(1.0, 2.0, 0.0), "duration must be above 0 s, got 0.0"),
        (lambda: Chirp(1.0, 2.0, 1.0, "cubic"), "kind must be one of 'linear', 'logarithmic'"),
        (lambda: BaseMotion(-1e-3), "amplitude must be at least 0 m, got -0.001"),
        (lambda: BaseMotion("big"), "amplitude must be a number, got 'big'"),
        (lambda: PointForce(-1.0), "amplitude must be at least 0 N, got -1.0"),
        (lambda: PointForce(1.0, 0.0), "position must be above 0 .* got 0.0"),
        (lambda: PointForce(1.0, 1.5), "position must be .* at most 1 .* got 1.5"),
    ],
)
def test_bad_input_is_one_clear_sentence(make, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        make()
