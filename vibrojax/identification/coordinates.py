"""Coordinates in which the numbers sought move: of a size with each other, within their bounds."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import check_choice
from vibrojax._tools.kinds import LARGEST
from vibrojax.ensemble.ranges import check_range_of

KINDS = ("log", "asinh", "linear")
Numbers = float | np.ndarray


class Coordinate(NamedTuple):
    """How one number moves."""

    argument: str
    """Of the function of the rig."""
    kind: str
    """`log`, `asinh` (linear below its scale, logarithmic above, so that 0 is reached) or
    `linear`."""
    scale: float
    low: float
    high: float
    guess: float
    label: str = ""
    """Of the measurement whose own number it is; empty where all share it."""

    @property
    def name(self) -> str:
        """Name of the number, `gap`, or `gap[label]` of one measurement."""
        return f"{self.argument}[{self.label}]" if self.label else self.argument

    def inside(self, number: Numbers) -> Numbers:
        """Coordinate of a number."""
        if self.kind == "log":
            return np.log(np.maximum(number, np.finfo(float).tiny))
        near = np.asarray(number, float) / self.scale
        return np.arcsinh(near) if self.kind == "asinh" else near

    def number(self, inside: Numbers) -> Numbers:
        """Number at a coordinate."""
        if self.kind == "linear":
            return self.scale * np.asarray(inside, float)
        inside = np.clip(inside, -700.0, 700.0)
        return np.exp(inside) if self.kind == "log" else self.scale * np.sinh(inside)

    def slope(self, inside: Numbers) -> Numbers:
        """Derivative of the number in its coordinate."""
        if self.kind == "log":
            return self.number(inside)
        inside = np.clip(inside, -700.0, 700.0)
        return self.scale * (np.cosh(inside) if self.kind == "asinh" else np.ones_like(inside))

    @property
    def limits(self) -> tuple[float, float]:
        """Bounds of the coordinate."""
        low = -np.inf if self.kind == "log" and self.low <= 0 else float(self.inside(self.low))
        return low, float(self.inside(self.high))


def coordinate_of(
    name: str, guess: float, bounds: Any = None, kind: str | None = None
) -> Coordinate:
    """Choose the coordinate of a number within its bounds, a `Range` (or None).

    Contact damping can be nothing at all, so it moves in asinh and stops at 0; what is above 0
    moves in log; what may have either sign, linearly. Raises `ValueError` for bounds that are none,
    a guess outside of them, or a kind that cannot hold them.
    """
    if not np.isfinite(guess):
        raise ValueError(f"guess of {name} must be a finite number, got {guess!r}.")
    low, high = -np.inf, np.inf
    if bounds is not None:
        # The largest number that a call takes stands for no end.
        ends = check_range_of(f"bounds of {name}", bounds)
        low, high = (e if abs(e) < LARGEST else np.sign(e) * np.inf for e in (ends.low, ends.high))
    damping = "damping" in name and "ratio" not in name
    if kind is None:
        above = guess > 0 and (bounds is None or low >= 0)
        kind = "asinh" if (damping and guess >= 0) else "log" if above else "linear"
    check_choice("transforms", kind, KINDS)
    if kind == "log" or (kind == "asinh" and bounds is None):
        low = max(low, 0.0)
    if kind == "log" and guess <= 0:
        raise ValueError(f"guess of {name} must be above 0 to move in log, got {guess:g}.")
    if not low <= guess <= high:
        raise ValueError(
            f"guess of {name} = {guess:g} lies outside its bounds, {low:g} to {high:g}: give a "
            "guess inside, or wider bounds."
        )
    return Coordinate(name, kind, abs(guess) or 1.0, low, high, guess)


def estimate_at(
    coordinates: Sequence[Coordinate], point: Float[np.ndarray, " unknowns"]
) -> dict[str, float]:
    """Return the numbers at a point by name, none of them beyond its bounds by round-off."""
    pairs = zip(coordinates, point, strict=True)
    return {c.name: float(np.clip(c.number(float(u)), c.low, c.high)) for c, u in pairs}
