"""A measured curve as a fit has it: what its sensor shows, how well, and at which drive."""

from collections.abc import Sequence

import numpy as np

from vibrojax.identification.sensor import Sensor
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.kinds import ORDERS
from vibrojax.measured.noise import lever

SPACING = 0.03
"""Of drive levels at which curves are traced, relative: a motion near one is a guess near it."""
MOST_LEVELS = 16


def sensor_of(measured: MeasuredCurve) -> Sensor:
    """Return the sensor that shows what was measured."""
    return Sensor(
        quantity=measured.quantity if measured.amplitude is not None else None,
        signal=measured.signal,
        is_ratio=measured.is_ratio,
        absolute=measured.frame == "absolute",
        with_force=measured.contact_force is not None,
        with_phase=measured.phase is not None,
    )


def order_of(measured: MeasuredCurve) -> int:
    """Return which derivative of the force or the displacement of the base was measured."""
    return ORDERS.get(measured.drive_signal, 0)


def channels_of(measured: MeasuredCurve) -> np.ndarray:
    """Return what the sensor shows at every point (points by channels)."""
    phase = measured.phase
    if phase is not None:  # ahead of the displacement, not of its derivative
        phase = phase + order_of(measured) * np.pi / 2
    return _columns(measured.amplitude, phase, measured.contact_force)


def deviations_of(measured: MeasuredCurve) -> np.ndarray:
    """Return the standard deviations of the channels, as `seen_from` has them."""
    noise, across = measured.noise(), None
    if noise.phase is not None and measured.amplitude is not None:
        arm = lever(measured.amplitude) if sensor_of(measured).is_complex else 1.0
        across = noise.phase * arm
    return _columns(noise.amplitude, across, noise.contact_force)


def _columns(*channels: np.ndarray | None) -> np.ndarray:
    return np.stack([c for c in channels if c is not None], axis=1)


def drive_of_rig(measured: MeasuredCurve) -> np.ndarray | None:
    """Return the drive amplitude at every point as a rig has it: N, or m of the base."""
    if measured.drive_amplitude is None:
        return None
    rate = 2 * np.pi * measured.frequency  # only of frequencies in Hz is there a derivative
    return measured.drive_amplitude / rate ** order_of(measured)


def drive_levels(drive: np.ndarray) -> np.ndarray:
    """Return a few drive amplitudes, evenly in the logarithm, of which one is near each point's."""
    sizes = np.log(drive.ravel())
    low, span = sizes.min(), np.ptp(sizes)
    count = int(np.clip(np.ceil(span / SPACING), 1, MOST_LEVELS))
    part = np.floor((sizes - low) / (span or 1.0) * count).astype(int)
    return np.exp(low + (np.unique(np.minimum(part, count - 1)) + 0.5) * span / count)


def check_alike(repetitions: Sequence[MeasuredCurve]) -> None:
    """Raise `ValueError` unless the curves show the same, of the same kind of drive."""
    kinds = {(sensor_of(m), m.drive_amplitude is None, m.drive_signal) for m in repetitions}
    if len(kinds) > 1:
        raise ValueError(
            "measured: curves that are fitted one by one (together=False) must have the same "
            "quantities, phase and drive. Fit those that are alike in a call."
        )
