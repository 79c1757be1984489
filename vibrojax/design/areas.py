"""The area under a branch, with its derivatives.

The integral runs along the curve, between the branch's own points, where all is smooth: in the way
along the tangent, behind a touch in the duration of the new contact. Where the curve moves by dy
and dw, the area changes by the integral of dy dw/ds - dw dy/ds, and at its ends by y times how far
these move: so derivatives along the curve are all that is needed, and folds are no matter.
"""

from collections.abc import Sequence
from itertools import pairwise
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
FIRM = 2e-6
"""Difference of the two rules between two points of the branch, over the whole, up to which the
better one counts: its own error is a hundredth of that. Of the area, and of each derivative."""
CUTS = 9
"""How often the way between two points is cut, at the most."""
CORNER = 8.0
"""Bend between two neighbours of the points of the rule, over the usual one, that is a corner."""
INNER, OUTER = 5**-0.5, (2 / 3) ** 0.5
KRONROD = (
    np.array([-1, -OUTER, -INNER, 0, INNER, OUTER, 1]),
    np.array([77, 432, 625, 672, 625, 432, 77]) / 2940,
)
"""Rule of Gauss and Lobatto with Kronrod's points: places in -1 to 1, of which the ends are known
motions, and weights (Gander and Gautschi 2000)."""
LOBATTO = np.array([1, 0, 5, 0, 5, 0, 1]) / 12
"""Weights of the rule without Kronrod's points, of the same places."""


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
        for a, b in pairwise(edges)
        if b.value > a.value
    ]
    return sum((_along(part, variable) for part in parts), still(0.0, known))


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


class _Cell(NamedTuple):
    """A way between two motions that are known."""

    between: Between
    low: float
    """Places of the motions."""
    high: float
    ends: tuple[OnCurve, OnCurve]


def _along(part: _Part, variable: Variable) -> Dual:
    """Integrate along a part."""
    piece, low, high = part.piece, part.low.value, part.high.value
    known, knots = piece.known, piece.knots
    slack = AT_END * (piece.high - piece.low)
    inside = [w for w in (low, high) if piece.low + slack < w < piece.high - slack]
    cuts: dict[float, OnCurve] = {}
    for value, motion in zip(inside, known.run([piece.motion_at(w) for w in inside]), strict=True):
        if motion is None:
            raise NoSuchPlace(f"No motion was found at {known.branch.axis} = {value:g}.")
        cuts[value] = motion
    cells = []
    for a, b in pairwise(knots):
        ends = a.motion.parameter, b.motion.parameter
        if max(ends) <= low + slack or min(ends) >= high - slack:
            continue
        between = Between(known, a, b)
        places, motions = list(between.places), [a.motion, b.motion]
        for bound, motion in cuts.items():
            for side, end in enumerate(ends):
                if (end < bound == low) or (end > bound == high):
                    places[side], motions[side] = between.place_of(motion), motion
        for side in (0, 1):
            # The way along the tangent is of states at the section of the first motion.
            if not between.compares(motions[side]):
                ((motions[side],),) = known.run([between.at_each([places[side]])])
        if any(motion is None for motion in motions):
            raise NoSuchPlace("Not all motions under the curve were found.")
        cells.append(_Cell(between, places[0], places[1], (motions[0], motions[1])))
    rises = piece.frequency[0] <= piece.frequency[-1]
    area, *slopes = _integrated(known, cells, variable) * (1.0 if rises else -1.0)
    own_ends = [knots[0].motion, knots[-1].motion][:: 1 if rises else -1]
    ends = [cuts.get(w, own) for w, own in zip((low, high), own_ends, strict=True)]
    rows = known.around(ends, means=variable.source in MEANS)
    below, above = (float(variable.rule(row.value[variable.column])) for row in rows)
    moved = above * part.high.slopes - below * part.low.slopes
    return Dual(float(area), np.append(slopes, 0.0) + moved)


class _Looked(NamedTuple):
    """What the rules say about a cell."""

    better: Float[np.ndarray, " sums"]
    """The area and its derivatives."""
    coarse: Float[np.ndarray, " sums"]
    motions: list[OnCurve]
    """At the points of the rules."""
    height: Float[np.ndarray, " points"]
    slope: Float[np.ndarray, " points"]
    """Of what is integrated, over the place."""


