"""How far ahead a lane is known to keep its contacts, and where it may change them next.

Within a phase the depths at the stops are sums of decaying turns of frozen amplitudes, the drive
one more of them. They are read on a coarse grid. Between two places a depth is no further from the
cubic through values and slopes than its fourth derivative allows, which the amplitudes bound: where
the highest coefficient of that bound (in Bernstein's form) is negative, no contact changes. The
first interval in doubt is looked at eight times as finely, and the first doubtful part of it either
holds one crossing for certain, to which the lane goes, or is looked at again from where it begins,
finer still. So what a lane costs is its contacts, whatever their stiffness.

Blocks are the second axis of all arrays here, after their two rows.
"""

from functools import reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.stepping.cubic import cubic_between
from vibrojax.stepping.elementary import computed_once, on_cpu, pick, where_needed
from vibrojax.stepping.forcing import Forcing
from vibrojax.stepping.signal_bounds import (
    Bounds,
    Margin,
    Place,
    Span,
    bounds_between,
    errors_of,
    first_of,
    spans_ahead,
    spans_at_once,
    turns_ahead,
)
from vibrojax.stepping.signals import Turning, contact_signals, with_derivatives, with_wave
from vibrojax.stepping.turns import Turn, product, repeated, turn_over, turned

lax = jax.lax

Lane = Float[Array, "*#lanes"]
Phase = Int[Array, "*#lanes"]
Which = Bool[Array, "stops *#lanes"]
Blocks = Float[Array, "2 blocks *#lanes"]
Wave = Float[Array, "2 *#lanes"]
Tick = Int[Array, ""]

PLACES, INTERVALS = 8, 32
"""Intervals of the coarse grid, of which so many are looked at together; and all of them."""
PARTS = 8
"""In so many parts one of them is looked at closely; powers of two, as `PLACES`."""
GRID = 0.21
"""Longest interval, over 1 / lowest angular frequency of the phase."""
ROUGH, ROUND_OFF = 4e-6, 1e-14
"""Rounding of what is read off the coarse grid and off its parts, over the amplitudes."""
LANDING = 1e-3
"""Longest way to a crossing that is gone by series, over 1 / the fastest rate of the phase."""
FINEST = 8.0**-7
"""Share of the usual grid at which a doubt is settled by the cubic itself."""


class Sight(NamedTuple):
    """What a lane is to do next."""

    time: Float[Array, "*lanes"]
    """How far to go, s; before that no contact changes."""
    stop: Int[Array, "*lanes"]
    """Stop that is expected to change its contact there; -1 for none."""
    scale: Float[Array, "*lanes"]
    """Grid to look on next, over the usual one."""


