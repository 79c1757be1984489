"""The largest Lyapunov exponent of a motion, from the growth of a tangent (`steady.growth`)."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_count, check_one_number, check_range, is_traced
from vibrojax._tools.compiled import compiled
from vibrojax._tools.described import shown_value
from vibrojax._tools.signatures import validated
from vibrojax.history.simulate import motion
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem, check_is_system
from vibrojax.results.variables import described_as
from vibrojax.steady.growth import ALIGNING, grown, mean_rate
from vibrojax.stepping.choice import choose_stepper
from vibrojax.stepping.stepper import AbstractStepper, with_traced_numbers

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class LyapunovExponent(eqx.Module):
    """Mean rate at which neighbouring motions part, 1/s."""

    exponent: Float[Array, ""]
    """Largest Lyapunov exponent, 1/s."""
    standard_error: Float[Array, ""]
    """Standard error of it, 1/s, from the means of batches of drive periods."""
    rates: Float[Array, " periods"]
    """Rate in every drive period, 1/s; the exponent is their mean, faded out at both ends."""
    final_state: Float[Array, " states"]
    """State (q, q', memories) at the end, at drive phase 0."""
    period: Float[Array, ""]
    """Drive period, s."""

    @property
    def per_period(self) -> Float[Array, ""]:
        """Exponent per drive period: the logarithm of a growth."""
        return self.exponent * self.period

    @property
    def significance(self) -> Float[Array, ""]:
        """The exponent in standard errors."""
        return self.exponent / self.standard_error

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset of the exponent and of its rates over `drive_period`, from 1.

        Raises `ValueError` for a batch of exponents: take one.
        """
        import xarray

        if np.ndim(self.exponent):
            raise ValueError(
                f"These are exponents of shape {np.shape(self.exponent)}: take one, such as "
                "jax.tree.map(lambda a: a[0], exponents)."
            )
        periods = np.arange(1, len(self.rates) + 1)
        about = {"units": "1", "long_name": "Drive period, from 1"}
        values = {
            "lyapunov_exponent": ((), float(self.exponent)),
            "lyapunov_standard_error": ((), float(self.standard_error)),
            "rate": ("drive_period", np.asarray(self.rates)),
        }
        return xarray.Dataset(
            {name: (*own, described_as(name)) for name, own in values.items()},
            {"drive_period": ("drive_period", periods, about)},
            attrs={"title": "vibrojax Lyapunov exponent"},
        )

    def plot(self) -> "Figure":
        """Draw the mean rate up to every drive period, and the exponent with two standard errors.

        Raises `ValueError` for a batch of exponents: take one.
        """
        from vibrojax.plot.regime import plot_lyapunov

        return plot_lyapunov(self.to_xarray())

    def __repr__(self) -> str:
        if is_traced(self.exponent) or np.ndim(self.exponent):
            exponents = shown_value(self.exponent, "1/s", exact=False)
            return f"LyapunovExponent({exponents})"
        value, error = float(self.exponent), float(self.standard_error)
        if not np.isfinite(value):
            return "LyapunovExponent(the motion stopped being finite)"
        return (
            f"LyapunovExponent({value:.4g} +- {error:.2g} 1/s over {len(self.rates)} periods, "
            f"{float(self.per_period):.4g} per drive period)"
        )


@compiled
def _exponent(stepper, run, state, before, periods):
    march = stepper.prepare(run.equations, run.drive)
    frequency = 2 * jnp.pi * jnp.asarray(run.waveform.frequency, float)
    _, end, _, growth = grown(march, frequency, state, before, periods)
    period = 2 * jnp.pi / frequency
    return LyapunovExponent(*mean_rate(growth, period), growth / period, end, period)


@validated(traceable=True)
def lyapunov_exponent(
    system: AbstractSystem,
    *,
    frequency: ArrayLike | None = None,
    frequency_ratio: ArrayLike | None = None,
    periods: int = 400,
    transient: int = 200,
    initial_state: ArrayLike | Sequence[float] | None = None,
    stepper: AbstractStepper | None = None,
    tolerance: float = 1e-6,
    steps_per_period: int | None = None,
) -> LyapunovExponent:
    """Return the largest Lyapunov exponent of the motion that a system settles to.

    Positive: neighbouring motions part, the motion is chaotic. Zero: quasi-periodic. Negative: a
    periodic motion, and the exponent is the logarithm of its leading Floquet multiplier per time.

    Parameters:
        system: what moves.
        frequency, frequency_ratio: drive frequency, one of the two (Hz; ratio to the first natural
            frequency of the unstopped system). Without a drive it only serves as a clock.
        periods: drive periods over which the growth is averaged.
        transient: drive periods marched before, to reach the motion that lasts.
        initial_state: at drive phase 0, as of `simulate`: what `system.state(displacement=...)`
            makes, or a state in the coordinates of the system; at rest by default.
        stepper: how to step; by default what suits the system.
        tolerance: relative error of the steps to aim at.
        steps_per_period: steps of the march, instead of those chosen.

    Raises `ValueError` for settings that contradict each other or cannot work, or a state of the
    wrong shape.
    """
    check_is_system(system)
    check_count("periods", periods, least=4)
    check_count("transient", transient, least=0)
    if (frequency_ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    for name, value in (("frequency", frequency), ("frequency_ratio", frequency_ratio)):
        if value is not None:
            advice = "Use regimes for many."
            check_one_number(name, value, "Hz" if name == "frequency" else "ratio", advice)
    check_range(
        "tolerance", tolerance, 0.0, 0.1, include_low=False, allowed="above 0 and at most 0.1"
    )
    chosen = choose_stepper(system, stepper, tolerance, steps_per_period)
    run = motion(system, frequency=frequency, frequency_ratio=frequency_ratio)
    state = jnp.zeros(run.equations.state_size)
    if initial_state is not None:
        state = as_state("initial_state", initial_state, run.equations)
    numbers = with_traced_numbers(chosen)
    before = jnp.asarray(max(transient - ALIGNING, 0), jnp.int32)
    return _exponent(numbers, run, state, before, periods)
