"""What the pictures of one history show over time."""

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_one
from vibrojax.history.crossings import check_whole
from vibrojax.history.quantities import (
    QUANTITIES,
    check_quantity,
    observables_of,
    quantity_of,
    unit_and_label,
)
from vibrojax.model.drives import BaseMotion

if TYPE_CHECKING:
    from vibrojax.history.samples import SampledMotion
    from vibrojax.plot.histories import Signal


def signals_of(
    history: "SampledMotion", quantity: str, position: ArrayLike | None
) -> "list[Signal]":
    """Return a quantity and the forces of the stops; see `History.plot`."""
    from vibrojax.plot.histories import Signal

    check_quantity(history.motion.equations, quantity)
    position = history.system.reported_place if position is None else position
    check_one("position", position, "place x/L")
    nowhere = position is None or quantity == "contact_force" or quantity not in QUANTITIES
    place = "" if nowhere else f" at x/L = {float(np.asarray(position)):g}"
    values, _ = quantity_of(history, quantity, None if nowhere else position)
    units, label = unit_and_label(quantity)
    forces = np.asarray(history.contact_force)
    stops = tuple(f"stop {s + 1}" for s in range(forces.shape[1]))
    below = [Signal(forces, *QUANTITIES["contact_force"], stops)] if stops else []
    return [Signal(np.asarray(values), units, label + place), *below]


def chirp_signals(history: "SampledMotion", quantities: tuple[str, ...]) -> "list[Signal]":
    """Return drive, quantities and drive frequency; see `History.plot_chirp`."""
    from vibrojax.plot.histories import Signal

    check_whole(history, "Pictures of a chirp")
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
    time = jnp.asarray(history.time)
    phase, rate, _ = motion.waveform.phase(time)
    if isinstance(drive, BaseMotion):
        base = np.asarray(drive.amplitude * jnp.sin(phase))
        driven = Signal(base, "m", "Base displacement")
    else:
        driven = Signal(np.asarray(drive.input(motion.waveform, time)), "N", "Drive force")
    shown = [Signal(np.asarray(quantity_of(history, n)[0]), *unit_and_label(n)) for n in quantities]
    return [driven, *shown, Signal(np.asarray(rate) / (2 * np.pi), "Hz", "Drive frequency")]
