"""States to start from: their coordinates, displacements by shape, and where a guess leads."""

import warnings
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import vibrojax as vj
from vibrojax.branches.work import _with_distance
from vibrojax.model.states import as_state
from vibrojax.regime.basins import Starts
from vibrojax.regime.regimes import start_states
from vibrojax.steady.periodic_result import compared

UNIT = 2 * np.pi
FREQUENCY = 0.9275 / UNIT
# Of the oscillator below at this frequency, from 300 periods of a march: a stable motion of period
# 2 (displacement and velocity at drive phase 0) beside an unstable one of period 1.
DOUBLE = np.array([-0.2205, 0.8301])


def oscillator(mass=1.0):
    """x'' + 0.1 x' + x + 50 max(x - 1, 0) = 0.3 cos(w t), everything times the mass."""
    return vj.MatrixSystem(
        [[mass]],
        [[0.1 * mass]],
        [[mass]],
        response_map=[1.0],
        stops=vj.Stop(None, 1.0, vj.KelvinVoigt(50.0 * mass)),
        stop_map=[[1.0]],
        drive=vj.PointForce(0.3 * mass),
        input_map=[1.0],
    )


@pytest.fixture(scope="module")
def beam():
    tapered = vj.Cantilever(
        *(0.2, 0.025, 1e-3, 130e9, 8250.0),
        taper=0.4,
        mass_ratio=0.3,
        point_masses=vj.PointMass(0.02, 0.6),
    )
    return vj.ImpactingBeam(tapered, num_modes=2)


# Displacements of a beam


def test_a_shape_within_the_modes_is_met_exactly(beam):
    q, rate = jnp.asarray([1e-3, -2e-4]), jnp.asarray([0.3, 0.1])
    free = beam.modes()
    state = beam.state(lambda s: free.shape(s) @ q, lambda s: free.shape(s) @ rate)
    np.testing.assert_allclose(state, jnp.concatenate([q, rate]), rtol=1e-12)
    places = np.linspace(0.1, 1.0, 7)
    measured = dict(zip(places, np.asarray(free.shape(places) @ q), strict=True))
    np.testing.assert_allclose(beam.state(measured)[:2], q, rtol=1e-12)
    np.testing.assert_array_equal(beam.state(measured)[2:], 0.0)


def test_another_shape_is_projected_by_the_mass(beam):
    free, cantilever = beam.modes(), beam.beam
    point = cantilever.point_masses[0]
    mass = point.mass / cantilever.reference_mass
    for k in range(2):

        def integrand(s, k=k):
            return (1 - cantilever.taper * s) * s**2 * float(free.shape(s)[k])

        wanted = quad(integrand, 0.0, 1.0)[0] + cantilever.mass_ratio * float(free.shape(1.0)[k])
        wanted += mass * point.position**2 * float(free.shape(point.position)[k])
        assert float(beam.modal_coordinates(lambda s: s**2)[k]) == pytest.approx(wanted, rel=1e-9)
    by_number = beam.modal_coordinates(lambda s: s**2 if s > 0 else 0.0)  # of one number only
    np.testing.assert_allclose(by_number, beam.modal_coordinates(lambda s: s**2))


def test_the_static_deflection_is_a_shape_too(beam):
    q = beam.static_shape(2e-3)
    free = beam.modes()
    np.testing.assert_allclose(beam.modal_coordinates(lambda s: free.shape(s) @ q), q, rtol=1e-12)


@pytest.mark.slow  # to compile
def test_a_state_has_derivatives(beam):
    slope = jax.jacfwd(lambda a: beam.state(lambda s: a * s**2)[:2])(2.0)
    np.testing.assert_allclose(slope, beam.modal_coordinates(lambda s: s**2))
    by_value = jax.jacrev(lambda v: beam.state({0.5: v, 1.0: 2 * v, 0.7: 1.4 * v})[:2])(1e-3)
    linear = beam.modal_coordinates({0.5: 1.0, 1.0: 2.0, 0.7: 1.4})
    np.testing.assert_allclose(by_value, linear, rtol=1e-9)


