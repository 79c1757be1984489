"""Systems given by matrices: against a beam, closed forms and scipy; what they refuse."""

from dataclasses import replace

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import eigh, expm
from scipy.optimize import brentq

import vibrojax as vj
from vibrojax.ensemble.lanes import lanes_of
from vibrojax.model.systems import as_arrays, equations_of
from vibrojax.stepping import splitting
from vibrojax.stepping.contact_phases import contact_phases, forced_blocks

STIFFNESS = np.array([[1.0, -1.0], [-1.0, 2.0]])
DASHPOT = np.array([[0.2, 0.0], [0.0, 0.0]])
STOP = vj.Stop(None, 1.0, vj.KelvinVoigt(100.0))


def two_masses(**changes):
    """The two-mass example of NLvib: a unilateral spring at mass 1, a force on mass 2."""
    numbers = {
        "mass": np.eye(2),
        "damping": 0.03 * STIFFNESS,
        "stiffness": STIFFNESS,
        "stops": STOP,
        "stop_map": [[1.0, 0.0]],
        "drive": vj.PointForce(0.1),
        "input_map": [0.0, 1.0],
        "response_map": [1.0, 0.0],
    }
    return vj.MatrixSystem(**numbers | changes)


def from_beam(beam, mixing=None, **changes):
    """The modal matrices of a beam, in other coordinates if `mixing` is given: q = mixing x."""
    e = equations_of(beam)
    t = np.eye(e.size) if mixing is None else mixing
    mass, w = np.asarray(e.modal_mass), np.asarray(e.angular_frequency)

    def matrix(diagonal):
        full = t.T @ np.diag(diagonal) @ t
        return (full + full.T) / 2

    numbers = {
        "mass": matrix(mass),
        "damping": matrix(2 * mass * np.asarray(e.damping_ratio) * w),
        "stiffness": matrix(mass * w**2),
        "stops": tuple(replace(stop, position=None) for stop in beam.stops),
        # The equations have the side in the map already, and the system multiplies by it.
        "stop_map": np.array([[float(s.side)] for s in beam.stops]) * np.asarray(e.stop_map) @ t,
        "drive": beam.drive,
        "input_map": t.T @ np.asarray(e.modal_mass * e.input_map),
        "response_map": np.asarray(e.response_map) @ t,
    }
    return vj.MatrixSystem(**numbers | changes)


def mixing(size):
    return np.eye(size) + 0.3 * np.random.default_rng(0).normal(size=(size, size))


def test_two_masses_of_nlvib():
    system = two_masses()
    equations = equations_of(system)
    exact = np.sqrt((3 + np.array([-1, 1]) * np.sqrt(5)) / 2)
    np.testing.assert_allclose(equations.angular_frequency, exact, rtol=1e-14)
    np.testing.assert_allclose(equations.damping_ratio, 0.03 * exact / 2, rtol=1e-13)
    assert equations.damping_coupling is None
    shapes = np.asarray(system.modes().shapes)
    np.testing.assert_allclose(shapes.T @ shapes, np.eye(2), atol=1e-14)
    np.testing.assert_allclose(shapes.T @ STIFFNESS @ shapes, np.diag(exact**2), atol=1e-14)
    np.testing.assert_allclose(equations.force_map, shapes[:1].T)
    np.testing.assert_allclose(equations.input_map, shapes[1])


def test_forced_response_in_flight_and_in_contact():
    system = two_masses(damping=0.03 * STIFFNESS + DASHPOT)
    phases = eqx.filter_jit(contact_phases)(equations_of(system))
    w = 2 * np.pi * 0.1
    blocks = forced_blocks(phases, jnp.asarray(1.0 + 0j), jnp.asarray(w))
    for touching in (0, 1):
        q = (phases.to_state[touching] @ blocks[touching])[:2]
        held = STIFFNESS + np.diag([100.0 * touching, 0.0])
        dynamic = held + 1j * w * system.damping - w**2 * np.eye(2)
        wanted = np.linalg.solve(dynamic, [0.0, 1.0])
        np.testing.assert_allclose(system.modes().shapes @ q, wanted, rtol=1e-11)