class Outlook(eqx.Module):
    """Signals of every phase, positive in contact, and what it takes to look ahead.

    Signals are the depths; where a stop may not pull, the pushes follow, as depths. All are signed:
    positive where contact changes.
    """

    turning: Turning
    longest: Float[Array, "phases *lanes"]
    """Interval of the usual grid, s."""
    shortest: Float[Array, "phases *lanes"]
    """Way to a crossing that is gone by series, s."""
    rows: Float[Array, "phases 2 blocks derivatives signals *lanes"]
    """Rows that read signals, their rates and accelerations."""
    rest: Float[Array, "phases signals *lanes"]
    sway: Float[Array, "phases signals *lanes"]
    """What a drive in resonance may add in a second."""
    creeps: Bool[Array, ""]
    """Whether any phase has real eigenvalues."""
    grows: Bool[Array, ""]
    """Whether any has eigenvalues that grow."""
    pulls: bool = eqx.field(static=True)

    def signed(self, phase: Phase) -> tuple[Array, Array]:
        """Rows that read the signals and their derivatives, and what the signals are at rest."""
        return pick(phase, self.rows), pick(phase, self.rest)

    def read(self, blocks: Blocks, wave: Wave, rows: Array, rest: Array) -> Array:
        """Read signals and their first two derivatives by `signed` rows."""
        read = product(rows, with_wave(blocks, wave)[:, :, None, None])
        return jnp.concatenate([read[:1] + rest, read[1:]])

    def breach(self, touching: Which, read: Float[Array, "kinds signals *#where"]) -> Array:
        """Values and derivatives of what has to pass zero for a stop to change its contact."""
        if self.pulls:
            return read
        depth, push = jnp.split(read, 2, axis=1)
        return jnp.where(_waits_for_push(touching, depth[:1], push[:1]), push, depth)

    def crossing(self, touching: Which, read: Array) -> tuple[Array, Which]:
        """When stops change their contact as parabolas have it, s, and whether they do."""
        late, real = _rise(*self.breach(touching, read))
        if self.pulls:
            return late, real
        begun = ~touching & jnp.logical_and(*jnp.split(read[0] > 0, 2))
        # Where both are positive contact has begun, at the later of the roots that are past.
        root, rises = _rise(*read)
        past = jnp.maximum(*jnp.split(jnp.where(rises & (root <= 0), root, -jnp.inf), 2))
        begun &= past > -jnp.inf
        return jnp.where(begun, past, late), begun | real

    def look(
        self,
        blocks: Blocks,
        phase: Phase,
        touching: Which,
        wave: Wave,
        scale: Lane,
        tolerance: Lane,
        signed: tuple[Array, Array],
        tick: Tick,
    ) -> Sight:
        """Look ahead from where lanes are; `wave` is sine and cosine of the drive phase."""
        once = lambda f: computed_once(tick, f)  # noqa: E731
        now = with_wave(blocks, wave)
        decay, rate, speed = (pick(phase, a) for a in self.turning)
        sway = pick(phase, self.sway)
        step = pick(phase, self.longest) * scale
        part, in_steps = step / PARTS, on_cpu()
        rows, rest = signed[0][:, :, :2], signed[1]
        turn = once(lambda: turn_over(decay, rate, part, self.creeps))
        over_interval = once(lambda: repeated(turn, PARTS))
        over_several = once(lambda: repeated(over_interval, PLACES))

        def growing() -> Array:
            return jnp.exp(jnp.maximum(jnp.max(decay, axis=0), 0.0) * INTERVALS * step)

        def largest() -> Array:
            # Of every block in every signal for as long as it is looked at.
            size = (now[0] ** 2 + now[1] ** 2) * growth**2
            return jnp.sqrt((rows[0, :, 0] ** 2 + rows[1, :, 0] ** 2) * size[:, None])

        growth = where_needed(self.grows, growing, jnp.ones_like(rate))
        amplitude = once(largest)

        def apart():
            # Of two real eigenvalues that make a pair the fast one may long have died out.
            real = rate == 0
            own = jnp.abs(rows[:, :, 0] * now[:, :, None]) * growth[:, None]
            first = jnp.where(real[:, None], own[0], amplitude)
            second = jnp.where(real[:, None], own[1], 0.0)
            fast = jnp.where(real, jnp.abs(decay), speed)
            each = (
                errors_of(a, f * step, PARTS) for a, f in zip((first, second), fast, strict=True)
            )
            return jax.tree.map(jnp.add, *each)

        errors = once(lambda: errors_of(amplitude, speed * step, PARTS))
        errors = where_needed(self.creeps, apart, errors)

        def grid() -> _Grid:
            more = sway * INTERVALS * step + errors.flat + ROUGH * errors.size - tolerance
            coarse = pick(phase, _single(self.rows[:, :, :, :2]))
            turns: Any = over_interval, over_several
            if not in_steps:
                turns = turns_ahead(decay, rate, step, INTERVALS, jnp.float32)
            return _Grid(coarse, *_single((rest, now, step, turns, Margin(errors.cubic, more))))

        interval = self._first_doubt(once(grid), touching)
        begun = interval * step
        leap = once(lambda: turn_over(decay, rate, begun, self.creeps))
        there = once(lambda: turned(leap, now))

        def fine() -> Array:
            more = sway * (begun + 2 * step) - ROUND_OFF * errors.size - tolerance
            margin = Margin(errors.cubic_of_parts, more)
            if in_steps:
                spans = spans_ahead(rows, rest, there, part, turn, PARTS)
            else:
                turns = turns_ahead(decay, rate, part, PARTS, part.dtype)
                spans = spans_at_once(rows, rest, there, part, turns)
            return self._closely(spans, margin, touching, interval, tolerance, scale)

        found = once(fine)
        outcome = jnp.floor(found / 2).astype(jnp.int32)
        again = outcome > len(touching)
        return Sight(
            time=(found - 2 * outcome) * (INTERVALS * step),
            stop=jnp.where(again, -1, outcome - 1),
            scale=jnp.where(again, jnp.maximum(scale / 8, FINEST), jnp.minimum(2 * scale, 1.0)),
        )

    def _first_doubt(self, grid: "_Grid", touching: Which) -> Float[Array, "*lanes"]:
        """First interval of the coarse grid in which a contact may change; else their number."""
        rows, rest, blocks, step, turns, margin = grid
        none = jnp.full(blocks.shape[2:], INTERVALS, blocks.dtype)

        def first(spans: list[Span]) -> Array:
            bounds = [bounds_between(*span, margin.cubic) for span in spans]
            may = [reduce(jnp.logical_or, self._above(touching, b, margin.more)) for b in bounds]
            return first_of(none, may, [None] * len(may))[0]

        if isinstance(turns, Turn):
            return first(spans_at_once(rows, rest, blocks, step, turns))
        turn, leap = turns

        def some(tick: Tick, carry: tuple[Lane, Blocks]) -> tuple[Lane, Blocks]:
            found, blocks = carry
            here = lambda: first(spans_ahead(rows, rest, blocks, step, turn, PLACES))  # noqa: E731
            found = jnp.minimum(found, computed_once(tick, here) + PLACES * tick)
            return found, turned(leap, blocks)

        return lax.fori_loop(0, INTERVALS // PLACES, some, (none, blocks))[0]

    def _closely(
        self,
        spans: list[Span],
        margin: Margin,
        touching: Which,
        interval: Lane,
        tolerance: Lane,
        scale: Lane,
    ) -> Float[Array, "*lanes"]:
        """Look at the parts of an interval; one number, of which XLA makes one loop.

        Twice the outcome (0: no change is expected, 1 + the stop that changes, 1 + the number of
        stops where it is to be looked at again), and how far to go, over the whole grid.
        """
        hits, each = [], []
        for span in spans:
            bounds = bounds_between(*span, margin.cubic)
            may = self._above(touching, bounds, margin.more)
            each.append((*span, may, self._sure(touching, bounds)))
            hits.append(reduce(jnp.logical_or, may))
        # Where there is none some part is taken, which nobody looks at then.
        found, chosen = first_of(jnp.full_like(interval, PARTS), hits, each)
        start, end, may, once_only = chosen
        doubtful = (interval < INTERVALS) & (found < PARTS)
        first, stop, settled = jnp.full_like(interval, jnp.inf), 0 * found, scale > 0
        for s, can in enumerate(may):
            (f0, g0), (f1, g1) = (self._breach(touching[s], place, s) for place in (start, end))
            f0, crosses = jnp.minimum(f0, 0.0), f1 > tolerance
            secant = jnp.clip(-f0 / jnp.where(crosses, f1 - f0, 1.0), 0.02, 0.98)
            cubic = cubic_between(f0, 3 * g0, f1, 3 * g1)
            place = jnp.where(crosses, cubic.root(guess=secant, rounds=5), jnp.inf)
            stop = jnp.where(place < first, s, stop)
            first = jnp.minimum(first, place)
            settled &= ~can | (crosses & once_only[s])
        settled |= scale <= FINEST
        # Cleared up to the crossing, or all of a part in which there is none after all.
        share = jnp.where(settled, jnp.minimum(first, 1.0), 0.0)
        clear = jnp.where(doubtful, found + share, jnp.where(interval < INTERVALS, PARTS, 0.0))
        outcome = jnp.where(jnp.isfinite(first), stop + 1, 0)
        outcome = jnp.where(settled, outcome, len(may) + 1)
        outcome = jnp.where(doubtful, outcome, 0)
        return 2 * outcome + (interval + clear / PARTS) / INTERVALS

    def _breach(self, touching: Array, place: Place, stop: int) -> tuple[Array, Array]:
        """`breach` of one stop at a place."""
        if self.pulls:
            return place[stop]
        depth, push = place[stop], place[stop + len(place) // 2]
        by_push = _waits_for_push(touching, depth[0], push[0])
        return jnp.where(by_push, push[0], depth[0]), jnp.where(by_push, push[1], depth[1])

    def _above(self, touching: Which, bounds: list[Bounds], more: Array) -> list[Array]:
        """Whether a stop may change its contact, from the highest that its signals may be."""
        top = [b.top + m > 0 for b, m in zip(bounds, more, strict=True)]
        if self.pulls:
            return top
        depth, push = top[: len(touching)], top[len(touching) :]
        return [p & (t | d) for t, d, p in zip(touching, depth, push, strict=True)]

    def _sure(self, touching: Which, bounds: list[Bounds]) -> list[Array]:
        """Whether a stop changes its contact once at the most."""
        if self.pulls:
            return [b.rises for b in bounds]
        stops = len(touching)
        stays = [b.rises | (b.bottom > 0) for b in bounds]
        return [
            jnp.where(touching[s], bounds[stops + s].rises, stays[s] & stays[stops + s])
            for s in range(stops)
        ]


class _Grid(NamedTuple):
    """What is read on the coarse grid."""

    rows: Float[Array, "2 blocks kinds signals *lanes"]
    rest: Float[Array, "signals *lanes"]
    blocks: Float[Array, "2 blocks *lanes"]
    step: Float[Array, "*lanes"]
    turns: tuple[Turn, Turn] | Turn
    """Over an interval and over as many as are looked at together; or to all places."""
    margin: Margin


def _single(numbers: Any) -> Any:
    return jax.tree.map(lambda a: a.astype(jnp.float32), numbers)


def _waits_for_push(touching: Array, depth: Array, push: Array) -> Array:
    """Whether contact changes with the push: it begins with depth and push, and ends with that."""
    return touching | (push < depth)


def _rise(value: Array, slope: Array, bend: Array) -> tuple[Array, Array]:
    """Time to where a parabola rises through zero, s, and whether it does."""
    square = slope**2 - 2 * bend * value
    real = square > 0
    # In the form that does not cancel.
    below = slope + jnp.sqrt(jnp.where(real, square, 1.0))
    real &= below != 0
    return -2 * value / jnp.where(real, below, 1.0), real


def outlook_of(phases: ContactPhases, force: Forcing, turning: Turning) -> Outlook:
    """Tabulate the signals of a drive."""
    w, signals = force.angular_frequency, contact_signals(phases, force)
    value = signals.rows.reshape(*signals.rows.shape[:2], 2, -1, *w.shape)
    driven = force.driven.reshape(force.driven.shape[0], 2, -1, *w.shape)
    # Blocks turn: what goes into one row of them is read by the other later.
    size, push = (
        jnp.sqrt(jnp.sum(jnp.abs(lax.stop_gradient(a)) ** 2, axis=-2 - w.ndim))
        for a in (value, driven)
    )
    slowest = jnp.maximum(jnp.min(turning.speed[:, :-1], axis=1), w)
    k, count = phases.num_stops, len(signals.rest)
    touching = (np.arange(count)[:, None] >> np.arange(signals.rest.shape[1]) % k) & 1
    sign = 1.0 - 2.0 * touching.reshape(*touching.shape, *(1,) * w.ndim)
    return Outlook(
        turning=turning,
        longest=GRID / slowest,
        shortest=LANDING / jnp.max(turning.speed, axis=1),
        rows=with_derivatives(turning, force, signals) * sign[:, None, None, None],
        rest=signals.rest * sign,
        sway=jnp.sum(size * push[:, None], axis=2),
        creeps=jnp.any(phases.rate == 0),
        grows=jnp.any(phases.exponent > 0),
        pulls=all(phases.can_pull),
    )
