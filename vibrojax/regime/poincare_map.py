"""The Poincaré map of many lanes, at drive phase 0: the engine of regimes, diagrams and basins.

A `PoincareMap` holds the rigs of a study made ready; lanes are pairs of a rig and a drive
frequency. It works through any number of lanes in chunks of one width, so everything compiles once,
and the result of a lane does not depend on its neighbours. On the host, lanes lead: states are
(lanes, states); in the loops they trail, as the marches want them.

    poincare = PoincareMap.of(method, rigs)
    state = poincare.march(rig, angular_frequency, state, periods)
    record = poincare.section(rig, angular_frequency, state, count)
    found = poincare.observe(rig, angular_frequency, state, plan)
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.regime.lyapunov import (
    ALIGNING,
    Growth,
    drive_period,
    first_tangent,
    mean_rate,
    tangent_growth,
)
from vibrojax.regime.period_number import period_number
from vibrojax.steady.settling import APERIODIC_PERIODS
from vibrojax.stepping.method import AbstractMarch, AbstractMethod
from vibrojax.sweep.lane_pool import WIDTHS
from vibrojax.sweep.swept_lanes import Prepared, Rigs, prepare, ratios_of

lax = jax.lax

Report = Callable[[int], object]
Numbers = Float[np.ndarray, " lanes"]


class SectionPlan(NamedTuple):
    """How long lanes are marched and seen, and when a motion counts as periodic."""

    transient: int
    """Drive periods before anything is looked at."""
    periods: int
    """Drive periods observed."""
    max_period: int
    tolerance: float
    """Relative return that makes a period, see `period_number`."""
    lyapunov: bool


class Observed(NamedTuple):
    """Motions of some lanes, lanes leading."""

    start: Float[np.ndarray, "lanes states"]
    """State at the start of the window observed, drive phase 0."""
    end: Float[np.ndarray, "lanes states"]
    period: Int[np.ndarray, " lanes"]
    return_error: Numbers
    lyapunov_exponent: Numbers
    """1/s; NaN where it was not asked for."""
    lyapunov_standard_error: Numbers
    alive: Bool[np.ndarray, " lanes"]
    """Whether the state stayed finite."""


def width_for(count: int) -> int:
    """Return how many lanes run side by side: the narrowest loop for them all, or the widest."""
    widths = WIDTHS.get(jax.default_backend(), WIDTHS["gpu"])
    return next((w for w in widths if w >= count), widths[-1])


def in_chunks(
    function: Callable[[np.ndarray], Any], count: int, report: Report = lambda done: None
) -> Any:
    """Run a function of an index over chunks of lanes of one width, the last filled by repeats.

    It returns a tree of arrays with the lanes leading; `report` takes numbers of lanes done.
    """
    width = width_for(count)
    parts = []
    for first in range(0, count, width):
        own = min(width, count - first)
        found = function(np.minimum(np.arange(first, first + width), count - 1))
        parts.append(jax.tree.map(lambda a, n=own: np.asarray(a)[:n], found))
        report(own)
    return jax.tree.map(lambda *a: np.concatenate(a), *parts)


def _on_host(tree: Any) -> Any:
    return jax.tree.map(lambda a: np.asarray(a) if eqx.is_array(a) else a, tree)


@eqx.filter_jit
def _march(march: AbstractMarch, frequency, state, periods):
    end, _, _ = march(state.T, frequency, periods, False)
    return end.T


def _iterated(advance, state, count: int):
    return lax.scan(lambda s, _: (advance(s),) * 2, state, None, length=count)


@eqx.filter_jit
def _section(march: AbstractMarch, frequency, state, count: int):
    advance = drive_period(march, frequency)
    _, record = _iterated(advance, state.T, count)
    return jnp.moveaxis(record, -1, 0)


@eqx.filter_jit
def _observe(
    march: AbstractMarch,
    frequency,
    state,
    transient,
    tolerance,
    periods: int,
    max_period: int,
    lyapunov: bool,
):
    weight, advance = march.energy_weight(), drive_period(march, frequency)
    before = jnp.full(frequency.shape, transient, jnp.int32)
    state, _, _ = march(state.T, frequency, before, False)
    if lyapunov:
        # One scan for both parts: the march is the dear thing to compile.
        grown: Growth = tangent_growth(
            advance, state, first_tangent(weight), weight, ALIGNING + periods
        )
        start, section = grown.section[ALIGNING - 1], grown.section[ALIGNING:]
        growth = grown.log_growth[ALIGNING:]
        exponent, error = mean_rate(growth, 2 * jnp.pi / frequency)
        end = grown.state
    else:
        start = state
        end, section = _iterated(advance, state, periods)
        exponent = error = jnp.full(frequency.shape, jnp.nan)
    found = period_number(section * weight, tolerance, max_period)
    alive = jnp.all(jnp.isfinite(end), axis=0)
    return {
        "start": start.T,
        "end": end.T,
        "period": jnp.where(alive, found.period, 0),
        "return_error": jnp.where(alive, found.return_error, jnp.nan),
        "lyapunov_exponent": exponent,
        "lyapunov_standard_error": error,
        "alive": alive,
    }


@eqx.filter_jit
def _measure(march: AbstractMarch, reference, frequency, state, window):
    _, _, measures = march(state.T, frequency, window, True)
    assert measures is not None  # a march that observes has them
    return ratios_of(measures, jnp.maximum(window, 1).astype(float), reference, jnp)


class PoincareMap(eqx.Module):
    """Rigs made ready to be marched, observed and measured, chunk by chunk of lanes.

    In all methods `rig[k]` is the rig of lane k among those prepared and `angular_frequency[k]`
    its drive in rad/s; states (q, q', memories) are at drive phase 0.
    """

    method: AbstractMethod
    rigs: Rigs
    """Equations and drives, rigs leading."""
    prepared: Prepared

    @classmethod
    def of(cls, method: AbstractMethod, rigs: Rigs) -> "PoincareMap":
        """Make rigs ready."""
        return cls(method, _on_host(rigs), _on_host(prepare(method, rigs)))

    def _march_of(self, rig: Int[np.ndarray, " lanes"]) -> AbstractMarch:
        # Picked here and not in the loops, which so do not compile anew for more rigs.
        march = self.prepared.march
        return jax.tree.map(lambda a: np.take(a, rig, axis=-1) if eqx.is_array(a) else a, march)

    def rigs_at(self, rig: Int[np.ndarray, " lanes"]) -> Rigs:
        """Return equations and drives of some lanes, lanes leading."""
        pick = self.rigs
        return jax.tree.map(lambda a: np.take(a, rig, axis=0) if eqx.is_array(a) else a, pick)

    @property
    def weight(self) -> Float[np.ndarray, "rigs states"]:
        """Weights that make states comparable: norms of weighted states are energies."""
        kept = self.prepared.march
        march = jax.tree.map(lambda a: jnp.asarray(a) if eqx.is_array(a) else a, kept)
        return np.asarray(march.energy_weight()).T

    @property
    def states(self) -> int:
        """Length of a state."""
        return self.weight.shape[1]

    def march(
        self,
        rig: Int[np.ndarray, " lanes"],
        angular_frequency: Numbers,
        state: Float[np.ndarray, "lanes states"],
        periods: int | Int[np.ndarray, " lanes"],
        report: Report = lambda done: None,
    ) -> Float[np.ndarray, "lanes states"]:
        """Return the states after so many drive periods, NaN where a lane was lost."""
        self.prepared.march.check_steps(rig, angular_frequency)
        count = np.broadcast_to(np.asarray(periods, np.int32), np.shape(rig))

        def run(k):
            return _march(self._march_of(rig[k]), angular_frequency[k], state[k], count[k])

        return in_chunks(run, len(rig), report)

    def section(
        self,
        rig: Int[np.ndarray, " lanes"],
        angular_frequency: Numbers,
        state: Float[np.ndarray, "lanes states"],
        count: int,
        report: Report = lambda done: None,
    ) -> Float[np.ndarray, "lanes count states"]:
        """Return the states after each of `count` drive periods."""

        def run(k):
            return _section(self._march_of(rig[k]), angular_frequency[k], state[k], count)

        return in_chunks(run, len(rig), report)

    def observe(
        self,
        rig: Int[np.ndarray, " lanes"],
        angular_frequency: Numbers,
        state: Float[np.ndarray, "lanes states"],
        plan: SectionPlan,
        report: Report = lambda done: None,
    ) -> Observed:
        """March the transient, then return period and exponent of what lasts."""
        self.prepared.march.check_steps(rig, angular_frequency)
        before = max(plan.transient - ALIGNING, 0) if plan.lyapunov else plan.transient
        transient, tolerance = jnp.asarray(before, jnp.int32), jnp.asarray(plan.tolerance, float)

        def run(k):
            return _observe(
                self._march_of(rig[k]),
                angular_frequency[k],
                state[k],
                transient,
                tolerance,
                plan.periods,
                plan.max_period,
                plan.lyapunov,
            )

        return Observed(**in_chunks(run, len(rig), report))

    def measure(
        self,
        rig: Int[np.ndarray, " lanes"],
        angular_frequency: Numbers,
        state: Float[np.ndarray, "lanes states"],
        period: Int[np.ndarray, " lanes"],
    ) -> dict[str, np.ndarray]:
        """Return amplitudes, contact forces and contacts as a sweep does, over one period.

        A motion without a period (0) is measured over `APERIODIC_PERIODS`.
        """
        lost = np.asarray(~np.isfinite(state).all(axis=1))
        window = np.where(period > 0, period, APERIODIC_PERIODS)
        window = np.where(lost, 0, window).astype(np.int32)
        begin = np.where(lost[:, None], 0.0, state)

        def run(k):
            reference = np.asarray(self.prepared.reference)[rig[k]]
            march = self._march_of(rig[k])
            return _measure(march, reference, angular_frequency[k], begin[k], window[k])

        found = in_chunks(run, len(rig))
        return {name: np.where(lost, np.nan, values) for name, values in found.items()}
