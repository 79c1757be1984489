"""The largest Lyapunov exponent of one motion, with its error."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from vibrojax._tools.checks import is_traced
from vibrojax._tools.described import shown_value
from vibrojax.results.variables import described_as

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

        self._refuse_batch()
        number = {"units": "1", "long_name": "Drive period, from 1"}
        data: dict[str, Any] = {
            "lyapunov_exponent": float(self.exponent),
            "lyapunov_standard_error": float(self.standard_error),
        }
        data = {name: ((), value, described_as(name)) for name, value in data.items()}
        data["rate"] = ("drive_period", np.asarray(self.rates), described_as("rate"))
        periods = np.arange(1, len(self.rates) + 1)
        return xarray.Dataset(
            data,
            {"drive_period": ("drive_period", periods, number)},
            attrs={"title": "vibrojax Lyapunov exponent"},
        )

    def plot(self) -> "Figure":
        """Draw the mean rate up to every drive period, and the exponent with two standard errors.

        Raises `ValueError` for a batch of exponents: take one.
        """
        dataset = self.to_xarray()
        from vibrojax.plot.lyapunov import plot_lyapunov

        return plot_lyapunov(dataset)

    def _refuse_batch(self) -> None:
        if np.ndim(self.exponent):
            raise ValueError(
                f"These are exponents of shape {np.shape(self.exponent)}: take one, such as "
                "jax.tree.map(lambda a: a[0], exponents)."
            )

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