@pytest.fixture(scope="module")
def pair(rig):
    """A beam with its stop below, and the same beam as matrices in other coordinates."""
    beam = rig(side=-1, num_modes=3)
    matrices = from_beam(beam, mixing(3))
    assert matrices.proportional
    return matrices, beam


@pytest.mark.slow
def test_history_of_the_same_beam(pair):
    arguments = {"frequency": 9.8, "periods": 3, "samples_per_period": 32, "gradient": "forward"}
    ours, wanted = (vj.simulate(s, **arguments) for s in pair)
    size = np.max(np.abs(wanted.displacement()))
    np.testing.assert_allclose(ours.displacement(), wanted.displacement(), atol=1e-9 * size)
    assert np.max(wanted.contact_force) > 0.1
    np.testing.assert_allclose(ours.contact_force, wanted.contact_force, atol=1e-6)
    np.testing.assert_allclose(wanted.displacement(), wanted.displacement(1.0), atol=1e-12 * size)
    with pytest.raises(ValueError, match=r"^Only the history of a beam has a position"):
        ours.displacement(1.0)
    np.testing.assert_array_equal(ours.to_xarray()["displacement"], ours.displacement())
    assert ours.plot().axes[0].get_ylabel() == "Displacement (mm)"
    label = wanted.plot().axes[0].get_ylabel()
    assert label.replace("\n", " ") == "Displacement at x/L = 1 (mm)"
    assert "x/L = 1" in label  # on one line


@pytest.mark.slow
def test_sweep_of_the_same_beam(pair):
    ours, wanted = (
        vj.frequency_sweep(
            s,
            frequency_ratio=[1.0, 1.1],
            settings=vj.SweepSettings(direction="forward", max_period=1, refine_jumps=None),
        )
        for s in pair
    )
    assert wanted.contact_force.max() > 0.5
    assert (wanted.period == 1).all()
    for name in ("amplitude_ratio", "contact_force", "contact_fraction"):
        np.testing.assert_allclose(getattr(ours, name), getattr(wanted, name), rtol=1e-4)


def test_fewer_modes_are_the_lowest(pair):
    matrices, beam = pair
    found = equations_of(replace(matrices, num_modes=2))
    assert found.size == 2
    wanted = equations_of(beam).angular_frequency[:2]
    np.testing.assert_allclose(found.angular_frequency, wanted, rtol=1e-10)


def test_fine_meshes_keep_their_lowest_modes():
    n, h = 50, 1 / 50
    bend = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]], float)
    heavy = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
    mass, stiffness = np.zeros((2, 2 * n + 2, 2 * n + 2))
    for e in range(n):
        place = slice(2 * e, 2 * e + 4)
        stiffness[place, place] += bend / h**3
        mass[place, place] += heavy * h / 420
    mass, stiffness = mass[2:, 2:], stiffness[2:, 2:]
    tip = np.zeros(2 * n)
    tip[-2] = 1
    system = vj.MatrixSystem(
        mass, 1e-4 * stiffness + 0.1 * mass, stiffness, response_map=tip, num_modes=5
    )
    assert system.proportional
    equations = equations_of(system)
    np.testing.assert_allclose(equations.angular_frequency[0], 1.875104068711961**2, rtol=1e-8)
    assert abs(float(equations.response_map[0])) == pytest.approx(2.0, rel=1e-6)
    w = np.asarray(equations.angular_frequency)
    np.testing.assert_allclose(equations.damping_ratio, 0.05 / w + 5e-5 * w, rtol=1e-7)


def free_decay(system, start, times, touching=False):
    """x and x' by the matrix exponential, with the stop of mass 1 always or never touching."""
    stiffness = STIFFNESS + np.diag([100.0 * touching, 0.0])
    below = -np.linalg.solve(system.mass, np.hstack([stiffness, system.damping]))
    matrix = np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), below])
    push = np.linalg.solve(system.mass, [100.0 * touching, 0.0])
    rest = np.linalg.solve(-matrix, np.concatenate([np.zeros(2), push])) if touching else 0.0
    return np.array([expm(matrix * t) @ (start - rest) + rest for t in times])