@pytest.mark.parametrize(
    ("displacement", "sentence"),
    [
        (1e-3, "displacement must be a function of x/L, or a dict of numbers by place x/L"),
        ("tip", "displacement must be a function of x/L"),
        ({1.0: 1e-3}, "displacement is given at 1 places, too few or too close to each other for"),
        ({0.99999999: 1e-3, 1.0: 1e-3}, "displacement is given at 2 places, too few or too close"),
        ({0.5: 1e-3, 1.5: 1e-3}, r"s must be from 0 \(root\) to 1 \(tip\), got 1.5"),
        ({0.5: np.nan, 1.0: 1e-3}, "displacement must be a finite number at every place"),
        (lambda s: np.nan * s, "displacement must be a finite number at every place"),
        (lambda s: np.ones((2, 3)), "displacement must return one number for every place x/L"),
    ],
)
def test_what_is_no_displacement_of_a_beam(beam, displacement, sentence):
    with pytest.raises(ValueError, match=sentence):
        beam.state(displacement)


def test_a_displacement_that_the_modes_leave_out_is_said(beam):
    with pytest.warns(UserWarning, match=r"The 2 modes of the model leave out \d+ % of this disp"):
        beam.state(lambda s: 1e-3)


# Of other systems


def test_displacements_of_matrices_and_angles_of_pendulums():
    x, v = np.array([0.4, -0.2]), np.array([0.7, 0.5])
    two = vj.MatrixSystem(
        np.diag([2.0, 3.0]), np.zeros((2, 2)), [[2.0, -1.0], [-1.0, 2.0]], response_map=[1.0, 0.0]
    )
    state = two.state(displacement=x, velocity=v)
    np.testing.assert_allclose(two.modes().shapes @ state.reshape(2, 2).T, np.stack([x, v]).T)
    with pytest.raises(ValueError, match=r"one number per coordinate, shape \(2,\), got an array"):
        two.state(displacement=[1.0])
    pendulum = vj.default_pendulum(num_links=3)
    angles = np.array([0.1, 0.2, 0.3])
    np.testing.assert_array_equal(pendulum.state(angles), [*angles, 0, 0, 0])
    modal = pendulum.linearised(3)
    np.testing.assert_allclose(modal.angles(modal.state(velocity=angles)[3:]), angles)
    with pytest.raises(ValueError, match=r"an angle per link, shape \(3,\), got 'x'"):
        modal.state("x")


def test_memories_of_stops():
    law = vj.StandardLinearSolid(50.0, 20.0, 0.1)
    one = vj.MatrixSystem(
        [[1.0]], [[0.1]], [[1.0]], response_map=[1.0], stops=vj.Stop(None, 1.0, law), stop_map=[[1]]
    )
    # The last idles, so that exact contact has an even number of states.
    np.testing.assert_allclose(one.state([0.5], [0.2]), [0.5, 0.2, 0.0, 0.0])
    np.testing.assert_allclose(one.state([0.5], [0.2], [0.01]), [0.5, 0.2, 0.01, 0.0])
    with pytest.raises(ValueError, match=r"internal states, shape \(1,\), or a state"):
        one.state([0.5], [0.2], [0.01, 0.02, 0.03])


# What the arguments take

TWO = SimpleNamespace(size=2, state_size=4)
MEMORY = SimpleNamespace(size=1, state_size=3)


