"""An exact motion of a branch as a function of where on the curve it is, and of the rig's numbers.

The curve of all motions is regular where it folds too: a motion is known by how far it is along the
tangent of the curve at one that is known. What is measured there has derivatives along the curve
and in the numbers, and so has every place that a condition says: a fold, a peak, where a level is
crossed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.ensemble.slopes import WithSlopes, with_slopes
from vibrojax.results.variables import DIFFERENTIATED
from vibrojax.steady.contact_times import Events, Orbit, Tables, follow_events, tables_of
from vibrojax.steady.exact_means import contact_fraction, mean_force, mean_square_and_harmonic
from vibrojax.steady.orbit_reading import look, read_motion, segment_of
from vibrojax.steady.paths import FrequencyPath, frequency_path
from vibrojax.stepping.elementary import varied
from vibrojax.stepping.phase_motion import stop_push

lax = jax.lax

MEASURED = ("parameter", *DIFFERENTIATED, "impulse", "clearance")
"""What is measured of a motion. The last one says how far a stop is from a change of contact, m."""
MEANS = "parameter", "rms_ratio", "first_harmonic_ratio", "contact_fraction", "impulse"
"""What of that needs no search for extremes."""
NEAREST = 4
"""Corrections of the time at which a stop comes nearest."""


class KnownMotion(NamedTuple):
    """A motion of a branch, as it was solved for; one lane."""

    events: Events
    times: Float[AnyArray, " events"]
    state: Float[AnyArray, " states"]
    """At the section, in units of energy."""
    parameter: Float[AnyArray, ""]
    state_along: Float[AnyArray, " states"]
    parameter_along: Float[AnyArray, ""]
    matrix: Float[AnyArray, "states states"]
    """Jacobian of the period map at the section."""
    scale: Float[AnyArray, ""]
    """Change of the parameter that counts as much as the state changing by its size."""
    stop: Int[AnyArray, ""]
    """Which stop's clearance is measured, and near which drive phase (rad)."""
    angle: Float[AnyArray, ""]


class Around(NamedTuple):
    """What is measured of a motion, and how it changes; columns are those of `MEASURED`."""

    value: Float[AnyArray, "*points measured"]
    along: Float[AnyArray, "*points measured"]
    """Derivative along the curve, per unit of its arclength."""
    by_number: Float[AnyArray, "*points numbers measured"]
    """Derivatives in the numbers, at a place that stays across the tangent."""


class Rates(NamedTuple):
    """How something changes: the derivative along the curve of what is measured, or one number."""

    along: Float[AnyArray, "*points_and_measured"]
    """Along the curve."""
    by_number: Float[AnyArray, "*points_and_numbers_and_measured"]


@compiled
def paths_with_slopes(systems: Any, slopes: Any, is_ratio: bool) -> WithSlopes:
    """Make the paths along the frequency of stacked systems, and their derivatives.

    `slopes` are of `systems_with_slopes`: the axes of the derivatives are lanes, numbers.
    """

    def one(system: Any, ways: Any) -> WithSlopes:
        found = with_slopes(lambda s: frequency_path(s, is_ratio, True), system, ways)
        smooth = jax.tree.map(
            lambda a, b: b if eqx.is_inexact_array(a) else None, found.made, found.slopes
        )
        return WithSlopes(found.made, smooth)

    return jax.vmap(one)(systems, slopes)


def _moved(path: FrequencyPath, slopes: Any, numbers: Array) -> FrequencyPath:
    """The path of a rig whose numbers have changed, to first order."""

    def move(a: Any, b: Any) -> Any:
        return a if b is None else a + jnp.tensordot(numbers, b, 1)

    return jax.tree.map(move, path, slopes, is_leaf=lambda a: a is None)


