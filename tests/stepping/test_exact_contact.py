import math
from dataclasses import replace

import equinox as eqx
import exact_propagation
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from marches import prepared
from scipy.integrate import solve_ivp

import vibrojax as vj
from vibrojax.model.systems import equations_of
from vibrojax.stepping import elementary, exact_contact, outlook
from vibrojax.stepping.contact_phases import phases_of
from vibrojax.stepping.forcing import forcing, longest_step
from vibrojax.stepping.gauge import Ruler

PERIODS = 8
RATIOS = jnp.array([0.72, 0.95, 1.05, 1.15, 1.22, 1.4])

ORACLE_CASES = {
    "default": {},
    "strong damping": {"damping": 4.0},
    "overdamped": {"damping": 300.0, "position": 1.0, "gap": 2e-3},
    "no gap": {"gap": 0.0},
    "stiff": {"stiffness": 5e4, "damping": 1.0},
    "very stiff, undamped": {"stiffness": 2e6, "damping": 0.0, "damping_ratio": 0.05},
    "at the tip, weak": {"position": 1.0, "gap": 1e-7, "stiffness": 200.0},
    "no tension, light": {"tension": False},
    "no tension, strong": {"tension": False, "damping": 4.0},
    "no tension, overdamped": {"tension": False, "damping": 300.0, "position": 1.0, "gap": 2e-3},
    "no tension, no gap": {"tension": False, "damping": 4.0, "gap": 0.0},
}


@eqx.filter_jit
def run(march, state, angular_frequency, periods=PERIODS, observe=False):
    periods = jnp.broadcast_to(jnp.asarray(periods, jnp.int32), angular_frequency.shape)
    return march(state, angular_frequency, periods, observe)


@eqx.filter_jit
def run_free(phases, state, angular_frequency, periods, amplitude=0.0):
    """March with any amplitude of the input, also none, and count contacts."""
    w = jnp.asarray(angular_frequency, float)
    amplitude = jnp.broadcast_to(jnp.asarray(amplitude, complex), w.shape)
    force = forcing(phases, amplitude, w, jnp.zeros_like(w))
    ruler = Ruler(jnp.asarray(1e-12), jnp.asarray(jnp.inf))
    return exact_contact.march(phases, force, state, jnp.asarray(periods, jnp.int32), ruler=ruler)


def prepare(rig, tolerance=1e-9, steps=None):
    return prepared(equations_of(rig), rig.drive, tolerance, steps)


def arrays(rig):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), rig)


def weight(equations):
    """Weights that turn (q, q') into square roots of energies."""
    root = jnp.sqrt(equations.modal_mass)
    return np.concatenate([root * equations.angular_frequency, root])


def rest(march, frequency):
    states = march.energy_weight().shape[0]
    return jnp.zeros((states, *frequency.shape))


@pytest.mark.parametrize("case", ORACLE_CASES.values(), ids=ORACLE_CASES.keys())
def test_march_agrees_with_event_driven_propagation(rig, problem, case):
    one = arrays(rig(**case))
    march = prepare(one)
    equations = one.equations()
    w = RATIOS * equations.angular_frequency[0]
    found, steps, _ = run(march, rest(march, w), w)
    oracle = problem(one)
    size = weight(equations)
    for lane, drive in enumerate(np.asarray(w)):
        end = PERIODS * 2 * np.pi / drive
        wanted, events = exact_propagation.propagate(oracle, drive, np.zeros(10), 0.0, end, [end])
        wanted = wanted[0] * size
        error = np.linalg.norm(np.asarray(found)[:, lane] * size - wanted)
        assert error <= 1e-9 * np.linalg.norm(wanted), (lane, len(events))
        # Rounds go from one change of contact to the next.
        assert steps[lane] <= 10 * (len(events) + PERIODS), (lane, len(events))


