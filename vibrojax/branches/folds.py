"""Folds of exact periodic motions: where the response jumps, with derivatives.

A fold is a periodic motion whose period map has a multiplier of 1. The motion, the frequency and
the condition are solved together, so that the frequency of the fold is a function of the numbers of
the system and can be differentiated.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.described import shown_value
from vibrojax._tools.signatures import validated
from vibrojax.branches.points import SpecialPoint
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.steady.contact_times import Events, Orbit, follow_events
from vibrojax.steady.exact_point import sampled_guess
from vibrojax.steady.implicit import frozen, with_columns
from vibrojax.steady.orbit_reading import read_motion
from vibrojax.steady.paths import FrequencyPath, frequency_path
from vibrojax.stepping.choice import is_exact

lax = jax.lax

STEPS = 12
SOLVED = 1e-8


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
    reverse mode (implicitly, on the condition of the fold), and mapped with `jax.vmap`.

    Parameters:
        system: a system with linear stops (KelvinVoigt without smoothing).
        near: a fold of `Branch.special_points`, or of this function.
        axis: unit of the frequency, `frequency_ratio` or `frequency` (Hz), as of the branch.

    Raises `ValueError` for a system whose stops are not linear, another axis, or a special point
    that is no fold with contact.
    """
    if axis not in ("frequency_ratio", "frequency"):
        raise ValueError(f"axis must be 'frequency_ratio' or 'frequency', got {axis!r}.")
    if not is_exact(system):
        raise ValueError("fold_response needs linear stops without smoothing (KelvinVoigt).")
    if isinstance(near, SpecialPoint) and (near.kind != "fold" or near.initial_state is None):
        raise ValueError(f"near must be a fold with contact, got {near!r}.")
    state = frozen(jnp.asarray(near.initial_state, float))
    value = frozen(jnp.asarray(near.parameter, float))
    arrays, is_ratio = as_arrays(system), axis == "frequency_ratio"
    found = _search(frozen(arrays), state, value, is_ratio)
    return with_columns(_fold, arrays, *found, is_ratio)


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

    def end(x):
        orbit = Orbit(x * frame.size, times)
        motion = follow_events(path.tables(p), frame.events, orbit, 1, twice=True)
        return motion.end / frame.size, motion

    matrix, motion = jax.jacfwd(end, has_aux=True)(x)
    after = motion.end / frame.size
    left, right = frame.border
    n = x.size
    bordered = jnp.block([[matrix - jnp.eye(n), left[:, None]], [right[None], jnp.zeros((1, 1))]])
    measure = jnp.linalg.solve(bordered, jnp.zeros(n + 1).at[-1].set(1.0))[-1]
    return jnp.append(after - x, measure), motion.times


@compiled
def _fold(system, frame, times, unknown, jacobian, error, is_ratio) -> Fold:
    path = frequency_path(system, is_ratio, True)
    out, _ = _condition(path, frame, times, unknown)
    good = error < SOLVED
    unknown = unknown - jnp.linalg.solve(jacobian, jnp.where(good, out, 0.0))
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
def _search(system, state, value, is_ratio) -> Any:
    """Newton's method on motion, frequency and singularity; no derivatives."""
    path = frequency_path(system, is_ratio, True)
    assert path.phases is not None
    events, (start, times), _ = sampled_guess(path, value, state, 1)
    size = jnp.linalg.norm(start * path.phases.weight) / path.phases.weight
    unknown = jnp.append(start / size, value)
    blank = jnp.zeros((2, start.size))
    frame = _Frame(events, size, blank)

    # Bordered by the singular vectors of the first matrix, the measure is well scaled.
    def first_matrix(x):
        orbit = Orbit(x * size, times)
        return follow_events(path.tables(value), events, orbit, 1).end / size

    matrix = jax.jacfwd(first_matrix)(unknown[:-1])
    left, _, right = jnp.linalg.svd(matrix - jnp.eye(start.size))
    frame = frame._replace(border=jnp.stack([left[:, -1], right[-1]]))

    def newton(carry, last):
        unknown, times, _, _ = carry

        def condition(u):
            return _condition(path, frame, times, u)

        jacobian, now = jax.jacfwd(condition, has_aux=True)(unknown)
        out, _ = condition(unknown)
        change = jnp.linalg.solve(jacobian, -out)
        length = jnp.max(jnp.abs(change))
        change = change * jnp.minimum(1.0, 0.1 / jnp.where(length > 0, length, 1.0))
        error = jnp.maximum(jnp.max(jnp.abs(out[:-1])), length)
        unknown = jnp.where(last, unknown, unknown + change)
        return (unknown, jnp.where(last, times, now), jacobian, error), None

    n = unknown.size
    carry = unknown, times, jnp.zeros((n, n)), jnp.asarray(jnp.inf)
    rounds = jnp.arange(STEPS + 1) == STEPS
    (unknown, times, jacobian, error), _ = lax.scan(newton, carry, rounds)
    return frame, times, unknown, jacobian, error
