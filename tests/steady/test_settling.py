import json
from pathlib import Path

import exact_propagation
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from marches import prepared

import vibrojax as vj
from vibrojax._tools.machine import second_level_cache
from vibrojax.steady import lane_pool, pool_programs
from vibrojax.steady.map_orbits import least_periods
from vibrojax.steady.period_maps import is_stable
from vibrojax.steady.settling import most_periods, slow_limits
from vibrojax.steady.starting import settle

GRADIENTS = json.loads((Path(__file__).parents[1] / "data" / "gradients.json").read_text())


def settled(march, state, frequency, max_periods=600):
    return settle(
        march,
        np.asarray(state),
        np.asarray(frequency),
        tolerance=1e-8,
        max_period=8,
        max_periods=max_periods,
    )


def lanes_of(one, count):
    """The march of one rig, for so many lanes."""
    march = prepared(one.equations(), one.drive, 1e-8 if count > 1 else 1e-6)
    return jax.tree.map(lambda a: jnp.repeat(jnp.asarray(a)[..., None], count, axis=-1), march)


PERIODS = {1.2: 1, 0.94: 1, 0.9275: 2, 0.926: 4, 0.924: 8, 0.87: 3, 0.91: 0}
"""Periods of the motions from rest by drive frequency, rad/s; 0: chaotic. By `by_oracle`."""
LANES = len(PERIODS)
CHAOTIC = list(PERIODS.values()).index(0)


class Oscillator(vj.model.AbstractSystem):
    """x'' + 0.1 x' + x + 50 max(x - 1, 0) = 0.3 cos(w t), as anyone would write it."""

    drive: vj.model.AbstractDrive
    stops: tuple[vj.Stop, ...]

    def equations(self):
        one = jnp.ones(1)
        return vj.model.LinearEquations(
            stops=self.stops,
            angular_frequency=one,
            damping_ratio=0.05 * one,
            input_map=one,
            stop_map=jnp.ones((1, 1)),
            force_map=jnp.ones((1, 1)),
            response_map=one,
            modal_mass=one,
        )


@pytest.fixture(scope="module")
def soft_impact():
    stop = vj.Stop(1.0, 1.0, vj.KelvinVoigt(50.0))
    return Oscillator(vj.PointForce(0.3), (stop,))


@pytest.fixture(scope="module")
def march(soft_impact):
    return lanes_of(soft_impact, LANES)


@pytest.fixture(scope="module")
def answer(march):
    """Motions of the periods below; the doubling starts at 0.9285 and ends in chaos."""
    frequency = np.array(list(PERIODS))
    return frequency, settled(march, np.zeros((LANES, 2)), frequency)


def oscillator_problem():
    return exact_propagation.Problem(
        angular_frequency=np.ones(1),
        damping_ratio=0.05,
        modal_mass=np.ones(1),
        participation=np.ones(1),
        shape_at_stop=np.ones(1),
        shape_at_tip=np.ones(1),
        gap=1.0,
        stiffness=50.0,
        damping=0.0,
        base_amplitude=1.0,
    )


def by_oracle(frequency, state, periods):
    """Strobes of the oscillator from a state, by event-driven propagation."""
    problem = oscillator_problem()
    # The oracle is driven at its base; its amplitude times the square of the frequency is 0.3.
    problem = exact_propagation.replace(problem, base_amplitude=0.3 / frequency**2)
    times = 2 * np.pi / frequency * np.arange(1, periods + 1)
    return exact_propagation.propagate(problem, frequency, state, 0.0, times[-1], times)[0]


def test_steady_states_are_those_of_a_long_march(answer):
    _, found = answer
    for lane, (drive, period) in enumerate(PERIODS.items()):
        strobes = by_oracle(drive, np.zeros(2), 700)
        assert found.period[lane] == period
        if not period:
            assert found.status[lane] == vj.Status.aperiodic.value
            continue
        assert found.status[lane] == vj.Status.settled.value
        nearest = np.abs(strobes[-8:] - np.asarray(found.state[lane])).max(axis=1).min()
        assert nearest < 1e-6
        returned = np.abs(strobes[-1] - strobes[-1 - np.arange(1, 9)]).max(axis=1)
        assert 1 + np.flatnonzero(returned < 1e-6)[0] == period


