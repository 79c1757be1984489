"""The response of one rig, to be asked for measures and their derivatives."""

from collections.abc import Callable
from typing import Any

import numpy as np

from vibrojax._tools.signatures import validated
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.design.response import Response
from vibrojax.design.rig_evaluator import RigEvaluator
from vibrojax.design.rig_functions import range_of
from vibrojax.ensemble.arguments import arguments_of, numbers_apart
from vibrojax.ensemble.ranges import Range
from vibrojax.model.systems import AbstractSystem


@validated
def respond(
    make_system: Callable[..., AbstractSystem],
    *,
    frequency_ratio: Range | None = None,
    frequency: Range | None = None,
    settings: ContinuationSettings | None = None,
    **numbers: Any,
) -> Response:
    """Follow the branch of a rig, and return what it does with derivatives in its numbers.

        response = vj.design.respond(
            vj.default_rig, gap=3e-4, stiffness=6e3, frequency_ratio=vj.Range(0.85, 1.31)
        )
        response.hysteresis_width()
        response.slopes(lambda r: r.peak("contact_force") / r.peak())

    Parameters:
        make_system: a function from named numbers to a system with linear stops.
        frequency_ratio, frequency: the drive frequencies over which the branch is followed (ratio
            to the first natural frequency of the unstopped system, or Hz): `vj.Range(low, high)`.
        settings: how it is followed, `vj.ContinuationSettings(...)`.
        numbers: arguments of the function; derivatives are in those that are real numbers.

    Raises `ValueError` for no range or two, names that the function does not take, lists, a system
    whose stops are not linear or that has a mode without damping, or no number to differentiate in.
    """
    axis, followed = range_of(frequency_ratio, frequency)
    named = arguments_of(make_system, (), numbers)
    if named.dimensions:
        raise ValueError(
            f"{named.dimensions[0].name} must be one value: a response is of one rig. "
            "vj.continue_response takes lists."
        )
    real, static = numbers_apart(named.fixed)
    if not real:
        raise ValueError(
            "Give at least one number of the rig by name, such as gap=3e-4: derivatives are in it."
        )
    how = settings or ContinuationSettings()
    evaluator = RigEvaluator(
        make_system, {}, tuple(real), axis=axis, range=followed, settings=how, numbers=static
    )
    return evaluator.response(np.array(list(real.values())))
