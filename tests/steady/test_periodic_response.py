"""Periodic responses: values, stability and derivatives against independent references."""

import json
from dataclasses import replace
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from scipy.integrate import solve_ivp
from splitting_settings import with_settings

import vibrojax as vj

DATA = Path(__file__).parents[1] / "data"
NAME = "C_MR0.5_mu0.5"
SINGLE = {
    key: np.array(values)
    for key, values in json.loads((DATA / "single_contact.json").read_text())["cases"][NAME].items()
    if key != "folds"
}
GRADIENTS = json.loads((DATA / "gradients.json").read_text())["cases"]
PARAMETERS = ("Ks", "Cs", "lam", "Omega", "zeta")
UNIT = 2 * np.pi


def states_of(one):
    """States of the reference, whose shapes are 1 at the tip, in our modal coordinates."""
    tip = np.asarray(vj.modes(one.beam, one.num_modes).shape(1.0))
    return SINGLE["state0"] / np.tile(tip, 2)


def energy_weight(one):
    w = np.asarray(one.equations().angular_frequency)
    return np.concatenate([w, np.ones(len(w))])


def assert_reference(found, at, tolerance=1e-8):
    for ours, theirs in (
        ("amplitude_ratio", "half_pp_ratio"),
        ("peak_ratio", "amp_ratio"),
        ("contact_force", "max_contact_force"),
        ("contact_fraction", "contact_fraction"),
    ):
        np.testing.assert_allclose(
            getattr(found, ours), SINGLE[theirs][at], rtol=tolerance, err_msg=ours
        )


@pytest.fixture(scope="module")
def solved(rig):
    """The responses at all single-contact points of the reference, from their states, at once."""
    one = rig()
    solve = jax.jit(
        jax.vmap(lambda r, x: vj.periodic_response(one, frequency_ratio=r, guess=x)),
    )
    states = states_of(one)
    return solve, solve(jnp.asarray(SINGLE["ratio"]), jnp.asarray(states))


def test_points_of_the_reference(rig, solved):
    _, found = solved
    assert (found.status == 0).all()
    # The reference is listed with 10 digits, its force is the small end of a difference.
    assert_reference(found, slice(None), 1e-7)
    assert_reference(jax.tree.map(lambda a: a[10:], found), slice(10, None), 1e-8)
    np.testing.assert_allclose(found.leading_multiplier, SINGLE["max_multiplier"], atol=1e-8)
    assert found.stable.all()
    assert found.residual.max() < 1e-10
    expected, weight = states_of(rig()), energy_weight(rig())
    error = np.linalg.norm((np.asarray(found.initial_state) - expected) * weight, axis=1)
    assert (error < 1e-8 * np.linalg.norm(expected * weight, axis=1)).all()
    np.testing.assert_allclose(found.frequency_ratio, SINGLE["ratio"], rtol=1e-12)
    natural = 57.870127869781115 / UNIT
    np.testing.assert_allclose(found.frequency, SINGLE["ratio"] * natural, rtol=1e-9)
    assert (found.contacts_per_period == 1).all()


@pytest.mark.slow
def test_the_guess_chooses_among_motions(rig, solved, rig_branch):
    """At 1.15 there are three: two stable, one between them unstable."""
    solve, _ = solved
    three = rig_branch.resample([1.15])
    states, count = three.initial_state.values[0], len(SINGLE["ratio"])
    assert len(states) == 3
    # As many lanes as before, so that nothing compiles.
    found = solve(jnp.full(count, 1.15), jnp.asarray(np.resize(states, (count, 10))))
    assert (found.status[:3] == 0).all()
    np.testing.assert_allclose(found.amplitude_ratio[:3], three.amplitude_ratio[0], rtol=1e-9)
    np.testing.assert_allclose(found.leading_multiplier[:3], three.leading_multiplier[0], rtol=1e-6)
    assert found.stable[:3].tolist() == [True, False, True]
    lanes = [jax.tree.map(lambda a, k=k: a[k], found) for k in range(3)]
    assert [lane.instability for lane in lanes] == ["none", "fold", "none"]
    assert "past a fold" in lanes[1].sentence
    upper = SINGLE["half_pp_ratio"][SINGLE["ratio"].tolist().index(1.15)]
    assert float(lanes[0].amplitude_ratio) == pytest.approx(upper, rel=1e-8)
    assert float(lanes[2].contact_force) == 0.0