def test_found_orbits_close_on_themselves(answer):
    frequency, found = answer
    for lane, drive in enumerate(np.asarray(frequency)):
        start, period = np.asarray(found.state[lane]), int(found.period[lane])
        if not period:
            continue
        strobes = by_oracle(drive, start, period)
        returned = np.abs(strobes - start).max(axis=1)
        assert returned[-1] < 1e-8
        assert (returned[:-1] > 1e-4).all()
        # It is measured over the whole of it.
        assert found.measures.time[lane] == pytest.approx(period * 2 * np.pi / drive)


def test_cost_is_counted(answer):
    _, found = answer
    assert (found.periods_marched >= 17).all()
    assert (found.periods_marched[CHAOTIC] == 600).all()
    assert found.periods_marched[0] < 200
    assert (found.steps >= found.periods_marched).all()


def test_not_settled_is_flagged(march, answer):
    frequency, _ = answer
    found = settled(march, np.zeros((LANES, 2)), frequency, 18)
    late = found.status == vj.Status.aperiodic.value
    assert late.any()
    assert (found.period[late] == 0).all()
    assert (found.periods_marched[late] == 18).all()
    assert np.isfinite(found.state).all()


def test_lost_lane_is_flagged_and_starts_again_from_rest(march, answer):
    frequency, clean = answer
    state = np.zeros((LANES, 2))
    state[1, 0] = np.nan
    found = settled(march, state, frequency)
    assert found.status[1] == vj.Status.diverged.value
    assert found.period[1] == 0
    assert (found.state[1] == 0).all()
    others = np.array([i for i in range(LANES) if i != 1])
    np.testing.assert_array_equal(found.status[others], clean.status[others])
    np.testing.assert_array_equal(found.state[others], clean.state[others])


def test_starting_on_the_orbit_stays_there(march, answer):
    frequency, found = answer
    again = settled(march, found.state, frequency)
    kept = np.array([i for i in range(LANES) if i != CHAOTIC])
    np.testing.assert_array_equal(again.period[kept], found.period[kept])
    # On the same orbit, though maybe at another of its drive periods.
    for name in ("highest", "lowest", "force", "contact_time", "integral_of_square"):
        one, other = getattr(again.measures, name), getattr(found.measures, name)
        np.testing.assert_allclose(one[kept], other[kept], rtol=1e-6, err_msg=name)


@pytest.fixture(scope="module")
def response(soft_impact):
    grid = np.arange(0.75, 1.551, 0.02) / (2 * np.pi)
    return vj.frequency_sweep(soft_impact, frequency=grid)


def test_response_curve_of_a_system_of_ones_own(response):
    unit = 2 * np.pi
    # Up where the lower branch grazes the stop, down at the fold.
    assert response.jump_up * unit == pytest.approx(1.1304366, rel=1e-3)
    assert response.jump_down * unit == pytest.approx(1.4484, rel=1e-3)
    w = np.asarray(response.frequencies) * unit
    linear = 1 / np.hypot(1 - w**2, 0.1 * w)
    free = (w < 0.8438) | (w > 1.4484)
    for k in range(2):
        np.testing.assert_allclose(response.amplitude_ratio[k, free], linear[free], rtol=1e-6)
        assert not response.contact_force[k, free].any()
    above = (w > 1.1305) & (w < 1.44)
    assert (response.contact_force[0, above] > 0).all()
    assert not response.contact_force[1, above].any()
    assert (response.contact_force[:, (w > 0.845) & (w < 1.13)] > 0).all()
    assert response.ratio_units == "m/N"


def test_period_doubling_where_it_is_known(response):
    """The period-1 motion doubles at 0.9285."""
    w = np.asarray(response.frequencies) * 2 * np.pi
    assert (response.period[:, (w > 0.9285) & (w < 1.13)] == 1).all()
    assert (response.period[:, (w > 0.85) & (w < 0.9285)] != 1).all()


def test_highest_point_of_the_upper_branch(soft_impact):
    grid = np.linspace(1.15, 1.448, 41) / (2 * np.pi)
    top = vj.frequency_sweep(
        soft_impact, frequency=grid, settings=vj.SweepSettings(refine_jumps=None)
    )
    assert top.peak_ratio[0, -1] * 0.3 > 1.0
    highest = top.peak_ratio[0] * 0.3
    deepest = top.contact_force[0] / 50 + 1
    assert (deepest <= highest * (1 + 1e-6)).all()
    assert deepest[-1] == pytest.approx(1.3126, abs=1e-2)


