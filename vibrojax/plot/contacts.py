"""Picture of the contacts of a history."""

from collections.abc import Sequence

import numpy as np
import xarray
from matplotlib.figure import Figure

from vibrojax.plot.style import (
    SERIES,
    SYMBOLS,
    key_of,
    label_for,
    name_axes,
    new_panels,
    outside_legend,
    within,
)

HEIGHT = 2.6
"""Of a panel, inches."""


def plot_contacts(contacts: xarray.Dataset, names: Sequence[str]) -> Figure:
    """Draw columns of the table against the time of touch, one panel each."""
    figure, panels = new_panels([HEIGHT] * len(names))
    stops = np.unique(contacts["stop"])
    for panel, name in zip(panels, names, strict=True):
        for k, stop in enumerate(stops):
            of = contacts["stop"].values == stop
            color = SERIES[k % len(SERIES)]
            panel.plot(
                contacts["touch"].values[of],
                contacts[name].values[of],
                linestyle="none",
                marker=SYMBOLS[k % len(SYMBOLS)],
                markersize=6,
                markerfacecolor="white" if k % 2 else color,
                color=color,
                label=f"stop {stop}",
            )
        name_axes(panel, None, within(label_for(contacts[name]), HEIGHT))
        if np.nanmin(contacts[name].values, initial=0.0) >= 0:
            panel.set_ylim(bottom=0.0)
    name_axes(panels[-1], label_for(contacts["touch"]), None)
    if len(stops) > 1:
        outside_legend(figure, key_of(panels[0]))
    return figure
