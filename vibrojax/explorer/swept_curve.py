"""What slow sweeps of both directions would follow of a branch, and where they jump."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.branches.continuation import Ending
from vibrojax.explorer.live_curve import LiveCurve

MOST_PIECES = 60


class Sweep(NamedTuple):
    """A slow sweep along the stable parts of a branch."""

    pieces: list[Float[np.ndarray, "points 2"]]
    """Frequency and response, in the order of the sweep."""
    jumps: list[Float[np.ndarray, "2 2"]]
    """Frequency and response before and after each jump."""

    def places(self, frequencies: Float[np.ndarray, " places"]) -> Float[np.ndarray, "some 2"]:
        """Interpolate at those of the frequencies that the sweep passes."""
        found = [np.zeros((0, 2))]
        for piece in self.pieces:
            x, y = piece[np.argsort(piece[:, 0], kind="stable")].T
            inside = frequencies[(frequencies >= x[0]) & (frequencies <= x[-1])]
            found.append(np.stack([inside, np.interp(inside, x, y)], axis=1))
        return np.concatenate(found)


def swept_curve(curve: LiveCurve, way: int) -> Sweep:
    """Follow a branch upwards (`way` 1) or downwards (-1) in frequency.

    A sweep stays on the branch while it is stable. At a fold it goes to the nearest stable part
    (along the branch) at that frequency. Where stability is lost without a fold the motion has
    another period, and the sweep goes on where the branch is stable again.
    """
    frequency, response, stable = curve.frequency, curve.response, curve.stable
    pieces, jumps = [], []
    if way < 0 and curve.ending is not Ending.completed:
        return Sweep(pieces, jumps)  # where the range ends, the branch was not found
    last = int(np.argmin(np.where(stable, way * frequency, np.inf))) if stable.any() else None
    while last is not None and len(pieces) < MOST_PIECES:
        index, at_fold = _onwards(frequency, stable, last, way)
        if len(index) > 1:
            pieces.append(np.stack([frequency[index], response[index]], axis=1))
        last = index[-1]
        if last in (0, len(frequency) - 1) and len(index) > 1:
            break  # an end of the range
        low = _landing(frequency, stable, last) if at_fold else None
        if low is None:
            last = _resumption(frequency, stable, last, way)
            continue
        high, here = low + 1, frequency[last]
        share = (here - frequency[low]) / (frequency[high] - frequency[low])
        arrived = response[low] + share * (response[high] - response[low])
        jumps.append(np.array([[here, response[last]], [here, arrived]]))
        last = high if way * (frequency[high] - frequency[low]) > 0 else low
    return Sweep(pieces, jumps)


def _onwards(frequency, stable, at: int, way: int) -> tuple[list[int], bool]:
    """Indices from a point on while the branch is stable and goes the way of the sweep.

    With them whether a fold ends them: whether the branch turns back before it is stable again.
    """
    count = len(frequency)

    def goes_on(k: int, step: int) -> bool:
        return 0 <= k + step < count and bool(way * (frequency[k + step] - frequency[k]) > 0)

    for step in (1, -1):
        index = [at]
        while goes_on(index[-1], step) and stable[index[-1] + step]:
            index.append(index[-1] + step)
        beyond = index[-1]
        while goes_on(beyond, step) and not stable[beyond + step]:
            beyond += step
        if len(index) > 1:
            return index, not goes_on(beyond, step)
    return [at], True


def _landing(frequency, stable, last: int) -> int | None:
    """Stable segment at the frequency of a point: the nearest along the branch, by its start."""
    here = frequency[last]
    before, after = frequency[:-1], frequency[1:]
    crossing = ((before - here) * (after - here) <= 0) & (before != after)
    segments = np.flatnonzero(crossing & stable[:-1] & stable[1:])
    segments = segments[(segments != last) & (segments + 1 != last)]
    return int(segments[np.argmin(abs(segments - last))]) if len(segments) else None


def _resumption(frequency, stable, last: int, way: int) -> int | None:
    """Nearest stable point along the branch beyond the frequency of a point."""
    beyond = np.flatnonzero(stable & (way * (frequency - frequency[last]) > 0))
    return int(beyond[np.argmin(abs(beyond - last))]) if len(beyond) else None
