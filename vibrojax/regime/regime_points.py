"""The regimes of lanes at their drive frequencies, and of lanes that are carried along an axis."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.checks import check_count, check_range
from vibrojax.regime.kinds import regime_of
from vibrojax.regime.observing import Sampling, sample_motions
from vibrojax.regime.poincare_map import Numbers, PoincareMap, Report, SectionPlan
from vibrojax.results.status import Status
from vibrojax.stepping.resonance import is_unbounded

SWEPT = (
    "amplitude_ratio",
    "peak_ratio",
    "rms_ratio",
    "first_harmonic_ratio",
    "contact_force",
    "contact_fraction",
    "contacts_per_period",
)
"""What is measured as in a frequency sweep."""


class RegimePlan(NamedTuple):
    """What is done with every lane."""

    section: SectionPlan
    sampling: Sampling


def regime_plan(
    *,
    transient: int,
    periods: int,
    max_period: int,
    tolerance: float,
    lyapunov: bool,
    samples_per_period: int,
    barrier: float,
    spectrum: bool,
) -> RegimePlan:
    """Check the settings of a study of regimes. Raises `ValueError` for those that cannot work."""
    check_count("max_period", max_period)
    check_count("transient", transient, least=0)
    check_count("periods", periods, least=max(4, 2 * max_period))
    check_count("samples_per_period", samples_per_period, least=8)
    check_range(
        "tolerance",
        tolerance,
        0.0,
        0.5,
        include_low=False,
        allowed="above 0 and at most 0.5",
        advice="It is the relative return that makes a period.",
    )
    check_range("barrier", barrier, allowed="a displacement in m")
    for name, value in (("lyapunov", lyapunov), ("spectrum", spectrum)):
        if not isinstance(value, bool):
            raise ValueError(f"{name} must be True or False, got {value!r}.")
    return RegimePlan(
        SectionPlan(transient, periods, max_period, tolerance, lyapunov),
        Sampling(periods, samples_per_period, float(barrier), spectrum),
    )


def regime_points(
    poincare: PoincareMap,
    rig: Int[np.ndarray, " lanes"],
    angular_frequency: Numbers,
    state: Float[np.ndarray, "lanes states"],
    plan: RegimePlan,
    report: Report = lambda done: None,
) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "lanes states"]]:
    """Bring all lanes to what lasts and return its numbers, lanes leading, and the last states.

    The state of a lane that was lost is rest.
    """
    seen = poincare.observe(rig, angular_frequency, state, plan.section, report)
    grows = is_unbounded(np.asarray(poincare.prepared.resonances)[:, rig], angular_frequency, np)
    end = np.where(grows[:, None], np.nan, seen.end)
    seen = seen._replace(alive=seen.alive & ~grows, period=np.where(grows, 0, seen.period), end=end)
    window = plan.section.periods * 2 * np.pi / angular_frequency
    kind = regime_of(
        seen.period,
        seen.lyapunov_exponent * window,
        seen.lyapunov_standard_error * window,
        seen.return_error,
        plan.section.tolerance,
        seen.alive,
    )
    measured = poincare.measure(rig, angular_frequency, seen.end, seen.period)
    start = np.where(seen.alive[:, None], seen.start, np.nan)
    sampled = sample_motions(poincare, rig, angular_frequency, start, plan.sampling)
    status = np.where(seen.period > 0, Status.settled.value, Status.aperiodic.value)
    status = np.where(seen.alive, status, Status.diverged.value)
    status = np.where(grows, Status.unbounded.value, status)
    found = {
        "period": seen.period,
        "regime": kind,
        "status": status.astype(np.int32),
        "return_error": seen.return_error,
        "lyapunov_exponent": seen.lyapunov_exponent,
        "lyapunov_standard_error": seen.lyapunov_standard_error,
        **{name: measured[name] for name in SWEPT},
        **sampled,
    }
    return found, np.where(seen.alive[:, None], seen.end, 0.0)


def carried_points(
    poincare: PoincareMap,
    rig: Int[np.ndarray, "lanes values"],
    angular_frequency: Float[np.ndarray, "lanes values"],
    backward: np.ndarray,
    state: Float[np.ndarray, "lanes states"],
    plan: RegimePlan,
    report: Report = lambda done: None,
) -> dict[str, np.ndarray]:
    """Carry every lane along its values, upwards or `backward`, each from where the last ended.

    Arrays have the shape (lanes, values, ...), values ascending in both directions; `state` is
    the last state at each value.
    """
    lanes, count = rig.shape
    every = np.arange(lanes)
    parts: list[Any] = []
    columns = []
    for visit in range(count):
        at = np.where(backward, count - 1 - visit, visit)
        found, state = regime_points(
            poincare, rig[every, at], angular_frequency[every, at], state, plan, report
        )
        parts.append(found | {"state": state})
        columns.append(at)
    place = np.stack(columns, axis=1)  # lanes, visits
    order = np.argsort(place, axis=1)

    def ascending(*values: np.ndarray) -> np.ndarray:
        stacked = np.stack(values, axis=1)
        return stacked[every[:, None], order]

    return jax.tree.map(ascending, *parts)
