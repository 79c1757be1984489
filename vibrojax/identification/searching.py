"""Searches for the numbers of several repetitions, side by side: where they begin and end."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from vibrojax.identification.coordinates import Coordinate
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.history_misfit import HistoryMisfit
from vibrojax.identification.least_squares import Search
from vibrojax.identification.problem import Problem
from vibrojax.identification.trail import Trail
from vibrojax.identification.trial_rigs import Curve

STAGES = ((0.0, 0.3), (1.0, 1e-3))
"""Stages of a search: how far between the two scales (in log), and when it ends (chi-square)."""
POOR = 2.0
"""Reduced chi-square above which searches start elsewhere too."""
HOPELESS = 10.0
"""Reduced chi-square of a guess above which a search looks around before it sets out."""
FARTHEST = 9.0
"""Farthest that a search goes from the guess in a coordinate: a factor of 8000 in log."""
FACTORS = (0.1, 0.3, 3.0, 10.0)
"""By which the stiffness is multiplied around a hopeless guess, and where a search ended poorly."""
WORSE = 3.0
"""Factor of chi-square by which a stiffer stop is so much worse that stiffer ones are left out."""
MOST_HOPS, HOP = 4, 0.1
"""How often histories may begin another sample sooner or later, and what that has to gain."""
NEARER = 0.05
"""Fall of chi-square, once all curves are followed anew, after which a search goes on."""


class Ended(NamedTuple):
    """Where a search ended."""

    point: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    curves: dict[int, Curve | None]
    """Curves that were followed there, by measurement."""

    @property
    def cost(self) -> float:
        """Chi-square."""
        return float(self.residual @ self.residual)


class Searches:
    """Searches of several repetitions of a problem, and where they ended, by repetition."""

    def __init__(
        self,
        problem: Problem,
        search: Search,
        frequency_scales: tuple[float, float],
        degrees_of_freedom: int,
        repetitions: int,
    ):
        self.problem, self.search = problem, search
        self.first, self.last = frequency_scales
        self.degrees_of_freedom = degrees_of_freedom
        self.ended: list[list[Ended]] = [[] for _ in range(repetitions)]
        self.evaluations = np.zeros(repetitions, int)

    def best(self, k: int) -> Ended:
        """Return the lowest end of a repetition."""
        return min(self.ended[k], key=lambda end: end.cost)

    def run(self, begin: np.ndarray, searches: int, trail: Trail) -> None:
        """Search from `begin` (repetitions by unknowns), where that ends badly from elsewhere too.

        The first repetition goes ahead: the others begin where it ended, if that explains them.
        `trail` is of `measure_damping`.
        """
        problem, repetitions = self.problem, np.arange(len(begin))
        self._search(self._look_around(begin[:1], repetitions[:1], trail), repetitions[:1], trail)
        rest = repetitions[1:]
        if len(rest):
            end = np.repeat(self.best(0).point[None], len(rest), axis=0)
            starts, trail = np.arange(len(rest)), Trail()
            explained = ~self._is_poor(self._costs(end, rest, self.last, trail, starts))
            trail = trail if explained.all() else {}
            self._search(end[explained], rest[explained], trail, STAGES[-1:])
            rest, trail = rest[~explained], {}
            self._search(self._look_around(begin[rest], rest, trail), rest, trail)
        others = spread_starts(problem.guess, problem.coordinates, searches - 1)
        which = np.repeat(repetitions, len(others))
        self._search(np.tile(others, (len(begin), 1)), which, {})
        for k in range(len(begin)):
            if self._is_poor(self.best(k).cost):
                again = restarts(begin[k], problem.coordinates)
                self._search(again, np.repeat(k, len(again)), {})
        self._hop()

    def _hop(self) -> None:
        """Let motions of histories begin a sample sooner or later, as long as that is better."""
        models = [
            (k, model)
            for k, model in enumerate(self.problem.misfits)
            if isinstance(model, HistoryMisfit) and model.can_hop
        ]
        repetitions = range(len(self.ended))
        for _ in range(MOST_HOPS if models else 0):
            points, which, held = [], [], []
            for k in repetitions:
                point = self.best(k).point
                self.problem.evaluate(point[None], np.array([k]), self.last)
                for m, model in models:
                    for limits in model.beside(k, model.shifts[0]):
                        points.append(point)
                        which.append(k)
                        held.append((m, limits))
            if not points:
                return
            before = [self.best(k).cost for k in repetitions]
            self._search(np.array(points), np.array(which), {}, STAGES[-1:], held)
            if all(self.best(k).cost > b - HOP for k, b in enumerate(before)):
                return

    def _is_poor(self, cost, limit: float = POOR):
        return cost > limit * self.degrees_of_freedom

    def _costs(self, points: np.ndarray, which: np.ndarray, scale: float, trail: Trail, starts):
        residual, _ = self.problem.evaluate(points, which, scale, trail=trail, starts=starts)
        np.add.at(self.evaluations, which, 1)
        return np.sum(residual**2, axis=1)

    def measure_damping(self) -> Trail:
        """Let what moves in asinh do so in units of what the data can see of it, at the guess."""
        problem, trail = self.problem, Trail()
        if all(c.kind != "asinh" for c in problem.coordinates):
            return trail
        guess, first = problem.guess[None], np.array([0])
        _, jacobian = problem.evaluate(guess, first, self.first, trail=trail, starts=first)
        size = np.linalg.norm(jacobian[0], axis=0) / problem.slopes(guess)[0]
        problem.coordinates = tuple(
            c._replace(scale=float(1 / s)) if c.kind == "asinh" and s > 0 else c
            for c, s in zip(problem.coordinates, size, strict=True)
        )
        return trail

    def _look_around(self, begin: np.ndarray, which: np.ndarray, trail: Trail) -> np.ndarray:
        """Return where to begin: from a hopeless guess with a stiffness that explains more.

        From soft to stiff, as curves of stiff stops are long, until one is good or all get worse.
        """
        if not any(isinstance(m, CurveMisfit) for m in self.problem.misfits):
            return begin
        starts = np.arange(len(begin))
        cost = self._costs(begin, which, self.first, trail, starts)
        low, high = self.problem.limits
        around = [restarts(point, self.problem.coordinates) for point in begin]
        start, lowest = begin.copy(), np.full(len(begin), np.inf)
        lost = starts[self._is_poor(cost, HOPELESS)]
        for factor in range(len(FACTORS)):
            if not len(lost):
                break
            points = np.clip([around[k][factor] for k in lost], low, high)
            found = self._costs(points, which[lost], self.first, trail, lost)
            better = found < cost[lost]
            start[lost[better]], cost[lost[better]] = points[better], found[better]
            lowest[lost] = np.minimum(lowest[lost], found)
            lost = lost[self._is_poor(found) & (found < WORSE * lowest[lost])]
        return start

    def _search(
        self,
        points: np.ndarray,
        which: np.ndarray,
        trail: Trail,
        stages: tuple[tuple[float, float], ...] = STAGES,
        held: Sequence[tuple[int, tuple[float, float]]] = (),
        *,
        again: bool = True,
    ) -> None:
        """Search from some points, of the repetitions `which`; `trail` is of the first stage.

        `held`: a measurement and limits of its shift, by lane.
        """
        if not len(points):
            return
        low, high = self.problem.limits
        middle, cost = self.problem.guess, np.zeros(0)
        low, high = np.maximum(low, middle - FARTHEST), np.minimum(high, middle + FARTHEST)
        shifts = {
            m: np.array([own if n == m else (-np.inf, np.inf) for n, own in held]) for m, _ in held
        }
        for stage, (share, tolerance) in enumerate(stages):
            trail = {} if stage else trail
            scale = self.first ** (1 - share) * self.last**share

            def evaluate(points, lanes, scale=scale, trail=trail):
                own = {m: limits[lanes] for m, limits in shifts.items()}
                return self.problem.evaluate(
                    points, which[lanes], scale, trail=trail, starts=lanes, shifts=own
                )

            found = self.search(evaluate, points, low, high, tolerance)
            points, cost = found.point, found.cost
            np.add.at(self.evaluations, which, found.evaluations)
        starts = np.arange(len(points))
        residual, jacobian = self.problem.evaluate(
            points, which, self.last, precisely=True, trail=trail, starts=starts
        )
        np.add.at(self.evaluations, which, 1)
        # Points that were gone on from may be nearer to another part of the curve by now.
        nearer = (cost - np.sum(residual**2, axis=1) > NEARER) & (again and bool(trail))
        for lane in starts[~nearer]:
            curves = {i: kept.curve for (i, start), kept in trail.items() if start == lane}
            end = Ended(points[lane], residual[lane], jacobian[lane], curves)
            self.ended[which[lane]].append(end)
        self._search(points[nearer], which[nearer], {}, stages[-1:], again=False)


def restarts(point: np.ndarray, coordinates: tuple[Coordinate, ...]) -> np.ndarray:
    """Starts around one that ended badly: the stiffness (or what moves in log) multiplied."""
    moving = [k for k, c in enumerate(coordinates) if c.kind == "log"]
    stiff = [k for k in moving if "stiffness" in coordinates[k].name] or moving[:1]
    starts = np.repeat(point[None], len(FACTORS), axis=0)
    starts[:, stiff] += np.log(FACTORS)[:, None]
    return starts


def spread_starts(point: np.ndarray, coordinates: tuple[Coordinate, ...], count: int) -> np.ndarray:
    """Starts spread evenly (Halton) within the bounds, or a decade around the guess."""
    shares = scipy.stats.qmc.Halton(len(point), scramble=False).random(count + 1)[1:]
    limits = np.array([c.limits for c in coordinates])
    reach = np.array([np.log(10.0) if c.kind == "log" else 3.0 for c in coordinates])
    around = np.stack([point - reach, point + reach], axis=1)
    low, high = np.where(np.isfinite(limits), limits, around).T
    return low + shares * (high - low)
