"""What a motion does within a drive period: observables, sides of a barrier, spectrum."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from vibrojax.model.drives import Harmonic
from vibrojax.model.systems import Motion
from vibrojax.regime.poincare_map import Numbers, PoincareMap, in_chunks
from vibrojax.stepping.method import AbstractMethod, ExactContact, with_traced_numbers
from vibrojax.sweep.swept_lanes import Rigs

lax = jax.lax

HYSTERESIS = 0.05
"""How far beyond the barrier a side counts as reached, in the largest distance from it."""
HIGHEST_ORDER = 8
"""Highest frequency of a spectrum, in drive frequencies."""


class Sampling(NamedTuple):
    """How motions are looked at between their states on the section."""

    periods: int
    samples_per_period: int
    barrier: float
    """Displacement between the two sides, m."""
    spectrum: bool

    @property
    def orders(self) -> Float[np.ndarray, " orders"]:
        """Frequencies of the spectrum over the drive frequency."""
        highest = min(HIGHEST_ORDER, self.samples_per_period // 2)
        return np.arange(highest * self.periods + 1) / self.periods


def steps_per_sample(
    method: AbstractMethod,
    rigs: Rigs,
    rig: Int[np.ndarray, " lanes"],
    angular_frequency: Numbers,
    samples_per_period: int,
) -> Int[np.ndarray, " lanes"]:
    """Return how many steps of its method every lane takes from sample to sample."""
    if isinstance(method, ExactContact):
        return np.ones(len(rig), np.int32)  # it takes as many as it needs within one
    pairs, own = np.unique(np.stack([rig, angular_frequency]), axis=1, return_inverse=True)

    def steps(k: int, frequency: float) -> int:
        one = jax.tree.map(lambda a: jnp.asarray(a[k]) if eqx.is_array(a) else a, rigs)
        run = Motion(one.equations, one.drive, Harmonic(frequency / (2 * np.pi)))
        return math.ceil(method.steps(run) / samples_per_period)

    found = [steps(int(k), float(w)) for k, w in pairs.T]
    return np.array(found, np.int32)[own.ravel()]


@eqx.filter_jit
def _sampled(
    method: AbstractMethod, rigs: Rigs, frequency, state, parts, periods: int, per_period: int
):

    def one(rig: Rigs, frequency: Array, state: Array, count: Array):
        equations = rig.equations
        run = Motion(equations, rig.drive, Harmonic(frequency / (2 * jnp.pi)))
        interval = 2 * jnp.pi / frequency / per_period
        step = interval / count
        kept = method.init(None, 0.0, step, state, run)  # which may be for this step only

        def look(state: Array):
            q, rate, _ = equations.split(state)
            return jax.jvp(equations.observables, (q,), (rate,))

        def sample(carry, k):
            state, sums = carry
            seen, rates = look(state)
            values = seen | {"strain_power": rates["strain_energy"]}
            sums = {
                name: (
                    jnp.maximum(sums[name][0], jnp.abs(value)),
                    sums[name][1] + value,
                    sums[name][2] + value**2,
                )
                for name, value in values.items()
            }
            begin = (k % per_period) * interval

            def on(i: Array, state: Array) -> Array:
                return method.advance(run, begin + i * step, step, state, kept)

            single = isinstance(method, ExactContact)
            after = on(jnp.zeros(()), state) if single else lax.fori_loop(0, count, on, state)
            return (after, sums), (seen["displacement"], rates["displacement"])

        names = [*jax.eval_shape(look, state)[0], "strain_power"]
        none = {name: (jnp.zeros(()),) * 3 for name in names}
        samples = periods * per_period
        (_, sums), (displacement, velocity) = lax.scan(sample, (state, none), jnp.arange(samples))
        numbers = {}
        for name, (largest, total, squares) in sums.items():
            numbers[f"{name}_max"] = largest
            numbers[f"{name}_mean"] = total / samples
            numbers[f"{name}_rms"] = jnp.sqrt(squares / samples)
        return displacement, velocity[::per_period], numbers

    return eqx.filter_vmap(one)(rigs, frequency, state, parts)


def sides(
    displacement: Float[np.ndarray, "lanes samples"], barrier: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return whether a motion visits both sides of a barrier (m), and how often it goes across.

    A side is reached `HYSTERESIS` of the largest distance beyond the barrier.
    """
    away = displacement - barrier
    edge = HYSTERESIS * np.max(np.abs(away), axis=1, keepdims=True)
    side = np.where(away > edge, 1, np.where(away < -edge, -1, 0))
    place = np.where(side != 0, np.arange(side.shape[1]), 0)
    latest = np.take_along_axis(side, np.maximum.accumulate(place, axis=1), axis=1)
    crossings = np.sum(latest[:, 1:] * latest[:, :-1] < 0, axis=1)
    return crossings > 0, crossings


def amplitude_spectrum(
    displacement: Float[np.ndarray, "lanes samples"], sampling: Sampling
) -> Float[np.ndarray, "lanes orders"]:
    """Return amplitudes (m) at `sampling.orders`, under a Hann window; the mean at order 0.

    A line of a motion of period n has its amplitude where n divides the periods observed, and
    spreads over its two neighbours.
    """
    from scipy.signal import get_window

    mean = displacement.mean(axis=1, keepdims=True)
    window = np.asarray(get_window("hann", displacement.shape[1]))
    weighted = (displacement - mean) * window
    lines = np.abs(np.fft.rfft(weighted, axis=1)) * 2 / window.sum()
    lines[:, 0] = np.abs(mean[:, 0])
    return lines[:, : len(sampling.orders)]


def sample_motions(
    poincare: PoincareMap,
    rig: Int[np.ndarray, " lanes"],
    angular_frequency: Numbers,
    state: Float[np.ndarray, "lanes states"],
    sampling: Sampling,
) -> dict[str, np.ndarray]:
    """March all lanes through a window, sampled, and return its numbers, by name, lanes leading.

    For every observable of the equations its largest size, mean and rms, the same of the rate of
    the strain energy (`strain_power`, W), strobed `displacement` and `velocity` of the response,
    `cross_well`, `crossings_per_period` and, where asked for, `spectrum`.
    """
    method, rigs, periods = poincare.method, poincare.rigs, sampling.periods
    numbers = with_traced_numbers(method)
    per_period = sampling.samples_per_period
    parts = steps_per_sample(method, rigs, rig, angular_frequency, per_period)
    lost = np.asarray(~np.isfinite(state).all(axis=1))
    begin = np.where(lost[:, None], 0.0, state)

    def run(k: np.ndarray) -> dict[str, Any]:
        own, w = poincare.rigs_at(rig[k]), angular_frequency[k]
        seen = _sampled(numbers, own, w, begin[k], parts[k], periods, per_period)
        displacement, velocity, found = jax.device_get(seen)
        crosses, crossings = sides(np.nan_to_num(displacement), sampling.barrier)
        found |= {
            "displacement": displacement[:, ::per_period],
            "velocity": velocity,
            "cross_well": crosses.astype(float),
            "crossings_per_period": crossings / periods,
        }
        if sampling.spectrum:
            found["spectrum"] = amplitude_spectrum(displacement, sampling)
        return found

    found = in_chunks(run, len(rig))
    for values in found.values():
        values[lost] = np.nan
    return found
