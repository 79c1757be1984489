"""What is measured of the stretches that lanes go through between changes of contact.

The march goes from one change of contact to the next and keeps where it was; here every stretch is
gone through again in cells, on each of which the response is the quintic through values, slopes and
accelerations at its ends. How many cells the amplitudes and rates of the stretch say. Where the
motion is highest on these is then gone to itself.
"""

import math
from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from vibrojax.stepping.contact_phases import ContactPhases
from vibrojax.stepping.cubic import cubic_between, quintic_maximum
from vibrojax.stepping.elementary import by_halves, computed_once, pick, total, where_needed
from vibrojax.stepping.forcing import Forcing
from vibrojax.stepping.measures import Measures
from vibrojax.stepping.signals import (
    Signals,
    Turning,
    contact_distances,
    measured_signals,
    with_derivatives,
    with_wave,
)
from vibrojax.stepping.turns import doubled, product, squares, turn_over, turned

lax = jax.lax

PLACES = 8
"""Stretches that a lane goes through before they are measured."""
CELLS = 8
"""Cells that are looked at together; a power of two."""
MOST = 64
"""Times so many cells, at the most, in a stretch."""
QUINTIC = 46080
"""Sixth derivative over the largest error of a quintic: 6! 2^6."""


RESPONSE = -2
"""Place of the response among the signals, behind the forces; the last is its negative."""
EULER_MACLAURIN = {1: -1 / 12, 3: 1 / 720, 5: -1 / 30240}
"""Weights of the derivatives at both ends by which the trapezoidal rule is corrected."""


class Ruler(NamedTuple):
    """How finely motions are measured."""

    error: Float[Array, "*#lanes"]
    """Of a quintic, over the amplitudes of what it is put through."""
    longest: Float[Array, "*#lanes"]
    """Longest cell, s."""
    nearest: bool = False
    """Whether to measure how near stops come to a change of contact and turn back."""


class Stretches(NamedTuple):
    """What lanes went through since they were measured last, in order of time."""

    blocks: Float[Array, "places 2 blocks *lanes"]
    """At the beginning."""
    phase: Int[Array, "places *lanes"]
    begun: Float[Array, "places *lanes"]
    """Time since the start, s."""
    cell: Float[Array, "places *lanes"]
    """Length of the cells, s."""
    groups: Int[Array, "places *lanes"]
    """How many times `CELLS` of them there are; 0 in places that are free."""

    def has_room(self) -> Bool[Array, "*lanes"]:
        """Whether a lane has a free place."""
        return self.groups[-1] == 0

    def add(self, stretch: "Stretches", kept: Bool[Array, "*lanes"]) -> "Stretches":
        """Note a stretch, which has no axis of places, where it was kept."""
        taken = self.groups > 0
        before = jnp.concatenate([jnp.ones_like(taken[:1]), taken[:-1]])
        here = kept & before & ~taken

        def put(new: Array, old: Array) -> Array:
            wide = here.reshape(PLACES, *(1,) * (old.ndim - here.ndim), *here.shape[1:])
            return jnp.where(wide, new, old)

        return jax.tree.map(put, stretch, self)

    def forgotten(self) -> "Stretches":
        """Make room for others."""
        return self._replace(groups=jnp.zeros_like(self.groups))


def no_stretches(blocks: Float[Array, "2 blocks *lanes"]) -> Stretches:
    """Nothing gone through."""
    lanes = blocks.shape[2:]
    time, number = jnp.zeros((PLACES, *lanes)), jnp.zeros((PLACES, *lanes), jnp.int32)
    return Stretches(jnp.zeros((PLACES, *blocks.shape)), number, time, time, number)


