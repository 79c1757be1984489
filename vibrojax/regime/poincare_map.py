"""The Poincaré map of many lanes, at drive phase 0: the engine of regimes, diagrams and basins.

A `PoincareMap` holds the rigs of a study made ready; lanes are pairs of a rig and a drive
frequency. It works through any number of lanes in chunks of one width, so everything compiles once,
and the result of a lane does not depend on its neighbours. On the host, lanes lead: states are
(lanes, states); in the loops they trail, as the marches want them.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._tools.checks import check_count, check_positive
from vibrojax._tools.compiled import compiled
from vibrojax.regime.lyapunov import ALIGNING, drive_period, grown, mean_rate
from vibrojax.steady.batches import in_batches
from vibrojax.steady.pool_programs import WIDTHS
from vibrojax.steady.settling import APERIODIC_PERIODS
from vibrojax.stepping.stepper import AbstractMarch, AbstractStepper
from vibrojax.sweep.swept_lanes import Prepared, Rigs, prepare, ratios_of

lax = jax.lax

Report = Callable[[int], object]
"""Takes numbers of lanes that are done."""
Numbers = Float[np.ndarray, " lanes"]
Places = Int[np.ndarray, " lanes"]
States = Float[np.ndarray, "lanes states"]


def width_for(count: int) -> int:
    """Return how many lanes run side by side: the narrowest loop for them all, or the widest."""
    widths = WIDTHS.get(jax.default_backend(), WIDTHS["gpu"])
    return next((w for w in widths if w >= count), widths[-1])


def in_chunks(function: Callable[[Places], Any], count: int, report: Report | None = None) -> Any:
    """Run a function of an index over chunks of lanes; it returns a tree with the lanes leading."""

    def chunk(k: Places) -> Any:
        found = jax.device_get(function(k))
        if report is not None:
            report(len(np.unique(k)))
        return found

    return in_batches(chunk, count, width_for(count))


def period_number(
    section: Float[Array, "count states *lanes"],
    tolerance: Float[ArrayLike, ""],
    max_period: int,
) -> tuple[Int[Array, "*lanes"], Float[Array, "*lanes"]]:
    """Return the smallest n after which a record of states repeats, up to `max_period`.

    The states are those at the same drive phase of successive periods, weighted so that their norm
    is that of an energy. With period n every state of the record returns after n periods to within
    `tolerance` of the size of the motion, and lies as near to the newest state of its phase, so
    that a slow drift along a torus is no period. The size is the spread of the states about their
    mean; of a fixed point, n = 1, it is that of the states themselves: a motion whose states
    spread by less than `tolerance` of their size is called period 1. The second answer is the
    relative error of that return; where the period is 0, none found, it is the least of all.

    Raises `ValueError` unless the tolerance is above 0 and there are at least 2 max_period states.
    """
    check_positive("tolerance", tolerance, "(relative return)")
    check_count("max_period", max_period)
    count = section.shape[0]
    if count < 2 * max_period:
        raise ValueError(
            f"section must have at least 2 max_period = {2 * max_period} states, got {count}. "
            "Observe more periods, or look for shorter ones."
        )

    def squares(states: Float[Array, "count states *lanes"]) -> Float[Array, "count *lanes"]:
        return jnp.sum(states**2, axis=1)

    spread = jnp.sqrt(jnp.mean(squares(section - jnp.mean(section, axis=0)), axis=0))
    size = jnp.sqrt(jnp.mean(squares(section), axis=0))
    place = jnp.arange(count)
    newest = count - 1

    def error(n):
        latest = newest - (newest - place) % n
        ahead = jnp.minimum(place + n, latest)  # itself near the end
        away = [
            jnp.max(squares(jnp.take(section, other, axis=0) - section), axis=0)
            for other in (ahead, latest)
        ]
        distance = jnp.sqrt(jnp.maximum(*away))
        still = distance <= 0  # at rest; a state that is not a number is not
        scale = jnp.where(n == 1, size, spread)
        return jnp.where(still, 0.0, distance / jnp.where(still, 1.0, scale))

    errors = lax.map(error, jnp.arange(1, max_period + 1, dtype=jnp.int32))
    fits = errors <= tolerance
    first = jnp.argmax(fits, axis=0)
    found = jnp.any(fits, axis=0)
    least = jnp.min(jnp.where(jnp.isnan(errors), jnp.inf, errors), axis=0)
    own = jnp.take_along_axis(errors, first[None], axis=0)[0]
    return jnp.where(found, first + 1, 0).astype(jnp.int32), jnp.where(found, own, least)


@compiled
def _march(march: AbstractMarch, frequency, state, periods):
    return march(state.T, frequency, periods, False)[0].T


def _iterated(advance, state, count: int):
    return lax.scan(lambda s, _: (advance(s),) * 2, state, None, length=count)


@compiled
def _section(march: AbstractMarch, frequency, state, count: int):
    _, record = _iterated(drive_period(march, frequency), state.T, count)
    return jnp.moveaxis(record, -1, 0)


@compiled
def _observe(
    march: AbstractMarch, frequency, state, transient, tolerance, periods, max_period, lyapunov
):
    before = jnp.full(frequency.shape, transient, jnp.int32)
    if lyapunov:
        start, end, section, growth = grown(march, frequency, state.T, before, periods)
        exponent, error = mean_rate(growth, 2 * jnp.pi / frequency)
    else:
        start, _, _ = march(state.T, frequency, before, False)
        end, section = _iterated(drive_period(march, frequency), start, periods)
        exponent = error = jnp.full(frequency.shape, jnp.nan)
    period, away = period_number(section * march.energy_weight(), tolerance, max_period)
    alive = jnp.all(jnp.isfinite(end), axis=0)
    return {
        "start": start.T,
        "end": end.T,
        "period": jnp.where(alive, period, 0),
        "return_error": jnp.where(alive, away, jnp.nan),
        "lyapunov_exponent": exponent,
        "lyapunov_standard_error": error,
        "alive": alive,
    }


@compiled
def _measure(march: AbstractMarch, reference, frequency, state, window):
    _, _, measures = march(state.T, frequency, window, True)
    assert measures is not None  # a march that observes has them
    return ratios_of(measures, jnp.maximum(window, 1).astype(float), reference, jnp)


class PoincareMap(eqx.Module):
    """Rigs made ready to be marched, observed and measured, chunk by chunk of lanes.

    In all methods `rig[k]` is the rig of lane k among those prepared and `frequency[k]` its drive
    in rad/s; states (q, q', memories) are at drive phase 0.
    """

    stepper: AbstractStepper
    rigs: Rigs
    """Equations and drives, rigs leading."""
    prepared: Prepared

    def __init__(self, stepper: AbstractStepper, rigs: Rigs) -> None:
        def on_host(tree: Any) -> Any:
            return jax.tree.map(lambda a: np.asarray(a) if eqx.is_array(a) else a, tree)

        self.stepper, self.rigs = stepper, on_host(rigs)
        self.prepared = on_host(prepare(stepper, rigs))

    def angular_frequency(
        self, axis: str, rig: Int[np.ndarray, "..."], value: Float[np.ndarray, "..."]
    ) -> Float[np.ndarray, "..."]:
        """Return drive frequencies in rad/s, from values of `frequency_ratio` or of `frequency`."""
        first = np.asarray(self.prepared.first_frequency)[rig]
        return value * (first if axis == "frequency_ratio" else 2 * np.pi)

    @property
    def natural_frequency(self) -> Float[np.ndarray, " rigs"]:
        """First natural frequency of the unstopped system, Hz."""
        return np.asarray(self.prepared.first_frequency) / (2 * np.pi)

    @property
    def weight(self) -> Float[np.ndarray, "rigs states"]:
        """Weights that make states comparable: norms of weighted states are energies."""
        kept = self.prepared.march
        march = jax.tree.map(lambda a: jnp.asarray(a) if eqx.is_array(a) else a, kept)
        return np.asarray(march.energy_weight()).T

    def _over(self, run, rig: Places, *lanes: Any, report: Report | None = None) -> Any:
        """Run a function of marches and arrays over lanes."""

        def chunk(k: Places) -> Any:
            # Picked here and not in the loops, which so do not compile anew for more rigs.
            march = self.prepared.march
            own = jax.tree.map(
                lambda a: np.take(a, rig[k], axis=-1) if eqx.is_array(a) else a, march
            )
            return run(own, *(a[k] for a in lanes))

        return in_chunks(chunk, len(rig), report)

    def march(self, rig: Places, frequency: Numbers, state: States, periods: Places) -> States:
        """Return the states after so many drive periods, NaN where a lane was lost."""
        return self._over(_march, rig, frequency, state, periods.astype(np.int32))

    def section(
        self, rig: Places, frequency: Numbers, state: States, count: int
    ) -> Float[np.ndarray, "lanes count states"]:
        """Return the states after each of `count` drive periods."""
        return self._over(lambda m, w, s: _section(m, w, s, count), rig, frequency, state)

    def observe(
        self,
        rig: Places,
        frequency: Numbers,
        state: States,
        *,
        periods: int,
        max_period: int,
        tolerance: float,
        transient: int = 0,
        lyapunov: bool = False,
        report: Report | None = None,
    ) -> dict[str, np.ndarray]:
        """March the transient, then return period and exponent of what lasts, lanes leading.

        `start` and `end` are states at the ends of the window observed; `alive` says whether the
        state stayed finite; the exponent is in 1/s, NaN where it was not asked for.
        """
        self.prepared.march.check_steps(rig, frequency)
        before = jnp.asarray(max(transient - ALIGNING, 0) if lyapunov else transient, jnp.int32)
        limit = jnp.asarray(tolerance, float)

        def run(march: AbstractMarch, frequency: Any, state: Any) -> Any:
            return _observe(march, frequency, state, before, limit, periods, max_period, lyapunov)

        return self._over(run, rig, frequency, state, report=report)

    def measure(
        self, rig: Places, frequency: Numbers, state: States, period: Places
    ) -> dict[str, np.ndarray]:
        """Return amplitudes, contact forces and contacts as a sweep does, over one period.

        A motion without a period (0) is measured over `APERIODIC_PERIODS`.
        """
        lost = np.asarray(~np.isfinite(state).all(axis=1))
        window = np.where(period > 0, period, APERIODIC_PERIODS)
        window = np.where(lost, 0, window).astype(np.int32)
        begin = np.where(lost[:, None], 0.0, state)
        reference = np.asarray(self.prepared.reference)[rig]

        found = self._over(_measure, rig, reference, frequency, begin, window)
        return {name: np.where(lost, np.nan, values) for name, values in found.items()}
