"""Coordinates in which the numbers sought move: of a size with each other, within their bounds."""

from typing import NamedTuple

import numpy as np

from vibrojax._tools.checks import check_choice

KINDS = ("log", "asinh", "linear")
TINY = 1e-12


class Coordinate(NamedTuple):
    """How one number moves."""

    name: str
    kind: str
    """`log`, `asinh` (linear below its scale, logarithmic above, so that 0 is reached) or
    `linear`."""
    scale: float
    low: float
    high: float

    def inside(self, number: float | np.ndarray) -> np.ndarray:
        """Coordinate of a number."""
        number = np.asarray(number, float)
        if self.kind == "log":
            return np.asarray(np.log(np.maximum(number, np.finfo(float).tiny)))
        near = number / self.scale
        return np.asarray(np.arcsinh(near) if self.kind == "asinh" else near)

    def number(self, inside: float | np.ndarray) -> np.ndarray:
        """Number at a coordinate."""
        inside = np.asarray(inside, float)
        if self.kind == "log":
            return np.asarray(np.exp(np.clip(inside, -700.0, 700.0)))
        if self.kind == "asinh":
            return np.asarray(self.scale * np.sinh(np.clip(inside, -700.0, 700.0)))
        return np.asarray(self.scale * inside)

    def slope(self, inside: float | np.ndarray) -> np.ndarray:
        """Derivative of the number in its coordinate."""
        if self.kind == "log":
            return self.number(inside)
        inside = np.clip(inside, -700.0, 700.0)
        shape = np.cosh(inside) if self.kind == "asinh" else np.ones_like(inside)
        return np.asarray(self.scale * shape)

    @property
    def limits(self) -> tuple[float, float]:
        """Bounds of the coordinate."""
        low = -np.inf if self.kind == "log" and self.low <= 0 else float(self.inside(self.low))
        return low, float(self.inside(self.high))


def coordinate_of(
    name: str, argument: str, guess: float, bounds: tuple[float, float] | None, kind: str | None
) -> Coordinate:
    """Choose the coordinate of a number.

    Contact damping can be nothing at all, so it moves in asinh and stops at 0; what is above 0
    moves in log; what may have either sign, linearly. Raises `ValueError` for bounds that are none,
    a guess outside of them, or a kind that cannot hold them.
    """
    if not np.isfinite(guess):
        raise ValueError(f"guess of {name} must be a finite number, got {guess!r}.")
    damping = "damping" in argument and "ratio" not in argument
    if kind is None:
        above = guess > 0 and (bounds is None or bounds[0] >= 0)
        kind = "asinh" if (damping and guess >= 0) else "log" if above else "linear"
    check_choice("transforms", kind, KINDS)
    low, high = (-np.inf, np.inf) if bounds is None else _bounds(name, bounds)
    if kind == "log" or (kind == "asinh" and bounds is None):
        low = max(low, 0.0)
    if kind == "log" and guess <= 0:
        raise ValueError(f"guess of {name} must be above 0 to move in log, got {guess:g}.")
    if not low <= guess <= high:
        raise ValueError(
            f"guess of {name} = {guess:g} lies outside its bounds, {low:g} to {high:g}: give a "
            "guess inside, or wider bounds."
        )
    scale = abs(guess) if guess else 1.0
    return Coordinate(name, kind, scale, low, high)


def _bounds(name: str, bounds: tuple[float, float]) -> tuple[float, float]:
    try:
        low, high = (float(b) for b in bounds)
    except (TypeError, ValueError):
        raise ValueError(f"bounds of {name} must be (low, high), got {bounds!r}.") from None
    if not low < high:
        raise ValueError(f"bounds of {name} must be (low, high) with low below high, got {bounds}.")
    return low, high