class Gauge:
    """Tables that stay fixed while lanes are measured.

    `grown` returns what a drive in resonance adds to blocks of a phase that turn from a drive time
    on for some times, all s; it is asked only where `resonant` says so.
    """

    def __init__(
        self,
        phases: ContactPhases,
        force: Forcing,
        turning: Turning,
        ruler: Ruler,
        grown: Callable[[Array, Array, Array], Array],
        resonant: Bool[Array, ""],
    ):
        self.force, self.turning, self.ruler = force, turning, ruler
        self.grown, self.resonant = grown, resonant
        signals = measured_signals(phases, force)
        # How far stops are from a change of contact comes first, where it is asked for.
        self.turning_back = phases.num_stops if ruler.nearest else 0
        if ruler.nearest:
            both = zip(contact_distances(phases, force), signals, strict=True)
            signals = Signals(*(jnp.concatenate(each, axis=1) for each in both))
        self.rows, self.rest = with_derivatives(turning, force, signals), signals.rest
        response = jax.tree.map(lambda a: a[:, RESPONSE : RESPONSE + 1], signals)
        self.higher = with_derivatives(turning, force, response, order=5)[:, :, :, 3:, 0]
        """Rows of the third to the fifth derivative of the response."""
        self.lanes = force.angular_frequency.ndim

    def stretch(
        self, blocks: Array, phase: Array, begun: Array, duration: Array, touching: Array
    ) -> Stretches:
        """Say how a stretch is to be measured; `blocks` have the drive with them."""
        count = self.cells(blocks, phase, duration, touching)
        return Stretches(blocks[:, :-1], phase, begun, duration / (CELLS * count), count)

    def measure(
        self,
        passed: Stretches,
        measures: Measures,
        touching: Callable[[Array], Bool[Array, "stops *lanes"]],
        wave_at: Callable[[Array], Float[Array, "2 *lanes"]],
    ) -> Measures:
        """Measure what lanes passed, each at its own pace."""
        share = jnp.arange(1, CELLS + 1).reshape((-1,) + (1,) * self.lanes)

        def some(tick: Array, carry: tuple[Any, ...]) -> tuple[Any, ...]:
            once = lambda f: computed_once(tick, f)  # noqa: E731
            place, k, blocks, tops, measures = carry
            stored, phase, begun, cell, groups = once(lambda: [pick(place, a) for a in passed])
            live = (place < PLACES) & (groups > 0)
            blocks = jnp.where(k == 0, jnp.concatenate([stored, blocks[:, -1:]], axis=1), blocks)
            decay, rate, _ = (pick(phase, a) for a in self.turning)
            turns = squares(once(lambda: turn_over(decay, rate, cell)), CELLS.bit_length(), tick)
            there = doubled(turned, turns[:-1], blocks[:, :, None], tick)
            there = once(
                lambda: jnp.concatenate([there, turned(turns[-1], blocks)[:, :, None]], axis=2)
            )

            def push() -> Array:
                more = self.grown(phase, begun + k * CELLS * cell, share * cell)
                return there.at[:, :-1, 1:].add(more)

            there = where_needed(self.resonant, push, there)
            integrals, top = once(lambda: self.of_cells(there, phase, cell, tick))
            always = jnp.ones((self.turning_back + 2, *live.shape), bool)
            counts = [always[:-2], touching(phase), always[-2:]]
            higher = live & jnp.concatenate(counts) & (top.value > tops.value)
            top = top._replace(
                offset=(k * CELLS + top.offset) * cell, place=jnp.broadcast_to(place, higher.shape)
            )
            tops = jax.tree.map(lambda new, old: jnp.where(higher, new, old), top, tops)
            over = live & (k + 1 >= groups)
            measures = measures.integrated(*integrals, live)
            return place + over, jnp.where(over, 0, k + live), there[:, :, -1], tops, measures

        begin = with_wave(passed.blocks[0], wave_at(passed.begun[0]))
        none = jnp.zeros_like(passed.phase[0])
        kinds = self.rest.shape[1:]
        tops = _Tops(
            jnp.full(kinds, -jnp.inf),
            jnp.zeros(kinds, bool),
            jnp.zeros(kinds),
            jnp.zeros(kinds, jnp.int32),
        )
        most = jnp.max(total(passed.groups))
        *_, tops, measures = lax.fori_loop(0, most, some, (none, none, begin, tops, measures))
        nearest, heights = jnp.split(self.heights(passed, tops, wave_at), [self.turning_back])
        *force, high, low = heights
        if measures.nearest is not None:
            k, w = self.turning_back, self.force.angular_frequency
            time = pick(tops.place[:k], jnp.expand_dims(passed.begun, -1 - self.lanes))
            angle = self.force.start_phase + w * (time + tops.offset[:k])
            new, old = jnp.stack([nearest, angle]), measures.nearest
            measures = measures._replace(nearest=jnp.where(new[0] > old[0], new, old))
        force = reduce(jnp.maximum, force, jnp.zeros_like(high))
        return measures.reached(high, -low, force, passed.groups[0] > 0)

    def heights(
        self, passed: Stretches, tops: "_Tops", wave_at: Callable[[Array], Array]
    ) -> Float[Array, "kinds *lanes"]:
        """Heights of the tops, from the motion itself."""

        def wide(table: Array) -> Array:
            return jnp.expand_dims(table, -1 - self.lanes)

        stored, phase, begun = (pick(tops.place, wide(a)) for a in passed[:3])
        decay, rate, _ = (pick(phase, wide(a)) for a in self.turning)
        now = with_wave(stored, wave_at(begun))
        blocks = turned(turn_over(decay, rate, tops.offset), now)

        def push() -> Array:
            more = jax.vmap(self.grown, 0, 2)(phase, begun, tops.offset)
            return blocks.at[:, :-1].add(more)

        blocks = where_needed(self.resonant, push, blocks)
        value, slope, bend = product(pick(phase, self.rows), blocks[:, :, None])
        value = value + pick(phase, self.rest)
        # What is left to the very top.
        peaks = tops.inside & (bend < 0)
        more = jnp.where(peaks, slope**2 / jnp.where(peaks, -2 * bend, 1.0), 0.0)
        return jnp.where(jnp.isfinite(tops.value), value + more, -jnp.inf)

    def cells(
        self, blocks: Array, phase: Array, duration: Array, touching: Array
    ) -> Int[Array, "*lanes"]:
        """How many times `CELLS` cells a stretch is to have."""
        tables = [pick(phase, self.rows[:, :, :, 0]), *(pick(phase, a) for a in self.turning)]
        rows, decay, rate, speed, blocks, duration = lax.stop_gradient((*tables, blocks, duration))
        size = jnp.sqrt(blocks[0] ** 2 + blocks[1] ** 2)
        amplitude = jnp.sqrt(rows[0] ** 2 + rows[1] ** 2) * size[:, None]
        bends = amplitude * speed[:, None] ** 6

        def apart() -> Array:
            own = jnp.abs(rows * blocks[:, :, None]) * decay[:, :, None] ** 6
            return jnp.where(rate[:, None] == 0, own[0] + own[1], bends)

        # Of two real eigenvalues that make a pair the fast one may long have died out.
        bends = where_needed(jnp.any(self.turning.rate == 0), apart, bends)
        whole, sixth = total(amplitude), total(bends)
        bent = jnp.where(whole > 0, sixth / jnp.where(whole > 0, whole, 1.0), 0.0)
        # What a stop that is not touched would push with does not count.
        pushes = jnp.where(touching, bent[self.turning_back : -2], 0.0)
        bent = reduce(jnp.maximum, list(pushes), bent[-1])
        asked = (bent / (QUINTIC * self.ruler.error)) ** (1 / 6)
        asked = duration * jnp.maximum(asked, 1 / self.ruler.longest)
        return jnp.clip(jnp.ceil(asked / CELLS), 1, MOST).astype(jnp.int32)

    def of_cells(
        self, blocks: Array, phase: Array, cell: Array, tick: Array
    ) -> tuple[tuple[Array, ...], "_Tops"]:
        """Integrals over some cells, and tops of the signals."""
        w, h = self.force.angular_frequency, cell
        rows, rest = pick(phase, self.rows), pick(phase, self.rest)

        def read(kind: int) -> Array:
            return product(rows[:, :, None, kind], blocks[:, :, :, None])

        value, slope, bend = computed_once(tick, lambda: (read(0) + rest, read(1), read(2)))
        scaled = value, slope * h, bend * h**2
        ends = blocks[:, :, ::CELLS]
        higher = product(pick(phase, self.higher)[:, :, :, None], ends[:, :, None])
        response = [*(a[::CELLS, RESPONSE] for a in (value, slope, bend)), *higher]
        cosine, sine = ends[:, -1]
        signs = 1, 1, -1, -1, 1, 1
        of_sine = [sign * w**k * (sine, cosine)[k % 2] for k, sign in enumerate(signs)]
        of_cosine = [sign * w**k * (cosine, -sine)[k % 2] for k, sign in enumerate(signs)]

        def integral(partner: Array, derivatives: list[Array]) -> Array:
            """Of response times partner: the trapezoidal rule, corrected by Euler and Maclaurin."""
            f = value[:, RESPONSE] * partner
            area = h * (total(f[1:-1]) + (f[0] + f[-1]) / 2)
            for order, weight in EULER_MACLAURIN.items():
                both = [
                    math.comb(order, k) * response[k] * derivatives[order - k]
                    for k in range(order + 1)
                ]
                start, end = reduce(jnp.add, both)
                area = area + weight * h ** (order + 1) * (end - start)
            return area

        integrals = (
            integral(value[:, RESPONSE], response),
            integral(blocks[1, -1], of_sine),
            integral(blocks[0, -1], of_cosine),
        )
        return integrals, _highest(scaled, self.turning_back)


