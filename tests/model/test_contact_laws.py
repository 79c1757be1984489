"""Contact laws beyond Kelvin-Voigt: their forces, and every method with every law."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import vibrojax as vj
from vibrojax.model.laws import stored_energy

RUBBER = vj.StandardLinearSolid(5500.0, 4000.0, 2e-3)
LAWS = {
    "kelvin_voigt": vj.KelvinVoigt(5500.0, 0.5, tension=False),
    "hertz": vj.Hertz(3e5),
    "hunt_crossley": vj.HuntCrossley(3e5, 0.5),
    "rubber": RUBBER,
}
SMOOTH = ("hertz", "hunt_crossley")


@pytest.fixture
def beam(rig):
    """Builder of the default rig with another law at its stop, the corner of the force kept."""

    def make(law, smoothing=0.0, **numbers):
        system = rig(damping_ratio=0.03, num_modes=2, **numbers)
        stop = vj.Stop(0.5, 0.4e-3, law, smoothing=smoothing)
        return vj.ImpactingBeam(
            system.beam, stop, system.drive, system.damping_ratio, system.num_modes
        )

    return make


def test_forces_by_hand():
    depth, rate = jnp.array([0.0, 4e-4, 4e-4]), jnp.array([1.0, 0.5, -3.0])
    np.testing.assert_allclose(vj.Hertz(1e6).force(depth, rate), [0, 8.0, 8.0])
    law = vj.HuntCrossley(1e6, 0.4)
    np.testing.assert_allclose(law.force(depth, rate), [0, 8 * (1 + 0.6 * 0.5), 0], atol=1e-15)
    law = vj.HuntCrossley(1e3, 0.2, exponent=1.0)
    np.testing.assert_allclose(law.force(depth, rate)[1], 0.4 * 1.15)


def test_rubber_relaxes_from_the_sum_of_both_springs_to_the_slow_one():
    depth, still = jnp.asarray(1e-3), jnp.asarray(0.0)
    assert RUBBER.force(depth, still) == pytest.approx(9.5)
    memory = jnp.asarray(1e-3)
    assert RUBBER.force_with_memory(depth, still, memory) == pytest.approx(5.5)
    assert RUBBER.memory_rate(depth, still, memory) == 0
    assert RUBBER.memory_rate(depth, still, 0 * memory) == pytest.approx(0.5)
    # Left alone, the surface stays behind until it has crept back, and nothing pulls.
    behind = 4000 / 9500 * 1e-3
    assert RUBBER.force_with_memory(jnp.asarray(0.9 * behind), still, memory) == 0
    assert RUBBER.memory_rate(still, still, memory) == pytest.approx((behind - 1e-3) / 2e-3)


@pytest.mark.parametrize("law", [*LAWS.values(), vj.Hertz(1e4, 2.2)], ids=str)
def test_stored_energy_is_the_work_of_a_slow_force(law):
    def slow(depth):
        if isinstance(law, vj.StandardLinearSolid):  # relaxed all the way
            return float(law.force_with_memory(depth, jnp.asarray(0.0), depth))
        return float(law.force(depth, jnp.asarray(0.0)))

    for depth in (0.0, 1e-5, 7e-4):
        work = quad(lambda d: slow(jnp.asarray(d)), 0, depth, epsabs=1e-15)[0]
        stored = stored_energy(law, jnp.asarray(depth), jnp.asarray(depth))
        assert stored == pytest.approx(work, rel=1e-9, abs=1e-18)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_derivatives_of_the_force_are_finite_everywhere(name):
    stop = vj.Stop(1.0, 1e-3, LAWS[name])

    def force(depth, rate, memory):
        return stop.force(depth, rate, memory)

    for smoothing in (None, 0.0):
        stop = vj.Stop(1.0, 1e-3, LAWS[name], smoothing=smoothing)
        for depth in (-1e-3, 0.0, 1e-9, 1e-3):
            point = (depth, 0.1, 1e-4)
            first = jax.grad(force, (0, 1, 2))(*point)
            second = jax.hessian(force, (0, 1, 2))(*point)
            assert np.isfinite(jax.tree.leaves((first, second))).all()


SOME = [
    pytest.param("kelvin_voigt", marks=pytest.mark.slow),
    pytest.param("hertz", marks=pytest.mark.slow),
    pytest.param("hunt_crossley", marks=pytest.mark.slow),
    "rubber",
]


@pytest.mark.parametrize("name", SOME)
def test_histories_agree_with_scipy_and_with_other_solvers(beam, name):
    import diffrax

    system = beam(LAWS[name])
    settings = {"frequency_ratio": 1.1, "periods": 6, "samples_per_period": 64}
    ours = vj.simulate(system, **settings, tolerance=1e-7)
    if name in ("hertz", "rubber"):
        peer = vj.simulate(system, **settings, stepper=diffrax.Tsit5(), tolerance=1e-8)
        size = float(jnp.max(jnp.abs(peer.displacement())))
        np.testing.assert_allclose(ours.displacement(), peer.displacement(), atol=1e-5 * size)
        return
    motion, equations = ours.motion, ours.motion.equations
    solved = solve_ivp(
        jax.jit(lambda t, y: motion.vector_field(t, y, None)),
        (0.0, float(ours.time[-1])),
        np.zeros(equations.state_size),
        t_eval=np.asarray(ours.time),
        rtol=1e-9,
        atol=1e-13,
        max_step=1e-4,
    )
    expected = solved.y[: equations.size].T @ np.asarray(equations.response_map)
    np.testing.assert_allclose(ours.displacement(), expected, atol=2e-5 * np.abs(expected).max())


@pytest.mark.slow
def test_rubber_with_a_short_memory_is_a_spring(beam):
    settings = {"frequency_ratio": 1.1, "periods": 5, "tolerance": 1e-6}
    # Relaxed before anything happens: the slow spring alone.
    rubber = vj.simulate(beam(vj.StandardLinearSolid(5500.0, 4000.0, 1e-9)), **settings)
    spring = vj.simulate(beam(vj.KelvinVoigt(5500.0, tension=False)), **settings)
    size = float(jnp.max(jnp.abs(spring.displacement())))
    np.testing.assert_allclose(rubber.displacement(), spring.displacement(), atol=1e-4 * size)
    # One that never relaxes: both springs.
    rubber = vj.simulate(beam(vj.StandardLinearSolid(5500.0, 4000.0, 1e9)), **settings)
    spring = vj.simulate(beam(vj.KelvinVoigt(9500.0, tension=False)), **settings)
    np.testing.assert_allclose(rubber.displacement(), spring.displacement(), atol=1e-4 * size)


def test_histories_go_on_from_where_another_ended(beam):
    system = beam(RUBBER)
    settings = {"frequency_ratio": 1.1, "samples_per_period": 32}
    whole = vj.simulate(system, periods=4, **settings)
    first = vj.simulate(system, periods=2, **settings)
    state = first.coordinates[-1], first.rates[-1], first.memory[-1]
    assert float(jnp.max(whole.memory)) > 1e-5
    second = vj.simulate(system, periods=2, initial_state=state, **settings)
    np.testing.assert_allclose(whole.memory[64:], second.memory, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(whole.coordinates[-1], second.coordinates[-1], rtol=1e-9)
    with pytest.raises(ValueError, match=r"and the internal states, shape \(1,\)"):
        vj.simulate(system, periods=1, initial_state=(*state, 0.0), **settings)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SMOOTH, "rubber"])
def test_sweep_shooting_and_balance_find_the_same_motion(beam, name):
    system = beam(LAWS[name])
    curve = vj.frequency_sweep(
        system,
        frequency_ratio=[1.05],
        settings=vj.SweepSettings(direction="forward", tolerance=1e-4, refine_jumps=None),
    )
    assert int(curve.period.item()) == 1
    shot = vj.periodic_response(
        system, frequency_ratio=1.05, settings=vj.PeriodicSettings(method=vj.Shooting())
    )
    assert shot.status == vj.Status.settled.value
    # Shooting reads the force at its steps: less finely than the displacement.
    found = {
        "amplitude_ratio": pytest.approx(float(shot.amplitude_ratio), rel=1e-3),
        "contact_force": pytest.approx(float(shot.contact_force), rel=1e-2),
    }
    for key, value in found.items():
        assert getattr(curve, key).item() == value, key
    assert float(shot.contact_force) > 0.3
    balance = vj.PeriodicSettings(method=vj.HarmonicBalance())
    balanced = vj.periodic_response(system, frequency_ratio=1.05, settings=balance)
    for key, value in found.items():
        assert float(getattr(balanced, key)) == value, key


class Putty(vj.model.AbstractMemoryLaw):
    """Rubber whose spring stiffens."""

    def force_with_memory(self, penetration, rate, memory):
        return jnp.maximum(5500.0 * penetration + 1e8 * (penetration - memory) ** 2, 0.0)

    def memory_rate(self, penetration, rate, memory):
        return (penetration - memory) / 2e-3

    def stored_energy_with_memory(self, penetration, memory):
        return 5500.0 * penetration**2 / 2


class Paste(vj.model.AbstractMemoryLaw):
    """Putty with two memories, each of which draws the other after it."""

    @property
    def memory_size(self):
        return 2

    def force_with_memory(self, penetration, rate, memory):
        return 5500.0 * penetration + 1e6 * (penetration - memory[0]) * (penetration - memory[1])

    def memory_rate(self, penetration, rate, memory):
        return jnp.stack([penetration - memory[1], 3 * memory[0] - 2 * memory[1]]) / 2e-3

    def stored_energy_with_memory(self, penetration, memory):
        return 5500.0 * penetration**2 / 2 + 100.0 * (memory[0] ** 2 + memory[1] ** 2)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_several_memories_are_at_rest_where_none_are_given(shape):
    depth = jnp.full(shape, 1e-3)
    stop, still = vj.Stop(0.5, 4e-4, Paste()), jnp.zeros_like(depth)
    for force in (Paste().force, stop.force, stop.exact_force):
        np.testing.assert_allclose(force(depth, still), np.full(shape, 6.5))
    for law in (Paste(), vj.model.MaxwellChain(5500.0, [0.0, 0.0], [1e-3, 1e-2])):
        found = stored_energy(law, depth)
        np.testing.assert_allclose(found, np.full(shape, 2.75e-3), rtol=1e-12)
    assert stop.stored_energy(depth).shape == shape


def test_laws_with_memory_are_refused_by_name_where_they_cannot_be(beam):
    system = beam(Putty())
    sentence = "Putty has an internal state that is not linear. Use frequency_sweep"
    with pytest.raises(ValueError, match=sentence):
        vj.periodic_response(
            system, frequency_ratio=1.1, settings=vj.PeriodicSettings(method=vj.HarmonicBalance())
        )
    with pytest.raises(ValueError, match=sentence):
        vj.continue_response(system, frequency_ratio=vj.Range(1.0, 1.2))
    with pytest.raises(ValueError, match="Putty"):
        vj.single_contact_response(system, frequency_ratio=[1.1])
    for law in (Putty(), LAWS["hertz"]):
        with pytest.raises(ValueError, match="ExactContact needs at most 4 stops that are linear"):
            vj.simulate(beam(law), frequency_ratio=1.1, periods=1, stepper=vj.ExactContact())


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: vj.Hertz(-1.0), "stiffness must be at least 0"),
        (lambda: vj.Hertz(1.0, exponent=0.5), "exponent must be from 1"),
        (lambda: vj.HuntCrossley(1.0, -0.1), "dissipation must be at least 0"),
        (lambda: vj.HuntCrossley(-1.0, 0.1), "stiffness must be at least 0"),
        (lambda: vj.StandardLinearSolid(-1.0, 1.0, 1.0), "stiffness must be at least 0"),
        (lambda: vj.StandardLinearSolid(1.0, -1.0, 1.0), "maxwell_stiffness must be at least 0"),
        (lambda: vj.StandardLinearSolid(1.0, 1.0, 0.0), "relaxation_time must be above 0"),
        (lambda: vj.KelvinVoigt(1.0, -1.0), "damping must be at least 0"),
    ],
)
def test_negative_numbers_are_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_gradients_of_a_history(beam, name):
    def energy(scale, gradient):
        law = jax.tree.map(lambda a: a * scale, LAWS[name])
        solver = None if name == "kelvin_voigt" else vj.ExponentialSplitting(steps_per_period=800)
        history = vj.simulate(
            beam(law),
            frequency_ratio=1.1,
            periods=2,
            samples_per_period=32,
            stepper=solver,
            gradient=gradient,
        )
        return jnp.sum(history.displacement() ** 2) * 1e6

    step = 1e-5
    expected = (energy(1 + step, "forward") - energy(1 - step, "forward")) / (2 * step)
    forward = jax.jacfwd(lambda s: energy(s, "forward"))(1.0)
    assert forward == pytest.approx(float(expected), rel=2e-4)
    if name != "kelvin_voigt":
        reverse = jax.grad(lambda s: energy(s, "reverse"))(1.0)
        assert reverse == pytest.approx(float(forward), rel=1e-8)
