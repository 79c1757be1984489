"""Exact periodic motions along a curve: Newton's method under one condition more.

The unknowns are the state at the section, the times of the changes of contact and the number that
is followed. The condition says which motion of the curve is meant: the one at a value, so far along
the curve, with a contact of so long, or that which just touches a stop.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from vibrojax.steady.contact_times import Events
from vibrojax.steady.known_contacts import KnownContacts, Passage
from vibrojax.steady.paths import LocalPath
from vibrojax.stepping.contact_loop import ContactLoop
from vibrojax.stepping.elementary import pick
from vibrojax.stepping.forcing import forcing

lax = jax.lax

ROOM = 128
"""Changes of contact of a motion: room for 64 contacts."""
ROUNDS = 16
"""Of Newton's method at the most."""
ROUND_OFF = 1e-11
SHORTENED = 0.7
"""Most that a phase of contact becomes shorter in a step of it, over its length."""
FARTHEST = 0.5
"""Longest step of Newton's method, over the size of the motion."""
TURN = 2 * np.pi

Lane = Float[Array, "*lanes"]
Number = Float[ArrayLike, "*lanes"]
States = Float[Array, "states *lanes"]
Times = Float[Array, "events *lanes"]


class Condition(NamedTuple):
    """What a motion of a curve has to fulfil: a sum over all unknowns has a value."""

    state: States
    times: Times
    parameter: Lane
    height: Lane
    """Factor of the distance of the peak's stop from a change of contact, m."""
    value: Lane


class Stride(NamedTuple):
    """How to go on behind a motion that lies a step along the curve behind another one."""

    size: Number
    """Size of the state of the one before, as a length."""
    step: Number
    """Arclength from there."""
    longest: Number
    low: Number
    """The parameter's range."""
    high: Number
    most: Int[ArrayLike, "*lanes"]
    """How many motions are wanted; more than one only of a program of one lane."""


class Try(NamedTuple):
    """A guess of a motion, and what it is to become."""

    events: Events
    state: States
    """At the section, times `unit`."""
    times: Times
    """Drive phases of the events, rad."""
    parameter: Lane
    unit: States
    """What makes the state's coordinates comparable."""
    scale: Lane
    """Change of the parameter that counts as much as the state changing by its size."""
    peak: Int[Array, "*lanes"]
    """Number of the event at which a stop comes nearest to a change of contact; -1 for none."""
    condition: Condition
    stride: Stride


class Motion(NamedTuple):
    """What Newton's method finds."""

    state: States
    times: Times
    parameter: Lane
    error: Lane
    """Last correction, relative."""
    rounds: Int[Array, "*lanes"]
    state_along: States
    """Change along the curve, per unit of its arclength; the way in which the condition grows."""
    times_along: Times
    parameter_along: Lane
    matrix: Float[Array, "states states *lanes"]
    """Jacobian of the period map at the section."""
    height_along: Lane
    """Along the curve, of what would have to pass zero at the peak, m."""
    bend: Lane
    """Its second derivative by the drive angle, m."""


