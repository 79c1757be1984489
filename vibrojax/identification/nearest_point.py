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
from vibrojax.steady.condensed import (
    balance,
    condensed_problem,
    differentiate,
    solve_condensed,
)
from vibrojax.steady.paths import FrequencyPath, Place

lax = jax.lax

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

    `slopes` holds the derivatives of the paths, with the numbers sought as the second axis; `scale`
    is the change of frequency that counts as much as a motion changing by its size, `rounds` the
    most that are gone through, `close` the step at which no further one is needed: distances are
    then off by its square, derivatives by itself.
    """
    samples = 2 * (depth.shape[-1] - 1)
    number = jax.tree.leaves(slopes)[0].shape[1]

    def see(phase, place, problem, force, depth):
        return seen_from(sensor, observe(sensor, place, problem, force, depth), phase, jnp)

    def linearise(path, slopes, phase, depth, frequency):
        place = Place(path.equations, path.drive, frequency * path.unit)

        def at(place):
            problem = condensed_problem(
                place.equations, place.drive, place.angular_frequency, samples=samples
            )
            per_second = samples * place.angular_frequency / (2 * jnp.pi)
            here = balance(problem, depth, per_second, samples)
            channels = see(phase, place, problem, here.force, depth)
            return (here.residual, channels), (here, problem)

        # How the place moves with the frequency, then with the numbers.
        equations, drive = jax.tree.map(jnp.zeros_like, (path.equations, path.drive))
        ways = jax.tree.map(
            lambda zero, rows: jnp.concatenate([zero[None], rows]),
            Place(equations, drive, path.unit),
            Place(slopes.equations, slopes.drive, frequency * slopes.unit),
        )
        (residual, channels), linear, (here, problem) = jax.linearize(at, place, has_aux=True)
        by_way, seen = jax.vmap(linear)(ways)
        right = -jnp.concatenate([residual[None], by_way])
        return place, problem, here, right, channels, seen

    def advance(target, depth, frequency, last, place, problem, here, solved, channels, seen):
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

        def looks(change):
            """Change of the channels with the motion."""
            both = jnp.stack([change, differentiate(change, samples)])
            value, rate = jnp.fft.irfft(both, samples)
            force = jnp.fft.rfft(here.stiffness * value + here.damping * rate)
            return jax.jvp(
                lambda d, f: see(target.phase, place, problem, f, d),
                (depth, here.force),
                (change, force),
            )[1]

        rows = jax.vmap(looks)(changes) + seen[0] * shifts[:, None]
        rows = rows.at[1:-1].add(seen[1:])

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
        return (
            depth + across[0] + step * changes[-1],
            frequency + shifts[0] + step * unit,
            newton,
            way,
            step,
            # As it will be after this step, to first order.
            residual - lines[0] - way * line,
            derivative,
        )

    def turn(carry):
        k, depth, frequency, last = carry[:4]
        # In the last round what did not get there goes back to its guess.
        lost = (k == rounds) & ~(last.newton < CONVERGED)
        depth = jnp.where(lost[:, None, None], guess[0], depth)
        frequency = jnp.where(lost, guess[1], frequency)
        place, problem, here, right, channels, seen = jax.vmap(linearise)(
            paths, slopes, target.phase, depth, frequency
        )
        touching = (here.stiffness != 0) | (here.damping != 0)
        needed = jnp.max(jnp.sum(touching, axis=(1, 2)))
        level = jnp.searchsorted(jnp.asarray(sizes), needed)
        solved = lax.switch(level, solvers, problem, here, right)
        depth, frequency, newton, way, step, *rest = jax.vmap(advance)(
            target, depth, frequency, last, place, problem, here, solved, channels, seen
        )
        there = Nearest(newton, way, step, ~lost, *rest)
        return k + 1, depth, frequency, there

    unknowns = depth.shape[1] * samples
    sizes = (*(unknowns * k // 16 for k in (1, 5, 9)), unknowns)
    solvers = [
        jax.vmap(lambda p, a, r, size=size: solve_condensed(p, a, r, samples, size))
        for size in sizes
    ]

    def unfinished(carry):
        return (carry[0] <= rounds) & ~jnp.all(settled(carry[3], close))

    points, size = frequency.shape[0], 1 + sensor.channels
    guess = (depth, frequency)
    far = jnp.full(points, jnp.inf)
    first = Nearest(
        newton=far,
        way=far,
        step=jnp.zeros(points),
        found=jnp.zeros(points, bool),
        residual=jnp.zeros((points, size)),
        derivative=jnp.zeros((points, size, number)),
    )
    return lax.while_loop(unfinished, turn, (0, depth, frequency, first))[3]
