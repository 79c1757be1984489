"""Settings of sweeps, as `frequency_sweep` and maps of sweeps take them."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import check_choice, check_count, check_range
from vibrojax._tools.described import AbstractSettings
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import DIRECTIONS, check_axis, check_drive
from vibrojax.model.systems import AbstractSystem, equation_kinds
from vibrojax.stepping.choice import choose_stepper
from vibrojax.stepping.stepper import AbstractStepper, check_settings
from vibrojax.sweep.plan import SweepPlan


@validated
class SweepSettings(AbstractSettings):
    """How a sweep is done. Raises `ValueError` for settings that cannot work."""

    direction: str = eqx.field(static=True, default="both")
    """`both`, `forward` (upwards) or `backward`."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Relative error to aim at in amplitudes and forces of settled points."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps of the march, instead of those chosen from contact and tolerance."""
    stepper: AbstractStepper | None = None
    """`ExactContact()`, `ExponentialSplitting()` or `LinearlyImplicit()`; None: as suits the
    system, the first where the stops are linear in contact."""
    max_period: int = eqx.field(static=True, default=8)
    """Longest period looked for, in drive periods."""
    max_periods: int | None = eqx.field(static=True, default=None)
    """Most drive periods marched at one frequency. None: 600, or twice as many as the slowest mode
    of a beam with linear stops takes to decay to a thousandth, up to 10,000."""
    settle: str = eqx.field(static=True, default="follow")
    """`follow`: a settled motion is solved for at the next frequency while it stays stable and
    keeps to its contacts, and marched where it does not; `march`: every point is marched to."""
    refine_jumps: float | None = eqx.field(static=True, default=1e-4)
    """Relative width to which jumps are bracketed. With `follow` those at folds are solved for
    (their brackets have no width); others are bisected, each try starting from the branch before
    the jump. None leaves them between grid points."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work; what depends on the system is checked beside it."""
        check_choice("direction", self.direction, tuple(DIRECTIONS))
        check_choice("settle", self.settle, ("follow", "march"))
        check_count("max_period", self.max_period)
        if self.max_periods is not None:
            check_count("max_periods", self.max_periods, least=2 * self.max_period + 1)
        if self.refine_jumps is not None:
            allowed = "from 1e-9 to 1, or None"
            check_range("refine_jumps", self.refine_jumps, 1e-9, 1.0, allowed=allowed)
        check_settings(self.tolerance, self.steps_per_period)

    def plan(
        self, sample: AbstractSystem, axis: str, grid: Float[np.ndarray, " frequencies"]
    ) -> SweepPlan:
        """Return what is to be done with systems like the sample over the frequencies `grid`.

        `axis` names them. Raises `ValueError` for a system without a drive, or without a natural
        frequency where a ratio to it is asked for, or a stepper that cannot take it.
        """
        check_drive(sample, "A frequency sweep needs")
        check_axis(equation_kinds(sample), axis)
        return SweepPlan(
            axis=axis,
            grid=grid,
            directions=DIRECTIONS[self.direction],
            stepper=choose_stepper(
                sample,
                self.stepper,
                self.tolerance,
                self.steps_per_period,
                (axis, float(np.min(grid))),
            ),
            tolerance=self.tolerance,
            max_period=self.max_period,
            max_periods=self.max_periods,
            refine_jumps=self.refine_jumps,
            settle=self.settle,
        )
