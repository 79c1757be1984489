"""Sliders of the explorer: their ranges and names."""

from typing import NamedTuple

from vibrojax.results.variables import axis_unit


class Slider(NamedTuple):
    """One number that can be moved."""

    low: float
    high: float
    value: float
    """Where it starts."""

    @property
    def is_logarithmic(self) -> bool:
        """Whether its range spans so much that it moves in decades."""
        return self.low > 0 and self.high > 20 * self.low


def unit_of(name: str) -> str:
    """Return the unit of a number, or nothing where it has or is known by none."""
    unit = axis_unit(name)
    return "" if unit == "1" else unit


def label_of_number(name: str) -> str:
    """Return the name of a number with its unit, where it is known."""
    unit = unit_of(name)
    return f"{name} ({unit})" if unit else name
