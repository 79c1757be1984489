"""The largest Lyapunov exponent of one motion, with its error."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float


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

    def __repr__(self) -> str:
        value, error = float(self.exponent), float(self.standard_error)
        if not np.isfinite(value):
            return "LyapunovExponent(the motion stopped being finite)"
        return (
            f"LyapunovExponent({value:.4g} +- {error:.2g} 1/s over {len(self.rates)} periods, "
            f"{float(self.per_period):.4g} per drive period)"
        )
