"""Marches under sampled inputs, against scipy's integration from event to event."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import vibrojax as vj
from vibrojax.stepping.input_phases import first_change, input_phases
from vibrojax.stepping.signal_march import march_equal, march_unequal

STIFFNESS, DAMPING, GAP = 5500.0, 0.3, 4e-4
STEP, COUNT = 1e-3, 400


def rig(tension):
    made = vj.default_rig()
    law = vj.KelvinVoigt(STIFFNESS, DAMPING, tension=tension)
    stop = dataclasses.replace(made.stops[0], law=law, gap=GAP)
    return dataclasses.replace(made, stops=(stop,), num_modes=3)


def reference(equations, time, inputs, tension):
    """States (q, q') at the samples, and how often contact changed."""
    w, zeta, driven = (
        np.asarray(a)
        for a in (equations.angular_frequency, equations.damping_ratio, equations.input_map)
    )
    towards, push = np.asarray(equations.stop_map)[0], np.asarray(equations.force_map)[:, 0]
    n = w.size

    def force(y):
        return STIFFNESS * (towards @ y[:n] - GAP) + DAMPING * (towards @ y[n:])

    def rates(t, y, touching):
        q, v = y[:n], y[n:]
        drive = driven * np.interp(t, time, inputs)
        return np.r_[v, drive - 2 * zeta * w * v - w**2 * q - push * touching * force(y)]

    def touch(t, y, touching):
        return towards @ y[:n] - GAP

    def leave(t, y, touching):
        return touch(t, y, touching) if tension else force(y)

    touch.direction, leave.direction = 1, -1
    touch.terminal = leave.terminal = True
    y, touching, changes, states = np.zeros(2 * n), False, 0, [np.zeros(2 * n)]
    for begun, ended in itertools.pairwise(time):
        while begun < ended - 1e-15:
            found = solve_ivp(
                rates,
                (begun, ended),
                y,
                args=(touching,),
                events=leave if touching else touch,
                rtol=1e-12,
                atol=1e-15,
                method="DOP853",
            )
            begun, y = found.t[-1], found.y[:, -1]
            if found.status == 1:
                touching, changes = not touching, changes + 1
        states.append(y)
    return np.array(states), changes


def shaken(scale=300.0):
    noise = np.random.default_rng(1).standard_normal(COUNT + 1)
    return scale * np.cumsum(noise)


@pytest.fixture(scope="module", params=[True, False])
def marched(request):
    """Equations, phases, inputs, tension, and the march over equal intervals."""
    equations = rig(request.param).equations().linear_between_contacts
    drive = vj.BaseMotion()
    phases = input_phases(equations, drive, vj.Sampled([0.0, 1.0], [0.0, 0.0]))
    begun = phases.begin(jnp.zeros(phases.scale.shape[0]), 0.0)

    @jax.jit
    def go(inputs):
        how = {"stride": 1, "count": COUNT, "reverse": False}
        return march_equal(phases, begun, inputs, jnp.asarray(STEP), **how)

    return equations, phases, begun, go, request.param


def states_of(phases, carried):
    return np.asarray(carried)[:, : phases.scale.shape[0]] * np.asarray(phases.scale)


def error(found, expected):
    return np.max(np.abs(found - expected) / np.max(np.abs(expected), axis=0))


@pytest.mark.slow
def test_contacts_are_those_of_scipy(marched):
    equations, phases, _, go, tension = marched
    inputs, time = shaken(), STEP * np.arange(COUNT + 1)
    expected, changes = reference(equations, time, inputs, tension)
    assert changes >= 2
    assert error(states_of(phases, go(inputs)), expected) < 1e-9


@pytest.mark.slow
def test_equal_and_unequal_marches_are_one(marched):
    _, phases, begun, go, _ = marched
    inputs, time = shaken(), STEP * np.arange(COUNT + 1)
    # Further knots on the straight lines change nothing, nor do those that are there twice.
    knots = np.sort(np.r_[time, time[:-1] + 0.3 * STEP, time[100]])
    values = np.interp(knots, time, inputs)
    finer = march_unequal(phases, begun, jnp.asarray(values), jnp.asarray(knots), reverse=False)
    there = np.searchsorted(knots, time)
    assert error(states_of(phases, finer[there]), states_of(phases, go(inputs))) < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("stride", [7, 100])
def test_what_is_kept_does_not_matter(marched, stride):
    _, phases, begun, go, _ = marched
    inputs = jnp.asarray(shaken())
    how = {"stride": stride, "count": COUNT // stride, "reverse": False}
    kept = march_equal(phases, begun, inputs, jnp.asarray(STEP), **how)
    whole = go(inputs)[::stride][: len(kept)]
    assert error(states_of(phases, kept)[1:], states_of(phases, whole)[1:]) < 1e-11


def test_flights_add_up(marched):
    _, phases, _, go, _ = marched
    one, other = shaken(0.05), 0.02 * np.sin(np.arange(COUNT + 1) / 7.0)
    apart = states_of(phases, go(one)) + states_of(phases, go(other))
    assert error(states_of(phases, go(one + other))[1:], apart[1:]) < 1e-11


def test_the_first_of_two_changes_is_found():
    # Depth -(u - 0.3)(u - 0.31): it is above 0 for a hundredth of the step.
    depth = jnp.array([-0.3 * 0.31, 0.61, -1.0])[:, None]
    noise, flying = jnp.full((2, 1), 1e-17), jnp.array([False])
    share, stop, by_depth = first_change(depth, depth, noise, flying)
    assert float(share) == pytest.approx(0.3, abs=1e-12)
    assert int(stop) == 0
    assert bool(by_depth)
    lower = depth.at[0].add(-1e-4)
    share, stop, _ = first_change(lower, lower, noise, flying)
    assert (float(share), int(stop)) == (1.0, -1)
