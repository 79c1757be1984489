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
from vibrojax.stepping.elementary import apply_matrix, computed_once, pick
from vibrojax.stepping.turns import product, turn_over, turned

lax = jax.lax

Blocks = Float[Array, "2 blocks lanes"]
Times = Float[Array, "events lanes"]


class Passage(NamedTuple):
    """Where lanes come to, and how that depends on where they begin."""

    blocks: Float[Array, "2 blocks lanes"]
    phase: Int[Array, " lanes"]
    late: Float[Array, "events lanes"]
    """Drive angle, rad, by which the changes of contact are later than was said."""
    matrix: Float[Array, "2 blocks states lanes"]
    """Derivatives of `blocks` by those at the beginning, the change of the times included."""
    delays: Float[Array, "events states lanes"]
    """Derivatives of the times of the changes, rad."""


class KnownContacts:
    """Lanes at their drive frequencies that change contacts in a known order."""

    def __init__(self, loop: ContactLoop, events: Events):
        self.loop, self.events = loop, events
        phases, lanes = loop.phases, loop.lanes
        count, stops, n = loop.count, loop.stops, loop.n
        kicks = np.zeros((count, stops)).tolist()
        for p, s in np.ndindex(count, stops):
            # By how much velocities jump, per depth: where the force does, by damping times rate.
            jumps = p >> s & 1 == 0 or phases.can_pull[s]
            push_off = spread(phases.push_off, 2, lanes)[:, s]
            damping = spread(phases.damping, 1, lanes)[s] * float(jumps)
            kicks[p][s] = -damping * apply_matrix(phases.from_state[p ^ (1 << s)][:, n:], push_off)
        self.kick: Any = jnp.asarray(kicks) if stops else None
        """Phases, stops, states, lanes."""

    def go_through(self, blocks: Blocks, times: Times, until: Float[Array, " lanes"]) -> Passage:
        """Go from the section through the changes before a drive angle (rad), and to it."""
        loop, events = self.loop, self.events
        room, states = len(times), 2 * loop.n
        used = (events.stop >= 0) & (times < until)

        def segment(j: Array, carry: tuple[Any, ...]) -> tuple[Any, ...]:
            once = lambda f: computed_once(j, f)  # noqa: E731
            blocks, phase, begun, late, matrix, delays = carry
            k = jnp.minimum(j, room - 1)
            changes = used[k] & (j < room)
            angle = jnp.where(changes, times[k], until)
            decay, rate = pick(phase, loop.exponent), pick(phase, loop.rate)
            turn = once(lambda: turn_over(decay, rate, (angle - begun) / self.frequency))
            blocks = once(lambda: turned(turn, blocks))
            fixed = lax.stop_gradient(turn)[:, :, None]
            matrix = once(lambda: turned(fixed, matrix))
            if loop.outlook is None:
                return blocks, phase, angle, late, matrix, delays
            stop = jnp.maximum(events.stop[k], 0)
            time = angle / self.frequency
            value, slope, row = once(lambda: self.read(blocks, phase, stop, time))
            slope = lax.stop_gradient(jnp.where(slope == 0, 1.0, slope / self.frequency))
            read = once(lambda: product(row.reshape(2, loop.n, 1, -1), matrix))
            kick = pick(stop, pick(phase, self.kick))

            def changed() -> tuple[Array, Array]:
                after = loop.change_phase(blocks, phase, stop, time).reshape(states, -1)
                table = spread(loop.phases.change, 4, loop.lanes)
                table = jnp.moveaxis(pick(stop, pick(phase, table)), 1, 0)
                table = table.reshape(2, loop.n, states, 1, -1)
                pushed = product(table, matrix[:, :, None]) + kick[:, None] * read
                after = (after + kick * value).reshape(blocks.shape)
                return after, pushed.reshape(matrix.shape)

            after, pushed = once(changed)
            keep = lambda new, old: jnp.where(changes, new, old)  # noqa: E731
            return (
                keep(after, blocks),
                keep(phase ^ loop.phase_of(loop.numbers == stop), phase),
                angle,
                late.at[k].set(keep(-value / slope, late[k])),
                keep(pushed, matrix),
                delays.at[k].set(keep(-read / slope, delays[k])),
            )

        lanes = until.shape
        phase = jnp.broadcast_to(events.first_phase, lanes)
        matrix = jnp.eye(states).reshape(2, loop.n, states, 1) + jnp.zeros(lanes)
        delays = jnp.zeros((room, states, *lanes))
        begin = blocks, phase, events.section, jnp.zeros((room, *lanes)), matrix, delays
        most = jnp.max(jnp.sum(used, axis=0), initial=0)
        end, phase, _, late, matrix, delays = lax.fori_loop(0, most + 1, segment, begin)
        return Passage(end, phase, late, matrix, delays)

    @property
    def frequency(self) -> Float[Array, " lanes"]:
        """Drive frequency, rad/s."""
        return self.loop.force.angular_frequency

    def read(
        self, blocks: Blocks, phase: Int[Array, " lanes"], stop: Array, time: Array
    ) -> tuple[Array, Array, Array]:
        """What passes zero where a stop changes its contact, its rate, the row that reads it."""
        outlook = self.loop.outlook
        assert outlook is not None
        touching = self.loop.touching(phase)
        read = outlook.read(blocks, phase, touching, self.loop.phasor(time))
        rows, _ = outlook.signed(phase, touching)
        rows = rows[:, :-1, 0].reshape(-1, *read.shape[1:])
        both = outlook.breach(touching, jnp.concatenate([read[:2], rows]))
        chosen = pick(stop, jnp.moveaxis(both, 1, 0))
        return chosen[0], chosen[1], lax.stop_gradient(chosen[2:])
