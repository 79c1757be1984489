"""Folds of exact periodic motions: where the response jumps, with derivatives.

A fold is a periodic motion whose period map has a multiplier of 1. The motion, the frequency and
the condition are solved together, so that the frequency of the fold is a function of the numbers of
the system and can be differentiated.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from vibrojax._tools.checks import is_traced
from vibrojax._tools.compiled import compiled, is_alone
from vibrojax._tools.described import shown_value
from vibrojax._tools.programs import sorted_out
from vibrojax._tools.signatures import validated
from vibrojax.branches.points import SpecialPoint
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.steady.contact_times import TO_SECOND, Events, Orbit, PiecewiseMotion, follow_events
from vibrojax.steady.exact_point import sampled_guess
from vibrojax.steady.implicit import compile_columns_ahead, frozen, with_columns
from vibrojax.steady.orbit_reading import read_motion
from vibrojax.steady.paths import FrequencyPath, exact_path
from vibrojax.stepping.choice import is_exact

lax = jax.lax

STEPS = 13
"""Of Newton's method at the most."""
DONE, SOLVED = 1e-12, 1e-8
"""Correction after which there is no need of another, and of a fold that was found."""


class Fold(NamedTuple):
    """A fold of the response: where it jumps when the frequency is swept."""

    parameter: Float[Array, ""]
    """Drive frequency, in the unit of the guess."""
    amplitude_ratio: Float[Array, ""]
    """Half peak-to-peak displacement there over the drive amplitude."""
    contact_force: Float[Array, ""]
    """Largest contact force there, N."""
    initial_state: Float[Array, " states"]
    """(q, q') at drive phase 0."""
    found: Bool[Array, ""]
    """Whether the search converged on a motion that keeps to its contacts; NaN where not."""

    def __repr__(self) -> str:
        return (
            f"Fold(parameter={shown_value(self.parameter, exact=False)}, "
            f"amplitude_ratio={shown_value(self.amplitude_ratio, exact=False)}, "
            f"contact_force={shown_value(self.contact_force, 'N', exact=False)}, "
            f"found={shown_value(self.found)})"
        )


@validated(traceable=True)
def fold_response(system: AbstractSystem, near: SpecialPoint | Fold, *, axis: str) -> Fold:
    """Solve for the fold near one that is known, of this or of a similar system.

    Its numbers can be differentiated with respect to every number in the system, in forward and
    reverse mode (implicitly, on the condition of the fold), twice (`jax.hessian`), and mapped with
    `jax.vmap`.

    Parameters:
        system: a system with linear stops (KelvinVoigt without smoothing).
        near: a fold of the `special_points` of a `Branch` of period 1, or of this function.
        axis: unit of the frequency, `frequency_ratio` or `frequency` (Hz), as of the branch.

    Raises `ValueError` for a system whose stops are not linear, another axis, or a special point
    that is no fold with contact.
    """
    if axis not in ("frequency_ratio", "frequency"):
        raise ValueError(f"axis must be 'frequency_ratio' or 'frequency', got {axis!r}.")
    check_linear_stops("fold_response", system)
    if isinstance(near, SpecialPoint) and (near.kind != "fold" or near.initial_state is None):
        raise ValueError(f"near must be a fold with contact, got {near!r}.")
    state = frozen(jnp.asarray(near.initial_state, float))
    value = frozen(jnp.asarray(near.parameter, float))
    arrays, is_ratio = as_arrays(system), axis == "frequency_ratio"
    still = frozen(arrays)
    if is_alone(sorted_out((still, state, value))[0]):
        path, found = compile_search(still, is_ratio)
        if any(is_traced(a) for a in jax.tree.leaves(arrays)):  # to be differentiated
            compile_columns_ahead(_fold, arrays, *found, is_ratio)
        else:
            _read.ahead(path, *found)
    found = _search(exact_path(still, is_ratio), state, value)
    return with_columns(_fold, arrays, *found, is_ratio)


def check_linear_stops(study: str, system: AbstractSystem) -> None:
    """Raise `ValueError` where a study solves for folds and the system's motions are not exact."""
    if not is_exact(system):
        raise ValueError(f"{study} needs linear stops without smoothing (KelvinVoigt).")


def compile_search(system: AbstractSystem, is_ratio: bool) -> tuple[Any, Any]:
    """Compile the search for folds in the background; shapes of the path and of what is found."""
    path = exact_path.ahead(system, is_ratio)
    return path, _search.ahead(path, np.zeros(path.phases.weight.shape), np.zeros(()))


