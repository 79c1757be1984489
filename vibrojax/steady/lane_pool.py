"""Many lanes to their steady states, each at its own pace: the engine of everything that settles.

One loop over all lanes would run as long as its slowest lane. Here every lane goes through its own
stages (march, Newton's method, measuring, the next frequency; see `settling`), and what is run is
always the fullest stage, on as many lanes as one loop takes.

A lane that has settled is followed to its next frequency where that can be, by its contact times
(`following`) or on the map of its period (`map_orbits`); all else is marched. First the march goes
near to the limit, for Newton's method; what that does not settle marches on to the full tolerance
and is tried once more.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrojax.steady.following import advance, steps_of_lanes
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.last_motions import LastMotions
from vibrojax.steady.map_orbits import least_periods
from vibrojax.steady.points_ahead import PointsAhead
from vibrojax.steady.pool_programs import (
    filled,
    march_some,
    measured,
    polish_some,
    targets_for,
    widths_for,
    widths_to_measure,
)
from vibrojax.steady.settled import SETTLED, Onwards, Settled, place_in_lane, status_of
from vibrojax.steady.settling import (
    APERIODIC_PERIODS,
    CLOSED,
    NEAR,
    begin_search,
    most_periods,
    settling_time,
    slow_limits,
)
from vibrojax.steady.tracks import begin_track, can_follow, keeps_to_contacts
from vibrojax.stepping.resonance import is_unbounded
from vibrojax.stepping.stepper import AbstractMarch

MARCH, APPROACH, POLISH, MEASURE, ORIENT, FOLLOW, READ, IDLE = range(8)

ARRIVED = 0.0
"""Limit of a lane that has marched to the full tolerance."""


class LanePool:
    """Lanes on their ways through frequencies; `rig[k]` is the rig of lane k among those prepared.

    Arrays here have the lanes leading; lanes are not marched at their `resonances`.
    """

    def __init__(
        self,
        march: AbstractMarch,
        rig: Int[np.ndarray, " lanes"],
        resonances: Float[np.ndarray, "modes lanes"],
        tolerance: float,
        max_period: int,
        max_periods: int | None,
        follow: bool = False,
    ):
        self.march, self.rig, self.resonances = march, rig, resonances
        rigs = table_of(march, xp=np)
        weight = np.asarray(march.energy_weight()).T
        self.weight = weight[rig]
        self.follow = follow
        """Whether lanes are followed where that can be."""
        self.by_contacts = (follow & can_follow(rigs.columns(), len(weight)))[rig]
        """Which lanes are, by their contact times, while their period is 1."""
        self.tolerance, self.max_period = tolerance, max_period
        self.max_periods, self.settling = max_periods, settling_time(march)[rig]
        self.rigs, each = rigs.on_device(), (len(rig), rigs.numbers.shape[1])
        self.widths, self.widths_to_measure = widths_for(*each), widths_to_measure(*each)

    def run(
        self,
        state: Float[np.ndarray, "lanes states"],
        angular_frequency: Float[np.ndarray, " lanes"],
        onwards: Callable[[Settled], Onwards],
        report: Callable[[int], object] = lambda count: None,
        ahead: Callable[[np.ndarray, int], np.ndarray] | None = None,
    ) -> None:
        """Settle all lanes, again and again, until none is sent on any more.

        `onwards` takes note of the steady states of some lanes and says where they go next;
        `report` takes numbers of points reached. `ahead` says to which frequencies (rad/s) some
        lanes go after the next, shape (a number of them, lanes), NaN where there are no more.
        """
        self.onwards, self.report, self.ahead = onwards, report, ahead
        count = len(self.rig)
        self.frequency, self.state = np.array(angular_frequency, float), np.array(state, float)
        self.march.check_steps(np.asarray(self.rig), self.frequency)
        self.searches = self._fresh(self.state * self.weight)
        self.search: Any = self.searches.columns()
        self.stage, self.limit = np.full(count, IDLE), np.full(count, NEAR)
        self.period, self.wanted = np.zeros((2, count), np.int32)
        """Period found, and the one that Newton's method is to try."""
        self.last = LastMotions(count, self.state.shape[1])
        self.track, self.orbit = self.last.track, self.last.orbit
        self.predicted = np.zeros(count, bool)
        """Whether the state of a lane is where its last orbit should have gone on to."""
        self.residual = np.full(count, np.inf)
        """How far from its orbit it is known to have been there, over its size."""
        self.pace = np.full((count, 2), np.inf)
        """Rows of `Pace`."""
        self.points = PointsAhead(count, targets_for(self.widths[0]), self.state.shape[1])
        self.oriented = np.zeros(count, bool)
        """Whether a lane has marched to where it is to be solved for, not followed."""
        every = np.ones(count, bool)
        self._send(np.arange(count), Onwards(every, self.frequency, self.state, every))
        # In the order of the stages.
        runs = self._run_march, self._approach, self._run_polish, self._measure, self._orient
        runs = *runs, self._run_follow, self._read
        while True:
            counts = np.bincount(self.stage, minlength=IDLE + 1)[:IDLE]
            if not counts.any():
                return
            stage = int(np.argmax(np.minimum(counts, self.widths[-1])))
            runs[stage](np.flatnonzero(self.stage == stage))

    def _arrive(self, settled: Settled) -> None:
        """Hand over the steady states of some lanes, and send them on."""
        self._send(settled.lanes, self.onwards(settled))
        self.report(len(settled.lanes))

    def _fresh(self, weighted: np.ndarray) -> LaneTable:
        return table_of(begin_search(weighted.T, self.max_period, np), xp=np)

    def _send(self, lanes: np.ndarray, onwards: Onwards) -> None:
        last = np.diff(lanes, append=-1) != 0  # of the points of a lane
        lanes, onwards = lanes[last], Onwards(*(a[last] for a in onwards))
        active, frequency, self.state[lanes], goes_on = onwards
        back, on = lanes[~goes_on], lanes[goes_on]
        self.last.leave(on, back)
        self.frequency[lanes] = np.where(active, frequency, self.frequency[lanes])
        first = np.where(self.track.known[lanes] >= 0, FOLLOW, MARCH)
        first[(first == MARCH) & self.follow & (self.orbit.period[lanes] > 0)] = APPROACH
        first = np.where(self._grows(lanes), MEASURE, first)
        self.stage[lanes] = np.where(active, first, IDLE)
        self.pace[lanes], self.search.steps[lanes], self.search.marched[lanes] = np.inf, 0, 0
        self.oriented[lanes], self.limit[lanes] = False, NEAR
        self._refresh(lanes[self.stage[lanes] == MARCH])
        self.predicted[lanes], self.residual[lanes] = self.stage[lanes] == APPROACH, np.inf
        k = lanes[self.predicted[lanes]]
        self.state[k] = self.last.orbits_at(k, self.frequency[k]) / self.weight[k]
        self.wanted[k] = self.period[k] = self.orbit.period[k]

    def _go_back(self, lanes: np.ndarray) -> None:
        """March lanes from their last orbits, which do not go on."""
        self.predicted[lanes], self.stage[lanes] = False, MARCH
        self.state[lanes] = self.last.orbits_left(lanes) / self.weight[lanes]
        self._refresh(lanes)

    def _refresh(self, lanes: np.ndarray) -> None:
        """Begin a search where lanes are, if there are any."""
        if not len(lanes):
            return
        self.orbit.period[lanes], steps = 0, self.search.steps[lanes]
        self.searches.numbers[lanes] = self._fresh(self.state[lanes] * self.weight[lanes]).numbers
        self.search.steps[lanes] = steps

    def _grows(self, lanes: np.ndarray) -> np.ndarray:
        """Whether lanes would grow without bound: they are not marched."""
        return np.asarray(is_unbounded(self.resonances[:, lanes], self.frequency[lanes], np))

    def _most_periods(self, lanes: np.ndarray) -> np.ndarray:
        """Drive periods that lanes are marched for at the most."""
        if self.max_periods is not None:
            return np.full(len(lanes), self.max_periods, np.int32)
        return most_periods(self.settling[lanes], self.frequency[lanes], self.max_period)

    def _own(self, lanes: np.ndarray) -> LaneTable:
        """March of some lanes, each with its rig."""
        return self.rigs.pick(self.rig[lanes])

    def _marched(
        self, lanes: np.ndarray, state: np.ndarray, frequency: np.ndarray, window: np.ndarray
    ) -> Any:
        """March lanes over windows: where they end, the steps, and what was measured."""
        widths = self.widths_to_measure
        return measured(self.rigs, self.rig[lanes], state, frequency, window, widths)

    def _batch(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the lanes of one loop and the same filled up to its width."""
        # Lanes of like pace: one loop takes as long as its slowest lane.
        pace = self.search.steps[chosen] / np.maximum(self.search.marched[chosen], 1)
        own = chosen[np.argsort(pace, kind="stable")][: self.widths[-1]]
        return own, filled(own, self.widths)

    def _batch_of_like(self, chosen: np.ndarray, periods: np.ndarray):
        """Together what takes the same number of periods."""
        return self._batch(chosen[periods[chosen] == periods[chosen].min()])

    def _run_march(self, chosen: np.ndarray) -> None:
        own, lanes = self._batch(chosen)
        n = len(own)
        # Lanes that wait for their turn, or come back soon, take the places of those that are done.
        still = 3 * n // 4 if len(chosen) > n else n // 2
        search = self.searches.pick(lanes)
        search.columns().done[n:] = True
        given = self._own(lanes), search, self.frequency[lanes], self.limit[lanes]
        marched = march_some(*given, self._most_periods(lanes), np.int32(still))
        # The last column is the period found.
        numbers = np.asarray(marched.numbers)[:n]
        self.searches.numbers[own] = numbers[:, :-1]
        arrived = self.search.done[own] > 0
        own, period = own[arrived], numbers[arrived, -1].astype(np.int32)
        self.state[own] = self.search.history[own, 0] / self.weight[own]
        lost = ~np.isfinite(self.state[own]).all(axis=1)
        # Period 1 first: a slowly turning period-1 motion returns best after several periods.
        self.wanted[own], self.period[own] = np.minimum(period, 1), period
        self.stage[own] = np.where(period > 0, POLISH, MEASURE)
        self.stage[own[(period == 1) & self.by_contacts[own]]] = ORIENT
        self.limit[own[(period > 0) & (self.limit[own] == self.tolerance)]] = ARRIVED
        self._march_on(own[(period == 0) & ~lost])

    def _march_on(self, lanes: np.ndarray) -> None:
        """Let lanes go on to the full tolerance, unless they marched for too long already.

        Those that settle slowly are looked for on the limit of their decay, once: inf marks them.
        """
        self.state[lanes] = self.search.history[lanes, 0] / self.weight[lanes]
        over = self.search.marched[lanes] >= self._most_periods(lanes)
        self.period[lanes], self.stage[lanes] = 0, np.where(over, MEASURE, MARCH)
        slow = lanes[over & (self.limit[lanes] < np.inf)]
        limit, period = slow_limits(self.search.history[slow], self.max_period)
        slow, limit, period = (a[period > 0] for a in (slow, limit, period))
        self.limit[lanes], self.limit[slow] = self.tolerance, np.inf
        self.search.streak[lanes], self.search.done[lanes] = 0, False
        self.state[slow] = limit / self.weight[slow]
        self.wanted[slow] = self.period[slow] = period
        self.stage[slow] = np.where((period == 1) & self.by_contacts[slow], ORIENT, POLISH)

    def _run_follow(self, chosen: np.ndarray) -> None:
        """Follow lanes towards their frequencies, and from there on to those behind them.

        What cannot be followed any further is marched from its last motion.
        """
        own, lanes = self._batch(chosen)
        n, targets = len(own), np.full((targets_for(len(lanes)), len(lanes)), np.nan)
        targets[0] = self.frequency[lanes]
        if self.ahead is not None:
            targets[1:] = self.ahead(lanes, len(targets) - 1)
        given = self._own(lanes), self.last.tracks.pick(lanes), targets, self.pace[lanes].T
        rows, every = steps_of_lanes(*advance(*given, np.asarray(n // 4)), len(lanes), n)
        self.last.tracks.numbers[own] = rows[:, -1, : self.last.tracks.numbers.shape[1]]
        good, state, rounds = every.found.good > 0, every.found.state, every.found.rounds
        self.pace[own] = np.stack([a[:, -1] for a in every.pace], axis=1)
        arrived, rounds = every.arrived > 0, np.cumsum(rounds, axis=1)
        reads = arrived.any(axis=1)
        # Those that are on their way, or cannot be followed.
        self.search.steps[own[~reads]] += rounds[~reads, -1]
        came = ~reads & good.any(axis=1) & ~self.oriented[own]
        last = good.shape[1] - 1 - np.argmax(good[came, ::-1], axis=1)
        self.state[own[came]] = state[came, last]
        self._give_up(own[(every.ended > 0).any(axis=1)])
        self.points.keep(own[reads], rows[reads], rounds[reads], arrived[reads])
        self.stage[own[reads]] = READ

    def _give_up(self, lanes: np.ndarray) -> None:
        """March lanes that cannot be followed, or go on with those that have marched."""
        self.track.known[lanes] = -1
        self.stage[lanes] = np.where(self.oriented[lanes], POLISH, MARCH)
        self._refresh(lanes[~self.oriented[lanes]])

    def _orient(self, own: np.ndarray) -> None:
        """Note the contacts of lanes that have marched near to a motion, to solve for it."""
        one = np.ones(len(own), np.int32)
        _, steps, measures = self._marched(own, self.state[own], self.frequency[own], one)
        weighted = self.state[own] * self.weight[own]
        begin_track(self.track, own, weighted, self.frequency[own], measures.events)
        self.oriented[own], self.stage[own] = True, FOLLOW
        self.search.steps[own] += steps
        self._give_up(own[self.track.known[own] < 0])

    def _read(self, chosen: np.ndarray) -> None:
        """Measure motions that have been followed; hand over those that keep to their contacts.

        A lane has several points one after the other: it ends before the first that does not.
        """
        lanes, _ = self._batch(chosen)
        own, rounds, points = self.points.of(lanes)
        track, state = points.track, points.found.state
        one, weight = np.ones(len(own), np.int32), self.weight[own]
        end, steps, measures = self._marched(own, state, track.frequency[:, 0], one)
        gone = (end - state) * weight
        bad = ~keeps_to_contacts(track, measures.events, state * weight, gone)
        place, lost = place_in_lane(own), np.cumsum(bad)
        first, begun = place == 0, np.arange(len(own)) - place
        at = np.flatnonzero(lost == (lost - bad)[begun])
        lanes, steps = own[at], self.search.steps[own] * first + steps + rounds
        if len(at):
            settled = Settled(
                lanes=lanes,
                state=state[at],
                period=one[at],
                status=one[at] * SETTLED,
                periods_marched=(self.search.marched[lanes] * first[at]).astype(np.int32),
                steps=steps[at].astype(np.int32),
                window=one[at],
                measures=jax.tree.map(lambda a: a[at], measures._replace(events=None)),
            )
            self._arrive(settled)
        self._give_up(np.unique(own[bad]))

    def _approach(self, chosen: np.ndarray) -> None:
        """Take lanes nearer to the orbits that they should have gone on to, by a march each."""
        own, lanes = self._batch_of_like(chosen, self.wanted)
        begun = self.state[lanes] * self.weight[lanes]
        given = self._own(lanes), self._fresh(begun), self.frequency[lanes], self.limit[lanes]
        periods = np.full(len(lanes), self.wanted[own[0]], np.int32)
        search, _ = march_some(*given, periods, np.int32(0)).columns()
        begun, end = begun[: len(own)], search.history[: len(own), 0]
        nearer, error = self.last.stepped(own, begun, end)
        self.search.steps[own] += search.steps[: len(own)]
        arrived = (error <= CLOSED) | ~(error < self.residual[own] / 2)
        self.residual[own], self.stage[own[arrived]] = error, POLISH
        left = own[~arrived]
        self.state[left] = nearer[~arrived] / self.weight[left]

    def _run_polish(self, chosen: np.ndarray) -> None:
        own, lanes = self._batch_of_like(chosen, self.wanted)
        last = self.last.orbits.pick(lanes)
        last.columns().period[~self.predicted[lanes]] = 0
        rigs, state, frequency = self._own(lanes), self.state[lanes], self.frequency[lanes]
        table = polish_some(rigs, last, state, frequency, self.wanted[lanes])
        # The last column is whether the orbit is to be taken.
        numbers = np.asarray(table.numbers)[: len(own)]
        good = numbers[:, -1] > 0
        settled, left = own[good], own[~good]
        self.last.orbits.numbers[settled] = numbers[good, :-1]
        self.state[settled] = self.orbit.state[settled] / self.weight[settled]
        self.stage[settled] = MEASURE
        # After a march that returned period 1 has been tried before any other.
        returned = ~self.predicted[settled] & (self.limit[settled] < np.inf)
        first, orbit = np.where(returned, 2, 1), self.orbit.state[settled]
        after = lambda k, n: self._after(settled[k], n)  # noqa: E731
        self.period[settled] = least_periods(self.wanted[settled], orbit, first, after)
        self._go_back(left[self.predicted[left]])
        left = left[self.stage[left] == POLISH]
        over = self.wanted[left] >= self.period[left]
        self.wanted[left] = self.period[left]
        left, arrived = left[over], self.limit[left[over]] == ARRIVED
        self.stage[left[arrived]] = MEASURE
        self._march_on(left[~arrived])

    def _after(self, own: np.ndarray, periods: int) -> np.ndarray:
        """March lanes over so many drive periods; in units of energy."""
        window = np.full(len(own), periods, np.int32)
        end, _, _ = self._marched(own, self.state[own], self.frequency[own], window)
        return end * self.weight[own]

    def _measure(self, chosen: np.ndarray) -> None:
        """Measure motions and hand them over, but those that should have kept to their contacts."""
        window = np.where(self.period > 0, self.period, APERIODIC_PERIODS)
        own, _ = self._batch_of_like(chosen, window)
        state, grows = self.state[own], self._grows(own)
        lost = grows | ~np.all(np.isfinite(state), axis=1)
        # A lane that is lost starts again from rest at the next frequency.
        begin = np.where(lost[:, None], 0.0, state)
        window = np.where(lost, 0, window[own]).astype(np.int32)
        end, steps, measures = self._marched(own, begin, self.frequency[own], window)
        contacts = measures.contacts / np.maximum(window, 1)
        strays = self.predicted[own] & (contacts != self.orbit.contacts[own])
        self.track.known[own] = -1
        one = ~lost & (self.period[own] == 1) & self.by_contacts[own]
        if one.any():
            log, at = jax.tree.map(lambda a: a[one], measures.events), own[one]
            weighted = self.state[at] * self.weight[at]
            begin_track(self.track, at, weighted, self.frequency[at], log)
        holds = ~one & ~lost & (self.orbit.period[own] == self.period[own])
        self.orbit.period[own[~holds]], self.orbit.contacts[own] = 0, contacts
        status = status_of(state, grows, self.period[own])
        period = np.where(lost, 0, self.period[own])
        # Periodic lanes go on from the orbit itself, the others from where the measuring ended.
        goes_on = (period == 0) & np.isfinite(end).all(axis=1)
        settled = Settled(
            lanes=own,
            state=np.where(goes_on[:, None], end, begin),
            period=period,
            status=status,
            periods_marched=self.search.marched[own].astype(np.int32),
            steps=(self.search.steps[own] + steps).astype(np.int32),
            window=np.maximum(window, 1),
            measures=measures._replace(events=None),
        )
        if strays.any():
            self._go_back(own[strays])
            settled = jax.tree.map(lambda a: a[~strays], settled)
        if len(settled.lanes):
            self._arrive(settled)
