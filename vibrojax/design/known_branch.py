"""A branch whose motions can be measured with their derivatives in the rig's numbers."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from vibrojax.branches.contacts import TURN
from vibrojax.branches.exact_results import walk_of
from vibrojax.branches.on_curve import OnCurve, Steps
from vibrojax.branches.points import BranchPoints
from vibrojax.branches.side_by_side import CurveRigs, Job, run_together
from vibrojax.design.around import (
    MEASURED,
    Around,
    Bends,
    KnownMotion,
    MultiplierSlopes,
    bends_around,
    look_around,
    multipliers_around,
)
from vibrojax.steady.batches import in_batches
from vibrojax.steady.contact_times import Events

ROOMS = 16, 128
"""Changes of contact that programs have room for; the least that is enough is taken."""
WIDTHS = 1, 8
"""Motions measured in one call."""
PARAMETER, CLEARANCE = MEASURED.index("parameter"), MEASURED.index("clearance")


class Node(NamedTuple):
    """What is measured at a place of a branch that a condition says; columns as of `MEASURED`."""

    value: Float[np.ndarray, " measured"]
    slopes: Float[np.ndarray, "numbers measured"]
    """Derivatives in the numbers, the place going along; NaN where they are not known."""


class KnownBranch:
    """A branch of one rig, its path along the frequency, and how that changes with the numbers."""

    def __init__(self, branch: BranchPoints, path: Any, slopes: Any, numbers: int):
        assert branch.curve is not None  # of linear stops, as was checked
        self.branch, self.curve, self.period = branch, branch.curve, branch.period
        self.path, self.slopes, self.numbers = path, slopes, numbers
        self.walk = walk_of(branch.curve, branch.period, branch.range)
        self._rigs: CurveRigs | None = None
        self._seen: dict[tuple[int, bool], tuple[OnCurve, Around]] = {}
        self.measured = 0
        """Motions that were measured."""

    def run(self, steps: Sequence[Steps]) -> list[Any]:
        """Run searches for motions side by side."""
        if self._rigs is None:
            self._rigs = CurveRigs(self.branch.path, self.period)
        search = self.walk.search
        return run_together([Job(each, self._rigs, 0, search.unit, search.scale) for each in steps])

    def around(self, motions: Sequence[OnCurve], *, means: bool = False) -> list[Around]:
        """Measure some motions, and how that changes; where it is enough, only their means."""
        new = [m for m in motions if self._known_of(m, means) is None]
        if new:
            self.measured += len(new)
            found = self._batch(look_around, new, [(0, 0.0)] * len(new), more=(means,))
            for k, motion in enumerate(new):
                row = jax.tree.map(lambda a, k=k: a[k], found)
                self._seen[id(motion), means] = motion, row
        known = [self._known_of(m, means) for m in motions]
        return [around for around in known if around is not None]

    def _known_of(self, motion: OnCurve, means: bool) -> Around | None:
        for kind in {False, means}:
            if (id(motion), kind) in self._seen:
                return self._seen[id(motion), kind][1]
        return None

    def column(self, motions: Sequence[OnCurve], name: str) -> Float[np.ndarray, " motions"]:
        """Return one measured number of some motions."""
        return np.array([a.value[MEASURED.index(name)] for a in self.around(motions)])

    def bends(self, motion: OnCurve, measured: bool) -> Bends:
        """Return how the derivatives along the curve change, of the parameter or all measured."""
        found = self._batch(bends_around, [motion], [(0, 0.0)], more=(measured,))
        return jax.tree.map(lambda a: a[0], found)

    def at(self, motion: OnCurve, value: float, moves: Any = 0.0) -> Node:
        """Return what is measured at a value of the parameter, of the motion next to it.

        `moves` are derivatives of the value in the numbers.
        """
        (here,) = self.around([motion])
        missing, by_number = here.value[PARAMETER] - value, here.by_number[:, PARAMETER] - moves
        return _placed(here, missing, here.along[PARAMETER], by_number)

    def at_fold(self, motion: OnCurve) -> Node:
        """Return what is measured at the fold that a motion is."""
        (here,), bends = self.around([motion]), self.bends(motion, measured=False)
        rate = here.along[PARAMETER]
        return _placed(here, rate, bends.along[PARAMETER], bends.by_number[:, PARAMETER])

    def at_touch(self, motion: OnCurve, stop: int, angle: float) -> Node:
        """Return what is measured where a stop is just touched, near a drive phase (rad)."""
        found = self._batch(look_around, [motion], [(stop, angle)], more=(False,))
        here = jax.tree.map(lambda a: a[0], found)
        columns = (a[..., CLEARANCE] for a in (here.value, here.along, here.by_number))
        return _placed(here, *columns)

    def at_multiplier(self, motion: OnCurve) -> Node:
        """Return what is measured where a Floquet multiplier has the modulus 1, near a motion."""
        (here,) = self.around([motion])
        values, right = np.linalg.eig(motion.matrix)
        k = int(np.argmin(np.abs(np.abs(values) - 1)))
        left = np.linalg.inv(right)[k].conj()
        both = left[None].astype(complex), right[None, :, k].astype(complex)
        found = self._batch(multipliers_around, [motion], [(0, 0.0)], both)
        slopes: MultiplierSlopes = jax.tree.map(lambda a: a[0], found)
        missing = float(np.log(np.abs(values[k])))
        return _placed(here, missing, slopes.along, slopes.by_number)

    def as_it_is(self, motion: OnCurve) -> Node:
        """Return what is measured of a motion of which no condition is known."""
        (here,) = self.around([motion])
        return Node(here.value, np.full_like(here.by_number, np.nan))

    def _batch(
        self,
        program: Any,
        motions: Sequence[OnCurve],
        touches: Sequence[tuple[int, float]],
        arrays: tuple[np.ndarray, ...] = (),
        more: tuple[Any, ...] = (),
    ) -> Any:
        room = next(r for r in ROOMS if r >= max(len(m.times) for m in motions))
        each = [self._known(m, room, t) for m, t in zip(motions, touches, strict=True)]
        known = jax.tree.map(lambda *a: np.stack(a), *each)
        width = WIDTHS[0] if len(motions) == 1 else WIDTHS[1]

        def part(index: np.ndarray) -> Any:
            own = (self.path, self.slopes)
            path, slopes = (
                jax.tree.map(lambda a: np.broadcast_to(a, (width, *np.shape(a))), t) for t in own
            )
            picked = jax.tree.map(lambda a: a[index], (known, *arrays))
            return program(path, slopes, *picked, self.period, *more)

        return in_batches(part, len(motions), width)

    def _known(self, m: OnCurve, room: int, touch: tuple[int, float]) -> KnownMotion:
        count, section = len(m.times), m.contacts.section
        stops = np.full(room, -1, np.int32)
        stops[:count] = m.contacts.stops
        times = np.full(room, section + TURN * self.period)
        times[:count] = m.times
        events: Any = Events(stops, np.int32(m.contacts.first_phase), np.float64(section))
        numbers = m.parameter_along, m.matrix, self.curve.scale, np.int32(touch[0]), touch[1]
        return KnownMotion(events, times, m.state, np.float64(m.parameter), m.state_along, *numbers)


def _placed(here: Around, missing: float, along: float, by_number: np.ndarray) -> Node:
    """Go to where what is missing to a condition is zero, to first order."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shift, moves = -missing / along, -by_number / along
    return Node(here.value + shift * here.along, here.by_number + moves[:, None] * here.along)
