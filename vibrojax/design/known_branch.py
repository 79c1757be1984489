"""A branch whose motions can be measured with their derivatives in the rig's numbers."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from vibrojax._tools.types import AnyArray
from vibrojax.branches.exact_results import walk_of
from vibrojax.branches.on_curve import OnCurve, Steps
from vibrojax.branches.points import BranchPoints
from vibrojax.design.around import (
    MEASURED,
    Around,
    Rates,
    bends_around,
    look_around,
    multipliers_around,
)
from vibrojax.design.group import Ask, Measuring, RigGroup, Searches

PARAMETER, CLEARANCE = MEASURED.index("parameter"), MEASURED.index("clearance")
NOWHERE = 0, 0.0
"""Stop and drive phase where no clearance is meant."""


class Node(NamedTuple):
    """What is measured at a place of a branch that a condition says; columns as of `MEASURED`."""

    value: Float[AnyArray, " measured"]
    slopes: Float[AnyArray, "numbers measured"]
    """Derivatives in the numbers, the place going along; NaN where they are not known."""


class KnownBranch:
    """A branch of one rig of a group, and how it changes with so many numbers of the rig."""

    def __init__(self, branch: BranchPoints, group: RigGroup, lane: int, numbers: int):
        assert branch.curve is not None  # of linear stops, as was checked
        self.branch, self.curve = branch, branch.curve
        self.lane, self.numbers = lane, numbers
        self.walk = walk_of(branch.curve, branch.range)
        self.ask: Ask = group.alone
        """Who computes: the group alone, or together with what others ask for."""
        self._seen: dict[tuple[int, bool], tuple[OnCurve, Around]] = {}

    def run(self, steps: Sequence[Steps]) -> list[Any]:
        """Run searches for motions side by side; they must not ask for measures."""
        search = self.walk.search
        return self.ask(Searches(self.lane, steps, search.unit, search.scale)) if steps else []

    def around(self, motions: Sequence[OnCurve], *, means: bool = False) -> list[Around]:
        """Measure some motions, and how that changes; where it is enough, only their means."""
        new = [m for m in motions if self._known_of(m, means) is None]
        if new:
            found = self._measure(look_around, new, [NOWHERE] * len(new), options=(means,))
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

    def bends(self, motion: OnCurve, measured: bool) -> Rates:
        """Return how the derivatives along the curve change, of the parameter or all measured."""
        return self._one(bends_around, motion, options=(measured,))

    def at(self, motion: OnCurve, value: float) -> Node:
        """Return what is measured at a value of the parameter, of the motion next to it."""
        (here,) = self.around([motion])
        missing, by_number = here.value[PARAMETER] - value, here.by_number[:, PARAMETER]
        return _placed(here, missing, here.along[PARAMETER], by_number)

    def at_fold(self, motion: OnCurve) -> Node:
        """Return what is measured at the fold that a motion is."""
        (here,), bends = self.around([motion]), self.bends(motion, measured=False)
        # Of the parameter, which is all that is asked for.
        return _placed(here, here.along[PARAMETER], bends.along[0], bends.by_number[:, 0])

    def at_touch(self, motion: OnCurve, stop: int, angle: float) -> Node:
        """Return what is measured where a stop is just touched, near a drive phase (rad)."""
        here: Around = self._one(look_around, motion, (stop, angle), options=(False,))
        columns = (a[..., CLEARANCE] for a in (here.value, here.along, here.by_number))
        return _placed(here, *columns)

    def at_multiplier(self, motion: OnCurve) -> Node:
        """Return what is measured where a Floquet multiplier has the modulus 1, near a motion."""
        (here,) = self.around([motion])
        values, right = np.linalg.eig(motion.matrix)
        k = int(np.argmin(np.abs(np.abs(values) - 1)))
        left = np.linalg.inv(right)[k].conj()
        both = left[None].astype(complex), right[None, :, k].astype(complex)
        slopes: Rates = self._one(multipliers_around, motion, arrays=both)
        missing = float(np.log(np.abs(values[k])))
        return _placed(here, missing, slopes.along, slopes.by_number)

    def as_it_is(self, motion: OnCurve) -> Node:
        """Return what is measured of a motion of which no condition is known."""
        (here,) = self.around([motion])
        return Node(here.value, np.full_like(here.by_number, np.nan))

    def _one(
        self, program: Any, motion: OnCurve, touch: tuple[int, float] = NOWHERE, **more: Any
    ) -> Any:
        return jax.tree.map(lambda a: a[0], self._measure(program, [motion], [touch], **more))

    def _measure(
        self,
        program: Any,
        motions: Sequence[OnCurve],
        touches: Sequence[tuple[int, float]],
        **more: Any,
    ) -> Any:
        scale = self.curve.search.scale
        return self.ask(Measuring(self.lane, program, motions, scale, touches, **more))


def _placed(here: Around, missing: Any, along: Any, by_number: Any) -> Node:
    """Go to where what is missing to a condition is zero, to first order."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shift, moves = -missing / along, -by_number / along
    return Node(here.value + shift * here.along, here.by_number + moves[:, None] * here.along)
