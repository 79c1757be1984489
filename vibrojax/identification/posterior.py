"""A sampled posterior of an identification."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, repr=False)
class Posterior:
    """Draws of the numbers; arrays of shape (draws,)."""

    draws: dict[str, np.ndarray]
    acceptance: float
    """Share of proposals that were accepted; near 1 where the posterior is nearly normal."""
    effective_size: float
    """How many independent draws the evaluations are worth."""
    evaluations: int
    confidence: float

    @property
    def interval(self) -> dict[str, tuple[float, float]]:
        """Central intervals of the draws."""
        tail = (1 - self.confidence) / 2
        return {
            n: (float(np.quantile(v, tail)), float(np.quantile(v, 1 - tail)))
            for n, v in self.draws.items()
        }

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over `draw`."""
        import xarray

        about = {"long_name": "Draw of the posterior", "units": "SI, as the rig's argument"}
        return xarray.Dataset(
            {n: ("draw", v, about) for n, v in self.draws.items()},
            attrs={"acceptance": self.acceptance, "effective_size": self.effective_size},
        )

    def __repr__(self) -> str:
        lines = [
            f"Posterior({len(next(iter(self.draws.values())))} draws from {self.evaluations} "
            f"evaluations, worth {self.effective_size:.0f} independent ones)"
        ]
        for n, v in self.draws.items():
            low, high = self.interval[n]
            lines.append(
                f"  {n}  mean {v.mean():.5g}, {100 * self.confidence:g} % within {low:.5g} to "
                f"{high:.5g}"
            )
        return "\n".join(lines)
