from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import vibrojax as vj
from vibrojax.model.laws import AbstractContactLaw
from vibrojax.stepping.contact_phases import MAX_STOPS, contact_phases, forced_blocks, phases_of


class Quadratic(AbstractContactLaw):
    def force(self, penetration, rate):
        return penetration**2


def with_stops(rig, *stops):
    base = rig()
    return vj.ImpactingBeam(
        base.beam, stops, base.drive, damping_ratio=base.damping_ratio, num_modes=5
    ).equations()


def stop(stiffness=5500.0, damping=5e-5, position=0.5, side=1, gap=4e-4):
    return vj.Stop(position, gap, vj.KelvinVoigt(stiffness, damping), side=side)


CASES = {
    "no stop": lambda rig, one: with_stops(rig),
    "light": lambda rig, one: with_stops(rig, stop()),
    "strong": lambda rig, one: with_stops(rig, stop(damping=20.0)),
    "overdamped": lambda rig, one: with_stops(rig, stop(damping=300.0, position=1.0)),
    "dashpot only": lambda rig, one: with_stops(rig, stop(0.0, 500.0)),
    "two": lambda rig, one: with_stops(rig, stop(), stop(2e4, 0.1, 0.9, -1, 1e-3)),
    "two overdamped": lambda rig, one: with_stops(
        rig, stop(damping=200.0), stop(2e3, 300.0, 1.0, -1, 1e-3)
    ),
    "one mass": lambda rig, one: one(damping_ratio=0.05, damping=0.3),
    "one mass overdamped": lambda rig, one: one(damping=40.0),
    "one mass, overdamped in flight too": lambda rig, one: one(damping_ratio=2.0, damping=40.0),
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys(), scope="module")
def equations(request, rig, oscillator):
    return request.param(rig, oscillator)


@pytest.fixture(scope="module")
def phases(equations):
    return phases_of(equations)


def state_matrix(equations, phase):
    """State matrix and constant of the motion with the stops of this phase touching."""
    w, zeta = (np.asarray(a) for a in (equations.angular_frequency, equations.damping_ratio))
    n = len(w)
    below = np.hstack([-np.diag(w**2), -np.diag(2 * zeta * w)])
    pull = np.zeros(n)
    for s, one in enumerate(equations.stops):
        if phase >> s & 1:
            k, c = (float(x) for x in one.law.linear_coefficients())
            push, place = np.asarray(equations.force_map[:, s]), np.asarray(equations.stop_map[s])
            below -= np.outer(push, np.concatenate([k * place, c * place]))
            pull += push * k * float(one.gap)
    matrix = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), below])
    return matrix, np.concatenate([np.zeros(n), pull])


def propagators(phases, time):
    """Propagator (q, q') of every phase over a time, from the blocks."""
    decay = jnp.exp(phases.exponent * time)
    turn = phases.rate * time
    found = []
    for p in range(phases.rate.shape[0]):
        cos = jnp.where(phases.oscillates[p] > 0, jnp.cos(turn[p]), 1.0)
        sin = jnp.sin(turn[p])
        top = jnp.hstack([jnp.diag(decay[p, 0] * cos), -jnp.diag(decay[p, 0] * sin)])
        bottom = jnp.hstack([jnp.diag(decay[p, 1] * sin), jnp.diag(decay[p, 1] * cos)])
        found.append(phases.to_state[p] @ jnp.vstack([top, bottom]) @ phases.from_state[p])
    return jnp.stack(found)


def scaled(matrix, equations):
    """A propagator on (w1 q, q'), so that its entries compare."""
    w = float(equations.angular_frequency[0])
    n = len(equations.angular_frequency)
    scale = np.concatenate([np.full(n, w), np.ones(n)])
    return scale[:, None] * np.asarray(matrix) / scale


def test_every_phase_is_its_matrix_exponential(equations, phases):
    assert phases.num_stops == len(equations.stops)
    assert phases.rate.shape[0] == 2 ** len(equations.stops)
    for time in np.array([0.01, 0.3, 2.0]) / float(equations.angular_frequency[0]):
        for p, found in enumerate(propagators(phases, time)):
            exact = scaled(expm(state_matrix(equations, p)[0] * time), equations)
            np.testing.assert_allclose(
                scaled(found, equations), exact, atol=1e-9 * np.abs(exact).max()
            )


def test_real_pairs_do_not_oscillate(equations, phases):
    for p in range(phases.rate.shape[0]):
        values = np.linalg.eigvals(state_matrix(equations, p)[0])
        size = np.abs(values).max()
        pairs = np.sum(values.imag > 1e-9 * size)
        assert phases.oscillates[p].sum() == pairs
        assert ((np.asarray(phases.rate[p]) > 0) == (np.asarray(phases.oscillates[p]) > 0)).all()


def test_the_overdamped_cases_are_overdamped(rig, oscillator):
    for name in ("overdamped", "two overdamped", "one mass overdamped", "dashpot only"):
        phases = phases_of(CASES[name](rig, oscillator))
        assert phases.oscillates[-1].sum() < phases.num_blocks


