"""Picture of several time histories together."""

from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from jaxtyping import ArrayLike
from matplotlib.figure import Figure

from vibrojax.history.quantities import check_quantity, unit_and_label
from vibrojax.plot.style import (
    LABEL,
    LINE_STYLES,
    new_picture,
    outside_legend,
)
from vibrojax.results.axes import axis_scale

if TYPE_CHECKING:
    from vibrojax.history.histories import Histories


def plot_histories(
    histories: "Histories", quantity: str, position: ArrayLike | None, most: int
) -> Figure:
    """Draw a quantity of every history against time; of many, evenly chosen ones."""
    check_quantity(histories[0].motion.equations, quantity)
    figure, axes = new_picture()
    shown = np.unique(np.linspace(0, len(histories) - 1, min(most, len(histories))).round())
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(shown)))
    scales = [axis_scale(histories.axes, name) for name in histories.axes]
    for order, (k, shade) in enumerate(zip(shown.astype(int), shades, strict=True)):
        history = histories[int(k)]
        place = np.unravel_index(k, histories.shape) if scales else ()
        numbers = (scale.labels[i] for scale, i in zip(scales, place, strict=True))
        axes.plot(
            np.asarray(history.time),
            np.asarray(history.quantity(quantity, position)),
            color=shade,
            linestyle=LINE_STYLES[order % len(LINE_STYLES)],
            linewidth=1.5,
            label=", ".join(numbers) or None,
        )
    unit, label = unit_and_label(quantity)
    axes.set_xlabel("Time (s)", fontsize=LABEL)
    axes.set_ylabel(label if unit == "1" else f"{label} ({unit})", fontsize=LABEL)
    if len(shown) < len(histories):
        title = f"{len(shown)} of {len(histories)} histories"
        axes.set_title(title, fontsize=LABEL, loc="left")
    lines, labels = axes.get_legend_handles_labels()
    if labels:
        outside_legend(axes, lines, labels)
    return figure