@pytest.mark.slow
def test_other_attractor_beside_the_listed_one(rig, problem):
    """From the motion at 0.90, rig P_MR0.5_mu0.5 at 0.91 settles on a period-7 motion."""
    one = rig(formulation="as_printed")
    equations, oracle = one.equations(), problem(one)
    march = lanes_of(one, 1)
    w = np.asarray(equations.angular_frequency[:1])
    below = settled(march, np.zeros((1, 10)), 0.90 * w)
    found = settled(march, below.state, 0.91 * w)
    assert int(found.period[0]) == 7
    drive = 0.91 * float(w[0])
    period = 2 * np.pi / drive
    start, size = np.asarray(found.state[0]), np.asarray(march.energy_weight())[:, 0]
    times = period * np.arange(1, 8)
    strobes, _ = exact_propagation.propagate(oracle, drive, start, 0.0, times[-1], times)
    returned = np.linalg.norm((strobes - start) * size, axis=1) / np.linalg.norm(start * size)
    assert returned[-1] < 1e-6
    assert (returned[:-1] > 1e-3).all()
    times = period * np.arange(1, 401)
    long, _ = exact_propagation.propagate(
        oracle, drive, np.asarray(below.state[0]), 0.0, times[-1], times
    )
    nearest = np.linalg.norm((long[-7:] - start) * size, axis=1) / np.linalg.norm(start * size)
    assert nearest.min() < 1e-3


@pytest.mark.slow  # to compile
@pytest.mark.parametrize("case", GRADIENTS["cases"], ids=["printed", "no tension"])
def test_gradients_of_the_steady_state(case):
    p = case["parameters"]
    names = ("Ks", "Cs", "lam", "Omega", "zeta")
    theta = jnp.array([p["Ks"], p["Cs"], p["lam"], case["Omega"], p["zeta"]])
    drive = vj.BaseMotion(p["sigma"])
    beam = vj.Cantilever(
        p["L"], p["b0"], p["h"], p["E"], p["rho"], taper=p["mu"], mass_ratio=p["mr"]
    )

    def image(theta, state, observe):
        stiffness, damping, gap, w, zeta = theta
        law = vj.KelvinVoigt(stiffness, damping, tension=p["law"] == "printed")
        one = vj.ImpactingBeam(
            beam,
            vj.Stop(p["s1"], gap, law),
            drive,
            damping_ratio=zeta,
            num_modes=p["n_modes"],
            formulation=p["variant"],
        )
        march = vj.ExactContact(1e-6).prepare(one.equations(), drive)
        return march(state, w, jnp.asarray(1, jnp.int32), observe)

    @jax.jit
    def all_of_it(theta, state):
        def step(state, _):
            by_state = jax.jacfwd(lambda x: image(theta, x, False)[0])(state)
            residual = image(theta, state, False)[0] - state
            return state + jnp.linalg.solve(jnp.eye(12) - by_state, residual), by_state

        state, jacobians = jax.lax.scan(step, state, length=3)
        by_theta = jax.jacfwd(lambda t: image(t, state, False)[0])(theta)
        moved = jnp.linalg.solve(jnp.eye(12) - jacobians[-1], by_theta)

        def outputs(t):
            state_t = state + moved @ (t - theta)
            measures = image(t, state_t, True)[2]
            return jnp.stack([jnp.maximum(measures.highest, -measures.lowest), measures.force])

        return outputs(theta), jax.jacfwd(outputs)(theta)

    # The reference normalises its shapes to 1 at the tip; the rest of the state follows by Newton.
    tip = np.asarray(vj.modes(beam, p["n_modes"], p["variant"]).shape(1.0))
    start = np.array(case["state0"]).reshape(2, -1) / tip
    (peak, force), slopes = all_of_it(theta, jnp.asarray(start.ravel()))
    assert peak == pytest.approx(case["outputs"]["tip_abs"], rel=1e-5)
    assert force == pytest.approx(case["outputs"]["force_max"], rel=1e-5)
    for i, name in enumerate(names):
        wanted = case["gradients"][name]
        assert slopes[0, i] == pytest.approx(wanted["d_tip_peak"], rel=1e-4), name
        assert slopes[1, i] == pytest.approx(wanted["d_force"], rel=1e-3), name


