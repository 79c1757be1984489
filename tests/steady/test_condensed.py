"""The condensed balance: receptances, the averaged force, and its linearisation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.steady.condensed import (
    balance,
    cell_average,
    cell_force,
    condensed_problem,
    receptance,
    solve_condensed,
    state_of,
)
from vibrojax.steady.paths import Place

SAMPLES = 64


class PowerLaw(vj.model.AbstractContactLaw):
    """A stop that stiffens: F = stiffness d^1.5."""

    stiffness: float

    def force(self, penetration, rate):
        return self.stiffness * penetration * jnp.sqrt(jnp.maximum(penetration, 1e-30))


@pytest.fixture(scope="module")
def equations(rig):
    return rig().equations()


def test_receptance_is_the_sum_over_modes(equations):
    w = jnp.asarray([10.0, 60.0, 300.0])
    table = receptance(equations, w)
    natural, zeta = np.asarray(equations.angular_frequency), np.asarray(equations.damping_ratio)
    push = np.asarray(equations.stop_map[0]) * np.asarray(equations.force_map[:, 0])
    for k, frequency in enumerate(np.asarray(w)):
        modal = 1 / (natural**2 - frequency**2 + 2j * zeta * natural * frequency)
        np.testing.assert_allclose(
            table.stop_from_force[0, 0, k], -np.sum(push * modal), rtol=1e-12
        )
        tip = np.sum(np.asarray(equations.response_map) * np.asarray(equations.input_map) * modal)
        np.testing.assert_allclose(table.response_from_input[k], tip, rtol=1e-12)


def test_coupled_damping_gives_the_same_receptance_by_its_poles():
    stiffness, damping = np.array([[3.0, -1.0], [-1.0, 2.0]]), np.array([[0.2, 0.05], [0.05, 0.1]])
    stop = vj.Stop(position=None, gap=1.0, law=vj.KelvinVoigt(10.0))
    system = vj.MatrixSystem(
        np.eye(2),
        damping,
        stiffness,
        response_map=[0.0, 1.0],
        stops=(stop,),
        stop_map=[[1.0, 0.0]],
        drive=vj.PointForce(1.0),
        input_map=[0.0, 1.0],
    )
    w = np.array([0.7, 1.9])
    table = receptance(system.equations(), jnp.asarray(w))
    for k, frequency in enumerate(w):
        dynamic = np.linalg.inv(stiffness - frequency**2 * np.eye(2) + 1j * frequency * damping)
        np.testing.assert_allclose(table.stop_from_force[0, 0, k], -dynamic[0, 0], rtol=1e-10)
        np.testing.assert_allclose(table.response_from_input[k], dynamic[1, 1], rtol=1e-10)


@pytest.mark.parametrize("change", [3e-5, -2e-4, 0.0])
def test_averaged_force_is_the_mean_over_the_cell(change):
    stop = vj.Stop(0.5, 0.0, vj.KelvinVoigt(5500.0, 2.0))  # no gap: no least width of the cell
    depth = jnp.asarray([-1.5e-4, -1e-5, 1e-6, 4e-5, 3e-4])
    force = cell_force(stop, depth, change * jnp.ones(5), jnp.asarray(100.0))
    u = np.linspace(-1, 1, 200001)
    place = np.asarray(depth)[:, None] + change * u
    exact = np.where(place > 0, 5500.0 * place + 2.0 * change * 100.0, 0.0) * (1 - np.abs(u))
    expected = np.trapezoid(exact, u, axis=1)
    np.testing.assert_allclose(force, expected, atol=2e-5 * np.abs(expected).max() + 1e-12)


def test_any_law_is_averaged_as_the_linear_one_is():
    class Linear(PowerLaw):
        def force(self, penetration, rate):
            return self.stiffness * penetration + 2.0 * rate

    depth, change = jnp.linspace(-1e-4, 2e-4, 31), 5e-5 * jnp.ones(31)
    per_second = jnp.asarray(100.0)
    closed = cell_force(vj.Stop(0.5, 4e-4, vj.KelvinVoigt(5500.0, 2.0)), depth, change, per_second)
    general = cell_force(vj.Stop(0.5, 4e-4, Linear(5500.0)), depth, change, per_second)
    np.testing.assert_allclose(general, closed, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("law", [vj.KelvinVoigt(5500.0, 0.5), PowerLaw(3e5)])
def test_condensed_solution_solves_the_linearised_balance(rig, law):
    stops = (vj.Stop(0.5, 0.4e-3, law), vj.Stop(0.8, 0.6e-3, law, side=-1))
    base = rig()
    system = vj.ImpactingBeam(base.beam, stops, base.drive, 0.018, 5)
    equations = system.equations()
    w = 1.1 * equations.angular_frequency[0]
    solve = eqx.filter_jit(solve_condensed)
    place = Place(equations, system.drive, w)
    problem = eqx.filter_jit(condensed_problem)(place, samples=SAMPLES)

    def residual(spectrum):
        return balance(problem, spectrum).residual

    spectrum = problem.drive  # deep in both stops
    at = eqx.filter_jit(balance)(problem, spectrum)
    touching = int(jnp.sum((at.stiffness != 0) | (at.damping != 0)))
    assert touching > 10
    change = solve(problem, at, -at.residual[None], 2 * SAMPLES)[0]
    smallest = solve(problem, at, -at.residual[None], touching)[0]
    np.testing.assert_allclose(smallest, change, rtol=1e-9, atol=1e-9 * np.abs(change).max())
    moved = jax.jit(lambda at, change: jax.jvp(residual, (at,), (change,))[1])(spectrum, change)
    size = np.abs(np.asarray(at.residual)).max()
    np.testing.assert_allclose(moved, -at.residual, atol=1e-9 * size)


def test_state_of_a_balance_without_contact_is_the_steady_state(equations, rig):
    w = 0.8 * equations.angular_frequency[0]
    none = jnp.zeros((1, SAMPLES // 2 + 1), complex)
    angle = jnp.asarray(0.7)
    state = state_of(Place(equations, rig().drive, w), none, angle)
    natural, zeta = np.asarray(equations.angular_frequency), np.asarray(equations.damping_ratio)
    w = float(w)
    phasor = 0.2e-3 * w**2 * np.asarray(equations.input_map)
    phasor = phasor / (natural**2 - w**2 + 2j * zeta * natural * w) * np.exp(0.7j)
    expected = np.concatenate([phasor.imag, (1j * w * phasor).imag])
    np.testing.assert_allclose(state, expected, rtol=1e-10, atol=1e-18)


def test_average_over_a_cell_is_one_at_rest():
    average = cell_average(SAMPLES, SAMPLES // 2 + 1)
    assert average[0] == 1.0
    np.testing.assert_allclose(average[-1], (2 / np.pi) ** 2)
