"""Designs judged with their tolerances: the mean, a quantile or the worst of rigs around each."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import (
    check_choice,
    check_count,
    check_positive,
    check_range,
    check_seed,
    nearest,
)
from vibrojax._tools.signatures import validated
from vibrojax.design.evaluation import AbstractEvaluator, Evaluation
from vibrojax.design.quasi_random import sobol_sequence

STATISTICS = ("worst", "mean", "quantile")
MOST_CORNERS = 16
"""Corners of the tolerances that are all tried; of more, the worst of first order is."""


@validated
@dataclasses.dataclass(frozen=True)
class Tolerance:
    """How far a number of a rig may lie from what it is designed to be, either way.

        vj.design.Tolerance(0.05e-3)  # gap ± 0.05 mm
        vj.design.Tolerance(0.2, relative=True)  # stiffness ± 20 %

    Every value in between is as likely. Raises `ValueError` for a width that is not above 0, or
    a relative one that is not below 1.
    """

    width: float
    """Half of the width, in the unit of the number, or as a share of it."""
    relative: bool = False
    """Whether the width is a share of the number."""

    def __post_init__(self) -> None:
        """Refuse what is no width."""
        check_positive("width", self.width, "(half of the width)")
        if self.relative and self.width >= 1:
            raise ValueError(
                f"width must be below 1, a share of the number, got {self.width!r}. For 20 % give "
                "0.2; without relative=True it is in the unit of the number."
            )
        object.__setattr__(self, "width", float(self.width))


@validated
@dataclasses.dataclass(frozen=True)
class Robust:
    """What is asked of a design: how it does with its tolerances.

        vj.design.Robust(dict(gap=vj.design.Tolerance(0.05e-3)), "quantile", quantile=0.9)

    Raises `ValueError` for no tolerances, an unknown statistic, a quantile that is not between 0
    and 1, or fewer than two rigs.
    """

    tolerances: Mapping[str, Tolerance]
    """Tolerances by name of the number, variables of the design or numbers held fixed."""
    statistic: str = "worst"
    """`worst` of all rigs, their `mean`, or the `quantile` that this share of them does not exceed
    to the worse side."""
    quantile: float = 0.9
    """Share of the rigs that are no worse, where a quantile is asked for."""
    rigs: int = 16
    """Quasi-random rigs for each design, in pairs, the same places in the tolerances for all; the
    worst also looks at the rig as designed and at corners of the tolerances."""
    seed: int = 0
    """Of the quasi-random rigs."""

    def __post_init__(self) -> None:
        """Refuse what cannot be asked."""
        if not self.tolerances:
            raise ValueError(
                "tolerances is empty: give at least one, such as dict(gap=Tolerance(2e-5))."
            )
        check_choice("statistic", self.statistic, STATISTICS)
        check_range(
            "quantile",
            self.quantile,
            0.0,
            1.0,
            include_low=False,
            include_high=False,
            allowed="above 0 and below 1",
        )
        check_count("rigs", self.rigs, least=2, most=2**16)
        check_seed(self.seed)
        object.__setattr__(self, "tolerances", dict(self.tolerances))

    def nodes(self) -> Float[np.ndarray, "rigs tolerances"]:
        """Return where the rigs of a design lie in their tolerances, from -1 to 1.

        Quasi-random places and their mirror images, so that the mean of what is linear is that of
        the middle. For the worst the middle, and the corners where there are up to 16, come first.
        The middle is no part of a mean or a quantile, where it would count for more than its
        share.
        """
        count = len(self.tolerances)
        some = 2 * sobol_sequence(-(-self.rigs // 2), count, self.seed) - 1
        found = np.stack([some, -some], axis=1).reshape(-1, count)
        if self.statistic != "worst":
            return found
        first = [np.zeros(count)]
        if self.all_corners:
            first += map(np.array, itertools.product((-1.0, 1.0), repeat=count))
        return np.concatenate([np.stack(first), found])

    @property
    def all_corners(self) -> bool:
        """Whether all corners of the tolerances are tried."""
        return 2 ** len(self.tolerances) <= MOST_CORNERS


class RobustEvaluator(AbstractEvaluator):
    """Statistics of functions over the tolerances, as functions of the design.

    A statistic is NaN where a rig has no value, with a note that says which. Where rigs are
    equally bad the first of them in the order of the nodes is the worst, and its slope that of the
    statistic: one of its one-sided slopes; likewise in a quantile.
    """

    def __init__(
        self,
        inner: AbstractEvaluator,
        names: Sequence[str],
        robust: Robust,
        worse: Sequence[int],
        held: Mapping[str, float] | None = None,
    ) -> None:
        """Judge designs by an evaluator of rigs.

        `inner` has the variables `names` of the design and all numbers with tolerances among its
        own; those that are no variables are `held` at their values. `worse` says for every
        function whether larger (1) or smaller (-1) is worse. Raises `ValueError` for a tolerance
        of an unknown number, or one that has no value.
        """
        held = dict(held or {})
        for name in robust.tolerances:
            if name not in inner.names:
                raise ValueError(
                    f"Unknown number {name!r} in tolerances. {nearest(name, inner.names)}"
                )
        for name in inner.names:
            if name not in names and name not in held:
                raise ValueError(
                    f"{name} has a tolerance but no value: make it a variable of the design, or "
                    f"give it in the call, {name}=..."
                )
        if len(worse) != len(inner.functions) or any(way not in (1, -1) for way in worse):
            raise ValueError(
                f"worse must be 1 or -1 for each of {len(inner.functions)} functions, got "
                f"{worse!r}."
            )
        self.inner, self.robust, self.worse = inner, robust, np.array(worse)
        self.names, self.functions = tuple(names), inner.functions
        self.held = {n: float(v) for n, v in held.items() if n not in self.names}
        tolerances = robust.tolerances
        self._at = [inner.names.index(name) for name in tolerances]
        self._own = [inner.names.index(name) for name in self.names]
        self._width = np.array([one.width for one in tolerances.values()])
        self._relative = np.array([one.relative for one in tolerances.values()])
        self._nodes = robust.nodes()

    def evaluate(
        self, places: Float[np.ndarray, "rigs numbers"], *, slopes: bool = True
    ) -> list[Evaluation]:
        """Evaluate the statistics for some designs, all their rigs side by side."""
        middles = np.empty((len(places), len(self.inner.names)))
        middles[:, self._own] = places
        for name, value in self.held.items():
            middles[:, self.inner.names.index(name)] = value
        nodes = [self._nodes] * len(places)
        known: list[list[Evaluation]] = [[] for _ in places]
        if self.robust.statistic == "worst" and not self.robust.all_corners and len(places):
            # The rig as designed says which corner is the worst of first order.
            known = [[one] for one in self.inner.evaluate(middles, slopes=True)]
            corners = [self._corners(m, one) for m, (one,) in zip(middles, known, strict=True)]
            nodes = [
                np.concatenate([own[:1], c, own[1:]]) for own, c in zip(nodes, corners, strict=True)
            ]
        rigs = [self._rigs(*pair) for pair in zip(middles, nodes, strict=True)]
        asked = [own[len(one) :] for own, one in zip(rigs, known, strict=True)]
        if not asked:
            return []
        answers = iter(self.inner.evaluate(np.concatenate(asked), slopes=slopes))
        found = []
        for k, own in enumerate(rigs):
            every = known[k] + list(itertools.islice(answers, len(asked[k])))
            found.append(self._judged(own, self._scales(nodes[k]), every))
        return found

    def _rigs(self, middle: np.ndarray, nodes: np.ndarray) -> Float[np.ndarray, "rigs inner"]:
        """Return the numbers of the rigs of a design."""
        found = np.repeat(middle[None], len(nodes), axis=0)
        found[:, self._at] += nodes * self._widths(middle)
        return found

    def _widths(self, middle: np.ndarray) -> Float[np.ndarray, " tolerances"]:
        return self._width * np.where(self._relative, middle[self._at], 1.0)

    def _scales(self, nodes: np.ndarray) -> Float[np.ndarray, "rigs numbers"]:
        """Return by how much the numbers of the rigs change with those of the design."""
        every = np.ones((len(nodes), len(self.inner.names)))
        every[:, self._at] += nodes * np.where(self._relative, self._width, 0.0)
        return every[:, self._own]

    def _corners(self, middle: np.ndarray, one: Evaluation) -> Float[np.ndarray, "corners numbers"]:
        """Return the corner of the tolerances where each function is worst of first order."""
        changes = one.slopes[:, self._at] * self._widths(middle) * self.worse[:, None]
        return np.unique(np.nan_to_num(np.sign(changes)), axis=0)

    def _judged(
        self, rigs: np.ndarray, scales: np.ndarray, every: Sequence[Evaluation]
    ) -> Evaluation:
        """Return the statistics of one design."""
        values = np.stack([one.values for one in every])
        slopes = np.stack([one.slopes for one in every])[:, :, self._own] * scales[:, None]
        weights = self._weights(values)
        lost = np.asarray(~np.isfinite(values))
        gone = np.any(lost, axis=0)
        notes = [one.note for one in every if one.note]
        note = notes[0] if notes else ""
        if gone.any():
            at = int(np.argmax(lost.any(axis=1)))
            pairs = zip(self.robust.tolerances, rigs[at, self._at], strict=True)
            numbers = ", ".join(f"{name} = {value:.6g}" for name, value in pairs)
            why = every[at].note or "nothing is said why."
            note = (
                f"Of {len(every)} rigs within the tolerances that with {numbers} has no "
                f"{self.functions[int(np.argmax(lost[at]))]}: {why}"
            )
        # Rigs that do not count may have no slopes.
        parts = np.where(weights[..., None] != 0, weights[..., None] * slopes, 0.0).sum(axis=0)
        return Evaluation(
            np.where(gone, np.nan, np.sum(weights * np.where(lost, 0.0, values), axis=0)),
            np.where(gone[:, None], np.nan, parts),
            note,
        )

    def _weights(
        self, values: Float[np.ndarray, "rigs functions"]
    ) -> Float[np.ndarray, "rigs functions"]:
        """Return what every rig counts in the statistic of every function."""
        count = len(values)
        if self.robust.statistic == "mean":
            return np.full(values.shape, 1 / count)
        worse = np.multiply(self.worse, values)
        order: Any = np.argsort(-worse, axis=0, kind="stable")  # the worst first
        share = self.robust.quantile if self.robust.statistic == "quantile" else 1.0
        place = (count - 1) * (1 - share)
        low = int(place)
        found = np.zeros(values.shape)
        columns: Any = np.arange(values.shape[1])
        found[order[low], columns] = 1 - (place - low)
        if low + 1 < count:
            found[order[low + 1], columns] = place - low
        return found
