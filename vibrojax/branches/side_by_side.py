"""The walks of many lanes side by side: what they ask for is computed together."""

from collections.abc import Callable, Generator
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from vibrojax.branches.contacts import TURN, Contacts
from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.on_curve import Ask, Look, OnCurve, Seen
from vibrojax.steady.batches import filled_up
from vibrojax.steady.contact_times import Events
from vibrojax.steady.curve_programs import STRIDE, read_on_curve, solve_on_curve
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.orbit_curve import ROOM, Condition, Stride, Try
from vibrojax.steady.paths import AbstractPath, FrequencyPath, LocalPath, OpenedPath, localise
from vibrojax.stepping.measures import Measures

WIDTH = 32
"""Motions of lanes side by side solved for in one call; no more than these go one by one, which is
as fast and compiles nothing more."""
BRIEF, SHARE = 1e-4, 0.02
"""Drive angle, rad, of a contact that is as good as none; share of how long short ones last."""


class CurveRigs:
    """Rigs of some lanes along the number that is followed."""

    def __init__(self, paths: AbstractPath, period: int):
        self.paths, self.period = jax.device_get(paths), period
        self.moves = not isinstance(paths, FrequencyPath | OpenedPath)
        """Whether a rig that is known to first order has to be looked at again elsewhere."""
        self.table: LaneTable | None = None
        self.programs: dict[tuple[Any, int], Callable[..., Any]] = {}
        self.started: tuple[list[np.ndarray], LaneTable] | None = None
        """Lanes and tries of the program for motions that was started last; its answers."""

    def run(self, program: Any, own: LaneTable, tries: LaneTable, *more: np.ndarray) -> LaneTable:
        """Start a program on rigs and tries; by name and width it is looked up once."""
        key = program.__name__, len(own.numbers)
        if key not in self.programs:
            self.programs[key] = program.bound(own, tries, *more, self.period)
        return self.programs[key](own.numbers, tries.numbers, *more)

    def solving(self, lanes: np.ndarray, scales: np.ndarray, asks: list[Ask]) -> LaneTable:
        """Start to solve for motions, unless that was started last."""
        tries = _tries(self, scales, asks)
        these = [lanes, tries.numbers]
        if self.started is None or not all(map(np.array_equal, these, self.started[0])):
            own = self.at(lanes, np.array([ask.parameter for ask in asks]))
            self.started = these, self.run(solve_on_curve, own, tries)
        return self.started[1]

    def at(self, lanes: np.ndarray, parameter: np.ndarray) -> LaneTable:
        """Rigs of lanes near some values, one row each."""
        if not self.moves:
            if self.table is None:
                count = _leading(self.paths)
                self.table = self._near(np.arange(count), np.ones(count))
            return self.table.pick(lanes)
        return self._near(lanes, parameter)

    def _near(self, lanes: np.ndarray, parameter: np.ndarray) -> LaneTable:
        local = jax.device_get(localise(self.paths, lanes, parameter, True))
        last = jax.tree.map(lambda a: np.moveaxis(np.asarray(a), 0, -1), local)
        return table_of(last, xp=np)

    def searches(self, parameter: float, scale: float) -> list[CurveSearch]:
        """Searches along the curves of all lanes, from a value on."""
        lanes = np.arange(_leading(self.paths))
        local = self.at(lanes, np.full(len(lanes), parameter)).columns()
        # A force that jumps where a stop is touched, and is zero where it is left, makes a corner.
        pulls = np.array(local.phases.can_pull) | (np.asarray(local.phases.damping) == 0)
        shortest = np.min(_contact_angles(local), axis=1, initial=np.inf)
        brief = np.minimum(BRIEF, SHARE * shortest)
        each = zip(np.asarray(local.phases.weight), pulls.all(axis=1), brief, strict=True)
        whole = TURN * self.period
        return [
            CurveSearch(unit.copy(), scale, whole, bool(smooth), float(angle))
            for unit, smooth, angle in each
        ]


def _contact_angles(local: LocalPath) -> Float[np.ndarray, "lanes stops"]:
    """Drive angles, rad, of short contacts: half a period of each stop and what it moves."""
    phases = local.phases
    assert phases is not None  # of linear stops
    mobility = np.einsum("ijk,ikj->ij", phases.speed_towards_stop, phases.push_off)
    rate = np.sqrt(np.abs(np.asarray(phases.stiffness) * mobility))
    w = np.asarray(local.place.angular_frequency)[:, None]
    return np.pi * w / np.where(rate > 0, rate, 1e-300)


def _leading(tree: Any) -> int:
    return next(np.shape(a)[0] for a in jax.tree.leaves(tree) if np.ndim(a))


