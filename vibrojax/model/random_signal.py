"""Random drives from a power spectral density."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import (
    axis_of,
    check_choice,
    check_frequencies,
    check_positive,
    check_seed,
)
from vibrojax._tools.signatures import validated
from vibrojax.model.signals import Sampled

PER_PERIOD = 20.0
"""Samples in a period of the highest frequency, unless given otherwise."""


@validated
def random_signal(
    frequencies: ArrayLike | Sequence[float],
    density: ArrayLike | Sequence[float],
    duration: float | int,
    *,
    seed: int,
    sides: int = 1,
    sampling_rate: float | int | None = None,
) -> Sampled:
    """Return Gaussian noise of a power spectral density, as a `Sampled`.

        noise = vj.model.random_signal([5, 20, 500], [1e-3, 0.02, 0.02], 60.0, seed=1)

    The density is straight on logarithmic axes between the frequencies, as test specifications draw
    it, and 0 outside of them. The noise repeats after its duration, and its samples have the
    density on average over seeds; the straight lines between them have sinc(f / sampling_rate)^4 of
    it, 1.6 % less at the highest frequency by default. Source: Shinozuka and Deodatis 1991, with
    random amplitudes in place of fixed ones.

    Parameters:
        frequencies: Hz, rising, at least two.
        density: (m/s2)^2/Hz of a base or N^2/Hz of a force, above 0, one for every frequency.
        duration: s.
        seed: another one gives other noise; the same gives the same.
        sides: 1: the density is that over frequencies above 0 alone; 2: over negative ones too,
            of which each side has half of the power.
        sampling_rate: Hz; by default 20 times the highest frequency.

    Raises `ValueError` for frequencies that do not rise, densities that are not above 0, lengths
    that differ, a duration without a line between the frequencies, or a sampling rate of less than
    twice the highest frequency.
    """
    axis = check_frequencies("frequencies", frequencies, "Hz")
    levels = axis_of("density", density)
    check_positive("density", levels, "(m/s2)^2/Hz or N^2/Hz")
    check_positive("duration", duration, "s")
    check_seed(seed)
    check_choice("sides", sides, (1, 2))
    if axis.size < 2 or axis.size != levels.size:
        raise ValueError(
            f"Give at least two frequencies, and a density for each, got {axis.size} frequencies "
            f"and {levels.size} densities."
        )
    rate = PER_PERIOD * axis[-1] if sampling_rate is None else sampling_rate
    if not rate >= 2 * axis[-1]:
        raise ValueError(
            f"sampling_rate must be at least twice the highest frequency, {2 * axis[-1]:g} Hz, "
            f"got {sampling_rate!r} Hz."
        )
    count = max(2, round(duration * rate))
    lines = np.fft.rfftfreq(count, duration / count)
    inside = (lines >= axis[0]) & (lines <= axis[-1])
    if not inside.any():
        raise ValueError(
            f"duration = {duration:g} s has lines {1 / duration:.3g} Hz apart, none of them from "
            f"{axis[0]:g} to {axis[-1]:g} Hz. Take a longer one."
        )
    found = sides * np.exp(np.interp(np.log(lines[inside]), np.log(axis), np.log(levels)))
    parts = np.random.default_rng(seed).standard_normal((2, found.size))
    spectrum = np.zeros(lines.size, complex)
    spectrum[inside] = count / 2 * np.sqrt(found / duration) * (parts[0] + 1j * parts[1])
    values = np.fft.irfft(spectrum, count)
    return Sampled(np.linspace(0.0, duration, count + 1), np.append(values, values[0]))
