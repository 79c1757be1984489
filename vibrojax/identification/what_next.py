"""Which further measurement would say most about a number."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Candidate:
    """One further point that could be measured."""

    frequency: float
    amplitude: float
    """What would be measured there, in the unit of the curve."""
    branch: str
    """`stable`, or `between folds` (which no sweep reaches)."""
    changes: dict[str, float]
    """Arguments of the rig that differ from the fitted one."""
    deviation: float
    """Standard deviation of the number after one such point, over what it is now."""


@dataclass(frozen=True, repr=False)
class WhatNext:
    """Further points, the most informative first."""

    name: str
    frequency_name: str
    candidates: tuple[Candidate, ...]
    points: int
    """How many such points would halve the deviation, at the best candidate."""

    @property
    def best(self) -> Candidate:
        """The most informative point."""
        return self.candidates[0]

    def by_change(self) -> dict[tuple[tuple[str, float], ...], Candidate]:
        """The most informative point of every rig that could be measured."""
        best: dict[tuple[tuple[str, float], ...], Candidate] = {}
        for c in self.candidates:
            best.setdefault(tuple(c.changes.items()), c)
        return best

    def __repr__(self) -> str:
        lines = [f"WhatNext(to sharpen {self.name}, the most informative points)"]
        for c in self.candidates[:5]:
            rig = "".join(f", {n} {v:g}" for n, v in c.changes.items())
            lines.append(
                f"  {self.frequency_name} {c.frequency:.5g}{rig}: amplitude {c.amplitude:.4g}, "
                f"leaves {100 * c.deviation:.1f} % of the standard deviation"
            )
        count = "1 point" if self.points == 1 else f"{self.points} points"
        lines.append(f"  {count} at the first would halve it.")
        return "\n".join(lines)


def points_to_halve(information: float, variance: float) -> int:
    """Repeats of a point after which a standard deviation is half of what it was."""
    return int(np.ceil(3.0 / (information * variance))) if information > 0 else 10**9
