"""Numbers of a curve as the paper reads them: of the forward sweep, over settled points."""

from typing import Any

import numpy as np

import vibrojax as vj

Curve = dict[str, Any]


def _settled_forward(curve: Curve) -> np.ndarray:
    settled = np.asarray(curve["status"][0]) == vj.Status.settled.value
    return np.where(settled, np.asarray(curve["peak_ratio"][0]), np.nan)


def settled_peak_ratio(curve: Curve) -> float:
    """Highest max|y tip| over the drive amplitude, the paper's amplitude ratio."""
    return float(np.nanmax(_settled_forward(curve), initial=-np.inf))


def settled_shift(curve: Curve) -> float:
    """Frequency ratio of that peak, minus 1."""
    heights = np.nan_to_num(_settled_forward(curve), nan=-np.inf)
    return float(curve["frequency_ratio"][np.argmax(heights)] - 1.0)


def peak_ratio_area(curve: Curve) -> float:
    """Area between the peak ratios of the two directions."""
    forward, backward = np.asarray(curve["peak_ratio"])
    return float(np.trapezoid(np.abs(forward - backward), curve["frequency_ratio"]))
