"""Stops that relax, state-space structures and circuits: linear between contacts, and exact."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from event_driven import integrate

import vibrojax as vj
from vibrojax.model.systems import equations_of

SOLID = vj.StandardLinearSolid(3000.0, 2000.0, 2e-3)
CHAIN = vj.model.MaxwellChain(3000.0, [1500.0, 500.0], [2e-3, 0.05])
LAWS = {"solid": SOLID, "chain": CHAIN}
RATIO = 1.05


def padded(law, gap=5e-4):
    """The default rig with two modes and another stop at its tip."""
    rig = vj.default_rig(num_modes=2, damping_ratio=0.03)
    return dataclasses.replace(rig, stops=(vj.Stop(1.0, gap, law),))


def by_scipy(system, law, state, periods):
    """Integrate a rig with one stop that relaxes, from its own equations as they are printed."""
    equations = equations_of(system)
    w, zeta = np.asarray(equations.angular_frequency), np.asarray(equations.damping_ratio)
    push, place = np.asarray(equations.force_map[:, 0]), np.asarray(equations.stop_map[0])
    drive, gap, n = np.asarray(equations.input_map), float(system.stops[0].gap), len(w)
    own = np.array(law.elements, float)
    whole = law.stiffness + own[:, 0].sum()
    frequency = RATIO * w[0]
    amplitude = float(system.drive.amplitude) * frequency**2

    def surface(x):
        return own[:, 0] @ x[2 * n : 2 * n + len(own)] / whole

    def rate(t, x, inside):
        q, v, z = x[:n], x[n : 2 * n], x[2 * n : 2 * n + len(own)]
        depth = place @ q - gap
        force = law.stiffness * depth + own[:, 0] @ (depth - z) if inside else 0.0
        reached = depth if inside else surface(x)
        a = drive * amplitude * np.sin(frequency * t) - w**2 * q - 2 * zeta * w * v - push * force
        return np.concatenate([v, a, (reached - z) / own[:, 1], 0 * x[2 * n + len(own) :]])

    def signal(x):
        return place @ x[:n] - gap - surface(x)

    end = periods * 2 * np.pi / frequency
    return (*integrate(rate, signal, state, end, inside=signal(state) > 0), whole)


@pytest.mark.parametrize("name", ["solid", pytest.param("chain", marks=pytest.mark.slow)])
def test_stops_that_relax_march_as_scipy_integrates_them(name):
    system = padded(LAWS[name])
    history = vj.simulate(system, frequency_ratio=RATIO, periods=6, samples_per_period=16)
    start = np.zeros(history.states.shape[1])
    wanted, changes, largest, whole = by_scipy(system, LAWS[name], start, 6)
    count = 4 + len(LAWS[name].elements)
    size = np.abs(wanted).max()
    np.testing.assert_allclose(history.states[-1][:count], wanted[:count], atol=1e-9 * size)
    contacts = history.contacts()
    times = np.stack([contacts.touch, contacts.departure], axis=1).ravel()
    np.testing.assert_allclose(times[: len(changes)], changes, atol=1e-9)
    assert contacts.peak_force.max() == pytest.approx(
        whole * largest, rel=5e-3
    )  # its steps are coarse
    # What the stop does not give back its dashpots have taken.
    flow = history.energy()
    assert np.abs(flow.balance).max() < 1e-9 * flow.input_work.max()
    assert flow.contact_loss[-1].sum() > 0.05 * flow.input_work[-1]


@pytest.mark.slow
def test_periodic_motions_of_stops_that_relax_return_and_are_balanced_too():
    system = padded(SOLID)
    found = vj.periodic_response(system, frequency_ratio=RATIO)
    assert found.converged
    assert found.exact
    assert found.residual < 1e-12
    back, changes, _, _ = by_scipy(system, SOLID, np.asarray(found.initial_state), 1)
    assert len(changes) >= 2
    size = np.abs(found.initial_state).max()
    np.testing.assert_allclose(back[:5], found.initial_state[:5], atol=1e-9 * size)
    settings = vj.PeriodicSettings(method=vj.HarmonicBalance(samples=512))
    balanced = vj.periodic_response(system, frequency_ratio=RATIO, settings=settings)
    assert balanced.rms_ratio == pytest.approx(float(found.rms_ratio), rel=1e-5)
    leading = abs(balanced.leading_multiplier - found.leading_multiplier)
    assert leading < 5e-3


@pytest.mark.slow
def test_sweeps_branches_and_closed_forms_of_a_stop_that_relaxes_agree():
    system = padded(SOLID, gap=8e-4)
    grid = np.linspace(0.95, 1.3, 15)
    settings = vj.SweepSettings(refine_jumps=None)
    sweep = vj.frequency_sweep(system, frequency_ratio=grid, settings=settings)
    branch = vj.continue_response(system, frequency_ratio=vj.Range(0.94, 1.31))
    assert branch.status == "completed"
    assert branch.exact_points.all()
    compared = branch.compare(sweep)
    on = compared.on_branch.values
    assert (on != 0).all()
    assert (on == 1).sum() >= 20
    assert np.nanmax(compared.relative_difference.values[on == 1]) < 1e-6
    single = vj.single_contact_response(system, frequency_ratio=[RATIO])
    assert single.valid.any()


@pytest.mark.slow
def test_derivatives_by_numbers_of_a_stop_that_relaxes():
    def rms(stiffness, maxwell_stiffness, time):
        law = vj.StandardLinearSolid(stiffness, maxwell_stiffness, time)
        return vj.periodic_response(padded(law), frequency_ratio=RATIO).rms_ratio

    at = 3000.0, 2000.0, 2e-3
    slopes = jax.grad(rms, (0, 1, 2))(*at)
    for k, slope in enumerate(slopes):
        step = 1e-4 * at[k]
        ends = [rms(*(x + sign * step * (i == k) for i, x in enumerate(at))) for sign in (1, -1)]
        assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-5)


def test_one_element_makes_a_chain_a_solid():
    chain = vj.model.MaxwellChain(3000.0, [2000.0], [2e-3])
    depth, rate, memory = jnp.asarray(1e-3), jnp.asarray(0.1), jnp.asarray(2e-4)
    for law in (chain, SOLID):
        assert law.force_with_memory(depth, rate, memory) == pytest.approx(3.0 + 1.6)
        assert law.memory_rate(depth, rate, memory) == pytest.approx(0.8e-3 / 2e-3)
        assert law.stored_energy_with_memory(depth, memory) == pytest.approx(1.5e-3 + 0.64e-3)
    with pytest.raises(ValueError, match=r"a number for each element, got 2 and 1\."):
        vj.model.MaxwellChain(1.0, [1.0, 2.0], [1.0])


# State-space structures


def as_state_space(rig, mix=None):
    """The same rig in states x of no meaning: a mixture of its modal ones."""
    equations = equations_of(rig)
    n = equations.size
    w, zeta = (np.asarray(a) for a in (equations.angular_frequency, equations.damping_ratio))
    flow = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(w**2), -np.diag(2 * zeta * w)]])
    mix = np.eye(2 * n) if mix is None else mix
    back, still = np.linalg.inv(mix), np.zeros(n)
    stops = tuple(dataclasses.replace(stop, position=None) for stop in rig.stops)
    sides = np.array([stop.side for stop in stops])
    places, pushes = np.asarray(equations.stop_map), np.asarray(equations.force_map)
    return vj.StateSpace(
        mix @ flow @ back,
        response_map=np.concatenate([np.asarray(equations.response_map), still]) @ back,
        stops=stops,
        stop_map=np.concatenate([sides[:, None] * places, 0 * places], axis=1) @ back,
        force_map=mix @ np.concatenate([0 * pushes, pushes * sides]),
        drive=rig.drive,
        input_map=mix @ np.concatenate([still, np.asarray(equations.input_map)]),
    )


def test_a_state_space_may_have_no_stops():
    alone = vj.StateSpace([[0.0, 1.0], [-4.0, -0.4]], response_map=[1.0, 0.0])
    assert alone.equations().size == 1
    assert alone.equations().angular_frequency[0] == pytest.approx(2.0)


MIX = np.random.default_rng(0).normal(size=(4, 4)) * np.array([1.0, 1.0, 60.0, 60.0])[:, None]


@pytest.mark.slow
def test_a_state_space_gives_the_answers_of_the_beam():
    rig = vj.default_rig(num_modes=2)
    system = as_state_space(rig, MIX)
    for ratio in (0.9, 1.15):
        wanted = vj.periodic_response(rig, frequency_ratio=ratio)
        found = vj.periodic_response(system, frequency_ratio=ratio)
        for name in ("amplitude_ratio", "rms_ratio", "contact_force", "leading_multiplier"):
            one, other = float(getattr(found, name)), float(getattr(wanted, name))
            assert one == pytest.approx(other, rel=1e-9, abs=1e-12), name
    x = np.arange(4.0)
    np.testing.assert_allclose(system.states(system.state_of(x)), x, atol=1e-12)


def test_modes_that_neither_stop_nor_response_see_are_internal_states():
    rig = vj.default_rig(num_modes=3)
    mix = np.random.default_rng(1).normal(size=(6, 6)) * np.repeat([1.0, 60.0], 3)[:, None]
    system = as_state_space(rig, mix)
    assert system.equations().internal_size == 2
    assert system.equations().size == 2
    start = np.random.default_rng(2).normal(size=6) * 1e-4 * np.repeat([1.0, 60.0], 3)
    wanted = vj.simulate(rig, frequency_ratio=1.1, periods=4, initial_state=start)
    found = vj.simulate(
        system, frequency_ratio=1.1, periods=4, initial_state=system.state_of(mix @ start)
    )
    assert wanted.contact_force.max() > 0
    size = np.abs(wanted.displacement()).max()
    np.testing.assert_allclose(found.displacement(), wanted.displacement(), atol=1e-7 * size)
    with pytest.raises(ValueError, match="does not say its masses"):
        found.energy()
    back = system.states(found.states[-1])
    np.testing.assert_allclose(
        np.linalg.solve(mix, back), wanted.states[-1], atol=1e-7 * np.abs(wanted.states[-1]).max()
    )


def filtered(stiffness, cutoff):
    """A mass that hits a stop, and a filter of first order behind its force sensor."""
    wall = vj.Stop(None, 1e-3, vj.KelvinVoigt(2e4, 5.0))
    return vj.StateSpace(
        [[0.0, 1.0, 0.0], [-stiffness, -4.0, 0.0], [0.0, cutoff, -cutoff]],
        response_map=[1.0, 0.0, 0.0],
        stops=wall,
        stop_map=[[1.0, 0.0, 0.0]],
        force_map=[[0.0], [1.0], [0.0]],
        drive=vj.PointForce(1.0),
        input_map=[0.0, 1.0, 0.0],
    )


@pytest.mark.slow
def test_numbers_of_a_state_space_are_axes_and_have_derivatives():
    maps = vj.parameter_map(
        filtered, stiffness=[900.0, 1600.0], cutoff=[30.0], frequency=np.linspace(4.0, 8.0, 9)
    )
    assert int((maps["contact_force"] > 0).sum()) > 3

    def rms(stiffness):
        return vj.periodic_response(filtered(stiffness, 30.0), frequency=5.0).rms_ratio

    slope = (rms(900.09) - rms(899.91)) / 0.18
    assert float(jax.grad(rms)(900.0)) == pytest.approx(float(slope), rel=1e-5)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"flow": np.eye(4)}, "flow must be stable, its eigenvalues left"),
        ({"flow": np.zeros((4, 3))}, r"flow must be a square matrix, shape \(4, 4\)"),
        ({"response_map": [1.0, 0, 0]}, r"response_map must be one number per state, shape \(4,\)"),
        ({"stop_map": np.eye(4)[2:3]}, r"stop_map\[0\] must be a displacement, which no force"),
        ({"response_map": np.zeros(4)}, "response_map must read some state, got zeros"),
        ({"input_map": None}, "input_map must be given, with stops or a drive"),
        ({"force_map": None}, "force_map must be given"),
        ({"input_map": [0, 0, np.inf, 0]}, "input_map must be finite, got inf at index"),
        ({"stops": vj.Stop(0.5, 1e-3, SOLID)}, "position must be None for a Stop of a StateSpace"),
    ],
)
def test_what_is_no_state_space_is_refused(change, sentence):
    good = as_state_space(vj.default_rig(num_modes=2))
    names = ("flow", "response_map", "stops", "stop_map", "force_map", "drive", "input_map")
    numbers = {name: getattr(good, name) for name in names} | change
    with pytest.raises(ValueError, match=sentence):
        vj.StateSpace(numbers.pop("flow"), **numbers)
