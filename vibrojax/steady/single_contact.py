"""Periodic motions with one contact per drive period, in closed form.

With one linear stop the motion is linear in flight and linear in contact. For a given time of
contact and a given drive frequency nothing has to be searched: the conditions that the motion
returns, that it touches and that it leaves at depth zero are linear and homogeneous in the state,
the drive (amplitude times cosine and sine of its phase at touch) and the gap. They are one fewer
than the unknowns, so that they leave one motion but for its size: one value of gap over drive
amplitude, one phase and one state, or none. That value as a function of contact time and frequency
holds the response for every gap and every amplitude; where it does not change with the contact
time the response has a fold. Solving for state, drive and gap together stays well conditioned
there, unlike solving for the state at a given drive, whose matrix I - P is singular at a fold.

Stability is that of the period map with its saltation (the jump of the damping force at touch and
departure). The closed form between contact times goes back to Shaw and Holmes 1983, for one mass.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from vibrojax._tools.eigenvalues import eigenvalues
from vibrojax._tools.trigonometry import cosine_and_sine, sine
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import AbstractEquations, LinearEquations
from vibrojax.model.laws import can_pull, is_linear
from vibrojax.steady.contact_times import (
    Events,
    PiecewiseMotion,
    Tables,
    forced,
    moved_on,
    tables_of,
)
from vibrojax.steady.orbit_reading import BREACH, Reading, read_motion
from vibrojax.stepping.contact_phases import ContactPhases, contact_phases

Scalar = Float[Array, ""]
State = Float[Array, " states"]

lax = jax.lax
FLIGHT, CONTACT = 0, 1
DEPTH, RATE, RESPONSE = 0, 1, 3
"""Rows of `ContactPhases.readout` with one stop."""


class SingleContact(NamedTuple):
    """A motion with one contact per drive period, per unit of drive amplitude.

    The unit of a length is that of the reported ratios, m/m for base motion, m/N for a force.
    """

    contact_fraction: Scalar
    """Share of the drive period in contact."""
    gap_ratio: Scalar
    """Gap over drive amplitude at which this is the motion; negative where the stop would have to
    be pressed on at rest."""
    touch: Scalar
    """Drive phase at touch, rad, in (-pi, pi]."""
    state: State
    """(q, q') at touch."""
    touch_rate: Scalar
    """Speed into the stop at touch."""
    departure_rate: Scalar
    """Speed into the stop at departure, negative in a motion that leaves."""
    in_contact: State
    """Block coordinates of the free part of the motion, at touch, in contact."""
    in_flight: State
    """The same at departure, in flight."""


def check_single_stop(equations: AbstractEquations) -> LinearEquations:
    """Return the equations if their motions with one contact have a closed form.

    Raises `ValueError` unless they are linear with one linear stop, a `KelvinVoigt` that may pull
    (tension=True) or one that relaxes, and it is not smoothed.
    """
    linear, stops = equations.linear_between_contacts, equations.stops
    law = type(stops[0].law).__name__ if stops else ""
    if linear is None:
        kind = type(equations).__name__
        fault = f"need a system that is linear between contacts, got {kind}."
    elif len(stops) != 1:
        fault = f"need a system with one stop, got {len(stops)}."
    elif not is_linear(stops[0].law):
        fault = f"need a contact law that is linear (KelvinVoigt), got {law}."
    elif not can_pull(stops[0].law):
        fault = (
            f"need a stop that is left at depth zero, got {law} with tension=False. Give it "
            "tension=True, or use frequency_sweep."
        )
    elif linear.load is not None:
        fault = "need a system without a constant force. Use continue_response."
    elif not stops[0].is_linear:
        fault = (
            f"keep the corner of the contact force, got smoothing = {stops[0].smoothing!r}. Leave "
            "smoothing out of the Stop."
        )
    else:
        return linear
    raise ValueError(f"Single-contact motions {fault}")


def unit_phases(equations: LinearEquations) -> ContactPhases:
    """Compute the phases of one lane with one stop, its gap replaced by 1."""
    one = jnp.ones((), equations.angular_frequency.dtype)
    return contact_phases(eqx.tree_at(lambda e: e.stops[0].gap, equations, one))


def unit_tables(
    phases: ContactPhases, drive: AbstractDrive, angular_frequency: Scalar, *, resonant: bool = True
) -> Tables:
    """Tabulate the steady responses to a drive of amplitude 1; `phases` as of `unit_phases`."""
    amplitude, _ = drive.reference
    tables = tables_of(phases, drive, angular_frequency, resonant=resonant)
    return tables._replace(
        **jax.tree.map(
            lambda table: table / amplitude,
            {"steady": tables.steady, "driven": tables.driven, "rows": tables.rows},
        )
    )


def contact_free(tables: Tables, row: int) -> Scalar:
    """Amplitude without contact that a row of the read-out sees; infinite at a resonance.

    That of `DEPTH` is the gap ratio at which this motion just touches: the limit of
    `SingleContact.gap_ratio` for short contacts.
    """
    phases, n = tables.phases, tables.phases.num_blocks
    if tables.driven is None:
        return jnp.abs(tables.rows[FLIGHT, row])
    left, right = phases.readout[FLIGHT, row, :n], phases.readout[FLIGHT, row, n:]
    top, bottom = tables.driven[FLIGHT, :n], tables.driven[FLIGHT, n:]
    along = 1j * tables.angular_frequency - phases.exponent[FLIGHT, 0]
    determinant = along**2 + phases.rate[FLIGHT] ** 2
    seen = left * (along * top - phases.rate[FLIGHT] * bottom)
    seen = seen + right * (phases.rate[FLIGHT] * top + along * bottom)
    endless = (determinant == 0) & (seen != 0)
    resonant = jnp.sum(seen / jnp.where(determinant == 0, 1.0, determinant))
    return jnp.where(jnp.any(endless), jnp.inf, jnp.abs(tables.rows[FLIGHT, row] + resonant))


def growth(phases: ContactPhases, phase: int, time: Scalar) -> Float[Array, "states states"]:
    """Return the propagator of the blocks over a time less the identity, exact for short ones."""
    decay, turn = phases.exponent[phase] * time, phases.rate[phase] * time
    growth = jnp.exp(decay)
    # Real pairs have rate 0, each row its own exponent.
    real = jnp.expm1(decay) - 2 * growth * sine(turn / 2) ** 2
    imag = growth * sine(turn)
    (a, b), (c, d) = ([jnp.diag(row) for row in part] for part in (real, imag))
    return jnp.block([[a, -c], [d, b]])


def durations(tables: Tables, contact_fraction):
    """Drive angle of the contact, time in contact, and time in flight."""
    angle = 2 * np.pi * contact_fraction
    w = tables.angular_frequency
    return angle, angle / w, (2 * np.pi - angle) / w


def single_contact(tables: Tables, contact_fraction: Scalar) -> SingleContact:
    """Return the one motion with this share of the drive period in contact.

    There is never a second one: the conditions are linear, and which of the two motions that
    differ in sign it is follows from its being slowed down in contact. `read_single_contact` says
    whether it enters and leaves in that order, at a gap of 0 or more, and stays where it is said.
    `tables` as of `unit_tables`; `contact_fraction` in (0, 1).
    """
    phases = tables.phases
    angle, time, flight = durations(tables, contact_fraction)
    contact, eye = growth(phases, CONTACT, time), jnp.eye(2 * phases.num_blocks)
    grown, kept, mean = eye + contact, eye + growth(phases, FLIGHT, flight), contact / angle
    cos, sin = cosine_and_sine(angle)
    turned = lax.complex(cos, sin)
    mean_turn = lax.complex(-2 * sine(angle / 2) ** 2, sin) / angle

    # Free parts: z in contact at touch, y in flight at departure. The steady parts return.
    exchange = phases.change[CONTACT, 0]
    steady = exchange @ tables.steady[CONTACT] - tables.steady[FLIGHT]
    pressed = exchange @ phases.rest[CONTACT]
    by_state = exchange - kept @ (exchange @ grown)
    later = steady * turned
    # What blocks in resonance gain in contact and in flight, by the drive phase where it begins.
    gained, gained_later = _gain(tables, CONTACT, angle), _gain(tables, FLIGHT, 2 * np.pi - angle)
    later = later + exchange @ gained
    by_phasor = steady - kept @ later - gained_later * turned
    by_gap = pressed - kept @ pressed

    # Depth zero at touch; its mean rate in contact zero; the mean deceleration one.
    rows, steady_rows = phases.readout[CONTACT], tables.rows[CONTACT]
    last_rows = [rows[DEPTH], rows[DEPTH] @ mean, -rows[RATE] @ mean]
    last_phasors = [
        steady_rows[DEPTH],
        steady_rows[DEPTH] * mean_turn + rows[DEPTH] @ gained / angle,
        -steady_rows[RATE] * mean_turn - rows[RATE] @ gained / angle,
    ]
    last_gaps = phases.readout_rest[CONTACT, DEPTH] * jnp.array([1.0, 0.0, 0.0])
    phasor = jnp.concatenate([by_phasor, jnp.stack(last_phasors)])
    whole = jnp.concatenate(
        [
            jnp.concatenate([by_state, jnp.stack(last_rows)]),
            jnp.stack([phasor.imag, phasor.real, jnp.append(by_gap, last_gaps)], axis=1),
        ],
        axis=1,
    )

    row_unit, column_unit = _units(tables, whole)
    scaled = whole / row_unit[:, None] / column_unit
    target = jnp.zeros(whole.shape[0]).at[-1].set(1.0)
    solved = jnp.linalg.solve(scaled, target) / column_unit
    z, (c, s, gap) = solved[:-3], solved[-3:]
    amplitude = jnp.hypot(c, s)
    z, c, s, gap = z / amplitude, c / amplitude, s / amplitude, gap / amplitude

    def swung(table, c, s):
        return table.imag * c + table.real * s

    end_c, end_s = c * cos - s * sin, s * cos + c * sin
    blocks = z + swung(tables.steady[CONTACT], c, s) + phases.rest[CONTACT] * gap
    end = grown @ z + swung(gained, c, s)
    departed = exchange @ (end + swung(tables.steady[CONTACT], end_c, end_s)) + pressed * gap
    return SingleContact(
        contact_fraction=contact_fraction,
        gap_ratio=gap,
        touch=jnp.arctan2(s, c),
        state=phases.to_state[CONTACT] @ blocks,
        touch_rate=rows[RATE] @ z + swung(steady_rows[RATE], c, s),
        departure_rate=rows[RATE] @ end + swung(steady_rows[RATE], end_c, end_s),
        in_contact=z,
        in_flight=departed - swung(tables.steady[FLIGHT], end_c, end_s),
    )


def _gain(tables: Tables, phase: int, angle):
    """What the drive adds over an angle: Im(gain exp(i phase)), by the phase where it begins."""
    still = jnp.zeros(tables.steady.shape[1])
    if tables.driven is None:
        return lax.complex(still, still)
    quarter, start = (moved_on(tables, phase, still, begun, angle) for begun in (np.pi / 2, 0.0))
    return lax.complex(quarter, start)


def _units(tables: Tables, whole):
    """Units of rows and columns in which the blocks have like energies and all rows like size."""
    phases = lax.stop_gradient(tables.phases)
    weight = phases.weight[:, None]
    energy = jnp.sqrt(jnp.sum((weight * phases.to_state) ** 2, axis=1))
    whole = lax.stop_gradient(whole)
    states = energy.shape[1]
    row = jnp.concatenate([1 / energy[FLIGHT], jnp.ones(3)])
    column = jnp.concatenate([energy[CONTACT], jnp.ones(3)])
    scaled = whole / row[:, None] / column
    height = jnp.linalg.norm(scaled[:, :states], axis=1)
    row = row * jnp.where(jnp.arange(states + 3) < states, 1.0, height)
    scaled = whole / row[:, None] / column
    width = jnp.linalg.norm(scaled, axis=0)
    column = column * jnp.where(jnp.arange(states + 3) < states, 1.0, width)
    return row, column


def multipliers(tables: Tables, contact_fraction: Scalar) -> Complex[Array, " states"]:
    """Return the Floquet multipliers: those of the period map just before touch.

    They depend on the times of contact and flight only, not on the motion.
    """
    phases, n = tables.phases, tables.phases.num_blocks
    _, time, flight = durations(tables, contact_fraction)
    push = phases.damping[0] * jnp.outer(phases.push_off[:, 0], phases.towards_stop[0])
    matrix = jnp.eye(2 * n)
    for phase, duration, sign in ((CONTACT, time, -1.0), (FLIGHT, flight, 1.0)):
        # Saltation: the damping force jumps where the stop is touched and left.
        matrix = matrix + sign * push @ matrix
        moved = jnp.eye(2 * n) + growth(phases, phase, duration)
        matrix = phases.to_state[phase] @ moved @ phases.from_state[phase] @ matrix
    matrix = phases.weight[:, None] * matrix / phases.weight
    return eigenvalues(matrix)


def laid_out(tables: Tables, found: SingleContact) -> tuple[Tables, Events, PiecewiseMotion]:
    """Lay the motion out in time from the middle of its flight, with the tables at its own gap."""
    phases = tables.phases
    angle, _, _ = durations(tables, found.contact_fraction)
    half = np.pi - angle / 2
    section = jnp.mod(found.touch - half, 2 * np.pi)
    touch, last = section + half, section + 2 * np.pi
    departure = touch + angle
    middle = moved_on(tables, FLIGHT, found.in_flight, departure, last - departure)
    events = Events(jnp.zeros(2, jnp.int32), jnp.zeros((), jnp.int32), section)
    motion = PiecewiseMotion(
        end=phases.to_state[FLIGHT] @ (middle + forced(tables, FLIGHT, section)),
        times=jnp.stack([touch, departure]),
        phase=jnp.array([FLIGHT, CONTACT, FLIGHT], jnp.int32),
        blocks=jnp.stack([middle, found.in_contact, found.in_flight], axis=1),
        start=jnp.stack([section, touch, departure]),
        stop=jnp.stack([touch, departure, last]),
        jacobian=None,
    )

    def by_gap(p):
        return [p.rest, p.readout_rest, p.change_rest, p.gap]

    own = eqx.tree_at(by_gap, phases, [a * found.gap_ratio for a in by_gap(phases)])
    return tables._replace(phases=own), events, motion


def read_single_contact(tables: Tables, found: SingleContact) -> tuple[Reading, Bool[Array, ""]]:
    """Read the motion off, per unit of drive amplitude, and say whether it is a real one.

    A virtual motion enters the stop again in its flight, or leaves it during its contact.
    """
    own, events, motion = laid_out(tables, found)
    reading = read_motion(own, events, motion, 1)
    size = jnp.maximum(jnp.abs(found.gap_ratio), jnp.maximum(reading.highest, -reading.lowest))
    possible = (found.touch_rate > 0) & (found.departure_rate < 0) & (found.gap_ratio >= 0)
    return reading, possible & (reading.breach <= BREACH * size)
