"""What modes follow under an input that is linear over a step."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from vibrojax.model.equations import LinearEquations
from vibrojax.model.systems import Motion


def straight_states(
    equations: LinearEquations,
    motion: Motion,
    start: Float[ArrayLike, ""],
    duration: Float[ArrayLike, ""],
    shares: tuple[float, ...],
) -> list[Float[Array, " states"]]:
    """Return the states about which modes move freely, at shares of a step (s), stops left out.

    Of a signal that is linear over the step this is exact; else it is the chord.
    """
    ends = jnp.asarray(start) + jnp.array([0.0, 1.0]) * duration
    first, last = motion.drive.input(motion.waveform, ends)
    slope = (last - first) / duration
    w = equations.angular_frequency
    flexibility = equations.input_map / w**2
    lag = 2 * equations.damping_ratio / w * slope
    still = jnp.zeros(equations.memory_size)
    return [
        jnp.concatenate(
            [flexibility * (first + share * (last - first) - lag), flexibility * slope, still]
        )
        for share in shares
    ]
