"""What a motion does within a drive period: observables, sides of a barrier, spectrum."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from vibrojax._tools.compiled import compiled
from vibrojax.model.drives import Harmonic
from vibrojax.model.systems import Motion
from vibrojax.regime.poincare_map import Numbers, Places, PoincareMap, States, in_chunks
from vibrojax.regime.settings import HIGHEST_ORDER
from vibrojax.steady.batches import take
from vibrojax.stepping.prepared_rigs import Rigs
from vibrojax.stepping.stepper import AbstractStepper, ExactContact, with_traced_numbers

lax = jax.lax

HYSTERESIS = 0.05
"""How far beyond the barrier a side counts as reached, in the largest distance from it."""


def _steps_per_sample(
    poincare: PoincareMap, rig: Places, angular_frequency: Numbers, samples_per_period: int
) -> Int[np.ndarray, " lanes"]:
    """Return how many steps of its stepper every lane takes from sample to sample."""
    stepper = poincare.stepper
    if isinstance(stepper, ExactContact):
        return np.ones(len(rig), np.int32)  # it takes as many as it needs within one
    pairs, own = np.unique(np.stack([rig, angular_frequency]), axis=1, return_inverse=True)

    def steps(k: int, frequency: float) -> int:
        one = jax.tree.map(lambda a: jnp.asarray(a[k]) if eqx.is_array(a) else a, poincare.rigs)
        run = Motion(one.equations, one.drive, Harmonic(frequency / (2 * np.pi)))
        return math.ceil(stepper.steps(run) / samples_per_period)

    found = [steps(int(k), float(w)) for k, w in pairs.T]
    return np.array(found, np.int32)[own.ravel()]


@compiled
def _sampled(
    stepper: AbstractStepper, rigs: Rigs, frequency, state, parts, periods: int, per_period: int
):
    def one(rig: Rigs, frequency: Array, state: Array, count: Array):
        equations = rig.equations
        run = Motion(equations, rig.drive, Harmonic(frequency / (2 * jnp.pi)))
        interval = 2 * jnp.pi / frequency / per_period
        step = interval / count
        kept = stepper.init(None, 0.0, step, state, run)  # which may be for this step only

        def look(state: Array):
            q, rate, _ = equations.split(state)
            return jax.jvp(equations.observables, (q,), (rate,))

        def sample(carry, k):
            state, sums = carry
            seen, rates = look(state)
            values = seen | {"strain_power": rates["strain_energy"]}
            sums = {
                name: (jnp.maximum(largest, jnp.abs(v)), total + v, squares + v**2)
                for name, v in values.items()
                for largest, total, squares in [sums[name]]
            }
            begin = (k % per_period) * interval

            def on(i: Array, state: Array) -> Array:
                return stepper.advance(run, begin + i * step, step, state, kept)

            single = isinstance(stepper, ExactContact)
            after = on(jnp.zeros(()), state) if single else lax.fori_loop(0, count, on, state)
            return (after, sums), (seen["displacement"], rates["displacement"])

        names = [*jax.eval_shape(look, state)[0], "strain_power"]
        none = {name: (jnp.zeros(()),) * 3 for name in names}
        samples = periods * per_period
        (_, sums), (displacement, velocity) = lax.scan(sample, (state, none), jnp.arange(samples))
        numbers = {}
        for name, (largest, total, squares) in sums.items():
            rms = jnp.sqrt(squares / samples)
            numbers |= {f"{name}_max": largest, f"{name}_mean": total / samples, f"{name}_rms": rms}
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
    displacement: Float[np.ndarray, "lanes samples"], periods: int
) -> Float[np.ndarray, "lanes orders"]:
    """Return amplitudes (m) at `RegimeSettings.orders`, under a Hann window; the mean at order 0.

    A line of a motion of period n has its amplitude where n divides the periods observed, and
    spreads over its two neighbours.
    """

    mean = displacement.mean(axis=1, keepdims=True)
    window = np.asarray(scipy.signal.get_window("hann", displacement.shape[1]))
    weighted = (displacement - mean) * window
    lines = np.abs(np.fft.rfft(weighted, axis=1)) * 2 / window.sum()
    lines[:, 0] = np.abs(mean[:, 0])
    return lines[:, : min(HIGHEST_ORDER, displacement.shape[1] // periods // 2) * periods + 1]


def sample_motions(
    poincare: PoincareMap,
    rig: Places,
    angular_frequency: Numbers,
    state: States,
    *,
    periods: int,
    samples_per_period: int,
    barrier: float,
    spectrum: bool = False,
) -> dict[str, np.ndarray]:
    """March all lanes through a window, sampled, and return its numbers, by name, lanes leading.

    For every observable of the equations its largest size, mean and rms, the same of the rate of
    the strain energy (`strain_power`, W), strobed `displacement` and `velocity` of the response,
    `cross_well`, `crossings_per_period` and, where asked for, `spectrum`.
    """
    numbers = with_traced_numbers(poincare.stepper)
    parts = _steps_per_sample(poincare, rig, angular_frequency, samples_per_period)
    lost = np.asarray(~np.isfinite(state).all(axis=1))
    begin = np.where(lost[:, None], 0.0, state)

    def run(k: Places) -> dict[str, Any]:
        own, w = take(poincare.rigs, rig[k]), angular_frequency[k]
        seen = _sampled(numbers, own, w, begin[k], parts[k], periods, samples_per_period)
        displacement, velocity, found = jax.device_get(seen)
        crosses, crossings = sides(np.nan_to_num(displacement), barrier)
        found |= {
            "displacement": displacement[:, ::samples_per_period],
            "velocity": velocity,
            "cross_well": crosses.astype(float),
            "crossings_per_period": crossings / periods,
        }
        if spectrum:
            found["spectrum"] = amplitude_spectrum(displacement, periods)
        return found

    found = in_chunks(run, len(rig))
    for values in found.values():
        values[lost] = np.nan
    return found
