"""How far the scatter of a rig's numbers makes what it does scatter."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import check_count, check_names, check_seed
from vibrojax._tools.described import AbstractSettings, in_short
from vibrojax._tools.signatures import validated
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.design.distributions import (
    Distributions,
    check_not_fixed,
    check_rigs,
    distributions_of,
)
from vibrojax.design.evaluation import AbstractEvaluator, Evaluation
from vibrojax.design.propagation import Propagation
from vibrojax.design.quasi_random import sobol_sequence
from vibrojax.design.rig_evaluator import RigEvaluator
from vibrojax.design.rig_functions import range_of
from vibrojax.design.sobol_indices import sobol_indices, sobol_probabilities
from vibrojax.ensemble.arguments import arguments_of
from vibrojax.ensemble.progress import progress_bar
from vibrojax.ensemble.ranges import Range
from vibrojax.model.systems import AbstractSystem

MOST_SAMPLES = 2**20
Places = tuple[Float[np.ndarray, "samples numbers"], Float[np.ndarray, "rigs numbers"]]
"""Places of the quasi-Monte Carlo sample, and those of Sobol indices."""


@validated
class PropagationSettings(AbstractSettings):
    """How scatter is propagated. Raises `ValueError` for settings that cannot work."""

    samples: int = eqx.field(static=True, default=64)
    """Rigs of the quasi-Monte Carlo sample, a power of two."""
    sobol: int | bool = eqx.field(static=True, default=False)
    """Base samples of Sobol indices, a power of two; they take that many times the numbers + 2
    rigs more, and SALib. False: none."""
    lanes: int = eqx.field(static=True, default=64)
    """Rigs side by side."""
    seed: int = eqx.field(static=True, default=0)
    """Of the samples; the same seed gives the same rigs."""
    continuation: ContinuationSettings | None = None
    """How the branch of every rig is followed; None: as `continue_response` does by itself."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        _check_power("samples", self.samples)
        if self.sobol is True:
            raise ValueError(
                "sobol must be how many base samples to take, such as sobol=256, or False, got "
                "True."
            )
        if self.sobol is not False:
            _check_power("sobol", self.sobol)
        check_count("lanes", self.lanes)
        check_seed(self.seed)


def _check_power(name: str, value: int) -> None:
    check_count(name, value, least=4, most=MOST_SAMPLES)
    if value & (value - 1):
        below = 2 ** (value.bit_length() - 1)
        raise ValueError(
            f"{name} must be a power of two, as Sobol's sequence is even only then, got {value}. "
            f"Nearest: {below} and {2 * below}."
        )


@validated
def propagate(
    make_system: Callable[..., AbstractSystem],
    distributions: Mapping[str, Any],
    measures: Mapping[str, Callable[[Any], Any]],
    *,
    frequency_ratio: Range | None = None,
    frequency: Range | None = None,
    settings: PropagationSettings | None = None,
    **numbers: Any,
) -> Propagation:
    """Say how much measures of a branch scatter where numbers of the rig do.

        vj.propagate(
            vj.default_rig,
            dict(gap=scipy.stats.norm(3e-4, 2e-5), stiffness=scipy.stats.uniform(4000, 3000)),
            dict(contact_force=lambda r: r.peak("contact_force")),
            frequency_ratio=vj.Range(0.9, 1.35),
        )

    Two answers beside each other: of first order, by the gradient at the means (one rig), with the
    share of every number in the variance; and by quasi-Monte Carlo (a scrambled Sobol sequence,
    Owen 1998, all rigs side by side), with quantiles. Where they differ, the result says why.
    Sobol indices are a third, where `settings.sobol` asks for them.

    Parameters:
        make_system: function from named numbers to a system.
        distributions: frozen continuous distributions of `scipy.stats` by name of a number, in its
            unit; they are independent.
        measures: functions from a response to a number, by any name; a name of vibrojax's, such as
            `contact_force`, has its unit.
        frequency_ratio, frequency: range of the drive frequency over which the branch is followed,
            `vj.Range(low, high)`, as ratio to the first natural frequency or in Hz.
        settings: `vj.design.PropagationSettings(samples=..., sobol=..., ...)`.
        numbers: arguments of the function that are held fixed.

    Rigs that have no value are counted (`lost`). Raises `ValueError` for what is no frozen
    continuous distribution or has no finite variance, a distribution that reaches numbers of which
    no rig can be built, names that the function does not take, measures that are none, no range or
    two; `ImportError` where Sobol indices are asked for without SALib.
    """
    how = settings or PropagationSettings()
    uncertain = distributions_of(distributions)
    check_names(make_system, distributions, "distributions")
    check_not_fixed(distributions, numbers)
    fixed = _fixed(make_system, uncertain, numbers)
    if not measures:
        raise ValueError(
            "measures is empty: give at least one function of a response by name, such as "
            'dict(force=lambda r: r.peak("contact_force")).'
        )
    axis, along = range_of(frequency_ratio, frequency)
    samples, design = _places(uncertain, how)
    sample = check_rigs(make_system, uncertain, np.concatenate([samples, design]), fixed)
    evaluator = RigEvaluator(
        make_system,
        measures,
        uncertain.names,
        axis=axis,
        range=along,
        settings=how.continuation or ContinuationSettings(),
        numbers=fixed,
    )
    evaluator.check(uncertain.means.tolist())
    units = sample.drive.reference[1]
    return propagated(evaluator, uncertain, how, places=(samples, design), ratio_units=units)


