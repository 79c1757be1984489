"""Picture of mode shapes."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from vibrojax.plot.style import GREY, finish, label_for, line_styles, new_picture


def plot_modes(modes: xarray.Dataset) -> Figure:
    """Draw the mode shapes, each scaled to a largest displacement of 1, with their frequencies."""
    _, axes = new_picture()
    places, frequencies = modes["place"].values, modes["frequency"].values
    for i, style in enumerate(line_styles(modes.sizes["mode"])):
        shape = modes["shape"].values[:, i]
        if np.isfinite(shape).all():
            label = f"mode {i + 1}: {frequencies[i]:.5g} Hz"
            axes.plot(places, shape / np.abs(shape).max(), linewidth=2, label=label, **style)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set_xlim(0.0, 1.0)
    place = f"{label_for(modes['place'])} (0 root, 1 tip)"
    return finish(axes, place, "Mode shape, largest displacement 1")
