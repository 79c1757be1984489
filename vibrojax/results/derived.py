"""Variables that follow from the ratios of a result, by what its ratios are."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from vibrojax._tools.types import AnyArray
from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray

Values = Float[AnyArray, "..."]
Rule = tuple[str, Callable[[Any], Any]]

DERIVED: dict[str, dict[str, Rule]] = {
    "m/N": {"receptance": ("rms_ratio", lambda rms: rms * 2**0.5)},
    "V": {"voltage": ("amplitude_ratio", lambda amplitude: amplitude)},
    "W^0.5": {
        "mean_power": ("rms_ratio", lambda root: root**2),
        "peak_power": ("peak_ratio", lambda root: root**2),
    },
}
"""By the unit of the ratios: what a variable is made from, and how."""
NEEDS = {
    "receptance": "a system that a force drives (PointForce): where the base moves, use "
    "amplitude_ratio",
    "voltage": "a Harvester with report='voltage'",
    "mean_power": "a Harvester with report='power'",
    "peak_power": "a Harvester with report='power'",
}


class AbstractRatios(eqx.Module):
    """A result whose ratios may be read as something else."""

    ratio_units: eqx.AbstractVar[str]

    def _derived(self, name: str) -> Any:
        rules = DERIVED.get(self.ratio_units, {})
        if name not in rules:
            raise AttributeError(f"{name} needs {NEEDS[name]}.")
        source, rule = rules[name]
        return rule(getattr(self, source))

    @property
    def derived(self) -> tuple[str, ...]:
        """Names of the variables that follow from the ratios."""
        return tuple(DERIVED.get(self.ratio_units, {}))

    @property
    def receptance(self) -> Values:
        """Displacement rms over force rms, m/N, of a system that a force drives.

        The displacement counts from rest, so a mean that contact gives it is part of its rms.
        Source: Ledezma-Ramirez et al., figs. 4 and 9. Raises `AttributeError` where the base moves.
        """
        return self._derived("receptance")

    @property
    def voltage(self) -> Values:
        """Half peak-to-peak voltage of the load, V, of a `Harvester` that reports its voltage.

        Raises `AttributeError` for other systems.
        """
        return self._derived("voltage")

    @property
    def mean_power(self) -> Values:
        """Mean power in the load, W, of a `Harvester` that reports its power.

        Raises `AttributeError` for other systems.
        """
        return self._derived("mean_power")

    @property
    def peak_power(self) -> Values:
        """Largest power in the load, W, of a `Harvester` that reports its power.

        Raises `AttributeError` for other systems.
        """
        return self._derived("peak_power")


def add_derived(dataset: "xarray.Dataset") -> "xarray.Dataset":
    """Add the variables that follow from the ratios of a dataset, by the unit that they have."""
    ratios = [dataset[n] for n in ("rms_ratio", "peak_ratio", "amplitude_ratio") if n in dataset]
    if not ratios:
        return dataset
    found = {}
    for name, (source, rule) in DERIVED.get(ratios[0].attrs.get("units", ""), {}).items():
        if source in dataset and np.issubdtype(dataset[source].dtype, np.floating):
            found[name] = rule(dataset[source]).assign_attrs(described_as(name))
    return dataset.assign(found)
