"""Sine and cosine that XLA vectorises on a CPU."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_COSINE = [(-1) ** n / math.factorial(2 * n) for n in range(11)]
_SINE = [(-1) ** n / math.factorial(2 * n + 1) for n in range(11)]


def cosine(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    """Cosine to round-off for angles up to some thousands of radians.

    One polynomial after reduction to half a turn. XLA calls the scalar library cosine for float64
    on a CPU, nine times slower than this, which it vectorises.
    """
    square, sign, _ = _reduced(angle)
    return _polynomial(_COSINE, square) * sign


def sine(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    """Sine to round-off, as `cosine`."""
    square, sign, rest = _reduced(angle)
    return _polynomial(_SINE, square) * rest * sign


def _reduced(angle):
    """Square of the angle beyond whole half turns, the sign of their number, and that angle."""
    turns = jnp.round(jax.lax.stop_gradient(angle) * (1 / np.pi))
    rest = (angle - turns * np.pi) - turns * 1.2246467991473532e-16
    half = turns * 0.5
    return rest * rest, 1.0 - 4.0 * (half - jnp.floor(half)), rest


def _polynomial(coefficients, square):
    value = jnp.full_like(square, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * square + coefficient
    return value
