"""Sliders of the explorer: ranges whose start is known."""

from vibrojax.ensemble.ranges import Range


def is_logarithmic(slider: Range) -> bool:
    """Whether the range spans so much that it moves in decades."""
    return slider.low > 0 and slider.high > 20 * slider.low