def test_a_failed_search_is_flagged(rig, small_branch):
    one, known = rig(num_modes=1), small_branch.resample([1.05, 1.2]).isel(crossing=0)
    good = known.initial_state.values
    states = np.concatenate([np.full((1, 2), np.nan), np.full((1, 2), np.inf), good])
    solve = jax.jit(jax.vmap(lambda r, x: vj.periodic_response(one, frequency_ratio=r, guess=x)))
    found = solve(jnp.array([1.05, 1.2, 1.05, 1.2]), jnp.asarray(states))
    assert found.status[:2].tolist() == [1, 1]
    for name in ("amplitude_ratio", "peak_ratio", "rms_ratio", "contact_force"):
        assert np.isnan(getattr(found, name)[:2]).all(), name
    assert not found.converged[:2].any()
    # Neighbours are not touched.
    assert (found.status[2:] == 0).all()
    np.testing.assert_allclose(found.amplitude_ratio[2:], known.amplitude_ratio, rtol=1e-9)
    assert (known.contact_force > 0).all()
    assert repr(found) == "PeriodicResponse(batch of (4,), 2 not found)"
    lost = jax.tree.map(lambda a: a[0], found)
    assert lost.sentence == "No periodic motion was found: the numbers mean nothing."
    with pytest.raises(ValueError, match=r"^instability is of one response"):
        _ = found.instability


@pytest.fixture(scope="module")
def from_rest(rig):
    return vj.periodic_response(rig(), frequency_ratio=1.05)


@pytest.mark.long  # to compile
@pytest.mark.slow
def test_from_rest(from_rest, solved, tmp_path):
    at = SINGLE["ratio"].tolist().index(1.05)
    assert_reference(from_rest, at)
    assert from_rest.exact
    assert from_rest.instability == "none"
    assert "repeats after 1 drive period(s) and is stable" in repr(from_rest)
    data = from_rest.to_xarray()
    data.to_netcdf(tmp_path / "response.nc", engine="h5netcdf")
    assert data.amplitude_ratio.dims == ()
    for name, variable in data.data_vars.items():
        assert variable.attrs["long_name"], name
    with xarray.open_dataset(tmp_path / "response.nc", engine="h5netcdf") as loaded:
        xarray.testing.assert_equal(loaded.load(), data)
    batch = solved[1].to_xarray()
    assert batch.amplitude_ratio.dims == ("lane_0",)
    assert batch.initial_state.dims == ("lane_0", "state")


@pytest.mark.long  # to compile
@pytest.mark.slow
def test_history_of_the_motion(from_rest):
    history = from_rest.history()
    tip = np.asarray(history.displacement())
    assert np.ptp(tip) / 2 / 0.2e-3 == pytest.approx(float(from_rest.amplitude_ratio), rel=1e-3)
    assert tip[0] == pytest.approx(tip[-1], rel=1e-6)


# Derivatives


def outputs_of(case):
    """Peak displacement and contact force by (Ks, Cs, lam, Omega, zeta), and its reference."""
    p = case["parameters"]
    beam = vj.Cantilever(
        p["L"], p["b0"], p["h"], p["E"], p["rho"], taper=p["mu"], mass_ratio=p["mr"]
    )
    drive, tension = vj.BaseMotion(p["sigma"]), p["law"] == "printed"
    tip = np.asarray(vj.modes(beam, p["n_modes"]).shape(1.0))
    guess = np.array(case["state0"]) / np.tile(tip, 2)

    def outputs(theta):
        stiffness, damping, gap, w, zeta = theta
        one = vj.ImpactingBeam(
            beam,
            vj.Stop(p["s1"], gap, vj.KelvinVoigt(stiffness, damping, tension=tension)),
            drive,
            damping_ratio=zeta,
            num_modes=p["n_modes"],
            formulation=p["variant"],
        )
        found = vj.periodic_response(one, frequency=w / UNIT, guess=guess)
        return jnp.stack([found.peak_ratio * p["sigma"], found.contact_force])

    theta = np.array([p["Ks"], p["Cs"], p["lam"], case["Omega"], p["zeta"]])
    return outputs, theta


