"""One measurement and what the fitted rig gives for it, as a dataset."""

from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax.identification.as_measured import order_of
from vibrojax.identification.sensor import wrapped
from vibrojax.identification.trial_rigs import Curve
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.history import CHANNELS, MeasuredHistory
from vibrojax.measured.kinds import DRIVES
from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray

WORDS = {
    "amplitude": "amplitude (max\u00a0−\u00a0min)/2",
    "peak": "peak max |y|",
    "peak_to_peak": "peak to peak",
    "rms": "root mean square",
    "first_harmonic": "first harmonic",
    "mean": "mean",
}


def described_amplitude(curve: MeasuredCurve) -> dict[str, str]:
    """Return unit and long name of the amplitudes of a measured curve."""
    signal = f"{'absolute ' * (curve.frame == 'absolute')}{curve.signal}"
    over = " over drive amplitude" * curve.is_ratio
    long_name = f"{signal.capitalize()}, {WORDS[curve.quantity]}{over}"
    return {"units": curve.unit, "long_name": long_name}


def fitted_data(
    measured: MeasuredCurve | MeasuredHistory,
    residual: np.ndarray,
    curve: Curve | None = None,
    influence: np.ndarray | None = None,
    fitted: tuple[np.ndarray, np.ndarray] | None = None,
) -> "xarray.Dataset":
    """Return points and residuals over `point`, and of a curve the fitted one and its folds.

    `influence` (points by numbers): by how many standard deviations each number would move without
    a point. `fitted`: frequencies and channels of the nearest points, at the drive of each. Where
    that was measured, the curve is the one at its median.
    """
    import xarray

    data: dict[str, Any] = {}

    def put(name: str, dimension: str, values: Any, long_name: str, units: str = "1") -> None:
        data[name] = dimension, values, {"long_name": long_name, "units": units}

    put("residual", "point", residual, "Distance over standard deviation")
    if influence is not None:
        words = "Change of the number without the point over its deviation"
        data["influence"] = ("point", "parameter"), influence, {"long_name": words, "units": "1"}
    if isinstance(measured, MeasuredHistory):
        seen = measured.observations()
        put("measured_time", "point", measured.time[seen.sample], "Time", "s")
        names = np.array(list(measured.channels))[seen.channel]
        put("channel", "point", names, "Channel measured")
        deviation = measured.noise().deviation
        shown = seen.value - residual * np.array([deviation[name] for name in names])
        put("unit", "point", [CHANNELS[name] for name in names], "Unit of the signals")
        put("measured_value", "point", seen.value, "Signal measured", "by channel")
        put("fitted_value", "point", shown, "Signal fitted, as the sensor shows it", "by channel")
        return xarray.Dataset(data)
    assert curve is not None
    if measured.drive_amplitude is not None:
        curve = curve.at_drive(float(np.median(measured.drive_amplitude)))
        about = {"units": DRIVES.get(measured.drive_signal, "N or m")}
        about["long_name"] = "Drive amplitude as measured"
        data["drive_amplitude"] = "point", measured.drive_amplitude, about
    at = described_as(measured.frequency_name)
    data["measured_frequency"] = "point", measured.frequency, at
    if fitted is not None:
        data["fitted_frequency"] = "point", fitted[0], at
    put("direction", "point", measured.direction, "Sweep (1: forward, -1: backward)")
    data["curve_frequency"] = "curve_point", curve.frequency, at
    flags = {"unstable": "Whether it lies between folds", "continues": "Whether the next joins it"}
    for name, long_name in flags.items():
        put(f"curve_{name}", "curve_point", getattr(curve, name).astype(np.int8), long_name)
    ways = {"forward": curve.turning(1), "backward": curve.turning(-1)}
    places = np.concatenate([curve.frequency[turns] for turns in ways.values()])
    data["fold"] = "fold_number", places, at
    names = np.repeat(list(ways), [turns.sum() for turns in ways.values()])
    put("fold_direction", "fold_number", names, "Sweep that jumps there")
    channels = {}
    if measured.amplitude is not None:
        channels[measured.quantity] = measured.amplitude, described_amplitude(measured)
    if measured.phase is not None:
        channels["phase"] = (
            measured.phase,
            {"units": "rad", "long_name": "Phase ahead of the drive"},
        )
    if measured.contact_force is not None:
        channels["contact_force"] = measured.contact_force, described_as("contact_force")
    for k, (name, (values, about)) in enumerate(channels.items()):
        columns = {"measured": ("point", values), "curve": ("curve_point", curve.channels[:, k])}
        if fitted is not None:
            columns["fitted"] = "point", fitted[1][:, k]
        for kind, (dimension, column) in columns.items():
            if name == "phase":  # as measured, ahead of what the drive was measured as
                behind = 0.0 if kind == "measured" else order_of(measured) * np.pi / 2
                column = _on_one_turn(column - behind, values)
            data[f"{kind}_{name}"] = dimension, column, about
    return xarray.Dataset(data)


def _on_one_turn(phase: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return phases (rad) within half a turn of the middle of the measured ones."""
    middle = np.angle(np.nanmean(np.exp(1j * measured)))
    return middle + wrapped(phase - middle)