@pytest.mark.slow
@pytest.mark.parametrize("tension", [True, False])
def test_what_a_gpu_runs_is_the_same_march(rig, monkeypatch, tension):
    one = arrays(rig(tension=tension, num_modes=2, stiffness=5e4))
    march, w = prepare(one), RATIOS * one.equations().angular_frequency[0]

    def marched():
        return eqx.filter_jit(lambda march, w: run.__wrapped__(march, rest(march, w), w))(march, w)

    wanted, rounds, _ = marched()
    for module in (outlook, elementary):
        monkeypatch.setattr(module, "on_cpu", lambda: False)
    found, its_rounds, _ = marched()
    np.testing.assert_allclose(found, wanted, atol=1e-12 * np.abs(wanted).max())
    assert np.all(np.abs(its_rounds - rounds) <= 2 + rounds // 10)  # rounding may cost some


@pytest.mark.parametrize(
    "steps",
    [
        pytest.param(4000, id="fine steps", marks=pytest.mark.slow),
        pytest.param(None, id="steps chosen"),
    ],
)
def test_very_stiff_stop(rig, problem, steps):
    one = arrays(rig(stiffness=2e5, damping=1.0))
    equations, oracle = one.equations(), problem(one)
    march = prepare(one, steps=steps)
    w = RATIOS[1:5] * equations.angular_frequency[0]
    found, _, _ = run(march, rest(march, w), w, 4)
    size = weight(equations)
    for lane, drive in enumerate(np.asarray(w)):
        end = 4 * 2 * np.pi / drive
        wanted, _ = exact_propagation.propagate(oracle, drive, np.zeros(10), 0.0, end, [end])
        error = np.linalg.norm((np.asarray(found)[:, lane] - wanted[0]) * size)
        assert error <= 1e-6 * np.linalg.norm(wanted[0] * size), lane


def test_batch_equals_loop_and_order_does_not_matter(rig):
    march = prepare(arrays(rig()))
    w = RATIOS * 57.87
    start = 1e-4 * jnp.asarray(np.random.default_rng(0).normal(size=(10, len(w))))
    together, steps, _ = run(march, start, w)
    order = np.array([3, 5, 0, 2, 4, 1])
    shuffled, shuffled_steps, _ = run(march, start[:, order], w[order])
    np.testing.assert_array_equal(shuffled_steps, steps[order])
    size = np.linalg.norm(together, axis=0)
    np.testing.assert_allclose(shuffled, together[:, order], atol=1e-13 * size.max())
    for lane in range(len(w)):
        alone, alone_steps, _ = run(march, start[:, lane], w[lane])
        # Rounding may decide where a step ends, not where the motion goes.
        assert abs(int(alone_steps) - int(steps[lane])) <= 4
        np.testing.assert_allclose(alone, together[:, lane], atol=1e-12 * size[lane])


def test_mirrored_rig_moves_mirrored(rig):
    w = RATIOS * 57.87
    start = 1e-4 * jnp.asarray(np.random.default_rng(1).normal(size=(4, len(w))))
    ends = {}
    for side in (1, -1):
        phases = phases_of(arrays(rig(side=side, num_modes=2)).equations())
        ends[side] = run_free(phases, side * start, w, 5 * jnp.ones(6, int), side * 4.0)
    np.testing.assert_array_equal(ends[-1][0], -ends[1][0])
    above, below = ends[1][2], ends[-1][2]
    np.testing.assert_array_equal(above.highest, -below.lowest)
    np.testing.assert_array_equal(above.force, below.force)
    np.testing.assert_array_equal(above.contacts, below.contacts)
    assert above.contacts.min() > 1


def energy(equations, state):
    (stop,) = equations.stops
    depth = jnp.maximum(equations.penetration(state[: len(state) // 2])[0], 0.0)
    own = jnp.sum((weight(equations) * state) ** 2) / 2
    return float(own + stop.law.stiffness * depth**2 / 2)


@pytest.mark.parametrize("gap", [4e-4, 1e-5])
def test_elastic_stop_keeps_the_energy(rig, gap):
    one = rig(damping_ratio=0.0, damping=0.0, gap=gap)
    equations = one.equations()
    start = jnp.concatenate([one.static_shape(-8e-3), jnp.zeros(5)])
    end, _, measures = run_free(phases_of(equations), start, 57.0, 120)
    assert measures.contacts >= 100
    assert energy(equations, end) == pytest.approx(energy(equations, start), rel=1e-6)


def test_period_of_an_undamped_mass(oscillator):
    equations = oscillator(stiffness=50.0, gap=1.0)
    wide, k = 1.5, 50.0
    turned = math.atan2(math.sqrt((wide**2 - 1) / (1 + k)), 1 / (1 + k))
    period = 2 * (math.pi - math.acos(1 / wide)) + 2 / math.sqrt(1 + k) * turned
    assert period == pytest.approx(5.0060650, abs=1e-7)
    start = jnp.array([-wide, 0.0])
    end, _, measures = run_free(phases_of(equations), start, 2 * math.pi / period, 10)
    np.testing.assert_allclose(end, start, atol=1e-8)
    assert measures.contacts == 10
    assert measures.lowest == pytest.approx(-wide, rel=1e-8)
    # All energy in the springs at the deepest point.
    deepest = (k + math.sqrt(k**2 - (1 + k) * (k - wide**2))) / (1 + k)
    assert measures.highest == pytest.approx(deepest, rel=1e-6)
    assert measures.force == pytest.approx(k * (deepest - 1), rel=1e-5)


@pytest.mark.parametrize("tension", [True, False])
@pytest.mark.parametrize("z", [0.05, 0.2, 0.7])
def test_restitution_of_a_kelvin_voigt_stop(oscillator, tension, z):
    # The spring of the base is all but absent, so the mass flies straight between stop and clock.
    equations = oscillator(frequency=1e-4, stiffness=1.0, damping=2 * z, gap=1.0, tension=tension)
    root = math.sqrt(1 - z**2)
    if tension:
        restitution = math.exp(-math.pi * z / root)
    else:
        turned = math.atan2(2 * z * root, 1 - 2 * z**2)
        restitution = math.exp(-z / root * (math.pi - turned))
    if z == 0.2:
        assert restitution == pytest.approx(0.526621 if tension else 0.571740, abs=1e-6)
    end, _, measures = run_free(phases_of(equations), jnp.array([0.0, 1.0]), 2 * math.pi / 8, 1)
    assert end[1] == pytest.approx(-restitution, rel=1e-6)
    assert measures.contacts == 1
    assert end[0] < 1.0


def test_overdamped_single_mass(oscillator):
    equations = oscillator(frequency=1.0, stiffness=50.0, damping=40.0, gap=0.5)
    phases = phases_of(equations)
    step = longest_step(phases, jnp.asarray(1.0), 1e-6)
    assert 0 < step < 1
    end, _, measures = run_free(phases, jnp.array([0.0, 1.0]), 2 * math.pi / 3, 1)

    def motion(_, x):
        depth = x[0] - 0.5
        return [x[1], -x[0] - (50 * depth + 40 * x[1] if depth > 0 else 0.0)]

    wanted = solve_ivp(
        motion, (0, 3), [0.0, 1.0], method="Radau", rtol=1e-9, atol=1e-11, max_step=0.01
    ).y[:, -1]
    np.testing.assert_allclose(end, wanted, atol=1e-6)
    assert measures.contacts == 1


@pytest.mark.slow
def test_forward_derivatives_through_contacts(rig, problem):
    names = ("gap", "stiffness", "damping", "frequency")
    start = {"gap": 4e-4, "stiffness": 5500.0, "damping": 0.4, "frequency": 57.87 * 1.1}
    periods = 4
    base = arrays(rig(damping=0.4))
    equations = base.equations()

    def state(factors):
        value = {n: start[n] * f for n, f in zip(names, factors, strict=True)}
        (stop,) = equations.stops
        law = replace(stop.law, stiffness=value["stiffness"], damping=value["damping"])
        stops = (replace(stop, law=law, gap=value["gap"]),)
        march = vj.ExactContact(1e-9).prepare(replace(equations, stops=stops), base.drive)
        w = value["frequency"]
        return march(jnp.zeros(10), w, jnp.asarray(periods, jnp.int32), False)[0]

    slopes = jax.jit(jax.jacfwd(state))(jnp.ones(4))
    size = weight(equations)

    def exact(name, factor):
        value = {**start, name: start[name] * factor}
        drive = value.pop("frequency")
        end = periods * 2 * np.pi / drive
        oracle = problem(rig(**value))
        states, events = exact_propagation.propagate(oracle, drive, np.zeros(10), 0, end, [end])
        assert len(events) >= 4
        return states[0]

    h = 1e-4
    for i, name in enumerate(names):
        near = exact(name, 1 + h) - exact(name, 1 - h)
        far = exact(name, 1 + 2 * h) - exact(name, 1 - 2 * h)
        wanted = size * (8 * near - far) / (12 * h)
        error = np.linalg.norm(size * slopes[:, i] - wanted)
        assert error <= 1e-5 * np.linalg.norm(wanted), name


@pytest.mark.parametrize("bad", [jnp.nan, jnp.inf, 1e200, 1e300])
def test_a_lane_that_blows_up_leaves_its_neighbours_alone(rig, bad):
    march = prepare(arrays(rig()), 1e-3)
    w = RATIOS * 57.87
    clean = rest(march, w)
    wanted, steps, measures = run(march, clean, w, observe=True)
    found, found_steps, found_measures = run(march, clean.at[:, 2].set(bad), w, observe=True)
    others = np.array([0, 1, 3, 4, 5])
    np.testing.assert_array_equal(found[:, others], wanted[:, others])
    np.testing.assert_array_equal(found_steps[others], steps[others])
    for one, other in zip(jax.tree.leaves(found_measures), jax.tree.leaves(measures), strict=True):
        np.testing.assert_array_equal(one[..., others], other[..., others])
    if not np.isfinite(bad):  # all else may be marched, or not
        assert not np.isfinite(found[:, 2]).any()


def test_stops_on_either_side(rig):
    beam = rig().beam
    law = vj.KelvinVoigt(5500.0, 0.5)
    stops = (vj.Stop(0.5, 4e-4, law), vj.Stop(0.8, 1e-3, vj.KelvinVoigt(3e3, 0.2), side=-1))
    one = vj.ImpactingBeam(beam, stops, vj.BaseMotion(2e-4), damping_ratio=0.018, num_modes=2)
    equations = one.equations()
    march = prepare(arrays(one))
    w1, zeta = np.asarray(equations.angular_frequency), 0.018
    place, push = np.asarray(equations.stop_map), np.asarray(equations.force_map)
    gaps, stiffness, damping = (4e-4, 1e-3), (5500.0, 3e3), (0.5, 0.2)
    seen = set()
    for ratio in (1.0,):
        drive = ratio * w1[0]
        found, _, measures = run(march, jnp.zeros(4), jnp.asarray(drive), 5, observe=True)

        def motion(t, x, touching, drive=drive):
            q, v = x[:2], x[2:]
            a = np.asarray(equations.input_map) * 2e-4 * drive**2 * math.sin(drive * t)
            a = a - 2 * zeta * w1 * v - w1**2 * q
            for s in touching:
                depth, rate = place[s] @ q - gaps[s], place[s] @ v
                a = a - push[:, s] * (stiffness[s] * depth + damping[s] * rate)
            return np.concatenate([v, a])

        def crossing(s):
            def depth(_, x, __):
                return place[s] @ x[:2] - gaps[s]

            depth.terminal = True
            return depth

        time, end, state, touching = 0.0, 5 * 2 * np.pi / drive, np.zeros(4), frozenset()
        entries = 0
        while time < end:
            events = []
            for s in (0, 1):
                event = crossing(s)
                event.direction = -1.0 if s in touching else 1.0
                events.append(event)
            part = solve_ivp(
                motion,
                (time, end),
                state,
                method="DOP853",
                rtol=1e-11,
                atol=1e-14,
                args=(touching,),
                events=events,
            )
            time, state = part.t[-1], part.y[:, -1]
            for s in (0, 1):
                if part.t_events[s].size:
                    entries += s not in touching
                    touching = touching ^ {s}
            seen.add(touching)
        size = weight(equations)
        np.testing.assert_allclose(
            found * size, state * size, atol=1e-7 * np.abs(state * size).max()
        )
        assert measures.contacts == entries
    assert {frozenset({0}), frozenset({1})} <= seen


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"tolerance": 0.0}, "tolerance must be above 0 and at most 0.1, got 0.0"),
        ({"tolerance": 0.5}, "tolerance must be above 0 and at most 0.1, got 0.5"),
        ({"tolerance": math.nan}, "tolerance must be a finite number, got nan"),
        ({"steps_per_period": 3}, "steps_per_period must be a whole number of at least 4, got 3"),
    ],
)
def test_wrong_settings_are_refused(settings, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        vj.ExactContact(**settings)


@pytest.mark.parametrize(("stiffness", "damping"), [(1e6, 1e3), (1e8, 1e5)])
def test_overdamped_stops_that_cannot_pull_cost_by_their_contacts(stiffness, damping):
    """A fast real eigenvalue that has died out does not shorten the way that is looked ahead."""
    rig = vj.default_rig(num_modes=2, position=0.6, stiffness=stiffness, damping=damping)
    rig = eqx.tree_at(lambda r: r.stops[0].law, rig, vj.KelvinVoigt(stiffness, damping, False))
    march = prepare(arrays(rig))
    w = jnp.linspace(0.9, 1.5, 25) * rig.equations().angular_frequency[0]
    end, rounds, _ = run(march, jnp.zeros((4, 25)), w, 60)
    assert np.all(np.isfinite(end))
    assert np.max(rounds) < 40 * 60
