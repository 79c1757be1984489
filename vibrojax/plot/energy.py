"""Picture of where the energy of a history is and where it goes."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from vibrojax.plot.style import Picture

if TYPE_CHECKING:
    from vibrojax.history.energy import EnergyFlow

MOST_POINTS = 4000
"""Samples that a picture shows; of more, every so manyth."""
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999")
LOWEST = 1e-5


def plot_energy(energy: "EnergyFlow", kind: str) -> Figure:
    """Draw the share of every mode, and below it what was lost and put in."""
    every = max(1, energy.time.size // MOST_POINTS)
    time, share = energy.time[::every], energy.share[::every]
    figure = Picture(figsize=(10, 7), dpi=150, layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    names = [f"mode {i + 1}" for i in range(share.shape[1])]
    colours = [COLOURS[i % len(COLOURS)] for i in range(share.shape[1])]
    if kind == "stacked":
        top.stackplot(time, share.T, labels=names, colors=colours)
        top.set_ylim(0.0, 1.0)
    else:
        for name, colour, values in zip(names, colours, share.T, strict=True):
            top.semilogy(time, np.maximum(values, LOWEST / 10), label=name, color=colour)
        top.set_ylim(LOWEST, 1.5)
    top.set_ylabel("Share of the energy [1]", fontsize=11)

    bottom.plot(time, energy.beam_loss.sum(axis=1)[::every], label="lost in the body", color="k")
    for s, values in enumerate(energy.contact_loss[::every].T):
        name = "lost in the stop" if energy.contact_loss.shape[1] == 1 else f"lost in stop {s + 1}"
        style = ("-", "-.", ":")[s % 3]
        bottom.plot(time, values, label=name, color="#d55e00", linestyle=style)
    if np.any(energy.input_work):
        work = energy.input_work[::every]
        bottom.plot(time, work, label="put in by the drive", color="#0072b2", linestyle="--")
    held = energy.total[::every]
    bottom.plot(time, held, label="held by body and stops", color="#999999", linewidth=0.8)
    bottom.set_ylabel("Energy [J]", fontsize=11)
    bottom.set_xlabel("Time [s]", fontsize=11)
    for panel in (top, bottom):
        panel.legend(fontsize=10, loc="center left", bbox_to_anchor=(1.0, 0.5))
        panel.tick_params(labelsize=10)
    bottom.grid(alpha=0.3)
    top.set_xlim(time[0], time[-1])
    return figure
