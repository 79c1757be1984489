"""The outcome of a resolution check."""

import equinox as eqx
import numpy as np


class ResolutionCheck(eqx.Module):
    """How far every number of a result moved when it was repeated more finely."""

    values: dict[str, np.ndarray]
    """The result itself."""
    moved: dict[str, dict[str, np.ndarray]]
    """Largest absolute change of every number, by what was refined."""
    skipped: dict[str, str]
    """What was not varied, and why."""

    @property
    def relative(self) -> dict[str, dict[str, float]]:
        """Changes over the size of the numbers; NaN for one that came or went."""
        return {
            what: {
                n: float(change / np.max(np.abs(self.values[n]))) if n in self.values else np.nan
                for n, change in numbers.items()
            }
            for what, numbers in self.moved.items()
        }

    @property
    def worst(self) -> float:
        """Largest relative change of all; NaN when a number came or went."""
        changes = [c for numbers in self.relative.values() for c in numbers.values()]
        return float(np.max(changes)) if changes else 0.0

    def __repr__(self) -> str:
        lines = ["ResolutionCheck (relative change)"]
        for what, numbers in self.relative.items():
            lines.append(f"  {what}")
            lines += [f"    {n:24s}{c:.2e}" for n, c in numbers.items()]
        lines += [f"  {what}: not varied, {why}" for what, why in self.skipped.items()]
        return "\n".join(lines)
