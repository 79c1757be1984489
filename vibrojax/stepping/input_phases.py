"""Flight and contact under an input that runs straight: one linear system for each set of stops.

Between two samples of a drive the input is linear in time, so that input and slope are states too:
z' = M z with z = (q, q'/w, ..., tones, 1, input, slope), w being the first natural frequency and
time counted in 1/w. Everything that a march asks of a phase is a product with M or its exponential.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Complex, Float, Int

from vibrojax.model.drives import AbstractDrive, AbstractWaveform
from vibrojax.model.equations import LinearEquations
from vibrojax.model.first_order import first_order
from vibrojax.model.laws import can_pull
from vibrojax.model.signals import Tones

DEGREE = 18
"""Of the power series over a step of the length 1/||M^4||^(1/4): good to round-off."""
LOOKS = 16
"""Places within an interval at which the bound of the fourth derivative is read."""
MARGIN = 1.5
"""What the bound is multiplied with, for what may lie between those places."""

Size = Float[Array, " size"]


class TonesOfInput(NamedTuple):
    """Sum of harmonics in the input: Im(amplitude exp(i (rate t + phase)))."""

    rate: Float[Array, " tones"]
    """rad/s."""
    amplitude: Complex[Array, " tones"]
    """m/s2 or N."""
    phase: Float[Array, " tones"]
    """rad."""


class InputPhases(eqx.Module):
    """The systems z' = M z of every set of touching stops, and the rows that read the stops."""

    matrix: Float[Array, "phases size size"]
    """M, stop s touching where bit s of the index is set."""
    depth: Float[Array, "stops size"]
    """Reads how deep the body is in each stop, m."""
    push: Float[Array, "stops size"]
    """Reads the force of each stop as a depth, m; the depth itself where it may pull."""
    unit: Float[Array, ""]
    """w: state and time in SI units over those of z, rad/s."""
    longest: Float[Array, " phases"]
    """Longest step of a power series, times w."""
    tones: TonesOfInput
    scale: Float[Array, " states"]
    """A state in SI units over that in z."""

    @property
    def carried(self) -> int:
        """How many entries of z go on from sample to sample: all but input and slope."""
        return self.matrix.shape[-1] - 2

    @property
    def num_stops(self) -> int:
        """How many stops there are."""
        return self.depth.shape[0]

    def begin(self, state: Float[Array, " states"], time: Float[ArrayLike, ""]) -> Size:
        """Return what is carried, from a state in SI units at a time (s)."""
        angle = self.tones.rate * time + self.tones.phase
        own = jnp.concatenate([jnp.sin(angle), jnp.cos(angle), jnp.ones(1)])
        return jnp.concatenate([state / self.scale, own])

    def first_phase(self, carried: Size, start_input: Float[Array, ""]) -> Int[Array, ""]:
        """Return which stops touch at the beginning; near zero depth the direction decides."""
        begun = jnp.concatenate([carried, jnp.stack([start_input, jnp.zeros(())])])
        depth, push = self.depth @ begun, self.push @ begun
        flight = self.matrix[0] @ begun
        by_depth = depth <= push
        value = jnp.where(by_depth, depth, push)
        rate = jnp.where(by_depth, self.depth @ flight, self.push @ flight)
        near = 1e-12 * (jnp.abs(self.depth) @ jnp.abs(begun))
        touching = jnp.where(jnp.abs(value) <= near, rate > 0, value > 0)
        return jnp.sum(touching * (1 << np.arange(self.num_stops)), dtype=jnp.int32)


