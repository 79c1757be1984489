"""One measurement and what the fitted rig gives for it, as a dataset."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.history import MeasuredHistory
from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray

WORDS = {
    "amplitude": "amplitude (max\u00a0−\u00a0min)/2",
    "peak": "peak max |y|",
    "peak_to_peak": "peak to peak",
    "rms": "root mean square",
    "first_harmonic": "first harmonic",
}


@dataclass(frozen=True)
class Prediction:
    """One measurement as the fitted rig gives it."""

    residual: np.ndarray
    """Of a curve, distance of every point over its standard deviation, with the sign of the
    amplitude's part; of a history, of every channel and sample."""
    frequency: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Points along the fitted curve."""
    channels: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    """What the sensor shows there: amplitude, then contact force, where measured."""
    unstable: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    """Whether a point lies between two folds."""
    continues: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    """Whether the next point continues this one."""
    folds: dict[str, np.ndarray] = field(default_factory=dict)
    """Where a `forward` and a `backward` sweep would jump."""


def described_amplitude(curve: MeasuredCurve) -> dict[str, str]:
    """Return unit and long name of the amplitudes of a measured curve."""
    signal = f"{'absolute ' * (curve.frame == 'absolute')}{curve.signal}"
    over = " over drive amplitude" * curve.is_ratio
    long_name = f"{signal.capitalize()}, {WORDS[curve.quantity]}{over}"
    return {"units": curve.unit, "long_name": long_name}


def fitted_data(
    measured: MeasuredCurve | MeasuredHistory, prediction: Prediction
) -> "xarray.Dataset":
    """Return points and residuals over `point`, and of a curve the fitted one and its folds."""
    import xarray

    def of_points(values: Any, long_name: str, units: str = "1") -> Any:
        return "point", values, {"long_name": long_name, "units": units}

    data: dict[str, Any] = {
        "residual": of_points(prediction.residual, "Distance over standard deviation")
    }
    if isinstance(measured, MeasuredHistory):
        part = measured.windowed()
        times = np.tile(part.time, len(part.channels))
        data["measured_time"] = of_points(times, "Time", "s")
        data["channel"] = of_points(np.repeat(list(part.channels), part.size), "Channel measured")
        return xarray.Dataset(data)
    at = described_as(measured.frequency_name)
    data["measured_frequency"] = ("point", measured.frequency, at)
    data["direction"] = of_points(measured.direction, "Sweep (1: forward, -1: backward)")
    data["curve_frequency"] = ("curve_point", prediction.frequency, at)
    flags = {"unstable": "Whether it lies between folds", "continues": "Whether the next joins it"}
    for name, long_name in flags.items():
        about = {"long_name": long_name, "units": "1"}
        values = np.asarray(getattr(prediction, name)).astype(np.int8)
        data[f"curve_{name}"] = ("curve_point", values, about)
    folds = [(f, way) for way, many in prediction.folds.items() for f in many]
    data["fold"] = ("fold_number", np.array([f for f, _ in folds], float), at)
    sweep = {"long_name": "Sweep that jumps there", "units": "1"}
    data["fold_direction"] = ("fold_number", np.array([way for _, way in folds], str), sweep)
    for k, (name, values, about) in enumerate(_channels(measured)):
        data[f"measured_{name}"] = ("point", values, about)
        data[f"curve_{name}"] = ("curve_point", prediction.channels[:, k], about)
    return xarray.Dataset(data)


def _channels(curve: MeasuredCurve) -> list[tuple[str, np.ndarray, dict[str, str]]]:
    """Return name, measured values and description of the channels of a curve, in order."""
    rows = []
    if curve.amplitude is not None:
        rows.append((curve.quantity, curve.amplitude, described_amplitude(curve)))
    if curve.contact_force is not None:
        rows.append(("contact_force", curve.contact_force, described_as("contact_force")))
    return rows
