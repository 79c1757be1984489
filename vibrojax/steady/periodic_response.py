"""The periodic response itself, at one point: exact, with stability and derivatives."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from vibrojax._tools.checks import check_one_number, is_traced
from vibrojax._tools.compiled import compiled, is_alone
from vibrojax._tools.programs import sorted_out
from vibrojax._tools.signatures import validated
from vibrojax._tools.warn import warn
from vibrojax.ensemble.frequencies import check_axis
from vibrojax.model.laws import is_linear
from vibrojax.model.states import ABOUT_STATES, as_state
from vibrojax.model.systems import AbstractSystem, as_arrays, check_is_system, equation_kinds
from vibrojax.steady.balanced_motion import balanced_strobes, read_balanced, solve_balance
from vibrojax.steady.contact_times import Events, Orbit, follow_events, motion_from
from vibrojax.steady.exact_point import ExactPoint, Guess, exact_point, sampled_guess
from vibrojax.steady.implicit import compile_columns_ahead, frozen, with_columns
from vibrojax.steady.methods import HarmonicBalance, PeriodicSettings, Shooting, check_balance
from vibrojax.steady.orbit_reading import find_crossings, read_motion, state_at
from vibrojax.steady.paths import FrequencyPath, exact_path, frequency_path
from vibrojax.steady.periodic_result import PeriodicResponse, numbers_of
from vibrojax.steady.shooting import shoot
from vibrojax.steady.starting import SAMPLES, sampled_motion, settled_motion
from vibrojax.stepping.choice import is_exact
from vibrojax.stepping.measures import MOST_EVENTS

lax = jax.lax

REPAIRS = 3
"""Searches anew with the contacts that were found, where they are others than guessed."""
MOST_RESIDUAL = 0.1
"""Residual of a balance on a finer grid at which it is no motion."""
FIRST_ONLY = (
    "A motion found by harmonic balance has no second derivatives: its peaks are read off samples. "
    "Use PeriodicSettings(method=Shooting()), or differences of the first derivatives."
)


@validated(traceable=True)
def periodic_response(
    system: AbstractSystem,
    *,
    frequency_ratio: ArrayLike | None = None,
    frequency: ArrayLike | None = None,
    guess: PeriodicResponse | ArrayLike | Sequence[float] | None = None,
    settings: PeriodicSettings | None = None,
) -> PeriodicResponse:
    """Solve for the steady state: a motion that repeats itself.

    It can be differentiated with respect to every number in the system and the frequency, in
    forward and reverse mode, and mapped with `jax.vmap`, in both nestings. Derivatives are those of
    the solution (implicit), never of the search or of a transient; second ones (`jax.hessian`) too,
    except for a motion found by harmonic balance.

    Parameters:
        system: what moves.
        frequency_ratio, frequency: drive frequency, one of the two (ratio to the first natural
            frequency of the unstopped system, or Hz).
        guess: where Newton's method starts: a `PeriodicResponse`, or a state at drive phase 0: what
            `system.state(displacement=..., velocity=...)` makes of displacements, one of
            `history.states`, or (q, q') in the coordinates of the system, those of its modes for a
            beam and for matrices, the memories of stops behind them. By default a march from rest
            until it settles.
        settings: `vj.PeriodicSettings(period=..., tolerance=..., method=...)`.

    Raises `ValueError` for arguments that contradict each other, a tolerance out of reach, a method
    that cannot take the system, or second derivatives of a balance. A search that fails is flagged
    in `status`.
    Where a guess led elsewhere, to a motion that lies far from it (`guess_distance`) or repeats
    sooner than asked for (`minimal_period`), the result says so, and a warning outside of
    transformations.
    """
    settings = settings or PeriodicSettings()
    period, tolerance, method = settings.period, settings.tolerance, settings.method
    if (frequency_ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    is_ratio = frequency_ratio is not None
    value = frequency_ratio if is_ratio else frequency
    name, unit = ("frequency_ratio", "ratio") if is_ratio else ("frequency", "Hz")
    check_is_system(system)
    advice = "Use continue_response, frequency_sweep or jax.vmap for many."
    check_one_number(name, value, unit, advice)
    arrays, value = as_arrays(system), jnp.asarray(value, float)
    equations = equation_kinds(arrays)
    linear = equations.linear_between_contacts
    check_axis(equations, name)
    state = None if guess is None else as_state("guess", guess, equations)
    exact = linear is not None and is_exact(system)
    remembers = any(s.memory_size and not is_linear(s.law) for s in equations.stops)
    shot = linear is None or remembers
    if linear is not None and method is None:
        # About a position that the body falls away from there is no steady response to start from.
        shot = shot or (linear.stiffness_sign is not None and not linear.free)
    by_contacts = method is None and not shot and (exact or not equations.stops)
    if isinstance(method, HarmonicBalance):
        check_balance(equations.stops)
    if isinstance(method, Shooting) or shot:
        if isinstance(method, HarmonicBalance):
            raise ValueError(
                f"{type(system).__name__} is not linear but for its stops, which harmonic balance "
                "needs. Use PeriodicSettings(method=Shooting())."
            )
        found = shoot(arrays, value, is_ratio, period, state, method or Shooting(), exact)
    elif by_contacts:
        numbers, how, still = (arrays, value), (period, state), frozen((arrays, value))
        if is_alone(sorted_out((still, state))[0]):
            path = exact_path.ahead(still[0], is_ratio)
            point = _solved_exactly.ahead(path, still[1], *how)
            if any(is_traced(a) for a in jax.tree.leaves(numbers)):  # to be differentiated
                compile_columns_ahead(_exact, numbers, point, *how, is_ratio)
            else:
                _read_exactly.ahead(path, still[1], point, *how)
        point = _solved_exactly(exact_path(still[0], is_ratio), still[1], *frozen(how))
        found = with_columns(_exact, numbers, point, *how, is_ratio)
    elif not equations.stops:
        raise ValueError("HarmonicBalance() needs a stop; leave method out for a linear system.")
    else:
        balance = HarmonicBalance() if method is None else method
        samples, harmonics = balance.samples_for(tolerance), balance.harmonics
        how = is_ratio, period, state, samples, harmonics, exact
        found = with_columns(_by_balance, (arrays, value), *how, first_only=FIRST_ONLY)
    response = PeriodicResponse(
        **found,
        period=period,
        exact=by_contacts,
        ratio_units=system.drive.reference[1],
        system=arrays,
    )
    if guess is not None and not is_traced(response.status):
        _warn_of_guess(response)
    return response


def _warn_of_guess(found: PeriodicResponse) -> None:
    """Warn where the guess led to no motion, or elsewhere."""
    if not found.converged or found.notes:
        warn(f"From this guess: {found.sentence} {ABOUT_STATES}")


def _exact(numbers, found: ExactPoint, period, state, is_ratio) -> dict[str, Array]:
    system, value = numbers
    return _read_exactly(exact_path(system, is_ratio), value, found, period, state)


@compiled(lightly=True)
def _read_exactly(path: FrequencyPath, value, found: ExactPoint, period, state) -> dict[str, Array]:
    tables = path.tables(value)
    motion = motion_from(tables, found.events, found.orbit, found.matrix, found.valid, period)
    reading = read_motion(tables, found.events, motion, period)
    phases = 2 * np.pi * jnp.arange(period)
    strobes = jax.vmap(lambda phase: state_at(tables, motion, phase, found.events.section, period))(
        phases
    )
    return numbers_of(
        path.at(value),
        reading,
        period=period,
        strobes=strobes,
        guess=state,
        multipliers=found.multipliers,
        residual=found.residual,
        converged=found.valid,
    )


@compiled
def _solved_exactly(path: FrequencyPath, value, period: int, state) -> ExactPoint:
    """Find the motion and its sequence of contacts; no derivatives."""
    tables = path.tables(value)
    weight = tables.phases.weight
    if not path.equations.stops:
        nothing = jnp.full(MOST_EVENTS, -1, jnp.int32)
        times = jnp.zeros(MOST_EVENTS) + 2 * np.pi * period
        events = Events(nothing, jnp.zeros((), jnp.int32), jnp.zeros(()))
        # One period from rest is all there is to know of a linear motion, damped or not.
        rest = Orbit(jnp.zeros_like(weight), times)
        once = follow_events(tables, events, rest, period, with_jacobian=True)
        assert once.jacobian is not None
        state = jnp.linalg.solve(jnp.eye(weight.size) - once.jacobian, once.end)
        first = Guess(events, Orbit(state, times), jnp.asarray(True))
    else:
        if state is None:
            state = settled_motion(path, value, period, exact=True)
        first = sampled_guess(path, value, state, period)

    def attempt(carry):
        count, guess, _ = carry
        point, reading, motion = exact_point(tables, guess, period)
        if not path.equations.stops:
            return count + 1, guess, point
        again = find_crossings(reading.depth, reading.change, MOST_EVENTS, period)
        section = again.events.section
        there = state_at(tables, motion, section, guess.events.section, period)
        following = Guess(again.events, Orbit(there, again.times), again.number <= MOST_EVENTS)
        return count + 1, following, point

    def on(carry):
        count, _, point = carry
        return (count <= REPAIRS) & ~point.valid

    n = state.size
    blank = ExactPoint(
        first.events,
        first.orbit,
        jnp.zeros((n, n)),
        jnp.zeros(n, complex),
        jnp.asarray(jnp.inf),
        jnp.asarray(False),
    )
    return lax.while_loop(on, attempt, (jnp.asarray(0), first, blank))[-1]


@compiled
def _by_balance(numbers, is_ratio, period, state, samples, harmonics, exact) -> dict[str, Array]:
    system, value = numbers
    path = frequency_path(system, is_ratio, False)
    place, still = path.at(value), frozen(path).at(frozen(value))
    start = frozen(state)
    if start is None:
        start = settled_motion(frozen(path), frozen(value), period, exact)
    count = max(SAMPLES, samples)
    depth, _, _ = sampled_motion(frozen(path), frozen(value), start, period, exact, count)
    spectrum, converged = solve_balance(place, still, depth, samples, period, harmonics)
    reading = read_balanced(place, spectrum, period)
    # Next to an undamped resonance the samples do not determine the motion.
    converged = converged & (reading.residual < MOST_RESIDUAL)
    return numbers_of(
        place,
        reading,
        period=period,
        strobes=balanced_strobes(place, spectrum, period),
        guess=state,
        multipliers=reading.multipliers,
        residual=lax.stop_gradient(reading.residual),
        converged=converged,
    )