def _fixed(
    make_system: Callable[..., AbstractSystem], uncertain: Distributions, numbers: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the numbers that are held fixed, each of them one value."""
    means = dict(zip(uncertain.names, uncertain.means.tolist(), strict=True))
    named = arguments_of(make_system, (), {**numbers, **means})
    for dimension in named.dimensions:
        raise ValueError(
            f"{dimension.name} must be one value, got {in_short(numbers[dimension.name])}. "
            "Call propagate once for each."
        )
    return {name: value for name, value in named.fixed.items() if name in numbers}


def _places(uncertain: Distributions, how: PropagationSettings) -> Places:
    """Draw the places of the settings. Raises `ImportError` as `propagated` does."""
    count = len(uncertain.names)
    unit = sobol_sequence(how.samples, count, how.seed)
    design = sobol_probabilities(count, how.sobol, how.seed) if how.sobol else np.empty((0, count))
    return uncertain.places(unit), uncertain.places(design)


def propagated(
    evaluator: AbstractEvaluator,
    uncertain: Distributions,
    how: PropagationSettings,
    *,
    places: Places | None = None,
    ratio_units: str = "1",
) -> Propagation:
    """Propagate distributions of the evaluator's numbers, which are in its order.

    `places` are of the settings; None: they are drawn here. `ratio_units` is the unit of
    displacements per drive. Raises `ImportError` where Sobol indices are asked for without SALib.
    """
    samples, design = places or _places(uncertain, how)
    everywhere = np.concatenate([samples, design])
    found: list[Evaluation] = []
    with progress_bar("propagate", 1 + len(everywhere), None, unit="rig") as bar:
        (middle,) = evaluator.evaluate(uncertain.means[None], slopes=True)
        bar.update(1)
        for k in range(0, len(everywhere), how.lanes):
            some = everywhere[k : k + how.lanes]
            found += evaluator.evaluate(some, slopes=False)
            bar.update(len(some))
    values = np.array([one.values for one in found], float)
    count = len(samples)
    indices = None
    if how.sobol:
        indices = sobol_indices(values[count:], len(uncertain.names), how.seed)
    return Propagation(
        measures=tuple(evaluator.functions),
        numbers=uncertain.names,
        means=uncertain.means,
        deviations=uncertain.deviations,
        value=np.asarray(middle.values, float),
        gradient=np.asarray(middle.slopes, float),
        note=middle.note,
        samples=samples,
        values=values[:count],
        notes=tuple(one.note for one in found[:count]),
        sobol=indices,
        evaluations=1 + len(everywhere),
        ratio_units=ratio_units,
    )
