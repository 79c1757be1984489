"""Motions of many lanes through changes of contact that are known, and their derivatives.

Where the march looks for the next change of contact, here the times of all are given, to first
order: what is missing to them is part of the answer. Lanes are the trailing axis, as in the march.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from vibrojax.steady.contact_times import Events
from vibrojax.stepping.contact_loop import ContactLoop
from vibrojax.stepping.contact_phases import spread
from vibrojax.stepping.elementary import computed_once, matrix_product, pick
from vibrojax.stepping.turns import product, turn_over, turned

lax = jax.lax

Blocks = Float[Array, "2 blocks lanes"]
Times = Float[Array, "events lanes"]
Phase = Int[Array, " lanes"]


class Peak(NamedTuple):
    """Nearest that a stop gets to a change of contact that does not happen."""

    height: Float[Array, " lanes"]
    """What would have to pass zero, m; negative where contact stays as it is."""
    row: Float[Array, "states lanes"]
    """Its derivatives, by what those of the passage are."""
    bend: Float[Array, " lanes"]
    """Second derivative by the drive angle, m."""


class Passage(NamedTuple):
    """Ends of lanes, and their derivatives by the beginnings."""

    blocks: Float[Array, "2 blocks lanes"]
    phase: Int[Array, " lanes"]
    late: Float[Array, "events lanes"]
    """Drive angle, rad, by which the changes of contact are later than was said."""
    matrix: Float[Array, "2 blocks states lanes"]
    """Derivatives of `blocks`, the change of the times included: by those at the beginning, or by
    what these were said to change with."""
    delays: Float[Array, "events states lanes"]
    """Derivatives of the times of the changes, rad."""
    peak: Peak | None
    """None where no event is one."""


class KnownContacts:
    """Lanes at their drive frequencies that change contacts in a known order.

    The event number `peak` of a lane (-1: none) changes no contact: there a stop comes nearest to a
    change. Blocks in resonance with the drive are only moved as they should where it is said that
    there may be any.
    """

    def __init__(
        self,
        loop: ContactLoop,
        events: Events,
        peak: Int[Array, " lanes"] | None = None,
        *,
        resonant: bool = False,
    ):
        self.loop, self.events, self.peak, self.resonant = loop, events, peak, resonant
        phases, lanes = loop.phases, loop.lanes
        every, stops = np.arange(loop.count)[:, None], np.arange(loop.stops)
        # By how much velocities jump, per depth: where the force does, by damping times rate.
        jumps = (every >> stops & 1 == 0) | np.asarray(phases.can_pull, bool)
        damping = spread(phases.damping, 1, lanes) * jumps.reshape(*jumps.shape, *(1,) * lanes)
        after = spread(phases.from_state, 3, lanes)[every ^ (1 << stops)]
        push_off = jnp.moveaxis(spread(phases.push_off, 2, lanes), 1, 0)
        kick = jnp.sum(after * push_off[:, None], axis=3)
        self.kick = -damping[:, :, None] * kick
        """Phases, stops, states, lanes."""

    def go_through(
        self,
        blocks: Blocks,
        times: Times,
        until: Float[Array, " lanes"],
        rates: Float[Array, "2 blocks states lanes"] | None = None,
    ) -> Passage:
        """Go from the section through the changes before a drive angle (rad), and to it.

        `rates` of the blocks at the beginning are by what derivatives are wanted by; without any
        they are by the blocks themselves.
        """
        loop, events = self.loop, self.events
        room, states = len(times), 2 * loop.n
        used = (events.stop >= 0) & (times < until)

        def segment(j: Array, carry: tuple[Any, ...]) -> tuple[Any, ...]:
            once = lambda f: computed_once(j, f)  # noqa: E731
            blocks, phase, begun, late, matrix, delays, peak = carry
            k = jnp.minimum(j, room - 1)
            changes = used[k] & (j < room)
            angle = jnp.where(changes, times[k], until)
            decay, rate = pick(phase, loop.exponent), pick(phase, loop.rate)
            turn = once(lambda: turn_over(decay, rate, (angle - begun) / self.frequency))
            since, started = (angle - begun) / self.frequency, begun / self.frequency
            moved = once(lambda: turned(turn, blocks))
            blocks = loop.pushed(moved, phase, started, since) if self.resonant else moved
            fixed = jax.tree.map(lambda a: lax.stop_gradient(a)[:, None], turn)
            matrix = once(lambda: turned(fixed, matrix))
            if loop.outlook is None:
                return blocks, phase, angle, late, matrix, delays, peak
            stop = jnp.maximum(events.stop[k], 0)
            time = angle / self.frequency
            nearest = changes if peak is None else changes & (k == self.peak)
            signal, rows = once(lambda: self.read(blocks, phase, stop, time, nearest))
            rates = lax.stop_gradient(signal) / self.frequency
            seen = [
                once(lambda row=row: product(row.reshape(2, loop.n, 1, -1), matrix)) for row in rows
            ]
            (value, slope), read = (signal[0], rates[1]), seen[0]
            flips = changes
            if peak is not None:
                # Where a stop comes nearest its rate is zero, not its depth.
                flips = changes & ~nearest
                bend = rates[2] / self.frequency
                here = Peak(signal[0], seen[0], bend)
                peak = jax.tree.map(lambda a, b: jnp.where(nearest, a, b), here, peak)
                value = jnp.where(nearest, signal[1] / self.frequency, value)
                slope = jnp.where(nearest, bend, slope)
                late_row = jnp.where(nearest, seen[1] / self.frequency, read)
            else:
                late_row = read
            slope = jnp.where(slope == 0, 1.0, slope)
            kick = pick(stop, pick(phase, self.kick))

            def changed() -> tuple[Array, Array]:
                after = loop.change_phase(blocks, phase, stop, time).reshape(states, -1)
                table = spread(loop.phases.change, 4, loop.lanes)
                pushed = matrix_product(
                    pick(stop, pick(phase, table)), matrix.reshape(states, states, -1)
                )
                pushed = pushed + kick[:, None] * read
                after = (after + kick * signal[0]).reshape(blocks.shape)
                return after, pushed.reshape(matrix.shape)

            after, pushed = once(changed)
            keep = lambda new, old: jnp.where(changes, new, old)  # noqa: E731
            flip = lambda new, old: jnp.where(flips, new, old)  # noqa: E731
            return (
                flip(after, blocks),
                flip(phase ^ loop.phase_of(loop.numbers == stop), phase),
                angle,
                late.at[k].set(keep(-value / slope, late[k])),
                flip(pushed, matrix),
                delays.at[k].set(keep(-late_row / slope, delays[k])),
                peak,
            )

        lanes = until.shape
        phase = jnp.broadcast_to(events.first_phase, lanes)
        if rates is None:
            rates = jnp.eye(states).reshape(2, loop.n, states, 1) + jnp.zeros(lanes)
        delays = jnp.zeros((room, states, *lanes))
        none = jnp.zeros(lanes)
        peak = None if self.peak is None else Peak(none, jnp.zeros((states, *lanes)), none)
        begin = blocks, phase, events.section, jnp.zeros((room, *lanes)), rates, delays, peak
        most = jnp.max(jnp.sum(used, axis=0), initial=0)
        end, phase, _, late, matrix, delays, peak = lax.fori_loop(0, most + 1, segment, begin)
        return Passage(end, phase, late, matrix, delays, peak)

    def go_to(
        self, blocks: Blocks, times: Times, until: Float[Array, " lanes"]
    ) -> tuple[Blocks, Phase]:
        """Go through the changes before a drive angle as they are given, none a peak."""
        loop, events, room = self.loop, self.events, len(times)
        used = (events.stop >= 0) & (times < until)

        def segment(j: Array, carry: tuple[Any, ...]) -> tuple[Any, ...]:
            blocks, phase, begun = carry
            k = jnp.minimum(j, room - 1)
            changes = used[k] & (j < room)
            angle = jnp.where(changes, times[k], until)
            decay, rate = pick(phase, loop.exponent), pick(phase, loop.rate)
            since, started = (angle - begun) / self.frequency, begun / self.frequency
            moved = turned(turn_over(decay, rate, since), blocks)
            blocks = loop.pushed(moved, phase, started, since) if self.resonant else moved
            if loop.outlook is None:
                return blocks, phase, angle
            stop = jnp.maximum(events.stop[k], 0)
            after = loop.change_phase(blocks, phase, stop, angle / self.frequency)
            flipped = phase ^ loop.phase_of(loop.numbers == stop)
            keep = lambda new, old: jnp.where(changes, new, old)  # noqa: E731
            return keep(after, blocks), keep(flipped, phase), angle

        phase = jnp.broadcast_to(events.first_phase, until.shape)
        most = jnp.max(jnp.sum(used, axis=0), initial=0)
        begin = blocks, phase, events.section
        blocks, phase, _ = lax.fori_loop(0, most + 1, segment, begin)
        return blocks, phase

    @property
    def frequency(self) -> Float[Array, " lanes"]:
        """Drive frequency, rad/s."""
        return self.loop.force.angular_frequency

    def read(
        self, blocks: Blocks, phase: Phase, stop: Array, time: Array, nearest: Array
    ) -> tuple[Array, list[Array]]:
        """What passes zero where a stop changes its contact, its rate and acceleration.

        Also the rows that read it, and its rate if there are peaks: lanes that are `nearest`.
        """
        outlook = self.loop.outlook
        assert outlook is not None
        touching = self.loop.touching(phase)
        table, rest = outlook.signed(phase)
        read = outlook.read(blocks, self.loop.phasor(time), table, rest)
        kinds = range(1 if self.peak is None else 2)
        rows = [table[:, :-1, kind].reshape(-1, *read.shape[1:]) for kind in kinds]
        every = jnp.concatenate([read, *rows])
        if self.peak is not None and not outlook.pulls:
            # Nearest to a touch is where the depth is largest, nearest to a release the push.
            depth, push = jnp.split(every, 2, axis=1)
            furthest = jnp.where(touching, push, depth)
            every = jnp.where(nearest, furthest, outlook.breach(touching, every))
        else:
            every = outlook.breach(touching, every)
        chosen = pick(stop, jnp.moveaxis(every, 1, 0))
        parts = jnp.split(lax.stop_gradient(chosen[3:]), len(rows))
        return chosen[:3], parts
