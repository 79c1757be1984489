"""Picture of a resolution check."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.style import GREY, LABEL, SMALL, new_picture, outside_legend

if TYPE_CHECKING:
    from vibrojax.resolution import ResolutionCheck

STYLES = (("o", "#0060a8"), ("^", "#d1590a"), ("s", "#2a7f3f"), ("D", "#7a3f8f"))
LEAST = 1e-16
"""Where changes of exactly zero are drawn."""


def plot_resolution(check: "ResolutionCheck") -> Figure:
    """Draw the relative change of every number, one marker for every refinement.

    Hollow markers at the right end are changes without a size. Raises `ValueError` when nothing was
    varied.
    """
    if not check.moved:
        raise ValueError("Nothing was varied: there is nothing to draw.")
    figure, axes = new_picture()
    relative = check.relative
    names = list(dict.fromkeys(n for numbers in relative.values() for n in numbers))
    hollow = False
    for k, (what, numbers) in enumerate(relative.items()):
        marker, color = STYLES[k % len(STYLES)]
        changes = np.maximum([numbers.get(n, np.nan) for n in names], LEAST)
        places = np.arange(len(names)) + 0.12 * (k - (len(relative) - 1) / 2)
        known = np.isfinite(changes)
        style: dict[str, Any] = {"marker": marker, "color": color, "markersize": 9}
        axes.plot(changes[known], places[known], linestyle="none", label=what, **style)
        if not known.all():
            lost = places[~known]
            style |= {"markerfacecolor": "white", "transform": axes.get_yaxis_transform()}
            axes.plot(np.full(len(lost), 0.985), lost, linestyle="none", **style)
            hollow = True
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), [n.replace("_", " ") for n in names], fontsize=SMALL)
    axes.invert_yaxis()
    axes.set_xlabel(f"Relative change when computed more finely ({LEAST:g}: none)", fontsize=LABEL)
    lines, labels = axes.get_legend_handles_labels()
    if hollow:
        mark = {"marker": "o", "color": GREY, "markerfacecolor": "white", "markersize": 9}
        lines.append(Line2D([], [], linestyle="none", **mark))
        labels.append("from 0, came or went, or not finite")
    outside_legend(axes, lines, labels)
    return figure
