"""Measures of a branch with their derivatives: peaks, levels, bands, areas.

What a measure is made of are places of the branch that a condition says, each with exact
derivatives of where it is and of what is measured there: ends of stable parts, peaks, where a level
is crossed. All are found anew for every rig, so that folds may move, appear and vanish: a measure
is always that of the branch as it is, and so is its derivative.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from vibrojax.branches.on_curve import OnCurve
from vibrojax.design.around import MEASURED
from vibrojax.design.known_branch import PARAMETER, KnownBranch, Node
from vibrojax.design.pieces import Between, Knot, Piece, node_of
from vibrojax.results.derived import DERIVED, NEEDS

READ = tuple(name for name in MEASURED if name not in ("parameter", "clearance"))
FLAT = 1e-8
"""How near to zero a rate along the branch is to come at a peak, over its size next to it."""
SOLVED = 1e-6
"""How near to a level a variable is to come, over its distance next to it; the rest goes to first
order."""
LOW_PEAK = 0.9
"""Least share of the highest knot at which another may be next to the highest peak."""


class NoSuchPlace(ValueError):
    """A branch has no place of the kind that was asked for."""


class Dual(NamedTuple):
    """A number and its derivatives: in the numbers of the rig, the last one in an argument."""

    value: float
    slopes: Float[np.ndarray, " numbers_and_argument"]

    def __add__(self, other: "Dual") -> "Dual":  # pyright: ignore[reportIncompatibleMethodOverride]
        return Dual(self.value + other.value, self.slopes + other.slopes)

    def __sub__(self, other: "Dual") -> "Dual":  # pyright: ignore[reportIncompatibleMethodOverride]
        return Dual(self.value - other.value, self.slopes - other.slopes)


def still(value: float, known: KnownBranch) -> Dual:
    """Return a number that does not change."""
    return Dual(value, np.zeros(known.numbers + 1))


class Variable(NamedTuple):
    """What is measured, by name."""

    name: str
    source: str
    """What of a motion it is made from."""
    rule: Callable[[Any], Any]

    @property
    def column(self) -> int:
        """Column of the source."""
        return MEASURED.index(self.source)

    def of(self, node: Node, steep: float = 0.0) -> Dual:
        """Return it at a place, where its source changes by `steep` per unit of an argument."""
        value, push = jax.linearize(self.rule, node.value[self.column])
        slopes = np.append(node.slopes[:, self.column], steep)
        return Dual(float(value), np.asarray(push(1.0)) * slopes)

    def at_knots(self, piece: Piece) -> Float[np.ndarray, " knots"]:
        """Return it at all knots of a part."""
        if self.name not in piece.values:
            piece.values[self.name] = self._read(piece)
        return piece.values[self.name]

    def _read(self, piece: Piece) -> np.ndarray:
        known, points = piece.known, piece.known.walk.points
        own = [k.motion is points[k.cell] for k in piece.knots]
        if not hasattr(known.branch, self.source):
            own = [False] * len(own)
        found = np.zeros(len(own))
        for k, (knot, is_point) in enumerate(zip(piece.knots, own, strict=True)):
            if is_point:
                found[k] = getattr(known.branch, self.source)[knot.cell]
        others = [k for k, is_point in enumerate(own) if not is_point]
        if others:
            motions = [piece.knots[k].motion for k in others]
            found[others] = [here.value[self.column] for here in known.around(motions)]
        return np.asarray(self.rule(found))


def variable_of(name: str, ratio_units: str) -> Variable:
    """Return what is measured of a name. Raises `ValueError` for an unknown one."""
    if name in READ:
        return Variable(name, name, lambda value: value)
    rules = DERIVED.get(ratio_units, {})
    if name in rules:
        return Variable(name, *rules[name])
    if name in NEEDS:
        raise ValueError(f"{name} needs {NEEDS[name]}.")
    known = ", ".join((*READ, *NEEDS))
    raise ValueError(f"Unknown variable {name!r}: give one of {known}.")


# ---------------------------------------------------------------------------------------- peaks


class Peak(NamedTuple):
    """Where a variable is largest."""

    height: Dual
    piece: Piece
    knot: Knot | None
    """The knot that it is at; None where the curve is flat there."""
    motion: Any


def peak_of(pieces: Sequence[Piece], variable: Variable) -> Peak:
    """Find the largest value over parts of a branch."""
    every = [(piece, variable.at_knots(piece)) for piece in pieces]
    if not every:
        raise NoSuchPlace("The branch has no stable motion in the range.")
    top = max(float(y.max()) for _, y in every)
    found: list[Peak] = []
    for piece, y in every:
        padded = np.concatenate([[-np.inf], y, [-np.inf]])
        is_top = (y >= padded[:-2]) & (y >= padded[2:]) & (y >= LOW_PEAK * top)
        found += [_peak_near(piece, variable, int(k)) for k in np.flatnonzero(is_top)]
    return max(found, key=lambda peak: peak.height.value)


def _peak_near(piece: Piece, variable: Variable, k: int) -> Peak:
    """Find the peak next to the knot that is higher than its neighbours."""
    known = piece.known
    motion = _flat_near(piece, variable, k, FLAT)
    if motion is not None:
        return Peak(variable.of(_flat(known, motion)), piece, None, motion)
    knot = piece.knots[k]
    return Peak(variable.of(node_of(known, knot)), piece, knot, knot.motion)


def _flat_near(piece: Piece, variable: Variable, k: int, flat: float) -> OnCurve | None:
    """Find where the curve is flat next to a knot; None where it has a corner or ends there."""
    known, column = piece.known, variable.column
    near = piece.knots[max(k - 1, 0) : k + 2]
    rates = [here.along[column] for here in known.around([knot.motion for knot in near])]

    def rate(motion: OnCurve) -> tuple[float, float]:
        (here,) = known.around([motion])
        return float(here.along[column]), 0.0

    for first, (a, b) in enumerate(pairwise(near)):
        if rates[first] * rates[first + 1] < 0:
            return Between(known, a, b).root(known, rate, flat)
    return None


def _flat(known: KnownBranch, motion: Any) -> Node:
    """What is measured at a peak, but for where it is: to first order it may be held."""
    (here,) = known.around([motion])
    return Node(here.value, here.by_number)


def peak_frequency_of(peak: Peak, variable: Variable) -> Dual:
    """Return the frequency of a peak."""
    known = peak.piece.known
    if peak.knot is not None:
        return frequency_of(node_of(known, peak.knot))
    (here,), bends = known.around([peak.motion]), known.bends(peak.motion, measured=True)
    column = variable.column
    moves = -bends.by_number[:, column] / bends.along[column]
    shift = -here.along[column] / bends.along[column]
    slopes = here.by_number[:, PARAMETER] + moves * here.along[PARAMETER]
    value = here.value[PARAMETER] + shift * here.along[PARAMETER]
    return Dual(float(value), np.append(slopes, 0.0))


def frequency_of(node: Node) -> Dual:
    """Return where a place is."""
    return Dual(float(node.value[PARAMETER]), np.append(node.slopes[:, PARAMETER], 0.0))


# ------------------------------------------------------------------------------------ one place


def at_frequency(
    pieces: Sequence[Piece], variable: Variable, frequency: float, upper: bool
) -> Dual:
    """Return a variable at a frequency, on the upper or lower part where there are several.

    Its last derivative is by the frequency. Raises `NoSuchPlace` where no motion is found.
    """
    over = [piece for piece in pieces if piece.interval(frequency) is not None]
    if not over:
        raise NoSuchPlace(f"The branch has no stable motion at {frequency:g}.")
    known = over[0].known
    motions = known.run([piece.motion_at(frequency) for piece in over])
    if any(motion is None for motion in motions):
        raise NoSuchPlace(f"No motion was found at {known.branch.axis} = {frequency:g}.")
    found = []
    for motion, here in zip(motions, known.around(motions), strict=True):
        steep = here.along[variable.column] / here.along[PARAMETER]
        found.append(variable.of(known.at(motion, frequency), float(steep)))
    return (max if upper else min)(found, key=lambda each: each.value)


# ---------------------------------------------------------------------------------------- bands


class Span(NamedTuple):
    """Frequencies from one to another."""

    low: Dual
    high: Dual


def span_of(piece: Piece) -> Span:
    """Return the frequencies of a part."""
    return Span(*map(frequency_of, piece.ends))


def above(piece: Piece, variable: Variable, level: float) -> list[Span]:
    """Return where a part is above a level; derivatives in the level are the last ones."""
    known, column, span = piece.known, variable.column, span_of(piece)

    def beyond(motion: OnCurve) -> tuple[float, float]:
        (here,) = known.around([motion])
        value, rate = jax.jvp(variable.rule, (here.value[column],), (here.along[column],))
        return float(value) - level, float(rate)

    y = variable.at_knots(piece) - level
    roots = []
    for k in np.flatnonzero(y[:-1] * y[1:] < 0):
        between = Between(known, *piece.knots[k : k + 2])
        roots.append(between.root(known, beyond, SOLVED))
    # A peak or a valley between knots may reach beyond the level where they do not.
    for k in _extremes_near(y, level):
        flat = _flat_near(piece, variable, k, SOLVED)
        if flat is not None and beyond(flat)[0] * y[k] < 0:
            raise NoSuchPlace(
                f"The level {level:g} of {variable.name} is passed twice within a step of the "
                "branch: give a shorter longest_step in the settings of the continuation."
            )
    crossings = []
    for motion in roots:
        if motion is None:
            raise NoSuchPlace(f"Where {variable.name} passes {level:g} was not found.")
        (here,) = known.around([motion])
        value, push = jax.linearize(variable.rule, here.value[column])
        rate = float(push(1.0))
        along = rate * here.along[column]
        shift = (level - float(value)) / along
        moves = np.append(-rate * here.by_number[:, column], 1.0) / along
        slopes = np.append(here.by_number[:, PARAMETER], 0.0) + moves * here.along[PARAMETER]
        crossings.append(Dual(float(here.value[PARAMETER] + shift * here.along[PARAMETER]), slopes))
    crossings.sort(key=lambda each: each.value)
    low_end = y[0] if piece.frequency[0] < piece.frequency[-1] else y[-1]
    edges = ([span.low] if low_end > 0 else []) + crossings
    if len(edges) % 2:
        edges.append(span.high)
    return [Span(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _extremes_near(y: np.ndarray, level: float) -> list[int]:
    """Inner knots that are extremes on this side of a level, and near it."""
    inner = np.arange(1, len(y) - 1)
    towards = -np.sign(y[inner])
    nearest = (towards * (y[inner] - y[inner - 1]) >= 0) & (
        towards * (y[inner] - y[inner + 1]) >= 0
    )
    return inner[nearest & (np.abs(y[inner]) < 0.05 * abs(level))].tolist()


def covered(spans: Sequence[Span], least: int = 1) -> list[Span]:
    """Return where at least so many of some spans are."""
    edges = [(s.low.value, 1, s.low) for s in spans] + [(s.high.value, -1, s.high) for s in spans]
    edges.sort(key=lambda edge: (edge[0], -edge[1]))
    found, depth, begun = [], 0, None
    for _, step, edge in edges:
        before, depth = depth, depth + step
        if before < least <= depth:
            begun = edge
        elif before >= least > depth and begun is not None:
            found.append(Span(begun, edge))
    return found


def length(spans: Sequence[Span], known: KnownBranch) -> Dual:
    """Return the total length of spans that do not overlap."""
    return sum((span.high - span.low for span in spans), still(0.0, known))