def expected_of(case):
    value = np.array([case["outputs"]["tip_abs"], case["outputs"]["force_max"]])
    listed = case["gradients"]
    slopes = np.array([[listed[n][key] for n in PARAMETERS] for key in ("d_tip_peak", "d_force")])
    return value, slopes


@pytest.mark.long  # to compile
@pytest.mark.slow
@pytest.mark.parametrize("case", GRADIENTS[:1], ids=["printed"])
def test_reverse_gradients_in_a_batch(case):
    """`vmap` of the gradient, the first lane being the reference."""
    outputs, theta = outputs_of(case)
    value, slopes = expected_of(case)
    lanes = jnp.asarray(theta * np.array([[1.0], [1.0005], [1.001]]))

    def both(theta):
        value, pullback = jax.vjp(outputs, theta)
        return value, jax.vmap(lambda g: pullback(g)[0])(jnp.eye(2))

    values, found = jax.jit(jax.vmap(both))(lanes)
    np.testing.assert_allclose(values[0], value, rtol=1e-8)
    np.testing.assert_allclose(found[0], slopes, rtol=1e-6)
    # Along the line of lanes, against differences of the values.
    along = np.asarray(found[1]) @ theta * 0.001
    np.testing.assert_allclose(values[2] - values[0], along, rtol=1e-4)


@pytest.mark.long  # to compile
@pytest.mark.slow
@pytest.mark.parametrize("case", GRADIENTS, ids=["printed", "no tension"])
def test_gradients_in_both_modes(case):
    outputs, theta = outputs_of(case)
    value, slopes = expected_of(case)
    theta = jnp.asarray(theta)
    np.testing.assert_allclose(jax.jit(outputs)(theta), value, rtol=1e-8)
    forward = jax.jit(jax.jacfwd(outputs))(theta)
    reverse = jax.jit(jax.jacrev(outputs))(theta)
    np.testing.assert_allclose(forward, slopes, rtol=1e-6)
    np.testing.assert_allclose(reverse, slopes, rtol=1e-6)


@pytest.mark.long  # to compile
@pytest.mark.slow
def test_gradient_of_a_batch_is_a_batch_of_gradients():
    outputs, theta = outputs_of(GRADIENTS[0])
    lanes = jnp.asarray(theta * np.array([[1.0], [1.0005]]))
    inner = jax.jit(jax.vmap(jax.grad(lambda t: outputs(t)[1])))(lanes)
    outer = jax.jit(jax.grad(lambda t: jnp.sum(jax.vmap(outputs)(t)[:, 1])))(lanes)
    alone = jax.jit(jax.grad(lambda t: outputs(t)[1]))
    single = [alone(lane) for lane in lanes]
    np.testing.assert_allclose(inner, outer, rtol=1e-9)
    np.testing.assert_allclose(inner, single, rtol=1e-8)


def by_method(rig, method, tolerance):
    """Amplitude, force and their gradients by gap and stiffness (relative) at ratio 1.1."""

    def outputs(scale):
        one = rig(gap=0.4e-3 * scale[0], stiffness=5500.0 * scale[1])
        found = vj.periodic_response(
            one,
            frequency_ratio=1.12 * scale[2],
            settings=vj.PeriodicSettings(method=method, tolerance=tolerance),
        )
        return jnp.stack([found.amplitude_ratio, found.contact_force]), found

    @jax.jit
    def all_of_it(scale):
        slopes, found = jax.jacfwd(outputs, has_aux=True)(scale)
        return found, slopes

    found, slopes = all_of_it(jnp.ones(3))
    return found, np.array(slopes)


