"""Motions that coexist at one frequency, and from where each was reached."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from vibrojax.systems.base import AbstractSystem

if TYPE_CHECKING:
    from vibrojax.results.branch import Branch


class Motion(eqx.Module):
    """One periodic motion and the starts that led to it."""

    period: int = eqx.field(static=True)
    """In drive periods."""
    amplitude_ratio: float
    contact_force: float
    """N."""
    initial_state: Float[np.ndarray, " states"]
    """(q, q') at drive phase 0."""
    starts: Int[np.ndarray, " starts"]
    """Indices of the start states that led here."""


class Coexisting(eqx.Module):
    """What a search from many states found at one frequency, the most frequent motion first."""

    axis: str = eqx.field(static=True)
    value: float
    motions: tuple[Motion, ...]
    start_states: Float[np.ndarray, "starts states"]
    aperiodic: Int[np.ndarray, " aperiodic"]
    """Starts for which no period was found."""
    diverged: Int[np.ndarray, " diverged"]
    system: AbstractSystem

    def branches(self, bounds: tuple[float, float], **settings: Any) -> "list[Branch]":
        """Follow every motion along the frequency, within the bounds, both ways.

        Motions on a branch that another one gave already are not followed again, so isolated
        branches are what comes besides the first. Settings are those of `continue_response`.
        """
        from vibrojax.studies.coexisting import branches_of

        return branches_of(self, bounds, **settings)

    def __repr__(self) -> str:
        total = len(self.start_states)
        lines = [f"Coexisting({total} starts at {self.axis} = {self.value:g})"]
        for m in self.motions:
            lines.append(
                f"  period {m.period}: amplitude ratio {m.amplitude_ratio:.6g}, contact force "
                f"{m.contact_force:.4g} N, from {len(m.starts)} starts"
            )
        if len(self.aperiodic):
            lines.append(f"  no period found from {len(self.aperiodic)} starts")
        if len(self.diverged):
            lines.append(f"  diverged from {len(self.diverged)} starts")
        return "\n".join(lines)
