"""Picture of basins: the attractor of every start."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from vibrojax.plot.style import (
    COLORS,
    SERIES,
    Key,
    chosen_in,
    edges_of,
    finish,
    label_for,
    new_picture,
)

ATTRACTORS = SERIES[:7]
"""Colours of periodic attractors, by share."""
OTHER, DIVERGED = "white", COLORS["black"]


def plot_basins(basins: xarray.Dataset, starts: Sequence[str], names: Sequence[str]) -> Figure:
    """Draw the basins at one combination of the other axes.

    `starts` are the names of the two numbers, `names` say in words what the attractors are.
    """
    number = basins["attractor"].values
    shown: Key = {}
    colors = [DIVERGED]
    periodic, others = iter(ATTRACTORS), 0.0
    style = {"edgecolor": "black", "linewidth": 0.5}
    for k, name in enumerate(names):
        own = basins.isel(attractor_number=k)
        color = COLORS["dark" if bool(own["cross_well"]) else "pale"]
        if int(own["period"]):
            color = next(periodic, OTHER)
        colors.append(color)
        share, error = 100 * float(own["share"]), 100 * float(own["standard_error"])
        if color == OTHER:
            others += share
        elif share:
            shown[f"{name}: {share:.1f} ± {error:.1f} %"] = Patch(facecolor=color, **style)
    if others:
        shown[f"further attractors: {others:.1f} %"] = Patch(facecolor=OTHER, **style)
    if lost := float(np.mean(number == 0)):
        shown[f"diverged: {100 * lost:.1f} %"] = Patch(facecolor=DIVERGED)
    figure, axes = new_picture()
    axes.grid(False)
    cells: dict[str, Any] = {"vmin": -0.5, "vmax": len(colors) - 0.5}
    cells["cmap"] = ListedColormap(colors)
    x, y = (basins[name].values.astype(float) for name in starts)
    if number.ndim == 2:
        axes.pcolormesh(edges_of(x), edges_of(y), number.T, rasterized=True, **cells)
    else:
        size = float(np.clip(3000 / max(number.size, 1), 4, 40))
        axes.scatter(x, y, c=number, s=size, edgecolors="black", linewidths=0.2, **cells)
    across, up = (label_for(basins[name]) for name in starts)
    return finish(figure, axes, across, up, shown, chosen_in(basins))