class _Tops(NamedTuple):
    """Highest places of signals."""

    value: Float[Array, "kinds *lanes"]
    inside: Bool[Array, "kinds *lanes"]
    """Whether the slope vanishes there."""
    offset: Float[Array, "kinds *lanes"]
    """From the beginning of the stretch, s; of `of_cells`, in cells."""
    place: Int[Array, "kinds *lanes"]


def _highest(ends: tuple[Array, ...], turning_back: int) -> _Tops:
    """Highest places on some cells, from values and derivatives per cell at their ends.

    Of the first signals, as many as `turning_back`, only where they rise before and fall behind.
    """
    start, end = (tuple(a[which] for a in ends) for which in (slice(None, -1), slice(1, None)))
    inside, place, value = quintic_maximum(start, end)
    if turning_back:
        before, behind = ([a[:, :turning_back] for a in side] for side in (start, end))
        turns, there, height = _turn_back(before, behind, inside, place, value)
        inside, place, value = (
            jnp.concatenate([a, b[:, turning_back:]], axis=1)
            for a, b in ((turns, inside), (there, place), (height, value))
        )
    first = np.arange(len(value)).reshape((-1,) + (1,) * (value.ndim - 1))
    cells = _Tops(value, inside, place + first, inside * 0)

    def higher(one: _Tops, other: _Tops) -> _Tops:
        return jax.tree.map(lambda a, b: jnp.where(other.value > one.value, b, a), one, other)

    return by_halves(higher, cells)


