"""What a person should know of a fit: misfit, jumps that came early, modes left out."""

import numpy as np
import scipy

from vibrojax.identification.trial_rigs import Curve
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.kinds import DRIVES
from vibrojax.model.laws import linear_coefficients
from vibrojax.model.systems import AbstractSystem

UNLIKELY = 5e-3
"""Probability of a larger misfit by chance from which the model does not explain the data."""


def used(measured: MeasuredCurve) -> list[str]:
    """Say which phase and which drive of a curve a fit takes, and what they are taken to be."""
    sentences = []
    kind = measured.drive_signal or "force or displacement of the base"
    if measured.phase is not None:
        reason = "" if measured.drive_signal else ", as no drive_signal says another"
        sentences.append(f"The phase was fitted too: ahead of the {kind} that drives{reason}.")
    if measured.drive_amplitude is not None:
        low, high = measured.drive_amplitude.min(), measured.drive_amplitude.max()
        unit = f" {DRIVES[measured.drive_signal]}" if measured.drive_signal else ""
        sentences.append(
            f"Each point was compared at the drive that was measured there, {low:.4g} to "
            f"{high:.4g}{unit}, in place of the rig's."
        )
    return sentences


def early_jumps(measured: MeasuredCurve, curve: Curve, unit: float, tolerance: float) -> list[str]:
    """Name the sweeps that jumped before the fold of the fitted curve.

    `tolerance` is how well (over `unit`) the fold and the frequencies are known.
    """
    sentences = []
    hertz = "" if measured.frequency_name == "frequency_ratio" else " Hz"
    for jump in measured.jumps():
        way, own = jump.direction, curve
        if measured.drive_amplitude is not None:
            own = curve.at_drive(measured.drive_amplitude[jump.last])
        turns = own.frequency[own.turning(way)]
        ahead = turns[way * (turns - jump.before) > 0]
        if not len(ahead):
            continue
        fold = ahead[np.argmin(np.abs(ahead - jump.before))]
        same = measured.frequency[measured.direction == way]
        # Points that could have stayed where the sweep was, had it not jumped.
        missed = (way * (same - jump.after) >= 0) & (way * (fold - same) > tolerance * unit)
        count = int(np.sum(missed))
        if count:
            name = "forward" if way > 0 else "backward"
            points = "1 point" if count == 1 else f"{count} points"
            sentences.append(
                f"The {name} sweep jumped early: between {jump.before:.5g} and "
                f"{jump.after:.5g}{hertz}, {points} before the fold at {fold:.5g}{hertz}. Its "
                "place says nothing about the stop; the points themselves were used."
            )
    return sentences


def misfit(square: float, degrees_of_freedom: int, residual: np.ndarray) -> list[str]:
    """Say so when the model does not explain the data, or the deviations are not what they were.

    `square` is the chi-square, `residual` in the order in which neighbours follow each other.
    """
    sentences = []
    reduced = square / degrees_of_freedom
    if scipy.stats.chi2.sf(square, degrees_of_freedom) < UNLIKELY:
        sentences.append(
            f"The model does not explain the data: the reduced chi-square is {reduced:.3g}. The "
            "formulation, the number of modes, a number held fixed or the deviations given are "
            "wrong, or this is not the best minimum; the intervals are widened accordingly, and "
            "still say nothing about a bias."
        )
    elif scipy.stats.chi2.cdf(square, degrees_of_freedom) < 1e-6:
        sentences.append(
            f"The fit is better than the deviations allow (reduced chi-square {reduced:.3g}): they "
            "are probably too large, and so are the intervals."
        )
    runs = _runs(residual)
    if runs < -3.5:
        sentences.append(
            "Neighbouring residuals have the same sign far more often than by chance "
            f"({-runs:.1f} standard deviations): there is something in the data that the model "
            "does not have."
        )
    return sentences


def _runs(residual: np.ndarray) -> float:
    """Runs of one sign beyond chance, in standard deviations (Wald and Wolfowitz 1940)."""
    signs = residual[residual != 0] > 0
    above, below = int(signs.sum()), int((~signs).sum())
    total = above + below
    if min(above, below) < 8:
        return 0.0
    runs = 1 + int(np.sum(signs[1:] != signs[:-1]))
    mean = 1 + 2 * above * below / total
    variance = (mean - 1) * (mean - 2) / (total - 1)
    return float((runs - mean) / np.sqrt(variance))


def modes_left_out(system: AbstractSystem, deviation: float) -> list[str]:
    """Say by how much the modes that are not kept shift a contact stiffness.

    They act as a spring in series with the stop: their share of the static flexibility of the beam
    there is taken for the stop's own. No misfit shows it. `deviation`: of the stiffness, N/m.
    """
    left_out = system.flexibility_left_out()
    if left_out is None:
        return []
    equations = system.equations()
    sentences = []
    for stop, missing in zip(equations.stops, left_out, strict=True):
        law = linear_coefficients(stop.law)
        if law is None:
            continue
        stiffness = float(np.asarray(law[0]))
        share = stiffness * missing
        shift = stiffness * share / (1 - share) if share < 1 else np.inf
        if shift > deviation:
            much = f"by about {shift:.3g} N/m" if np.isfinite(shift) else "by far"
            sentences.append(
                f"With num_modes={equations.size}, {missing:.3g} m/N of the beam's static "
                f"flexibility at the stop is left out, so the stiffness comes out too low, {much}. "
                "No misfit shows this: keep more modes, or give the system static_correction=True."
            )
    return sentences
