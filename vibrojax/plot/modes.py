"""Picture of mode shapes."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from vibrojax.plot.style import GREY, LINE_STYLES, finish, key_of, label_for, new_picture, shades


def plot_modes(modes: xarray.Dataset) -> Figure:
    """Draw the mode shapes, each scaled to a largest displacement of 1, with their frequencies."""
    figure, axes = new_picture()
    places = modes["place"].values
    for i, color in enumerate(shades(modes.sizes["mode"])):
        shape, frequency = modes["shape"].values[:, i], float(modes["frequency"][i])
        if not np.isfinite(shape).all():
            continue
        axes.plot(
            places,
            shape / np.abs(shape).max(),
            color=color,
            linestyle=LINE_STYLES[i % len(LINE_STYLES)],
            linewidth=2,
            label=f"mode {i + 1}: {frequency:.5g} Hz",
        )
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set_xlim(0.0, 1.0)
    place = f"{label_for(modes['place'])} (0 root, 1 tip)"
    return finish(figure, axes, place, "Mode shape, largest displacement 1", key_of(axes))
