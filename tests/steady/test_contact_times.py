"""Motions between contact times: their derivatives against the closed form of a single contact."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.model.systems import as_arrays, equations_of
from vibrojax.steady.contact_times import Orbit, follow_events, motion_from
from vibrojax.steady.orbit_reading import state_in
from vibrojax.steady.single_contact import laid_out, single_contact, unit_phases, unit_tables

FRACTION, TURN = 0.3, 1.3


@pytest.mark.slow  # to compile
def test_first_and_second_derivatives_by_the_gap_are_those_of_the_closed_form():
    """The force of the stop jumps at a touch: one correction of its time is not enough."""
    system = as_arrays(
        vj.MatrixSystem(
            [[1.0]],
            [[0.1]],
            [[1.0]],
            stops=vj.Stop(None, 1.0, vj.KelvinVoigt(3.0, 0.4)),
            stop_map=[[1.0]],
            drive=vj.PointForce(1.0),
            input_map=[1.0],
            response_map=[1.0],
        )
    )
    expected, found = jax.jit(lambda e: both(e, system.drive))(equations_of(system))
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)


def both(equations, drive):
    """Touch and length of the contact by the gap ratio, with two derivatives: closed, by steps."""
    phases, fraction = unit_phases(equations), jnp.asarray(FRACTION)
    tables = unit_tables(phases, drive, jnp.asarray(TURN))

    def closed(fraction):
        motion = single_contact(tables, fraction)
        return jnp.stack([motion.gap_ratio, motion.touch, 2 * jnp.pi * fraction])

    (gap, *times), (slope, *slopes), (bend, *bends) = twice(closed, fraction)
    slopes = jnp.stack(slopes) / slope
    expected = jnp.stack(times), slopes, (jnp.stack(bends) - slopes * bend) / slope**2

    own, events, motion = laid_out(tables, single_contact(tables, fraction))
    orbit = Orbit(state_in(own, motion, 0, events.section), motion.times)
    jacobian = follow_events(own, events, orbit, 1, with_jacobian=True).jacobian

    def solved(gap):
        def scaled(p):
            return [p.rest, p.readout_rest, p.change_rest, p.gap]

        wider = eqx.tree_at(scaled, phases, [a * gap for a in scaled(phases)])
        at = tables._replace(phases=wider)
        touch, departure = motion_from(at, events, orbit, jacobian, jnp.asarray(True), 1).times
        return jnp.stack([touch, departure - touch])

    return expected, twice(solved, gap)


def twice(function, x):
    """Values of a function of a number, with its first and second derivatives."""

    def slope(x):
        return jax.jvp(function, (x,), (jnp.ones(()),))[1]

    return function(x), *jax.jvp(slope, (x,), (jnp.ones(()),))
