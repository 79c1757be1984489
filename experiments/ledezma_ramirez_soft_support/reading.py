"""What is read off histories alike: parts of them, their period, and an analyser's filter."""

import dataclasses

import numpy as np
from rig import GRAVITY
from scipy.signal import firwin

import vibrojax as vj


def part(history: vj.history.History, start: float, end: float) -> vj.history.History:
    """Return the samples of a history between two times, s."""
    time = np.asarray(history.time)
    inside = slice(*np.searchsorted(time, [start - 1e-9, end + 1e-9]))
    names = ("time", "coordinates", "rates", "accelerations", "contact_force", "memory")
    return dataclasses.replace(history, **{name: getattr(history, name)[inside] for name in names})


def peak_in_g(history: vj.history.History, start: float = 0.0) -> float:
    return abs(history.peak("acceleration", start=start).value) / GRAVITY


def through_analyser(history: vj.history.History, span: float = 500.0) -> np.ndarray:
    """Return the tip acceleration, g, as an analyser of this span (Hz) sees it.

    Its filter passes the span and stops what lies above 1.56 times it, where its samples (2.56 per
    second and Hz of span) would fold. Before the release the beam is held still.
    """
    rate = 1 / float(history.time[1] - history.time[0])
    taps = 2 * round(1.65 * rate / (0.56 * span)) + 1
    acceleration = np.asarray(history.acceleration()) / GRAVITY
    return np.convolve(acceleration, firwin(taps, 1.28 * span, fs=rate), "same")[: -(taps // 2)]


def period(history: vj.history.History, samples: int, longest: int = 8) -> int:
    """Return the period in drive periods of so many samples, 0 where there is none."""
    states = np.concatenate([history.coordinates[:, :2], history.rates[:, :2] / 100], axis=1)
    size = np.abs(states).max()
    for count in range(1, longest + 1):
        shift = count * samples
        if np.abs(states[shift:] - states[:-shift]).max() < 2e-3 * size:
            return count
    return 0
