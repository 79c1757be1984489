"""Picture of a time history."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import ArrayLike
from matplotlib.figure import Figure

from vibrojax._tools.checks import check_one
from vibrojax.history.quantities import QUANTITIES, check_quantity, unit_and_label
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.plot.style import Picture

if TYPE_CHECKING:
    from vibrojax.history.history import History


def plot_history(history: "History", quantity: str, position: ArrayLike | None) -> Figure:
    """Draw a quantity against time, and below it the force of every stop."""
    check_quantity(history.motion.equations, quantity)
    time = np.asarray(history.time)
    forces = np.asarray(history.contact_force)
    stops = forces.shape[1]
    figure = Picture(figsize=(10, 6 if stops else 4), dpi=150, layout="constrained")
    panels = figure.subplots(2 if stops else 1, 1, sharex=True, squeeze=False)[:, 0]
    unit, label = unit_and_label(quantity)
    if position is None and isinstance(history.system, ImpactingBeam):
        position = 1.0
    check_one("position", position, "place x/L")
    nowhere = position is None or quantity == "contact_force" or quantity not in QUANTITIES
    place = "" if nowhere else f" at x/L = {float(np.asarray(position)):g}"
    values = history.quantity(quantity, None if nowhere else position)
    panels[0].plot(time, np.asarray(values), linewidth=1.0)
    panels[0].set_ylabel(f"{label}{place} [{unit}]", fontsize=11)
    if stops:
        for s in range(stops):
            panels[1].plot(time, forces[:, s], linewidth=1.0, label=f"stop {s + 1}")
        panels[1].set_ylabel("Contact force [N]", fontsize=11)
        if stops > 1:
            panels[1].legend(fontsize=10)
    panels[-1].set_xlabel("Time [s]", fontsize=11)
    for panel in panels:
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=10)
    return figure