def test_rest_input_and_readout(equations, phases):
    n, k = phases.num_blocks, phases.num_stops
    some = np.random.default_rng(0).normal(size=2 * n)
    for p in range(phases.rate.shape[0]):
        matrix, pull = state_matrix(equations, p)
        unit = np.concatenate([np.full(n, float(equations.angular_frequency[0])), np.ones(n)])
        np.testing.assert_allclose(
            phases.to_state[p] @ phases.rest[p] * unit,
            np.linalg.solve(-matrix, pull) * unit,
            atol=1e-10,
        )
        drive = np.concatenate([np.zeros(n), equations.input_map])
        np.testing.assert_allclose(
            phases.to_state[p] @ phases.input[p] / unit, drive / unit, atol=1e-9
        )
        # Depth, its rate and acceleration, and the response, of a state away from rest.
        blocks = np.asarray(phases.from_state[p] @ some) - np.asarray(phases.rest[p])
        read = np.asarray(phases.readout[p] @ blocks + phases.readout_rest[p])
        rate = matrix @ some + pull
        place, tip = np.asarray(equations.stop_map), np.asarray(equations.response_map)
        gaps = np.array([float(s.gap) for s in equations.stops])
        wanted = [place @ some[:n] - gaps, place @ some[n:], place @ rate[n:]]
        wanted = np.concatenate([*wanted, [tip @ some[:n], tip @ some[n:]]])
        for rows in (slice(0, k), slice(k, 2 * k), slice(2 * k, 3 * k), slice(3 * k, None)):
            size = max(1.0, np.abs(wanted[rows]).max(initial=0.0))
            np.testing.assert_allclose(read[rows], wanted[rows], atol=1e-8 * size)


def test_changes_of_phase_keep_the_state(equations, phases):
    some = np.random.default_rng(1).normal(size=2 * phases.num_blocks)
    for p in range(phases.rate.shape[0]):
        blocks = phases.from_state[p] @ some - phases.rest[p]
        for s in range(phases.num_stops):
            other = p ^ (1 << s)
            moved = phases.change[p, s] @ blocks + phases.change_rest[p, s]
            state = phases.to_state[other] @ (moved + phases.rest[other])
            np.testing.assert_allclose(state, some, atol=1e-8)


def test_forced_response_of_every_phase(equations, phases):
    drive = 1.1 * float(equations.angular_frequency[0])
    amplitude = jnp.asarray(2.0 - 0.5j)
    found = forced_blocks(phases, amplitude, jnp.asarray(drive))
    n = phases.num_blocks
    forcing = np.concatenate([np.zeros(n), equations.input_map]) * complex(amplitude)
    for p in range(phases.rate.shape[0]):
        matrix, _ = state_matrix(equations, p)
        wanted = np.linalg.solve(1j * drive * np.eye(2 * n) - matrix, forcing)
        np.testing.assert_allclose(
            np.asarray(phases.to_state[p]) @ np.asarray(found[p]),
            wanted,
            atol=1e-11 * np.abs(wanted).max(),
        )


@pytest.mark.parametrize(
    "which",
    [
        pytest.param("light", marks=pytest.mark.slow),
        pytest.param("two overdamped", marks=pytest.mark.slow),
        "one mass overdamped",
    ],
)
@pytest.mark.parametrize("name", ["stiffness", "damping", "angular_frequency", "stop_map"])
def test_derivative_of_the_propagators(rig, oscillator, which, name):
    equations = CASES[which](rig, oscillator)
    time = 0.7 / float(equations.angular_frequency[0])

    def changed(factor):
        """The equations with one kind of number multiplied by a factor."""
        if name in ("stiffness", "damping"):
            laws = [
                replace(s.law, **{name: jnp.asarray(getattr(s.law, name)) * factor})
                for s in equations.stops
            ]
            stops = [replace(s, law=law) for s, law in zip(equations.stops, laws, strict=True)]
            return replace(equations, stops=tuple(stops))
        return replace(equations, **{name: getattr(equations, name) * factor})

    @jax.jit
    def slope_at(factor):
        def of(factor):
            return propagators(contact_phases(changed(factor)), time)

        _, slope = jax.jvp(of, (factor,), (1.0,))
        return slope

    slope = slope_at(1.0)

    def exact(factor):
        at = changed(factor)
        return np.stack([expm(state_matrix(at, p)[0] * time) for p in range(len(slope))])

    h = 1e-3
    near, far = exact(1 + h) - exact(1 - h), exact(1 + 2 * h) - exact(1 - 2 * h)
    for p, wanted in enumerate((8 * near - far) / (12 * h)):
        wanted = scaled(wanted, equations)
        size = max(np.abs(wanted).max(), 1e-6)
        np.testing.assert_allclose(scaled(slope[p], equations), wanted, atol=1e-5 * size)


def test_too_many_stops_are_refused(rig):
    one = stop()
    assert phases_of(with_stops(rig, *[one] * 2)).num_stops == 2
    with pytest.raises(ValueError, match=f"^ExactContact takes at most {MAX_STOPS} stops, got 5"):
        contact_phases(with_stops(rig, *[one] * 5))


def test_laws_that_are_not_linear_are_refused(rig):
    curved = with_stops(rig, vj.Stop(0.5, 4e-4, Quadratic()))
    with pytest.raises(ValueError, match=r"^ExactContact needs contact laws that are linear"):
        contact_phases(curved)
    with pytest.raises(ValueError, match=r"^ExactContact needs a system that is linear"):
        vj.ExactContact().prepare(Pendulum(stops=()), vj.NoDrive())


class Pendulum(vj.model.AbstractEquations):
    stops: tuple[vj.Stop, ...]

    def mass(self, q):
        return jnp.eye(1)

    def linear_force(self, q, rate):
        return jnp.zeros(1)

    def smooth_force(self, q, rate):
        return -jnp.sin(q)

    def input(self, q):
        return jnp.cos(q)

    def penetration(self, q):
        return jnp.zeros(0)

    def response(self, q):
        return q[0]

    @property
    def size(self):
        return 1