def input_phases(
    equations: LinearEquations, drive: AbstractDrive, waveform: AbstractWaveform
) -> InputPhases:
    """Put structure, stops and input together, for every set of touching stops of one lane."""
    tones = _tones(drive, waveform)
    form, unit, count = first_order(equations), equations.angular_frequency[0], len(equations.stops)
    scale, states, waves = form.scale, len(form.scale), tones.rate.shape[0]
    size = states + 2 * waves + 3
    one = size - 3
    driven = form.input / scale / unit
    free = (
        jnp.zeros((size, size)).at[:states, :states].set(form.flow * scale / scale[:, None] / unit)
    )
    free = free.at[:states, -2].set(driven).at[-2, -1].set(1.0)
    free = free.at[:states, one].set(form.load / scale / unit)
    sine, cosine = states + np.arange(waves), states + waves + np.arange(waves)
    free = free.at[sine, cosine].set(tones.rate / unit).at[cosine, sine].set(-tones.rate / unit)
    free = free.at[:states, states:one].set(
        driven[:, None] * jnp.concatenate([tones.amplitude.real, tones.amplitude.imag])
    )
    zero = jnp.zeros((count, size))
    depth = zero.at[:, :states].set(form.depth * scale).at[:, one].set(-form.gap)
    rate = zero.at[:, :states].set(form.rate * scale)
    force = form.stiffness[:, None] * depth + form.damping[:, None] * rate
    whole = form.stiffness + form.damping * unit
    pulls = np.array([can_pull(stop.law) for stop in equations.stops], bool) | (whole == 0)
    push = jnp.where(pulls[:, None], depth, force / jnp.where(pulls, 1.0, whole)[:, None])
    against = form.push / scale[:, None] / unit
    sets = np.array([[p >> s & 1 for s in range(count)] for p in range(2**count)], float)

    def one_set(touching: Float[Array, " stops"]) -> Float[Array, "size size"]:
        return free.at[:states].add(-(against * touching) @ force)

    matrix = jax.vmap(one_set)(jnp.asarray(sets).reshape(2**count, count))
    square = matrix[:, :one, :one] @ matrix[:, :one, :one]
    size_of = jnp.max(jnp.sum(jnp.abs(square @ square), axis=1), axis=-1)
    longest = jnp.maximum(jax.lax.stop_gradient(size_of), 1e-24) ** -0.25
    return InputPhases(matrix, depth, push, unit, longest, tones, scale)


def _tones(drive: AbstractDrive, waveform: AbstractWaveform) -> TonesOfInput:
    if not isinstance(waveform, Tones):
        return TonesOfInput(jnp.zeros(0), jnp.zeros(0, complex), jnp.zeros(0))
    rate = 2 * jnp.pi * waveform.frequencies
    amplitude = waveform.shares * drive.complex_amplitude(rate, jnp.zeros_like(rate))
    return TonesOfInput(rate, amplitude, waveform.phases)


class Ahead(eqx.Module):
    """Tables that give the next so many samples at once, for every set of touching stops."""

    table: Float[Array, "phases ahead carried known"]
    """What is carried at samples ahead, from what is carried now and the inputs till then."""
    bound: Float[Array, "phases 2 stops size"]
    """What depth and push may be off a cubic between two samples, by the entries of z."""
    step: Float[Array, ""]
    """Interval of the samples, times w."""


def tables_ahead(phases: InputPhases, step: Float[Array, ""], ahead: int) -> Ahead:
    """Tabulate the motion over `ahead` intervals of the length `step` (times w)."""
    m = phases.carried
    read = jnp.stack([phases.depth, phases.push])

    def of_phase(matrix: Float[Array, "size size"]) -> tuple[Array, Array]:
        passed = jax.scipy.linalg.expm(matrix * step)
        late = passed[:m, m + 1] / step
        early = passed[:m, m] - late
        first = jnp.zeros((m, m + ahead + 1)).at[:, :m].set(jnp.eye(m))

        def one(row: Array, j: Array) -> tuple[Array, Array]:
            row = (passed[:m, :m] @ row).at[:, m + j].add(early).at[:, m + j + 1].add(late)
            return row, row

        _, table = jax.lax.scan(one, first, jnp.arange(ahead))
        part = jax.scipy.linalg.expm(matrix * (step / LOOKS))
        # The rest of the cubic through values and slopes at both ends is h^4/384 of the fourth
        # derivative, which is a row times the exponential times z at the sample before.
        power = matrix @ matrix
        begun = jax.lax.stop_gradient(read @ (power @ power))

        def look(rows: Array, _: None) -> tuple[Array, Array]:
            rows = rows @ part
            return rows, jnp.abs(rows)

        _, seen = jax.lax.scan(look, begun, None, LOOKS)
        most = jnp.maximum(jnp.abs(begun), jnp.max(seen, axis=0))
        return table, MARGIN * step**4 / 384 * most

    table, bound = jax.lax.map(of_phase, phases.matrix)
    return Ahead(table, jax.lax.stop_gradient(bound), step)


