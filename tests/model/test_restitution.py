"""Laws made from a coefficient of restitution: a free mass thrown at them, integrated by scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import vibrojax as vj


def thrown(force, mass, speed, leaves_at_zero_force):
    """Speed that a mass is left with over the one that it came with."""

    def field(_, state):
        return [state[1], -force(*state) / mass]

    def leaves(time, state):
        if time == 0.0:
            return 1.0
        return force(*state) if leaves_at_zero_force and state[1] < 0 else state[0]

    leaves.terminal, leaves.direction = True, -1
    settings = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14, "max_step": 1e-3}
    run = solve_ivp(field, (0.0, 10.0), [0.0, speed], events=leaves, **settings)
    return -run.y_events[0][0, 1] / speed


@pytest.mark.parametrize("tension", [True, False])
def test_kelvin_voigt(tension):
    stiffness, mass = 300.0, 0.4
    restitution = jnp.array([0.9, 0.4, 0.15, 0.12])  # without tension the last is overdamped
    law = vj.KelvinVoigt.from_restitution(
        restitution, stiffness=stiffness, mass=mass, tension=tension
    )
    damping = np.asarray(law.damping)
    assert (damping[-1] > 2 * np.sqrt(stiffness * mass)) == (not tension)
    for c, e in zip(damping, np.asarray(restitution), strict=True):
        left = thrown(lambda d, v, c=c: stiffness * d + c * v, mass, 0.7, not tension)
        np.testing.assert_allclose(left, e, rtol=1e-9)


def test_hunt_crossley():
    stiffness, mass, speed = 2e4, 0.4, 0.7
    for e in (0.95, 0.5, 0.2):
        law = vj.HuntCrossley.from_restitution(e, speed=speed, stiffness=stiffness)
        a = 1.5 * float(law.dissipation)
        left = thrown(
            lambda d, v, a=a: stiffness * max(d, 0.0) ** 1.5 * (1 + a * v), mass, speed, False
        )
        np.testing.assert_allclose(left, e, rtol=1e-9)


def damping(restitution, tension):
    return vj.KelvinVoigt.from_restitution(
        restitution, stiffness=1.0, mass=1.0, tension=tension
    ).damping


def dissipation(restitution):
    return vj.HuntCrossley.from_restitution(restitution, speed=1.0, stiffness=1.0).dissipation


@pytest.mark.parametrize(
    ("number", "inside"),
    [
        (lambda e: damping(e, True), np.exp(-np.pi / np.sqrt(3))),  # damping ratio 1/2
        (lambda e: damping(e, False), np.exp(-2.0)),  # 1: where both closed forms are 0/0
        (dissipation, 0.73),  # where the series meets the closed form
    ],
)
def test_derivatives(number, inside):
    places = jnp.array([1e-3, 0.3, inside, 0.999])
    slope = jax.vmap(jax.grad(number))(places)
    step = 1e-5 * places
    differences = (number(places + step) - number(places - step)) / (2 * step)
    np.testing.assert_allclose(slope, differences, rtol=1e-6)
    # At restitution 1, where they begin, differences have one side only.
    assert number(1.0) == 0.0
    np.testing.assert_allclose(number(1 - 1e-7) / 1e-7, -jax.grad(number)(1.0), rtol=1e-5)


def test_known_values():
    np.testing.assert_allclose(damping(np.exp(-np.pi / np.sqrt(3)), True), 1.0, rtol=1e-14)
    np.testing.assert_allclose(damping(np.exp(-2.0), False), 2.0, rtol=1e-13)
    # At low speeds 1 - e is the dissipation times the speed.
    np.testing.assert_allclose(dissipation(1 - 1e-6), 1e-6, rtol=1e-5)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: damping(1.1, True), "restitution must be above 0 and at most 1"),
        (lambda: damping(0.0, True), r"restitution must be .* got 0.0"),
        (lambda: dissipation(-0.1), "restitution must be above 0"),
        (
            lambda: vj.KelvinVoigt.from_restitution(0.7, stiffness=1e4, mass=0.0),
            "mass must be above 0 kg",
        ),
        (
            lambda: vj.HuntCrossley.from_restitution(0.7, speed=0.0, stiffness=1e4),
            "speed must be above 0 m/s",
        ),
    ],
)
def test_refusals(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()


def test_mass_at_a_stop(rig):
    system = rig(num_modes=3)
    free = system.modes()
    shape, mass = np.asarray(free.shape(0.5)), np.asarray(free.modal_mass)
    np.testing.assert_allclose(system.mass_at(), 1 / np.sum(shape**2 / mass), rtol=1e-12)
    np.testing.assert_allclose(system.mass_at(1, modes=1), mass[0] / shape[0] ** 2, rtol=1e-12)
    with pytest.raises(ValueError, match="stop must be a whole number from 1 to 1"):
        system.mass_at(2)
    with pytest.raises(ValueError, match="linear between contacts"):
        vj.default_pendulum().mass_at()