class _Frame(NamedTuple):
    """What is held while a fold is searched for."""

    events: Events
    size: Array
    """Unit of every state."""
    border: Array
    """Row and column that border the singular matrix."""


def _condition(path: FrequencyPath, frame: _Frame, times, unknown):
    """Return of the state and the measure of singularity that vanishes at a fold; contact times."""
    x, p = unknown[:-1], unknown[-1]
    orbit = Orbit(x * frame.size, times)
    motion = follow_events(path.tables(p), frame.events, orbit, 1, with_jacobian=True)
    left, right = frame.border
    still = _still(motion, frame.size)
    bordered = jnp.block([[still, left[:, None]], [right[None], jnp.zeros((1, 1))]])
    measure = jnp.linalg.solve(bordered, jnp.zeros(x.size + 1).at[-1].set(1.0))[-1]
    return jnp.append(motion.end / frame.size - x, measure), motion.times


def _still(motion: PiecewiseMotion, size: Array) -> Array:
    """Jacobian of the return of a motion, in its units: singular at a fold."""
    assert motion.jacobian is not None
    return motion.jacobian * size / size[:, None] - jnp.eye(size.size)


def _fold(system, frame, times, unknown, jacobian, error, is_ratio) -> Fold:
    return _read(exact_path(system, is_ratio), frame, times, unknown, jacobian, error)


@compiled(lightly=True)
def _read(path: FrequencyPath, frame, times, unknown, jacobian, error) -> Fold:
    good = error < SOLVED

    def newton(carry, _):
        unknown, times = carry
        out, times = _condition(path, frame, times, unknown)
        return (unknown - jnp.linalg.solve(jacobian, jnp.where(good, out, 0.0)), times), None

    # As for a periodic response: steps from the solution make its derivatives.
    (unknown, times), _ = lax.scan(newton, (unknown, times), length=TO_SECOND)
    value = unknown[-1]
    tables = path.tables(value)
    orbit = Orbit(unknown[:-1] * frame.size, times)
    motion = follow_events(tables, frame.events, orbit, 1)
    reading = read_motion(tables, frame.events, motion, 1)
    assert path.phases is not None
    reference, _ = path.drive.reference
    found = good & reading.ordered & (reading.breach <= 1e-7 * jnp.max(jnp.abs(path.phases.gap)))
    lost = jnp.where(found, 0.0, jnp.nan)
    return Fold(
        parameter=value + lost,
        amplitude_ratio=(reading.highest - reading.lowest) / 2 / reference + lost,
        contact_force=reading.contact_force + lost,
        initial_state=reading.initial_state,
        found=found,
    )


@compiled
def _search(path: FrequencyPath, state, value) -> Any:
    """Newton's method on motion, frequency and singularity; no derivatives."""
    assert path.phases is not None
    events, (start, times), _ = sampled_guess(path, value, state, 1)
    size = jnp.linalg.norm(start * path.phases.weight) / path.phases.weight
    unknown = jnp.append(start / size, value)

    # Bordered by the singular vectors of the first matrix, the measure is well scaled.
    first = follow_events(path.tables(value), events, Orbit(start, times), 1, with_jacobian=True)
    left, _, right = jnp.linalg.svd(_still(first, size))
    frame = _Frame(events, size, jnp.stack([left[:, -1], right[-1]]))

    def newton(carry):
        unknown, times, _, _, rounds = carry

        def condition(u):
            out, times_there = _condition(path, frame, times, u)
            return out, (out, times_there)

        jacobian, (out, times) = jax.jacfwd(condition, has_aux=True)(unknown)
        change = jnp.linalg.solve(jacobian, -out)
        length = jnp.max(jnp.abs(change))
        change = change * jnp.minimum(1.0, 0.1 / jnp.where(length > 0, length, 1.0))
        error = jnp.maximum(jnp.max(jnp.abs(out[:-1])), length)
        return unknown + change, times, jacobian, error, rounds + 1

    def goes_on(carry):
        *_, error, rounds = carry
        return (error > DONE) & (rounds < STEPS)

    n = unknown.size
    carry = unknown, times, jnp.zeros((n, n)), jnp.asarray(jnp.inf), 0
    unknown, times, jacobian, error, _ = lax.while_loop(goes_on, newton, carry)
    return frame, times, unknown, jacobian, error
