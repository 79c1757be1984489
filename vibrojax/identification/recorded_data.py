"""Measured histories as arrays, lane by lane, with which motions are compared."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax._tools.programs import rounded_up
from vibrojax.identification.history_motions import Seen
from vibrojax.measured.history import MeasuredHistory, Observations

DIGITS = 4
"""Counts are rounded up to so many binary digits, by an eighth at most."""


class Data(NamedTuple):
    """What each lane is compared with."""

    seen: Seen
    values: Float[np.ndarray, "lanes observations"]
    deviation: Float[np.ndarray, "lanes observations"]
    """Infinite where a place is filled up."""

    @property
    def span(self) -> Float[np.ndarray, " lanes"]:
        """Length of the records, s."""
        return np.ptp(self.seen.time, axis=1)

    def standardised(self, signals: np.ndarray) -> np.ndarray:
        """Divide signals, whose second axis is that of the residuals, by their deviations."""
        each = self.deviation
        return signals / each.reshape(each.shape + (1,) * (signals.ndim - 2))

    def of_channel(self, lane: int, channel: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return times (s), values and deviations of one channel."""
        own = (self.seen.channel[lane] == channel) & np.isfinite(self.deviation[lane])
        time = np.asarray(self.seen.time)[lane, self.seen.sample[lane, own]]
        return time, self.values[lane, own], self.deviation[lane, own]

    def misfit_of_shifts(self, lane: int, signals, grid, delays, shifts, wraps: bool):
        """Sum of squares for every shift (cells of the grid) of signals (channels, cells).

        `grid` is the cells in a second; far samples are left out where there are many.
        """
        cells = signals.shape[1]
        total = np.zeros(len(shifts))
        for k, signal in enumerate(signals):
            time, values, deviation = self.of_channel(lane, k)
            keep = slice(None, None, max(1, len(time) // 1000))
            at = (time[None, keep] - delays[k]) * grid + shifts[:, None]
            seen = np.interp(at, np.arange(cells), signal, period=cells if wraps else None)
            total += np.sum(((values[keep] - seen) / deviation[keep]) ** 2, axis=1)
        return np.where(np.isfinite(total), total, np.inf)


def data_of(
    repetitions: Sequence[MeasuredHistory], found: Sequence[Observations], delayed: bool
) -> Data:
    """Put together what is compared; filled up to round numbers, so that few are compiled."""
    count = rounded_up(len(found[0].value), DIGITS)
    lanes = []
    for history, one in zip(repetitions, found, strict=True):
        deviations = history.noise().deviation
        deviation = np.array([deviations[name] for name in history.channels])[one.channel]
        if delayed:  # every observation at a time of its own
            sample, at = np.arange(len(one.value)), one.sample
            time, owner = history.time[at], one.channel
        else:
            at, sample = np.unique(one.sample, return_inverse=True)
            time, owner = history.time[at], np.zeros(len(at), int)
        lanes.append((time, owner, one.channel, sample, one.value, deviation))
    # Repetitions may have their blanks at other places.
    times = rounded_up(max(len(lane[0]) for lane in lanes), DIGITS)

    def filled(part: int, size: int) -> np.ndarray:
        own = [lane[part] for lane in lanes]
        return np.stack([np.pad(a, (0, size - len(a)), mode="edge") for a in own])

    seen = Seen(*(filled(part, size) for part, size in enumerate((times, times, count, count))))
    deviation = filled(5, count)
    deviation[:, len(found[0].value) :] = np.inf
    return Data(seen, filled(4, count), deviation)


def records_of(
    repetitions: Sequence[MeasuredHistory],
) -> Float[np.ndarray, "repetitions 2 samples"]:
    """Times (s) and values of the drives as measured, as far as they are needed."""
    found = []
    for history in repetitions:
        record = np.zeros((2, 0))
        if history.waveform is not None:
            record = np.stack([history.waveform.time, history.waveform.values])
            last = float(history.windowed().time[-1])
            record = record[:, : int(np.searchsorted(record[0], last)) + 1]
        found.append(record)
    # Shorter ones go on as they end.
    longest = max(record.shape[1] for record in found)
    return np.stack([np.pad(r, ((0, 0), (0, longest - r.shape[1])), mode="edge") for r in found])


def on_samples(history: MeasuredHistory) -> bool:
    """Whether a history has its samples together with those of its drive, equally spaced."""
    waveform, sampled = history.waveform, history.windowed().time
    if waveform is None or not waveform.equally_spaced:
        return False
    time = np.asarray(waveform.time)
    place = (sampled - time[0]) / (time[-1] - time[0]) * (time.size - 1)
    known = place < time.size - 0.5
    return bool(known.all() and np.max(np.abs(place - np.round(place))) < 1e-3)
