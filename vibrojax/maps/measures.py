"""Measures of a curve: peak, jumps, hysteresis, forces, or whatever the user asks."""

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from operator import itemgetter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax._tools.compiled import compiled
from vibrojax.results.status import Status
from vibrojax.steady.kinds import Regime

Curve = dict[str, Any]
"""Arrays of one lane by name: variables of the response over (direction, frequency), the frequency
axis, and numbers such as jump_up and natural_frequency."""

Measures = (
    str
    | Callable[[Curve], Any]
    | Sequence[str | Callable[[Curve], Any]]
    | Mapping[str, str | Callable[[Curve], Any]]
)
"""What a map may be asked to keep: names or functions, one or a list, or by name."""

PLACES = 4
"""Folds or first touches kept of a branch."""


class Measure(NamedTuple):
    """One number per lane."""

    name: str
    function: Callable[[Curve], Any]
    own: bool
    """Whether it is vibrojax's own, which JAX can trace."""


def _peak_frequency(curve: Curve) -> Any:
    amplitude = curve["amplitude_ratio"]
    amplitude = amplitude.reshape(-1, amplitude.shape[-1])
    highest = jnp.max(jnp.where(jnp.isnan(amplitude), -jnp.inf, amplitude), axis=0)
    at = curve["frequencies"][jnp.argmax(highest)]
    return jnp.where(jnp.isfinite(highest).any(), at, jnp.nan)


def _hysteresis_width(curve: Curve) -> Any:
    if "fold" in curve:
        folds = jnp.append(curve["fold"], curve["further_folds"])
        width = jnp.nanmax(folds) - jnp.nanmin(folds)
    else:
        width = jnp.abs(curve["jump_down"] - curve["jump_up"])
    return jnp.where(jnp.isnan(width), 0.0, width)


def _largest(name: str) -> Callable[[Curve], Any]:
    return lambda curve: jnp.nanmax(curve[name])


def _area(curve: Curve) -> Any:
    forward, backward = curve["amplitude_ratio"]
    return jnp.trapezoid(jnp.abs(forward - backward), curve["frequencies"])


def _share(variable: str, kind: Enum) -> Callable[[Curve], Any]:
    return lambda curve: jnp.mean(curve[variable] == kind.value)


STEPWISE_FUNCTIONS: dict[str, Callable[[Curve], Any]] = {
    "peak_frequency": _peak_frequency,
    "resonance_shift": lambda curve: _peak_frequency(curve) / curve["unit_frequency"] - 1.0,
    "aperiodic_fraction": _share("status", Status.aperiodic),
    "grazing": itemgetter("grazing"),
    "chaotic_fraction": _share("regime", Regime.chaotic),
    "periodic_fraction": _share("regime", Regime.periodic),
    "largest_lyapunov_exponent": _largest("lyapunov_exponent"),
    "largest_strain_power": _largest("strain_power_rms"),
    "most_attractors": lambda curve: jnp.max(curve["attractors"]),
    "least_periodic_share": lambda curve: jnp.min(curve["periodic_share"]),
}
"""Measures without a derivative: read off the grid, counted, or averaged over a march."""
STEPWISE = tuple(STEPWISE_FUNCTIONS)
FUNCTIONS = STEPWISE_FUNCTIONS | {
    "peak_amplitude_ratio": _largest("amplitude_ratio"),
    "largest_contact_force": _largest("contact_force"),
    "jump_up": itemgetter("jump_up"),
    "jump_down": itemgetter("jump_down"),
    "hysteresis_width": _hysteresis_width,
    "hysteresis_area": _area,
    "natural_frequency": itemgetter("natural_frequency"),
    "fold": itemgetter("fold"),
}
AT_FOLDS = ("jump_up", "jump_down", "hysteresis_width", "fold")
"""Measures that are read off jumps and folds; one of the user's may be too."""
PLACED = ("fold", "grazing")
"""Measures with several values per lane."""


def measures_of(asked: Any, offered: tuple[str, ...]) -> tuple[Measure, ...]:
    """Return the measures that were asked for, by name or as functions.

    Raises `ValueError` for a name that is unknown or that this response has not, a name that is
    given twice, or what is neither name nor function.
    """
    if asked is None:
        asked = offered
    if isinstance(asked, str) or callable(asked):
        asked = (asked,)
    pairs = asked.items() if isinstance(asked, Mapping) else [(None, one) for one in asked]
    found: list[Measure] = []
    for name, one in pairs:
        if isinstance(one, str):
            if one not in offered:
                reason = " for this response" if one in FUNCTIONS else ""
                raise ValueError(
                    f"Unknown measure {one!r}{reason} in measures. {nearest(one, offered)}"
                )
            found.append(Measure(one, FUNCTIONS[one], True))
            continue
        if not callable(one):
            raise ValueError(f"measures must be names or functions of a curve, got {one!r}.")
        name = getattr(one, "__name__", "") if name is None else name
        if not str(name).isidentifier():
            raise ValueError(
                "A function without a name needs one: measures={'name': function, ...}, got "
                f"{one!r}."
            )
        found.append(Measure(str(name), one, False))
    names = [m.name for m in found]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"The measure {name!r} is asked for twice.")
    return tuple(found)


@compiled
def _all_lanes(function: Callable[[Curve], Any], curves: Curve, shared: Curve) -> Any:
    return jax.vmap(lambda own: function(own | shared))(curves)


def measure_lanes(
    measures: tuple[Measure, ...], curves: Curve, shared: Curve
) -> dict[str, np.ndarray]:
    """Return every measure of all lanes; arrays of `curves` have the lanes leading.

    Raises `ValueError` for a function that does not return one number.
    """
    found: dict[str, np.ndarray] = {}
    for measure in measures:
        if measure.own:
            found[measure.name] = np.asarray(_all_lanes(measure.function, curves, shared))
            continue
        count = len(next(iter(curves.values())))
        lanes = ({name: a[k] for name, a in curves.items()} | shared for k in range(count))
        values = [measure.function(lane) for lane in lanes]
        for value in values:
            if np.ndim(value):
                raise ValueError(
                    f"The measure {measure.name!r} must return one number for a curve, got an "
                    f"array of shape {np.shape(value)}."
                )
        found[measure.name] = np.array([float(value) for value in values])
    return found
