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
from jaxtyping import Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax.steady.batches import in_batches
from vibrojax.steady.growth import ALIGNING, drive_period
from vibrojax.steady.observed import iterated, observe
from vibrojax.steady.pool_programs import all_widths
from vibrojax.steady.settling import APERIODIC_PERIODS
from vibrojax.stepping.measures import ratios_of
from vibrojax.stepping.prepared_rigs import Prepared, Rigs, prepare
from vibrojax.stepping.stepper import AbstractMarch, AbstractStepper

Report = Callable[[int], object]
"""Takes numbers of lanes that are done."""
Numbers = Float[np.ndarray, " lanes"]
Places = Int[np.ndarray, " lanes"]
States = Float[np.ndarray, "lanes states"]


def width_for(count: int) -> int:
    """Return how many lanes run side by side: the narrowest loop for them all, or the widest."""
    widths = all_widths()
    return next((w for w in widths if w >= count), widths[-1])


def in_chunks(function: Callable[[Places], Any], count: int, report: Report | None = None) -> Any:
    """Run a function of an index over chunks of lanes; it returns a tree with the lanes leading."""

    def chunk(k: Places) -> Any:
        found = jax.device_get(function(k))
        if report is not None:
            report(len(np.unique(k)))
        return found

    return in_batches(chunk, count, width_for(count))


@compiled
def _march(march: AbstractMarch, frequency, state, periods):
    return march(state.T, frequency, periods, False)[0].T


@compiled
def _section(march: AbstractMarch, frequency, state, count: int):
    _, record = iterated(drive_period(march, frequency), state.T, count)
    return jnp.moveaxis(record, -1, 0)


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
            return observe(march, frequency, state, before, limit, periods, max_period, lyapunov)

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
