"""Blocks that the drive turns at their own frequency: no steady response, growth instead.

Undamped, such a block has no steady response; nearly so, it has a huge one, of which the motion is
a small difference. There the input is integrated from where a step begins:

    z(t) = e^(p t) z(0) + g (e^(i W t) - e^(p t)) / (i W - p),

written without cancellation, so that nothing happens when the pole p is i W.
"""

from types import ModuleType

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Complex, Float

from vibrojax._tools.trigonometry import cosine_and_sine
from vibrojax._tools.types import AnyArray
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.stop_forces import contact_slope
from vibrojax.model.stops import Stop

NEAR = 1e-4
"""Distance of pole and drive, relative to the frequency, below which the input is integrated: at
worst four digits are lost by a large steady response."""
SAME = 1e-12
"""Relative distance at which two frequencies are one, and relative damping that is none."""
NOT_AT_ALL = 1e-9
"""Share of a mode in what drives or holds the body, below which it is a node of it."""


def driven_growth(
    decay: Float[Array, "blocks *#lanes"],
    rate: Float[Array, "blocks *#lanes"],
    driven: Complex[Array, "rows *#lanes"],
    angle: Float[ArrayLike, "*#lanes"],
    angular_frequency: Float[Array, "*#lanes"],
    time: Float[ArrayLike, "*#lanes"],
) -> Float[Array, "rows *#lanes"]:
    """What inputs Im(driven e^(i phase)) add to the two rows of blocks in resonance.

    Over a `time` (s) from the drive phase `angle`, for blocks that turn at `rate` and grow with
    the exponent `decay`. Of other blocks the input has to be 0.
    """
    first, second = jnp.split(driven, 2)
    pole, drive = lax.complex(decay, rate), 1j * angular_frequency
    start, end = _turn(jnp.stack(jnp.broadcast_arrays(angle, angle + angular_frequency * time)))
    grown = jnp.exp(decay * time) * _turn(rate * time)
    # The quotient of the differences above by its series: in resonance this is small.
    apart = (drive - pole) * time
    mean = jnp.ones_like(apart)
    for order in (7, 6, 5, 4, 3, 2):
        mean = 1 + apart / order * mean
    ahead = (first + 1j * second) * start * mean * time * grown
    back = (jnp.conj(first) + 1j * jnp.conj(second)) * (jnp.conj(end) - jnp.conj(start) * grown)
    added = (ahead + back / (drive + pole)) / 2j
    return jnp.concatenate([added.real, added.imag])


def _turn(angle: Float[Array, "..."]) -> Complex[Array, "..."]:
    return lax.complex(*cosine_and_sine(angle))


def is_resonant(
    determinant: Complex[Array, "..."], angular_frequency: Float[Array, "..."]
) -> Bool[Array, "..."]:
    """Whether the determinant (i W - p)(i W - p*) of a block says that the drive turns it."""
    return jnp.abs(determinant) < 2 * NEAR * angular_frequency**2


def unbounded_at(
    equations: AbstractEquations, drive: AbstractDrive
) -> Float[Array, " coordinates"]:
    """Return the drive frequencies (rad/s) at which the motion of one lane grows without bound.

    Those of the modes without damping that are driven and that no stop can hold; NaN for others,
    nothing for systems that are not linear.
    """
    resonances = undamped_at(equations, drive)
    linear = equations.linear_between_contacts
    if linear is None:
        return resonances
    for s, stop in enumerate(linear.stops):
        reach = jnp.abs(linear.stop_map[s])
        held = _pushes(stop) & (reach > NOT_AT_ALL * jnp.max(reach))
        resonances = jnp.where(held, jnp.nan, resonances)
    return resonances


def undamped_at(equations: AbstractEquations, drive: AbstractDrive) -> Float[Array, " coordinates"]:
    """Return the drive frequencies (rad/s) at which there is no steady response without contact.

    Those of the modes without damping that are driven; NaN for others, nothing for systems that
    are not linear.
    """
    linear = equations.linear_between_contacts
    if linear is None:
        return jnp.zeros(0)
    w = linear.angular_frequency
    free = jnp.abs(linear.damping_ratio) <= SAME
    if linear.damping_coupling is not None:
        free &= jnp.max(jnp.abs(linear.damping_coupling), axis=1) <= SAME * w
    if linear.stiffness_sign is not None:
        free &= linear.stiffness_sign > 0
    moved = jnp.abs(linear.input_map)
    amplitude = jnp.abs(jnp.stack([drive.complex_amplitude(x, jnp.zeros_like(x)) for x in w]))
    free &= (moved > NOT_AT_ALL * jnp.max(moved)) & (amplitude > 0)
    return jnp.where(free, w, jnp.nan)


def _pushes(stop: Stop) -> Bool[Array, ""]:
    depth = jnp.maximum(jnp.abs(jnp.asarray(stop.gap, float)), 1e-9)
    return (contact_slope(stop) != 0) | (stop.force(depth, jnp.ones_like(depth)) != 0)


def is_unbounded(
    resonances: Float[AnyArray, "coordinates *#lanes"],
    angular_frequency: Float[AnyArray, "*#lanes"],
    xp: ModuleType = jnp,
) -> Bool[AnyArray, "*lanes"]:
    """Whether lanes are driven at one of these resonances; in arrays of JAX or of numpy."""
    return xp.any(xp.abs(resonances - angular_frequency) <= SAME * angular_frequency, axis=0)
