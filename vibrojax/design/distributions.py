"""Numbers of a rig that are not known exactly: their distributions, and places drawn from them."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from vibrojax._tools.described import in_short
from vibrojax.ensemble.lanes import made_by
from vibrojax.model.systems import AbstractSystem

EDGE = 2.0**-60
"""Nearest to 0 and 1 that a probability is drawn, as some distributions are infinite there."""


class Distributions(NamedTuple):
    """Independent distributions of numbers."""

    names: tuple[str, ...]
    each: tuple[Any, ...]
    """Frozen continuous distributions of scipy, by name."""
    means: Float[np.ndarray, " numbers"]
    deviations: Float[np.ndarray, " numbers"]

    def places(
        self, probabilities: Float[np.ndarray, "places numbers"]
    ) -> Float[np.ndarray, "places numbers"]:
        """Return where the distributions have some cumulative probabilities.

        Raises `ValueError` where one of them is not finite.
        """
        inside = np.clip(probabilities, EDGE, 1 - 2.0**-53)
        found = np.stack([d.ppf(p) for d, p in zip(self.each, inside.T, strict=True)], axis=1)
        for name, values in zip(self.names, found.T, strict=True):
            if not np.isfinite(values).all():
                raise ValueError(
                    f"distributions[{name!r}] has no finite values at some of its quantiles. Give "
                    "a distribution whose ppf is finite between 0 and 1."
                )
        return found


def distributions_of(given: Mapping[str, Any]) -> Distributions:
    """Check distributions by name.

    Raises `ValueError` where there are none, and for what is no frozen continuous distribution of
    scipy of one number, or has no finite mean and standard deviation.
    """
    if not given:
        raise ValueError(
            "distributions is empty: give at least one, such as "
            "dict(gap=scipy.stats.norm(3e-4, 2e-5))."
        )
    moments, frozen = [], type(scipy.stats.norm())  # all continuous ones are of this class
    for name, one in given.items():
        if not isinstance(one, frozen):
            scipys_own = isinstance(one, scipy.stats.rv_continuous)
            raise ValueError(
                f"distributions[{name!r}] must be a continuous distribution of scipy.stats with "
                f"its numbers, such as scipy.stats.norm(3e-4, 2e-5), got {in_short(one)}."
                + (f" Call it first: scipy.stats.{one.name}(...)." if scipys_own else "")
            )
        mean, deviation = one.mean(), one.std()
        if np.ndim(mean) or np.ndim(deviation):
            raise ValueError(
                f"distributions[{name!r}] must be of one number, got one of shape "
                f"{np.shape(mean)}. Give it one value of each of its numbers."
            )
        if not (np.isfinite(mean) and np.isfinite(deviation) and deviation > 0):
            raise ValueError(
                f"distributions[{name!r}] must have a finite mean and a finite standard deviation "
                f"above 0, got {float(mean):g} and {float(deviation):g}. Give one with finite "
                "tails, such as scipy.stats.norm, uniform or truncnorm; a number that is known "
                f"exactly goes into the call, {name}=..."
            )
        moments.append((float(mean), float(deviation)))
    means, deviations = np.array(moments).T
    return Distributions(tuple(given), tuple(given.values()), means, deviations)


def check_rigs(
    make_system: Callable[..., AbstractSystem],
    uncertain: Distributions,
    places: Float[np.ndarray, "places numbers"],
    numbers: Mapping[str, Any],
) -> AbstractSystem:
    """Build the rig at the means, and at the least and the largest place of every number.

    All from concrete numbers, the others at their means; returns the rig at the means. Raises
    `ValueError` where no rig can be built.
    """
    middle = dict(zip(uncertain.names, uncertain.means.tolist(), strict=True))
    made = made_by(make_system, {**numbers, **middle})
    for k, name in enumerate(uncertain.names):
        for value in (places[:, k].min(), places[:, k].max()):
            try:
                made_by(make_system, {**numbers, **middle, name: float(value)})
            except (ValueError, ArithmeticError) as error:
                raise ValueError(
                    f"distributions[{name!r}] reaches {value:.6g}, where no rig can be "
                    f"built: {error} Give one that ends before, such as scipy.stats.uniform or "
                    "truncnorm."
                ) from error
    return made


def check_not_fixed(distributions: Mapping[str, Any], numbers: Mapping[str, Any]) -> None:
    """Raise `ValueError` for a number that has a distribution and is held fixed too."""
    for name in distributions:
        if name in numbers:
            raise ValueError(
                f"{name} has a distribution and is also given as a fixed number, "
                f"{in_short(numbers[name])}. Leave one of the two out."
            )
