"""Picture of the motions that coexist at one frequency."""

from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from vibrojax.plot.style import (
    LABEL,
    LINE_STYLES,
    label_of,
    new_picture,
    outside_legend,
)

if TYPE_CHECKING:
    from vibrojax.branches.coexisting_result import Coexisting

SAMPLES = 256
"""Samples per drive period of an orbit."""


def plot_coexisting(found: "Coexisting") -> Figure:
    """Draw every motion in the plane of displacement and velocity, marked at drive phase 0.

    Raises `ValueError` when no periodic motion was found.
    """
    if not found.motions:
        raise ValueError("No periodic motion was found: there is nothing to draw.")
    figure, axes = new_picture()
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(found.motions)))
    total = len(found.start_states)
    for k, (motion, shade) in enumerate(zip(found.motions, shades, strict=True)):
        history = found.history(k, samples_per_period=SAMPLES)
        across, along = 1e3 * np.asarray(history.displacement()), np.asarray(history.velocity())
        style = LINE_STYLES[k % len(LINE_STYLES)]
        starts = f"{len(motion.starts)} of {total} starts"
        label = f"period {motion.period}, {motion.amplitude_ratio:.4g}, from {starts}"
        axes.plot(across, along, color=shade, linestyle=style, linewidth=2.0, label=label)
        strobed = slice(0, -1, SAMPLES)
        axes.plot(across[strobed], along[strobed], "o", color=shade, markersize=7)
    axes.set_xlabel("Displacement (mm)", fontsize=LABEL)
    axes.set_ylabel("Velocity (m/s)", fontsize=LABEL)
    lost = [
        f"{len(starts)} starts {words}"
        for starts, words in ((found.aperiodic, "without a period"), (found.diverged, "diverged"))
        if len(starts)
    ]
    where = f"{label_of(found.axis)} {found.value:g}; dots: drive phase 0"
    axes.set_title("; ".join([where, *lost]), fontsize=LABEL, loc="left")
    lines, labels = axes.get_legend_handles_labels()
    # The first entry says what the second number is.
    labels[0] = labels[0].replace(", ", ", amplitude ratio ", 1)
    outside_legend(axes, lines, labels)
    return figure
