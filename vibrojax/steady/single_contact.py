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

from vibrojax._tools.trigonometry import cosine
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import AbstractEquations, LinearEquations
from vibrojax.model.laws import can_pull, linear_coefficients
from vibrojax.steady.contact_times import Tables, moved_on, tables_of
from vibrojax.stepping.contact_phases import ContactPhases, contact_phases

lax = jax.lax
FLIGHT, CONTACT = 0, 1
DEPTH, RATE = 0, 1
"""Rows of `ContactPhases.readout` with one stop."""


class SingleContact(NamedTuple):
    """A motion with one contact per drive period, per unit of drive amplitude.

    The unit of a length is that of the reported ratios, m/m for base motion, m/N for a force.
    """

    contact_fraction: Float[Array, ""]
    """Share of the drive period in contact."""
    gap_ratio: Float[Array, ""]
    """Gap over drive amplitude at which this is the motion; negative where the stop would have to
    be pressed on at rest."""
    touch: Float[Array, ""]
    """Drive phase at touch, rad, in (-pi, pi]."""
    state: Float[Array, " states"]
    """(q, q') at touch."""
    touch_rate: Float[Array, ""]
    """Speed into the stop at touch."""
    departure_rate: Float[Array, ""]
    """Speed into the stop at departure, negative in a motion that leaves."""
    in_contact: Float[Array, " states"]
    """Block coordinates of the free part of the motion, at touch, in contact."""
    in_flight: Float[Array, " states"]
    """The same at departure, in flight."""

    @property
    def possible(self) -> Bool[Array, ""]:
        """Whether the motion enters and leaves the stop in that order, at a gap of 0 or more."""
        return (self.touch_rate > 0) & (self.departure_rate < 0) & (self.gap_ratio >= 0)


def check_single_stop(equations: AbstractEquations) -> LinearEquations:
    """Return the equations if their motions with one contact have a closed form.

    Raises `ValueError` unless they are linear with one `KelvinVoigt` stop that may pull
    (tension=True) and is not smoothed.
    """
    linear = equations.linear_between_contacts
    if linear is None:
        raise ValueError(
            "Single-contact motions need a system that is linear between contacts, got "
            f"{type(equations).__name__}."
        )
    if len(equations.stops) != 1:
        raise ValueError(
            f"Single-contact motions need a system with one stop, got {len(equations.stops)}."
        )
    (stop,) = equations.stops
    name = type(stop.law).__name__
    if linear_coefficients(stop.law) is None:
        raise ValueError(
            f"Single-contact motions need a contact law that is linear (KelvinVoigt), got {name}."
        )
    if not can_pull(stop.law):
        raise ValueError(
            f"Single-contact motions need a stop that is left at depth zero, got {name} with "
            "tension=False. Give it tension=True, or use frequency_sweep."
        )
    if not stop.is_linear:
        raise ValueError(
            f"Single-contact motions keep the corner of the contact force, got smoothing = "
            f"{stop.smoothing!r}. Leave smoothing out of the Stop."
        )
    return linear


def unit_phases(equations: LinearEquations) -> ContactPhases:
    """Compute the phases of one lane with one stop, its gap replaced by 1."""
    one = jnp.ones((), equations.angular_frequency.dtype)
    return contact_phases(eqx.tree_at(lambda e: e.stops[0].gap, equations, one))