class _Curve:
    """Motions next to one that is known."""

    def __init__(self, path: FrequencyPath, slopes: Any, motion: KnownMotion, period: int):
        self.path, self.slopes, self.motion, self.period = path, slopes, motion, period
        assert path.phases is not None
        self.size = jnp.linalg.norm(motion.state)
        self.size = jnp.where(self.size > 0, self.size, 1.0)
        self.unit = lax.stop_gradient(path.phases.weight) / self.size
        self.start = jnp.append(motion.state / self.size, motion.parameter / motion.scale)
        self.tangent = jnp.append(
            motion.state_along / self.size, motion.parameter_along / motion.scale
        )

    def follow(
        self, path: FrequencyPath, unknown: Array, times: Array, *, with_jacobian: bool = False
    ) -> tuple[Tables, Any]:
        assert path.phases is not None  # of linear stops
        w = unknown[-1] * self.motion.scale * path.unit
        tables = tables_of(path.phases, path.drive, w, resonant=False)
        events, orbit = self.motion.events, Orbit(unknown[:-1] / self.unit, times)
        motion = follow_events(tables, events, orbit, self.period, with_jacobian=with_jacobian)
        return tables, motion

    def held_matrix(self) -> Array:
        """Of Newton's method, at the motion that is known."""

        def end(parameter: Array) -> Array:
            unknown = self.start.at[-1].set(parameter)
            return (
                self.follow(self.path, unknown, jnp.asarray(self.motion.times))[1].end * self.unit
            )

        push = jax.jvp(end, (self.start[-1],), (jnp.ones(()),))[1]
        still = self.motion.matrix - jnp.eye(len(push))
        return jnp.block([[still, push[:, None]], [self.tangent[None]]])

    def at(self, place: Array, numbers: Array, matrix: Array, order: int) -> "_There":
        """The motion at a place along the tangent, with derivatives up to an order.

        With the matrix and the rates at the events held, two rounds of Newton's method make those
        of one order more right: the times of the events follow the state a round later.
        """
        path = _moved(self.path, self.slopes, numbers)

        def newton(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Any]:
            unknown, times = carry
            found = self.follow(path, unknown, times)
            missing = found[1].end * self.unit - unknown[:-1]
            gone = self.tangent @ (unknown - self.start) - place
            change = jnp.linalg.solve(matrix, jnp.append(missing, gone))
            return (unknown - change, found[1].times), (unknown, *found)

        start = self.start, jnp.asarray(self.motion.times)
        start = varied(start, place, numbers, path.unit)
        _, rounds = lax.scan(newton, start, None, length=2 * order)
        unknown, tables, motion = jax.tree.map(lambda a: a[-1] if eqx.is_array(a) else a, rounds)
        return _There(path, unknown, tables, motion)

    def measured(
        self, place: Array, numbers: Array, matrix: Array, order: int, means: bool
    ) -> Array:
        """What is measured; only the `means` where that is said, NaN for all else."""
        path, unknown, tables, motion = self.at(place, numbers, matrix, order)
        reference, _ = path.drive.reference
        turn = 2 * np.pi / tables.angular_frequency
        found = {name: jnp.full((), jnp.nan) for name in MEASURED}
        found["parameter"] = unknown[-1] * self.motion.scale
        count = self.motion.events.number + 1
        found["impulse"] = mean_force(tables, motion, self.period, count) * turn
        if means:
            square, harmonic = mean_square_and_harmonic(tables, motion, self.period, count)
            fraction = contact_fraction(motion, self.period)
        else:
            read = read_motion(tables, self.motion.events, motion, self.period)
            square, harmonic = read.mean_square, read.first_harmonic
            fraction = read.contact_fraction
            found |= {
                "amplitude_ratio": (read.highest - read.lowest) / 2 / reference,
                "peak_ratio": jnp.maximum(read.highest, -read.lowest) / reference,
                "contact_force": read.contact_force,
                "clearance": self._clearance(tables, motion),
            }
        found |= {
            "rms_ratio": jnp.sqrt(square) / reference,
            "first_harmonic_ratio": harmonic / reference,
            "contact_fraction": fraction,
        }
        return jnp.stack([found[name] for name in MEASURED])

    def _clearance(self, tables: Tables, motion: Any) -> Array:
        """How far a stop is from changing its contact where it comes nearest; negative before."""
        stop, stops = self.motion.stop, tables.phases.num_stops
        if not stops:
            return jnp.zeros(())
        whole, begin = 2 * np.pi * self.period, self.motion.events.section

        def nearness(tables: Tables, motion: Any, angle: Array) -> tuple[Array, Array]:
            """How near a change of contact is, m, and its rate: by depth, or of contact by push."""
            phases = tables.phases
            angle = begin + jnp.mod(angle - begin, whole)
            segment = segment_of(motion, angle)
            rows = look(tables, motion, segment[None], angle[None])[:, 0]
            depth, rate = rows[stop], rows[stops + stop]
            push, slope = stop_push(
                phases.stiffness[stop],
                phases.damping[stop],
                jnp.asarray(phases.can_pull)[stop],
                tables.angular_frequency,
                depth,
                rate,
                rows[2 * stops + stop],
            )
            held = ((motion.phase[segment] >> stop) & 1) == 1
            return jnp.where(held, -push, depth), jnp.where(held, -slope, rate)

        still = lax.stop_gradient((tables, motion))

        def nearer(_: Any, angle: Array) -> Array:
            one = jnp.ones_like(angle)
            rate, bend = jax.jvp(lambda a: nearness(*still, a)[1], (angle,), (one,))
            return angle - jnp.clip(rate / jnp.where(bend == 0, 1.0, bend), -0.05, 0.05)

        # The time itself does not count: where a stop is nearest, the rate is zero.
        angle = lax.fori_loop(0, NEAREST, nearer, lax.stop_gradient(self.motion.angle))
        return nearness(tables, motion, angle)[0]


