"""Forward and backward frequency sweeps, the state carried from frequency to frequency."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.described import provenance, recipe
from vibrojax._tools.signatures import validated
from vibrojax._tools.warn import warn
from vibrojax.ensemble.arguments import Zipped
from vibrojax.ensemble.frequencies import frequency_axis
from vibrojax.ensemble.lanes import Lanes, lanes_of
from vibrojax.ensemble.progress import progress_bar
from vibrojax.model.systems import AbstractSystem
from vibrojax.stepping.prepared_rigs import kinds_of_rigs, prepare, prepared_kinds, rigs_of
from vibrojax.sweep.frequency_response import FrequencyResponse
from vibrojax.sweep.plan import SweepPlan, Swept
from vibrojax.sweep.settings import SweepSettings
from vibrojax.sweep.swept_lanes import compile_ahead, numbers_of_jumps, sweep_rigs


@validated
def frequency_sweep(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    settings: SweepSettings | None = None,
    progress: bool | None = None,
    **axes: Any,
) -> FrequencyResponse:
    """Sweep the drive frequency up and down and return the steady response at every point.

    At each frequency the lanes march from where the last one ended until their motion returns
    after `settings.max_period` drive periods or fewer, each lane at its own pace. What has not
    settled after `settings.max_periods` is flagged in `status`, never dropped.

    Parameters:
        system: the rig, or a function from named numbers to a rig; then further keywords are its
            arguments, and lists among them are axes, crossed, which the result carries by name.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency_ratio: drive frequencies over the first linear natural frequency of the
            unstopped system, increasing, shape (frequencies,).
        frequency: the same in Hz; give one of the two.
        settings: `vj.SweepSettings(direction=..., tolerance=..., ...)`: how the sweep is done.
        progress: show a progress bar; by default on long runs in a terminal.

    Raises `ValueError` for frequencies that are empty, not finite or not increasing, an unknown
    keyword, or a system without a drive. Warns of frequencies at which
    an undamped mode that no stop holds grows without bound. Source: Gandhi and Vyas 2017,
    sec. 3.1.
    """
    axis, grid = frequency_axis(frequency_ratio, frequency)
    lanes = lanes_of(system, axes, zipped)
    plan = (settings or SweepSettings()).plan(lanes.sample, axis, grid)
    points = len(grid) * len(plan.directions) * int(np.prod(lanes.shape))
    with progress_bar("sweep", points, progress) as bar:
        compile_ahead(plan, prepared_kinds(plan.stepper, kinds_of_rigs(lanes.systems)))
        prepared = prepare(plan.stepper, rigs_of(lanes.systems))
        swept = sweep_rigs(plan, prepared, bar.update, warn)
    return _result(lanes, plan, swept)


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
        attributes=provenance("frequency sweep", lanes.description)
        | {"stepper": recipe(plan.stepper)},
        **{name: over_axes(values) for name, values in numbers.items()},
    )
