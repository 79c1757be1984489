"""What the data say about each number at the minimum: covariance, intervals, identifiability."""

from typing import NamedTuple

import numpy as np
import scipy

from vibrojax.identification.coordinates import Coordinate

WIDE = np.log(10.0)
"""Half width in log of an interval that says no more than an order of magnitude."""
TIED = 0.995
"""Correlation beyond which two numbers are known only together."""


class Uncertainty(NamedTuple):
    """What is known of the numbers; arrays by unknowns."""

    interval: np.ndarray
    """Low and high end."""
    covariance: np.ndarray
    """In the coordinates."""
    correlation: np.ndarray
    deviation: np.ndarray
    """Standard deviations of the numbers, to first order."""
    identifiability: tuple[str, ...]
    identifiable: tuple[bool, ...]


def uncertainty(
    residual: np.ndarray,
    jacobian: np.ndarray,
    point: np.ndarray,
    coordinates: tuple[Coordinate, ...],
    degrees_of_freedom: int,
    confidence: float,
) -> Uncertainty:
    """Judge the numbers by the curvature of the misfit at its minimum.

    Where the misfit is larger than the noise explains, all deviations grow with it. A number next
    to a bound gets the one-sided interval of the normal distribution cut off there.
    """
    excess = max(1.0, float(residual @ residual) / degrees_of_freedom)
    size = np.linalg.norm(jacobian, axis=0)
    blind = size <= 1e-9 * max(size.max(initial=0.0), 1e-300)
    unit = np.where(blind, 1.0, size)
    normal = (jacobian / unit).T @ (jacobian / unit)
    values, vectors = np.linalg.eigh(np.where(np.outer(~blind, ~blind), normal, 0.0))
    keep = values > 1e-12
    inverse = (vectors[:, keep] / values[keep]) @ vectors[:, keep].T
    loose = blind | (np.sum(vectors[:, ~keep] ** 2, axis=1) > 1e-3)
    covariance = excess * inverse / np.outer(unit, unit)
    variance = np.diag(covariance)
    deviation = np.where(loose, np.inf, np.sqrt(variance))
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    correlation = covariance / np.outer(scale, scale)
    # Where the minimum would be if there were no bounds, to first order.
    ahead = point - inverse @ ((jacobian.T @ residual) / unit) / unit
    quantile = float(scipy.stats.t.ppf(0.5 + confidence / 2, degrees_of_freedom))
    intervals, sentences = [], []
    for k, c in enumerate(coordinates):
        interval, sentence = _judge(
            c, point[k], ahead[k], deviation[k], quantile, confidence, bool(blind[k])
        )
        tied = np.abs(correlation[k]) > TIED
        others = [other.name for j, other in enumerate(coordinates) if tied[j] and j != k]
        if sentence is None and others:
            sentence = f"identifiable only together with {', '.join(others)}"
        intervals.append(interval)
        sentences.append(sentence)
    slope = np.array([float(c.slope(u)) for c, u in zip(coordinates, point, strict=True)])
    return Uncertainty(
        interval=np.array(intervals),
        covariance=np.where(np.outer(loose, loose), np.inf, covariance),
        correlation=correlation,
        deviation=slope * deviation,
        identifiability=tuple(s or "identifiable" for s in sentences),
        identifiable=tuple(s is None for s in sentences),
    )


def _judge(
    coordinate: Coordinate,
    point: float,
    ahead: float,
    deviation: float,
    quantile: float,
    confidence: float,
    blind: bool,
) -> tuple[tuple[float, float], str | None]:
    """Interval of one number, and what keeps it from being identified, if anything."""
    if coordinate.kind == "asinh":
        # The misfit is a parabola in the number itself; the coordinate only helps the search.
        slope = float(coordinate.slope(point))
        number = float(coordinate.number(point))
        ahead, deviation = number + slope * (ahead - point), slope * deviation
        coordinate = coordinate._replace(kind="linear", scale=1.0)
        point = number
    low, high = coordinate.limits
    percent = f"{100 * confidence:g} %"
    if blind or not np.isfinite(deviation):
        why = "the data do not depend on it" if blind else "the data know it only with others"
        return (float(coordinate.low), float(coordinate.high)), f"not identifiable: {why}"
    reach = quantile * deviation
    bottom, top = point - reach, point + reach
    at_low, at_high = bottom <= low, top >= high
    if at_low or at_high:
        mean = ahead if min(point - low, high - point) < 1e-6 else point
        cut = scipy.stats.truncnorm(
            (low - mean) / deviation, (high - mean) / deviation, mean, deviation
        )
        bottom = low if at_low else float(cut.ppf(1 - confidence))
        top = high if at_high else float(cut.ppf(confidence))
    ends = float(coordinate.number(bottom)), float(coordinate.number(top))
    if at_low and at_high:
        return ends, "not identifiable: the interval covers all that the bounds allow"
    if at_low or at_high:
        bound = f"at most {ends[1]:.3g}" if at_low else f"at least {ends[0]:.3g}"
        return ends, f"not identifiable: the data only bound it, {bound} ({percent})"
    if coordinate.kind == "log" and reach > WIDE:
        factor = np.exp(min(2 * reach, 700.0))
        return ends, f"not identifiable: the {percent} interval covers a factor of {factor:.3g}"
    return ends, None


def influence(residual: np.ndarray, jacobian: np.ndarray, rows: int) -> np.ndarray:
    """By how many standard deviations each number would move without one measured point.

    `rows` residuals belong to a point. To first order (leave-one-out with leverage): points by
    unknowns.
    """
    normal = np.linalg.pinv(jacobian.T @ jacobian)
    deviation = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    count = len(residual) // rows
    j = jacobian.reshape(count, rows, -1)
    r = residual.reshape(count, rows)
    leverage = np.einsum("nip,pq,njq->nij", j, normal, j)
    left = np.linalg.solve(np.eye(rows) - np.minimum(leverage, 0.999), r[..., None])[..., 0]
    moved = np.einsum("pq,niq,ni->np", normal, j, left)
    return moved / deviation
