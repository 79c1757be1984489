"""Picture of the contacts of a history."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from vibrojax.plot.energy import COLOURS
from vibrojax.plot.style import Picture

if TYPE_CHECKING:
    from vibrojax.history.contacts import Contacts

MARKERS = ("o", "^", "s", "D")


def plot_contacts(contacts: "Contacts", names: tuple[str, ...]) -> Figure:
    """Draw columns of the table against the time of touch, one panel each."""
    from vibrojax.history.contacts import COLUMNS

    height = 2.0 + 2.4 * len(names)
    figure = Picture(figsize=(10, height), dpi=150, layout="constrained")
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    stops = np.unique(contacts.stop)
    for panel, name in zip(panels, names, strict=True):
        for k, stop in enumerate(stops):
            of = contacts.stop == stop
            panel.plot(
                contacts.touch[of],
                getattr(contacts, name)[of],
                linestyle="none",
                marker=MARKERS[k % len(MARKERS)],
                markersize=5,
                markerfacecolor="none" if k % 2 else COLOURS[k % len(COLOURS)],
                color=COLOURS[k % len(COLOURS)],
                label=f"stop {stop}",
            )
        units, label = COLUMNS[name]
        panel.set_ylabel(label if units == "1" else f"{label} [{units}]", fontsize=11)
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=10)
        if np.nanmin(getattr(contacts, name), initial=0.0) >= 0:
            panel.set_ylim(bottom=0.0)
    panels[-1].set_xlabel("Time of touch [s]", fontsize=11)
    if len(stops) > 1:
        panels[0].legend(fontsize=10)
    return figure