@pytest.mark.parametrize(
    ("given", "equations", "wanted"),
    [
        ([1, 2, 3, 4], TWO, [1, 2, 3, 4]),
        (np.arange(4), TWO, [0, 1, 2, 3]),
        (([1, 2], [3, 4]), TWO, [1, 2, 3, 4]),
        ([np.ones(2), jnp.zeros(2)], TWO, [1, 1, 0, 0]),
        (np.array([[1, 2], [3, 4]]), TWO, [1, 2, 3, 4]),
        (SimpleNamespace(initial_state=np.arange(4)), TWO, [0, 1, 2, 3]),
        ((1, 2), MEMORY, [1, 2, 0]),
        ((1, 2, 3), MEMORY, [1, 2, 3]),
        (([1], [2]), MEMORY, [1, 2, 0]),
        (([1], [2], [3]), MEMORY, [1, 2, 3]),
    ],
)
def test_forms_of_a_state(given, equations, wanted):
    np.testing.assert_array_equal(as_state("guess", given, equations), wanted)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("x", "guess must be q and q' of shape .* got 'x'"),
        (3, r"each, or a state \(q, q'\) of shape \(4,\), got an array of shape \(\)"),
        ([1, 2, 3], r"got an array of shape \(3,\)"),
        (([1, 2], [3]), r"q' of shape \(2,\) each, .* got shapes \[\(2,\), \(1,\)\]"),
        ([[1, 2, 3, 4]], r"got an array of shape \(1, 4\)"),
        ([1, 2, np.nan, 4], "guess must hold finite numbers, got nan at index 2"),
        ({"q": 1}, "guess must be q and q'"),
        (None, "guess must be q and q'"),
    ],
)
def test_what_is_no_state(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        as_state("guess", given, TWO)


def test_all_studies_read_states_alike():
    one = oscillator(4.0)
    state = one.state([0.5], [0.2])
    np.testing.assert_allclose(state, [1.0, 0.4])  # in modal coordinates: by the root of the mass
    pair = state[:1], state[1:]
    np.testing.assert_array_equal(start_states(one, [state, pair], None, 0), [state, state])
    places = {"x": [0.5, 1.0], "speed": [0.2, 0.3]}

    def start(x, speed):
        return one.state(jnp.stack([x]), jnp.stack([speed]))

    made = Starts.of(start, places, None, 0, 0).states(one.equations())
    np.testing.assert_allclose(made[[0, 2]], [state, [2.0, 0.4]])
    with pytest.raises(ValueError, match=r"starts must be how many .* shape \(starts, 2\); each"):
        start_states(one, [[1.0]], None, 0)


@pytest.mark.slow  # to compile
def test_a_motion_goes_on_from_its_last_state():
    one = oscillator()
    settings = {"frequency": FREQUENCY, "samples_per_period": 32, "gradient": "forward"}
    whole = vj.simulate(one, periods=4, initial_state=one.state([0.3], [0.5]), **settings)
    half = vj.simulate(one, periods=2, initial_state=([0.3], [0.5]), **settings)
    on = vj.simulate(one, periods=2, initial_state=half.states[-1], **settings)
    assert float(jnp.max(whole.contact_force)) > 0
    np.testing.assert_allclose(on.states, whole.states[64:], atol=1e-6)
    orbit = vj.periodic_response(
        one, frequency=FREQUENCY, guess=DOUBLE, settings=vj.PeriodicSettings(period=2)
    )
    round_trip = vj.simulate(one, periods=2, initial_state=orbit, **settings)
    np.testing.assert_allclose(round_trip.states[-1], orbit.initial_state, atol=1e-6)
    assert float(jnp.linalg.norm(round_trip.states[32] - orbit.initial_state)) > 0.1


# Where a guess leads


def test_distance_from_a_guess_and_the_period_that_is_least(beam):
    place = SimpleNamespace(equations=beam.equations())
    weight = beam.equations().energy_weight
    one, other = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0])
    states = [jnp.asarray(s / weight) for s in (one, other)]
    for order, least in (((0, 1, 0, 1), 2), ((0, 0, 0, 0), 1), ((0, 0, 0, 1), 4), ((0,), 1)):
        strobes = jnp.stack([states[k] for k in order])
        sooner, distance = compared(place, strobes, None)
        assert int(sooner) == least
        assert np.isnan(distance)
    strobes = jnp.stack([states[k] for k in (0, 1)])
    assert float(compared(place, strobes, states[0])[1]) == 0.0
    assert float(compared(place, strobes, 0.25 * states[0])[1]) == pytest.approx(0.75)
    assert float(compared(place, strobes, states[1])[1]) == pytest.approx(np.sqrt(2))


@pytest.fixture(scope="module")
def double():
    """The stable motion of period 2, from a good guess: without a warning, which is an error."""
    return vj.periodic_response(
        oscillator(), frequency=FREQUENCY, guess=DOUBLE, settings=vj.PeriodicSettings(period=2)
    )


@pytest.mark.slow  # to compile
def test_a_good_guess_is_silent(double):
    assert (int(double.status), int(double.minimal_period), bool(double.stable)) == (0, 2, True)
    assert float(double.guess_distance) < 1e-3
    assert double.notes == ()
    assert double.sentence == "The motion repeats after 2 drive period(s) and is stable."
    dataset = double.to_xarray()
    assert int(dataset.minimal_period) == 2
    assert dataset.guess_distance.attrs["long_name"].startswith("Distance of the motion from the")
    # The same motion of the same body in another unit of mass, whose modal coordinates differ.
    heavy = oscillator(4.0)
    guess = heavy.state(displacement=DOUBLE[:1], velocity=DOUBLE[1:])
    found = vj.periodic_response(
        heavy, frequency=FREQUENCY, guess=guess, settings=vj.PeriodicSettings(period=2)
    )
    assert found.notes == ()
    np.testing.assert_allclose(found.initial_state, 2 * double.initial_state, rtol=1e-6)


