"""Jumps of a hysteretic frequency response."""

import numpy as np

DISTINCT, MOVING = 0.01, 0.1
"""Relative difference of amplitude from which two motions are different; if one has not settled."""
STEEPER = 5.0
"""Change over those beside it that a jump has at the least: at a fold a curve turns up steeply."""


class Jumps:
    """The jump of each direction: between which points, which way, in what bracket.

    Arrays have the shape (..., directions). `before` is the index (in ascending frequency) of the
    last point ahead of the jump, -1 where there is none; a bracket is (before, after). `doubtful`
    are those that have to be looked at: the other direction may be the one that jumps, the other
    way, or the response may only be steep.
    """

    def __init__(
        self, before: np.ndarray, after: np.ndarray, rises: np.ndarray, doubtful: np.ndarray
    ):
        self.before, self.after, self.rises, self.doubtful = before, after, rises, doubtful
        self.exists = before >= 0
        self.bracket = np.full((*before.shape, 2), np.nan)
        self.state = np.empty((*before.shape, 0))
        """Of the motion next to the jump, before it."""
        self.free = np.zeros(before.shape, bool)
        """Whether that motion has no contact."""

    def begin(self, frequencies: np.ndarray, states: np.ndarray, force: np.ndarray) -> None:
        """Bracket every jump by its two grid points.

        States and largest contact forces are (..., directions, frequencies).
        """
        both = np.stack([frequencies[self.before], frequencies[self.after]], axis=-1)
        self.bracket = np.where(self.exists[..., None], both, np.nan)
        self.state = np.take_along_axis(states, self.before[..., None, None], axis=-2)[..., 0, :]
        self.free = np.take_along_axis(force, self.before[..., None], axis=-1)[..., 0] == 0

    def drop(self, there_is_none: np.ndarray) -> None:
        """Forget jumps that are none."""
        self.exists = self.exists & ~there_is_none
        self.bracket = np.where(self.exists[..., None], self.bracket, np.nan)

    @property
    def dropped(self) -> np.ndarray:
        """Which lanes had a jump that is none."""
        return (self.before >= 0) & ~self.exists

    def take(self, others: "Jumps") -> None:
        """Take others in the place of those that were dropped."""
        here = self.dropped
        for name in ("before", "after", "rises", "doubtful", "exists", "bracket", "state", "free"):
            new, old = getattr(others, name), getattr(self, name)
            chosen = here.reshape(here.shape + (1,) * (new.ndim - here.ndim))
            setattr(self, name, np.where(chosen, new, old))

    def up_and_down(self) -> tuple[np.ndarray, np.ndarray]:
        """Return brackets (..., 2) of the jump up and the jump down, low end first."""
        ordered = np.sort(self.bracket, axis=-1)

        def first(wanted: np.ndarray) -> np.ndarray:
            found = np.full((*ordered.shape[:-2], 2), np.nan)
            for k in reversed(range(ordered.shape[-2])):
                found = np.where(wanted[..., k, None], ordered[..., k, :], found)
            return found

        return first(self.exists & self.rises), first(self.exists & ~self.rises)


def find_jumps(
    amplitude: np.ndarray, settled: np.ndarray, allowed: np.ndarray, directions: tuple[str, ...]
) -> Jumps:
    """Find the jump of each direction in amplitudes of shape (..., directions, frequencies).

    A jump leaves a branch that the other direction is not on and lands where the other direction
    is: the largest such change, before those that are doubtful. With one direction alone, it is
    that which stands out most from those on both sides: doubtful, unless it is out of all
    proportion to them and to most. Doubtful ones are looked for ahead of `allowed` points.
    """
    *lanes, n = amplitude.shape
    before, after = np.full((2, *lanes), -1)
    rises, doubtful = np.zeros((2, *lanes), bool)
    for lane in np.ndindex(*lanes) if n > 1 else ():
        *outer, k = lane
        own = amplitude[lane]
        ahead, behind = np.arange(n - 1), np.arange(1, n)
        if directions[k] == "backward":
            ahead, behind = behind, ahead
        change = own[behind] - own[ahead]
        size = np.abs(change)
        if len(directions) == 2:
            twin = (*outer, 1 - k)
            other = amplitude[twin]
            least = np.where(settled[lane] & settled[twin], DISTINCT, MOVING)
            larger = least * np.maximum(np.maximum(own, other), 1e-300)
            apart = np.abs(own - other) > larger
            jumps = apart[ahead] & ~apart[behind] & (size > larger[ahead])
            stands_out = size
            doubts = size < np.abs(other[behind] - other[ahead])
        else:
            padded = np.pad(change, 1, constant_values=np.nan)
            beside = padded[:-2], padded[2:]
            usual = np.maximum(2 * np.median(size), np.fmax(*np.abs(beside)))
            least = np.where(settled[lane], DISTINCT, MOVING)
            larger = np.maximum(own[ahead], own[behind])
            doubts = ~(size > STEEPER * usual)
            jumps = size > np.maximum(*least[[ahead, behind]]) * larger
            out = np.fmax(np.fmin(*beside) - change, change - np.fmax(*beside))
            stands_out = np.where(np.isnan(out), size, out)
        jumps &= np.isfinite(change) & (allowed[lane][behind] | ~doubts)
        if np.any(jumps & ~doubts):
            jumps &= ~doubts
        if jumps.any():
            at = int(np.argmax(np.where(jumps, stands_out, -np.inf)))
            before[lane], after[lane], rises[lane] = ahead[at], behind[at], change[at] > 0
            doubtful[lane] = doubts[at]
    return Jumps(before, after, rises, doubtful)
