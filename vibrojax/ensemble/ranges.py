"""Ranges of a number: what is followed, moved or searched, where a list would be an axis."""

import dataclasses
from typing import Any

from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated


@validated
@dataclasses.dataclass(frozen=True)
class Range:
    """All numbers from `low` to `high`, where a list would be some of them.

        vj.continue_response(rig, frequency_ratio=vj.Range(0.85, 1.31))
        vj.explore(rig, gap=vj.Range(1e-4, 1e-3))

    Raises `ValueError` for a range without width, or a start outside of it.
    """

    low: float
    """Least value."""
    high: float
    """Largest value."""
    start: float | None = None
    """Where a slider or the first branch of `fold_curves` begins; None: as they say."""

    def __post_init__(self) -> None:
        """Refuse a range without width."""
        if not self.low < self.high:
            raise ValueError(
                f"Range({self.low!r}, {self.high!r}) is a range without width: give the low end "
                "first, then a higher one."
            )
        if self.start is not None and not self.low <= self.start <= self.high:
            raise ValueError(
                f"start must be from {self.low:g} to {self.high:g}, the ends of its Range, got "
                f"{self.start!r}."
            )
        for name in ("low", "high", "start"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else float(value))


def check_range_of(name: str, value: Any) -> Range:
    """Return the range that was given; refuse all else with a `ValueError`."""
    if not isinstance(value, Range):
        raise ValueError(
            f"{name} must be a range, vj.Range(low, high), got {in_short(value)}. (A list is an "
            "axis, one answer for each of its values.)"
        )
    return value