@pytest.mark.slow  # to compile
def test_a_guess_in_other_coordinates_is_said(double):
    heavy = oscillator(4.0)
    messages = []
    for factor in (1.0, 0.5, 0.2, 0.1, 4.0, 1e200):  # 2 would be right
        with pytest.warns(
            UserWarning, match="From this guess: .* States are in the coordinates"
        ) as said:
            found = vj.periodic_response(
                heavy,
                frequency=FREQUENCY,
                guess=factor * double.initial_state,
                settings=vj.PeriodicSettings(period=2),
            )
        messages.append(str(said[0].message))
        assert np.isfinite(found.amplitude_ratio) == (int(found.status) == 0)
        if int(found.status) == 0:
            assert float(found.guess_distance) > 0.3
            assert "away from the guess: it may be another motion" in repr(found)
    assert any("No periodic motion was found" in one for one in messages)
    assert any("away from the guess" in one for one in messages)


@pytest.mark.slow  # to compile
def test_a_motion_of_a_lower_period_is_said(double):
    one = oscillator()
    once = vj.periodic_response(one, frequency=FREQUENCY, guess=[-0.44, 0.81])
    assert (int(once.status), int(once.minimal_period), bool(once.stable)) == (0, 1, False)
    with pytest.warns(UserWarning, match=r"It repeats after 1 drive period\(s\) already"):
        found = vj.periodic_response(
            one, frequency=FREQUENCY, guess=once, settings=vj.PeriodicSettings(period=2)
        )
    assert (int(found.status), int(found.minimal_period), found.period) == (0, 1, 2)
    assert "it is no motion of period 2" in repr(found)


@pytest.mark.slow  # to compile
def test_in_a_batch_distances_are_numbers_and_nothing_is_warned_of(double):
    one = oscillator()
    solve = jax.jit(
        jax.vmap(
            lambda x: vj.periodic_response(
                one, frequency=FREQUENCY, guess=x, settings=vj.PeriodicSettings(period=2)
            )
        )
    )
    guesses = jnp.asarray([1.0, 0.1, jnp.nan])[:, None] * double.initial_state
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = solve(guesses)
    assert found.status.tolist() == [0, 0, 1]
    assert found.minimal_period.tolist() == [2, 2, 0]
    assert float(found.guess_distance[0]) < 1e-9
    assert float(found.guess_distance[1]) > 0.3
    assert np.isnan(found.guess_distance[2])
    assert repr(found).endswith("1 not found, 1 far from their guess)")


@pytest.mark.slow  # to compile
@pytest.mark.parametrize("method", [vj.HarmonicBalance(), vj.Shooting()])
def test_other_methods_say_it_too(double, method):
    def solve(guess, period):
        return vj.periodic_response(
            oscillator(),
            frequency=FREQUENCY,
            guess=guess,
            settings=vj.PeriodicSettings(period=period, method=method),
        )

    found = solve(double, 2)
    assert (int(found.minimal_period), found.notes) == (2, ())
    assert float(found.guess_distance) < 0.05
    with pytest.warns(UserWarning, match="From this guess"):
        lower = solve([-0.44, 0.81], 2)
    assert int(lower.minimal_period) in (0, 1)
    with pytest.warns(UserWarning, match="From this guess"):
        solve(5 * double.initial_state, 2)


@pytest.mark.slow  # to compile
def test_a_branch_far_from_its_start_says_so(rig, rig_branch):
    weight = np.asarray(rig().equations().energy_weight)
    start = rig_branch.initial_state[10]
    assert _with_distance(rig_branch, start, weight) is rig_branch
    with pytest.warns(UserWarning, match=r"From this start: It passes 0.9\d* of its size away"):
        found = _with_distance(rig_branch, 0.03 * start, weight)
    assert found.sentence.startswith(f"{rig_branch.sentence} It passes 0.9")
