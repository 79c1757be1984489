"""Settings of studies of regimes and basins, and of maps of them."""

from typing import Any

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

HIGHEST_ORDER = 8
"""Highest frequency of a spectrum, in drive frequencies."""


@validated
class RegimeSettings(AbstractSettings):
    """How regimes are distinguished. Raises `ValueError` for settings that cannot work."""

    transient: int = eqx.field(static=True, default=200)
    """Drive periods marched before anything is looked at."""
    periods: int = eqx.field(static=True, default=200)
    """Drive periods observed."""
    max_period: int = eqx.field(static=True, default=20)
    """Longest period looked for, in drive periods."""
    period_tolerance: float = eqx.field(static=True, default=0.02)
    """Relative return that makes a period, see `period_number`."""
    lyapunov: bool = eqx.field(static=True, default=True)
    """Whether the largest Lyapunov exponent is computed; without it a motion that has no period is
    undecided."""
    samples_per_period: int = eqx.field(static=True, default=64)
    """Samples of the observables per drive period."""
    barrier: float = eqx.field(static=True, default=0.0)
    """Displacement of the response, m, between two wells, for `cross_well`."""
    spectrum: bool = eqx.field(static=True, default=True)
    """Whether spectra of the displacement are kept (not by maps)."""
    direction: str = eqx.field(static=True, default="both")
    """`both`, `forward` (upwards) or `backward`, of diagrams and maps."""
    observables: tuple[str, ...] = eqx.field(static=True, default=())
    """Further observables that maps keep (`chord_reduction`, ...): their `_max` and `_rms`."""
    strobes: bool = eqx.field(static=True, default=False)
    """Whether maps keep strobed `displacement` and `velocity`, along a dimension `strobe`."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Relative error of the steps to aim at."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps of the march, instead of those chosen."""
    stepper: AbstractStepper | None = None
    """How motions are stepped; None: as suits the system."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work; what depends on the system is checked beside it."""
        check_choice("direction", self.direction, tuple(DIRECTIONS))
        check_count("max_period", self.max_period)
        check_count("transient", self.transient, least=0)
        check_count("periods", self.periods, least=max(4, 2 * self.max_period))
        check_count("samples_per_period", self.samples_per_period, least=8)
        _check_period_tolerance(self.period_tolerance, 0.5)
        check_range("barrier", self.barrier, allowed="a displacement in m")
        check_settings(self.tolerance, self.steps_per_period)

    @property
    def orders(self) -> Float[np.ndarray, " orders"] | None:
        """Frequencies of the spectrum over the drive frequency; None where there is none."""
        count = min(HIGHEST_ORDER, self.samples_per_period // 2) * self.periods + 1
        return np.arange(count) / self.periods if self.spectrum else None

    def stepper_of(self, sample: AbstractSystem, axis: str) -> AbstractStepper:
        """Return the stepper for systems like the `sample`, over the frequency `axis`.

        Raises `ValueError` for a system that nothing drives, one without a natural frequency where
        a ratio to it is asked for, or a stepper that cannot take it.
        """
        return _stepper_of(sample, axis, self.stepper, self.tolerance, self.steps_per_period)


@validated
class BasinSettings(AbstractSettings):
    """How attractors are found. Raises `ValueError` for settings that cannot work."""

    transient: int = eqx.field(static=True, default=200)
    """Drive periods after which a start that has not settled has one window left."""
    periods: int = eqx.field(static=True, default=24)
    """Drive periods of a window, at least 2 max_period."""
    max_period: int = eqx.field(static=True, default=12)
    """Longest period looked for, in drive periods."""
    period_tolerance: float = eqx.field(static=True, default=0.01)
    """Relative return (in the norm of energy) that makes a period, and distance within which two
    states on an orbit are the same."""
    barrier: float = eqx.field(static=True, default=0.0)
    """Displacement between the wells, m, for `cross_well`."""
    distinguish_phases: bool = eqx.field(static=True, default=False)
    """Whether the n shifts of a period-n orbit count as n attractors."""
    stepper: AbstractStepper | None = None
    """How motions are stepped; None: as suits the system."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_count("transient", self.transient, least=0)
        check_count("max_period", self.max_period)
        check_count("periods", self.periods, least=2 * self.max_period)
        _check_period_tolerance(self.period_tolerance, 0.2)
        check_range("barrier", self.barrier, allowed="a finite displacement in m")

    def stepper_of(self, sample: AbstractSystem, axis: str) -> AbstractStepper:
        """Return the stepper for systems like the `sample`, over the frequency `axis`.

        Raises `ValueError` as that of `RegimeSettings` does.
        """
        return _stepper_of(sample, axis, self.stepper, 1e-4, None)


def _stepper_of(sample: AbstractSystem, axis: str, *given: Any) -> AbstractStepper:
    check_drive(sample)
    check_axis(equation_kinds(sample), axis)
    return choose_stepper(sample, *given)


def _check_period_tolerance(value: Any, most: float) -> None:
    check_range(
        "period_tolerance",
        value,
        0.0,
        most,
        include_low=False,
        allowed=f"above 0, up to {most}",
        advice="It is the relative return that makes a period.",
    )
