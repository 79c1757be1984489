"""The shock response spectrum: what oscillators of all frequencies make of an acceleration."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from vibrojax._tools.checks import check_frequencies, check_range, concrete
from vibrojax._tools.signatures import validated
from vibrojax.history.history import History
from vibrojax.history.quantities import table
from vibrojax.history.samples import times_of
from vibrojax.model.drives import BaseMotion
from vibrojax.model.signals import Sampled

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

PER_PERIOD = 64
"""Samples in a period of an oscillator, at least; its peak is read off a parabola through three."""


@dataclass(frozen=True, eq=False)
class ShockSpectrum:
    """Largest absolute accelerations of oscillators on a base, by natural frequency."""

    frequency: Float[np.ndarray, " oscillators"]
    """Natural frequencies, Hz."""
    positive: Float[np.ndarray, " oscillators"]
    """Largest acceleration, m/s2; at least 0."""
    negative: Float[np.ndarray, " oscillators"]
    """Modulus of the lowest acceleration, m/s2."""
    damping_ratio: float
    """Of all oscillators."""

    @property
    def maximax(self) -> Float[np.ndarray, " oscillators"]:
        """The larger one of both, m/s2: what is usually called the shock response spectrum."""
        return np.maximum(self.positive, self.negative)

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over oscillator, with units and long names."""
        columns = {
            "frequency": (self.frequency, "Hz", "Natural frequency"),
            "maximax": (self.maximax, "m/s2", "Largest absolute acceleration"),
            "positive": (self.positive, "m/s2", "Largest acceleration"),
            "negative": (self.negative, "m/s2", "Lowest acceleration, its modulus"),
        }
        return table("oscillator", columns, {"damping_ratio": self.damping_ratio})

    def plot(self) -> "Figure":
        """Draw it on logarithmic axes."""
        from vibrojax.plot.history import plot_shock

        return plot_shock(self.to_xarray())

    def __repr__(self) -> str:
        return (
            f"ShockSpectrum({self.frequency.size} oscillators, {self.frequency[0]:.6g} to "
            f"{self.frequency[-1]:.6g} Hz, damping ratio {self.damping_ratio:g}, largest "
            f"{np.max(self.maximax):.5g} m/s2)"
        )


@validated
def shock_response_spectrum(
    record: Sampled | History,
    frequencies: ArrayLike | Sequence[float],
    *,
    damping_ratio: float | int = 0.05,
    position: ArrayLike | None = None,
) -> ShockSpectrum:
    """Return the shock response spectrum of an acceleration, maximax and both signs.

        vj.history.shock_response_spectrum(pulse, np.geomspace(10, 2000, 60))
        vj.history.shock_response_spectrum(history, np.geomspace(10, 2000, 60), position=1.0)

    Every oscillator stands on what has the acceleration, at rest at first, and is followed for one
    period after the end, when the acceleration is 0. Source: Smallwood 1981, "An improved recursive
    formula for calculating shock response spectra", ramp-invariant filter: exact for an
    acceleration that is linear between its samples.

    Parameters:
        record: a `Sampled` base acceleration (m/s2), or a `History`, of which the absolute
            acceleration counts.
        frequencies: natural frequencies of the oscillators, Hz, rising.
        damping_ratio: of the oscillators; 0.05 is a quality of 10.
        position: place x/L on the beam of a history; None: where it reports, the tip.

    Raises `ValueError` for frequencies that are not above 0 and rising, a damping ratio outside of
    [0, 1), a position without a history of a beam, or a history that diverged or holds lanes.
    """
    axis = check_frequencies("frequencies", frequencies, "Hz")
    allowed = "from 0 to below 1"
    check_range("damping_ratio", damping_ratio, 0.0, 1.0, include_high=False, allowed=allowed)
    time, values = _acceleration(record, position)
    found = np.array([_extremes(time, values, float(f), damping_ratio) for f in axis])
    return ShockSpectrum(axis, found[:, 0], found[:, 1], float(damping_ratio))


def _acceleration(
    record: Sampled | History, position: ArrayLike | None
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Return times (s) and absolute accelerations (m/s2)."""
    if isinstance(record, Sampled):
        if position is not None:
            raise ValueError(f"A Sampled has no position, got {position!r}. Leave it out.")
        time, values = concrete(record.time), concrete(record.values)
        if time is None or values is None:
            raise ValueError("The shock response spectrum is that of a record outside jit.")
        return time, values
    time = times_of(record, "shock response spectrum")
    motion = record.motion
    values = np.asarray(record.acceleration(position))
    if isinstance(motion.drive, BaseMotion):
        values = values - np.asarray(motion.drive.input(motion.waveform, jnp.asarray(time)))
    return time, values


def _extremes(
    time: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, " samples"],
    frequency: float,
    damping_ratio: float,
) -> tuple[float, float]:
    """Return the largest and the modulus of the lowest acceleration of one oscillator."""
    from scipy.signal import lfilter

    length, count = time[-1] - time[0], time.size - 1
    count *= max(1, int(np.ceil(PER_PERIOD * frequency * length / count)))
    step = length / count
    after = int(np.ceil(1 / frequency / step)) + 1
    dense = np.interp(time[0] + step * np.arange(count + 1), time, values)
    rate = 2 * np.pi * frequency
    decay, angle = np.exp(-damping_ratio * rate * step), rate * step * np.sqrt(1 - damping_ratio**2)
    cosine, sine = decay * np.cos(angle), decay * np.sin(angle) / angle
    ahead = [1 - sine, 2 * (sine - cosine), decay**2 - sine]
    back = [1.0, -2 * cosine, decay**2]
    # At rest before: a value that is there from the start comes within an interval.
    filtered = lfilter(ahead, back, np.concatenate([[0.0], dense, np.zeros(after)]))
    moved = np.asarray(filtered)
    return _highest(moved), _highest(-moved)


def _highest(values: Float[np.ndarray, " samples"]) -> float:
    """Return the top of the parabola through the largest value and its neighbours, 0 at least."""
    at = int(np.argmax(values))
    if values[at] <= 0 or at in (0, values.size - 1):
        return max(float(values[at]), 0.0)
    before, here, after = values[at - 1 : at + 2]
    bend = before - 2 * here + after
    return float(here - (after - before) ** 2 / (8 * bend)) if bend < 0 else float(here)
