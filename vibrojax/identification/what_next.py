"""What to measure next: the information further points hold, from the fitted curve itself."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vibrojax._tools.checks import check_names
from vibrojax._tools.described import in_short
from vibrojax.identification.as_measured import channels_of, deviations_of, sensor_of
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.fit import Fit
from vibrojax.measured.curve import MeasuredCurve


@dataclass(frozen=True)
class Candidate:
    """One further point that could be measured."""

    frequency: float
    amplitude: float
    """What would be measured there, in the unit of the curve."""
    branch: str
    """`stable`, or `between folds` (which no sweep reaches)."""
    changes: dict[str, float]
    """Arguments of the rig that differ from the fitted one."""
    deviation: float
    """Standard deviation of the number after one such point, over what it is now."""


@dataclass(frozen=True, repr=False)
class WhatNext:
    """Further points, the most informative first."""

    name: str
    frequency_name: str
    candidates: tuple[Candidate, ...]
    points: int
    """How many such points would halve the deviation, at the best candidate."""

    @property
    def best(self) -> Candidate:
        """The most informative point."""
        return self.candidates[0]

    def __repr__(self) -> str:
        lines = [f"WhatNext(to sharpen {self.name}, the most informative points)"]
        for c in self.candidates[:5]:
            rig = "".join(f", {n} {v:g}" for n, v in c.changes.items())
            lines.append(
                f"  {self.frequency_name} {c.frequency:.5g}{rig}: amplitude {c.amplitude:.4g}, "
                f"leaves {100 * c.deviation:.1f} % of the standard deviation"
            )
        count = "1 point" if self.points == 1 else f"{self.points} points"
        lines.append(f"  {count} at the first would halve it.")
        return "\n".join(lines)


def what_next(fit: Fit, name: str, **changes: Any) -> WhatNext:
    """See `Identification.what_next`."""
    sought, problem = fit.place_of(name), fit.problem
    curves = [k for k, misfit in enumerate(problem.misfits) if isinstance(misfit, CurveMisfit)]
    if not curves:
        raise ValueError("what_next needs a measured curve: further points are points of a curve.")
    measured = fit.measured[curves[0]]
    assert isinstance(measured, MeasuredCurve)
    check_names(problem.make, changes)
    axes = {}
    for n, values in changes.items():
        if n in problem.unknowns[curves[0]]:
            raise ValueError(f"{n} is what is fitted: it cannot be chosen for a measurement.")
        if np.ndim(values) > 1:
            raise ValueError(f"{n} must be a number or a list of numbers, got {in_short(values)}.")
        axes[n] = np.atleast_1d(np.asarray(values, float)).tolist()
    noise = _noise(measured)
    # Singular where the data know nothing yet: what is missing counts as one unit of coordinate.
    covariance = np.where(np.isfinite(fit.covariance), fit.covariance, np.eye(len(fit.names)))
    candidates = []
    for row in itertools.product(*axes.values()):
        other = dict(zip(axes, row, strict=True))
        for frequency, amplitude, unstable, slope in _slopes(fit, curves[0], other, noise):
            # Sherman and Morrison: one more row of the Jacobian, one channel at a time.
            after = covariance
            for line in slope:
                gained = after @ line
                after = after - np.outer(gained, gained) / (1 + line @ gained)
            left = np.sqrt(max(after[sought, sought], 0.0) / covariance[sought, sought])
            branch = "between folds" if unstable else "stable"
            candidates.append(Candidate(frequency, amplitude, branch, other, float(left)))
    reachable = [c for c in candidates if c.branch == "stable"]
    if not reachable:
        raise ValueError("No curve was found for what could be measured: change the ranges.")
    reachable.sort(key=lambda c: c.deviation)
    # Every such point adds as much information as the first.
    gained = 1 / max(reachable[0].deviation, 1e-12) ** 2 - 1
    return WhatNext(
        name=name,
        frequency_name=measured.frequency_name,
        candidates=tuple(reachable),
        points=int(np.ceil(3.0 / gained)) if gained > 0 else 10**9,
    )


def _noise(measured: MeasuredCurve) -> np.ndarray:
    """Deviation of the channels over their sizes, as it was in the measurement."""
    deviation, size = deviations_of(measured), _sizes(measured, channels_of(measured))
    known = (size > 0) & np.isfinite(deviation)
    pairs = zip(deviation.T, size.T, known.T, strict=True)
    return np.array([np.median(d[k] / s[k]) for d, s, k in pairs])


def _sizes(measured: MeasuredCurve, channels: np.ndarray) -> np.ndarray:
    """What deviations of channels are in proportion to; that of an angle is the same anywhere."""
    sizes = np.abs(channels)
    if measured.phase is not None:
        sizes[:, 1] = sizes[:, 0] if sensor_of(measured).is_complex else 1.0
    return sizes


def _slopes(
    fit: Fit, k: int, other: dict[str, float], noise: np.ndarray
) -> Iterator[tuple[float, float, bool, np.ndarray]]:
    """Points of the curve of a rig, and the rows they would add to the Jacobian."""
    misfit, unknowns = fit.problem.misfits[k], list(fit.problem.unknowns[k].values())
    assert isinstance(misfit, CurveMisfit)
    static = {n: v for n, v in misfit.maker.static.items() if n not in other}
    maker = replace(misfit.maker, fixed=misfit.maker.fixed | other, static=static)
    measured: Any = fit.measured[k]
    trial = CurveMisfit(maker, [measured])
    trial.unit = misfit.unit
    if trial.levels is not None:  # one curve: at the drive that was usual
        trial.levels = np.median(measured.drive_amplitude, keepdims=True)
    lanes = trial.lanes(fit.problem.of_measurement(k, fit.point[None]))
    curve = trial.curves(lanes.made)[0]
    if len(curve.frequency) < 2:
        return
    # The points of the curve take the place of the measured ones: distance 0, the same slopes.
    trial.frequency, trial.channels = curve.frequency[None], curve.channels[None]
    if curve.drive is not None:
        rate = 2 * np.pi * curve.frequency if trial.order else 1.0
        trial.drive, trial.rig_drive = curve.drive[None], (curve.drive / rate**trial.order)[None]
    sizes = _sizes(measured, curve.channels)
    trial.deviation = np.maximum(noise * sizes, 1e-3 * sizes.max(axis=0))[None]
    _, near = trial.nearest(lanes, [curve], np.zeros(1, int), fit.frequency_scale, False)
    assert near is not None
    change = fit.problem.slopes(fit.point)
    for at in np.flatnonzero(near.found):
        rows = np.zeros((near.derivative.shape[1], len(change)))
        rows[:, unknowns] = near.derivative[at] * change[unknowns]
        amplitude = float(curve.channels[at, 0])
        yield float(curve.frequency[at]), amplitude, bool(curve.unstable[at]), rows
