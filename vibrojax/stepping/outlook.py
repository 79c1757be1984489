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

from functools import partial, reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.stepping.cubic import cubic_between
from vibrojax.stepping.elementary import computed_once, pick, where_needed
from vibrojax.stepping.forcing import Forcing
from vibrojax.stepping.signals import Turning, contact_signals, with_derivatives, with_wave
from vibrojax.stepping.turns import (
    both,
    doubled,
    product,
    read_after,
    squares,
    turn_over,
    turned,
)

lax = jax.lax

Lane = Float[Array, "*#lanes"]
Phase = Int[Array, "*#lanes"]
Which = Bool[Array, "stops *#lanes"]
Blocks = Float[Array, "2 blocks *#lanes"]
Wave = Float[Array, "2 *#lanes"]
Tick = Int[Array, ""]

STEPS, LEAPS = 4, 8
"""Places of the coarse grid: as many leaps, of as many steps. Powers of two."""
LAST = STEPS * LEAPS - 1
PARTS = 7
"""In so many parts one of its intervals is looked at closely: one less than a power of two."""
GRID = 0.21
"""Longest interval, over 1 / lowest angular frequency of the phase."""
SHAPE = 16 / 6
"""Middle coefficient of 16 x^2 (1 - x)^2, the shape of a cubic's largest error, as a quartic."""
SLOPE = 384 * 3**0.5 / 216
"""Bound of the error of the cubic's slope over that of its value (Birkhoff and Priver, Hermite
interpolation errors for derivatives, 1967)."""
ROUGH, ROUND_OFF = 2e-6, 1e-14
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

    Signals are the depths; where a stop may not pull, the pushes follow, as depths.
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
    pulls: bool = eqx.field(static=True)

    def signed(self, phase: Phase, touching: Which) -> tuple[Array, Array]:
        """Rows that read the signals and what they are at rest, positive where contact changes."""
        sign = jnp.where(touching, -1.0, 1.0)
        sign = sign if self.pulls else jnp.concatenate([sign, sign])
        rest = pick(phase, self.rest) * sign
        zero = jnp.zeros_like(rest)
        return pick(phase, self.rows) * sign, jnp.stack([rest, zero, zero])

    def read(self, blocks: Blocks, phase: Phase, touching: Which, wave: Wave) -> Array:
        """Read signals and their first two derivatives."""
        rows, rest = self.signed(phase, touching)
        blocks = with_wave(blocks, wave)
        return product(rows, blocks[:, :, None, None]) + rest

    def breach(self, touching: Which, read: Float[Array, "kinds signals *#where"]) -> Array:
        """Values and derivatives of what has to pass zero for a stop to change its contact."""
        if self.pulls:
            return read
        depth, push = jnp.split(read, 2, axis=1)
        # Contact begins with depth and push, and ends where the push does.
        return jnp.where(touching | (push[:1] < depth[:1]), push, depth)

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
        tick: Tick,
    ) -> Sight:
        """Look ahead from where lanes are; `wave` is sine and cosine of the drive phase."""
        once = lambda f: computed_once(tick, f)  # noqa: E731
        now = with_wave(blocks, wave)
        decay, rate, speed = (pick(phase, a) for a in self.turning)
        sway = pick(phase, self.sway)
        step = pick(phase, self.longest) * scale
        part = step / PARTS
        rows, rest = once(lambda: self.signed(phase, touching))
        rows, rest = rows[:, :, :2], rest[:2]
        of_parts, of_steps = _turns(decay, rate, part, tick)

        def largest():
            # Of every block in every signal for as long as it is looked at.
            growth = jnp.exp(jnp.maximum(jnp.max(decay, axis=0), 0.0) * LAST * step)
            size = jnp.sqrt(now[0] ** 2 + now[1] ** 2) * growth
            return jnp.sqrt(rows[0, :, 0] ** 2 + rows[1, :, 0] ** 2) * size[:, None], growth

        amplitude, growth = once(largest)

        def apart():
            # Of two real eigenvalues that make a pair the fast one may long have died out.
            real = rate == 0
            own = jnp.abs(rows[:, :, 0] * now[:, :, None]) * growth[:, None]
            first = jnp.where(real[:, None], own[0], amplitude)
            second = jnp.where(real[:, None], own[1], 0.0)
            fast = jnp.where(real, jnp.abs(decay), speed)
            each = _errors(first, fast[0] * step), _errors(second, fast[1] * step)
            return jax.tree.map(jnp.add, *each)

        errors = once(lambda: _errors(amplitude, speed * step))
        errors = where_needed(self.creeps, apart, errors)
        grid = once(lambda: _grid(_single((rows, now, rest, of_steps)), tick))

        def coarse():
            bounds = _bounds(grid, *_single((step, errors.cubic)))
            more = sway * LAST * step + errors.flat + ROUGH * errors.size - tolerance
            return self._above(touching, bounds.top + _single(more))

        above = once(coarse)
        interval = once(lambda: _first(above))
        begun, there = interval * step, now
        for power, turn in enumerate(of_steps):
            there = once(partial(_where_bit, interval, power, turn, there))
        there = doubled(turned, of_parts, there[:, :, None], tick)
        read = once(lambda: product(rows[:, :, None], there[:, :, :, None, None]) + rest)

        def close():
            bounds = _bounds(read, part, errors.cubic_of_parts)
            more = sway * (begun + 2 * step) - ROUND_OFF * errors.size - tolerance
            return self._above(touching, bounds.top + more), self._sure(touching, bounds)

        above_there, sure = once(close)

        def decide():
            found = _first(above_there)
            doubtful = (interval < LAST) & (found < PARTS)
            start, end, may, once_only = (
                # Where there is none the last is taken, which nobody looks at then.
                pick(jnp.minimum(found, PARTS - 1), a)
                for a in (read[:-1], read[1:], above_there, sure)
            )
            f0, g0 = self.breach(touching, start)
            f1, g1 = self.breach(touching, end)
            f0, crosses = jnp.minimum(f0, 0.0), f1 > tolerance
            secant = jnp.clip(-f0 / jnp.where(crosses, f1 - f0, 1.0), 0.02, 0.98)
            cubic = cubic_between(f0, g0 * part, f1, g1 * part)
            place = jnp.where(crosses, cubic.root(guess=secant, rounds=5), jnp.inf)
            first = jnp.min(place, axis=0)
            settled = ~jnp.any(may & ~(crosses & once_only), axis=0) | (scale <= FINEST)
            # Cleared up to the crossing, or all of a part in which there is none after all.
            share = jnp.where(settled, jnp.minimum(first, 1.0), 0.0)
            clear = jnp.where(doubtful, found + share, jnp.where(interval < LAST, PARTS, 0.0))
            expected = doubtful & settled & jnp.isfinite(first)
            again = doubtful & ~settled
            return Sight(
                time=begun + clear * part,
                stop=jnp.where(expected, jnp.argmin(place, axis=0), -1).astype(jnp.int32),
                scale=jnp.where(again, jnp.maximum(scale / 8, FINEST), jnp.minimum(2 * scale, 1.0)),
            )

        return once(decide)

    def _above(self, touching: Which, top: Array) -> Bool[Array, "places stops *lanes"]:
        """Whether a stop may change its contact, from the highest that its signals may be."""
        if self.pulls:
            return top > 0
        depth, push = jnp.split(top > 0, 2, axis=1)
        return push & (touching | depth)

    def _sure(self, touching: Which, bounds: "_Bounds") -> Bool[Array, "places stops *lanes"]:
        """Whether a stop changes its contact once at the most."""
        if self.pulls:
            return bounds.rises
        depth, push = jnp.split(bounds.rises, 2, axis=1)
        depth_stays, push_stays = jnp.split(bounds.bottom > 0, 2, axis=1)
        flight = (depth | depth_stays) & (push | push_stays)
        return jnp.where(touching, push, flight)


