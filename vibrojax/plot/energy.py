"""Picture of where the energy of a history is and where it goes."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from vibrojax.plot.style import (
    COLORS,
    SERIES,
    key_of,
    label_for,
    name_axes,
    new_panels,
    outside_legend,
)

MOST_POINTS = 4000
"""Samples that a picture shows; of more, every so manyth."""
LOWEST = 1e-5


def plot_energy(energy: xarray.Dataset, kind: str) -> Figure:
    """Draw the share of every mode, and below it what was lost and put in."""
    shown = energy.isel(time=slice(None, None, max(1, energy.sizes["time"] // MOST_POINTS)))
    time, share = shown["time"].values, shown["share"].values.T
    figure, (top, bottom) = new_panels([2.9, 2.9])
    names = [f"mode {i + 1}" for i in range(len(share))]
    colors = [SERIES[i % len(SERIES)] for i in range(len(share))]
    if kind == "stacked":
        top.stackplot(time, share, labels=names, colors=colors)
        top.set_ylim(0.0, 1.0)
    else:
        for name, color, values in zip(names, colors, share, strict=True):
            top.semilogy(time, np.maximum(values, LOWEST / 10), label=name, color=color)
        top.set_ylim(LOWEST, 1.5)
    name_axes(top, None, "Share of the energy")

    lines = [("lost in the body", shown["beam_loss"].sum("mode"), "black", "-")]
    losses = shown["contact_loss"].values.T
    for s, values in enumerate(losses):
        name = "lost in the stop" if len(losses) == 1 else f"lost in stop {s + 1}"
        lines.append((name, values, "orange", ("-", "-.", ":")[s % 3]))
    if np.any(shown["input_work"]):
        lines.append(("put in by the drive", shown["input_work"], "blue", "--"))
    held = shown["modal_energy"].sum("mode") + shown["stop_energy"].sum("stop")
    lines.append(("held by body and stops", held, "middle", "-"))
    for name, values, color, style in lines:
        bottom.plot(time, values, label=name, color=COLORS[color], linestyle=style)
    name_axes(bottom, label_for(shown["time"]), "Energy (J)")
    outside_legend(figure, key_of(top, bottom))
    top.set_xlim(time[0], time[-1])
    return figure
