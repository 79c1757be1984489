"""Which samples a simulation returns: how long it is, and at how many equal intervals."""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vibrojax._tools.checks import (
    check_count,
    check_one_number,
    check_positive,
    concrete,
)
from vibrojax.model.drives import AbstractSignal
from vibrojax.model.signals import Sampled, Tones
from vibrojax.model.systems import Motion
from vibrojax.stepping.signal_grid import SignalGrid, signal_grid, times_of_record

MOST_SAMPLES = 100_000_000


class SampleGrid(NamedTuple):
    """The samples of a motion, and how they lie to the drive."""

    times: Float[Array, " samples"]
    """s."""
    per_period: float
    """Samples in a period of the clock."""
    signal: SignalGrid | None
    """Knots of an exact march under a signal; None: the drive has a phase."""
    interval: float | None
    """Between samples under a signal, s."""
    corners: int | None
    """Equal parts of a sample interval that end where the signal has corners; None: no equal parts
    do, or there are none."""


def sample_grid(
    run: Motion,
    periods: float | int | None,
    duration: Any,
    samples_per_period: int,
    samples: int | None,
    sampling_rate: float | int | None,
) -> SampleGrid:
    """Read what `simulate` was asked for. Raises `ValueError` for what contradicts itself."""
    if sampling_rate is not None:
        if samples is not None:
            raise ValueError("Give samples or sampling_rate (Hz), not both.")
        _check_sampling(sampling_rate, run)
    if samples is not None:
        check_count("samples", samples)
    check_count("samples_per_period", samples_per_period, least=2)
    if isinstance(run.waveform, AbstractSignal):
        return _of_signal(run, periods, duration, samples_per_period, samples, sampling_rate)
    if (periods is None) == (duration is None):
        raise ValueError("Give periods or duration (s), one of the two.")
    period = 2 * jnp.pi / run.clock
    if periods is not None:
        check_positive("periods", periods, "(drive periods)")
        length = jnp.asarray(periods, float) * period
        count: Any = periods
    else:
        check_one_number("duration", duration, "s", "The motions of one call are equally long.")
        length = jnp.asarray(duration, float)
        count = concrete(length / period)
    if sampling_rate is not None:
        seconds = concrete(length)
        samples = None if seconds is None else max(1, round(float(seconds) * sampling_rate))
    if count is None or (samples is None and sampling_rate is not None):
        raise ValueError(
            "How many samples the run has depends on values that JAX is tracing: give periods, and "
            "samples_per_period or samples, in place of duration or sampling_rate."
        )
    if samples is None:
        # A duration is covered to its end; a number of periods has its samples exactly.
        wanted = float(count) * samples_per_period
        samples = math.ceil(wanted) if periods is None else max(1, round(wanted))
    _check_most(samples, "duration" if periods is None else "periods")
    times = length * jnp.linspace(0.0, 1.0, samples + 1)
    return SampleGrid(times, samples / float(count), None, None, None)


def _check_most(samples: int, length_name: str) -> None:
    if samples > MOST_SAMPLES:
        raise ValueError(
            f"{length_name} and samples_per_period, samples or sampling_rate ask for "
            f"{samples:.3g} samples; at most {MOST_SAMPLES:,} fit into a memory. Ask for fewer."
        )


def _of_signal(run, periods, duration, samples_per_period, samples, sampling_rate) -> SampleGrid:
    """Read what was asked for under a signal, whose own samples are the default."""
    signal, kind = run.waveform, type(run.waveform).__name__
    if periods is not None:
        raise ValueError(
            f"periods: a {kind} has no period, got {periods!r}. Give duration (s)"
            f"{' in its place.' if isinstance(signal, Tones) else ', or leave both out.'}"
        )
    start, spacing = 0.0, 1.0
    if isinstance(signal, Sampled):
        time = times_of_record(signal)
        start, spacing = float(time[0]), float(time[-1] - time[0]) / (time.size - 1)
        duration = float(time[-1] - time[0]) if duration is None else duration
    if duration is None:
        raise ValueError(f"Give duration (s): a {kind} has no end.")
    check_one_number("duration", duration, "s", "The motions of one call are equally long.")
    length = concrete(duration)
    if length is None:
        raise ValueError(f"duration must be known under a {kind}, but JAX is tracing it.")
    length = float(length)
    if isinstance(signal, Tones):
        fastest = concrete(jnp.max(signal.frequencies))
        if fastest is None and samples is None and sampling_rate is None:
            raise ValueError("Give samples: JAX is tracing the frequencies of the Tones.")
        if fastest is not None:
            spacing = 1 / (float(fastest) * samples_per_period)
    if sampling_rate is not None:
        samples = max(1, round(length * sampling_rate))
    elif samples is None:
        samples = max(1, math.ceil(length / spacing - 1e-6))
        length = samples * spacing  # covered to its end, at the samples of the record
    _check_most(samples, "duration")
    linear, interval = run.equations.linear_between_contacts, length / samples
    fastest = None if linear is None else concrete(jnp.max(linear.angular_frequency))
    grid = signal_grid(signal, start, interval, samples, 0.0 if fastest is None else float(fastest))
    corners = None
    if isinstance(signal, Sampled) and grid.kept is None:
        corners = max(1, round(interval / spacing))
        corners = corners if abs(interval - corners * spacing) < 1e-6 * spacing else None
    clock = concrete(run.clock)
    per_period = 2 * np.pi / (float(clock) if clock is not None else 1.0) / interval
    times = start + length * jnp.linspace(0.0, 1.0, samples + 1)
    return SampleGrid(times, per_period, grid, interval, corners)


def parts_under_signal(run: Motion, grid: SampleGrid, parts: int) -> int:
    """Return equal steps in a sample interval of a stepper, at least so many.

    They end at the corners of the signal where they can, else are a quarter of its intervals.
    """
    if not isinstance(run.waveform, Sampled):
        return parts
    if grid.corners is not None:
        return grid.corners * math.ceil(parts / grid.corners)
    assert grid.interval is not None  # of signals
    shortest = float(np.min(np.diff(times_of_record(run.waveform))))
    return max(parts, math.ceil(4 * grid.interval / shortest))


def longest_step(run: Motion, grid: SampleGrid) -> Float[Array, ""]:
    """Return the longest step (s) of a stepper that chooses its own, lest it misses a contact."""
    longest = 2 * jnp.pi / run.clock / 40
    if not isinstance(run.waveform, Sampled):
        return longest
    return jnp.minimum(longest, jnp.min(jnp.diff(run.waveform.time)))


def _check_sampling(sampling_rate, run):
    """Refuse a sampling rate (Hz) that cannot show the highest mode."""
    check_positive("sampling_rate", sampling_rate, "Hz")
    linear = run.equations.linear_between_contacts
    if linear is None:
        return
    highest = concrete(jnp.max(linear.angular_frequency) / (2 * jnp.pi))
    if highest is not None and sampling_rate < 2 * highest:
        raise ValueError(
            f"sampling_rate must be at least twice the highest natural frequency of the model, "
            f"2 x {float(highest):.6g} Hz, got {sampling_rate!r} Hz. Sample faster, or keep fewer "
            "modes."
        )