class Job(NamedTuple):
    """The walk of a lane, as far as it has come."""

    steps: Generator[Any, Any, Any]
    rigs: CurveRigs
    lane: int
    unit: np.ndarray
    """Weights of states in the energy."""
    scale: float
    """Change of the parameter that counts as much as the state changing by its size."""


def compile_ahead(rigs: CurveRigs, lanes: int) -> None:
    """Compile in the background what walks of so many lanes will run."""
    first = np.zeros(1, int)
    own = rigs.at(first, np.ones(1))
    n = own.columns().phases.weight.shape[1]
    nothing = Ask(Contacts((), 0, 0.0), np.zeros(0), np.zeros(n), 1.0)
    tries = _tries(rigs, np.ones((1, n + 1)), [nothing])
    for width, program in ((STRIDE, read_on_curve), (_width(lanes), solve_on_curve)):
        rows = np.zeros(width, int)
        more = (np.zeros(width),) if program is read_on_curve else ()
        program.ahead(own.pick(rows), tries.pick(rows), *more, rigs.period)


def run_together(jobs: list[Job]) -> list[Any]:
    """Run generators to their ends, and return what they return."""
    results: list[Any] = [None] * len(jobs)
    asked = {k: _next(job, None, results, k) for k, job in enumerate(jobs)}
    while True:
        asked = {k: request for k, request in asked.items() if request is not None}
        if not asked:
            return results
        answers = _answers(jobs, asked)
        asked = {k: _next(jobs[k], answers[k], results, k) for k in asked}


def _next(job: Job, answer: Any, results: list[Any], k: int) -> Any:
    try:
        return job.steps.send(answer)
    except StopIteration as end:
        results[k] = end.value
        return None


def _answers(jobs: list[Job], asked: dict[int, Any]) -> dict[int, Any]:
    answers: dict[int, Any] = {}
    groups: dict[tuple[int, bool], list[int]] = {}
    for k, request in asked.items():
        groups.setdefault((id(jobs[k].rigs), isinstance(request, Ask)), []).append(k)
    for (_, solves), members in groups.items():
        rigs, lanes = jobs[members[0]].rigs, np.array([jobs[k].lane for k in members])
        if solves:
            scales = np.array([[*jobs[k].unit, jobs[k].scale] for k in members])
            found = _solved(rigs, lanes, scales, [asked[k] for k in members])
            answers |= dict(zip(members, found, strict=True))
        else:
            looks: list[Look] = [asked[k] for k in members]
            count = [len(look.motions) for look in looks]
            every = [m for look in looks for m in look.motions]
            sections = [
                s
                for look in looks
                for s in (look.sections or [m.contacts.section for m in look.motions])
            ]
            whose = np.repeat(lanes, count)
            scales = np.repeat([[*jobs[k].unit, jobs[k].scale] for k in members], count, axis=0)
            following = looks[0].following if len(looks) == 1 and not rigs.moves else None
            seen = _seen(rigs, whose, scales, every, sections, following)
            ends = np.cumsum([0, *count])
            answers |= {k: seen[ends[i] : ends[i + 1]] for i, k in enumerate(members)}
    return answers


@lru_cache
def _blank(states: int) -> LaneTable:
    """A table of `Try` with one row of zeros."""
    numbers: Any = np.zeros
    none, zero, state = numbers((ROOM, 1)), numbers(1), numbers((states, 1))
    whole: Any = np.zeros(1, np.int32)
    events = Events(none.astype(np.int32), whole, zero)
    condition = Condition(state, none, zero, zero, zero)
    stride = Stride(zero, zero, zero, zero, zero, whole)
    return table_of(Try(events, state, none, zero, state, zero, whole, condition, stride), xp=np)


def _tries(rigs: CurveRigs, scales: np.ndarray, asks: list[Ask]) -> LaneTable:
    whole = TURN * rigs.period
    table = _blank(scales.shape[1] - 1).pick(np.zeros(len(asks), int))
    tries: Any = table.columns()
    tries.events.stop[:], tries.unit[:], tries.scale[:] = -1, scales[:, :-1], scales[:, -1]
    for i, ask in enumerate(asks):
        n, (stops, first, section) = len(ask.times), ask.contacts
        tries.events.stop[i, :n] = stops
        tries.events.first_phase[i], tries.events.section[i] = first, section
        tries.times[i], tries.times[i, :n] = section + whole, ask.times
        tries.state[i], tries.parameter[i], tries.peak[i] = ask.state, ask.parameter, ask.peak
        condition = tries.condition
        condition.state[i], condition.times[i, :n] = ask.by_state, ask.by_times
        condition.parameter[i], condition.height[i] = ask.by_parameter, ask.by_height
        condition.value[i] = ask.value
        for column, number in zip(tries.stride, ask.stride, strict=True):
            column[i] = number
    return table


