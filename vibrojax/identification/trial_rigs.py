"""Trial rigs, many at a time: their paths, what a sensor sees of them, and their curves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.types import AnyArray
from vibrojax.branches.along import check_equations
from vibrojax.branches.tracing import free_motion
from vibrojax.ensemble.slopes import WithSlopes, systems_with_slopes, with_slopes
from vibrojax.identification.record_numbers import RecordedBy, record_numbers_in
from vibrojax.identification.sensor import observe
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.condensed import balance, condensed_problem
from vibrojax.steady.paths import FrequencyPath, Place

SAMPLES = 128
WIDTHS = (8,)
"""Rigs that are made side by side."""


class Curve(NamedTuple):
    """A traced curve as a sensor sees it."""

    frequency: np.ndarray
    channels: np.ndarray
    depth: np.ndarray
    continues: np.ndarray
    """Whether the next point continues this one."""
    drive: np.ndarray | None = None
    """Drive amplitude of every point, as it was measured; None: that of the rig."""

    def at_drive(self, amplitude: float) -> "Curve":
        """Return the part that was traced at about this drive amplitude."""
        if self.drive is None or not len(self.drive):
            return self
        nearest = self.drive[np.argmin(np.abs(self.drive - amplitude))]
        own = self.drive == nearest
        return Curve(*(column[own] for column in self if column is not None))

    def turning(self, direction: int) -> np.ndarray:
        """Whether each point is a fold at which a sweep in this direction (1 or -1) jumps."""
        before, after = np.roll(self.frequency, 1), np.roll(self.frequency, -1)
        joined = self.continues & np.roll(self.continues, 1)
        beyond = direction * (self.frequency - np.stack([before, after]))
        return joined & np.all(beyond > 0, axis=0)

    @property
    def unstable(self) -> np.ndarray:
        """Whether each point lies on the way back behind a fold.

        A part that leads from one end of the range to the same one began with stable motions.
        """
        frequency = self.frequency
        if len(frequency) < 2:
            return np.zeros(len(frequency), bool)
        change = np.append(np.diff(frequency), 0.0)
        change[~self.continues] = np.append(0.0, change)[:-1][~self.continues]
        forth = np.full(len(frequency), np.sign(frequency[-1] - frequency[0]))
        (stops,) = np.nonzero(~self.continues)
        for first, last in zip([0, *(stops[:-1] + 1)], stops, strict=False):
            ends = frequency[[first, last]]
            if np.isclose(ends[:, None], [frequency.min(), frequency.max()]).any(axis=1).all():
                way = change[first] if np.isclose(*ends) else ends[1] - ends[0]
                forth[first : last + 1] = np.sign(way)
        return change * forth < 0


def together(curves: Sequence[Curve], drive: np.ndarray) -> Curve:
    """Return curves that were traced at some drive amplitudes as one."""
    columns = zip(*(curve[:4] for curve in curves), strict=True)
    counts = [len(curve.frequency) for curve in curves]
    return Curve(*map(np.concatenate, columns), drive=np.repeat(drive, counts))


@dataclass(frozen=True)
class Maker:
    """What makes trial rigs: the user's function, the numbers sought and those held."""

    make: Callable[..., AbstractSystem]
    names: tuple[str, ...]
    fixed: dict[str, Any]
    static: dict[str, Any]

    def trials(
        self, read: Callable[..., Any], how: Any, values: np.ndarray, *own: Any
    ) -> WithSlopes:
        """What `read(system, how, *own)` makes of the rigs with these values (lanes by names)."""
        numbers = {n: jnp.full(len(values), v) for n, v in self.fixed.items()}
        numbers |= dict(zip(self.names, np.asarray(values, float).T, strict=True))
        apart = record_numbers_in(self.make, self.names)
        make: Any = RecordedBy(self.make, apart) if apart else self.make
        made, slopes = jax.device_get(systems_with_slopes(make, self.static, self.names, numbers))
        # What is the same in all rigs, as the modes of a beam whose stop is sought, is read once.
        moves = jax.tree.map(lambda a, b: bool(np.any(b) or np.any(a != a[:1])), made, slopes)
        if not any(jax.tree.leaves(moves)):
            moves = True
        moving, still = eqx.partition(made, moves)
        still = jax.tree.map(lambda a: a[0], still)
        return _read(read, how, still, moving, eqx.filter(slopes, moves), own)

    def system(self, values: Any) -> AbstractSystem:
        """Make one rig."""
        numbers = dict(zip(self.names, values, strict=True))
        for name in record_numbers_in(self.make, self.names):
            del numbers[name]
        return self.make(**self.static, **self.fixed, **numbers)


@compiled(lightly=True)
def _read(read, how, still, moving, slopes, own) -> WithSlopes:
    def one(moving, slopes, own):
        return with_slopes(lambda m: read(eqx.combine(m, still), how, *own), moving, slopes)

    return jax.vmap(one)(moving, slopes, own)


def frequency_path(system: AbstractSystem, is_ratio: bool) -> FrequencyPath:
    """Path of a rig along the drive frequency. Raises `ValueError` where it cannot be followed."""
    equations = system.equations()
    check_equations(system, equations)
    linear = equations.linear_between_contacts
    assert linear is not None  # just checked
    return FrequencyPath(linear, system.drive, linear.drive_unit(is_ratio), None)


class LevelPath(FrequencyPath):
    """Along the drive frequency at a velocity or acceleration of the base that stays the same."""

    level: Float[AnyArray, "..."]
    """Its amplitude, m/s or m/s2."""
    order: int = eqx.field(static=True)
    """Which derivative of the displacement it is."""

    def at(self, parameter: Float[Array, ""]) -> Place:
        """Return the same system at another frequency, the displacement of the base with it."""
        place = super().at(parameter)
        amplitude = self.level / place.angular_frequency**self.order
        return Place(place.equations, place.drive.with_amplitude(amplitude), parameter * self.unit)


def at_level(paths: FrequencyPath, amplitude: np.ndarray, order: int) -> FrequencyPath:
    """Return the paths of some lanes at other drive amplitudes (lanes).

    They are those of the `order`-th derivative of what drives the rig.
    """
    if order == 0:
        return driven(paths, amplitude)
    return LevelPath(paths.equations, paths.drive, paths.unit, None, amplitude, order)


def driven(paths: FrequencyPath, amplitude: np.ndarray) -> FrequencyPath:
    """Return the paths of some lanes at other drive amplitudes (lanes), m or N."""
    return eqx.tree_at(lambda p: p.drive, paths, paths.drive.with_amplitude(amplitude))


def driven_as_measured(lanes: WithSlopes, amplitude: np.ndarray) -> WithSlopes:
    """Return paths at other drive amplitudes, which change with no number."""
    still = jax.tree.map(lambda _: None, lanes.slopes.drive)
    slopes = eqx.tree_at(lambda p: p.drive, lanes.slopes, still)
    return WithSlopes(driven(lanes.made, amplitude), slopes)


@compiled
def observe_points(paths, sensor, depth, frequency):
    """Channels of a sensor for some motions, each of its own path."""
    samples = 2 * (depth.shape[-1] - 1)

    def one(path, depth, frequency):
        place = path.at(frequency)
        problem = condensed_problem(place, samples=samples)
        return observe(sensor, place, problem, balance(problem, depth).force, depth)

    return jax.vmap(one)(paths, depth, frequency)


@compiled
def free_and_touching(paths, frequency):
    """Motions without contact, and whether they reach a stop."""
    depth = free_motion(paths, frequency, SAMPLES, 1)
    return depth, jnp.any(jnp.fft.irfft(depth, SAMPLES) > 0, axis=(1, 2))