@pytest.fixture(scope="module")
def exactly(rig):
    return by_method(rig, None, 1e-4)


METHODS = {
    "balance": (vj.HarmonicBalance(), 1e-4, 1e-3, 1e-2),
    "balance, coarse": (vj.HarmonicBalance(samples=128), 1e-3, 3e-3, 3e-2),
    "shooting": (vj.Shooting(), 1e-4, 1e-4, 1e-3),
    "splitting": (vj.Shooting(vj.ExponentialSplitting(1e-4)), 1e-4, 2e-3, 1e-2),
    "Tsit5": (vj.Shooting(diffrax.Tsit5(), steps_per_period=2000), 1e-4, 2e-3, 1e-2),
}


@pytest.mark.long  # to compile
@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_methods_agree(rig, exactly, name):
    method, tolerance, values, slopes = METHODS[name]
    exact, wanted = exactly
    found, derivative = by_method(rig, method, tolerance)
    assert int(found.status) == 0
    assert not found.exact
    assert float(found.amplitude_ratio) == pytest.approx(float(exact.amplitude_ratio), rel=values)
    assert float(found.contact_force) == pytest.approx(float(exact.contact_force), rel=values)
    assert float(found.rms_ratio) == pytest.approx(float(exact.rms_ratio), rel=values)
    assert float(found.leading_multiplier) == pytest.approx(
        float(exact.leading_multiplier), abs=10 * values
    )
    np.testing.assert_allclose(derivative[0], wanted[0], rtol=slopes)
    # The largest force is read off samples here: a hundredth of its largest derivative.
    largest = abs(wanted[1]).max()
    np.testing.assert_allclose(derivative[1], wanted[1], rtol=0, atol=1.5e-2 * largest)


# Stability lost at -1


def oscillator_system(stiffness=50.0):
    """x'' + 0.1 x' + x + 50 max(x - 1, 0) = 0.3 cos(w t)."""
    return vj.MatrixSystem(
        [[1.0]],
        [[0.1]],
        [[1.0]],
        response_map=[1.0],
        stops=vj.Stop(None, 1.0, vj.KelvinVoigt(stiffness)),
        stop_map=[[1.0]],
        drive=vj.PointForce(0.3),
        input_map=[1.0],
    )


@pytest.mark.long  # to compile
@pytest.mark.slow
def test_period_doubling():
    """The motion of period 1 is unstable between 0.844 and 0.9285; at 0.9275 period 2 is stable."""
    one = oscillator_system()
    solve = jax.jit(lambda w, x: vj.periodic_response(one, frequency=w / UNIT, guess=x))
    start = vj.periodic_response(one, frequency=0.95 / UNIT)
    assert start.stable
    state, names = start.initial_state, {}
    for w in (0.94, 0.93, 0.9275, 0.915, 0.9, 0.88):
        found = solve(w, state)
        assert int(found.status) == 0
        state, names[w] = found.initial_state, found.instability
        assert float(found.peak_ratio) * 0.3 > 1.0
    assert names[0.94] == names[0.93] == "none"
    assert {names[w] for w in (0.9275, 0.915, 0.9, 0.88)} == {"period doubling"}
    assert "past a period doubling" in found.sentence
    assert found.ratio_units == "m/N"
    double = vj.periodic_response(
        one, frequency=0.9275 / UNIT, settings=vj.PeriodicSettings(period=2)
    )
    assert double.period == 2
    assert double.stable
    assert double.contacts_per_period == 1
    once = np.asarray(solve(0.9275, double.initial_state).initial_state)
    assert np.abs(once - np.asarray(double.initial_state)).max() > 1e-3


