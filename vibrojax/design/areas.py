"""The area under a branch, with its derivatives.

The integral runs along the curve, between the branch's own points, where all is smooth: in the way
along the tangent, behind a touch in the duration of the new contact. Where the curve moves by dy
and dw, the area changes by the integral of dy dw/ds - dw dy/ds, and at its ends by y times how far
these move: so derivatives along the curve are all that is needed, and folds are no matter.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from vibrojax.branches.on_curve import OnCurve
from vibrojax.design.around import MEANS
from vibrojax.design.known_branch import PARAMETER, KnownBranch
from vibrojax.design.measures import Dual, NoSuchPlace, Variable, span_of, still
from vibrojax.design.pieces import Between, Piece

AT_END = 1e-9
"""Distance from an end of a part, over its width, that is none."""
NODES = 3
"""Points of Gauss's rule between two neighbouring motions of the branch."""


class _Part(NamedTuple):
    """What is integrated over: a stable part between two frequencies that may move."""

    piece: Piece
    low: Dual
    high: Dual


def area_of(
    pieces: Sequence[Piece], variable: Variable, low: float, high: float, upper: bool
) -> Dual:
    """Integrate a variable over a band of the frequency, on the upper or lower stable part.

    Where there are several, the part is chosen that is highest or lowest in the middle of where
    they overlap. Raises `NoSuchPlace` where there is no stable motion in a part of the band.
    """
    if not pieces:
        raise NoSuchPlace("The branch has no stable motion in the range.")
    known = pieces[0].known
    edges = [still(low, known), still(high, known)]
    edges += [edge for piece in pieces for edge in span_of(piece) if low < edge.value < high]
    edges.sort(key=lambda edge: edge.value)
    parts = [
        _Part(_chosen(pieces, variable, (a.value + b.value) / 2, upper), a, b)
        for a, b in zip(edges, edges[1:], strict=False)
        if b.value > a.value
    ]
    total = still(0.0, known)
    for part in parts:
        own = _along(part, variable)
        total = Dual(total.value + own.value, total.slopes + own.slopes)
    return total


def _chosen(pieces: Sequence[Piece], variable: Variable, value: float, upper: bool) -> Piece:
    """The upper or lower one of the parts at a frequency, by a line between their knots."""
    over = [(piece, k) for piece in pieces if (k := piece.interval(value)) is not None]
    if not over:
        raise NoSuchPlace(f"The branch has no stable motion at {value:g}.")
    if len(over) == 1:
        return over[0][0]

    def height(each: tuple[Piece, int]) -> float:
        piece, k = each
        x, y = piece.frequency[k : k + 2], variable.at_knots(piece)[k : k + 2]
        return float(y[0] + (value - x[0]) / (x[1] - x[0]) * (y[1] - y[0]))

    return (max if upper else min)(over, key=height)[0]


def _along(part: _Part, variable: Variable) -> Dual:
    """Integrate along a part."""
    piece, low, high = part.piece, part.low.value, part.high.value
    known, knots = piece.known, piece.knots
    cells: list[tuple[Between, float, float]] = []
    cuts: dict[float, OnCurve] = {}
    slack = AT_END * (piece.high - piece.low)
    inside = [w for w in (low, high) if piece.low + slack < w < piece.high - slack]
    for value, motion in zip(inside, known.run([piece.motion_at(w) for w in inside]), strict=True):
        if motion is None:
            raise NoSuchPlace(f"No motion was found at {known.branch.axis} = {value:g}.")
        cuts[value] = motion
    for k in range(len(knots) - 1):
        ends = knots[k].motion.parameter, knots[k + 1].motion.parameter
        if max(ends) <= low + slack or min(ends) >= high - slack:
            continue
        between = Between(known, knots[k], knots[k + 1])
        places = [
            between.place_of(cuts[bound]) if bound in cuts and is_out else place
            for place, (bound, is_out) in zip(
                between.places, (_cut(end, low, high) for end in ends), strict=True
            )
        ]
        cells.append((between, *places))
    x, weight = np.polynomial.legendre.leggauss(NODES)
    share, weight = (x + 1) / 2, weight / 2
    found = known.run([between.at_each(a + share * (b - a)) for between, a, b in cells])
    motions = [motion for own in found for motion in own]
    if any(motion is None for motion in motions):
        raise NoSuchPlace("Not all motions under the curve were found.")
    factors = [w * (b - a) for _, a, b in cells for w in weight]
    whose = [between for between, _, _ in cells for _ in share]
    value, slopes = _summed(known, motions, whose, np.array(factors), variable)
    rises = piece.frequency[0] <= piece.frequency[-1]
    sign = 1.0 if rises else -1.0
    own_ends = [knots[0].motion, knots[-1].motion][:: 1 if rises else -1]
    ends = [cuts.get(w, own) for w, own in zip((low, high), own_ends, strict=True)]
    rows = known.around(ends, means=variable.source in MEANS)
    below, above = (float(variable.rule(row.value[variable.column])) for row in rows)
    moved = above * part.high.slopes - below * part.low.slopes
    return Dual(sign * value, np.append(sign * slopes, 0.0) + moved)


def _cut(end: float, low: float, high: float) -> tuple[float, bool]:
    """The bound nearest to an end of a cell, and whether the end lies beyond it."""
    return (low, end < low) if end < low or end - low < high - end else (high, end > high)


def _summed(
    known: KnownBranch,
    motions: list[Any],
    whose: list[Between],
    factors: Float[np.ndarray, " motions"],
    variable: Variable,
) -> tuple[float, Float[np.ndarray, " numbers"]]:
    """Sum what motions add to the area, and to its derivatives."""
    rows = known.around(motions, means=variable.source in MEANS)
    at = variable.column
    source = np.array([row.value[at] for row in rows])
    y, rate = jax.jvp(variable.rule, (source,), (np.ones_like(source),))
    y, rate = np.asarray(y), np.asarray(rate)
    w_along = np.array([row.along[PARAMETER] for row in rows])
    y_along = rate * np.array([row.along[at] for row in rows])
    w_moves = np.array([row.by_number[:, PARAMETER] for row in rows])
    y_moves = rate[:, None] * np.array([row.by_number[:, at] for row in rows])
    both = zip(whose, motions, strict=True)
    lengths = factors / np.array([between.rate_of(motion) for between, motion in both])
    moved = y_moves * w_along[:, None] - y_along[:, None] * w_moves
    return float(lengths @ (y * w_along)), lengths @ moved