def unit_tables(
    phases: ContactPhases,
    drive: AbstractDrive,
    angular_frequency: Float[Array, ""],
    *,
    resonant: bool = True,
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


def touch_gap_ratio(tables: Tables) -> Float[Array, ""]:
    """Gap over drive amplitude at which the motion without contact just touches.

    The limit of `SingleContact.gap_ratio` for short contacts.
    """
    return _contact_free(tables, DEPTH)


def contact_free_amplitude(tables: Tables) -> Float[Array, ""]:
    """Reported displacement of the motion without contact, over the drive amplitude."""
    return _contact_free(tables, 3 * tables.phases.num_stops)


def _contact_free(tables: Tables, row: int) -> Float[Array, ""]:
    """Amplitude that a row of the read-out sees without contact; infinite at a resonance."""
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


def growth(phases: ContactPhases, phase: int, time: Float[Array, ""]):
    """Real and imaginary parts of exp(exponent time) - 1, by row of the blocks: (2, blocks) each.

    Without cancellation for short times. Real pairs have rate 0, each row its own exponent.
    """
    decay, turn = phases.exponent[phase] * time, phases.rate[phase] * time
    growth = jnp.exp(decay)
    half_sine = cosine(turn / 2 - np.pi / 2)
    real = jnp.expm1(decay) - 2 * growth * half_sine**2
    return real, growth * cosine(turn - np.pi / 2)


def apply_blocks(parts, matrix):
    """Block matrix times a vector or matrix of block coordinates."""
    real, imag = parts
    if matrix.ndim == 2:
        real, imag = real[..., None], imag[..., None]
    top, bottom = jnp.split(matrix, 2)
    return jnp.concatenate([real[0] * top - imag[0] * bottom, imag[1] * top + real[1] * bottom])


def _right(matrix, parts):
    """Row vector or matrix times a block matrix."""
    real, imag = parts
    left, right = jnp.split(matrix, 2, axis=-1)
    return jnp.concatenate(
        [left * real[0] + right * imag[1], right * real[1] - left * imag[0]], axis=-1
    )


def durations(tables: Tables, contact_fraction):
    """Drive angle of the contact, time in contact, and time in flight."""
    angle = 2 * np.pi * contact_fraction
    w = tables.angular_frequency
    return angle, angle / w, (2 * np.pi - angle) / w


def single_contact(tables: Tables, contact_fraction: Float[Array, ""]) -> SingleContact:
    """Return the one motion with this share of the drive period in contact.

    There is never a second one: the conditions are linear, and which of the two motions that
    differ in sign it is follows from its being slowed down in contact. Check `possible`, and with
    `read_single_contact` whether it stays out of the stop in flight and in it in contact.
    `tables` as of `unit_tables`; `contact_fraction` in (0, 1).
    """
    phases = tables.phases
    angle, time, flight = durations(tables, contact_fraction)
    contact = growth(phases, CONTACT, time)
    free = growth(phases, FLIGHT, flight)
    grown = (contact[0] + 1, contact[1])
    kept = (free[0] + 1, free[1])
    mean = (contact[0] / angle, contact[1] / angle)
    cos, sin = cosine(angle), cosine(angle - np.pi / 2)
    turned = lax.complex(cos, sin)
    half_sine = cosine(angle / 2 - np.pi / 2)
    mean_turn = lax.complex(-2 * half_sine**2, sin) / angle

    # Free parts: z in contact at touch, y in flight at departure. The steady parts return.
    exchange = phases.change[CONTACT, 0]
    steady = exchange @ tables.steady[CONTACT] - tables.steady[FLIGHT]
    pressed = exchange @ phases.rest[CONTACT]
    by_state = exchange - apply_blocks(kept, _right(exchange, grown))
    later = steady * turned
    # What blocks in resonance gain in contact and in flight, by the drive phase where it begins.
    gained, gained_later = _gain(tables, CONTACT, angle), _gain(tables, FLIGHT, 2 * np.pi - angle)
    later = later + exchange @ gained
    by_phasor = steady - lax.complex(apply_blocks(kept, later.real), apply_blocks(kept, later.imag))
    by_phasor = by_phasor - gained_later * turned
    by_gap = pressed - apply_blocks(kept, pressed)

    # Depth zero at touch; its mean rate in contact zero; the mean deceleration one.
    rows, steady_rows = phases.readout[CONTACT], tables.rows[CONTACT]
    last_rows = [rows[DEPTH], _right(rows[DEPTH], mean), -_right(rows[RATE], mean)]
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

    def forced(table, c, s):
        return table.imag * c + table.real * s

    end_c, end_s = c * cos - s * sin, s * cos + c * sin
    blocks = z + forced(tables.steady[CONTACT], c, s) + phases.rest[CONTACT] * gap
    end = apply_blocks(grown, z) + forced(gained, c, s)
    departed = exchange @ (end + forced(tables.steady[CONTACT], end_c, end_s)) + pressed * gap
    return SingleContact(
        contact_fraction=contact_fraction,
        gap_ratio=gap,
        touch=jnp.arctan2(s, c),
        state=phases.to_state[CONTACT] @ blocks,
        touch_rate=rows[RATE] @ z + forced(steady_rows[RATE], c, s),
        departure_rate=rows[RATE] @ end + forced(steady_rows[RATE], end_c, end_s),
        in_contact=z,
        in_flight=departed - forced(tables.steady[FLIGHT], end_c, end_s),
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


def gap_ratio_and_slope(
    tables: Tables, contact_fraction: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""], SingleContact]:
    """Return the gap ratio, its derivative in the contact fraction, and the motion."""

    def value(fraction):
        found = single_contact(tables, fraction)
        return found.gap_ratio, found

    gap, slope, found = jax.jvp(
        value, (contact_fraction,), (jnp.ones_like(contact_fraction),), has_aux=True
    )
    return gap, slope, found


def monodromy(tables: Tables, contact_fraction: Float[Array, ""]) -> Float[Array, "states states"]:
    """Return the Jacobian of the period map just before touch, in units of energy.

    It depends on the times of contact and flight only, not on the motion.
    """
    phases, n = tables.phases, tables.phases.num_blocks
    _, time, flight = durations(tables, contact_fraction)
    weight = phases.weight
    push = phases.damping[0] * jnp.outer(phases.push_off[:, 0], phases.towards_stop[0])
    matrix = jnp.eye(2 * n)
    for phase, duration, sign in ((CONTACT, time, -1.0), (FLIGHT, flight, 1.0)):
        # Saltation: the damping force jumps where the stop is touched and left.
        matrix = matrix.at[n:].add(sign * push @ matrix[:n])
        real, imag = growth(phases, phase, duration)
        matrix = phases.to_state[phase] @ apply_blocks(
            (real + 1, imag), phases.from_state[phase] @ matrix
        )
    return weight[:, None] * matrix / weight


def multipliers(tables: Tables, contact_fraction: Float[Array, ""]) -> Complex[Array, " states"]:
    """Return the Floquet multipliers of the motion."""
    matrix = monodromy(tables, contact_fraction)
    return jnp.linalg.eigvals(jnp.where(jnp.isfinite(matrix), matrix, 0.0))
