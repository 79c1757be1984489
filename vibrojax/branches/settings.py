"""Settings of continuations, as `continue_response` and maps of branches take them."""

from typing import Any

import equinox as eqx

from vibrojax._tools.checks import check_count, check_range
from vibrojax._tools.described import AbstractSettings
from vibrojax._tools.signatures import validated
from vibrojax.branches.continuation import LONGEST_STEP
from vibrojax.branches.plan import Plan
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.methods import HarmonicBalance, PeriodicSettings
from vibrojax.stepping.choice import is_exact


@validated
class ContinuationSettings(AbstractSettings):
    """How a branch is followed. Raises `ValueError` for settings that cannot work."""

    period: int = eqx.field(static=True, default=1)
    """Drive periods after which the motion repeats."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Relative error to aim at, where motions are not exact."""
    method: HarmonicBalance | None = None
    """`HarmonicBalance(samples=..., harmonics=...)` of motions that are not exact; None: by the
    tolerance."""
    max_points: int = eqx.field(static=True, default=10_000)
    """Most points of a branch; where it is followed both ways, as from a `start`, of each."""
    longest_step: float = eqx.field(static=True, default=LONGEST_STEP)
    """Longest step along the branch, in its arclength."""
    max_crossings: int = eqx.field(static=True, default=3)
    """Answers that a map keeps at a frequency; further ones are left out."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        PeriodicSettings(self.period, self.tolerance)
        check_count("max_points", self.max_points, least=10)
        check_count("max_crossings", self.max_crossings)
        check_range("longest_step", self.longest_step, 1e-4, 1.0, allowed="from 1e-4 to 1")

    def plan(self, sample: AbstractSystem, **place: Any) -> Plan:
        """Return what is to be done with systems like the sample.

        `place` are fields of the plan: axis, low, high, labels, description. Raises `ValueError`
        for a tolerance out of reach.
        """
        exact = is_exact(sample)
        method = self.method or HarmonicBalance()
        samples = 0 if exact else method.samples_for(self.tolerance)
        return Plan(
            **place,
            period=self.period,
            exact=exact,
            samples=samples,
            harmonics=method.harmonics,
            max_points=self.max_points,
            longest_step=self.longest_step,
            ratio_units=sample.drive.reference[1],
        )