@pytest.mark.parametrize(
    ("solver", "bound"), [(vj.ExactContact(1e-9), 1e-9), (diffrax.Tsit5(), 1e-5)]
)
def test_free_decay_with_a_dashpot_through_a_contact(solver, bound):
    mass = np.array([[2.0, 0.3], [0.3, 1.0]])
    # A corner rounded over 1e-6 gap leaves Tsit5 near the exact corner.
    stop = STOP if isinstance(solver, vj.ExactContact) else replace(STOP, smoothing=1e-6)
    system = two_masses(mass=mass, damping=DASHPOT, drive=vj.NoDrive(), stops=stop)
    assert not system.proportional
    assert np.abs(equations_of(system).damping_coupling).max() > 0.01
    x, v = np.array([0.9, 0.2]), np.array([1.0, -0.5])
    q, rate = system.modal_coordinates(x), system.modal_coordinates(v)
    run = vj.simulate(
        system,
        duration=1.0,
        samples=40,
        initial_state=(q, rate),
        stepper=solver,
        tolerance=1e-9,
        gradient="forward",
    )
    # In flight to the touch, in contact to the release, in flight again.
    start = np.concatenate([x, v])
    t1 = brentq(lambda t: free_decay(system, start, [t])[0, 0] - 1, 0.0, 0.3, xtol=1e-14)
    (touch,) = free_decay(system, start, [t1])
    t2 = brentq(lambda t: free_decay(system, touch, [t], True)[0, 0] - 1, 0.3, 0.7, xtol=1e-14)
    (release,) = free_decay(system, touch, [t2], True)
    time = np.asarray(run.time)
    wanted = np.concatenate(
        [
            free_decay(system, start, time[time <= t1]),
            free_decay(system, touch, time[(time > t1) & (time <= t1 + t2)] - t1, True),
            free_decay(system, release, time[time > t1 + t2] - t1 - t2),
        ]
    )
    shapes = system.modes().shapes
    np.testing.assert_allclose(run.coordinates @ shapes.T, wanted[:, :2], atol=bound)
    np.testing.assert_allclose(run.rates @ shapes.T, wanted[:, 2:], atol=10 * bound)
    assert np.max(run.contact_force) > 5


def test_linear_force_and_acceleration_have_the_whole_damping():
    mass = np.array([[2.0, 0.3], [0.3, 1.0]])
    system = two_masses(mass=mass, damping=DASHPOT)
    equations, shapes = equations_of(system), system.modes().shapes
    x, v = np.array([0.4, -0.2]), np.array([0.7, 0.5])
    q, rate = system.modal_coordinates(x), system.modal_coordinates(v)
    wanted = DASHPOT @ v + STIFFNESS @ x
    np.testing.assert_allclose(equations.linear_force(q, rate), shapes.T @ wanted, atol=1e-13)
    wanted = np.linalg.solve(mass, np.array([0.0, 3.0]) - wanted)
    np.testing.assert_allclose(shapes @ equations.acceleration(q, rate, 3.0), wanted, atol=1e-13)
    np.testing.assert_allclose(
        vj.model.AbstractEquations.acceleration(equations, q, rate, 3.0),
        equations.acceleration(q, rate, 3.0),
        atol=1e-13,
    )


