"""What results about regimes have in common: variables by name, period, kind, exponent."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.checks import nearest

Array = np.ndarray


class AbstractRegimeTable(eqx.Module):
    """Variables over lanes, read by name: `table["strain_power_rms"]`."""

    variables: eqx.AbstractVar[dict[str, Array]]

    def __getitem__(self, name: str) -> Array:
        if name not in self.variables:
            raise ValueError(f"Unknown variable {name!r}. {nearest(name, self.variables)}")
        return self.variables[name]

    @property
    def period(self) -> Int[Array, "..."]:
        """Drive periods after which the motion repeats; 0 where none was found."""
        return self.variables["period"]

    @property
    def regime(self) -> Int[Array, "..."]:
        """Kind of motion, as the values of `Regime`."""
        return self.variables["regime"]

    @property
    def lyapunov_exponent(self) -> Float[Array, "..."]:
        """Largest Lyapunov exponent, 1/s."""
        return self.variables["lyapunov_exponent"]

    @property
    def lyapunov_standard_error(self) -> Float[Array, "..."]:
        """Standard error of the exponent, 1/s."""
        return self.variables["lyapunov_standard_error"]
