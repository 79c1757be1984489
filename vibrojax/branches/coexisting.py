"""Coexisting motions: many settled marches, the motions they lead to, and their branches."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.checks import (
    check_count,
    check_names,
    check_needed_arguments,
    check_positive,
    check_seed,
)
from vibrojax._tools.signatures import validated
from vibrojax.branches.along import check_system
from vibrojax.branches.coexisting_result import SAME, Coexisting, Motion
from vibrojax.branches.lane_paths import frequency_paths
from vibrojax.model.systems import AbstractSystem, as_arrays, check_made
from vibrojax.results.status import Status
from vibrojax.steady.batches import take
from vibrojax.steady.starting import settled
from vibrojax.stepping.choice import is_exact


@validated
def coexisting_responses(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *,
    frequency_ratio: float | None = None,
    frequency: float | None = None,
    starts: int = 64,
    size: float = 3.0,
    seed: int = 0,
    max_period: int = 8,
    max_periods: int = 600,
    **numbers: Any,
) -> Coexisting:
    """Look for all motions that coexist at one frequency, by marching from many states.

    Starts are random states: directions uniform on the sphere of the energy norm, sizes uniform up
    to `size` times the contact-free steady state; rest is always among them. All march at once.

    Parameters:
        system: a system, or a function from named numbers to one.
        frequency_ratio, frequency: drive frequency, one of the two (ratio, or Hz).
        starts: how many states to march from.
        size: largest start, over the size of the contact-free response.
        seed: of the random starts.
        max_period: longest period looked for, in drive periods.
        max_periods: most drive periods marched.
        numbers: arguments of the function.

    Raises `ValueError` for settings that cannot work. `.branches(...)` of the result follows each
    motion along the frequency.
    """
    check_count("starts", starts)
    check_count("max_period", max_period)
    check_count("max_periods", max_periods, least=2 * max_period + 1)
    check_seed(seed)
    check_positive("size", size, "(times the contact-free response)")
    if (frequency_ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    is_ratio = frequency_ratio is not None
    value = float(frequency_ratio if frequency_ratio is not None else frequency or 0.0)
    check_positive("frequency_ratio" if is_ratio else "frequency", value, "")
    if not isinstance(system, AbstractSystem):
        check_names(system, numbers)
        check_needed_arguments(system, numbers)
        make, system = system, system(**numbers)
        check_made(make, system)
    elif numbers:
        raise ValueError(f"Unknown argument {next(iter(numbers))!r}: the system is made already.")
    check_system(system)
    exact = is_exact(system)
    stacked = jax.tree.map(lambda a: a[None], as_arrays(system))
    one = frequency_paths(stacked, is_ratio, exact)
    paths = take(one, jnp.zeros(starts, int))
    states = _random_states(one, value, starts, size, seed)
    found = settled(
        paths, jnp.full(starts, value), jnp.asarray(states.T), exact, max_period, max_periods
    )
    axis = "frequency_ratio" if is_ratio else "frequency"
    return _sorted_out(system, axis, value, one, states, found)


def _random_states(paths, value: float, starts: int, size: float, seed: int) -> np.ndarray:
    place = take(paths, 0).at(jnp.asarray(value))
    equations, w = place.equations, float(place.angular_frequency)
    weight = np.asarray(equations.energy_weight)
    amplitude = complex(place.drive.complex_amplitude(jnp.asarray(w), jnp.asarray(0.0)))
    natural, zeta = np.asarray(equations.angular_frequency), np.asarray(equations.damping_ratio)
    q = amplitude * np.asarray(equations.input_map) / (natural**2 - w**2 + 2j * zeta * natural * w)
    moving = 2 * len(q)
    reach = np.linalg.norm(weight[:moving] * np.concatenate([np.abs(q), w * np.abs(q)]))
    random = np.random.default_rng(seed)
    # Low modes carry the motion: the size of a direction falls with the frequency of its mode.
    # Stops with an internal state are at rest.
    spread = np.append(np.tile(natural[0] / natural, 2), np.zeros(weight.size - moving))
    direction = random.normal(size=(starts, weight.size)) * spread
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = size * reach * random.uniform(size=(starts, 1))
    states = radius * direction / weight
    states[0] = 0.0
    return states


def _sorted_out(system, axis, value, paths, starts, found) -> Coexisting:
    """Group the marches by the motion they ended in."""
    weight = np.asarray(take(paths, 0).at(jnp.asarray(value)).equations.energy_weight)
    states = np.asarray(found.state).T * weight
    period, status = np.asarray(found.period), np.asarray(found.status)
    measures = found.measures
    reference = float(np.asarray(system.drive.reference[0]))
    high, low = np.asarray(measures.highest), np.asarray(measures.lowest)
    amplitude = (high - low) / 2 / reference
    force = np.asarray(measures.force)
    groups: list[list[int]] = []
    for k in range(len(states)):
        if status[k] != Status.settled.value:
            continue
        for group in groups:
            j = group[0]
            scale = max(np.linalg.norm(states[j]), np.linalg.norm(states[k]), 1e-300)
            # A motion of period n is met at any of its n phases: its amplitude decides.
            close = np.linalg.norm(states[j] - states[k]) < SAME * scale
            alike = abs(amplitude[j] - amplitude[k]) < SAME * amplitude[j]
            if period[j] == period[k] and (close or (period[k] > 1 and alike)):
                group.append(k)
                break
        else:
            groups.append([k])
    groups.sort(key=len, reverse=True)
    motions = tuple(
        Motion(
            period=int(period[g[0]]),
            amplitude_ratio=float(amplitude[g[0]]),
            contact_force=float(force[g[0]]),
            initial_state=states[g[0]] / weight,
            starts=np.array(g),
        )
        for g in groups
    )
    return Coexisting(
        axis=axis,
        value=value,
        motions=motions,
        start_states=starts,
        aperiodic=np.flatnonzero(status == Status.aperiodic.value),
        diverged=np.flatnonzero(status == Status.diverged.value),
        system=system,
    )
