"""Forward and backward frequency sweeps, the state carried from frequency to frequency."""

from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import (
    check_choice,
    check_count,
    check_range,
)
from vibrojax._tools.described import recipe
from vibrojax._tools.signatures import validated
from vibrojax._tools.warn import warn
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.frequencies import DIRECTIONS, check_drive, frequency_axis
from vibrojax.ensemble.lanes import Lanes, lanes_of
from vibrojax.model.systems import AbstractSystem
from vibrojax.stepping.choice import choose_method
from vibrojax.stepping.method import AbstractMethod, check_settings
from vibrojax.sweep.frequency_response import FrequencyResponse
from vibrojax.sweep.swept_lanes import SweepPlan, Swept, numbers_of_jumps, rigs_of, sweep_rigs


@validated
def frequency_sweep(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    direction: str = "both",
    tolerance: float = 1e-4,
    steps_per_period: int | None = None,
    method: AbstractMethod | None = None,
    max_period: int = 8,
    max_periods: int = 600,
    refine_jumps: float | None = 1e-4,
    progress: bool | None = None,
    **axes: Any,
) -> FrequencyResponse:
    """Sweep the drive frequency up and down and return the steady response at every point.

    At each frequency the lanes march from where the last one ended until their motion returns
    after `max_period` drive periods or fewer, each lane at its own pace. What has not settled
    after `max_periods` is flagged in `status`, never dropped.

    Parameters:
        system: the rig, or a function from named numbers to a rig; then further keywords are its
            arguments, and lists among them are axes, crossed, which the result carries by name.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency_ratio: drive frequencies over the first linear natural frequency of the
            unstopped system, increasing, shape (frequencies,).
        frequency: the same in Hz; give one of the two.
        direction: `both`, `forward` (upwards) or `backward`.
        tolerance: relative error to aim at in amplitudes and forces of settled points.
        steps_per_period: steps of the march, instead of those chosen from contact and tolerance.
        method: how to step: `ExactContact()` or `ExponentialSplitting()`; by default the first
            where the stops are linear in contact, else the second.
        max_period: longest period looked for, in drive periods.
        max_periods: most drive periods marched at one frequency.
        refine_jumps: relative width to which the jumps are bracketed by bisection, each try
            starting from the branch before the jump; None leaves them between grid points.
        progress: show a progress bar; by default on long runs in a terminal.

    Raises `ValueError` for frequencies that are empty, not finite or not increasing, an unknown
    keyword, a system without a drive, or settings that cannot work. Warns of frequencies at which
    an undamped mode that no stop holds grows without bound. Source: Gandhi and Vyas 2017,
    sec. 3.1.
    """
    axis, grid = frequency_axis(frequency_ratio, frequency)
    lanes = lanes_of(system, axes, zipped)
    plan = sweep_plan(
        lanes.sample,
        axis,
        grid,
        direction=direction,
        tolerance=tolerance,
        steps_per_period=steps_per_period,
        method=method,
        max_period=max_period,
        max_periods=max_periods,
        refine_jumps=refine_jumps,
    )
    from tqdm import tqdm

    hidden = None if progress is None else not progress
    points = len(grid) * len(plan.directions) * int(np.prod(lanes.shape))
    delay = 2.0 if progress is None else 0.0
    with tqdm(total=points, desc="sweep", disable=hidden, delay=delay, unit="point") as bar:
        rigs = rigs_of(lanes.systems)
        swept = sweep_rigs(plan, rigs, bar.update, warn)
    return _result(lanes, plan, swept)


def sweep_plan(
    sample: AbstractSystem,
    axis: str,
    grid: np.ndarray,
    *,
    direction: str,
    tolerance: float,
    steps_per_period: int | None,
    method: AbstractMethod | None,
    max_period: int,
    max_periods: int,
    refine_jumps: float | None,
) -> SweepPlan:
    """Check the settings of a sweep of systems like the sample.

    Raises `ValueError` as `frequency_sweep` does.
    """
    check_sweep(direction, tolerance, steps_per_period, max_period, max_periods, refine_jumps)
    check_drive(sample)
    return SweepPlan(
        axis=axis,
        grid=grid,
        directions=DIRECTIONS[direction],
        method=choose_method(sample, method, tolerance, steps_per_period),
        tolerance=tolerance,
        max_period=max_period,
        max_periods=max_periods,
        refine_jumps=refine_jumps,
    )


def check_sweep(
    direction: str,
    tolerance: float,
    steps_per_period: int | None,
    max_period: int,
    max_periods: int,
    refine_jumps: float | None,
) -> None:
    """Refuse, with a `ValueError`, settings of a sweep that no system could be swept with."""
    check_choice("direction", direction, tuple(DIRECTIONS))
    check_count("max_period", max_period)
    check_count("max_periods", max_periods, least=2 * max_period + 1)
    if refine_jumps is not None:
        check_range("refine_jumps", refine_jumps, 1e-9, 1.0, allowed="from 1e-9 to 1, or None")
    check_settings(tolerance, steps_per_period)


def _result(lanes: Lanes, plan: SweepPlan, swept: Swept) -> FrequencyResponse:
    def over_axes(values: Any) -> Any:
        return values.reshape((*lanes.shape, *values.shape[1:]))[()]

    _, ratio_units = lanes.sample.drive.reference
    numbers = swept.curves | numbers_of_jumps(swept)
    numbers["natural_frequency"] = swept.natural_frequency
    return FrequencyResponse(
        axis=plan.axis,
        frequencies=plan.grid,
        directions=plan.directions,
        axes=lanes.axes,
        ratio_units=ratio_units,
        attributes={
            "title": "vibrojax frequency sweep",
            "rig": lanes.description,
            "method": recipe(plan.method),
            "vibrojax_version": version("vibrojax"),
            "jax_version": version("jax"),
        },
        **{name: over_axes(values) for name, values in numbers.items()},
    )
