"""Pictures of the study, from its dataset alone."""

from pathlib import Path

import matplotlib
import numpy as np
import xarray
from matplotlib.figure import Figure
from trends import Count

import vibrojax as vj
from vibrojax.plot.style import COLORS, LABEL, SMALL

matplotlib.use("Agg")

MAPS = {
    "peak": "peak_amplitude_ratio",
    "hysteresis": "hysteresis_width",
    "aperiodic": "aperiodic_fraction",
}
"""Measures that are drawn over gap and position, one panel for each taper and mass ratio."""
DPI = 100  # of twelve panels, wide enough
SHADES = {"with_it": COLORS["forward"], "level": "#c9c9c9", "against": COLORS["backward"]}
NAMES = {"with_it": "as claimed", "level": "level", "against": "against"}


def draw_maps(dataset: xarray.Dataset, folder: Path) -> None:
    """Draw measures over gap and position."""
    for name, measure in MAPS.items():
        figure = vj.plot_map(dataset, measure, x="gap", y="position")
        figure.savefig(folder / f"{name}.png", dpi=DPI)


def draw_frequencies(dataset: xarray.Dataset, folder: Path) -> None:
    """Draw the amplitude over gap and frequency of one rig, forward beside backward."""
    rig = {"taper": 0.5, "mass_ratio": 0.5, "position": 0.5}
    near = {k: float(dataset[k].sel({k: v}, method="nearest")) for k, v in rig.items()}
    around = dataset.sel(frequency_ratio=slice(0.9, 1.35))
    figure = vj.plot_map(around, "amplitude_ratio", y="gap", **near)
    figure.savefig(folder / "frequencies.png", dpi=DPI)


def draw_trends(counts: list[Count], path: Path) -> None:
    """Draw how many steps go the way of each claim."""
    figure = Figure(figsize=(11, 0.42 * len(counts) + 1.4), dpi=120, layout="constrained")
    axes = figure.subplots()
    rows = np.arange(len(counts))
    left = np.zeros(len(counts))
    for kind, color in SHADES.items():
        of = np.array([max(1, c.pairs) for c in counts])
        width = 100 * np.array([getattr(c, kind) for c in counts]) / of
        axes.barh(rows, width, left=left, color=color, label=NAMES[kind])
        for row, (start, wide) in enumerate(zip(left, width, strict=True)):
            if wide >= 6:
                ink = "black" if kind == "level" else "white"
                style = {"ha": "center", "va": "center", "fontsize": SMALL, "color": ink}
                axes.text(start + wide / 2, row, f"{wide:.0f}", **style)
        left += width
    labels = [c.claim + " *" * (c.source == "not claimed") for c in counts]
    labels = [text.replace(" (contradicts the line above)", "") for text in labels]
    axes.set_yticks(rows, labels, fontsize=SMALL)
    axes.set_ylim(len(counts) - 0.5, -0.5)
    axes.set_xlim(0, 100)
    label = "share of steps between neighbours of the grid (%); * not claimed in the paper"
    axes.set_xlabel(label, fontsize=LABEL - 1)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    figure.legend(loc="outside upper right", ncols=3, fontsize=SMALL, frameon=False)
    figure.savefig(path)


def draw_all(dataset: xarray.Dataset, counts: list[Count], folder: Path) -> None:
    """Draw every picture of the study."""
    draw_maps(dataset, folder)
    draw_frequencies(dataset, folder)
    draw_trends(counts, folder / "trends.png")
    vj.plot_map_summary(dataset).savefig(folder / "summary.png", dpi=DPI)