def test_gradients_in_the_matrices():
    """Of the free vibration by the phases, with respect to entries off the diagonal."""
    base = {"mass": np.diag([2.0, 1.0]), "damping": 0.03 * STIFFNESS, "stiffness": STIFFNESS}
    x = np.array([0.4, -0.2])

    @jax.jit
    def later(changes):
        off = jnp.array([[0.0, 1.0], [1.0, 0.0]])
        changed = [m + c * off for m, c in zip(base.values(), changes, strict=True)]
        system = two_masses(**dict(zip(base, changed, strict=True)))
        phases = contact_phases(system.equations())
        q = system.modal_coordinates(x)
        blocks = phases.from_state[0] @ jnp.concatenate([q, jnp.zeros(2)])
        decay, turn = jnp.exp(2.0 * phases.exponent[0, 0]), 2.0 * phases.rate[0]
        first, second = jnp.split(blocks, 2)
        cos, sin = decay * jnp.cos(turn), decay * jnp.sin(turn)
        turned = jnp.concatenate([cos * first - sin * second, sin * first + cos * second])
        return system.modes().shapes @ (phases.to_state[0] @ turned)[:2]

    exact = free_decay(two_masses(**base), np.append(x, [0, 0]), [2.0])[0, :2]
    np.testing.assert_allclose(later(np.zeros(3)), exact, atol=1e-12)
    slopes = jax.jit(jax.jacfwd(later))(np.zeros(3)).T
    for slope, step in zip(slopes, 1e-4 * np.eye(3), strict=True):
        assert np.max(np.abs(slope)) > 1e-2
        np.testing.assert_allclose(slope, (later(step) - later(-step)) / 2e-4, atol=1e-6)


def test_reverse_gradient_of_a_natural_frequency():
    def first(entry):
        stiffness = [[1.0, -1.0], [-1.0, entry]]
        return two_masses(stiffness=stiffness).equations().angular_frequency[0]

    w2, vectors = eigh(STIFFNESS)
    wanted = vectors[1, 0] ** 2 / (2 * np.sqrt(w2[0]))
    assert float(jax.jit(jax.grad(first))(2.0)) == pytest.approx(wanted, rel=1e-12)


def test_a_dashpot_as_an_axis_may_vanish():
    """The systems of a study differ in structure only until they are stacked."""

    def system(dashpot):
        return two_masses(damping=0.03 * STIFFNESS + dashpot * DASHPOT)

    assert [system(c).proportional for c in (0.0, 1.0)] == [True, False]
    lanes = lanes_of(system, {"dashpot": [0.0, 1.0]})
    coupling = eqx.filter_vmap(equations_of)(lanes.systems).damping_coupling
    np.testing.assert_allclose(coupling[0], 0.0, atol=1e-16)
    np.testing.assert_allclose(coupling[1], equations_of(system(1.0)).damping_coupling, atol=1e-16)


def test_splitting_takes_proportional_damping_only():
    method = vj.ExponentialSplitting()
    assert method.prepare(equations_of(two_masses()), vj.NoDrive()) is not None
    coupled = two_masses(damping=DASHPOT)
    refusal = "^ExponentialSplitting needs modes that neither damping nor internal states couple"
    with pytest.raises(ValueError, match=refusal):
        vj.simulate(coupled, stepper=method, frequency=0.1, periods=1)
    with pytest.raises(ValueError, match=refusal):
        vj.frequency_sweep(coupled, frequency=[0.1], settings=vj.SweepSettings(stepper=method))
    with pytest.raises(ValueError, match=refusal):
        splitting.steady(equations_of(coupled), jnp.asarray(1.0 + 0j), jnp.asarray(1.0))


def test_replaced_matrices_are_not_taken_for_proportional():
    def stiffened(system):
        return eqx.tree_at(lambda s: s.stiffness, system, STIFFNESS + np.diag([0.5, 0.0]))

    stale = stiffened(two_masses())
    with pytest.raises(RuntimeError, match="The damping couples the modes"):
        jax.block_until_ready(equations_of(as_arrays(stale)))
    general = equations_of(stiffened(two_masses(proportional=False)))
    anew = equations_of(two_masses(stiffness=STIFFNESS + np.diag([0.5, 0.0])))
    np.testing.assert_allclose(general.damping_coupling, anew.damping_coupling, atol=1e-15)
    scaled = equations_of(eqx.tree_at(lambda s: s.damping, two_masses(), 0.1 * STIFFNESS))
    assert scaled.damping_coupling is None


