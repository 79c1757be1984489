"""An interactive frequency response: sliders for the numbers of a rig."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_choice, check_names
from vibrojax._tools.described import in_short
from vibrojax._tools.kinds import is_list
from vibrojax._tools.signatures import validated
from vibrojax.branches.along import along_of
from vibrojax.ensemble.arguments import default_of
from vibrojax.explorer.explorer import Explorer, Measurement
from vibrojax.explorer.live_curve import CurveTracer
from vibrojax.explorer.sliders import Slider
from vibrojax.identification.curve_misfit import sensor_of
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
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    variable: str = "amplitude_ratio",
    measured: Any = None,
    **numbers: Any,
) -> Explorer:
    """Show the frequency response of a rig with a slider for each of its numbers.

        vj.explore(rig, gap=(0.1e-3, 1e-3), stiffness=(500, 50000), taper=0.3)

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
        frequency_ratio, frequency: range (low, high) of the drive frequency, as ratio to the first
            natural frequency of the unstopped system, or in Hz; one of the two. By default the
            range of the measured points, or (0.8, 1.4) times the first natural frequency.
        variable: what is drawn against frequency: `amplitude_ratio`, `peak_ratio`, `rms_ratio`,
            `first_harmonic_ratio`, or `contact_force` (N). With `measured` it is what was measured.
        measured: a `MeasuredCurve`, or anything that `read_measured_curve` reads, to be laid over.
        numbers: arguments of the function, in SI units: (low, high) is the range of a slider, which
            starts at the function's default or in the middle; (low, high, start) says where.
            Ranges over more than a factor of 20 are logarithmic. Anything else is fixed.

    Returns an `Explorer`. Raises `ValueError` for a name that is not an argument of the function, a
    range without width, numbers that the function refuses at either end of a range, no slider at
    all, or a system that `continue_response` cannot follow.
    """
    if isinstance(make_system, AbstractSystem) or not callable(make_system):
        raise ValueError(
            "make_system must be a function from named numbers to a system, got "
            f"{in_short(make_system)}. Write def rig(gap=4e-4): ... and pass rig."
        )
    check_choice("variable", variable, tuple(QUANTITIES))
    sliders = {n: _slider(make_system, n, v) for n, v in numbers.items() if isinstance(v, tuple)}
    fixed = {name: value for name, value in numbers.items() if name not in sliders}
    if not sliders:
        raise ValueError(
            "Give at least one number a range (low, high), such as gap=(1e-4, 1e-3): that makes "
            "its slider."
        )
    for name, value in fixed.items():
        if is_list(value):
            raise ValueError(
                f"{name} must be a range (low, high), which makes a slider, or one fixed value, "
                f"got {in_short(value)}."
            )
    points = _measurements(measured)
    axis, low, high = _range(frequency_ratio, frequency, points)
    starts = {name: slider.value for name, slider in sliders.items()}
    sample = None
    for name, slider in sliders.items():
        for end in (slider.low, slider.high):
            at = fixed | starts | {name: end}
            sample = along_of(make_system, *_frequencies(axis, low, high), at).sample
    assert sample is not None
    force = variable == "contact_force"
    sensor = Sensor(quantity=QUANTITIES[variable], with_force=True)
    y_label = label_of(variable, sample.drive.reference[1])
    if points:
        first = points[0]
        force = first.amplitude is None
        y_label = label_of("contact_force")
        if not force:
            described = described_amplitude(first)
            y_label = with_unit(described["long_name"], described["units"])
            sensor = dataclasses.replace(sensor_of(first), with_force=True)
    drawn = tuple(
        Measurement(m, np.asarray(m.contact_force if force else m.amplitude)) for m in points
    )
    tracer = CurveTracer(make_system, fixed, axis, low, high, sensor, is_exact(sample))
    return Explorer(tracer, sliders, (label_of(axis), y_label), force, drawn)


def _frequencies(axis: str, low: float, high: float) -> tuple[Any, Any]:
    """Return the two arguments of a continuation."""
    return ((low, high), None) if axis == "frequency_ratio" else (None, (low, high))


def _slider(make_system: Callable[..., AbstractSystem], name: str, value: tuple) -> Slider:
    try:
        given = [float(v) for v in value]
    except (TypeError, ValueError):
        given = []
    if not 2 <= len(given) <= 3 or not np.isfinite(given).all() or not given[0] < given[1]:
        raise ValueError(
            f"{name} must be a range (low, high) or (low, high, start) of finite numbers with low "
            f"below high, got {in_short(value)}."
        )
    low, high, *start = given
    check_names(make_system, [name])
    default = default_of(make_system, name)
    if not start and isinstance(default, int | float):
        start = [float(default)]
    middle = np.sqrt(low * high) if Slider(low, high, low).is_logarithmic else (low + high) / 2
    chosen = start[0] if start and low <= start[0] <= high else float(middle)
    return Slider(low, high, chosen)


def _measurements(measured: Any) -> tuple[MeasuredCurve, ...]:
    if measured is None:
        return ()
    read = measured if isinstance(measured, MeasuredCurve) else read_measured_curve(measured)
    curves = (read,) if isinstance(read, MeasuredCurve) else tuple(read)
    first = curves[0]

    def kind(m: MeasuredCurve) -> tuple[Any, ...]:
        return (m.frequency_name, m.quantity, m.signal, m.is_ratio, m.frame, m.amplitude is None)

    for curve in curves:
        if kind(curve) != kind(first):
            raise ValueError(
                "measured: all curves must be of one quantity and one kind of frequency, to be "
                "drawn on one axis. Pass those that are."
            )
    return curves


def _range(
    frequency_ratio: Any, frequency: Any, measured: tuple[MeasuredCurve, ...]
) -> tuple[str, float, float]:
    if frequency_ratio is not None and frequency is not None:
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    axis = "frequency" if frequency is not None else "frequency_ratio"
    given = frequency if frequency is not None else frequency_ratio
    if measured:
        own = measured[0].frequency_name
        if given is not None and axis != own:
            raise ValueError(f"The measured points are over {own}: give {own}=(low, high).")
        if given is None:
            all_of_them = np.concatenate([m.frequency for m in measured])
            low, high = float(all_of_them.min()), float(all_of_them.max())
            edge = MARGIN * (high - low) or MARGIN * low
            return own, max(low - edge, low / 2), high + edge
    if given is None:
        given = (0.8, 1.4)
    values = np.asarray(given, float).reshape(-1)
    if values.shape != (2,) or not np.isfinite(values).all() or not 0 < values[0] < values[1]:
        raise ValueError(
            f"{axis} must be a range (low, high) above 0 with low below high, "
            f"got {in_short(given)}."
        )
    return axis, float(values[0]), float(values[1])
