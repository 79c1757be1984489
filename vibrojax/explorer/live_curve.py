"""A whole frequency response in a few hundredths of a second, for a slider that moves.

The branch is traced as `continue_response` does; its points are read off the balance and stay
there (1e-4 and better at 128 samples), in place of being made exact. Stability comes from the exact
propagators between the contact times of the balanced motion where stops are linear, else from
kicks.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.eigenvalues import eigenvalues
from vibrojax.branches.along import frequency_paths
from vibrojax.branches.continuation import Ending
from vibrojax.branches.over_range import scale_of, trace_over
from vibrojax.branches.special_points import parabola_vertex
from vibrojax.branches.tracing import Traced
from vibrojax.ensemble.lanes import stacked
from vibrojax.identification.sensor import Sensor, observe
from vibrojax.model.first_order import without_memory
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.balanced_motion import kicked_monodromy
from vibrojax.steady.batches import in_batches, take
from vibrojax.steady.condensed import (
    Balance,
    Problem,
    balance,
    cell_average,
    condensed_problem,
    differentiate,
    state_of,
)
from vibrojax.steady.contact_times import Orbit, follow_events, tables_of
from vibrojax.steady.orbit_reading import find_crossings
from vibrojax.steady.paths import FrequencyPath, Place
from vibrojax.stepping.measures import MOST_EVENTS

SAMPLES = 128
CONVERGED = (1e-3, 1e-4, 1e-8)
"""Relative Newton correction at which a point counts as found (what is left is about its square),
and where the next one is then not found."""
QUICK_HARMONICS = 12
MOST_QUICK_POINTS = 250
"""Points of a curve that may take no more than a tenth of a second."""
BATCH = 32
FINER = 4
"""How many times finer than the balance the waveform of an orbit is drawn."""


class LiveCurve(NamedTuple):
    """One branch along the drive frequency, in order of arclength."""

    frequency: Float[np.ndarray, " points"]
    """Ratio to the first natural frequency, or Hz."""
    response: Float[np.ndarray, " points"]
    """What the sensor shows."""
    contact_force: Float[np.ndarray, " points"]
    """Largest contact force, N."""
    leading_multiplier: Float[np.ndarray, " points"]
    direction: Float[np.ndarray, " points"]
    """Change of the frequency along the branch."""
    ending: Ending
    depth: Complex[np.ndarray, "points stops harmonics"]
    path: FrequencyPath
    """As one lane of a stack."""
    harmonics: int | None
    """Harmonics kept; None: all that the samples carry."""

    @property
    def stable(self) -> Bool[np.ndarray, " points"]:
        """Whether all Floquet multipliers lie inside the unit circle."""
        return self.leading_multiplier < 1.0

    @property
    def folds(self) -> list[tuple[int, float]]:
        """Where the branch turns round: index of the point, and frequency (parabola through 3)."""
        turns = np.flatnonzero(np.diff(np.sign(self.direction)) != 0)
        found = []
        for k in turns:
            way = np.sign(self.direction[k])
            at = int(k if way * self.frequency[k] >= way * self.frequency[k + 1] else k + 1)
            near = self.frequency[max(at - 1, 0) : at + 2].tolist()
            found.append((at, parabola_vertex(*near) if len(near) == 3 else near[-1]))
        return found


def _balanced_at(path: FrequencyPath, depth, frequency) -> tuple[Place, Problem, Balance]:
    """Place, condensed problem and balance of a motion with this spectrum of averaged depth."""
    place = path.at(frequency)
    problem = condensed_problem(place, samples=2 * (depth.shape[-1] - 1))
    return place, problem, balance(problem, depth)


def _contact_monodromy(path: FrequencyPath, place: Place, depth, force):
    """Jacobian of the period map between the contact times read off the waveform."""
    assert path.phases is not None
    samples = 2 * (depth.shape[-1] - 1)
    motion = depth / cell_average(samples, depth.shape[-1])
    value, change = jnp.fft.irfft(jnp.stack([motion, differentiate(motion, samples)]), samples)
    found = find_crossings(value, change, MOST_EVENTS, 1)
    events, w = found.events, place.angular_frequency
    state = state_of(place, force, events.section)
    tables, orbit = tables_of(path.phases, place.drive, w), Orbit(state, found.times)
    jacobian = follow_events(tables, events, orbit, 1, with_jacobian=True).jacobian
    assert jacobian is not None
    weight = path.phases.weight
    return jnp.where(found.number <= MOST_EVENTS, weight[:, None] * jacobian / weight, jnp.nan)


@compiled
def _glance(paths: FrequencyPath, depth, frequency, sensor: Sensor):
    """What the sensor shows, the largest force and the leading multiplier of some motions."""
    path = take(paths, 0)

    def one(depth, frequency):
        place, problem, at = _balanced_at(path, depth, frequency)
        shown, force = observe(sensor, place, problem, at.force, depth)
        if path.phases is None:
            matrix = kicked_monodromy(place, at, 1 / problem.per_second)
        else:
            matrix = _contact_monodromy(path, place, depth, at.force)
        return shown, force, jnp.max(jnp.abs(eigenvalues(matrix)))

    return jax.vmap(one)(depth, frequency)


class CurveTracer(eqx.Module):
    """From named numbers to a curve; compiled once for all of them.

    `make` makes the system from the numbers and from what is `fixed`.
    """

    make: Any = eqx.field(static=True)
    fixed: dict[str, Any]
    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    low: float
    high: float
    sensor: Sensor
    force: bool
    """Whether the contact force is what is drawn, in place of the first channel of the sensor."""
    exact: bool
    """Whether stops are linear, so that contact phases have propagators."""

    def system(self, numbers: dict[str, float]) -> AbstractSystem:
        """Return the system with these numbers."""
        return self.make(**self.fixed, **numbers)

    def __call__(self, numbers: dict[str, float]) -> LiveCurve:
        """Return the whole curve; one of no points where none is found at the low end."""
        return self._read(*self._trace(numbers, None, 2000), None)

    def quick(self, numbers: dict[str, float], winds: bool) -> LiveCurve:
        """Return the whole curve if it has few points, else a quick look with few harmonics.

        Between very stiff stops a curve winds through dozens of small folds, which few harmonics
        pass over. With `winds` that is expected, and the whole curve is not tried.
        """
        if not winds:
            path, traced = self._trace(numbers, None, MOST_QUICK_POINTS)
            if traced.ending is not Ending.running and len(traced.parameter) <= MOST_QUICK_POINTS:
                return self._read(path, traced, None)
        few = QUICK_HARMONICS
        return self._read(*self._trace(numbers, few, MOST_QUICK_POINTS), few)

    def _trace(
        self, numbers: dict[str, float], harmonics: int | None, max_points: int
    ) -> tuple[FrequencyPath, Traced]:
        systems = stacked([self.system(numbers)])
        path = frequency_paths(systems, self.axis == "frequency_ratio", self.exact)
        path = jax.device_get(path)
        traced = self._follow(path, 1, harmonics, max_points)
        if not len(traced.parameter):
            # Where contact is heavy at the low end, free motion is no guess; at the high end it is.
            back = self._follow(path, -1, harmonics, max_points)
            traced = back._replace(
                parameter=back.parameter[::-1],
                depth=back.depth[::-1],
                direction=-back.direction[::-1],
            )
        return path, traced

    def _follow(
        self, path: FrequencyPath, way: int, harmonics: int | None, max_points: int
    ) -> Traced:
        """Trace from the low end upwards (`way` 1) or from the high end downwards (-1)."""
        tried = []
        for tolerance in CONVERGED:
            tried += trace_over(
                path,
                np.array([self.low if way > 0 else self.high]),
                self.low,
                self.high,
                scale=scale_of(self.low, self.high, 1.0 if "ratio" in self.axis else np.inf),
                way=float(way),
                tolerance=tolerance,
                samples=SAMPLES,
                harmonics=harmonics,
                max_points=max_points,
            )
            lost = tried[-1].ending in (Ending.stuck, Ending.closed, Ending.turned_back)
            if not lost or not len(tried[-1].parameter):
                break
        return tried[-1]

    def _read(self, path: FrequencyPath, traced: Traced, harmonics: int | None) -> LiveCurve:
        count = len(traced.parameter)
        shown, force, leading = np.zeros((3, 0))
        if count:
            shown, force, leading = in_batches(
                lambda i: _glance(path, traced.depth[i], traced.parameter[i], self.sensor),
                count,
                BATCH,
            )
        return LiveCurve(
            frequency=traced.parameter,
            response=force if self.force else shown,
            contact_force=force,
            leading_multiplier=leading,
            direction=traced.direction,
            ending=traced.ending,
            depth=traced.depth,
            path=path,
            harmonics=harmonics,
        )


def nearest_point(curve: LiveCurve, frequency: float) -> int:
    """Return the point of a curve nearest to a frequency; of several the highest stable one.

    Raises `ValueError` where no curve was found.
    """
    if not len(curve.frequency):
        raise ValueError(f"There is no curve to take an orbit from: {curve.ending.sentence}")
    away = np.abs(curve.frequency - frequency)
    ends = np.pad(away, 1, constant_values=np.inf)
    passes = np.flatnonzero((away <= ends[:-2]) & (away <= ends[2:]))
    # Where the curve turns round before it gets there it does not pass the frequency.
    longest = np.max(np.abs(np.diff(curve.frequency)), initial=0.0)
    passes = passes[away[passes] <= max(longest, away.min())]
    stable = passes[curve.stable[passes]]
    chosen = stable if len(stable) else passes
    return int(chosen[np.argmax(curve.response[chosen])])


def highest_stable(curve: LiveCurve) -> int:
    """Return the point of the largest stable response (of all, where none is stable)."""
    shown = np.where(curve.stable, curve.response, -np.inf)
    return int(np.argmax(shown if np.isfinite(shown).any() else curve.response))


class LiveOrbit(NamedTuple):
    """One drive period of a motion, closed: the last sample repeats the first."""

    phase: Float[np.ndarray, " samples"]
    """Drive periods from phase 0."""
    displacement: Float[np.ndarray, " samples"]
    """What the system reports (the tip), relative to the base, m."""
    velocity: Float[np.ndarray, " samples"]
    """m/s."""
    contact_force: Float[np.ndarray, "stops samples"]
    """N."""
    touching: Bool[np.ndarray, " samples"]
    """Whether any stop is touched."""


@compiled
def _waves(paths, depth, frequency):
    place, problem, at = _balanced_at(take(paths, 0), depth, frequency)
    samples = 2 * (depth.shape[-1] - 1)
    average = cell_average(samples, depth.shape[-1])
    push = jnp.einsum("bk,bk->k", problem.receptance.response_from_force, at.force / average)
    tip, motion = problem.response_drive + push, depth / average
    both = jnp.concatenate([tip[None], motion])
    rows = jnp.concatenate([both, differentiate(both, samples)])
    # The highest harmonic has no phase at the samples: it is left out.
    waves = jnp.fft.irfft(FINER * rows.at[:, -1].set(0.0), FINER * samples)
    value, rate = jnp.split(waves, 2)
    rate = rate * problem.per_second
    stops = enumerate(without_memory(place.equations.stops), start=1)
    forces = jnp.stack([stop.force(value[a], rate[a]) for a, stop in stops])
    return value[0], rate[0], forces, jnp.any(value[1:] > 0, axis=0)


def orbit_at(curve: LiveCurve, point: int) -> LiveOrbit:
    """Return the orbit of a point of the curve (its index)."""
    waves = _waves(curve.path, curve.depth[point], jnp.asarray(curve.frequency[point]))
    closed = [np.concatenate([a, a[..., :1]], axis=-1) for a in map(np.asarray, waves)]
    return LiveOrbit(np.linspace(0.0, 1.0, len(closed[0])), *closed)