@pytest.mark.parametrize("states", [3, 20])
def test_period_maps_are_stable_up_to_a_spectral_radius_of_one(states):
    rng = np.random.default_rng(3)
    matrices = rng.normal(size=(8, states, states))
    largest = np.abs(np.linalg.eigvals(matrices)).max(axis=1)
    radius = np.array([0.2, 0.9, 0.99, 0.999, 1.001, 1.01, 1.1, 5.0])
    scaled = matrices * (radius / largest)[:, None, None]
    found = is_stable(jnp.asarray(np.moveaxis(scaled, 0, -1)))
    np.testing.assert_array_equal(found, radius < 1)
    for one, stable in zip(scaled, radius < 1, strict=True):
        assert bool(is_stable(jnp.asarray(one))) is bool(stable)


@pytest.mark.parametrize("period", [1, 2])
def test_the_limit_of_a_slow_decay_is_extrapolated(period):
    """Two turning modes and one that alternates, all with multipliers of 0.99 and more."""
    rng, multipliers = np.random.default_rng(0), np.zeros(6, complex)
    multipliers[:4] = 0.999 * np.exp(1j * np.array([0.3, -0.3, 1.1, -1.1]))
    multipliers[4] = -0.99
    basis = rng.normal(size=(6, 6)).astype(complex)
    basis[[1, 3]] = np.conj(basis[[0, 2]] + 1j * rng.normal(size=(2, 6)))
    basis[[0, 2]] = np.conj(basis[[1, 3]])
    decay = (multipliers ** np.arange(40)[:, None] @ basis).real
    orbit = rng.normal(size=(period, 6))
    states = orbit[np.arange(40) % period] * 20 + decay
    wild = np.random.default_rng(1).normal(size=(40, 6))
    limit, found = slow_limits(np.stack([states[::-1], wild])[:, :17], 8)
    assert found.tolist() == [period, 0]
    np.testing.assert_allclose(limit[0], 20 * orbit[39 % period], rtol=1e-7)
    np.testing.assert_array_equal(limit[1], wild[0])


def test_slow_motions_are_marched_for_longer():
    time, one = np.array([0.0, 1.0, 100.0, np.inf]), np.full(4, 2 * np.pi * 50)
    assert most_periods(time, one, 8).tolist() == [600, 600, 10_000, 10_000]
    assert most_periods(time, 10 * one, 400).tolist() == [801, 1000, 10_000, 10_000]


@pytest.mark.usefixtures("on_a_cpu")
def test_loops_are_as_wide_as_the_cache_allows(monkeypatch):
    assert second_level_cache() >= 2**17
    wide = {}
    for size in (2**19, 2**21):
        monkeypatch.setattr(pool_programs, "second_level_cache", lambda size=size: size)
        wide[size] = [pool_programs.widths_for(1000, numbers) for numbers in (100, 4000, 10**6)]
    assert wide[2**21] == [(16, 128), (16, 128), (16,)]
    assert wide[2**19] == [(16, 128), (16, 32), (16,)]
    assert pool_programs.widths_for(40, 100) == (16, 64)
    assert pool_programs.widths_for(2, 100) == (2,)


def test_orbits_have_the_least_of_their_periods():
    """Turns by a quarter, a third and a half; found with multiples of their periods."""
    turns, found = np.array([4, 3, 2, 5]), np.array([8, 6, 8, 5])

    def state(at, periods):
        angle = 2 * np.pi * periods / turns[at]
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    every = np.arange(4)
    for first, least in ((1, [4, 3, 2, 5]), (3, [4, 3, 4, 5])):
        given = found, state(every, 0), np.full(4, first), state
        np.testing.assert_array_equal(least_periods(*given), least)


@pytest.mark.slow
def test_newtons_method_is_tried_again_where_a_march_has_settled(rig, monkeypatch):
    """It fails from far away; without it a point is as exact as the tolerance, 5e-5 off here."""

    def swept(tolerance):
        settings = vj.SweepSettings("forward", tolerance=tolerance, refine_jumps=None)
        ratios = [1.0, 1.2, 1.4, 1.6]
        return vj.frequency_sweep(rig(num_modes=1), frequency_ratio=ratios, settings=settings)

    exact = swept(1e-10)
    monkeypatch.setattr(lane_pool, "NEAR", 0.1)
    found = swept(1e-2)
    assert found.periods_marched.sum() > exact.periods_marched.sum()
    np.testing.assert_allclose(found.amplitude_ratio, exact.amplitude_ratio, rtol=1e-11)
    np.testing.assert_allclose(found.contact_force, exact.contact_force, rtol=1e-10)
