"""The spectrum of a history: what `spectrum_of` needs, read off the motion."""

from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float

from vibrojax.history.quantities import (
    QUANTITIES,
    STRAIN_POWER,
    displacement_of,
    observable_motion,
    quantity_of,
)
from vibrojax.history.samples import SampledMotion, times_of
from vibrojax.history.spectrum import Spectrum, spectrum_of
from vibrojax.model.drives import Harmonic

FOLDED = 0.01
"""Share of the rms that may lie above half the sampling rate: 40 dB down."""


def spectrum_of_history(
    history: SampledMotion,
    quantity: str,
    position: ArrayLike | None,
    *,
    start: float | int,
    segment: float | int | None,
    **settings: Any,
) -> Spectrum:
    """Return the spectrum of a quantity; see `History.spectrum`."""
    time = times_of(history, "spectrum")
    inside = time >= start
    if np.sum(inside) < 9:
        raise ValueError(
            f"start = {start!r} s leaves {np.sum(inside)} samples, 9 are needed. The history "
            f"ends at {time[-1]:.6g} s."
        )
    rate = float(1 / (time[1] - time[0]))
    is_force = quantity == "contact_force"
    if is_force:
        position = None
    values = np.asarray(quantity_of(history, quantity, position)[0])[inside]
    motion = history.motion
    equations, waveform = motion.equations, motion.waveform
    clock, natural = float(motion.clock) / (2 * np.pi), np.zeros(0)
    if equations.linear_between_contacts is not None:
        natural = np.asarray(equations.linear_between_contacts.angular_frequency) / (2 * np.pi)
    if np.max(natural, initial=0.0) > rate / 2:
        if quantity in QUANTITIES:
            moved, _, pushed = displacement_of(history, position)
        else:
            quantity_moved = "strain_energy" if quantity == STRAIN_POWER else quantity
            moved, _, pushed = observable_motion(history, quantity_moved)
        moved, pushed = np.asarray(moved)[inside], np.asarray(pushed)[inside]
        # A force has no derivative that shows folded lines: the motion it causes has.
        share = folded_share(pushed if is_force else values, moved, pushed, rate)
        if share > FOLDED:
            raise ValueError(
                f"The history has {rate:.6g} samples/s and a highest mode of {max(natural):.6g}"
                f" Hz: {100 * share:.2g} % of the rms lies above {rate / 2:.6g} Hz and would "
                "be folded. Give simulate a sampling_rate of at least "
                f"{2.56 * max(natural):.5g} Hz, or samples_per_period of at least "
                f"{int(np.ceil(2.56 * max(natural) / clock))}."
            )
    moving = float(motion.strength) > 0
    of_a_place = quantity in QUANTITIES and not is_force
    if position is None and of_a_place:
        position = history.system.reported_place
    return spectrum_of(
        values[:-1] if segment is None else values,
        rate,
        quantity=quantity,
        segment=segment,
        drive_frequency=clock if moving and isinstance(waveform, Harmonic) else None,
        natural_frequencies=natural,
        position=None if position is None else float(np.asarray(position)),
        **settings,
    )


def folded_share(
    values: Float[np.ndarray, " samples"],
    displacement: Float[np.ndarray, " samples"],
    acceleration: Float[np.ndarray, " samples"],
    rate: float,
) -> float:
    """Return the share of the rms of `values` that lies above half the sampling rate, about.

    A line at w (rad/s) that is really one at W, folded, shows in that its acceleration is W^2
    times the displacement, not w^2.
    """
    from scipy.signal import get_window

    weights = get_window("hann", len(values))
    parts = (values, displacement, acceleration)
    size, moved, pushed = (np.abs(np.fft.rfft(weights * part))[1:] for part in parts)
    seen = 2 * np.pi * np.fft.rfftfreq(len(values), 1 / rate)[1:]
    folded = pushed > seen * (2 * np.pi * rate - seen) * moved
    return float(np.sqrt(np.sum(size[folded] ** 2) / max(np.sum(size**2), 1e-300)))
