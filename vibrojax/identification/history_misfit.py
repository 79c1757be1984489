"""Distance of a measured time history from the motions of many trial rigs at once.

A steady motion is marched until it returns, as a sweep upwards and one downwards arrive at it,
because two motions may coexist; then Newton's method closes it, so that derivatives are those of
the steady state and not of a transient.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.identification.history_motions import (
    Passed,
    Plan,
    Rig,
    pass_through,
    rig_of,
    sampled_signals,
    settle,
)
from vibrojax.identification.record_numbers import (
    BEGINNING,
    numbers_of,
    places_of,
    record_numbers_in,
)
from vibrojax.identification.recorded_data import Data, data_of, on_samples, records_of
from vibrojax.identification.trial_rigs import Maker
from vibrojax.measured.history import MeasuredHistory
from vibrojax.model.drives import BaseMotion, NoDrive
from vibrojax.model.laws import linear_coefficients
from vibrojax.model.stops import Stop
from vibrojax.model.systems import AbstractSystem, equation_kinds
from vibrojax.steady.batches import filled_up
from vibrojax.stepping.choice import is_exact
from vibrojax.stepping.contact_phases import MAX_STOPS

WIDTH = 4
"""Lanes that are computed together, filled up where there are fewer: one kernel for all numbers."""
LOST = 1e3
"""Residual of every sample of a rig without a motion, in standard deviations."""
CLOSED = 1e-7
"""Relative return of a steady motion."""
GRID = 512
"""Places of a motion among which its shift is sought first."""
REACH = 0.1
"""Largest shift of a free release, in lengths of the window."""
MOST_ROUNDS = 12
"""Corrections of the shift and of the state at the start."""


class Trial(NamedTuple):
    """Motions as they are, lane by lane, and where they should go."""

    residual: np.ndarray
    derivative: np.ndarray
    """With the shift as it is."""
    followed: np.ndarray
    """What of it a shift that follows the numbers makes up for."""
    cost: np.ndarray
    closed: np.ndarray
    stable: np.ndarray
    shift: np.ndarray
    """s."""
    step: np.ndarray
    """Change of the shift that lowers the cost most, s."""
    change: np.ndarray
    """What that does to the residuals, root mean square."""
    following: np.ndarray
    """Corrected state at the start."""


def _tried(data: Data, passed: Passed, rigs: Rig, state, shift, names: int, plan: Plan) -> Trial:
    lanes, n = state.shape
    shown, end, slope, end_slope = (np.asarray(part) for part in passed)
    numbers, along = slope[:, :, :names], slope[:, :, names]
    residual = data.standardised(data.values - shown)
    expected, following = residual, state
    closed, stable = np.ones(lanes, bool), np.ones(lanes, bool)
    if plan.begins == "settled":
        by_state, monodromy = slope[:, :, names + 1 :], end_slope[:, :, names + 1 :]
        finite = np.all(np.isfinite(monodromy), axis=(1, 2))
        monodromy = np.where(finite.reshape(-1, 1, 1), monodromy, 0.0)
        off = end - state
        known = np.concatenate([end_slope[:, :, :names], off[:, :, None]], axis=2)
        solved = np.linalg.solve(np.eye(n) - monodromy, known)
        # The state moves with the numbers so that the motion stays closed.
        numbers = numbers + by_state @ solved[:, :, :names]
        following = state + solved[:, :, names]
        expected = residual - data.standardised((by_state @ solved[:, :, names:])[:, :, 0])
        weight = np.asarray(rigs.weight)
        size = np.linalg.norm(weight * state, axis=1)
        gone = np.linalg.norm(weight * off, axis=1)
        closed = finite & np.asarray(gone <= CLOSED * size)
        stable = np.max(np.abs(np.linalg.eigvals(monodromy)), axis=1) < 1 + 1e-6
    derivative = -data.standardised(numbers)
    step = change = np.zeros(lanes)
    followed = np.zeros_like(derivative)
    if plan.aligned:
        along = -data.standardised(along)
        square = np.sum(along**2, axis=1)
        square = np.where(square > 0, square, 1.0)
        step = -np.sum(along * expected, axis=1) / square
        count = np.sum(np.isfinite(data.deviation), axis=1)
        change = np.abs(step) * np.sqrt(square / count)
        # The shift follows the numbers: what it can make up for is no misfit.
        share = np.einsum("ls,lsn->ln", along, derivative) / square[:, None]
        followed = along[:, :, None] * share[:, None, :]
    cost = np.sum(residual**2, axis=1)
    return Trial(
        residual, derivative, followed, cost, closed, stable, shift, step, change, following
    )


class HistoryMisfit:
    """Misfit of a measured time history, as a function of the numbers of the user's function.

    Residuals are (measured - model)/deviation of all that was sampled in the window, one channel
    after another. A motion that is not `settled` starts at time 0, from what the history or the
    numbers sought say, else from rest; before that it moves as it does then. A settled motion is
    the steady state itself, of up to `LONGEST` drive periods; where sweeps upwards and downwards
    arrive at two different ones, the one nearer to the data counts. With `align_phase` every lane
    has its own shift of the time axis, the best one for its numbers.

    Raises `ValueError` for a history the system cannot have.
    """

    def __init__(self, maker: Maker, repetitions: Sequence[MeasuredHistory]):
        self.maker = maker
        first = repetitions[0]
        found = [history.observations() for history in repetitions]
        counts = [len(one.value) for one in found]
        if len({(*h.channels, n) for h, n in zip(repetitions, counts, strict=True)}) > 1:
            raise ValueError(
                "Repetitions of a history must have the same channels and as many samples in "
                "their windows."
            )
        self.size = counts[0]
        """How many residuals there are."""
        channels = tuple(first.channels)
        own = record_numbers_in(maker.make, maker.names)
        delayed = any(h.delay for h in repetitions) or any(n.endswith("_delay") for n in own)
        self.data = data_of(repetitions, found, delayed)
        # By the kind of system alone, which needs no numbers.
        self.plan = eqx.filter_eval_shape(
            lambda values: _plan(first, channels, maker.system(values)), jnp.ones(len(maker.names))
        )
        given = [h.frequency_ratio if self.plan.is_ratio else h.frequency for h in repetitions]
        self.frequency = np.array([1.0 if f is None else f for f in given])
        self.numbers = np.stack([numbers_of(history) for history in repetitions])
        self.record = records_of(repetitions)
        together = not delayed and all(on_samples(history) for history in repetitions)
        # Records that were filled up are not equally spaced.
        together = together and bool((np.diff(self.record[:, 0]) > 0).all())
        self.plan = self.plan._replace(
            delayed=delayed, fitted=places_of(own, channels), together=together
        )
        self.anywhere = bool(set(own) & set(BEGINNING)) or first.release is None
        """Whether a motion without a drive may begin anywhere in the record."""
        self.sharp = [k for k, c in enumerate(channels) if c in ("contact_force", "acceleration")]
        self.shifts = np.zeros(0)
        """Shifts of the lanes last computed (model time less measured time), s."""

    def residuals(
        self,
        values: np.ndarray,
        which: np.ndarray,
        frequency_scale: float,
        *,
        precisely: bool = False,
        shifts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of all rigs (lanes by `size`) and their derivatives in the numbers.

        `values` has lanes by numbers, `which` the repetition that every lane is compared with;
        `frequency_scale` is not used. `precisely` goes on with shifts that would move only a
        little more; `shifts` (lanes, 2) are limits of them, s. A lane whose motion fails has
        residuals `LOST` and no derivative.
        """
        values, which = np.asarray(values, float), np.asarray(which, int)
        residual = np.full((len(values), self.size), LOST)
        derivative = np.zeros((len(values), self.size, len(self.maker.names)))
        self.shifts = np.full(len(values), np.nan)
        limits = np.tile([-np.inf, np.inf], (len(values), 1)) if shifts is None else shifts
        sound = np.flatnonzero(np.isfinite(values).all(axis=1))
        for k in range(0, len(sound), WIDTH):
            own = sound[k : k + WIDTH]
            index = own[filled_up(len(own), WIDTH)]
            with np.errstate(all="ignore"):
                best, good = self._evaluate(values[index], which[index], precisely, limits[index])
            good = good[: len(own)]
            kept, count = own[good], np.flatnonzero(good)
            residual[kept] = best.residual[count, : self.size]
            derivative[kept] = best.derivative[count, : self.size]
            self.shifts[kept] = best.shift[count]
        return residual, derivative

    @property
    def can_hop(self) -> bool:
        """Whether the shift is sought, of a motion whose force may set in with a jump."""
        return self.plan.jumps and self.plan.aligned and bool(self.sharp)

    def beside(self, repetition: int, shift: float) -> list[tuple[float, float]]:
        """Return limits of the shift with which the motion begins one sample sooner, or later.

        The misfit jumps whenever a sample passes a jump of the force.
        """
        time, _, _ = self.data.of_channel(repetition, self.sharp[0])
        place, found = int(np.searchsorted(time, -shift)), []
        for low in (place - 2, place):
            if 0 <= low < len(time) - 1:
                off = 1e-6 * (time[low + 1] - time[low])
                found.append((off - time[low + 1], -off - time[low]))
        return found

    def _evaluate(self, values, which, precisely, limits) -> tuple[Trial, np.ndarray]:
        trials = self.maker.trials(
            rig_of,
            self.plan,
            values,
            self.frequency[which],
            self.numbers[which],
            self.record[which],
        )
        rigs = jax.device_get(trials.made)
        data = jax.tree.map(lambda part: part[which], self.data)
        if self.plan.begins == "settled":
            state, period, shift, cell = self._steady(trials.made, rigs, data)
        else:
            state, period = rigs.start, np.ones(len(values), np.int32)
            shift, cell = self._begun(trials.made, rigs, data, limits)
        enough = 1e-7 if precisely else 1e-3
        best = self._refined(trials, rigs, data, state, period, shift, limits, 2 * cell, enough)
        if self.plan.begins == "settled":
            length = period * 2 * np.pi / rigs.angular_frequency
            best = best._replace(shift=best.shift - np.round(best.shift / length) * length)
        finite = np.isfinite(best.residual).all(axis=1)
        finite &= np.isfinite(best.derivative).all(axis=(1, 2))
        return best, finite & best.closed & best.stable

    def _steady(self, made: Rig, rigs: Rig, data: Data):
        """State, period, first shift (s) and its grain of the steady motion nearest to the data."""
        visits, periods = jax.device_get(settle(made, self.plan))
        one = 2 * np.pi / rigs.angular_frequency
        best = np.full(len(one), np.inf)
        state, period, shift = visits[0, 0].copy(), periods[0].copy(), np.zeros(len(one))
        for start in range(2):
            length = periods[start] * one
            signals = sampled_signals(made, self.plan, visits[0, start], jnp.asarray(length), GRID)
            signals = np.asarray(signals)
            for k in range(len(one)):
                turns = np.arange(periods[start, k])
                shifts = np.arange(GRID) if self.plan.aligned else turns * GRID / len(turns)
                grid, delays = GRID / length[k], rigs.sensors.delay[k]
                costs = data.misfit_of_shifts(k, signals[k], grid, delays, shifts, True)
                place = int(np.argmin(costs))
                if costs[place] < best[k]:
                    best[k], period[k] = costs[place], len(turns)
                    # Without a shift to find, a subharmonic may still begin at any drive period.
                    back = 0 if self.plan.aligned else -place % len(turns)
                    state[k] = visits[back, start, k]
                    shift[k] = shifts[place] / GRID * length[k] if self.plan.aligned else 0.0
        return state, period, shift, period * one / GRID

    def _begun(
        self, made: Rig, rigs: Rig, data: Data, limits: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """First shift (s) and its grain of motions that have a beginning."""
        lanes = len(rigs.angular_frequency)
        if not self.plan.aligned:
            return np.zeros(lanes), np.zeros(lanes)
        reach, begun = 2 * np.pi / rigs.angular_frequency, np.zeros(lanes)
        if not self.plan.driven:
            reach = (1.0 if self.anywhere else REACH) * data.span
            begun = np.min(data.seen.time, axis=1) if self.anywhere else begun
        span = np.max(data.seen.time, axis=1) - begun + reach
        steps = np.diff(np.sort(self.data.seen.time, axis=1))
        whole = np.max(data.span) / np.min(steps[steps > 0])
        count = int(np.clip(2 * whole, GRID, 8 * GRID))
        signals = np.asarray(sampled_signals(made, self.plan, rigs.start, jnp.asarray(span), count))
        shift, cell = np.zeros(lanes), span / count
        for k in range(lanes):
            most = int(reach[k] / cell[k])
            shifts = np.arange(-most, most + 1) - begun[k] / cell[k]
            delays = rigs.sensors.delay[k]
            costs = data.misfit_of_shifts(k, signals[k], 1 / cell[k], delays, shifts, False)
            low, high = limits[k]
            allowed = (shifts * cell[k] >= low) & (shifts * cell[k] <= high)
            best = shifts[int(np.argmin(np.where(allowed, costs, np.inf)))] * cell[k]
            shift[k] = best if allowed.any() else (low + high) / 2
        return shift, cell

    def _refined(self, trials, rigs, data, state, period, shift, shifts, longest, enough) -> Trial:
        """Close the motions and find their shifts, all lanes together."""
        best, step = None, np.zeros(len(shift))
        pinned = np.zeros(len(shift), bool)
        for _ in range(MOST_ROUNDS):
            passed = jax.device_get(
                pass_through(trials.made, trials.slopes, self.plan, data.seen, state, shift, period)
            )
            here = _tried(data, passed, rigs, state, shift, len(self.maker.names), self.plan)
            better = np.ones(len(shift), bool)
            if best is not None:
                better = ~best.closed | (here.closed & (here.cost < best.cost))
                here = jax.tree.map(
                    lambda a, b, c=better: np.where(c.reshape(-1, *[1] * (a.ndim - 1)), a, b),
                    here,
                    best,
                )
            best = here
            whole = np.isfinite(best.cost) & np.isfinite(best.following).all(axis=1)
            whole &= np.isfinite(best.step)
            # A step that went too far is tried again, shorter.
            step = np.where(better, np.clip(best.step, -longest, longest), step / 4)
            step = np.clip(best.shift + step, *shifts.T) - best.shift
            pinned = ~better | (step == 0)
            if np.all(~whole | (best.closed & ((best.change <= enough) | (step == 0)))):
                break
            step = np.where(whole, step, 0.0)
            state = np.where(whole[:, None], best.following, state)
            shift = np.where(whole, best.shift + step, shift)
        assert best is not None
        # Where a sample would pass a jump of the force, the shift stays before it.
        pinned &= best.change > enough
        followed = np.where(pinned[:, None, None], 0.0, best.followed)
        return best._replace(derivative=best.derivative - followed)


def _plan(history: MeasuredHistory, channels: tuple[str, ...], system: AbstractSystem) -> Plan:
    """Decide what is computed. Raises `ValueError` for a history the system cannot have."""
    kind = type(system).__name__
    kinds = system.equations()
    if kinds.linear_between_contacts is None:
        raise ValueError(
            f"{kind} is not linear but for its stops: histories of such a system are not fitted."
        )
    exact = is_exact(system)
    if getattr(equation_kinds(system), "memory_size", 0) and not exact:
        raise ValueError(
            f"{kind} has internal states, and its contact is not exact: histories of such a system "
            f"are not fitted. Give it at most {MAX_STOPS} stops, linear in contact, unsmoothed."
        )
    beam = system.reported_place is not None
    if history.position is not None and not beam:
        raise ValueError(
            f"position = {history.position:g}: only a beam has positions along it, and this is a "
            f"{kind}. Leave position out, and let its response_map be the sensor."
        )
    if history.release is not None and not beam:
        raise ValueError(
            f"release is for the tip of an ImpactingBeam, and this is a {kind}. Give its "
            "initial_displacement."
        )
    measured = history.waveform is not None
    driven = measured or history.frequency is not None or history.frequency_ratio is not None
    unknown = [name for name in channels if name in ("displacement", "velocity")]
    if (
        measured
        and history.frame == "absolute"
        and unknown
        and isinstance(system.drive, BaseMotion)
    ):
        raise ValueError(
            f"The absolute {unknown[0]} needs that of the base, and its waveform is measured as an "
            "acceleration. Give the acceleration, or channels relative to the base."
        )
    if driven and isinstance(system.drive, NoDrive):
        raise ValueError(
            "The history has a drive, but the system has none. Give the system its "
            "drive (BaseMotion or PointForce), or the history its release (m)."
        )
    return Plan(
        channels=channels,
        position=history.position,
        absolute=history.frame == "absolute",
        begins="signal" if measured else "settled" if history.settled else "start",
        is_ratio=history.frequency is None,
        driven=driven,
        aligned=history.align_phase,
        exact=exact,
        jumps=not history.settled and any(_sets_in(stop) for stop in kinds.stops),
        delayed=False,
        fitted=(),
    )


def _sets_in(stop: Stop) -> bool:
    """Whether the force of a stop sets in with a jump: of a dashpot, where no corner is rounded."""
    return stop.is_linear and linear_coefficients(stop.law) is not None