@pytest.mark.long  # to compile
@pytest.mark.slow
def test_without_contact_or_stops_it_is_the_linear_response(rig):
    one = rig()
    equations = one.equations()
    w, ratio = np.asarray(equations.angular_frequency), 0.9
    drive = ratio * w[0]
    gain = np.asarray(equations.input_map * equations.response_map)
    zeta = np.asarray(equations.damping_ratio)
    expected = np.abs((gain / (w**2 - drive**2 + 2j * zeta * w * drive)).sum()) * drive**2
    for system in (one, replace(one, stops=())):
        found = vj.periodic_response(system, frequency_ratio=ratio)
        assert int(found.status) == 0
        for name in ("amplitude_ratio", "peak_ratio", "first_harmonic_ratio"):
            assert float(getattr(found, name)) == pytest.approx(expected, rel=1e-9), name
        assert float(found.rms_ratio) == pytest.approx(expected / np.sqrt(2), rel=1e-9)
        assert float(found.contact_force) == 0.0
        # Every mode rings down by itself.
        damped = np.sort(np.exp(-zeta * w * UNIT / drive))
        np.testing.assert_allclose(
            np.sort(np.abs(found.floquet_multipliers)), np.repeat(damped, 2), atol=1e-10
        )


# Refusals


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({}, r"^Give frequency_ratio or frequency, one of the two"),
        ({"frequency_ratio": 1.0, "frequency": 9.0}, r"^Give frequency_ratio or frequency, one of"),
        ({"frequency_ratio": 0.0}, r"^frequency_ratio must be .*above 0"),
        ({"frequency": -1.0}, r"^frequency must be .*above 0"),
        ({"frequency_ratio": np.nan}, r"^frequency_ratio must be"),
        ({"frequency_ratio": 1.0, "period": 0}, r"^period must be"),
        ({"frequency_ratio": 1.0, "tolerance": 0.0}, r"^tolerance must be above 0, up to 0.1"),
        ({"frequency_ratio": 1.0, "guess": np.zeros(4)}, r"^guess must be .* of shape \(10,\)"),
        (
            {"frequency_ratio": 1.0, "method": vj.HarmonicBalance(samples=32), "tolerance": 1e-5},
            r"^tolerance = 1e-05 is out of reach of 32 samples",
        ),
        (
            {"frequency_ratio": 1.0, "method": vj.HarmonicBalance(), "tolerance": 1e-9},
            r"^tolerance = 1e-09 is out of reach of harmonic balance",
        ),
    ],
)
def test_wrong_arguments_are_refused(rig, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        vj.periodic_response(rig(), **with_settings(vj.PeriodicSettings, arguments))


def test_balance_needs_a_stop(rig):
    one = replace(rig(), stops=())
    with pytest.raises(ValueError, match=r"^HarmonicBalance\(\) needs a stop"):
        vj.periodic_response(
            one, frequency_ratio=1.0, settings=vj.PeriodicSettings(method=vj.HarmonicBalance())
        )


@pytest.mark.slow
def test_balance_of_coupled_modes_and_a_hertz_stop_begins_with_a_march():
    """Only the linearly implicit stepper takes such modes with such a stop."""
    one = vj.MatrixSystem(
        np.diag([1.0, 0.5]),
        [[8.0, -0.5], [-0.5, 1.5]],  # not proportional
        [[3e3, -1e3], [-1e3, 1e3]],
        response_map=[0.0, 1.0],
        stops=vj.Stop(None, 1e-3, vj.Hertz(1e7)),
        stop_map=[[0.0, 1.0]],
        drive=vj.PointForce(1.0),
        input_map=[1.0, 0.0],
    )
    assert not one.equations().is_modal
    found = vj.periodic_response(one, frequency=7.0)
    assert found.contacts_per_period == 1
    assert not found.exact
    shot = vj.periodic_response(
        one, frequency=7.0, settings=vj.PeriodicSettings(method=vj.Shooting())
    )
    assert found.amplitude_ratio == pytest.approx(float(shot.amplitude_ratio), rel=1e-3)
    assert found.leading_multiplier == pytest.approx(float(shot.leading_multiplier), rel=2e-2)


class PendulumEquations(vj.model.AbstractEquations):
    """q'' + 0.2 q' + sin q = 0.6 a(t): linear but for nothing."""

    stops: tuple[vj.Stop, ...] = ()

    @property
    def size(self):
        return 1

    def mass(self, q):
        return jnp.eye(1)

    def linear_force(self, q, rate):
        return 0.2 * rate

    def smooth_force(self, q, rate):
        return -jnp.sin(q)

    def input(self, q):
        return 0.6 * jnp.ones(1)

    def penetration(self, q):
        return jnp.zeros(0)

    def response(self, q):
        return q[0]


class Pendulum(vj.model.AbstractSystem):
    drive: vj.model.AbstractDrive
    stops: tuple[vj.Stop, ...] = ()

    def equations(self):
        return PendulumEquations()


def test_systems_that_are_not_linear_are_shot():
    one = Pendulum(vj.PointForce(1.0))
    with pytest.raises(ValueError, match=r"^Pendulum is not linear but for its stops, which harm"):
        vj.periodic_response(
            one, frequency=0.1, settings=vj.PeriodicSettings(method=vj.HarmonicBalance())
        )
    with pytest.raises(ValueError, match=r"^This system has no natural frequency: give frequency"):
        vj.periodic_response(one, frequency_ratio=0.9)
    found = vj.periodic_response(one, frequency=0.8 / UNIT)
    assert int(found.status) == 0
    assert np.isnan(found.frequency_ratio)

    def slope(t, x):
        return [x[1], 0.6 * forcing(t) - 0.2 * x[1] - np.sin(x[0])]

    def forcing(t):
        return np.sin(0.8 * t)

    start = np.asarray(found.initial_state)
    run = solve_ivp(slope, (0, UNIT / 0.8), start, rtol=1e-10, atol=1e-12, dense_output=True)
    np.testing.assert_allclose(run.y[:, -1], start, atol=1e-5)
    motion = run.sol(np.linspace(0, UNIT / 0.8, 4001))[0]
    assert float(found.amplitude_ratio) == pytest.approx(np.ptp(motion) / 2, rel=1e-5)
    # What flows in is damped: the multipliers' product is that of the damping.
    product = np.prod(np.asarray(found.floquet_multipliers)).real
    assert product == pytest.approx(np.exp(-0.2 * UNIT / 0.8), rel=1e-5)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"samples": 8}, r"^samples must be"),
        ({"samples": 33}, r"^samples must be even, got 33. Use 34"),
        ({"harmonics": 0}, r"^harmonics must be"),
    ],
)
def test_balance_refuses(settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        vj.HarmonicBalance(**settings)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"stepper": "Tsit5"}, r"^stepper must be a diffrax solver .*got 'Tsit5'"),
        ({"steps_per_period": 8}, r"^steps_per_period must be a whole number of at least 16"),
        ({"max_steps": 0}, r"^max_steps must be"),
    ],
)
def test_shooting_refuses(settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        vj.Shooting(**settings)


@pytest.mark.parametrize(
    ("numbers", "frequency_ratio"),
    [
        ((4.2144e-4, 18382.0, 0.3902, 0.14987, 0.34004, 1.07313, 0.03002668), 1.0199),
        ((2.3231e-4, 15061.5, 0.89128, 0.10792, 0.60916, 1.95361, 0.01451278), 1.1734),
        ((4.0638e-4, 13826.3, 0.31538, 0.65887, 0.51181, 0.46243, 0.02726701), 1.0181),
    ],
)
def test_the_largest_of_several_forces_is_found(numbers, frequency_ratio):
    names = ("gap", "stiffness", "damping", "taper", "position", "mass_ratio", "damping_ratio")
    one = vj.default_rig(**dict(zip(names, numbers, strict=True)), num_modes=2)
    found = vj.periodic_response(one, frequency_ratio=frequency_ratio)
    assert found.converged
    finely = float(found.history(20_000).contact_force.max())
    # Highest peaks nearly as high as each other, or right behind a touch.
    assert finely <= float(found.contact_force) * (1 + 1e-12)
    assert found.contact_force == pytest.approx(finely, rel=1e-5)
