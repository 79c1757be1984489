"""The motion within a phase of contact: its blocks over a time, and what says that it ends."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Complex, Float

from vibrojax._tools.trigonometry import cosine
from vibrojax._tools.types import AnyArray
from vibrojax.stepping.resonance import driven_growth


def free_blocks(
    decay: Float[Array, "2 blocks *#places"],
    rate: Float[Array, "blocks *#places"],
    blocks: Float[Array, "states *#places"],
    time: Float[ArrayLike, "*#places"],
) -> Float[Array, "states *places"]:
    """Advance the block coordinates of a free motion over a time, s.

    Real pairs have rate 0: cosine 1, sine 0, each row with its own exponent.
    """
    growth, angle = jnp.exp(decay * time), rate * time
    c, s = cosine(angle), cosine(angle - np.pi / 2)
    top, bottom = jnp.split(blocks, 2)
    return jnp.concatenate([growth[0] * (c * top - s * bottom), growth[1] * (s * top + c * bottom)])


def driven_blocks(
    decay: Float[Array, "2 blocks *#places"],
    rate: Float[Array, "blocks *#places"],
    blocks: Float[Array, "states *#places"],
    driven: Complex[Array, "states *#places"] | None,
    angle: Float[ArrayLike, "*#places"],
    angular_frequency: Float[Array, "*#places"],
    time: Float[Array, "*#places"],
) -> Float[Array, "states *places"]:
    """Advance block coordinates from the drive phase `angle`, with the input `driven`.

    `driven` is that of blocks in resonance, None where there are none; the others take no more from
    the drive than their steady response, which is not part of these coordinates.
    """
    moved = free_blocks(decay, rate, blocks, time)
    if driven is None:
        return moved
    return moved + driven_growth(decay[0], rate, driven, angle, angular_frequency, time)


def stop_push(
    stiffness: Float[AnyArray, "*#stops"],
    damping: Float[AnyArray, "*#stops"],
    can_pull: Bool[AnyArray, "*#stops"],
    angular_frequency: Float[Array, "*#stops"],
    depth: Float[Array, "*#stops"],
    rate: Float[Array, "*#stops"],
    acceleration: Float[Array, "*#stops"],
) -> tuple[Float[Array, "*stops"], Float[Array, "*stops"]]:
    """Force of stops as a depth, m, and its rate; the depth itself where a stop may pull."""
    unit = stiffness + damping * angular_frequency
    pushes = (unit > 0) & ~can_pull
    safe = jnp.where(unit > 0, unit, 1.0)
    push = (stiffness * depth + damping * rate) / safe
    slope = (stiffness * rate + damping * acceleration) / safe
    return jnp.where(pushes, push, depth), jnp.where(pushes, slope, rate)


def contact_indicator(
    depth: Float[Array, "*#stops"],
    rate: Float[Array, "*#stops"],
    push: Float[Array, "*#stops"],
    push_rate: Float[Array, "*#stops"],
) -> tuple[Float[Array, "*stops"], Float[Array, "*stops"]]:
    """Smaller one of depth and push (positive in contact), m, and its rate, m/s."""
    by_depth = depth <= push
    return jnp.where(by_depth, depth, push), jnp.where(by_depth, rate, push_rate)
