"""Growth of neighbouring motions: a tangent carried along, for the largest Lyapunov exponent.

The tangent goes through the same steps as the state (forward mode through the stepper, so what
happens to it at a contact is part of it), and is made short again after every interval; the mean of
the logarithms of its growth is the exponent. Source: Benettin et al. 1980, Meccanica 15, 9-20;
Müller 1994, Chaos, Solitons & Fractals 4, 1671 for motions with impacts.
"""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax.stepping.stepper import AbstractMarch

lax = jax.lax

ALIGNING = 20
"""Intervals that the tangent gets to turn into the direction of fastest growth."""
BATCHES = 20
"""Batches of intervals from which the standard error is estimated, at most."""
FADING = 0.25
"""Share of the record over which the mean fades out, at both ends together."""


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
