"""Many lanes to their steady states, each at its own pace: the engine of everything that settles.

One loop over all lanes would run as long as its slowest lane. Here every lane goes through its own
stages (march, Newton's method, measuring, the next frequency; see `settling`), and what is run is
always the fullest stage, on as many lanes as one loop takes.

A lane that has settled is followed to its next frequency where that can be (`following`); all else
is marched. First the march goes near to the limit, for Newton's method; what that does not settle
marches on to the full tolerance.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.results.status import Status
from vibrojax.steady.following import (
    advance,
    begin_track,
    can_follow,
    keeps_to_contacts,
    no_tracks,
)
from vibrojax.steady.lane_table import LaneTable, table_of
from vibrojax.steady.pool_programs import filled, march_some, measure_some, polish_some, widths_for
from vibrojax.steady.settling import APERIODIC_PERIODS, CLOSED, NEAR, begin_search
from vibrojax.stepping.measures import Measures
from vibrojax.stepping.resonance import is_unbounded
from vibrojax.stepping.stepper import AbstractMarch

SHORTEST = 0.12
"""Shortest step of lanes that are followed, over the way to their next frequency."""

MARCH, POLISH, MEASURE, ORIENT, FOLLOW, READ, IDLE = range(7)


class Settled(NamedTuple):
    """Steady states of some lanes, lanes leading."""

    lanes: Int[np.ndarray, " lanes"]
    state: Float[np.ndarray, "lanes states"]
    period: Int[np.ndarray, " lanes"]
    status: Int[np.ndarray, " lanes"]
    periods_marched: Int[np.ndarray, " lanes"]
    steps: Int[np.ndarray, " lanes"]
    window: Int[np.ndarray, " lanes"]
    """Drive periods measured."""
    measures: Measures


class Onwards(NamedTuple):
    """Where the lanes that settled go next."""

    active: Bool[np.ndarray, " lanes"]
    angular_frequency: Float[np.ndarray, " lanes"]
    """rad/s; of no meaning where a lane is not active any more."""
    state: Float[np.ndarray, "lanes states"]
    goes_on: Bool[np.ndarray, " lanes"]
    """Whether a lane goes on from its last motion; else, again from the one before."""


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
        max_periods: int,
        follow: bool = False,
    ):
        self.march, self.rig, self.resonances = march, rig, resonances
        self.rigs = table_of(march, xp=np)
        weight = np.asarray(march.energy_weight()).T
        self.weight = weight[rig]
        self.follow = (follow & can_follow(self.rigs.columns(), len(weight)))[rig]
        """Which lanes are followed where that can be."""
        self.tolerance, self.max_period = tolerance, max_period
        self.max_periods = jnp.asarray(max_periods)
        self.widths = widths_for(len(rig))

    def run(
        self,
        state: Float[np.ndarray, "lanes states"],
        angular_frequency: Float[np.ndarray, " lanes"],
        onwards: Callable[[Settled], Onwards],
        report: Callable[[int], object] = lambda count: None,
    ) -> None:
        """Settle all lanes, again and again, until none is sent on any more.

        `onwards` takes note of the steady states of some lanes and says where they go next;
        `report` takes numbers of points reached.
        """
        count = len(self.rig)
        self.frequency, self.state = np.array(angular_frequency, float), np.array(state, float)
        self.march.check_steps(np.asarray(self.rig), self.frequency)
        self.searches = self._fresh(self.state * self.weight)
        self.search: Any = self.searches.columns()
        self.stage, self.limit = np.full(count, IDLE), np.full(count, NEAR)
        self.period, self.wanted = np.zeros((2, count), np.int32)
        """Period found, and the one that Newton's method is to try."""
        self.tracks, self.tracks_before = (no_tracks(count, self.state.shape[1]) for _ in range(2))
        """The last motion of a lane, and the one before."""
        self.track: Any = self.tracks.columns()
        self.stride, self.least_stride = np.zeros((2, count))
        """Way (rad/s) that is tried next, and at the least, before a lane is marched."""
        self.arrived_at = self.state.copy()
        self.oriented = np.zeros(count, bool)
        """Whether a lane has marched to where it is to be solved for, not followed."""
        every = np.ones(count, bool)
        self._send(np.arange(count), Onwards(every, self.frequency, self.state, every))
        while True:
            counts = np.bincount(self.stage, minlength=IDLE + 1)[:IDLE]
            if not counts.any():
                return
            stage = int(np.argmax(np.minimum(counts, self.widths[-1])))
            chosen = np.flatnonzero(self.stage == stage)
            if stage == MARCH:
                self._run_march(chosen)
            elif stage == POLISH:
                self._run_polish(*self._batch_of_like(chosen, self.wanted))
            elif stage == FOLLOW:
                self._run_follow(*self._batch_of_like(chosen, np.minimum(self.track.known, 1)))
            elif stage == READ:
                settled = self._read(*self._batch(chosen))
                if len(settled.lanes):
                    self._send(settled.lanes, onwards(settled))
                    report(len(settled.lanes))
            elif stage == ORIENT:
                self._orient(*self._batch(chosen))
            else:
                window = np.where(self.period > 0, self.period, APERIODIC_PERIODS)
                own, lanes = self._batch_of_like(chosen, window)
                self._send(own, onwards(self._measured(own, lanes, window[lanes])))
                report(len(own))

    def _fresh(self, weighted: np.ndarray) -> LaneTable:
        return table_of(begin_search(weighted.T, self.max_period, np), xp=np)

    def _send(self, lanes: np.ndarray, onwards: Onwards) -> None:
        active, frequency, self.state[lanes], goes_on = onwards
        back, on = lanes[~goes_on], lanes[goes_on]
        self.tracks.numbers[back] = self.tracks_before.numbers[back]
        self.tracks_before.numbers[on] = self.tracks.numbers[on]
        self.frequency[lanes] = np.where(active, frequency, self.frequency[lanes])
        first = np.where(self.track.known[lanes] >= 0, FOLLOW, MARCH)
        first = np.where(self._grows(lanes), MEASURE, first)
        self.stage[lanes] = np.where(active, first, IDLE)
        self.stride[lanes] = self.frequency[lanes] - self.track.frequency[lanes, 0]
        self.least_stride[lanes] = SHORTEST * np.abs(self.stride[lanes])
        self.search.steps[lanes], self.oriented[lanes] = 0, False
        self._refresh(lanes)
        self.limit[lanes] = NEAR

    def _refresh(self, lanes: np.ndarray) -> None:
        """Begin a search where lanes are."""
        steps = self.search.steps[lanes]
        self.searches.numbers[lanes] = self._fresh(self.state[lanes] * self.weight[lanes]).numbers
        self.search.steps[lanes] = steps

    def _grows(self, lanes: np.ndarray) -> np.ndarray:
        """Whether lanes would grow without bound: they are not marched."""
        return np.asarray(is_unbounded(self.resonances[:, lanes], self.frequency[lanes], np))

    def _own(self, lanes: np.ndarray) -> LaneTable:
        """March of some lanes, each with its rig."""
        return self.rigs.pick(self.rig[lanes])

    def _marched(self, own: np.ndarray, lanes: np.ndarray, state: np.ndarray, window: np.ndarray):
        """March lanes over windows; of their own the states, the steps, and what was measured."""
        marched = measure_some(self._own(lanes), state, self.frequency[lanes], window)
        return marched.pick(slice(len(own))).columns()

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
        marched = march_some(
            self._own(lanes),
            search,
            self.frequency[lanes],
            self.limit[lanes],
            self.max_periods,
            np.int32(still),
        )
        # The last column is the period found.
        numbers = np.asarray(marched.numbers)[:n]
        self.searches.numbers[own] = numbers[:, :-1]
        arrived = self.search.done[own] > 0
        own, period = own[arrived], numbers[arrived, -1].astype(np.int32)
        self.state[own] = self.search.history[own, 0] / self.weight[own]
        near, lost = self.limit[own] == NEAR, ~np.isfinite(self.state[own]).all(axis=1)
        # Period 1 first: a slowly turning period-1 motion returns best after several periods.
        self.wanted[own], self.period[own] = np.minimum(period, 1), period
        self.stage[own] = np.where(near & (period > 0), POLISH, MEASURE)
        self.stage[own[near & (period == 1) & self.follow[own]]] = ORIENT
        self._march_on(own[near & (period == 0) & ~lost])

    def _march_on(self, lanes: np.ndarray) -> None:
        """Let lanes go on to the full tolerance, unless they marched for too long already."""
        self.limit[lanes], self.period[lanes] = self.tolerance, 0
        self.search.streak[lanes], self.search.done[lanes] = 0, False
        over = self.search.marched[lanes] >= int(self.max_periods)
        self.stage[lanes] = np.where(over, MEASURE, MARCH)

    def _run_follow(self, own: np.ndarray, lanes: np.ndarray) -> None:
        """Follow lanes towards their frequencies; what arrives is to be read.

        Motions that are not known well yet are solved for where they are. Where a step fails it is
        halved, and at last the lane is marched from its last motion.
        """
        n, known, here = len(own), self.track.known[lanes] > 0, self.track.frequency[lanes, 0]
        left = self.frequency[lanes] - here
        whole = np.abs(left) <= np.abs(self.stride[lanes])
        to = np.where(whole, self.frequency[lanes], here + self.stride[lanes])
        at = np.where(known, to, here)
        advanced = advance(self._own(lanes), self.tracks.pick(lanes), at)
        _, found = advanced.columns()
        good, known, arrives = found.good[:n] > 0, known[:n], whole[:n] & known[:n]
        numbers = self.tracks.numbers
        numbers[own] = np.asarray(advanced.numbers)[:n, : numbers.shape[1]]
        self.search.steps[own] += found.rounds[:n]
        self.stride[own] = np.where(known, (at - here)[:n] * np.where(good, 2.0, 0.5), left[:n])
        self.arrived_at[own[good]] = found.state[:n][good]
        passed = own[good & ~arrives & ~self.oriented[own]]
        self.state[passed] = self.arrived_at[passed]
        arrives |= self.oriented[own] & (self.track.known[own] > 0)
        self.stage[own[good & arrives]] = READ
        self._give_up(own[~good & (~known | (np.abs(self.stride[own]) < self.least_stride[own]))])

    def _give_up(self, lanes: np.ndarray) -> None:
        """March lanes that cannot be followed, or go on with those that have marched."""
        self.track.known[lanes] = -1
        self.stage[lanes] = np.where(self.oriented[lanes], POLISH, MARCH)
        self._refresh(lanes[~self.oriented[lanes]])

    def _orient(self, own: np.ndarray, lanes: np.ndarray) -> None:
        """Note the contacts of lanes that have marched near to a motion, to solve for it."""
        one = np.ones(len(lanes), np.int32)
        _, steps, measures = self._marched(own, lanes, self.state[lanes], one)
        weighted = self.state[own] * self.weight[own]
        begin_track(self.track, own, weighted, self.frequency[own], measures.events)
        self.oriented[own], self.stage[own] = True, FOLLOW
        self.search.steps[own] += steps
        self._give_up(own[self.track.known[own] < 0])

    def _read(self, own: np.ndarray, lanes: np.ndarray) -> Settled:
        """Measure motions that have been followed; return those that keep to their contacts."""
        one = np.ones(len(lanes), np.int32)
        end, steps, measures = self._marched(own, lanes, self.arrived_at[lanes], one)
        arrived, weight = self.arrived_at[own], self.weight[own]
        track, gone = self.tracks.pick(own).columns(), (end - arrived) * weight
        keeps = keeps_to_contacts(track, measures.events, arrived * weight, gone)
        self.search.steps[own] += steps
        self._give_up(own[~keeps])
        own, measures = own[keeps], jax.tree.map(lambda a: a[keeps], measures)
        one = np.ones(len(own), np.int32)
        return Settled(
            lanes=own,
            state=self.arrived_at[own],
            period=one,
            status=one * Status.settled.value,
            periods_marched=self.search.marched[own].astype(np.int32),
            steps=self.search.steps[own].astype(np.int32),
            window=one,
            measures=measures._replace(events=None),
        )

    def _run_polish(self, own: np.ndarray, lanes: np.ndarray) -> None:
        state, good = polish_some(
            self._own(lanes), self.state[lanes], self.frequency[lanes], self.wanted[lanes]
        )
        good = np.asarray(good)[: len(own)]
        settled, left = own[good], own[~good]
        self.state[settled] = np.asarray(state)[: len(own)][good]
        self.period[settled], self.stage[settled] = self.wanted[settled], MEASURE
        self._reduce_periods(settled)
        over = self.wanted[left] >= self.period[left]
        self.wanted[left] = self.period[left]
        self._march_on(left[over])

    def _reduce_periods(self, settled: np.ndarray) -> None:
        """Set the least period of orbits found with a multiple of it.

        A motion that alternates about its orbit while it settles returns best after twice the
        period. Period 1 has been tried before any other.
        """
        for part in range(2, self.max_period // 2 + 1):
            own = settled[(self.period[settled] % part == 0) & (self.period[settled] > part)]
            if not len(own):
                continue
            lanes = filled(own, self.widths)
            window = np.full(len(lanes), part, np.int32)
            end, _, _ = self._marched(own, lanes, self.state[lanes], window)
            gone = (end - self.state[own]) * self.weight[own]
            size = np.linalg.norm(self.state[own] * self.weight[own], axis=1)
            self.period[own[np.linalg.norm(gone, axis=1) <= CLOSED * size]] = part

    def _measured(self, own: np.ndarray, lanes: np.ndarray, window: np.ndarray) -> Settled:
        state, grows, n = self.state[lanes], self._grows(lanes), len(own)
        gave_up = np.any(np.isinf(state), axis=1)
        lost = grows | ~np.all(np.isfinite(state), axis=1)
        # A lane that is lost starts again from rest at the next frequency.
        state = np.where(lost[:, None], 0.0, state)
        window = np.where(lost, 0, window).astype(np.int32)
        end, steps, measures = self._marched(own, lanes, state, window)
        lost, self.track.known[own] = lost[:n], -1
        one = ~lost & (self.period[own] == 1) & self.follow[own]
        if one.any():
            log, at = jax.tree.map(lambda a: a[one], measures.events), own[one]
            weighted = self.state[at] * self.weight[at]
            begin_track(self.track, at, weighted, self.frequency[at], log)
        period = np.where(lost, 0, self.period[own])
        # Periodic lanes go on from the orbit itself, the others from where the measuring ended.
        goes_on = (period == 0) & np.isfinite(end).all(axis=1)
        kind = np.where(period > 0, Status.settled.value, Status.aperiodic.value)
        words = Status.unbounded, Status.gave_up, Status.diverged
        status = np.select([grows[:n], gave_up[:n], lost], [w.value for w in words], kind)
        return Settled(
            lanes=own,
            state=np.where(goes_on[:, None], end, state[:n]),
            period=period,
            status=status.astype(np.int32),
            periods_marched=self.search.marched[own].astype(np.int32),
            steps=(self.search.steps[own] + steps).astype(np.int32),
            window=np.maximum(window[:n], 1),
            measures=measures._replace(events=None),
        )


def settle(
    march: AbstractMarch,
    state: Float[np.ndarray, "lanes states"],
    angular_frequency: Float[np.ndarray, " lanes"],
    *,
    tolerance: float,
    max_period: int,
    max_periods: int,
) -> Settled:
    """Bring lanes, each with a rig of its own, to their steady states at one frequency (rad/s).

    `tolerance` is relative to the size of the state in the norm of energy. Whether a lane would
    grow without bound is not looked at.
    """
    parts: list[Settled] = []

    def last(settled: Settled) -> Onwards:
        parts.append(settled)
        nowhere = np.zeros(len(settled.lanes), bool)
        return Onwards(nowhere, np.ones(nowhere.shape), settled.state, ~nowhere)

    rig, none = np.arange(len(state)), np.zeros((0, len(state)))
    LanePool(march, rig, none, tolerance, max_period, max_periods).run(
        state, angular_frequency, last
    )
    whole: Settled = jax.tree.map(lambda *a: np.concatenate(a), *parts)
    order = np.argsort(whole.lanes)
    return jax.tree.map(lambda a: a[order], whole)