class _There(NamedTuple):
    path: FrequencyPath
    unknown: Array
    tables: Tables
    motion: Any


def _each(
    function: Any, paths: Any, slopes: Any, motions: KnownMotion, period: int, *arrays: Array
) -> Any:
    """Call a function of each curve, its matrix, the number of numbers and arrays by motion."""

    def one(path: FrequencyPath, slope: Any, motion: KnownMotion, *own: Array) -> Any:
        curve = _Curve(path, slope, motion, period)
        count = next(len(leaf) for leaf in jax.tree.leaves(slope))
        return function(curve, lax.stop_gradient(curve.held_matrix()), count, *own)

    return jax.vmap(one)(paths, slopes, motions, *arrays)


def _with_slopes(function: Callable[[Array, Array], Array], count: int) -> tuple[Array, Array]:
    """Value at zero of a function of the place and of so many numbers, and its derivatives.

    These come first by the place, then by each number.
    """

    def along(way: Array) -> tuple[Array, Array]:
        return jax.jvp(function, (jnp.zeros(()), jnp.zeros(count)), (way[0], way[1:]))

    return jax.vmap(along, out_axes=(None, 0))(jnp.eye(count + 1))


@compiled
def look_around(paths: Any, slopes: Any, motions: KnownMotion, period: int, means: bool) -> Around:
    """Measure some motions, and how that changes along the curve and with the numbers.

    All have the points as the leading axis; `slopes` are of `paths_with_slopes`. With `means` only
    these are measured.
    """

    def one(curve: _Curve, matrix: Array, count: int) -> Around:
        def measured(place: Array, numbers: Array) -> Array:
            return curve.measured(place, numbers, matrix, 1, means)

        value, slopes = _with_slopes(measured, count)
        return Around(value, slopes[0], slopes[1:])

    return _each(one, paths, slopes, motions, period)


@compiled
def bends_around(
    paths: Any, slopes: Any, motions: KnownMotion, period: int, measured: bool
) -> Rates:
    """How the derivative along the curve changes; as `look_around`.

    Of the parameter only unless all that is `measured` is asked for, which takes longer to compile.
    """

    def one(curve: _Curve, matrix: Array, count: int) -> Rates:
        def value(place: Array, numbers: Array) -> Array:
            if measured:
                return curve.measured(place, numbers, matrix, 2, False)
            return curve.at(place, numbers, matrix, 2).unknown[-1:] * curve.motion.scale

        def along(place: Array, numbers: Array) -> Array:
            return jax.jvp(lambda place: value(place, numbers), (place,), (jnp.ones(()),))[1]

        _, bends = _with_slopes(along, count)
        return Rates(bends[0], bends[1:])

    return _each(one, paths, slopes, motions, period)


@compiled
def multipliers_around(
    paths: Any,
    slopes: Any,
    motions: KnownMotion,
    left: Complex[Array, "points states"],
    right: Complex[Array, "points states"],
    period: int,
) -> Rates:
    """Derivatives of the logarithm of a multiplier's modulus; as `look_around`.

    `left` and `right` are its vectors, of the Jacobian of the period map in units of energy.
    """

    def one(curve: _Curve, matrix: Array, count: int, left: Array, right: Array) -> Any:
        def logarithm(place: Array, numbers: Array) -> Array:
            there = curve.at(place, numbers, matrix, 1)
            given = there.path, there.unknown, there.motion.times
            jacobian = curve.follow(*given, with_jacobian=True)[1].jacobian
            # Its product with the vectors is all of it that counts.
            turned = (curve.unit[:, None] * jacobian / curve.unit) @ right
            return jnp.log(jnp.sum(jnp.conj(left) * turned)).real

        _, slopes = _with_slopes(logarithm, count)
        return Rates(slopes[0], slopes[1:])

    return _each(one, paths, slopes, motions, period, left, right)
