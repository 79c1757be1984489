"""States of motion: what `initial_state=`, `guess=`, `start=` and `starts=` take.

A state is (q, q', memories of the stops), in the coordinates of the equations.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_range, concrete
from vibrojax._tools.warn import warn
from vibrojax.model.beam import Cantilever
from vibrojax.model.modes import Modes
from vibrojax.model.residual_shapes import CorrectedModes

Displacement = ArrayLike | Sequence[Any] | Mapping[Any, Any] | Callable[..., Any]
"""Displacements of a system: an array, or of a beam a function of x/L or numbers by place x/L."""
ABOUT_STATES = (
    "States are in the coordinates of the system, at drive phase 0: its state(displacement=..., "
    "velocity=...) makes one."
)
LOST = 0.1
"""Share of a displacement that modes may leave out before it is said."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)


def as_state(name: str, given: Any, equations: Any) -> Float[Array, " states"]:
    """Return a state as one array: from one, from (q, q') or (q, q', internal), or a response.

    Internal states that are left out are at rest. Raises `ValueError` for another shape, or values
    that are not finite.
    """
    n, size = equations.size, equations.state_size
    held = size - 2 * n - getattr(equations, "idle_size", 0)  # equations of one's own have none
    given = getattr(given, "initial_state", given)  # of a PeriodicResponse or a point of a branch
    shown, state = repr(given), None
    try:
        rows = isinstance(given, list | tuple) or getattr(given, "ndim", 1) == 2
        several = rows and len(given) in (2, 3)
        parts = [jnp.asarray(part, float) for part in (given if several else (given,))]
        shapes = [part.shape for part in parts]
        if several and shapes[0]:
            shown = f"shapes {shapes}"
            if shapes[:2] == [(n,), (n,)] and shapes[2:] in ([], [(held,)], [(size - 2 * n,)]):
                state = jnp.concatenate(parts)
        else:
            state = jnp.stack(parts) if several else parts[0]
            shown = f"an array of shape {state.shape}"
    except (TypeError, ValueError, OverflowError):
        state = None
    if state is None or state.shape not in ((size,), (2 * n + held,), (2 * n,)):
        memories = f", and the internal states, shape ({held},)" * (held > 0)
        raise ValueError(
            f"{name} must be q and q' of shape ({n},) each{memories}, or a state (q, q') of shape "
            f"({size},), got {shown}. The system's state(displacement=..., velocity=...) makes one."
        )
    values = concrete(state)
    if values is not None and not np.isfinite(values).all():
        at = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ValueError(f"{name} must hold finite numbers, got {values[at]} at index {at}.")
    return jnp.concatenate([state, jnp.zeros(size - state.size)])


def check_coordinates(name: str, given: Any, count: int, meaning: str) -> Float[Array, " n"]:
    """Return an array of so many numbers. Raises `ValueError` for anything else."""
    try:
        array = jnp.asarray(given, float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be {meaning}, shape ({count},), got {given!r}.") from None
    if array.shape != (count,):
        raise ValueError(
            f"{name} must be {meaning}, shape ({count},), got an array of shape {array.shape}."
        )
    return array


def beam_coordinates(
    beam: Cantilever, free: Modes | CorrectedModes, displacement: Displacement
) -> Float[Array, " modes"]:
    """Return the modal coordinates, m, of a displacement of a beam; see `ImpactingBeam`."""
    if callable(displacement):
        return _projected(beam, free, displacement)
    if isinstance(displacement, Mapping):
        return _fitted(free, displacement)
    raise ValueError(
        "displacement must be a function of x/L, or a dict of numbers by place x/L such as "
        f"{{0.5: 1e-3, 1.0: 3e-3}}, got {displacement!r}. From a static deflection a motion starts "
        "by release=."
    )


def _projected(
    beam: Cantilever, free: Modes | CorrectedModes, displacement: Callable[..., Any]
) -> Array:
    """Project a function of x/L on the modes, with the mass of the beam and all masses on it."""
    low, length = free.knots[:-1], jnp.diff(free.knots)
    places = (low[:, None] + length[:, None] * (1 + NODES) / 2).reshape(-1)
    density = (length[:, None] * WEIGHTS / 2).reshape(-1) * (1 - beam.taper * places)
    points = beam.point_masses
    masses = [jnp.asarray(point.mass) / beam.reference_mass for point in points]
    weight = jnp.concatenate([density, jnp.stack([jnp.asarray(beam.mass_ratio), *masses])])
    ends = jnp.stack([jnp.ones(()), *(jnp.asarray(point.position, float) for point in points)])
    places = jnp.concatenate([places, ends])
    values = _values(displacement, places)
    q = free.shape(places).T @ (weight * values)
    size = jnp.sum(weight * values**2)
    _warn_of_loss(size, size - jnp.sum(q**2), free.num_modes)
    return q


def _values(displacement: Callable[..., Any], places: Array) -> Array:
    try:
        values = jnp.asarray(displacement(places), float)
    except (TypeError, ValueError):  # a function of single numbers only
        values = jnp.stack([jnp.asarray(displacement(float(s)), float) for s in places])
    if values.shape not in ((), places.shape):
        raise ValueError(
            f"displacement must return one number for every place x/L, shape {places.shape}, got "
            f"an array of shape {values.shape}."
        )
    values = jnp.broadcast_to(values, places.shape)
    check_range("displacement", values, allowed="a finite number at every place x/L")
    return values


def _fitted(free: Modes | CorrectedModes, displacement: Mapping[Any, Any]) -> Array:
    """Fit the modes to displacements at some places, by least squares."""
    places = jnp.asarray(list(displacement), float)
    shapes = free.shape(places)
    known = concrete(shapes)
    rank = len(places) if known is None else int(np.linalg.matrix_rank(known, rtol=1e-6))
    if rank < free.num_modes:
        raise ValueError(
            f"displacement is given at {len(places)} places, too few or too close to each other "
            f"for {free.num_modes} modes. Give more, or a function of x/L; from a static "
            "deflection a motion starts by release=."
        )
    values = jnp.stack([jnp.asarray(v, float) for v in displacement.values()])
    check_range("displacement", values, allowed="a finite number at every place x/L")
    orthogonal, triangle = jnp.linalg.qr(shapes)
    q = jnp.linalg.solve(triangle, orthogonal.T @ values)
    _warn_of_loss(jnp.sum(values**2), jnp.sum((values - shapes @ q) ** 2), free.num_modes)
    return q


def _warn_of_loss(size: Array, lost: Array, modes: int) -> None:
    numbers = concrete(size), concrete(lost)
    if numbers[0] is None or numbers[1] is None or not numbers[0] > 0:
        return
    share = float(np.sqrt(max(numbers[1], 0.0) / numbers[0]))
    if share > LOST:
        warn(
            f"The {modes} modes of the model leave out {100 * share:.0f} % of this displacement "
            "(rms). Keep more modes, or give what a clamped beam can take."
        )
