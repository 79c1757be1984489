"""Which attractors many starts lead to: march, recognise, match, and drop what has arrived.

All starts are marched window by window. A start whose motion returns is parked; of every cluster of
parked ones a candidate marches on until it is closer to its limit, whose states then are an
attractor, and the parked starts near any of these states are its. So only few starts are followed
to their limit, and near misses (a start that lingers at a saddle) are found out, as their candidate
leaves it again. Pilots go first: the others arrive, in shorter windows, where they run along an
attractor that is known.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from vibrojax.regime.observing import sample_motions
from vibrojax.regime.poincare_map import PoincareMap, Report, width_for
from vibrojax.regime.settings import BasinSettings

MARCHING, CANDIDATE, PARKED, ARRIVED, APERIODIC, LOST, WAITING = range(7)
PILOTS = 16
"""Starts of a place that go first, at least, to find its main attractors."""
SHORT = 6
"""Drive periods of the windows in which the other starts are followed onto known attractors."""
FOLLOWED = 8
"""Such windows, after which a start may be on an attractor that is not known yet."""
CANDIDATES = 8
"""Candidates of a place that march at the same time."""
CLOSER = 5.0
"""How many times smaller than the tolerance the return of a candidate has to be ..."""
WINDOWS = 8
"""... unless it has marched so many windows on."""
FAR = 10.0
"""Tolerances up to which a start that returns, but is out of time, is given to an attractor."""
MOST = 64
"""Most periodic attractors of one place."""
WATCHED = (24, 60)
"""Drive periods over which means and powers are taken: the first that all periods divide."""
NARROW, MANY = 16, 8
"""Lanes of a narrow loop, and full loops of starts from which on there is one."""
TINY = 1e-300
ONWARDS = 200
"""Drive periods by which the states of attractors are marched on before they are kept."""
SAMPLES = 32
"""Samples per drive period of what is watched."""


DESCRIBED = {
    "cross_well": "cross_well",
    "mean_displacement": "displacement_mean",
    "strain_power_rms": "strain_power_rms",
    "amplitude_ratio": "amplitude_ratio",
    "contact_force": "contact_force",
}
"""What is known of an attractor, and the number of its motion that says it."""


class Attractors(NamedTuple):
    """What the starts of one rig at one frequency lead to; attractors by share, largest first."""

    number: Int[np.ndarray, " starts"]
    """Attractor of every start, from 1; 0 for a start that was lost."""
    periods_marched: Int[np.ndarray, " starts"]
    described: dict[str, np.ndarray]
    """Over the attractors: `period` in drive periods (0 for motions without one), what DESCRIBED
    names, and the `initial_state` at drive phase 0, of a motion without a period that of one."""


class _Orbit(NamedTuple):
    """A periodic attractor."""

    section: Float[np.ndarray, "period states"]
    """Weighted states, that of the lowest first coordinate first."""
    state: Float[np.ndarray, " states"]

    @property
    def period(self) -> int:
        return len(self.section)

    @property
    def size(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self.section**2, axis=1))))


class _Search:
    """Starts on their ways; lane k is start k % starts of place k // starts."""

    def __init__(self, poincare, rig, frequency, starts, settings: BasinSettings, report):
        places, count, _ = starts.shape
        self.poincare, self.settings, self.report = poincare, settings, report
        self.place = np.repeat(np.arange(places), count)
        self.rig, self.frequency = rig[self.place], frequency[self.place]
        self.state = starts.reshape(places * count, -1).copy()
        self.weight = poincare.weight[rig]
        self.stage = np.full(len(self.place), MARCHING)
        self.marched = np.zeros(len(self.place), int)
        self.windows = np.zeros(len(self.place), int)
        """Windows that a candidate has marched on."""
        self.orbits: list[list[_Orbit]] = [[] for _ in range(places)]
        self.orbit = np.full(len(self.place), -1)
        self.shift = np.zeros(len(self.place), int)
        """By how many drive periods a start is ahead on its orbit."""
        self.width = width_for(len(self.place))
        # Stragglers of a long run are worth a loop of their own width, which has to be compiled.
        self.narrow = width_for(NARROW) if len(self.place) > MANY * self.width else self.width

    def run(self) -> None:
        """Bring every start to an end."""
        count = len(self.place) // len(self.orbits)
        first = max(PILOTS, self.width // len(self.orbits))
        pilots = np.random.default_rng(0).permutation(count)[:first]
        self.stage[:] = WAITING
        self.stage.reshape(-1, count)[:, pilots] = MARCHING
        self._settle()
        self._follow()
        self.stage[self.stage == WAITING] = MARCHING
        self._settle()

    def _follow(self) -> None:
        """March what waits until it runs along one of the attractors that are known."""
        known = np.array([bool(orbits) for orbits in self.orbits])
        for _ in range(FOLLOWED):
            lanes = np.flatnonzero((self.stage == WAITING) & known[self.place])
            if not lanes.size:
                return
            record = self._record(lanes)
            self.state[lanes] = record[:, -1]
            self.marched[lanes] += SHORT
            alive = np.isfinite(record[:, -1]).all(axis=1)
            self._end(lanes[~alive], LOST)
            for place in np.unique(self.place[lanes[alive]]):
                own = alive & (self.place[lanes] == place)
                self._join(place, lanes[own], record[own] * self.weight[place])

    def _record(self, lanes):
        """Return the states of some lanes after each period of a short window."""
        every = self._filled(lanes)
        rig, frequency, state = self.rig[every], self.frequency[every], self.state[every]
        return self.poincare.section(rig, frequency, state, SHORT)[: len(lanes)]

    def _join(self, place, lanes, record):
        """Let lanes arrive that run along an orbit of their place all through a short window."""
        rows, best = np.arange(len(lanes)), np.full(len(lanes), np.inf)
        orbit, shift = np.zeros(len(lanes), int), np.zeros(len(lanes), int)
        back = np.arange(SHORT)[::-1]
        for k, known in enumerate(self.orbits[place]):
            n = known.period
            away = scipy.spatial.distance.cdist(record.reshape(-1, record.shape[2]), known.section)
            away = away.reshape(len(lanes), SHORT, n) / max(known.size, TINY)
            # By the state at which the window would end.
            path = [away[:, np.arange(SHORT), (end - back) % n].max(axis=1) for end in range(n)]
            end = np.argmin(path, axis=0)
            farthest = np.array(path)[end, rows]
            nearer = farthest < best
            best, orbit = np.where(nearer, farthest, best), np.where(nearer, k, orbit)
            shift = np.where(nearer, (end - self.marched[lanes]) % n, shift)
        near = best <= self.settings.period_tolerance
        self.orbit[lanes[near]], self.shift[lanes[near]] = orbit[near], shift[near]
        self._end(lanes[near], ARRIVED)

    def _settle(self) -> None:
        """March what marches, window by window, and find the attractors."""
        budget = self.settings.transient + self.settings.periods
        while True:
            lanes = np.flatnonzero(self.stage <= CANDIDATE)
            if not lanes.size:
                break
            period, error = self._march(lanes)
            self._resolve(lanes, period, error)
            parked = lanes[(self.stage[lanes] == MARCHING) & (period > 0)]
            self.stage[parked] = PARKED
            for place in np.unique(self.place[self.stage == PARKED]):
                self._match(place)
            out = (self.stage == MARCHING) & (self.marched >= budget)
            self._end(np.flatnonzero(out), APERIODIC)
            for place in np.unique(self.place[self.stage == PARKED]):
                self._choose(place, budget)

    def _filled(self, lanes):
        """Fill some lanes up to one of the widths that are compiled."""
        width = self.narrow if len(lanes) <= self.narrow else self.width
        return lanes[np.minimum(np.arange(max(len(lanes), width)), len(lanes) - 1)]

    def _march(self, lanes):
        """March a window; returns period and error of the return."""
        settings = self.settings
        every = self._filled(lanes)
        found = self.poincare.observe(
            self.rig[every],
            self.frequency[every],
            self.state[every],
            periods=settings.periods,
            max_period=settings.max_period,
            tolerance=settings.period_tolerance,
        )
        found = {name: values[: len(lanes)] for name, values in found.items()}
        self.state[lanes] = found["end"]
        self.marched[lanes] += settings.periods
        period, error, alive = found["period"], found["return_error"], found["alive"]
        self._end(lanes[~alive], LOST)
        return np.where(alive, period, 0), error

    def _end(self, lanes, stage):
        self.stage[lanes] = stage
        if self.report is not None:
            self.report(len(lanes))

    def _weighted(self, lanes):
        return self.state[lanes] * self.weight[self.place[lanes]]

    def _resolve(self, lanes, period, error):
        """Make attractors of candidates that are near their limit."""
        own = np.flatnonzero(self.stage[lanes] == CANDIDATE)
        self.windows[lanes[own]] += 1
        gone = own[period[own] == 0]
        self.stage[lanes[gone]] = MARCHING
        near = error <= self.settings.period_tolerance / CLOSER
        near |= self.windows[lanes] >= WINDOWS
        ready = own[(period[own] > 0) & near[own]]
        if not ready.size:
            return
        chosen = lanes[ready]
        parts, begin = [self.state[chosen][:, None]], self.state[chosen].copy()
        for _ in range(-(-self.settings.max_period // SHORT)):
            parts.append(self._record(chosen))
            self.state[chosen] = parts[-1][:, -1]
        self.state[chosen] = begin
        record = np.concatenate(parts, axis=1)
        for k, lane in enumerate(chosen):
            self.stage[lane] = PARKED
            place, n = self.place[lane], int(period[ready[k]])
            self._match(place)
            if self.stage[lane] == ARRIVED:
                continue
            section = record[k, :n]
            # From the same phase whichever start was the candidate.
            section = np.roll(section, -int(np.argmin(section[:, 0])), axis=0)
            self.orbits[place].append(_Orbit(section * self.weight[place], section[0]))
            self._match(place)

    def _match(self, place, within=1.0):
        """Give parked starts of a place to the orbits that they are near."""
        lanes = np.flatnonzero((self.stage == PARKED) & (self.place == place))
        if not self.orbits[place] or not lanes.size:
            return
        states = self._weighted(lanes)
        away = [
            scipy.spatial.distance.cdist(states, o.section) / max(o.size, TINY)
            for o in self.orbits[place]
        ]
        distance = np.stack([a.min(axis=1) for a in away])
        best = distance.argmin(axis=0)
        near = distance.min(axis=0) <= within * self.settings.period_tolerance
        for row in np.flatnonzero(near):
            lane, k = lanes[row], best[row]
            period = self.orbits[place][k].period
            self.orbit[lane] = k
            self.shift[lane] = (away[k][row].argmin() - self.marched[lane]) % period
        self._end(lanes[near], ARRIVED)

    def _choose(self, place, budget):
        """Choose candidates among the parked starts of a place; the others wait or march on."""
        mine = self.place == place
        pending = np.flatnonzero(mine & (self.stage == CANDIDATE))
        if pending.size:
            return
        late = mine & (self.stage == PARKED) & (self.marched >= budget)
        if self.orbits[place] and late.any():
            waiting = np.flatnonzero(mine & (self.stage == PARKED) & ~late)
            self.stage[waiting] = MARCHING
            self._match(place, FAR)
            self.stage[waiting] = PARKED
        parked = np.flatnonzero(mine & (self.stage == PARKED))
        if len(self.orbits[place]) >= MOST:
            self._end(parked, APERIODIC)
            return
        states = self._weighted(parked)
        left = np.ones(len(parked), bool)
        for _ in range(CANDIDATES):
            if not left.any():
                break
            first = int(np.argmax(left))
            self.stage[parked[first]] = CANDIDATE
            self.windows[parked[first]] = 0
            away = np.sqrt(np.sum((states - states[first]) ** 2, axis=1))
            left &= away > self.settings.period_tolerance * np.sqrt(np.sum(states[first] ** 2))
            left[first] = False
        if self.orbits[place]:  # what is near none of them yet comes nearer
            self.stage[mine & (self.stage == PARKED) & ~late] = MARCHING


def find_attractors(
    poincare: PoincareMap,
    rig: Int[np.ndarray, " places"],
    angular_frequency: Float[np.ndarray, " places"],
    starts: Float[np.ndarray, "places starts states"],
    settings: BasinSettings,
    report: Report | None = None,
) -> list[Attractors]:
    """Follow the starts of every place, a rig at a frequency (rad/s), to their attractors."""
    search = _Search(poincare, rig, angular_frequency, starts, settings, report)
    search.run()
    return _watched(search)


def _watched(search: _Search) -> list[Attractors]:
    """Watch every attractor, and every start that reached none, and number them by share."""
    orbits = [(p, o) for p, own in enumerate(search.orbits) for o in own]
    wild = np.flatnonzero(search.stage == APERIODIC)
    place = np.concatenate([np.array([p for p, _ in orbits], int), search.place[wild]])
    numbers: dict[str, np.ndarray] = {}
    if len(place):
        known = np.reshape([o.state for _, o in orbits], (-1, search.state.shape[1]))
        states = np.concatenate([known, search.state[wild]])
        fits = (n for n in WATCHED if all(n % o.period == 0 for _, o in orbits))
        any_lane = place * (len(search.place) // len(search.orbits))
        lanes = search.rig[any_lane], search.frequency[any_lane]
        period = np.array([o.period for _, o in orbits] + [0] * len(wild), int)
        # Periodic motions on to their limits, by whole periods: they were found near them.
        at = np.flatnonzero(period)
        if at.size:
            on = period[at] * -(-ONWARDS // period[at])
            later = search.poincare.march(*(a[at] for a in lanes), states[at], on)
            states[at] = np.where(np.isfinite(later).all(axis=1, keepdims=True), later, states[at])
        numbers = sample_motions(
            search.poincare,
            *lanes,
            states,
            periods=next(fits, WATCHED[0]),
            samples_per_period=SAMPLES,
            barrier=search.settings.barrier,
        )
        numbers |= search.poincare.measure(*lanes, states, period)
        numbers["state"] = states
    places = range(len(search.orbits))
    return [_of_place(search, p, place, len(orbits), wild, numbers) for p in places]


def _of_place(search, place, places, count, wild, numbers) -> Attractors:
    """Number the attractors of one place."""
    lanes = np.flatnonzero(search.place == place)
    kinds: list[tuple[int, np.ndarray, np.ndarray]] = []
    """Period, lanes, and where in the numbers the kind is described."""
    first = int(np.sum(places[:count] < place))
    for k, orbit in enumerate(search.orbits[place]):
        own = lanes[(search.stage[lanes] == ARRIVED) & (search.orbit[lanes] == k)]
        shifts = search.shift[own] if search.settings.distinguish_phases else 0 * own
        for shift in np.unique(shifts):
            kinds.append((orbit.period, own[shifts == shift], np.array([first + k])))
    mine = np.flatnonzero(search.place[wild] == place)
    for side in (False, True) if mine.size else ():
        own = mine[(numbers["cross_well"][count + mine] > 0.5) == side]
        if own.size:
            kinds.append((0, wild[own], count + own))

    def mean(name, rows):
        return float(np.mean(numbers[name][rows]))

    kinds.sort(key=lambda k: (-len(k[1]), k[0], round(mean("displacement_mean", k[2]), 12)))
    number = np.zeros(len(lanes), int)
    for i, (_, own, _) in enumerate(kinds, start=1):
        number[own - lanes[0]] = i
    described = {
        name: np.array([mean(source, rows) for _, _, rows in kinds], float)
        for name, source in DESCRIBED.items()
    }
    described["cross_well"] = described["cross_well"] > 0.5
    described["period"] = np.array([period for period, _, _ in kinds], int)
    states = [numbers["state"][rows[0]] for _, _, rows in kinds]
    described["initial_state"] = np.reshape(states, (-1, search.state.shape[1]))
    return Attractors(number, search.marched[lanes], described)
