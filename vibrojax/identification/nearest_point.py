"""The point of a response curve nearest to a measured one, with its derivatives.

The curve is that of the condensed balance along the drive frequency. From a guess on it, every
round solves the linearised balance once: Newton's correction puts the motion on the curve, the
tangent of the curve takes it to where the measured point is nearest, and the same factors give
the derivatives in the numbers that are sought.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.branches.continuation import dot
from vibrojax.identification.sensor import Sensor, observe, seen_from
from vibrojax.steady.condensed import balance, condensed_problem, solve_lanes
from vibrojax.steady.paths import FrequencyPath, Place

lax = jax.lax

WIDTH = 32
"""Points in one loop: few, as all go on until the last is there, and what is in hand is near."""
LONGEST = 0.05
"""Longest step along the curve in one round, in the arclength of the continuation."""
CONVERGED = 1e-3
"""Newton correction, over the size of the motion, from which what is left counts in squares."""


class Target(NamedTuple):
    """A measured point, and the lengths by which distances from it are divided."""

    frequency: Float[AnyArray, "..."]
    channels: Float[AnyArray, "... channels"]
    frequency_scale: Float[AnyArray, "..."]
    deviation: Float[AnyArray, "... channels"]
    phase: Float[AnyArray, "..."] | None = None
    """Phase (rad) from which the channels are seen; None where none is measured."""


class Nearest(NamedTuple):
    """The nearest point of a curve, and what the last round still did to find it."""

    newton: Float[Array, " points"]
    way: Float[Array, " points"]
    step: Float[Array, " points"]
    found: Bool[Array, " points"]
    """Whether it is on the curve; else the guess itself stands here."""
    residual: Float[Array, "points coordinates"]
    """Measured minus nearest, in units of the scales: frequency first, then the channels."""
    derivative: Float[Array, "points coordinates numbers"]
    """Of the residual in the numbers sought, the nearest point following."""
    depth: Complex[Array, "points stops harmonics"]
    frequency: Float[Array, " points"]
    depth_slope: Complex[Array, "points numbers stops harmonics"]
    """Derivative of the motion in the numbers, and of its frequency: where the point goes."""
    frequency_slope: Float[Array, "points numbers"]


def settled(nearest: Any, close: Any) -> Any:
    """Whether further rounds would not move a point."""
    return (nearest.newton < close) & (abs(nearest.way) < close)


@compiled
def nearest_points(
    paths: FrequencyPath,
    slopes: FrequencyPath,
    target: Target,
    depth: Complex[AnyArray, "points stops harmonics"],
    frequency: Float[AnyArray, " points"],
    sensor: Sensor,
    *,
    scale: float,
    rounds: int | Int[Array, ""],
    close: float | Float[Array, ""],
) -> Nearest:
    """Find the nearest points of many curves from guesses on them.

    `slopes` holds the derivatives of the paths, with the numbers sought as the second axis, and
    None for what no number changes; `scale` is the change of frequency that counts as much as a
    motion changing by its size, `rounds` the most that are gone through, `close` the step at which
    no further one is needed: distances are then off by its square, derivatives by itself.
    """
    samples = 2 * (depth.shape[-1] - 1)
    number = jax.tree.leaves(slopes)[0].shape[1]
    still = jnp.zeros(number)

    def at(path, slopes, phase, depth, frequency, numbers):
        """Residual of the balance and what a sensor sees, the numbers changed by so much."""
        path = jax.tree.map(
            lambda slope, value: (
                value if slope is None else value + jnp.tensordot(numbers, slope, 1)
            ),
            *(slopes, path),
            is_leaf=lambda leaf: leaf is None,
        )
        place = Place(path.equations, path.drive, frequency * path.unit)
        problem = condensed_problem(place, samples=samples)
        here = balance(problem, depth)
        channels = observe(sensor, place, problem, here.force, depth)
        return here.residual, seen_from(sensor, channels, phase, jnp), (problem, here)

    def linearise(path, slopes, phase, depth, frequency):
        def of(depth, frequency, numbers):
            return at(path, slopes, phase, depth, frequency, numbers)

        # Few channels and many motions: backwards what is seen, forwards what is out of balance.
        channels, pull, (problem, here) = jax.vjp(
            lambda *now: of(*now)[1:], depth, frequency, still, has_aux=True
        )
        seen = jax.vmap(pull)(jnp.eye(channels.size))
        residual, by_frequency = jax.jvp(
            lambda f: of(depth, f, still)[0], (frequency,), (jnp.ones(()),)
        )
        by_number = jax.vmap(
            lambda way: jax.jvp(lambda n: of(depth, frequency, n)[0], (still,), (way,))[1]
        )(jnp.eye(number))
        right = -jnp.concatenate([jnp.stack([residual, by_frequency]), by_number])
        return problem, here, right, channels, seen

    def advance(target, depth, frequency, last, lost, solved, channels, seen):
        correction, direction, by_numbers = solved[0], solved[1], solved[2:]
        size2 = dot(depth, depth)
        length2 = dot(direction, direction) / size2 + 1 / scale**2
        unit = 1 / jnp.sqrt(length2)
        # Newton's correction and the change by each number, both across the curve.
        across = jnp.concatenate([correction[None], by_numbers])
        shifts = -jax.vmap(lambda change: dot(change, direction))(across) / size2 / length2
        across = across + direction * shifts[:, None, None]
        changes = jnp.concatenate([across, direction[None] * unit])
        shifts = jnp.append(shifts, unit)
        by_depth, by_frequency, by_number = seen
        rows = jnp.einsum("nak,cak->nc", changes, by_depth).real + shifts[:, None] * by_frequency
        rows = rows.at[1:-1].add(by_number.T)

        def scaled(frequencies, values):
            first = frequencies / target.frequency_scale
            return jnp.concatenate([first[..., None], values / target.deviation], axis=-1)

        lines = scaled(shifts, rows)
        residual = scaled(target.frequency - frequency, target.channels - channels)
        line = lines[-1]
        way = (residual - lines[0]) @ line / (line @ line)
        newton = jnp.sqrt(dot(across[0], across[0]) / size2 + (shifts[0] / scale) ** 2)
        # The curve bends, so a step falls short or goes too far by the same share as the last one.
        share = last.step / (last.way - way)
        share = jnp.where((share > 0.3) & (share < 4.0), share, 1.0)
        step = jnp.clip(way * share, -LONGEST, LONGEST)
        normal = line / jnp.linalg.norm(line)
        derivative = -lines[1:-1].T
        derivative = derivative - normal[:, None] * (normal @ derivative)
        follows = -(lines[1:-1] @ line) / (line @ line)
        return Nearest(
            newton=newton,
            way=way,
            step=step,
            found=~lost,
            # As it will be after this step, to first order.
            residual=residual - lines[0] - way * line,
            derivative=derivative,
            depth=depth + across[0] + step * changes[-1],
            frequency=frequency + shifts[0] + step * unit,
            depth_slope=across[1:] + follows[:, None, None] * changes[-1],
            frequency_slope=shifts[1:-1] + follows * unit,
        )

    def turn(carry):
        k, last = carry
        # In the last round what did not get there goes back to its guess.
        lost = (k == rounds) & ~(last.newton < CONVERGED)
        at_depth = jnp.where(lost[:, None, None], depth, last.depth)
        at_frequency = jnp.where(lost, frequency, last.frequency)
        problem, here, right, channels, seen = jax.vmap(linearise)(
            paths, slopes, target.phase, at_depth, at_frequency
        )
        solved = solve_lanes(problem, here, right, sizes)
        return k + 1, jax.vmap(advance)(
            target, at_depth, at_frequency, last, lost, solved, channels, seen
        )

    unknowns = depth.shape[1] * samples
    sizes = (*(unknowns * k // 16 for k in (1, 3, 6, 9)), unknowns)

    def unfinished(carry):
        return (carry[0] <= rounds) & ~jnp.all(settled(carry[1], close))

    points, size = frequency.shape[0], 1 + sensor.channels
    far = jnp.full(points, jnp.inf)
    first = Nearest(
        newton=far,
        way=far,
        step=jnp.zeros(points),
        found=jnp.zeros(points, bool),
        residual=jnp.zeros((points, size)),
        derivative=jnp.zeros((points, size, number)),
        depth=jnp.asarray(depth),
        frequency=jnp.asarray(frequency),
        depth_slope=jnp.zeros((points, number, *depth.shape[1:]), complex),
        frequency_slope=jnp.zeros((points, number)),
    )
    return lax.while_loop(unfinished, turn, (0, first))[1]
