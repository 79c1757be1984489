"""Folds, period doublings, Neimark-Sacker points and first touches of a balanced branch.

They are found between points of the branch; touches are solved for exactly.
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from vibrojax._tools.compiled import compiled
from vibrojax.branches.points import SpecialPoint
from vibrojax.branches.readings import Columns
from vibrojax.steady.batches import in_batches
from vibrojax.steady.condensed import receptance
from vibrojax.steady.paths import AbstractPath, FrequencyPath, localise


def special_points(
    paths: AbstractPath, columns: list[Columns], period: int
) -> list[tuple[SpecialPoint, ...]]:
    """Find the special points of balanced branches."""
    points: list[tuple[SpecialPoint, ...]] = []
    for k, own in enumerate(columns):
        found = []
        for kind, at in _brackets(own["values"], own["floquet_multipliers"]):
            both = own["floquet_multipliers"][at : at + 2]
            if kind != "neimark_sacker" or on_circle(both, 0.1, 1e-3).any():
                found.append(_unrefined(kind, at, own))
        if period == 1 and len(own["values"]):
            found += _first_touches(paths, k, own["values"], own["contact_fraction"] > 0)
        points.append(tuple(sorted(found, key=lambda p: p.after)))
    return points


def doubling_test(
    multipliers: Complex[np.ndarray, "... states"],
) -> Float[np.ndarray, "..."]:
    """Zero where a multiplier is -1."""
    return np.asarray(np.prod(1 + multipliers, axis=-1).real)


def torus_test(multipliers: Complex[np.ndarray, "... states"]) -> Float[np.ndarray, "..."]:
    """Zero where two multipliers have the product 1, as a pair on the unit circle has."""
    i, j = np.triu_indices(multipliers.shape[-1], 1)
    return np.prod(1 - multipliers[..., i] * multipliers[..., j], axis=-1).real


def on_circle(
    multipliers: Complex[np.ndarray, "... states"], near: float = 1e-3, turned: float = 1e-4
) -> Bool[np.ndarray, "..."]:
    """Whether a complex pair is on the unit circle, near enough to be no real pair."""
    close = np.abs(np.abs(multipliers) - 1) < near
    return np.asarray(np.any(close & (np.abs(np.imag(multipliers)) > turned), axis=-1))


def _brackets(parameter: np.ndarray, multipliers: np.ndarray) -> list[tuple[str, int]]:
    """Find between which points of a branch special ones lie.

    Returns their kinds, and indices: of the middle point (fold), or of the first of the two.
    """
    if len(parameter) < 3:
        return []
    found, step = [], np.diff(parameter)
    # A fold turns the parameter round; steps of round-off turn nothing.
    size = 1e-11 * np.max(np.abs(parameter), initial=0.0)
    moving = np.flatnonzero(np.abs(step) > size)
    for before, after in pairwise(moving):
        if step[before] * step[after] < 0:
            found.append(("fold", int(after)))
    for kind, test in (("period_doubling", doubling_test), ("neimark_sacker", torus_test)):
        value = test(multipliers)
        for i in np.flatnonzero(value[:-1] * value[1:] < 0):
            found.append((kind, int(i)))
    return found


def _unrefined(kind: str, at: int, columns: Columns) -> SpecialPoint:
    """Point of a balanced branch: the vertex of a parabola, or the middle of a step."""
    values = columns["values"]
    if kind == "fold":
        parameter = parabola_vertex(*values[at - 1 : at + 2].tolist())
    else:
        parameter = (values[at] + values[at + 1]) / 2
    return SpecialPoint(
        kind,
        float(parameter),
        float(columns["amplitude_ratio"][at]),
        float(columns["contact_force"][at]),
        columns["initial_state"][at],
        after=at,
        refined=False,
    )


def parabola_vertex(before: float, middle: float, after: float) -> float:
    """Return the extreme of the parabola through three values at equal distances."""
    bend = before - 2 * middle + after
    return middle - (after - before) ** 2 / (8 * bend) if bend else middle


class Touch(NamedTuple):
    """Where the contact-free motion just reaches a stop."""

    parameter: Float[Array, ""]
    amplitude_ratio: Float[Array, ""]
    found: Bool[Array, ""]


def touch_near(path: AbstractPath, parameter: Float[Array, ""]) -> Touch:
    """Solve for the touch near a parameter by Newton's method; differentiable in the path."""

    def clearance(p):
        place = path.at(p)
        zero = jnp.zeros_like(place.angular_frequency)
        amplitude = place.drive.complex_amplitude(place.angular_frequency, zero)
        table = receptance(place.equations, place.angular_frequency[None])
        reach = jnp.abs(amplitude * table.stop_from_input[:, 0])
        gaps = jnp.stack([jnp.asarray(s.gap, float) for s in place.equations.stops])
        return jnp.min((gaps - reach) / gaps)

    def newton(_, p):
        value, slope = jax.jvp(clearance, (p,), (jnp.ones_like(p),))
        return p - jnp.clip(value / jnp.where(slope == 0, 1.0, slope), -0.02, 0.02)

    p = jax.lax.fori_loop(0, 12, newton, parameter)
    place = path.at(p)
    table = receptance(place.equations, place.angular_frequency[None])
    force = place.drive.complex_amplitude(place.angular_frequency, jnp.zeros_like(p))
    reference, _ = place.drive.reference
    amplitude = jnp.abs(force * table.response_from_input[0]) / reference
    return Touch(p, amplitude, jnp.abs(clearance(p)) < 1e-9)


@compiled
def _touches_near(paths: AbstractPath, near: Float[Array, " touches"]) -> Touch:
    return jax.vmap(touch_near)(paths, near)


def _first_touches(
    paths: AbstractPath, lane: int, parameter: np.ndarray, touching: np.ndarray
) -> list[SpecialPoint]:
    """Find where flight and contact meet along a branch."""
    change = np.flatnonzero(touching[:-1] != touching[1:])
    if not len(change):
        return []
    paths, near = jax.device_get(paths), parameter[np.where(touching[change], change + 1, change)]

    def touch(i):
        here = localise(paths, np.full(len(i), lane), near[i], False)
        return _touches_near(here, jnp.asarray(near[i]))

    touches = in_batches(touch, len(change))
    # A path other than that of the frequency is only known to first order near a value.
    for _ in range(0 if isinstance(paths, FrequencyPath) else 3):
        near = touches.parameter
        touches = in_batches(touch, len(change))
    rows = zip(change.tolist(), *map(np.ndarray.tolist, touches), strict=True)
    return [SpecialPoint("grazing", p, a, 0.0, None, i, True) for i, p, a, good in rows if good]