def test_traced_matrices_pass_and_keep_their_coupling():
    @jax.jit
    def coupling(scale):
        return two_masses(damping=scale * STIFFNESS).equations().damping_coupling

    np.testing.assert_allclose(coupling(0.03), np.zeros((2, 2)), atol=1e-16)

    @jax.jit
    def sure(scale):
        return two_masses(damping=scale * STIFFNESS, proportional=True).equations()

    assert sure(0.03).damping_coupling is None


def test_without_stops_and_drive():
    system = vj.MatrixSystem(np.eye(2), np.zeros((2, 2)), STIFFNESS, response_map=[1, 0])
    equations = equations_of(as_arrays(system))
    assert equations.stop_map.shape == (0, 2)
    assert equations.damping_coupling is None
    np.testing.assert_array_equal(equations.input_map, 0.0)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"mass": np.ones((2, 3))}, r"mass must be a square matrix, shape \(2, 2\), got"),
        ({"mass": 1.0}, "mass must be a square matrix"),
        ({"mass": "heavy"}, "mass must be a number or an array of numbers, got 'heavy'"),
        ({"mass": [[1.0, 0.0], [0.0]]}, "mass must be a number or an array of numbers"),
        ({"mass": np.diag([1.0, 0.0])}, r"mass must be positive definite, got 0 at index \(1, 1\)"),
        ({"mass": [[1.0, 0.1], [0.2, 1.0]]}, r"mass must be symmetric, got 0\.1 at index \(0, 1\)"),
        ({"damping": np.eye(3)}, r"damping must be of the shape of mass, shape \(2, 2\), got"),
        ({"damping": [[0.0, 1.0], [-1.0, 0.0]]}, "damping must be symmetric, got 1 at"),
        ({"damping": [[np.nan, 0.0], [0.0, 0.0]]}, r"damping must be finite, got nan at index"),
        ({"stiffness": [[1.0, -1.0], [-2.0, 2.0]]}, "stiffness must be symmetric, got -1 at"),
        (
            {"stiffness": [[1.0, -1.0], [-1.0, 1.0]]},
            r"stiffness must be positive definite, got .* lowest eigenvalue .*Hold the body",
        ),
        ({"stiffness": [[np.inf, 0.0], [0.0, 1.0]]}, "stiffness must be finite, got inf"),
        ({"stops": replace(STOP, position=0.5)}, "position must be None for a Stop of a Matrix"),
        ({"stop_map": None}, r"stop_map must be given with stops: shape \(1, 2\)"),
        ({"stop_map": [1.0, 0.0]}, r"stop_map must be one row per stop, by coordinate, shape \(1"),
        ({"stop_map": [[np.nan, 0.0]]}, r"stop_map must be finite, got nan at index \(0, 0\)"),
        ({"input_map": None}, r"input_map must be given with a drive: shape \(2,\)"),
        ({"input_map": [1.0]}, r"input_map must be one number per coordinate, shape \(2,\), got"),
        ({"response_map": [[1.0, 0.0]]}, "response_map must be one number per coordinate"),
        ({"response_map": [1.0, np.inf]}, r"response_map must be finite, got inf at index \(1,\)"),
        ({"num_modes": 0}, "num_modes must be a whole number of at least 1, got 0"),
        ({"num_modes": 3}, "num_modes must be at most 2, the number of coordinates, got 3"),
        ({"damping": DASHPOT, "proportional": True}, "proportional must be False for damping that"),
    ],
)
def test_what_is_no_system_is_refused(changes, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        two_masses(**changes)


def test_a_beam_refuses_a_stop_without_a_place(rig):
    with pytest.raises(ValueError, match=r"^position must be above 0 .* got None\. Give every"):
        vj.ImpactingBeam(rig().beam, stops=STOP)


def test_release_is_for_beams():
    with pytest.raises(ValueError, match=r"^release is for an ImpactingBeam"):
        vj.simulate(two_masses(drive=vj.NoDrive()), periods=1, release=0.1)