class _Errors(NamedTuple):
    """How far signals may be from the cubics through them, by signal and lane."""

    cubic: Float[Array, "signals *lanes"]
    """At the middle of an interval, falling off towards its ends as the error of a cubic does."""
    cubic_of_parts: Float[Array, "signals *lanes"]
    flat: Float[Array, "signals *lanes"]
    """Anywhere in an interval, of blocks that turn too far in it."""
    size: Float[Array, "signals *lanes"]
    """What rounding is a share of."""


def _errors(amplitude: Float[Array, "blocks signals *lanes"], turn: Array) -> _Errors:
    """Bounds from the largest amplitudes and the turns over an interval, rad."""
    cubic, of_parts = turn**4 / 384, (turn / PARTS) ** 4 / 384
    # However fast a block turns, the cubic through it is no higher than its ends make it.
    flat = 2 + 0.3 * turn
    slow = SHAPE * cubic <= flat
    kinds = jnp.where(slow, cubic, 0.0), of_parts, jnp.where(slow, 0.0, flat), 1 + turn
    return _Errors(*(jnp.sum(amplitude * kind[:, None], axis=0) for kind in kinds))


def _turns(decay: Array, rate: Array, part: Lane, tick: Tick) -> tuple[list[Array], list[Array]]:
    """Turns over 1, 2, 4, ... parts, which together are a step, and over 1, 2, 4, ... steps."""
    turn = computed_once(tick, lambda: turn_over(decay, rate, part))
    of_parts = squares(turn, (PARTS + 1).bit_length() - 1, tick)
    turn = computed_once(tick, lambda: reduce(both, of_parts))
    return of_parts, squares(turn, (STEPS * LEAPS).bit_length() - 1, tick)


