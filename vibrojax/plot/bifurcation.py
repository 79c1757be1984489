"""Pictures of bifurcation diagrams."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.regime import axis_label, titled, two_panels
from vibrojax.plot.style import COLORS, GREY, LABEL, SMALL, WORDS
from vibrojax.results.axes import example, pick

if TYPE_CHECKING:
    from vibrojax.regime.bifurcation_result import BifurcationDiagram

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


def plot_bifurcation_diagram(diagram: "BifurcationDiagram", **selection: Any) -> Figure:
    """Draw strobed displacements and exponents; see `BifurcationDiagram.plot`."""
    index, chosen, left = pick(diagram.coordinates, selection)
    left = [n for n in left if n not in ("direction", diagram.parameter)]
    if left:
        told = example(diagram.axes, left[0])
        raise ValueError(f"Give a value of {' and '.join(left)}, such as {told}.")
    x = np.asarray(diagram.values)
    displacement, exponent = diagram["displacement"][index], diagram.lyapunov_exponent[index]
    error = diagram["lyapunov_standard_error"][index]
    directions = diagram.directions
    if "direction" in selection:
        directions = (selection["direction"],)
        displacement, exponent, error = displacement[None], exponent[None], error[None]
    figure, (upper, lower) = two_panels((2.2, 1.0))
    handles = []
    for k, direction in reversed(list(enumerate(directions))):  # rings lie below the points
        style: dict[str, Any] = POINTS[direction] | {
            "color": COLORS[direction],
            "linestyle": "none",
        }
        many = np.broadcast_to(x[:, None], displacement[k].shape)
        upper.plot(many.ravel(), displacement[k].ravel(), rasterized=True, **style)
        bigger: dict[str, Any] = style | {"markersize": 7.0}
        lower.errorbar(x, exponent[k], 2 * error[k], ecolor=GREY, elinewidth=0.7, **bigger)
        shown: dict[str, Any] = style | {"markersize": 9.0}
        handles.append(Line2D([], [], **shown))
    lower.axhline(0.0, color=GREY, linewidth=1.0)
    upper.legend(
        handles,
        [WORDS[d] for d in reversed(directions)],
        ncols=2,
        frameon=False,
        fontsize=SMALL,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
    )
    upper.set_ylabel("Displacement at drive phase 0 (m)", fontsize=LABEL)
    lower.set_ylabel("Largest Lyapunov\nexponent (1/s)", fontsize=LABEL)
    lower.set_xlabel(axis_label(diagram.parameter), fontsize=LABEL)
    titled(lower, {n: v for n, v in chosen.items() if n != "direction"})
    return figure