def _width(rows: int) -> int:
    return 1 if rows <= WIDTH else WIDTH


def _solved(
    rigs: CurveRigs, lanes: np.ndarray, scales: np.ndarray, asks: list[Ask]
) -> list[list[OnCurve]]:
    """Motions that were asked for, and those of their strides; errors say whether they are any."""
    if rigs.moves:  # a rig is known near the first motion of a stride only
        asks = [ask._replace(stride=ask.stride._replace(most=1)) for ask in asks]
    fit, every = np.flatnonzero([len(ask.times) <= ROOM for ask in asks]), []
    width = _width(len(fit))
    for at in fit[filled_up(len(fit), width)].reshape(-1, width):
        own = [asks[i] for i in at]
        part = _solve(rigs, lanes[at], scales[at], own)
        if rigs.moves:
            # Once more, the rig taken from where the motions are.
            again = [
                a._replace(state=m.state, times=m.times, parameter=m.parameter)
                if np.isfinite(m.error)
                else a
                for a, (m, *_) in zip(own, part, strict=True)
            ]
            part = _solve(rigs, lanes[at], scales[at], again)
        every += part
    found = dict(zip(fit.tolist(), every, strict=False))
    return [found[i] if i in found else [_nothing(ask)] for i, ask in enumerate(asks)]


def _nothing(ask: Ask) -> OnCurve:
    n = len(ask.state)
    return OnCurve(
        ask.contacts, ask.times, ask.state, ask.parameter, ask.state, ask.times, 0.0, np.eye(n)
    )


def _solve(
    rigs: CurveRigs, lanes: np.ndarray, scales: np.ndarray, asks: list[Ask]
) -> list[list[OnCurve]]:
    every, steps = rigs.solving(lanes, scales, asks).columns()
    found = []
    for i, ask in enumerate(asks):
        rows = range(i, len(every.error), len(asks))
        count = 1
        while count < len(rows) and np.isfinite(every.error[rows[count]]):
            count += 1
        found.append([_row(every, k, ask, steps[k]) for k in rows[:count]])
    return found


def _row(every: Any, k: int, ask: Ask, step: float) -> OnCurve:
    n = len(ask.times)
    return OnCurve(
        contacts=ask.contacts,
        times=every.times[k, :n].copy(),
        state=every.state[k].copy(),
        parameter=float(every.parameter[k]),
        state_along=every.state_along[k].copy(),
        times_along=every.times_along[k, :n].copy(),
        parameter_along=float(every.parameter_along[k]),
        matrix=every.matrix[k].copy(),
        error=float(every.error[k]),
        step=float(step),
        height_along=float(every.height_along[k]),
        bend=float(every.bend[k]),
    )


def _seen(
    rigs: CurveRigs,
    lanes: np.ndarray,
    scales: np.ndarray,
    motions: list[OnCurve],
    sections: list[float],
    following: Ask | None,
) -> list[Seen]:
    """What marches of motions over their period show; meanwhile what follows is solved for."""
    found: list[Seen] = []
    for rows in filled_up(len(motions), STRIDE).reshape(-1, STRIDE):
        own = [motions[i] for i in rows]
        asks = [Ask(m.contacts, m.times, m.state, m.parameter) for m in own]
        table = rigs.at(lanes[rows], np.array([m.parameter for m in own]))
        tries = _tries(rigs, scales[rows], asks)
        at = np.array([sections[i] for i in rows])
        marching = rigs.run(read_on_curve, table, tries, at)
        if following is not None:
            rigs.solving(lanes[:1], scales[:1], [following])
        for motion in own:
            motion.find_multipliers()  # on this core; the programs run on others
        read: Any = marching.columns()
        log = read.measures.events
        sums = zip(*(column.tolist() for column in read.measures.sums), strict=True)
        nearest = zip(*read.measures.nearest.swapaxes(0, 1).tolist(), strict=True)
        left = range(len(motions) - len(found))  # without those that fill it up
        for i, measures, near in zip(left, sums, nearest, strict=False):
            number = int(log.number[i])
            kept = min(number, ROOM)
            met = Contacts(
                tuple(log.stop[i, :kept].astype(int).tolist()),
                int(log.first_phase[i]),
                own[i].contacts.section,
            )
            found.append(
                Seen(
                    contacts=met,
                    times=np.array(log.angle[i, :kept]),
                    fits=number <= ROOM,
                    initial_state=np.array(read.initial_state[i]),
                    at_section=np.array(read.at_section[i]),
                    measures=Measures(*measures),
                    nearest=near,
                )
            )
    return found
