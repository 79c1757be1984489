"""Pictures of cycles against frequency, and of Poincaré sections."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.style import COLORS, GREY, Key, finish, label_for, new_picture

SHOWN = 1.6
"""Drive periods shown above the highest order, at least."""
ORDER: dict[str, Any] = {"color": GREY, "linewidth": 1.0, "linestyle": (0, (6, 3))}


def plot_cycles(cycles: xarray.Dataset, orders: Sequence[int], quantity: str) -> Figure:
    """Draw the lengths of cycles of a quantity against the drive frequency."""
    figure, axes = new_picture()
    frequency, length = cycles["drive_frequency"], cycles["drive_periods"].values
    top = max([order + SHOWN for order in orders] + [SHOWN])
    if len(length):
        top = max(top, float(np.quantile(length, 0.98)) * 1.08)
    over = length > top
    points = {"linestyle": "none", "color": COLORS["blue"], "markersize": 5, "alpha": 0.6}
    axes.plot(frequency[~over], length[~over], "o", **points)
    key: Key = {f"a cycle of {quantity} ({len(length)})": Line2D([], [], marker="o", **points)}
    for order in orders:
        axes.axhline(order, zorder=0.9, **ORDER)
    if over.any():
        above = points | {"alpha": 1.0, "markerfacecolor": "white"}
        axes.plot(frequency[over], np.full(over.sum(), 0.99 * top), "^", **above)
        key[f"longer than shown ({over.sum()})"] = Line2D([], [], marker="^", **above)
    if orders:
        plural = "" if list(orders) == [1] else "s"
        words = f"{', '.join(str(order) for order in orders)} drive period{plural}"
        key[words] = Line2D([], [], **ORDER)
    axes.set_ylim(0.0, top)
    axes.set_yticks(np.arange(0, np.ceil(top), 1 if top < 16 else 5))
    return finish(figure, axes, label_for(frequency), "Length of the cycle (drive periods)", key)


def plot_section(section: xarray.Dataset, x: str, y: str) -> Figure:
    """Draw one variable of a Poincaré section against another."""
    figure, axes = new_picture()
    size = 6.0 if section.sizes["point"] < 200 else 3.0
    dots = {"color": COLORS["blue"], "markersize": size, "markeredgewidth": 0, "alpha": 0.7}
    axes.plot(section[x], section[y], "o", **dots)
    names = label_for(section[x]), label_for(section[y])
    return finish(figure, axes, *names, {}, section.attrs["section"])
