"""What the pictures of one history show over time."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_one
from vibrojax.history.quantities import (
    QUANTITIES,
    check_quantity,
    observables_of,
    quantity_of,
    unit_and_label,
)
from vibrojax.history.samples import SampledMotion, check_one_history, times_of
from vibrojax.model.drives import AbstractSignal, BaseMotion

Signal = tuple[np.ndarray, str, str]
"""Values over time, unit and long name."""


def signals_of(history: SampledMotion, quantity: str, position: ArrayLike | None) -> list[Signal]:
    """Return a quantity and the forces of the stops; see `History.plot`."""
    check_one_history(history, "quantities")
    check_quantity(history.motion.equations, quantity)
    position = history.system.reported_place if position is None else position
    check_one("position", position, "place x/L")
    nowhere = position is None or quantity == "contact_force" or quantity not in QUANTITIES
    place = "" if nowhere else f" at x/L = {float(np.asarray(position)):g}"
    values, _ = quantity_of(history, quantity, None if nowhere else position)
    units, label = unit_and_label(quantity)
    forces = np.asarray(history.contact_force)
    # Of one stop it would be the same once more.
    others = forces.shape[1] - (quantity == "contact_force")
    below = [(forces, *QUANTITIES["contact_force"])] if others > 0 else []
    signal = isinstance(history.motion.waveform, AbstractSignal)
    driven = [input_of(history)] if signal and history.motion.drive.signal_factor else []
    return [*driven, (np.asarray(values), units, label + place), *below]


def input_of(history: SampledMotion) -> Signal:
    """Return what drives a motion: the acceleration of the base, or the force."""
    motion = history.motion
    values = np.asarray(motion.drive.input(motion.waveform, jnp.asarray(history.time)))
    if isinstance(motion.drive, BaseMotion):
        return -values, "m/s2", "Base acceleration"
    return values, "N", "Drive force"


def chirp_signals(history: SampledMotion, quantities: tuple[str, ...]) -> list[Signal]:
    """Return drive, quantities and drive frequency; see `History.plot_chirp`."""
    time = jnp.asarray(times_of(history, "pictures of a chirp"))
    motion = history.motion
    for name in quantities:
        check_quantity(motion.equations, name)
    drive = history.system.drive
    if drive.reference[1] == "m":
        raise ValueError("Nothing drives this system: use history.plot() for its motion.")
    seen = observables_of(motion.equations)
    if not quantities:
        angle = "bearing_angle" if "bearing_angle" in seen else "displacement"
        bent = "chord_reduction" if "chord_reduction" in seen else "strain_energy"
        quantities = (angle, bent)
    phase, rate, _ = motion.waveform.phase(time)
    if isinstance(drive, BaseMotion):
        base = np.asarray(drive.amplitude * jnp.sin(phase))
        driven = (base, "m", "Base displacement")
    else:
        driven = input_of(history)
    shown = [(np.asarray(quantity_of(history, n)[0]), *unit_and_label(n)) for n in quantities]
    return [driven, *shown, (np.asarray(rate) / (2 * np.pi), "Hz", "Drive frequency")]
