"""Many lanes to their steady states, each at its own pace.

One loop over all lanes would run as long as its slowest lane. Here every lane goes through its own
stages (march, Newton's method, measuring, the next frequency), and what is run is always the
fullest stage, on as many lanes as one loop takes. The stages are those of `steady.settling`, so
a lane ends as it would alone.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax.results.status import Status
from vibrojax.steady.settling import (
    APERIODIC_PERIODS,
    CLOSED,
    NEAR,
    Search,
    begin_search,
    found_period,
    march_until,
    polish,
)
from vibrojax.stepping.measures import Measures
from vibrojax.stepping.method import AbstractMarch
from vibrojax.stepping.resonance import is_unbounded

WIDTHS = {"cpu": (2, 16, 128), "gpu": (64, 1024, 8192)}
"""How many lanes run side by side in one loop: on a CPU their tables have to stay in the cache."""

MARCH, POLISH, MEASURE, IDLE = range(4)


class Arrived(NamedTuple):
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
    """Where the lanes that arrived go next."""

    active: Bool[np.ndarray, " lanes"]
    angular_frequency: Float[np.ndarray, " lanes"]
    """rad/s; of no meaning where a lane is not active any more."""
    state: Float[np.ndarray, "lanes states"]


@runtime_checkable
class LaneFeed(Protocol):
    """Decides the frequencies that each lane goes through."""

    def onwards(self, arrived: Arrived) -> Onwards:
        """Take note of the steady states of some lanes and say where they go next."""
        ...


def take_rigs(tree: Any, rigs: Array) -> Any:
    """Pick rigs of a tree in which they are the trailing axis."""
    return jax.tree.map(lambda a: jnp.take(a, rigs, axis=-1) if eqx.is_array(a) else a, tree)


@eqx.filter_jit
def _march(march, rigs, search, frequency, limit, max_periods, still):
    own = take_rigs(march, rigs)
    search = march_until(own, own.energy_weight(), search, frequency, limit, max_periods, still)
    return search, found_period(search, limit)


@eqx.filter_jit
def _polish(march, rigs, state, frequency, period):
    own = take_rigs(march, rigs)
    return polish(own, own.energy_weight(), state, frequency, period)


@eqx.filter_jit
def _measure(march, rigs, state, frequency, window):
    return take_rigs(march, rigs)(state, frequency, window, True)


class LanePool:
    """Lanes on their ways through frequencies; `rig[k]` is the rig of lane k among those prepared.

    Arrays here have the lanes leading; `resonances` are those of `Prepared`, which are not marched.
    """

    def __init__(
        self,
        march: AbstractMarch,
        rig: Int[np.ndarray, " lanes"],
        resonances: Float[np.ndarray, "modes lanes"],
        tolerance: float,
        max_period: int,
        max_periods: int,
    ):
        self.march, self.rig, self.resonances = march, rig, resonances
        self.weight = np.asarray(march.energy_weight()).T[rig]
        self.tolerance, self.max_period = tolerance, max_period
        self.max_periods = jnp.asarray(max_periods)
        widths = WIDTHS.get(jax.default_backend(), WIDTHS["gpu"])
        enough = next((i for i, w in enumerate(widths) if w >= len(rig)), len(widths) - 1)
        # Few lanes have one width, many a narrow one for the stragglers too: each compiles.
        self.widths = widths[max(1, enough - 1) : enough + 1] if enough else widths[:1]

    def run(
        self,
        state: Float[np.ndarray, "lanes states"],
        angular_frequency: Float[np.ndarray, " lanes"],
        feed: LaneFeed,
        report: Callable[[int], object] = lambda count: None,
    ) -> None:
        """Bring all lanes to the end of their feed; `report` takes numbers of points reached."""
        lanes = len(self.rig)
        self.frequency = np.array(angular_frequency, float)
        self.march.check_steps(np.asarray(self.rig), self.frequency)
        self.state = np.array(state, float)
        fresh = begin_search((self.state * self.weight).T, self.max_period, np)
        self.search: Any = jax.tree.map(np.array, self._lanes_first(fresh))
        """A `Search` in arrays of numpy, lanes leading."""
        self.limit = np.full(lanes, NEAR)
        self.stage = self._first_stage(np.arange(lanes))
        self.period = np.zeros(lanes, np.int32)
        self.wanted = np.zeros(lanes, np.int32)
        """Period that Newton's method is to try."""
        while True:
            counts = np.bincount(self.stage, minlength=IDLE + 1)[:IDLE]
            if not counts.any():
                return
            stage = int(np.argmax(np.minimum(counts, self.widths[-1])))
            chosen = np.flatnonzero(self.stage == stage)
            if stage == MARCH:
                self._run_march(chosen)
            elif stage == POLISH:
                self._run_polish(chosen)
            else:
                report(self._run_measure(chosen, feed))

    def _first_stage(self, lanes: np.ndarray) -> np.ndarray:
        """Return MARCH; MEASURE for lanes that would grow without bound."""
        return np.where(self._grows(lanes), MEASURE, MARCH)

    def _grows(self, lanes: np.ndarray) -> np.ndarray:
        return np.asarray(is_unbounded(self.resonances[:, lanes], self.frequency[lanes], np))

    def _batch(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the lanes of one loop and the same filled up to its width."""
        # Lanes of like pace: one loop takes as long as its slowest lane.
        pace = self.search.steps[chosen] / np.maximum(self.search.marched[chosen], 1)
        own = chosen[np.argsort(pace, kind="stable")][: self.widths[-1]]
        width = next(w for w in self.widths if w >= len(own))
        return own, own[np.minimum(np.arange(width), len(own) - 1)]

    @staticmethod
    def _lanes_first(search: Search) -> Any:
        return jax.tree.map(lambda a: np.moveaxis(np.asarray(a), -1, 0), search)

    def _run_march(self, chosen: np.ndarray) -> None:
        own, lanes = self._batch(chosen)
        # Lanes that wait for their turn, or come back soon, take the places of those that are done.
        waits = len(chosen) > len(own)
        still = 3 * len(own) // 4 if waits else len(own) // 2
        done = self.search.done[lanes]
        done[len(own) :] = True
        search = jax.tree.map(lambda a: np.moveaxis(a[lanes], 0, -1), self.search)
        search, period = _march(
            self.march,
            self.rig[lanes],
            jax.tree.map(jnp.asarray, search._replace(done=done)),
            self.frequency[lanes],
            self.limit[lanes],
            self.max_periods,
            np.int32(still),
        )
        for kept, new in zip(self.search, self._lanes_first(search), strict=True):
            kept[own] = new[: len(own)]
        period = np.asarray(period)[: len(own)]
        arrived = self.search.done[own]
        own, period = own[arrived], period[arrived]
        self.state[own] = self.search.history[own, 0] / self.weight[own]
        near = self.limit[own] == NEAR
        found = period > 0
        lost = ~np.isfinite(self.state[own]).all(axis=1)
        over = self.search.marched[own] >= int(self.max_periods)
        # Period 1 first: a slowly turning period-1 motion returns best after several periods.
        self.wanted[own] = np.minimum(period, 1)
        self.period[own] = period
        self.stage[own] = np.where(near & found, POLISH, np.where(near, MARCH, MEASURE))
        self._march_on(own[near & ~found])
        self.stage[own[lost | (over & ~(near & found))]] = MEASURE

    def _march_on(self, lanes: np.ndarray) -> None:
        """What Newton's method did not settle goes on to the full tolerance."""
        self.limit[lanes] = self.tolerance
        self.period[lanes] = 0
        self.search.streak[lanes] = 0
        self.search.done[lanes] = False
        over = self.search.marched[lanes] >= int(self.max_periods)
        self.stage[lanes] = np.where(over, MEASURE, MARCH)

    def _run_polish(self, chosen: np.ndarray) -> None:
        # Together what takes the same number of periods.
        own, lanes = self._batch(chosen[self.wanted[chosen] == self.wanted[chosen].min()])
        state, good = _polish(
            self.march,
            self.rig[lanes],
            self.state[lanes].T,
            self.frequency[lanes],
            self.wanted[lanes],
        )
        good = np.asarray(good)[: len(own)]
        settled = own[good]
        self.state[settled] = np.asarray(state).T[: len(own)][good]
        self.period[settled] = self.wanted[settled]
        self._reduce_periods(settled)
        self.stage[settled] = MEASURE
        left = own[~good]
        again = self.wanted[left] < self.period[left]
        self.wanted[left[again]] = self.period[left[again]]
        self._march_on(left[~again])

    def _reduce_periods(self, settled: np.ndarray) -> None:
        """Set the least period of orbits found with a multiple of it.

        A motion that alternates about its orbit while it settles returns best after twice the
        period. Period 1 has been tried before any other.
        """
        for part in range(2, self.max_period // 2 + 1):
            lanes = settled[(self.period[settled] % part == 0) & (self.period[settled] > part)]
            while len(lanes):
                own, left = lanes[: self.widths[-1]], lanes[self.widths[-1] :]
                width = next(w for w in self.widths if w >= len(own))
                batch = own[np.minimum(np.arange(width), len(own) - 1)]
                window = np.full(width, part, np.int32)
                state = self.state[batch].T
                end, _, _ = _measure(
                    self.march, self.rig[batch], state, self.frequency[batch], window
                )
                gone = (np.asarray(end).T - self.state[batch])[: len(own)] * self.weight[own]
                size = np.linalg.norm(self.state[own] * self.weight[own], axis=1)
                self.period[own[np.linalg.norm(gone, axis=1) <= CLOSED * size]] = part
                lanes = left

    def _run_measure(self, chosen: np.ndarray, feed: LaneFeed) -> int:
        window = np.where(self.period > 0, self.period, APERIODIC_PERIODS)
        own, lanes = self._batch(chosen[window[chosen] == window[chosen].min()])
        state = self.state[lanes]
        grows = self._grows(lanes)
        lost = grows | ~np.all(np.isfinite(state), axis=1)
        # A lane that is lost starts again from rest at the next frequency.
        state = np.where(lost[:, None], 0.0, state)
        window = np.where(lost, 0, window[lanes]).astype(np.int32)
        end, steps, measures = _measure(
            self.march, self.rig[lanes], state.T, self.frequency[lanes], window
        )
        n = len(own)
        end, lost = np.asarray(end).T[:n], lost[:n]
        period = np.where(lost, 0, self.period[own])
        goes_on = (period == 0) & np.isfinite(end).all(axis=1)
        # Periodic lanes go on from the orbit itself, the others from where the measuring ended.
        state = np.where(goes_on[:, None], end, state[:n])
        kind = np.where(period > 0, Status.settled.value, Status.aperiodic.value)
        arrived = Arrived(
            lanes=own,
            state=state,
            period=period,
            status=np.select(
                [grows[:n], lost], [Status.unbounded.value, Status.diverged.value], kind
            ).astype(np.int32),
            periods_marched=self.search.marched[own].copy(),
            steps=self.search.steps[own] + np.asarray(steps)[:n],
            window=np.maximum(window[:n], 1),
            measures=jax.tree.map(lambda a: np.asarray(a)[:n], measures),
        )
        self._send(own, feed.onwards(arrived))
        return n

    def _send(self, lanes: np.ndarray, onwards: Onwards) -> None:
        self.frequency[lanes] = np.where(
            onwards.active, onwards.angular_frequency, self.frequency[lanes]
        )
        self.stage[lanes] = np.where(onwards.active, self._first_stage(lanes), IDLE)
        self.state[lanes] = onwards.state
        weighted = (onwards.state * self.weight[lanes]).T
        fresh = self._lanes_first(begin_search(weighted, self.max_period, np))
        for kept, new in zip(self.search, fresh, strict=True):
            kept[lanes] = new
        self.limit[lanes] = NEAR
