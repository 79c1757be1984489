"""Pictures of bifurcation diagrams."""

from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.style import (
    COLORS,
    GREY,
    WORDS,
    chosen_in,
    label_for,
    name_axes,
    new_panels,
    outside_legend,
    titled,
)

POINTS: dict[str, dict[str, Any]] = {
    "forward": {"marker": ".", "markersize": 4.0, "markeredgewidth": 0.0},
    "backward": {
        "marker": "o",
        "markersize": 4.5,
        "markerfacecolor": "none",
        "markeredgewidth": 0.5,
    },
}
"""Filled points upwards, rings downwards: told apart without colour too."""


def plot_bifurcation_diagram(diagram: xarray.Dataset) -> Figure:
    """Draw strobed displacements and exponents against the parameter, in its directions."""
    figure, (upper, lower) = new_panels([4.4, 2.0])
    parameter = diagram[diagram["period"].dims[-1]]
    x, exponent, key = parameter.values, diagram["lyapunov_exponent"], {}
    for direction in reversed(diagram["direction"].values.tolist()):  # rings lie below the points
        style: dict[str, Any] = POINTS[direction] | {
            "color": COLORS[direction],
            "linestyle": "none",
        }
        own = diagram.sel(direction=direction)
        strobed = own["displacement"].values
        many = np.broadcast_to(x[:, None], strobed.shape)
        upper.plot(many.ravel(), strobed.ravel(), rasterized=True, **style)
        bigger: dict[str, Any] = style | {"markersize": 7.0, "ecolor": GREY, "elinewidth": 0.7}
        error = 2 * own["lyapunov_standard_error"].values
        lower.errorbar(x, own["lyapunov_exponent"].values, error, **bigger)
        shown: dict[str, Any] = style | {"markersize": 9.0}
        key[WORDS[direction]] = Line2D([], [], **shown)
    lower.axhline(0.0, color=GREY, linewidth=1.0)
    name_axes(upper, None, "Displacement at drive phase 0 (m)")
    name_axes(lower, label_for(parameter), label_for(exponent).replace("Lyapunov ", "Lyapunov\n"))
    titled(upper, chosen_in(diagram, "direction"))
    outside_legend(figure, key)
    return figure
