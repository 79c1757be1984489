"""Studies of regimes made ready, and the regimes of lanes, alone or carried along an axis."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.described import provenance, recipe
from vibrojax.ensemble.frequencies import frequency_axis
from vibrojax.ensemble.lanes import Lanes, lanes_of
from vibrojax.regime.observing import sample_motions
from vibrojax.regime.poincare_map import Numbers, PoincareMap, Report
from vibrojax.regime.settings import BasinSettings, RegimeSettings
from vibrojax.results.status import Status
from vibrojax.results.variables import RESPONSE
from vibrojax.steady.kinds import Regime, regime_of
from vibrojax.stepping.prepared_rigs import rigs_of
from vibrojax.stepping.resonance import is_unbounded
from vibrojax.stepping.stepper import AbstractStepper


class Ready(NamedTuple):
    """A study made ready: its lanes and frequencies, and how they are marched."""

    axis: str
    """`frequency_ratio`, or `frequency` in Hz."""
    grid: Float[np.ndarray, " frequencies"]
    lanes: Lanes
    stepper: AbstractStepper
    attributes: dict[str, str]
    """What is run, in words."""

    def poincare(self) -> PoincareMap:
        """Compute the equations of all rigs and make them ready to march."""
        return PoincareMap(self.stepper, rigs_of(self.lanes.systems))


def made_ready(
    title: str,
    system: Any,
    numbers: dict[str, Any],
    zipped: tuple[Any, ...],
    frequency_ratio: Any,
    frequency: Any,
    settings: RegimeSettings | BasinSettings,
) -> Ready:
    """Sort what a study was called with; raises `ValueError` for what cannot be studied."""
    axis, grid = frequency_axis(frequency_ratio, frequency)
    lanes = lanes_of(system, numbers, zipped)
    stepper = settings.stepper_of(lanes.sample, axis)
    attributes = provenance(title, lanes.description)
    attributes |= {"stepper": recipe(stepper), "settings": recipe(settings)}
    return Ready(axis, grid, lanes, stepper, attributes)


def regime_points(
    poincare: PoincareMap,
    rig: Int[np.ndarray, " lanes"],
    angular_frequency: Numbers,
    state: Float[np.ndarray, "lanes states"],
    settings: RegimeSettings,
    report: Report | None = None,
) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "lanes states"]]:
    """Bring all lanes to what lasts and return its numbers, lanes leading, and the last states.

    The state of a lane that was lost is rest.
    """
    seen = poincare.observe(
        rig,
        angular_frequency,
        state,
        periods=settings.periods,
        max_period=settings.max_period,
        tolerance=settings.period_tolerance,
        transient=settings.transient,
        lyapunov=settings.lyapunov,
        report=report,
    )
    grows = is_unbounded(np.asarray(poincare.prepared.resonances)[:, rig], angular_frequency, np)
    alive = seen["alive"] & ~grows
    period = np.where(grows, 0, seen["period"])
    end = np.where(grows[:, None], np.nan, seen["end"])
    window = settings.periods * 2 * np.pi / angular_frequency
    exponent, error = seen["lyapunov_exponent"], seen["lyapunov_standard_error"]
    away, limit = seen["return_error"], settings.period_tolerance
    measured = poincare.measure(rig, angular_frequency, end, period)
    sampled = sample_motions(
        poincare,
        rig,
        angular_frequency,
        np.where(alive[:, None], seen["start"], np.nan),
        periods=settings.periods,
        samples_per_period=settings.samples_per_period,
        barrier=settings.barrier,
        spectrum=settings.spectrum,
    )
    gave_up = ~grows & np.isinf(end).any(axis=1)
    words = Status.unbounded, Status.gave_up, Status.diverged, Status.settled
    status = np.select(
        [grows, gave_up, ~alive, period > 0], [w.value for w in words], Status.aperiodic.value
    )
    regime = regime_of(period, exponent * window, error * window, away, limit, alive)
    found = {
        "period": period,
        "regime": np.where(gave_up, Regime.gave_up.value, regime).astype(np.int32),
        "status": status.astype(np.int32),
        "return_error": away,
        "lyapunov_exponent": exponent,
        "lyapunov_standard_error": error,
        **{name: measured[name] for name in RESPONSE},
        **sampled,
    }
    return found, np.where(alive[:, None], end, 0.0)


def carried_points(
    poincare: PoincareMap,
    rig: Int[np.ndarray, "lanes values"],
    angular_frequency: Float[np.ndarray, "lanes values"],
    backward: np.ndarray,
    state: Float[np.ndarray, "lanes states"],
    settings: RegimeSettings,
    report: Report | None = None,
) -> dict[str, np.ndarray]:
    """Carry every lane along its values, upwards or `backward`, each from where the last ended.

    Arrays have the shape (lanes, values, ...), values ascending in both directions; `state` is
    the last state at each value.
    """
    lanes, count = rig.shape
    every = np.arange(lanes)
    # In the order of visits, upwards or downwards; downwards the same turned over.
    place = np.where(np.asarray(backward)[:, None], np.arange(count)[::-1], np.arange(count))
    parts: list[Any] = []
    for at in place.T:
        found, state = regime_points(
            poincare, rig[every, at], angular_frequency[every, at], state, settings, report
        )
        parts.append(found | {"state": state})
    return jax.tree.map(lambda *v: np.stack(v, axis=1)[every[:, None], place], *parts)