class Rigs:
    """Rigs with the events of their motions, at values of the number followed."""

    def __init__(self, path: LocalPath, tries: Try, period: int):
        self.path, self.tries, self.until = path, tries, tries.events.section + TURN * period

    def loop(self, parameter: Lane) -> ContactLoop:
        """The rigs under their drives."""
        return ContactLoop(*self.tables(parameter))

    def tables(self, parameter: Lane, start_phase: ArrayLike = 0.0) -> tuple[Any, Any]:
        """Phases and tables of the drive from a drive phase (rad) on."""
        place, phases = self.path.at(parameter), self.path.phases_at(parameter)
        w = place.angular_frequency
        amplitude = place.drive.complex_amplitude(w, jnp.zeros_like(w))
        return phases, forcing(phases, amplitude, w, jnp.zeros_like(w) + start_phase)

    def contacts(self, loop: ContactLoop) -> KnownContacts:
        """The same with the events."""
        tries = self.tries
        return KnownContacts(loop, tries.events, tries.peak, resonant=self.path.resonant)

    def begin(self, at: KnownContacts, state: States) -> Array:
        """Block coordinates of a state at the section."""
        events, time = self.tries.events, self.tries.events.section / at.frequency
        return at.loop.blocks_of(state / self.tries.unit, events.first_phase, time)

    def state(self, at: KnownContacts, blocks: Array, phase: Array, angle: Array) -> Array:
        """State, times `unit`, of block coordinates at a drive phase (rad)."""
        return self.tries.unit * at.loop.state_of(blocks, phase, angle / at.frequency)

    def passed(self, parameter: Lane, state: States, times: Times) -> "_Passed":
        """End of the motion after its period, and its derivatives by all unknowns."""
        first, unit = self.tries.events.first_phase, self.tries.unit

        def image(parameter: Lane) -> tuple[Any, tuple[Passage, Array]]:
            at = self.contacts(self.loop(parameter))
            phases, begin = at.loop.phases, self.begin(at, state)
            into = lax.stop_gradient(pick(first, phases.from_state)) / unit
            rates = into.reshape(2, at.loop.n, *into.shape[1:])
            gone = at.go_through(begin, times, self.until, rates)
            end = self.state(at, gone.blocks, gone.phase, self.until)
            assert gone.peak is not None
            return (end, gone.late, gone.peak.height), (gone, pick(first, phases.to_state))

        (end, late, height), push, (gone, out) = jax.jvp(
            image, (parameter,), (jnp.ones_like(parameter),), has_aux=True
        )
        matrix = _times(unit[:, None] * out, gone.matrix.reshape(out.shape))
        assert gone.peak is not None
        peak = gone.peak
        return _Passed(end, late, height, push, matrix, gone.delays, peak.row, peak.bend)


class _Passed(NamedTuple):
    end: States
    late: Times
    height: Lane
    by_parameter: tuple[States, Times, Lane]
    matrix: Array
    delays: Array
    height_row: Array
    bend: Lane


def _times(
    left: Float[Array, "rows inner lanes"], right: Float[Array, "inner columns lanes"]
) -> Float[Array, "rows columns lanes"]:
    return jnp.einsum("ijl,jkl->ikl", left, right)


class _Search(NamedTuple):
    state: States
    times: Times
    parameter: Lane
    error: Lane
    rounds: Int[Array, " lanes"]
    going: Bool[Array, " lanes"]


