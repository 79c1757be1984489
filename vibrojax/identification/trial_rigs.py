"""Trial rigs, many at a time: their paths, what a sensor sees of them, and their curves."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.branches.along import check_equations
from vibrojax.branches.tracing import free_motion
from vibrojax.identification.nearest_point import nearest_points
from vibrojax.identification.sensor import observe
from vibrojax.steady.condensed import balance, condensed_problem
from vibrojax.steady.paths import FrequencyPath, Place

SAMPLES = 128
WIDTHS = (8,)
"""Rigs that are followed side by side in one loop."""


class Curve(NamedTuple):
    """A traced curve as a sensor sees it."""

    frequency: np.ndarray
    channels: np.ndarray
    depth: np.ndarray
    continues: np.ndarray
    """Whether the next point continues this one."""
    completed: bool

    def turning(self, direction: int) -> np.ndarray:
        """Whether each point is a fold at which a sweep in this direction (1 or -1) jumps."""
        before, after = np.roll(self.frequency, 1), np.roll(self.frequency, -1)
        joined = self.continues & np.roll(self.continues, 1)
        beyond = direction * (self.frequency - np.stack([before, after]))
        return joined & np.all(beyond > 0, axis=0)

    @property
    def unstable(self) -> np.ndarray:
        """Whether each point lies on the way back between two folds."""
        if len(self.frequency) < 2:
            return np.zeros(len(self.frequency), bool)
        change = np.append(np.diff(self.frequency), 0.0)
        change[~self.continues] = np.append(0.0, change)[:-1][~self.continues]
        forth = np.sign(self.frequency[-1] - self.frequency[0])
        return change * forth < 0


class Lanes(NamedTuple):
    """Trial rigs: their paths and the derivatives of those in the numbers sought."""

    paths: FrequencyPath
    slopes: FrequencyPath


@eqx.filter_jit
def make_lanes(make, names, static, is_ratio, values, fixed):
    """Paths of the rigs with these values (rigs by names), and their derivatives in them."""

    def one(values, fixed):
        def build(values):
            system = make(**static, **fixed, **dict(zip(names, values, strict=True)))
            equations = system.equations()
            check_equations(system, equations)
            unit = equations.angular_frequency[0] if is_ratio else jnp.asarray(2 * jnp.pi)
            return FrequencyPath(equations, system.drive, unit, None)

        path = build(values)
        rows = jnp.eye(len(names))
        slopes = jax.vmap(lambda row: eqx.filter_jvp(build, (values,), (row,))[1])(rows)
        fill = lambda a, b: jnp.zeros((len(names), *jnp.shape(a))) if b is None else b  # noqa: E731
        return path, jax.tree.map(fill, path, slopes)

    return jax.vmap(one)(values, fixed)


@eqx.filter_jit
def observe_points(paths, sensor, depth, frequency):
    """Channels of a sensor for some motions, each of its own path."""
    samples = 2 * (depth.shape[-1] - 1)

    def one(path, depth, frequency):
        place = Place(path.equations, path.drive, frequency * path.unit)
        w = place.angular_frequency
        problem = condensed_problem(place.equations, place.drive, w, samples=samples)
        at = balance(problem, depth, samples * w / (2 * jnp.pi), samples)
        return observe(sensor, place, problem, at.force, depth, 1)

    return jax.vmap(one)(paths, depth, frequency)


def gaps_of(path: FrequencyPath) -> list[Any]:
    """Gaps of the stops."""
    return [stop.gap for stop in path.equations.stops]


find_nearest = eqx.filter_jit(nearest_points)


@eqx.filter_jit
def free_and_touching(paths, frequency):
    """Motions without contact, and whether they reach a stop."""
    depth = free_motion(paths, frequency, SAMPLES, 1)
    return depth, jnp.any(jnp.fft.irfft(depth, SAMPLES) > 0, axis=(1, 2))


def filled_up(lanes: int) -> np.ndarray:
    """Index of the lanes, the last one repeated up to a full width: one kernel for all numbers."""
    width = WIDTHS[-1]
    return np.minimum(np.arange(-(-lanes // width) * width), lanes - 1)
