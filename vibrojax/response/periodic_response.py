"""The periodic response itself, at one point: exact, with stability and derivatives."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._checks import check_count, check_one_number, check_range
from vibrojax.response.balanced_motion import read_balanced, solve_balance
from vibrojax.response.contact_times import MOST_EVENTS, Events, Orbit, follow_events
from vibrojax.response.exact_point import Guess, exact_point
from vibrojax.response.implicit import frozen
from vibrojax.response.methods import HarmonicBalance, Shooting, check_balance
from vibrojax.response.orbit_reading import find_crossings, read_course, state_at
from vibrojax.response.paths import FrequencyPath, frequency_path
from vibrojax.response.shooting import shoot
from vibrojax.response.starting import sampled_motion, settled_motion
from vibrojax.response.tracing import REPAIRS
from vibrojax.results.periodic_response import PeriodicResponse, reading_of
from vibrojax.stepping.choice import is_exact
from vibrojax.systems.base import AbstractSystem, LinearEquations, as_arrays, check_is_system

lax = jax.lax


def periodic_response(
    system: AbstractSystem,
    *,
    frequency_ratio: ArrayLike | None = None,
    frequency: ArrayLike | None = None,
    period: int = 1,
    guess: Any = None,
    method: Shooting | HarmonicBalance | None = None,
    tolerance: float = 1e-4,
) -> PeriodicResponse:
    """Solve for the steady state: a motion that returns after `period` drive periods.

    It can be differentiated with respect to every number in the system and the frequency, in
    forward and reverse mode, and mapped with `jax.vmap`, in both nestings. Derivatives are those of
    the solution (implicit), never of the search or of a transient.

    Parameters:
        system: what moves.
        frequency_ratio, frequency: drive frequency, one of the two (ratio to the first natural
            frequency of the unstopped system, or Hz).
        period: drive periods after which the motion repeats.
        guess: where Newton's method starts: a `PeriodicResponse` or a state (q, q') at drive
            phase 0, shape (2 coordinates,), the memories of stops behind it. By
            default a march from rest until it settles.
        method: `Shooting()` or `HarmonicBalance()`. By default linear stops are solved exactly
            between their contact times (shooting through exact propagators), other stops by
            harmonic balance, stops with an internal state, modes that fall away and other systems
            by shooting.
        tolerance: relative error to aim at, where the solution is not exact.

    Raises `ValueError` for a period below 1, settings that contradict each other, a tolerance out
    of reach, or a method that cannot take the system. A search that fails is flagged in `status`.
    """
    check_count("period", period)
    check_range("tolerance", tolerance, 0.0, 0.1, include_low=False, allowed="above 0, up to 0.1")
    if (frequency_ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    is_ratio = frequency_ratio is not None
    value = frequency_ratio if is_ratio else frequency
    name, unit = ("frequency_ratio", "ratio") if is_ratio else ("frequency", "Hz")
    check_is_system(system)
    advice = "Use continue_response, frequency_sweep or jax.vmap for many."
    check_one_number(name, value, unit, advice)
    if method is not None and not isinstance(method, Shooting | HarmonicBalance):
        raise ValueError(f"method must be Shooting() or HarmonicBalance(), got {method!r}.")
    arrays, value = as_arrays(system), jnp.asarray(value, float)
    equations = eqx.filter_eval_shape(arrays.equations)
    linear = isinstance(equations, LinearEquations)
    if is_ratio and not linear:
        raise ValueError("This system has no natural frequency: give frequency in Hz.")
    state = _state_of(guess, equations.state_size)
    exact = linear and is_exact(system)
    shot = not linear or bool(equations.memory_size)
    if linear and method is None:
        # About a position that the body falls away from there is no steady response to start from.
        shot = shot or equations.stiffness_sign is not None
    if isinstance(method, HarmonicBalance):
        check_balance(equations.stops)
    if isinstance(method, Shooting) or shot:
        if isinstance(method, HarmonicBalance):
            raise ValueError(
                f"{type(system).__name__} is not linear but for its stops, which harmonic balance "
                "needs. Use method=Shooting()."
            )
        return shoot(arrays, value, is_ratio, period, state, method or Shooting(), exact)
    if method is None and (exact or not equations.stops):
        return _exactly(arrays, value, is_ratio, period, state)
    if not equations.stops:
        raise ValueError("HarmonicBalance() needs a stop; leave method out for a linear system.")
    method = HarmonicBalance() if method is None else method
    method.check_reach(tolerance)
    samples = method.samples_for(tolerance)
    return _by_balance(arrays, value, is_ratio, period, state, samples, method.harmonics, exact)


def _state_of(guess: Any, size: int) -> Array | None:
    if guess is None:
        return None
    if isinstance(guess, PeriodicResponse):
        guess = guess.initial_state
    state = jnp.asarray(guess, float)
    if state.shape != (size,):
        raise ValueError(
            f"guess must be a PeriodicResponse or a state (q, q') of shape ({size},), got an "
            f"array of shape {state.shape}."
        )
    return state


@eqx.filter_jit
def _exactly(system, value, is_ratio, period, state) -> PeriodicResponse:
    path = frequency_path(system, is_ratio, True)
    found = _solved_exactly(frozen(path), frozen(value), period, frozen(state))
    # One Newton step from the solution, in which only the numbers of the system are
    # differentiated, has the value of the solution and its implicit derivative.
    tables = path.tables(value)
    start = found.orbit.state
    course = follow_events(tables, found.events, found.orbit, period)
    gap = jnp.where(found.valid, course.end - start, 0.0)
    start = start + jnp.linalg.solve(jnp.eye(start.size) - found.matrix, gap)
    orbit = Orbit(start, found.orbit.times)
    course = follow_events(tables, found.events, orbit, period)
    reading = read_course(tables, found.events, course, period)
    return reading_of(
        system,
        path.at(value),
        reading,
        period=period,
        multipliers=found.multipliers,
        residual=found.residual,
        converged=found.valid,
        exact=True,
    )


class _Solution(NamedTuple):
    """An exact motion, as constants."""

    events: Events
    orbit: Orbit
    matrix: Float[Array, "states states"]
    """Monodromy matrix in (q, q')."""
    multipliers: Array
    residual: Array
    valid: Array


def _solved_exactly(path: FrequencyPath, value, period: int, state) -> _Solution:
    """Find the motion and its sequence of contacts; no derivatives."""
    assert path.phases is not None
    if state is None:
        state = settled_motion(path, value, period, exact=True)
    weight = path.phases.weight
    if not path.equations.stops:
        nothing = jnp.full(MOST_EVENTS, -1, jnp.int32)
        times = jnp.zeros(MOST_EVENTS) + 2 * np.pi * period
        events = Events(nothing, jnp.zeros((), jnp.int32), jnp.zeros(()))
        first = Guess(events, Orbit(state, times), jnp.asarray(True))
    else:
        depth, change, states = sampled_motion(path, value, state, period, exact=True)
        found = find_crossings(depth, change, MOST_EVENTS, period)
        # The section is moved to the nearest sample, whose state is known.
        angle = 2 * np.pi * period * jnp.arange(states.shape[0]) / states.shape[0]
        nearest = jnp.argmin(jnp.abs(angle - found.events.section))
        events = found.events._replace(section=angle[nearest])
        first = Guess(events, Orbit(states[nearest], found.times), found.number <= MOST_EVENTS)

    def attempt(carry, _):
        guess, best = carry
        point, course = exact_point(path.tables, guess, value, period, hold=True, iterations=8)
        matrix = point.monodromy * weight / weight[:, None]
        solution = _Solution(
            guess.events, point.orbit, matrix, point.multipliers, point.residual, point.valid
        )
        best = jax.tree.map(lambda a, b: jnp.where(best.valid, a, b), best, solution)
        if not path.equations.stops:
            return (guess, best), None
        reading = point.reading
        again = find_crossings(reading.depth, reading.change, MOST_EVENTS, period)
        section = again.events.section
        there = state_at(path.tables(value), course, section, guess.events.section, period)
        following = Guess(again.events, Orbit(there, again.times), again.number <= MOST_EVENTS)
        return (following, best), None

    n = state.size
    blank = _Solution(
        first.events,
        first.orbit,
        jnp.zeros((n, n)),
        jnp.zeros(n, complex),
        jnp.asarray(jnp.inf),
        jnp.asarray(False),
    )
    (_, best), _ = lax.scan(attempt, (first, blank), None, length=1 + REPAIRS)
    return best


@eqx.filter_jit
def _by_balance(system, value, is_ratio, period, state, samples, harmonics, exact):
    path = frequency_path(system, is_ratio, False)
    place, still = path.at(value), frozen(path).at(frozen(value))
    state = frozen(state)
    if state is None:
        state = settled_motion(frozen(path), frozen(value), period, exact)
    depth, _, _ = sampled_motion(frozen(path), frozen(value), state, period, exact)
    spectrum, converged = solve_balance(place, still, depth, samples, period, harmonics)
    reading = read_balanced(place, spectrum, period)
    return reading_of(
        system,
        place,
        reading,
        period=period,
        multipliers=reading.multipliers,
        residual=lax.stop_gradient(reading.residual),
        converged=converged,
        exact=False,
    )