def _grid(numbers: tuple[Array, Array, Array, list[Array]], tick: Tick) -> Array:
    """Read signals and slopes at all places of the coarse grid."""
    rows, blocks, rest, of_steps = numbers
    leap = STEPS.bit_length() - 1
    ahead = doubled(read_after, of_steps[:leap], rows[:, :, None], tick)
    leaps = doubled(turned, of_steps[leap:], blocks[:, :, None], tick)
    read = product(ahead[:, :, None], leaps[:, :, :, None, None, None])
    return read.reshape(-1, *read.shape[2:]) + rest


class _Bounds(NamedTuple):
    top: Float[Array, "places signals *lanes"]
    bottom: Float[Array, "places signals *lanes"]
    rises: Bool[Array, "places signals *lanes"]


def _bounds(read: Array, step: Lane, error: Array) -> _Bounds:
    """Bounds of signals on the intervals between places, from values and slopes there."""
    value, slope = read[:, 0], read[:, 1] * (step / 3)
    b0, b3 = value[:-1], value[1:]
    b1, b2 = b0 + slope[:-1], b3 - slope[1:]
    early, late, middle = (b0 + 3 * b1) / 4, (3 * b2 + b3) / 4, (b1 + b2) / 2
    ends = jnp.maximum(early, late), jnp.minimum(early, late)
    top = jnp.maximum(jnp.maximum(ends[0], middle + SHAPE * error), b3)
    bottom = jnp.minimum(jnp.minimum(ends[1], middle - SHAPE * error), jnp.minimum(b0, b3))
    rise = jnp.minimum(jnp.minimum(b1 - b0, b2 - b1), b3 - b2)
    return _Bounds(top, bottom, 3 * rise > SLOPE * error)


def _first(above: Bool[Array, "places stops *lanes"]) -> Int[Array, "*lanes"]:
    """Index of the first place with any stop; their number where there is none."""
    found = jnp.full(above.shape[2:], len(above), jnp.int32)
    for k in reversed(range(len(above))):
        found = jnp.where(jnp.any(above[k], axis=0), k, found)
    return found


def _where_bit(count: Array, power: int, turn: Array, blocks: Array) -> Array:
    """Turn blocks where a bit of a count is set."""
    return jnp.where((count >> power) & 1 == 1, turned(turn, blocks), blocks)


def _single(numbers: Any) -> Any:
    return jax.tree.map(lambda a: a.astype(jnp.float32), numbers)


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
    return Outlook(
        turning=turning,
        longest=GRID / slowest,
        shortest=LANDING / jnp.max(turning.speed, axis=1),
        rows=with_derivatives(turning, force, signals),
        rest=signals.rest,
        sway=jnp.sum(size * push[:, None], axis=2),
        creeps=jnp.any(phases.rate == 0),
        pulls=all(phases.can_pull),
    )
