"""What is measured of a march: extremes from the motion itself, integrals of high order."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from marches import prepared

from vibrojax.stepping import exact_contact, gauge
from vibrojax.stepping.contact_phases import phases_of
from vibrojax.stepping.forcing import forcing
from vibrojax.stepping.gauge import PLACES, Ruler


@eqx.filter_jit
def run(march, state, angular_frequency, periods, observe):
    return march(state, angular_frequency, periods, observe)


def marched(rig, ratios, periods, tolerance=1e-4, state=None, observe=True):
    """March lanes that differ in frequency over drive periods; from rest where nothing is said."""
    equations = rig.equations()
    march = prepared(equations, rig.drive, tolerance)
    w = jnp.asarray(ratios) * float(equations.angular_frequency[0])
    weight = march.energy_weight()
    start = jnp.zeros((weight.shape[0], len(w))) if state is None else state
    return run(march, start, w, jnp.full(len(w), periods, jnp.int32), observe)


@pytest.fixture(scope="module")
def beam(rig):
    return rig(num_modes=3)


RATIOS = 0.95, 1.05, 1.15, 1.2


def test_a_march_with_measures_goes_the_same_way(beam):
    end, rounds, measures = marched(beam, RATIOS, 40)
    bare, bare_rounds, nothing = marched(beam, RATIOS, 40, observe=False)
    assert nothing is None
    # Rounding, which each program does its own way, decides whether it looks once more.
    np.testing.assert_allclose(rounds, bare_rounds, rtol=0.1)
    size = np.abs(bare).max(axis=1, keepdims=True)
    np.testing.assert_allclose(end / size, bare / size, atol=1e-11)
    assert (np.asarray(measures.contacts)[:2] > 20).all()


def test_extremes_do_not_depend_on_how_finely_it_is_measured(beam):
    _, _, rough = marched(beam, RATIOS, 3, tolerance=1e-2)
    _, _, fine = marched(beam, RATIOS, 3, tolerance=1e-9)
    for name in ("highest", "lowest", "force"):
        np.testing.assert_allclose(getattr(rough, name), getattr(fine, name), rtol=1e-7)
    squares = [np.asarray(m.integral_of_square) for m in (rough, fine)]
    np.testing.assert_allclose(*squares, rtol=1e-5)
    assert (np.abs(squares[0] / squares[1] - 1) > 1e-12).any()  # it is measured in other cells


def test_integrals_and_extremes_of_one_mode_in_closed_form(rig):
    one = rig(num_modes=1, gap=1.0)
    equations, ratios = one.equations(), np.array([0.5, 0.9, 1.3])
    w1, zeta = float(equations.angular_frequency[0]), float(equations.damping_ratio[0])
    w = ratios * w1
    gain = equations.input_map * equations.response_map / (w1**2 - w**2 + 2j * zeta * w1 * w)
    amplitude = np.abs(gain) * w**2 * float(one.drive.amplitude)
    end, _, _ = marched(one, ratios, 800, observe=False)
    _, _, measures = marched(one, ratios, 1, state=end)
    np.testing.assert_allclose(measures.highest, amplitude, rtol=1e-11)
    np.testing.assert_allclose(measures.lowest, -amplitude, rtol=1e-11)
    np.testing.assert_allclose(measures.integral_of_square, amplitude**2 * np.pi / w, rtol=1e-9)
    harmonic = np.hypot(measures.integral_with_sine, measures.integral_with_cosine)
    np.testing.assert_allclose(harmonic, amplitude * np.pi / w, rtol=1e-9)


@jax.jit
def nearest(phases, state, angular_frequency, periods=1):
    """March over periods of a clock that drives nothing: how near a stop comes, and when."""
    force = forcing(phases, 0j * angular_frequency, angular_frequency, 0 * angular_frequency)
    ruler = Ruler(jnp.asarray(1e-10), jnp.asarray(jnp.inf), nearest=True)
    _, _, measures = exact_contact.march(phases, force, state, periods, ruler=ruler)
    return measures.nearest[:, 0]


def test_how_near_a_stop_comes_to_a_change_of_contact_in_closed_form(oscillator):
    flying = phases_of(oscillator(stiffness=50.0, gap=1.0))
    distance, phase = nearest(flying, jnp.array([0.0, 0.7]), np.float64(1.0))
    assert distance == pytest.approx(-0.3, abs=1e-9)
    assert phase == pytest.approx(np.pi / 2, abs=1e-6)
    # Before it turns back.
    distance, _ = nearest(flying, jnp.array([0.0, 0.7]), np.float64(5.0))
    assert distance == -np.inf
    # In the second of two periods of the clock.
    distance, phase = nearest(flying, jnp.array([0.0, -0.7]), np.float64(1.5), periods=2)
    assert distance == pytest.approx(-0.3, abs=1e-9)
    assert phase == pytest.approx(1.5 * 3 * np.pi / 2, abs=1e-6)
    # It rests on the stop, by which it is pushed, and rises from it by almost all of its depth.
    resting = phases_of(oscillator(stiffness=50.0, gap=-1.0))
    at_rest, swing = -50 / 51, 0.019
    own = np.sqrt(51.0)
    distance, phase = nearest(resting, jnp.array([at_rest, swing * own]), own)
    assert distance == pytest.approx(-(at_rest + 1 - swing), abs=1e-9)
    assert phase == pytest.approx(3 * np.pi / 2, abs=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_turn_back_and_on_within_a_cell_is_seen(sign):
    """Of depths that rise on, or fall on, on either side of it: those of t^3 - 3 e^2 t."""
    half, width = 0.05, 0.25
    ends = np.linspace(-0.9, 1.1, 9)[:, None]
    depth, rate, bend = ends**3 - 3 * half**2 * ends, 3 * (ends**2 - half**2), 6 * ends
    assert (rate > 0).all()
    derivatives = [jnp.asarray(sign * a * width**k) for k, a in enumerate((depth, rate, bend))]
    top = gauge._highest(tuple(derivatives), 1)
    assert bool(top.inside[0])
    assert top.value[0] == pytest.approx(2 * half**3, rel=1e-9)
    assert -0.9 + width * top.offset[0] == pytest.approx(-sign * half, rel=1e-9)


def test_more_stretches_than_there_is_room_for_at_once(beam):
    end, _, whole = marched(beam, RATIOS, 12)
    assert (np.asarray(whole.events.number)[:3] > PLACES).all()
    state, parts = None, []
    for _ in range(12):
        state, _, measures = marched(beam, RATIOS, 1, state=state)
        parts.append(measures)
    np.testing.assert_allclose(state, end, rtol=1e-8, atol=1e-15)
    for name, of in (("highest", np.max), ("lowest", np.min), ("force", np.max)):
        wanted = of([getattr(m, name) for m in parts], axis=0)
        np.testing.assert_allclose(getattr(whole, name), wanted, rtol=1e-8)
    for name in ("time", "integral_of_square", "contact_time", "contacts"):
        wanted = np.sum([getattr(m, name) for m in parts], axis=0)
        np.testing.assert_allclose(getattr(whole, name), wanted, rtol=1e-8)


def test_measures_have_forward_derivatives(beam):
    start, _, _ = marched(beam, RATIOS, 5, observe=False)
    change = start * jnp.asarray([1.0, -0.5, 0.2, 0.7])

    def read(share):
        _, _, m = marched(beam, RATIOS, 2, state=start + share * change)
        return jnp.stack([m.highest, m.lowest, m.force, m.integral_of_square])

    _, slope = jax.jvp(read, (0.0,), (1.0,))
    h = 1e-5
    differences = (read(h) - read(-h)) / (2 * h)
    np.testing.assert_allclose(slope, differences, rtol=2e-5, atol=1e-9)
