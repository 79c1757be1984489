"""What to measure next: the information further points hold, from the fitted curve itself."""

import itertools
from typing import Any

import numpy as np

from vibrojax._tools.checks import check_names
from vibrojax._tools.described import in_short
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.fit import Fit
from vibrojax.identification.profiling import index_of
from vibrojax.identification.what_next import Candidate, WhatNext, points_to_halve
from vibrojax.measured.curve import MeasuredCurve


def what_next(fit: Fit, name: str, **changes: Any) -> WhatNext:
    """See `Identification.what_next`."""
    sought = index_of(fit, name)
    pairs = zip(fit.problem.parts, fit.measured, strict=True)
    curves = [(p, m) for p, m in pairs if isinstance(p.misfit, CurveMisfit)]
    if not curves:
        raise ValueError("what_next needs a measured curve: further points are points of a curve.")
    part, measured = curves[0]
    assert isinstance(measured, MeasuredCurve)
    _check(fit, changes)
    noise = _noise(measured)
    axes = {n: np.atleast_1d(np.asarray(v, float)).tolist() for n, v in changes.items()}
    # Singular where the data know nothing yet: what is missing counts as one unit of coordinate.
    covariance = np.where(np.isfinite(fit.covariance), fit.covariance, np.eye(len(fit.names)))
    candidates, informations = [], []
    for row in itertools.product(*axes.values()):
        other = dict(zip(axes, row, strict=True))
        for frequency, amplitude, unstable, slope in _slopes(fit, part, measured, other, noise):
            # Sherman and Morrison: one more row of the Jacobian, one channel at a time.
            after = covariance
            for line in slope:
                gained = after @ line
                after = after - np.outer(gained, gained) / (1 + line @ gained)
            before = covariance[sought, sought]
            left = np.sqrt(max(after[sought, sought], 0.0) / before)
            informations.append(1 / max(left, 1e-12) ** 2 - 1)
            branch = "between folds" if unstable else "stable"
            candidates.append(Candidate(frequency, amplitude, branch, other, float(left)))
    reachable = [k for k, c in enumerate(candidates) if c.branch == "stable"]
    if not reachable:
        raise ValueError("No curve was found for what could be measured: change the ranges.")
    order = sorted(reachable, key=lambda k: candidates[k].deviation)
    return WhatNext(
        name=name,
        frequency_name=measured.frequency_name,
        candidates=tuple(candidates[k] for k in order),
        points=points_to_halve(informations[order[0]], 1.0),
    )


def _check(fit: Fit, changes: dict[str, Any]) -> None:
    check_names(fit.asked.make, changes)
    for n, values in changes.items():
        if n in fit.asked.arguments.values():
            raise ValueError(f"{n} is what is fitted: it cannot be chosen for a measurement.")
        if np.ndim(values) > 1:
            raise ValueError(f"{n} must be a number or a list of numbers, got {in_short(values)}.")


def _noise(measured: MeasuredCurve) -> np.ndarray:
    """Relative deviation of the channels, as it was in the measurement."""
    noise = measured.noise()
    pairs = (
        (measured.amplitude, noise.amplitude),
        (measured.contact_force, noise.contact_force),
    )
    shares = []
    for values, deviation in pairs:
        if values is not None and deviation is not None:
            shares.append(np.median(deviation[values > 0] / values[values > 0]))
    return np.array(shares)


def _slopes(
    fit: Fit,
    part: Any,
    measured: MeasuredCurve,
    other: dict[str, float],
    noise: np.ndarray,
):
    """Points of the curve of a rig, and the rows they would add to the Jacobian."""
    misfit, unknowns = part.misfit, list(part.unknowns)
    coordinates = fit.problem.coordinates
    fixed = misfit.fixed | other
    trial = CurveMisfit(
        fit.asked.make, misfit.names, fixed, misfit.static, [measured], objective="distance"
    )
    trial.unit = misfit.unit
    numbers = fit.problem.numbers(fit.point[None])[:, unknowns]
    lanes = trial.lanes(numbers)
    curve = trial.curves(lanes.paths)[0]
    if len(curve.frequency) < 2:
        return
    # The points of the curve take the place of the measured ones: distance 0, the same slopes.
    trial.frequency, trial.channels = curve.frequency[None], curve.channels[None]
    trial.deviation = np.maximum(noise * curve.channels, 1e-3 * curve.channels.max(axis=0))[None]
    _, near = trial.nearest(lanes, [curve], np.zeros(1, int), fit.frequency_scale, False)
    assert near is not None
    change = np.array([float(c.slope(u)) for c, u in zip(coordinates, fit.point, strict=True)])
    for k in np.flatnonzero(near.found):
        rows = np.zeros((near.derivative.shape[1], len(coordinates)))
        rows[:, unknowns] = near.derivative[k] * change[unknowns]
        amplitude = float(curve.channels[k, 0])
        yield float(curve.frequency[k]), amplitude, bool(curve.unstable[k]), rows