def _newton(rigs: Rigs, search: _Search) -> tuple[_Search, Motion]:
    """One round of Newton's method; and what is known where it began."""
    tries = rigs.tries
    now = rigs.passed(search.parameter, search.state, search.times)
    used = tries.events.stop >= 0
    late = jnp.where(used, now.late, 0.0)
    push, late_push, height_push = now.by_parameter
    late_push = jnp.where(used, late_push, 0.0)
    ask, n = tries.condition, len(search.state)
    # The times follow from the state and the parameter: they are put into the condition.
    row = ask.state + jnp.einsum("kl,kil->il", ask.times, now.delays)
    row = row + ask.height * now.height_row
    last = ask.parameter + jnp.sum(ask.times * late_push, axis=0) + ask.height * height_push
    missing = ask.value - jnp.sum(ask.state * search.state, axis=0)
    missing = missing - jnp.sum(ask.times * (search.times + late), axis=0)
    missing = missing - ask.parameter * search.parameter - ask.height * now.height
    size = jnp.sqrt(jnp.sum(search.state**2, axis=0))
    size = jnp.where(size > 0, size, 1.0)
    whole = jnp.concatenate(
        [
            jnp.concatenate([now.matrix - jnp.eye(n)[..., None], push[:, None]], axis=1),
            jnp.concatenate([row, last[None]])[None],
        ]
    )
    # Rows and columns of like size.
    columns = jnp.concatenate([jnp.broadcast_to(size, (n, *size.shape)), tries.scale[None]])
    whole = whole * columns
    length = jnp.max(jnp.abs(whole), axis=1, keepdims=True)
    length = jnp.where(length > 0, length, 1.0)
    unit = jnp.zeros((n + 1, *size.shape)).at[-1].set(1.0)
    right = jnp.stack([jnp.concatenate([search.state - now.end, missing[None]]), unit], axis=1)
    solved = jnp.linalg.solve(
        jnp.moveaxis(whole / length, -1, 0), jnp.moveaxis(right / length, -1, 0)
    )
    change, along = jnp.moveaxis(solved, (0, 1, 2), (2, 1, 0))
    along = along / jnp.sqrt(jnp.sum(along**2, axis=0))

    def parts(step: Array) -> tuple[Array, Array, Array]:
        state, parameter = step[:-1] * size, step[-1] * tries.scale
        times = jnp.einsum("kil,il->kl", now.delays, state) + late_push * parameter
        return state, jnp.where(used, times, 0.0), parameter

    far = jnp.sqrt(jnp.sum(change**2, axis=0))
    limit = jnp.where(jnp.any(used, axis=0), FARTHEST, jnp.inf)
    moved, delays, shift = parts(change)
    delays = late + delays
    # No phase becomes much shorter in one round: far away the whole step is taken in part.
    none = jnp.zeros_like(last)[None]
    ends = jnp.concatenate([tries.events.section[None], search.times, rigs.until[None]])
    lengths, shorter = (
        jnp.diff(ends, axis=0),
        -jnp.diff(jnp.concatenate([none, delays, none]), axis=0),
    )
    part = jnp.where(shorter > 0, SHORTENED * lengths / jnp.where(shorter > 0, shorter, 1.0), 1.0)
    part = jnp.minimum(limit / jnp.where(far > 0, far, 1.0), jnp.min(part, axis=0, initial=1.0))
    part = jnp.minimum(part, 1.0)
    moved, delays, shift = part * moved, part * delays, part * shift
    error = jnp.maximum(far, jnp.max(jnp.abs(delays), axis=0, initial=0.0) / part)
    shrinks = (search.rounds < 4) | (error < search.error / 2) | (part < 1.0)
    good = jnp.isfinite(error) & search.going
    takes = good & (shrinks | (error < 1e-8))
    state_along, times_along, parameter_along = parts(along)
    motion = Motion(
        state=jnp.where(takes, search.state + moved, search.state),
        times=jnp.where(takes & used, search.times + delays, search.times),
        parameter=jnp.where(takes, search.parameter + shift, search.parameter),
        error=jnp.where(jnp.isfinite(error), error, jnp.inf),
        rounds=search.rounds + search.going,
        state_along=state_along,
        times_along=times_along,
        parameter_along=parameter_along,
        matrix=now.matrix,
        height_along=jnp.sum(now.height_row * state_along, axis=0) + height_push * parameter_along,
        bend=now.bend,
    )
    going = takes & shrinks & (error > ROUND_OFF) & (search.rounds + 1 < ROUNDS)
    return _Search(
        motion.state, motion.times, motion.parameter, motion.error, motion.rounds, going
    ), motion


def nothing_found(ask: Try) -> Motion:
    """Where Newton's method starts."""
    n, none = len(ask.state), jnp.zeros_like(ask.parameter)
    return Motion(
        ask.state,
        ask.times,
        ask.parameter,
        error=none + jnp.inf,
        rounds=jnp.zeros(none.shape, jnp.int32),
        state_along=0 * ask.state,
        times_along=0 * ask.times,
        parameter_along=none,
        matrix=jnp.zeros((n, n, *none.shape)),
        height_along=none,
        bend=none,
    )


def solved(path: LocalPath, ask: Try, period: int) -> Motion:
    """Newton's method."""
    own, nothing = Rigs(path, ask, period), nothing_found(ask)
    first = _Search(*nothing[:5], jnp.ones(nothing.error.shape, bool))

    def better(carry: tuple[_Search, Motion]) -> tuple[_Search, Motion]:
        search, before = carry
        after, motion = _newton(own, search)
        keep = lambda new, old: jnp.where(search.going, new, old)  # noqa: E731
        return after, jax.tree.map(keep, motion, before)

    return lax.while_loop(lambda carry: jnp.any(carry[0].going), better, (first, nothing))[1]
