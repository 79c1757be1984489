"""How a lane ended, as a number in the result and a sentence for the reader."""

import enum


class Status(enum.Enum):
    """What became of a lane at a frequency."""

    settled = 0
    aperiodic = 1
    diverged = 2
    completed = 3
    unbounded = 4
    gave_up = 5

    @property
    def sentence(self) -> str:
        """The status in words."""
        return _SENTENCES[self]


LOST = Status.diverged.value, Status.unbounded.value, Status.gave_up.value
"""How points end that have no values."""

_SENTENCES = {
    Status.settled: "The motion is periodic and stable.",
    Status.aperiodic: (
        "No period up to the largest one looked for within the periods allowed: chaotic, "
        "quasi-periodic, of higher period, or still in a transient."
    ),
    Status.completed: "The integration reached its end.",
    Status.unbounded: (
        "An undamped mode is driven at its own frequency and no stop holds it: the motion grows "
        "without bound."
    ),
    Status.diverged: "The state stopped being finite.",
    Status.gave_up: (
        "Contacts came too fast to be gone through in the rounds allowed for a drive period: raise "
        "ExactContact(max_rounds=...), or march with another stepper where that does not help."
    ),
}
