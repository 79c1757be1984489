"""How a periodic response is found: settings, apart from the system."""

from typing import Any

import diffrax
import equinox as eqx

from vibrojax._tools.checks import check_count, check_range
from vibrojax._tools.described import AbstractSettings
from vibrojax._tools.signatures import validated
from vibrojax.model.laws import is_linear
from vibrojax.model.stops import Stop

SAMPLES = ((1e-3, 128), (1e-4, 256), (1e-5, 512), (1e-6, 1024))
"""Tolerance reached by harmonic balance, by samples per drive period."""


def check_balance(stops: tuple[Stop, ...]) -> None:
    """Refuse, with a `ValueError`, a contact law that harmonic balance cannot take."""
    for stop in stops:
        if stop.memory_size and not is_linear(stop.law):
            raise ValueError(
                "Harmonic balance needs a contact force that is a function of depth and rate, but "
                f"a {type(stop.law).__name__} has an internal state that is not linear. Use "
                "frequency_sweep, or periodic_response with method=Shooting()."
            )


@validated
class HarmonicBalance(AbstractSettings):
    """Condensed harmonic balance: the motion at the stops, sampled in time.

    For systems that are linear but for their stops, any contact law that is a function of depth
    and rate, any number of modes and stops. The largest force is read off the samples: with 1e-3 in
    amplitudes its derivatives are good to 1 %. Raises `ValueError` for fewer than 16 samples, an
    odd number of them, or fewer than 1 harmonic.
    """

    samples: int | None = eqx.field(static=True, default=None)
    """Samples per drive period; by default chosen from the tolerance."""
    harmonics: int | None = eqx.field(static=True, default=None)
    """Harmonics of the drive frequency kept; by default all that the samples carry."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        if self.samples is not None:
            check_count("samples", self.samples, least=16)
            if self.samples % 2:
                raise ValueError(
                    f"samples must be even, got {self.samples}. Use {self.samples + 1}."
                )
        if self.harmonics is not None:
            check_count("harmonics", self.harmonics)

    def samples_for(self, tolerance: float) -> int:
        """Return the samples per drive period for a relative error.

        Raises `ValueError` when the samples asked for cannot reach the tolerance.
        """
        if self.samples is None:
            needed = next((n for reached, n in SAMPLES if tolerance >= reached), None)
            if needed is not None:
                return needed
            raise ValueError(
                f"tolerance = {tolerance:g} is out of reach of harmonic balance: the least is "
                f"{SAMPLES[-1][0]:g}. Use linear stops without smoothing, which are solved "
                "exactly, or Shooting()."
            )
        reach = next((r for r, n in reversed(SAMPLES) if self.samples >= n), 1e-2)
        if tolerance < reach:
            raise ValueError(
                f"tolerance = {tolerance:g} is out of reach of {self.samples} samples, which give "
                f"about {reach:g}. Leave samples out, or allow more."
            )
        return self.samples


@validated
class Shooting(AbstractSettings):
    """Newton's method on the period map, its Jacobian in forward mode through the stepper.

    For every system and every stepper. The largest force is read off the steps, its derivatives
    are good to about 1 %. Raises `ValueError` for a stepper that is none, or fewer than 16 steps
    per period.
    """

    stepper: diffrax.AbstractSolver[Any] | None = None
    """A diffrax solver, at equal steps; by default the one that suits the system."""
    steps_per_period: int = eqx.field(static=True, default=512)
    """Equal steps per drive period (samples of the result)."""
    max_steps: int = eqx.field(static=True, default=20)
    """Newton steps before giving up."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        if self.stepper is not None and not isinstance(self.stepper, diffrax.AbstractSolver):
            raise ValueError(f"stepper must be a diffrax solver, got {self.stepper!r}.")
        check_count("steps_per_period", self.steps_per_period, least=16)
        check_count("max_steps", self.max_steps)


@validated
class PeriodicSettings(AbstractSettings):
    """How periodic motions are solved for, as `periodic_response` and maps of them take it.

    Raises `ValueError` for a period below 1, or a tolerance that cannot work.
    """

    period: int = eqx.field(static=True, default=1)
    """Drive periods after which the motion repeats."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Relative error to aim at, where the solution is not exact."""
    method: Shooting | HarmonicBalance | None = None
    """`Shooting()` or `HarmonicBalance()`. None: linear stops are solved exactly between their
    contact times (shooting through exact propagators), other stops by harmonic balance, stops with
    an internal state, modes that fall away and other systems by shooting."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_count("period", self.period)
        allowed = "above 0, up to 0.1"
        check_range("tolerance", self.tolerance, 0.0, 0.1, include_low=False, allowed=allowed)