def series(matrix: Float[Array, "size size"], z: Size, step: Float[Array, ""]) -> Array:
    """Coefficients (DEGREE + 1, size) of z over a step, by the share of it from 0 to 1."""
    terms, part = [z], matrix * step
    for j in range(1, DEGREE + 1):
        terms.append(part @ terms[-1] / j)
    return jnp.stack(terms)


def value_and_slope(terms: Float[Array, "terms *rest"], share: Float[Array, ""]) -> tuple:
    """Value and slope of a power series at a share of its step."""
    value, slope = terms[-1], jnp.zeros_like(terms[-1])
    for term in terms[-2::-1]:
        slope = slope * share + value
        value = value * share + term
    return value, slope


def first_change(
    depth: Float[Array, "terms stops"],
    push: Float[Array, "terms stops"],
    noise: Float[Array, "2 stops"],
    touching: Bool[Array, " stops"],
) -> tuple[Float[Array, ""], Int[Array, ""], Bool[Array, ""]]:
    """Find the first change of contact over a step of power series, for certain.

    Returns the share of the step (1: none), which stop it is (-1: none), and whether its depth
    passes zero there, not its push. From every share one goes on as far as the curvature, which the
    coefficients bound, leaves the contact as it is; that converges to the first root like Newton's
    method. What is below the `noise` of depth and push counts as zero.
    """
    weights = jnp.arange(depth.shape[0], dtype=float)
    weights = (weights * (weights - 1))[:, None]
    both = jnp.stack([jnp.where(touching, push, -depth), jnp.where(touching, push, -push)], axis=-1)
    curvature = jnp.maximum(jnp.sum(weights[..., None] * jnp.abs(both), axis=0), 1e-300)
    depth_noise, push_noise = noise
    rounding = jnp.stack([jnp.where(touching, push_noise, depth_noise), push_noise], axis=-1)

    def room(share: Float[Array, ""]) -> tuple[Array, Array]:
        """How far contact stays as it is, by stop, and which of the two says so."""
        value, slope = value_and_slope(both, share)
        outside = value < -rounding
        value = jnp.where(value <= rounding, 0.0, value)
        root = jnp.sqrt(slope**2 + 2 * curvature * value)
        falls = slope < 0
        far = jnp.where(
            falls,
            2 * value / jnp.where(falls, root - slope, 1.0),
            (slope + root) / curvature,
        )
        # At a touch that goes no further the next place is a little on.
        far = jnp.where(falls, jnp.where(outside, 0.0, far), jnp.maximum(far, 1e-7))
        # In flight, depth and push both have to be positive for a contact.
        far = jnp.where(outside & ~touching[:, None], 0.0, far)
        return jnp.max(far, axis=-1), jnp.argmax(far, axis=-1)

    def on(carry: tuple) -> Array:
        share, reach, _, rounds = carry
        return (rounds < 200) & (jnp.min(reach) > 0) & (share < 1)

    def one(carry: tuple) -> tuple:
        share, reach, _, rounds = carry
        share = jnp.minimum(share + jnp.min(reach), 1.0)
        return share, *room(share), rounds + 1

    start = jnp.zeros(())
    share, reach, which, _ = jax.lax.while_loop(on, one, (start, *room(start), 0))
    stop = jnp.argmin(reach)
    found = (share < 1) & (reach[stop] <= 0)
    by_depth = ~touching[stop] & (which[stop] == 0)
    share = jnp.where(found, share, 1.0)
    return share, jnp.where(found, stop, -1), by_depth
