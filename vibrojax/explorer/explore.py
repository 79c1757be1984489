"""An interactive frequency response: sliders for the numbers of a rig."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from vibrojax._tools.checks import check_choice, check_positive
from vibrojax._tools.described import in_short
from vibrojax._tools.kinds import is_list
from vibrojax._tools.signatures import validated
from vibrojax.branches.along import check_continued
from vibrojax.ensemble.arguments import Zipped, arguments_of, default_of
from vibrojax.ensemble.lanes import made_by
from vibrojax.ensemble.ranges import Range
from vibrojax.explorer.explorer import Explorer
from vibrojax.explorer.live_curve import CurveTracer
from vibrojax.explorer.sliders import is_logarithmic
from vibrojax.identification.as_measured import sensor_of
from vibrojax.identification.fitted_data import described_amplitude
from vibrojax.identification.sensor import Sensor
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.reading import read_measured_curve
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.variables import label_of, with_unit
from vibrojax.stepping.choice import is_exact

QUANTITIES = {
    "amplitude_ratio": "amplitude",
    "peak_ratio": "peak",
    "rms_ratio": "rms",
    "first_harmonic_ratio": "first_harmonic",
    "contact_force": "amplitude",
}
"""What is drawn, and what of the displacement a sensor then shows."""
MARGIN = 0.03


@validated
def explore(
    make_system: Callable[..., AbstractSystem] | AbstractSystem,
    *,
    frequency_ratio: Range | None = None,
    frequency: Range | None = None,
    variable: str = "amplitude_ratio",
    measured: Any = None,
    **numbers: Any,
) -> Explorer:
    """Show the frequency response of a rig with a slider for each of its numbers.

        vj.explore(rig, gap=vj.Range(0.1e-3, 1e-3), stiffness=vj.Range(500, 50000), taper=0.3)

    Drawn are the branch of periodic motions of period 1 (stable and unstable parts), what slow
    sweeps of both directions follow of it with their jumps, and of the orbit under the cursor the
    phase portrait and the contact force. The branch is the condensed harmonic balance with 128
    samples, with stability from the exact propagators where stops are linear: 1e-4 and better, and
    a few hundredths of a second for any numbers once compiled (half a minute). `Explorer.branch()`
    gives the exact one.

    In a notebook with ipywidgets the last line of a cell shows the sliders (ipyevents makes the
    picture follow the mouse); without a running kernel, and without ipywidgets, it is a still
    picture with a note.

    Parameters:
        make_system: a function (not a system) from named numbers to a system with stops.
        frequency_ratio, frequency: `vj.Range(low, high)` of the drive frequency, as ratio to the
            first natural frequency of the unstopped system, or in Hz; one of the two. By default
            the range of the measured points, or 0.8 to 1.4 times the first natural frequency.
        variable: what is drawn against frequency: `amplitude_ratio`, `peak_ratio`, `rms_ratio`,
            `first_harmonic_ratio`, or `contact_force` (N). With `measured` it is what was measured.
        measured: a `MeasuredCurve`, or anything that `read_measured_curve` reads, to be laid over.
        numbers: arguments of the function, in SI units: `vj.Range(low, high)` makes a slider, which
            starts at the function's default or in the middle; `vj.Range(low, high, start)` says
            where. Ranges over more than a factor of 20 are logarithmic. Anything else is fixed.

    Returns an `Explorer`. Raises `ValueError` for a name that is not an argument of the function,
    numbers that the function refuses at either end of a range, no slider at all, or a system that
    `continue_response` cannot follow.
    """
    if isinstance(make_system, AbstractSystem) or not callable(make_system):
        raise ValueError(
            "make_system must be a function from named numbers to a system, got "
            f"{in_short(make_system)}. Write def rig(gap=4e-4): ... and pass rig."
        )
    check_choice("variable", variable, tuple(QUANTITIES))
    for name, value in numbers.items():
        if is_list(value) or isinstance(value, Zipped):
            raise ValueError(
                f"{name} must be a range, vj.Range(low, high), which makes a slider, or one fixed "
                f"value, got {in_short(value)}."
            )
    named = arguments_of(make_system, (), numbers, with_ranges=True)
    if not named.ranges:
        raise ValueError(
            "Give at least one number a range, such as gap=vj.Range(1e-4, 1e-3): that makes its "
            "slider."
        )
    sliders = {n: _slider(r, default_of(make_system, n)) for n, r in named.ranges.items()}
    points = _measurements(measured)
    axis, over = _range(frequency_ratio, frequency, points)
    starts = {name: slider.start for name, slider in sliders.items()}
    sample = None
    for name, slider in sliders.items():
        for end in (slider.low, slider.high):
            sample = made_by(make_system, named.fixed | starts | {name: end})
            check_continued(sample)
    assert sample is not None
    force, sensor = variable == "contact_force", Sensor(quantity=QUANTITIES[variable])
    y_label = label_of(variable, sample.drive.reference[1])
    if points:
        force, y_label = points[0].amplitude is None, label_of("contact_force")
        if not force:
            described = described_amplitude(points[0])
            y_label = with_unit(described["long_name"], described["units"])
            sensor = sensor_of(points[0])
    sensor = dataclasses.replace(sensor, with_force=True, with_phase=False)
    tracer = CurveTracer(
        make_system, named.fixed, axis, over.low, over.high, sensor, force, is_exact(sample)
    )
    return Explorer(tracer, sliders, (label_of(axis), y_label), points)


def _slider(given: Range, default: Any) -> Range:
    """Choose where a slider starts, if the range does not say."""
    start = given.start
    if start is None and isinstance(default, int | float) and given.low <= default <= given.high:
        start = float(default)
    if start is None:
        low, high = given.low, given.high
        start = float(np.sqrt(low * high)) if is_logarithmic(given) else (low + high) / 2
    return dataclasses.replace(given, start=start)


def _measurements(measured: Any) -> tuple[MeasuredCurve, ...]:
    if measured is None:
        return ()
    read = measured if isinstance(measured, MeasuredCurve) else read_measured_curve(measured)
    curves = (read,) if isinstance(read, MeasuredCurve) else tuple(read)
    kinds = {
        (m.frequency_name, m.quantity, m.signal, m.is_ratio, m.frame, m.amplitude is None)
        for m in curves
    }
    if len(kinds) > 1:
        raise ValueError(
            "measured: all curves must be of one quantity and one kind of frequency, to be drawn "
            "on one axis. Pass those that are."
        )
    return curves


def _range(
    frequency_ratio: Range | None, frequency: Range | None, measured: tuple[MeasuredCurve, ...]
) -> tuple[str, Range]:
    """Name and range of the axis of frequencies."""
    if frequency_ratio is not None and frequency is not None:
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    axis = "frequency" if frequency is not None else "frequency_ratio"
    given = frequency_ratio if frequency is None else frequency
    if given is None and measured:
        every = np.concatenate([m.frequency for m in measured])
        low, high = float(every.min()), float(every.max())
        edge = MARGIN * (high - low) or MARGIN * low
        return measured[0].frequency_name, Range(max(low - edge, low / 2), high + edge)
    if measured and axis != measured[0].frequency_name:
        own = measured[0].frequency_name
        raise ValueError(f"The measured points are over {own}: give {own}=vj.Range(low, high).")
    given = given or Range(0.8, 1.4)
    check_positive(axis, given.low, "(ratio)" if axis == "frequency_ratio" else "Hz")
    return axis, given
