"""Rigs whose branches were followed together, and what is computed for them side by side."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from vibrojax.branches.contacts import TURN
from vibrojax.branches.on_curve import OnCurve, Steps
from vibrojax.branches.side_by_side import CurveRigs, Job, run_together
from vibrojax.design.around import KnownMotion
from vibrojax.steady.batches import in_batches
from vibrojax.steady.contact_times import Events

ROOMS = 16, 128
"""Changes of contact that programs have room for; the least that is enough is taken."""
WIDTH = 8
"""Motions measured in one call: of fewer it takes little longer, and compiles nothing more."""


class Searches(NamedTuple):
    """Motions of a rig's branch that are to be searched for."""

    lane: int
    steps: Sequence[Steps]
    unit: np.ndarray
    scale: float


class Measuring(NamedTuple):
    """Motions of a rig's branch that are to be measured by a program of `around`."""

    lane: int
    program: Any
    motions: Sequence[OnCurve]
    scale: float
    touches: Sequence[tuple[int, float]]
    """Stop and drive phase (rad) whose clearance is meant, of each motion."""
    arrays: tuple[np.ndarray, ...] = ()
    """Further arrays by motion."""
    options: tuple[Any, ...] = ()


Request = Searches | Measuring
Ask = Callable[[Request], Any]


class RigGroup:
    """Paths of some rigs along the frequency, with their derivatives, stacked."""

    def __init__(self, paths: Any, slopes: Any, period: int):
        self.paths, self.slopes, self.period = paths, slopes, period
        self._rigs: CurveRigs | None = None

    def alone(self, request: Request) -> Any:
        """Answer one request."""
        return self.answer({0: request})[0]

    def answer(self, requests: dict[int, Request]) -> dict[int, Any]:
        """Answer some requests together."""
        found: dict[int, Any] = {}
        searches = {k: r for k, r in requests.items() if isinstance(r, Searches)}
        if searches:
            found |= self._searched(searches)
        kinds: dict[tuple[Any, ...], dict[int, Measuring]] = {}
        for k, request in requests.items():
            if isinstance(request, Measuring):
                room = next(r for r in ROOMS if r >= max(len(m.times) for m in request.motions))
                kind = request.program.__name__, room, request.options
                kinds.setdefault(kind, {})[k] = request
        for (_, room, _), alike in kinds.items():
            found |= self._measured(alike, room)
        return found

    def _searched(self, searches: dict[int, Searches]) -> dict[int, list[Any]]:
        if self._rigs is None:
            self._rigs = CurveRigs(self.paths, self.period)
        jobs = [
            Job(steps, self._rigs, each.lane, each.unit, each.scale)
            for each in searches.values()
            for steps in each.steps
        ]
        results = iter(run_together(jobs))
        return {k: [next(results) for _ in each.steps] for k, each in searches.items()}

    def _measured(self, alike: dict[int, Measuring], room: int) -> dict[int, Any]:
        each = list(alike.values())
        lanes = np.concatenate([np.full(len(e.motions), e.lane) for e in each])
        rows = [
            self._known(motion, room, e.scale, touch)
            for e in each
            for motion, touch in zip(e.motions, e.touches, strict=True)
        ]
        arrays = [np.concatenate(own) for own in zip(*(e.arrays for e in each), strict=True)]
        known = jax.tree.map(lambda *a: np.stack(a), *rows)

        def part(index: np.ndarray) -> Any:
            own = self.paths, self.slopes
            paths, slopes = (jax.tree.map(lambda a: a[lanes[index]], tree) for tree in own)
            picked = jax.tree.map(lambda a: a[index], (known, *arrays))
            return each[0].program(paths, slopes, *picked, self.period, *each[0].options)

        found = in_batches(part, len(rows), WIDTH)
        ends = np.cumsum([0, *(len(e.motions) for e in each)]).tolist()
        return {
            k: jax.tree.map(lambda a, i=i: a[ends[i] : ends[i + 1]], found)
            for i, k in enumerate(alike)
        }

    def _known(self, m: OnCurve, room: int, scale: float, touch: tuple[int, float]) -> KnownMotion:
        count, section = len(m.times), m.contacts.section
        stops = np.full(room, -1, np.int32)
        stops[:count] = m.contacts.stops
        times = np.full(room, section + TURN * self.period)
        times[:count] = m.times
        begin: Any = stops, np.int32(m.contacts.first_phase), np.float64(section)
        events: Any = Events(*begin)
        place: Any = np.int32(touch[0]), np.float64(touch[1])
        numbers: Any = np.float64(m.parameter_along), m.matrix, np.float64(scale), *place
        parameter: Any = np.float64(m.parameter)
        return KnownMotion(events, times, m.state, parameter, m.state_along, *numbers)