def _turn_back(
    start: list[Array], end: list[Array], inside: Array, place: Array, value: Array
) -> tuple[Array, Array, Array]:
    """Where on some cells signals turn back, whether inside of them, and how high; else -inf.

    `inside`, `place`, `value` are of the highest places. A signal that rises at both ends of one,
    or falls, turns back and on in between where the cubic through its slopes has another sign.
    """
    (y, slope, bend), (_, last, bent) = start, end
    stops = slice(None, slope.shape[1])
    rises = slope >= 0
    sign = jnp.where(rises, -1.0, 1.0)
    other = cubic_between(sign * slope, sign * bend, sign * last, sign * bent)
    u, most = other.peak()
    narrow = -(other.curve + 3 * u * other.bend)
    hidden = (rises == (last >= 0)) & (most > 0) & (narrow > 0)
    off = jnp.sqrt(jnp.where(hidden, most / jnp.where(hidden, narrow, 1.0), 0.0))
    u = jnp.clip(u + sign * off, 0.0, 1.0)
    gone = u * (other.value + u * (other.slope / 2 + u * (other.curve / 3 + u * other.bend / 4)))
    plain = rises & (last < 0)
    height = jnp.where(hidden, y + sign * gone, jnp.where(plain, value[:, stops], -jnp.inf))
    return hidden | inside[:, stops], jnp.where(hidden, u, place[:, stops]), height