def _integrated(
    known: KnownBranch, cells: list[_Cell], variable: Variable
) -> Float[np.ndarray, " sums"]:
    """Integrate the area and its derivatives over cells, in pieces where they are not known well.

    Derivatives are NaN where a cell is not smooth: they are not known.
    """
    done, left = np.zeros(1 + known.numbers), cells
    size = np.zeros_like(done)
    for count in range(CUTS + 1):
        if not left:
            break
        looked = _looked_at(known, left, variable)
        better, coarse = (np.array([own[k] for own in looked]) for k in (0, 1))
        size = np.maximum(size, np.abs(done) + np.sum(np.abs(better), axis=0))
        firm = np.all(np.abs(better - coarse) <= FIRM * size, axis=1)
        if count == CUTS and not firm.all():
            # The branch has left something out there: it is not smooth, however near one looks.
            firm, better[:, 1:] = np.ones_like(firm), np.nan
        done = done + np.sum(better[firm], axis=0)
        left = [c for k in np.flatnonzero(~firm) for c in _pieces(known, left[k], looked[k])]
    return done


def _pieces(known: KnownBranch, cell: _Cell, looked: _Looked) -> list[_Cell]:
    """Cut a cell at its corner, between the points next to that, or in halves.

    A corner is where another contact, or another time, becomes that of the largest force.
    """
    places = cell.low + (KRONROD[0] + 1) / 2 * (cell.high - cell.low)
    step, bend = np.diff(places), np.diff(looked.slope)
    sharp = np.abs(bend / step)
    k, last = int(np.argmax(sharp)), len(places) - 1
    is_corner = sharp[k] > CORNER * np.median(sharp)
    kept = sorted({0, k, k + 1, last}) if is_corner else [0, last // 2, last]
    ends = [(float(places[i]), looked.motions[i]) for i in kept]
    if is_corner:
        # Where the tangents at both points meet.
        rise = looked.height[k + 1] - looked.height[k]
        inside = (looked.slope[k + 1] * step[k] - rise) / (bend[k] * step[k])
        if 0.0 < inside < 1.0:
            corner = float(places[k] + inside * step[k])
            ((motion,),) = known.run([cell.between.at_each([corner])])
            if motion is None:
                raise NoSuchPlace("Not all motions under the curve were found.")
            ends.insert(kept.index(k + 1), (corner, motion))
    return [_Cell(cell.between, a, b, (m, n)) for (a, m), (b, n) in pairwise(ends)]


def _looked_at(known: KnownBranch, cells: list[_Cell], variable: Variable) -> list[_Looked]:
    """Integrate the area and its derivatives over each cell, by the better and the coarser rule."""
    x = (KRONROD[0] + 1) / 2
    steps = [c.between.at_each(c.low + x[1:-1] * (c.high - c.low)) for c in cells]
    every: list[list[Any]] = []
    for cell, inner in zip(cells, known.run(steps), strict=True):
        if any(motion is None for motion in inner):
            raise NoSuchPlace("Not all motions under the curve were found.")
        every.append([cell.ends[0], *inner, cell.ends[1]])
    found = []
    columns = _integrand(known, cells, every, variable)
    for cell, motions, own in zip(cells, every, columns, strict=True):
        sums = (cell.high - cell.low) * own[:, 2:]
        found.append(_Looked(KRONROD[1] @ sums, LOBATTO @ sums, motions, own[:, 0], own[:, 1]))
    return found


def _integrand(
    known: KnownBranch, cells: list[_Cell], every: list[list[OnCurve]], variable: Variable
) -> Float[np.ndarray, "cells points columns"]:
    """Height and slope at motions of each cell, and what is integrated over the place.

    The latter is one column for the area and one for each of its derivatives.
    """
    shape = len(cells), len(KRONROD[0])
    rows = known.around([m for own in every for m in own], means=variable.source in MEANS)
    at = variable.column
    source = np.array([row.value[at] for row in rows])
    y, rate = (np.asarray(a) for a in jax.jvp(variable.rule, (source,), (np.ones_like(source),)))
    w_along = np.array([row.along[PARAMETER] for row in rows])
    y_along = rate * np.array([row.along[at] for row in rows])
    w_moves = np.array([row.by_number[:, PARAMETER] for row in rows])
    y_moves = rate[:, None] * np.array([row.by_number[:, at] for row in rows])
    stretch = [c.between.stretch_at(m) for c, own in zip(cells, every, strict=True) for m in own]
    lengths = np.array(stretch)
    moved = y_moves * w_along[:, None] - y_along[:, None] * w_moves
    columns = [y, lengths * y_along, lengths * y * w_along, *(lengths[:, None] * moved).T]
    return np.stack(columns, axis=-1).reshape(*shape, -1)
