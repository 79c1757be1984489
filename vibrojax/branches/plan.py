"""What a continuation is to do, apart from the systems it is done with."""

from typing import NamedTuple


class Resolution(NamedTuple):
    """Samples per drive period of the balance, and the harmonics kept (None: all)."""

    samples: int
    harmonics: int | None = None


class Plan(NamedTuple):
    """What a continuation is to do; the systems themselves are in its paths."""

    axis: str
    low: float
    high: float
    labels: list[dict[str, float]]
    """Values of the axes, by lane."""
    period: int
    exact: bool
    resolution: Resolution
    max_points: int
    longest_step: float
    ratio_units: str
    description: str

    @property
    def fallbacks(self) -> tuple[Resolution, ...]:
        """Resolutions tried in turn where a branch does not reach its end."""
        samples, harmonics = self.resolution
        return (
            Resolution(2 * samples, harmonics),
            Resolution(samples // 2, harmonics),
            Resolution(samples // 2, 12),
        )
