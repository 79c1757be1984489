"""The largest Lyapunov exponent, by carrying a tangent along the motion.

The tangent goes through the same steps as the state (forward mode through the stepper, so what
happens to it at a contact is part of it), and is made short again after every interval; the mean of
the logarithms of its growth is the exponent. Source: Benettin et al. 1980, Meccanica 15, 9-20;
Müller 1994, Chaos, Solitons & Fractals 4, 1671 for motions with impacts.
"""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._tools.checks import check_count, check_one_number, check_range, is_traced
from vibrojax._tools.compiled import compiled
from vibrojax._tools.described import shown_value
from vibrojax._tools.signatures import validated
from vibrojax.history.simulate import motion
from vibrojax.model.states import as_state
from vibrojax.model.systems import AbstractSystem, check_is_system
from vibrojax.results.variables import described_as
from vibrojax.stepping.choice import choose_stepper
from vibrojax.stepping.stepper import AbstractMarch, AbstractStepper, with_traced_numbers

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

lax = jax.lax

ALIGNING = 20
"""Intervals that the tangent gets to turn into the direction of fastest growth."""
BATCHES = 20
"""Batches of intervals from which the standard error is estimated, at most."""
FADING = 0.25
"""Share of the record over which the mean fades out, at both ends together."""


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


def first_tangent(weight: Float[Array, "states *lanes"]) -> Float[Array, "states *lanes"]:
    """Return a tangent of length 1 with a share of every direction, the same for every lane."""
    direction = np.random.default_rng(20).normal(size=weight.shape[0])
    direction = direction / np.linalg.norm(direction)
    return jnp.asarray(direction).reshape((-1,) + (1,) * (weight.ndim - 1)) / weight


def tangent_growth(
    advance: Callable[[Float[Array, "states *lanes"]], Float[Array, "states *lanes"]],
    state: Float[Array, "states *lanes"],
    tangent: Float[Array, "states *lanes"],
    weight: Float[Array, "states *lanes"],
    count: int,
) -> tuple[
    Float[Array, "states *lanes"],
    Float[Array, "states *lanes"],
    Float[Array, "count states *lanes"],
    Float[Array, "count *lanes"],
]:
    """Carry a state and its tangent over `count` equal intervals of any flow or map.

    `advance` takes a state over one interval; it must be differentiable in forward mode. The
    tangent is measured with its components times `weight`. Returns both at the end (the tangent of
    length 1), and after every interval the state and the logarithm of the growth in it.
    """

    def interval(carry, _):
        state, tangent = carry
        state, pushed = jax.jvp(advance, (state,), (tangent,))
        length = jnp.sqrt(jnp.sum((pushed * weight) ** 2, axis=0))
        gone = length < jnp.finfo(length.dtype).tiny  # nothing is left of it: begin anew
        safe = jnp.where(gone, 1.0, length)
        tangent = jnp.where(gone, tangent, pushed / safe)
        growth = jnp.log(jnp.where(gone, jnp.finfo(length.dtype).tiny, length))
        return (state, tangent), (state, growth)

    (state, tangent), (section, growth) = lax.scan(interval, (state, tangent), None, length=count)
    return state, tangent, section, growth


def mean_rate(
    log_growth: Float[Array, "count *lanes"], interval: Float[ArrayLike, "*#lanes"]
) -> tuple[Float[Array, "*lanes"], Float[Array, "*lanes"]]:
    """Return the exponent, 1/s, and its standard error, from growths over intervals (s).

    The mean fades out at both ends of the record, so that a growth that goes up and down, as that
    of a turning tangent, leaves hardly a trace. The error is that of the means of batches, whose
    length grows with the record, so that growths that are correlated do not make it look small.
    """
    count = log_growth.shape[0]
    batches = min(BATCHES, max(2, math.isqrt(count)))
    length = count // batches
    if length == 0:
        raise ValueError(f"log_growth must have at least 2 intervals, got {count}.")
    kept = log_growth[count - batches * length :]
    means = jnp.mean(kept.reshape((batches, length, *log_growth.shape[1:])), axis=1)
    weight = scipy.signal.windows.tukey(count + 2, FADING)[1:-1]  # without its zeros
    weight = weight / weight.sum()
    error = jnp.std(means, axis=0, ddof=1) / math.sqrt(batches)
    error = error * math.sqrt(count * np.sum(weight**2))  # fewer intervals count fully
    mean = jnp.tensordot(jnp.asarray(weight), log_growth, axes=1)
    return mean / interval, error / interval


def drive_period(
    march: AbstractMarch, angular_frequency: Float[Array, "*lanes"]
) -> Callable[[Float[Array, "states *lanes"]], Float[Array, "states *lanes"]]:
    """Return the map over one drive period from phase 0, for `tangent_growth`."""
    once = jnp.ones(angular_frequency.shape, jnp.int32)
    return lambda state: march(state, angular_frequency, once, False)[0]


def grown(
    march: AbstractMarch,
    angular_frequency: Float[Array, "*lanes"],
    state: Float[Array, "states *lanes"],
    before: Int[Array, "*lanes"],
    periods: int,
) -> tuple[
    Float[Array, "states *lanes"],
    Float[Array, "states *lanes"],
    Float[Array, "periods states *lanes"],
    Float[Array, "periods *lanes"],
]:
    """March so many drive periods `before`, align a tangent, and see it grow for so many periods.

    Returns the states where it was aligned and at the end, those after every period in between, and
    the logarithms of the growth.
    """
    weight = march.energy_weight()
    state, _, _ = march(state, angular_frequency, before, False)
    # One scan for both parts: the march is the dear thing to compile.
    end, _, section, growth = tangent_growth(
        drive_period(march, angular_frequency),
        state,
        first_tangent(weight),
        weight,
        ALIGNING + periods,
    )
    return section[ALIGNING - 1], end, section[ALIGNING:], growth[ALIGNING:]


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
