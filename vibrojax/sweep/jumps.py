"""Jumps of a hysteretic frequency response."""

import numpy as np

DISTINCT = 0.1
"""Relative difference of amplitude from which two branches are different."""


class Jumps:
    """The jump of each direction: between which points, which way, in what bracket.

    Arrays have the shape (..., directions). `before` is the index (in ascending frequency) of the
    last point ahead of the jump, -1 where there is none; a bracket is (before, after).
    """

    def __init__(self, before: np.ndarray, after: np.ndarray, rises: np.ndarray):
        self.before, self.after, self.rises = before, after, rises
        self.exists = before >= 0
        self.bracket = np.full((*before.shape, 2), np.nan)

    def any(self) -> bool:
        """Whether any lane jumps."""
        return bool(self.exists.any())

    def fill_brackets(self, frequencies: np.ndarray) -> None:
        """Bracket every jump by its two grid points."""
        self.set_brackets(frequencies[self.before], frequencies[self.after])

    def set_brackets(self, before: np.ndarray, after: np.ndarray) -> None:
        """Give every existing jump a bracket."""
        both = np.stack([before, after], axis=-1)
        self.bracket = np.where(self.exists[..., None], both, np.nan)

    def up_and_down(self) -> tuple[np.ndarray, np.ndarray]:
        """Return brackets (..., 2) of the jump up and the jump down, low end first."""
        ordered = np.sort(self.bracket, axis=-1)

        def first(wanted: np.ndarray) -> np.ndarray:
            found = np.full((*ordered.shape[:-2], 2), np.nan)
            for k in reversed(range(ordered.shape[-2])):
                found = np.where(wanted[..., k, None], ordered[..., k, :], found)
            return found

        return first(self.exists & self.rises), first(self.exists & ~self.rises)


def find_jumps(amplitude: np.ndarray, directions: tuple[str, ...]) -> Jumps:
    """Find the jump of each direction in amplitudes of shape (..., directions, frequencies).

    A jump leaves a branch that the other direction is not on and lands where the other direction
    is: the largest such change. With one direction alone, the largest change that is out of all
    proportion to its neighbours.
    """
    *lanes, n = amplitude.shape
    before, after, rises = np.full(lanes, -1), np.full(lanes, -1), np.zeros(lanes, bool)
    for lane in np.ndindex(*lanes):
        *outer, k = lane
        own = amplitude[lane]
        ahead, behind = np.arange(n - 1), np.arange(1, n)
        if directions[k] == "backward":
            ahead, behind = behind, ahead
        change = own[behind] - own[ahead]
        size = np.abs(change)
        if len(directions) == 2:
            other = amplitude[(*outer, 1 - k)]
            larger = np.maximum(np.maximum(own, other), 1e-300)
            apart = np.abs(own - other) > DISTINCT * larger
            jumps = apart[ahead] & ~apart[behind] & (size > DISTINCT * larger[ahead])
        else:
            typical = np.median(size) if n > 2 else 0.0
            largest = np.maximum(own[ahead], own[behind])
            jumps = (size > 10 * typical) & (size > 3 * DISTINCT * largest)
        size = np.where(jumps & np.isfinite(size), size, -1.0)
        if n > 1 and size.max() > 0:
            at = int(np.argmax(size))
            before[lane], after[lane], rises[lane] = ahead[at], behind[at], change[at] > 0
    return Jumps(before, after, rises)
